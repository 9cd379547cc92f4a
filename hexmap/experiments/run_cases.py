"""Independent cases, computed by any number of workers and through any interruption to the same bits.

An experiment is a list of cases, plain dictionaries that JSON can hold, and one function that computes a
case. What keeps the results the same for any number of workers and any order:

* the random numbers of a case follow from the seed and the case's own content, and from nothing else;
* a case sees only its own copy of the case and data that it cannot change;
* results pass through JSON in every mode, and JSON keeps a float exactly (its shortest ``repr``).

Workers are spawned, never forked, because a fork after a parallel kernel kills the child. Finished cases
go to a journal, one line each, so that a run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.errors import ArgumentError
from hexmap.base.version import __version__
from hexmap.experiments.case import CaseFunction, canonical_json, case_text, check_function, compute, digest
from hexmap.experiments.journal import Journal
from hexmap.experiments.local_workers import held_back, run_on_workers

__all__ = ["run_cases"]


def run_cases(
    function: CaseFunction,
    cases: Iterable[Mapping[str, Any]],
    *,
    shared: Mapping[str, Any] | None = None,
    folder: str | os.PathLike[str] | None = None,
    workers: int = 1,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    fingerprint: str = "",
) -> list[dict[str, Any]]:
    """Compute every case and return the results in the order of the cases.

    The results are the same, bit for bit, for any number of workers, any order of the cases, and after any
    number of interruptions, as long as ``function`` itself depends on nothing but its arguments. Equal cases
    are computed once; to repeat a case, number the repetitions in it. Cases that are to be compared pair by
    pair (the same rotation on every lattice) share random numbers only if they are one case.

    Args:
        function: a function of the top level of a module, ``function(case, rng, shared)``, which returns a
            dictionary of plain numbers, text and lists (numpy's are turned into Python's).
        cases: dictionaries that JSON can hold. The function gets them as JSON gives them back: tuples as
            lists, keys in sorted order.
        shared: read-only data for all cases, given to a worker once: arrays of any shape (C-contiguous and
            not writable there; mapped from a file where they are large), or values that JSON can hold.
        folder: where the journal of finished cases lies; made if it does not exist. Without one nothing is
            kept. A journal belongs to one function, version and ``shared``: a run on other data has another
            file in the same folder, so that neither can be taken for the other.
        workers: processes; one computes in this process.
        seed: of the whole experiment, 0 or larger.
        progress: called as ``progress(done, total)`` at the beginning and after every case.
        fingerprint: whatever else the results depend on, such as the version of a helper.

    Returns:
        One dictionary a case. Numbers that a journal kept equal those just computed exactly.

    Raises:
        ArgumentError: the function is not one that a worker can import, a case or ``shared`` is not plain
            data, or ``workers`` or ``seed`` is out of range.
        CaseError: a case failed, or a worker died. Other cases that were finished stay in the journal.
        HexmapError: what a case itself raised, unchanged.
        FormatError: the journal is a foreign file.
        FileAccessError: the journal cannot be written, or another run is using it.
        KeyboardInterrupt: after Ctrl-C, with the workers stopped and the journal whole.
    """
    check_function(function)
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ArgumentError(f"the number of workers must be 1 or larger, not {workers!r}")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ArgumentError(f"the seed must be a whole number, 0 or larger, not {seed!r}")
    seed = int(seed)
    data = _prepare_shared(shared or {})
    texts = [case_text(case, i) for i, case in enumerate(cases)]
    description = _describe(function, data, fingerprint)
    identity = digest(canonical_json(description))
    keys = [digest(f"{identity} {seed} {text}") for text in texts]
    counts: dict[str, int] = {}
    for key in keys:
        counts[key] = counts.get(key, 0) + 1

    name = f"cases-{function.__name__}-{identity[:12]}.jsonl"
    with Journal.open(folder, name, description) as journal:
        results = {key: result for key, result in journal.finished.items() if key in counts}
        todo = {key: text for key, text in zip(keys, texts, strict=True) if key not in results}
        done = sum(counts[key] for key in results)

        def record(key: str, text: str) -> None:
            nonlocal done
            journal.append(key, todo[key], text)
            results[key] = json.loads(text)
            done += counts[key]

        def report() -> None:
            if progress is not None:
                progress(done, len(keys))

        report()
        tasks = list(todo.items())
        if min(workers, len(tasks)) <= 1:
            for key, text in tasks:
                result = compute(function, text, seed, data)
                with held_back():
                    record(key, result)
                report()
        else:
            run_on_workers(function, tasks, data, seed, min(workers, len(tasks)), record, report)
    # Equal cases must not share one dictionary that a caller may change.
    first = set[str]()
    return [_once(results[key], key, first) for key in keys]


def _once(result: dict[str, Any], key: str, seen: set[str]) -> dict[str, Any]:
    if key in seen:
        copy: dict[str, Any] = json.loads(json.dumps(result))
        return copy
    seen.add(key)
    return result


# ---------------------------------------------------------------------- plain data


def _prepare_shared(shared: Mapping[str, Any]) -> dict[str, Any]:
    """Return the shared data as every case sees it: C-contiguous read-only arrays, and plain values."""
    data: dict[str, Any] = {}
    for name, value in shared.items():
        if isinstance(value, np.ndarray) and not value.dtype.hasobject:
            # The memory layout can change the last bit of a sum, so it is the same in every mode.
            array = np.asarray(value, order="C").view(np.ndarray)
            array.setflags(write=False)
            data[str(name)] = array
            continue
        try:
            data[str(name)] = json.loads(canonical_json(value))
        except (TypeError, ValueError, RecursionError) as error:
            raise ArgumentError(f"shared {name!r} is neither an array of numbers nor plain data") from error
    return data


def _describe(function: CaseFunction, data: Mapping[str, Any], fingerprint: str) -> dict[str, Any]:
    """Return all that a result depends on besides its case and the seed."""
    content = hashlib.blake2b(digest_size=20)
    for name in sorted(data):
        value = data[name]
        if isinstance(value, np.ndarray):
            content.update(f"{name!r} {value.dtype.str} {value.dtype.descr} {value.shape}\n".encode())
            content.update(value.reshape(-1).view(np.uint8).data)
        else:
            content.update(f"{name!r} {canonical_json(value)}\n".encode())
    source = getattr(sys.modules.get(function.__module__), "__file__", None)
    code = ""
    with contextlib.suppress(OSError, TypeError):
        # Yesterday's results of an edited function are the mistake that a journal invites.
        code = hashlib.blake2b(Path(source or "").read_bytes(), digest_size=20).hexdigest()
    return {
        "function": f"{function.__module__}.{function.__qualname__}",
        "code": code,
        "hexmap": __version__,
        "numpy": np.__version__,
        "shared": content.hexdigest(),
        "fingerprint": str(fingerprint),
    }


# ---------------------------------------------------------------------- one case


# ---------------------------------------------------------------------- the journal


# ---------------------------------------------------------------------- workers


