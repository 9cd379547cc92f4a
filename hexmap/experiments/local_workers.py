"""Worker processes of this machine, as an executor.

The pool is Python's own :class:`~concurrent.futures.ProcessPoolExecutor`. Added to it is what a long run needs of its
workers: one thread each, no reaction to the Ctrl-C of the terminal, an end with the run however the run ends, an end
in the middle of a case where the run is stopped, and a clear account of a worker that died.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from mmap import mmap
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from typing import Any

from hexmap.experiments.case import CaseError, one_line
from hexmap.experiments.interrupts import deferred_interrupt
from hexmap.experiments.payload import compute_from_payload

# Workers share the machine among themselves; threads below them would only get in each other's way.
_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_STOP_SECONDS = 1.0
_NO_GUARD = 'a script needs `if __name__ == "__main__":` around its run'
_NOTE_BYTES = 1024  # of the line that an error quotes of a case


class LocalWorkers(ProcessPoolExecutor):
    """Spawned processes of one thread each, which end with this process and can be stopped in the middle of a case.

    They are spawned, never forked, because a fork after a parallel kernel kills the child.

    Args:
        count: how many.
        folder: where the payload is, and where each worker notes the case it is computing.

    Raises:
        CaseError: this process is itself a worker that is still importing the script it works for.
    """

    def __init__(self, count: int, folder: Path) -> None:
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            # Python refuses the same, but only after the pool has made its semaphores. This process is about to be
            # ended by its parent, and what it leaks then would be the last line that the user reads.
            raise CaseError(_NO_GUARD)
        context = _WorkerContext()
        self._workers = context.workers
        self._folder = folder
        super().__init__(count, mp_context=context, initializer=_prepare_worker)

    def stop(self) -> None:
        """End all workers, those that are computing at once, and wait for them; takes little over a second at most."""
        self.shutdown(wait=False, cancel_futures=True)
        deadline = time.monotonic() + _STOP_SECONDS
        while alive := [worker for worker in self._workers if worker.is_alive()]:
            late = time.monotonic() >= deadline
            for worker in alive:
                if late:
                    worker.kill()
                elif self._case_of(worker):
                    # Only in a case, never while a worker sends a result: the pool would wait for the rest of it.
                    # What sends or waits ends by itself, or by the pool, which ends all where one is gone.
                    worker.terminate()
            time.sleep(0.005)

    def cause_of_death(self) -> str:
        """Return which worker broke the pool, how it ended and at which case."""
        deadline = time.monotonic() + _STOP_SECONDS
        while not (dead := [worker for worker in self._workers if worker.died]) and time.monotonic() < deadline:
            time.sleep(0.005)
        if not dead:
            return "the workers cannot be reached any more"
        code = dead[0].exitcode or 0
        how = f"killed by signal {-code}" if code < 0 else f"exit code {code}"
        text = self._case_of(dead[0])
        if text is None:
            return f"a worker died before it began ({how}); {_NO_GUARD}"
        case = f"case {text}: " if text else ""
        hint = "; if memory ran out, use fewer workers" if code == -9 else ""
        return f"{case}the worker died ({how}){hint}"

    def _case_of(self, worker: _Worker) -> str | None:
        """Return the case that a worker is computing: empty between two cases, None before the first one."""
        try:
            return _note_path(self._folder, worker.pid).read_bytes().rstrip(b"\0").decode(errors="ignore")
        except FileNotFoundError:
            return None


def compute_noted(folder: str, text: str) -> str:
    """Compute one case as :func:`compute_from_payload` does, in a worker that notes what it is computing."""
    note = _open_note(folder)
    note[:] = one_line(text).encode()[:_NOTE_BYTES].ljust(_NOTE_BYTES, b"\0")
    try:
        return compute_from_payload(folder, text)
    finally:
        note[:] = bytes(_NOTE_BYTES)


@lru_cache(maxsize=1)
def _open_note(folder: str) -> mmap:
    """Return a file as memory: writing costs nothing, and what is written outlives this process."""
    with open(_note_path(Path(folder), os.getpid()), "w+b") as file:
        file.truncate(_NOTE_BYTES)
        return mmap(file.fileno(), _NOTE_BYTES)


def _note_path(folder: Path, pid: int | None) -> Path:
    return folder / f"case-of-{pid}"


class _Worker(SpawnProcess):
    """A process that starts fit for its work, and remembers whether it was told to end."""

    _told = False

    def start(self) -> None:
        try:
            with _fit_for_start():
                super().start()
        except OSError as error:
            raise CaseError(f"a worker could not be started: {error.strerror or error}") from error

    def terminate(self) -> None:
        self._told = self._told or self.exitcode is None
        super().terminate()

    @property
    def died(self) -> bool:
        """Whether it has ended, and not because it was told to: the pool tells the dead one as well."""
        return self.exitcode is not None and not (self._told and self.exitcode == -signal.SIGTERM)


class _WorkerContext(SpawnContext):
    """Gives the pool its processes, and keeps a list of them: the pool itself shows none."""

    def __init__(self) -> None:
        super().__init__()
        self.workers: list[_Worker] = []

    def Process(self, *args: Any, **kwargs: Any) -> _Worker:  # type: ignore[override]
        worker = _Worker(*args, **kwargs)
        self.workers.append(worker)
        return worker


@contextlib.contextmanager
def _fit_for_start() -> Iterator[None]:
    """Make what a new process inherits right: one thread each, and no reaction to the Ctrl-C of the terminal.

    The environment has to be set before a worker imports numpy, and the signal blocked before it can run a
    handler, so neither can be left to the worker.
    """
    before = {name: os.environ.get(name) for name in _THREADS}
    with deferred_interrupt():
        mask: set[Any] | None = None
        if hasattr(signal, "pthread_sigmask"):
            # Its first use starts a process of its own and unblocks the signal again: do that first.
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


def _prepare_worker() -> None:
    """Leave it to the parent alone when to stop, unless there is no parent any more."""
    with contextlib.suppress(ValueError):
        # The parent has blocked it where it can.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()


def _die_with_parent() -> None:
    """End this worker when its parent has been killed, in the middle of a case or not."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
