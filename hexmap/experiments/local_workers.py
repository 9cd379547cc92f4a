"""Cases computed by processes of this machine."""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import pickle
import signal
import tempfile
import threading
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import FileAccessError, HexmapError
from hexmap.experiments.case import CaseError, CaseFunction, Task, compute, one_line


@dataclass(eq=False)
class _Worker:
    """A process, our end of the pipe to it, and what it is computing."""

    process: BaseProcess
    pipe: Connection
    task: Task | None = None
    ready: bool = False


class _RemoteTraceback(Exception):
    """Where in a worker an error arose: the cause of the error that is raised here."""


def run_on_workers(
    function: CaseFunction,
    tasks: list[Task],
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
                    with held_back():
                        finished = _receive(worker, record)
                        worker.task = queue.popleft() if queue else None
                        if worker.task is None:
                            del busy[worker.pipe]
                        with contextlib.suppress(BrokenPipeError):  # a dead worker is noticed at the next wait
                            worker.pipe.send(worker.task)
                    if finished:
                        report()
        except BaseException:
            with held_back():
                _drain(workers, record)
                for worker in workers:
                    worker.process.terminate()
            raise
        finally:
            with held_back():
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
    case = f"case {one_line(worker.task[1])}: " if worker.task else ""
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
            text = f"a worker could not load the experiment: {type(error).__name__}: {one_line(str(error))}"
            pipe.send(("error", None, text, traceback.format_exc()))
            return
        pipe.send(("ready",))
        while (task := pipe.recv()) is not None:
            try:
                result = compute(function, task[1], seed, data)
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


@contextlib.contextmanager
def _fit_for_start() -> Iterator[None]:
    """Make what a new process inherits right: one thread each, and deaf to the Ctrl-C of the terminal.

    The environment has to be set before a worker imports numpy, and the signal blocked before it can run a
    handler, so neither can be left to the worker.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    with held_back():
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


@contextlib.contextmanager
def held_back() -> Iterator[None]:
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


# Workers share the machine among themselves; threads below them would only get in each other's way.
_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


_STOP_SECONDS = 0.5


# Smaller arrays are cheaper to copy to a worker than to map.
_MAPPED_BYTES = 1 << 20
