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
import io
import json
import multiprocessing
import multiprocessing.connection
import os
import pickle
import signal
import sys
import tempfile
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

import hexmap
from hexmap.errors import ArgumentError, FileAccessError, FormatError, HexmapError

__all__ = ["CaseError", "CaseFunction", "case_generator", "run_cases"]

CaseFunction = Callable[[dict[str, Any], np.random.Generator, Mapping[str, Any]], Mapping[str, Any]]

_Task = tuple[str, str]  # the key of a case in the journal, and the case as canonical JSON

# Smaller arrays are cheaper to copy to a worker than to map.
_MAPPED_BYTES = 1 << 20
# Workers share the machine among themselves; threads below them would only get in each other's way.
_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_STOP_SECONDS = 0.5
_TEXT = 200  # characters of a case, or of a message, that a line of an error quotes


class CaseError(HexmapError, RuntimeError):
    """A case of an experiment failed; the text names the case and says why."""


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
    _check_function(function)
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ArgumentError(f"the number of workers must be 1 or larger, not {workers!r}")
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ArgumentError(f"the seed must be a whole number, 0 or larger, not {seed!r}")
    seed = int(seed)
    data = _prepare_shared(shared or {})
    texts = [_case_text(case, i) for i, case in enumerate(cases)]
    description = _describe(function, data, fingerprint)
    identity = _digest(_canonical(description))
    keys = [_digest(f"{identity} {seed} {text}") for text in texts]
    counts: dict[str, int] = {}
    for key in keys:
        counts[key] = counts.get(key, 0) + 1

    name = f"cases-{function.__name__}-{identity[:12]}.jsonl"
    with _Journal.open(folder, name, description) as journal:
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
                result = _compute(function, text, seed, data)
                with _held_back():
                    record(key, result)
                report()
        else:
            _run_on_workers(function, tasks, data, seed, min(workers, len(tasks)), record, report)
    # Equal cases must not share one dictionary that a caller may change.
    first = set[str]()
    return [_once(results[key], key, first) for key in keys]


def case_generator(case: Mapping[str, Any], seed: int = 0) -> np.random.Generator:
    """Return the random numbers that :func:`run_cases` gives to ``case``: of the seed and the case only."""
    words = np.frombuffer(hashlib.sha256(_canonical(case).encode()).digest(), dtype="<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *(int(word) for word in words)])))


def _once(result: dict[str, Any], key: str, seen: set[str]) -> dict[str, Any]:
    if key in seen:
        copy: dict[str, Any] = json.loads(json.dumps(result))
        return copy
    seen.add(key)
    return result


# ---------------------------------------------------------------------- plain data


def _plain(value: object) -> object:
    """Turn what numpy has of its own into what JSON has."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not plain data")


def _canonical(value: object) -> str:
    """Return one text for one content, whatever the order of its keys."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=_plain)


def _digest(text: str) -> str:
    return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()


def _one_line(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _TEXT else line[: _TEXT - 3] + "..."


def _case_text(case: Mapping[str, Any], index: int) -> str:
    if not isinstance(case, Mapping):
        raise ArgumentError(f"case {index} is not a dictionary: {_one_line(repr(case))}")
    try:
        return _canonical(dict(case))
    except (TypeError, ValueError, RecursionError) as error:
        raise ArgumentError(f"case {index} cannot be written as JSON: {_one_line(str(error))}") from error


def _check_function(function: CaseFunction) -> None:
    """Refuse early, and for one worker too, what a spawned worker could not import."""
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", None)
    found: object = sys.modules.get(module) if isinstance(module, str) else None
    for part in str(name).split("."):
        found = getattr(found, part, None)
    if name is None or found is not function:
        raise ArgumentError(f"{name or function!r} is not a function of the top level of a module")


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
            data[str(name)] = json.loads(_canonical(value))
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
            content.update(f"{name!r} {_canonical(value)}\n".encode())
    source = getattr(sys.modules.get(function.__module__), "__file__", None)
    code = ""
    with contextlib.suppress(OSError, TypeError):
        # Yesterday's results of an edited function are the mistake that a journal invites.
        code = hashlib.blake2b(Path(source or "").read_bytes(), digest_size=20).hexdigest()
    return {
        "function": f"{function.__module__}.{function.__qualname__}",
        "code": code,
        "hexmap": hexmap.__version__,
        "numpy": np.__version__,
        "shared": content.hexdigest(),
        "fingerprint": str(fingerprint),
    }


# ---------------------------------------------------------------------- one case


def _compute(function: CaseFunction, text: str, seed: int, data: Mapping[str, Any]) -> str:
    """Compute one case and return its result as JSON.

    Raises:
        CaseError: the case failed; what it raised is the cause.
        HexmapError: what the case itself raised.
    """
    case: dict[str, Any] = json.loads(text)
    rng = case_generator(case, seed)
    try:
        result = function(case, rng, MappingProxyType(data))
    except HexmapError:
        raise
    except Exception as error:
        raise CaseError(_failure(text, error)) from error
    if not isinstance(result, Mapping):
        raise CaseError(f"case {_one_line(text)}: the result is not a dictionary but {type(result).__name__}")
    try:
        return json.dumps(dict(result), separators=(",", ":"), default=_plain)
    except (TypeError, ValueError, RecursionError) as error:
        reason = _one_line(str(error))
        raise CaseError(f"case {_one_line(text)}: the result cannot be written as JSON: {reason}") from error


def _failure(text: str, error: BaseException) -> str:
    message = _one_line(str(error))
    return f"case {_one_line(text)}: {type(error).__name__}" + (f": {message}" if message else "")


# ---------------------------------------------------------------------- the journal


class _Journal:
    """Finished cases on disk, one JSON line each, after a first line that says what they are results of.

    A line is written by one call, so that a killed run can leave at most the last line torn; that one is cut
    off, and its case computed again.
    """

    def __init__(self, path: Path | None, file: io.FileIO | None) -> None:
        self._path, self._file = path, file
        self.finished: dict[str, dict[str, Any]] = {}

    @classmethod
    @contextlib.contextmanager
    def open(cls, folder: str | os.PathLike[str] | None, name: str, description: dict[str, Any]) -> Iterator[_Journal]:
        """Open the journal ``name`` in ``folder`` and read it; without a folder nothing is kept."""
        if folder is None:
            yield cls(None, None)
            return
        path = Path(folder) / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = io.FileIO(path, "a+")
        except OSError as error:
            raise FileAccessError(f"{path}: cannot be written: {error.strerror or error}") from error
        journal = cls(path, file)
        with file:
            journal._lock()
            journal._read(description)
            yield journal
            # Power may fail; a killed process loses nothing even without this.
            with contextlib.suppress(OSError):
                os.fsync(file.fileno())

    def _lock(self) -> None:
        """Keep a second run off the same journal; the lock goes with the process, however it ends."""
        assert self._file is not None
        try:
            import fcntl
        except ImportError:  # another system than POSIX
            return
        try:
            fcntl.flock(self._file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileAccessError(f"{self._path}: another run is using this journal") from error
        except OSError:
            return  # file systems without locks

    def _read(self, description: dict[str, Any]) -> None:
        assert self._file is not None
        self._file.seek(0)
        content = self._file.readall()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            self._file.truncate(whole)
        lines = content[:whole].splitlines()
        if not lines:
            self._write({"hexmap": "journal", "format": 1, "of": description})
            return
        head = _parse(lines[0])
        if head.get("hexmap") != "journal" or head.get("format") != 1 or head.get("of") != description:
            raise FormatError(f"{self._path}: is not the journal of this experiment; move it away to begin anew")
        for line in lines[1:]:
            entry = _parse(line)
            # A line that cannot be read only costs its case a second time.
            if isinstance(entry.get("key"), str) and isinstance(entry.get("result"), dict):
                self.finished[entry["key"]] = entry["result"]

    def append(self, key: str, case: str, result: str) -> None:
        """Add a finished case; ``case`` and ``result`` are JSON already."""
        if self._file is not None:
            self._write_line(f'{{"key":"{key}","case":{case},"result":{result}}}\n')

    def _write(self, value: object) -> None:
        self._write_line(json.dumps(value, separators=(",", ":")) + "\n")

    def _write_line(self, line: str) -> None:
        assert self._file is not None
        content = line.encode()
        try:
            while content:
                content = content[self._file.write(content) :]
        except OSError as error:
            raise FileAccessError(f"{self._path}: cannot be written: {error.strerror or error}") from error


def _parse(line: bytes) -> dict[str, Any]:
    try:
        value = json.loads(line)
    except ValueError:
        return {}
    return value if isinstance(value, dict) else {}


# ---------------------------------------------------------------------- workers


@contextlib.contextmanager
def _held_back() -> Iterator[None]:
    """Let Ctrl-C wait until the block has ended."""
    if threading.current_thread() is not threading.main_thread():
        yield  # Python interrupts the main thread only
        return
    caught: list[tuple[int, Any]] = []
    before = signal.signal(signal.SIGINT, lambda number, frame: caught.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)
        if caught and callable(before):
            before(*caught[0])


@contextlib.contextmanager
def _fit_for_start() -> Iterator[None]:
    """Make what a new process inherits right: one thread each, and deaf to the Ctrl-C of the terminal.

    The environment has to be set before a worker imports numpy, and the signal blocked before it can run a
    handler, so neither can be left to the worker.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    with _held_back():
        mask: set[Any] | None = None
        if hasattr(signal, "pthread_sigmask"):
            # Its first use starts a process of its own and unblocks the signal again: do that first.
            from multiprocessing import resource_tracker

            resource_tracker.ensure_running()
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        os.environ.update(dict.fromkeys(_THREADS, "1"))
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    os.environ.pop(name, None)
                else:
                    os.environ[name] = value
            if mask is not None:
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@dataclass(eq=False)
class _Worker:
    """A process, our end of the pipe to it, and what it is computing."""

    process: BaseProcess
    pipe: Connection
    task: _Task | None = None
    ready: bool = False


class _RemoteTraceback(Exception):
    """Where in a worker an error arose: the cause of the error that is raised here."""


def _run_on_workers(
    function: CaseFunction,
    tasks: list[_Task],
    data: dict[str, Any],
    seed: int,
    count: int,
    record: Callable[[str, str], None],
    report: Callable[[], None],
) -> None:
    """Compute the tasks on ``count`` workers, one at a time each; ``record`` each as it is finished."""
    queue = deque(tasks)
    with tempfile.TemporaryDirectory(prefix="hexmap-cases-") as scratch:
        _write_payload(Path(scratch), function, data, seed)
        workers: list[_Worker] = []
        try:
            _start(workers, count, scratch)
            busy = {worker.pipe: worker for worker in workers}
            while busy:
                for pipe in multiprocessing.connection.wait(list(busy)):
                    worker = busy[pipe]  # type: ignore[index]
                    with _held_back():
                        finished = _receive(worker, record)
                        worker.task = queue.popleft() if queue else None
                        if worker.task is None:
                            del busy[worker.pipe]
                        with contextlib.suppress(BrokenPipeError):  # a dead worker is noticed at the next wait
                            worker.pipe.send(worker.task)
                    if finished:
                        report()
        except BaseException:
            with _held_back():
                _drain(workers, record)
                for worker in workers:
                    worker.process.terminate()
            raise
        finally:
            with _held_back():
                _stop(workers)


def _write_payload(folder: Path, function: CaseFunction, data: Mapping[str, Any], seed: int) -> None:
    """Write what every worker needs into ``folder``: large arrays as files to map, the rest in one pickle."""
    small, mapped = {}, {}
    try:
        for i, (name, value) in enumerate(data.items()):
            if isinstance(value, np.ndarray) and value.nbytes >= _MAPPED_BYTES:
                mapped[name] = f"{i}.npy"
                np.save(folder / mapped[name], value, allow_pickle=False)
            else:
                small[name] = value
        # The function as bytes: a worker that cannot import it should say so, not die of it.
        payload = (pickle.dumps(function), small, mapped, list(data), seed)
        (folder / "payload").write_bytes(pickle.dumps(payload))
    except OSError as error:
        raise FileAccessError(f"{folder}: cannot be written: {error.strerror or error}") from error


def _start(workers: list[_Worker], count: int, scratch: str) -> None:
    context = multiprocessing.get_context("spawn")
    with _fit_for_start():
        for _ in range(count):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, scratch), daemon=True)
            try:
                process.start()
            except OSError as error:
                raise CaseError(f"a worker could not be started: {error.strerror or error}") from error
            workers.append(_Worker(process, ours))
            # With the only other end in the worker, its death is the end of the file here.
            theirs.close()


def _receive(worker: _Worker, record: Callable[[str, str], None]) -> bool:
    """Take one message of a worker; whether it was a finished case.

    Raises:
        CaseError: the case failed, or the worker died.
        HexmapError: what the case raised.
    """
    try:
        kind, *content = worker.pipe.recv()
    except (EOFError, OSError) as error:
        raise CaseError(_death(worker)) from error
    if kind == "result":
        assert worker.task is not None
        record(worker.task[0], content[0])
        return True
    if kind == "ready":
        worker.ready = True
        return False
    pickled, text, where = content
    failure: HexmapError = CaseError(text) if pickled is None else pickle.loads(pickled)
    raise failure from _RemoteTraceback(f"\n{where}")


def _death(worker: _Worker) -> str:
    worker.process.join(_STOP_SECONDS)
    code = worker.process.exitcode
    how = f"killed by signal {-code}" if code is not None and code < 0 else f"exit code {code}"
    if not worker.ready:
        return f'a worker died before it began ({how}); a script needs `if __name__ == "__main__":` around its run'
    case = f"case {_one_line(worker.task[1])}: " if worker.task else ""
    hint = "; if memory ran out, use fewer workers" if code == -9 else ""
    return f"{case}the worker died ({how}){hint}"


def _drain(workers: list[_Worker], record: Callable[[str, str], None]) -> None:
    """Record what workers have finished but nobody has received yet."""
    for worker in workers:
        with contextlib.suppress(Exception):
            if worker.task is not None and worker.pipe.poll(0):
                _receive(worker, record)


def _stop(workers: list[_Worker]) -> None:
    """End all workers and wait for them, so that none is left as a zombie; takes a second at the most."""
    for worker in workers:
        worker.pipe.close()
    for end in (lambda process: None, BaseProcess.terminate, BaseProcess.kill):
        for worker in workers:
            if worker.process.is_alive():
                end(worker.process)
        for worker in workers:
            worker.process.join(_STOP_SECONDS / len(workers))
    for worker in workers:
        with contextlib.suppress(ValueError):
            worker.process.close()


def _work(pipe: Connection, scratch: str) -> None:
    """Compute cases until there are none: what a worker does."""
    with contextlib.suppress(ValueError):
        # The parent has blocked it where it can; the parent alone decides when to stop.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    # A parent that is gone needs no answer.
    with contextlib.suppress(EOFError, ConnectionError):
        try:
            function, data, seed = _read_payload(Path(scratch))
        except Exception as error:
            text = f"a worker could not load the experiment: {type(error).__name__}: {_one_line(str(error))}"
            pipe.send(("error", None, text, traceback.format_exc()))
            return
        pipe.send(("ready",))
        while (task := pipe.recv()) is not None:
            try:
                result = _compute(function, task[1], seed, data)
            except Exception as error:
                pipe.send(("error", _pickled(error), str(error), traceback.format_exc()))
                return
            pipe.send(("result", result))


def _read_payload(folder: Path) -> tuple[CaseFunction, dict[str, Any], int]:
    function, small, mapped, names, seed = pickle.loads((folder / "payload").read_bytes())
    arrays = {name: np.load(folder / file, mmap_mode="r").view(np.ndarray) for name, file in mapped.items()}
    data: dict[str, Any] = {**small, **arrays}
    for value in data.values():
        if isinstance(value, np.ndarray):
            _freeze(value)
    return pickle.loads(function), {name: data[name] for name in names}, seed


def _freeze(array: NDArray[Any]) -> None:
    array.setflags(write=False)


def _pickled(error: Exception) -> bytes | None:
    """Return the error as bytes if the same error comes out again, else None."""
    try:
        content = pickle.dumps(error)
        again = pickle.loads(content)
    except Exception:
        return None
    return content if isinstance(again, HexmapError) and str(again) == str(error) else None


def _die_with_parent() -> None:
    """End this worker when its parent has been killed, in the middle of a case or not."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
