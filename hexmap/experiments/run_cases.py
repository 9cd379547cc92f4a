"""Independent cases, computed by any number of workers and through any interruption to the same bits.

An experiment is a list of cases, plain dictionaries that JSON can hold, and one function that computes a
case. What keeps the results the same for any number of workers and any order:

* the random numbers of a case follow from the seed and the case's own content, and from nothing else;
* a case sees only its own copy of the case and data that it cannot change;
* results pass through JSON in every mode, and JSON keeps a float exactly (its shortest ``repr``).

Cases are computed in this process, by worker processes of this machine, or by any executor that is passed in,
such as that of a cluster. Finished cases go to a journal, one line each, so that a run that was interrupted goes on
where it stopped.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, as_completed
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.errors import ArgumentError, HexmapError
from hexmap.base.interrupts import deferred_interrupt
from hexmap.base.local_workers import LocalWorkers, WorkerDied, WorkerError
from hexmap.base.version import __version__
from hexmap.experiments.case import (
    CaseError,
    CaseFunction,
    Task,
    canonical_json,
    case_text,
    check_function,
    compute,
    digest,
    failure,
    one_line,
)
from hexmap.experiments.journal import Journal
from hexmap.experiments.payload import compute_from_payload, write_payload

__all__ = ["run_cases"]


def run_cases(
    function: CaseFunction,
    cases: Iterable[Mapping[str, Any]],
    *,
    shared: Mapping[str, Any] | None = None,
    folder: str | os.PathLike[str] | None = None,
    workers: int = 1,
    executor: Executor | None = None,
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
        workers: processes of this machine; one computes in this process.
        executor: computes the cases instead of ``workers``: any object whose ``submit`` returns a
            :class:`concurrent.futures.Future`, such as Dask's ``client.get_executor()``. It is not shut down. Its
            workers import ``function`` and read ``shared`` from files that are written into ``folder`` (without one
            into the temporary folder of this machine), so they must see that folder under the same path.
        seed: of the whole experiment, 0 or larger.
        progress: called as ``progress(done, total)`` at the beginning and after every case.
        fingerprint: whatever else the results depend on, such as the version of a helper.

    Returns:
        One dictionary a case. Numbers that a journal kept equal those just computed exactly.

    Raises:
        ArgumentError: the function is not one that a worker can import, a case or ``shared`` is not plain
            data, or ``workers`` or ``seed`` is out of range.
        CaseError: a case failed, or every worker that was given it died. Other cases that were finished stay in the
            journal. A worker that is killed from outside costs what it had computed of its case, and no more.
        HexmapError: what a case itself raised, unchanged.
        FormatError: the journal is a foreign file.
        FileAccessError: the journal cannot be written, or another run is using it.
        KeyboardInterrupt: after Ctrl-C, with the workers stopped and the journal whole.
    """
    _check(function, workers, seed)
    data = _prepare_shared(shared or {})
    texts = [case_text(case, i) for i, case in enumerate(cases)]
    description = _describe(function, data, fingerprint)
    identity = digest(canonical_json(description))
    keys = [digest(f"{identity} {int(seed)} {text}") for text in texts]
    name = f"cases-{function.__name__}-{identity[:12]}.jsonl"
    with Journal.open(folder, name, description) as journal:
        results = _Results(keys, journal, progress)
        tasks = [task for task in dict(zip(keys, texts, strict=True)).items() if task[0] not in results.finished]
        count = min(workers, len(tasks))
        results.report()
        if executor is not None:
            # Workers of this machine see its temporary folder, others perhaps not.
            with _scratch(None if isinstance(executor, LocalWorkers) else folder) as scratch:
                write_payload(scratch, function, data, int(seed))
                _compute_by(executor, scratch, tasks, results)
        elif count > 1:
            with _scratch(None) as scratch:
                write_payload(scratch, function, data, int(seed))
                _compute_by_local_workers(count, scratch, tasks, results)
        else:
            for key, text in tasks:
                result = compute(function, text, int(seed), data)
                with deferred_interrupt():
                    results.record(key, text, result)
                results.report()
    return results.in_order()


def _check(function: CaseFunction, workers: int, seed: int) -> None:
    check_function(function)
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ArgumentError(f"the number of workers must be 1 or larger, not {workers!r}")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ArgumentError(f"the seed must be a whole number, 0 or larger, not {seed!r}")


class _Results:
    """The results of a run as they come in: into the journal, and to whoever watches the progress."""

    def __init__(self, keys: Sequence[str], journal: Journal, progress: Callable[[int, int], None] | None) -> None:
        self._keys, self._journal, self._progress = keys, journal, progress
        self._counts = Counter(keys)  # equal cases have one key
        self.finished = {key: result for key, result in journal.finished.items() if key in self._counts}
        self._done = sum(self._counts[key] for key in self.finished)

    def record(self, key: str, text: str, result: str) -> None:
        """Keep the result of the case ``text``; a second time is none."""
        if key not in self.finished:
            self._journal.append(key, text, result)
            self.finished[key] = json.loads(result)
            self._done += self._counts[key]

    def report(self) -> None:
        """Tell whoever watches how far the run is."""
        if self._progress is not None:
            self._progress(self._done, len(self._keys))

    def in_order(self) -> list[dict[str, Any]]:
        """Return one dictionary a case, none of them shared with another one that a caller may change."""
        first = set[str]()
        out: list[dict[str, Any]] = []
        for key in self._keys:
            result = self.finished[key]
            out.append(json.loads(json.dumps(result)) if key in first else result)
            first.add(key)
        return out


# ---------------------------------------------------------------------- executors


@contextlib.contextmanager
def _scratch(folder: str | os.PathLike[str] | None) -> Iterator[Path]:
    """Make a folder for the payload of one run, and remove it at the end."""
    with tempfile.TemporaryDirectory(prefix="hexmap-cases-", dir=folder, ignore_cleanup_errors=True) as scratch:
        yield Path(scratch)


def _compute_by(executor: Executor, scratch: Path, tasks: Sequence[Task], results: _Results) -> None:
    """Compute the tasks on an executor whose workers read the payload in ``scratch``; record each as it is finished."""
    pending: dict[Future[str], Task] = {}
    try:
        with deferred_interrupt():
            for key, text in tasks:
                pending[executor.submit(compute_from_payload, str(scratch), text)] = key, text
        for future in as_completed(pending):
            with deferred_interrupt():
                results.record(*pending[future], _result(future, pending[future][1]))
            results.report()
    except BaseException as error:
        with deferred_interrupt():
            _keep_what_is_finished(pending, results)
        if isinstance(error, BrokenExecutor):
            raise CaseError(f"the executor broke: {one_line(str(error))}") from error
        if isinstance(error, WorkerError):
            raise CaseError(str(error)) from error
        raise


def _result(future: Future[str], text: str) -> str:
    """Return what came out of the case ``text``.

    Raises:
        CaseError: its workers died, or another executor has lost it.
        HexmapError: what the case raised.
    """
    try:
        return future.result()
    except WorkerDied as error:
        raise CaseError(f"case {one_line(text)}: {error}") from error
    except (HexmapError, BrokenExecutor):
        raise
    except Exception as error:  # no case raises anything else
        raise CaseError(failure(text, error)) from error


def _keep_what_is_finished(pending: Mapping[Future[str], Task], results: _Results) -> None:
    """Record what has been computed but not yet been received, and withdraw what has not begun."""
    for future, task in pending.items():
        with contextlib.suppress(Exception):
            if future.done() and not future.cancelled() and future.exception() is None:
                results.record(*task, future.result())
    for future in pending:
        future.cancel()


def _compute_by_local_workers(count: int, scratch: Path, tasks: Sequence[Task], results: _Results) -> None:
    try:
        pool = LocalWorkers(count)
    except WorkerError as error:
        raise CaseError(str(error)) from error
    try:
        _compute_by(pool, scratch, tasks, results)
    finally:
        pool.stop()


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
