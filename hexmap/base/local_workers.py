"""Worker processes of this machine, as an executor.

What a long run needs of its workers: one thread each, no reaction to the Ctrl-C of the terminal, an end with the run
however the run ends, an end in the middle of a task where the run is stopped, and where a worker is killed from
outside (memory ran out, an operator), the loss of its task only, which another worker begins again.

A worker has two pipes of its own, one for tasks and one for results, and in this process a thread that reads the
results. Nothing is shared between workers, no lock and no queue, so that one may die at any instant: its pipe ends,
what it had sent before is read, and the first task that it had not answered is the one that it died at.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from typing import Any, TypeVar

from hexmap.base.errors import HexmapError
from hexmap.base.interrupts import deferred_interrupt

__all__ = ["LocalWorkers", "WorkerDied", "WorkerError"]

T = TypeVar("T")
# Workers share the machine among themselves; threads below them would only get in each other's way.
_THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_STOP_SECONDS = 1.0
_KILLED = -9  # the exit code, of what the system kills when memory runs out, too
_TRIES = 3  # a worker that was killed says nothing of its task; three that died at it do
_NO_GUARD = 'a script needs `if __name__ == "__main__":` around its run'
# A worker whose tasks are shorter is sent the next one before it asks: waking it would take as long as the task. It
# lies in the worker's pipe until then, which holds four times as many bytes.
_SHORT_SECONDS = 0.01
_AHEAD_BYTES = 1 << 14
_starting = threading.Lock()  # what a new process inherits is set for that moment


class WorkerError(HexmapError, RuntimeError):
    """Worker processes cannot be started or have been stopped."""


class WorkerDied(WorkerError):
    """The worker of a task died at it, and so did those that were given it again."""


class LocalWorkers(Executor):
    """Spawned processes of one thread each, which end with this process and are replaced where they are killed.

    They are spawned, never forked, because a fork after a parallel kernel kills the child. A task whose worker is
    killed by a signal is begun again by another one, three times at most; one whose worker ends by itself is not.
    What a task returns must therefore not depend on whether it was begun before.

    Args:
        count: how many.

    Raises:
        WorkerError: this process is itself a worker that is still importing the script it works for, or a process
            cannot be started.
    """

    def __init__(self, count: int) -> None:
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            # Python refuses the same, but only when the process is started, and in more words.
            raise WorkerError(_NO_GUARD)
        self._lock = threading.Lock()  # of all that follows
        self._waiting: deque[_Task] = deque()
        self._workers: dict[int, _Worker] = {}
        self._failed_starts = 0
        self._over: WorkerError | None = None
        self._threads = [threading.Thread(target=self._serve, args=(k,), daemon=True) for k in range(count)]
        try:
            for number in range(count):
                self._workers[number] = _Worker()
        except BaseException:
            self.stop()
            raise
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Give a task to the next worker that is free.

        Raises:
            WorkerError: the workers have been stopped, or cannot be started.
        """
        task = _Task(pickle.dumps((fn, args, kwargs)))
        with self._lock:
            if self._over is not None:
                raise self._over
            self._waiting.append(task)
            self._hand_out()
        return task.future

    def stop(self) -> None:
        """End all workers, those that are computing at once, and wait for them; takes little over a second at most.

        Tasks that have not begun are cancelled, and those in the middle fail with WorkerError.
        """
        with deferred_interrupt():
            with self._lock:
                self._over = self._over or WorkerError("the workers have been stopped")
                while self._waiting:
                    self._waiting.popleft().future.cancel()
                workers = list(self._workers.values())
                for worker in workers:
                    worker.end()
            deadline = time.monotonic() + _STOP_SECONDS
            for worker in workers:
                worker.process.join(max(0.0, deadline - time.monotonic()))
                worker.process.kill()
                worker.process.join()
            for thread in self._threads:
                if thread.ident is not None:
                    thread.join()

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Do as :meth:`stop`, whatever the arguments."""
        self.stop()

    def _hand_out(self) -> None:
        """Send what waits to the workers that are free; the lock is held."""
        for ahead in (False, True):
            for worker in self._workers.values():
                # Ahead only where there is enough for all: a task in a pipe cannot be given to another worker.
                while len(self._waiting) > (len(self._workers) if ahead else 0) and worker.takes(
                    self._waiting[0], ahead
                ):
                    task = self._waiting.popleft()
                    if task.begun or task.future.set_running_or_notify_cancel():
                        task.begun = True
                        worker.send(task)

    def _serve(self, number: int) -> None:
        """Read what worker ``number`` sends, and replace it when it dies, until all is over."""
        while (worker := self._workers.get(number)) is not None:
            try:
                reply = worker.results.recv_bytes()
            except (EOFError, OSError):
                self._bury(number, worker)
                continue
            with self._lock:
                task = worker.answered()
                self._failed_starts = 0
                self._hand_out()
            if task is not None:
                _answer(task.future, reply)

    def _bury(self, number: int, worker: _Worker) -> None:
        """Put another worker in the place of a dead one, and what it had not answered in front of what waits."""
        code = worker.exit_code()
        failed: list[tuple[_Task, WorkerError]] = []
        with self._lock:
            del self._workers[number]
            lost = list(worker.tasks)
            if self._over is None:
                if lost:
                    lost[0].deaths += 1
                    if code >= 0 or lost[0].deaths >= _TRIES:
                        often = f", {lost[0].deaths} times" if lost[0].deaths > 1 else ""
                        text = f"the worker died{often} ({_how(code)}){_hint(code)}"
                        failed.append((lost.pop(0), WorkerDied(text)))
                self._waiting.extendleft(reversed(lost))
                lost = []
                self._replace(number, None if worker.ready else code)
                self._hand_out()
            if self._over is not None:
                failed += [(task, self._over) for task in (*lost, *self._waiting)]
                self._waiting.clear()
        for task, error in failed:
            if task.begun or task.future.set_running_or_notify_cancel():
                task.future.set_exception(error)

    def _replace(self, number: int, failed: int | None) -> None:
        """Start another worker; ``failed`` is the exit code of one that had not begun to work. The lock is held."""
        if failed is not None:
            self._failed_starts += 1
            if failed >= 0 or self._failed_starts >= _TRIES:
                hint = f"; {_NO_GUARD}" if failed >= 0 else _hint(failed)
                self._over = WorkerError(f"a worker died before it began ({_how(failed)}){hint}")
                return
        try:
            self._workers[number] = _Worker()
        except WorkerError as error:
            self._over = error


class _Task:
    """What a worker is to compute, and what became of it."""

    def __init__(self, content: bytes) -> None:
        self.content = content
        self.future: Future[Any] = Future()
        self.begun = False
        self.deaths = 0


class _Worker:
    """A process, the pipes to and from it, and what it has been sent and has not answered.

    Raises:
        WorkerError: it cannot be started.
    """

    def __init__(self) -> None:
        try:
            theirs, self._sender = multiprocessing.Pipe(duplex=False)
            self.results, sender = multiprocessing.Pipe(duplex=False)
            self.process = SpawnProcess(target=_work, args=(theirs, sender))
            with _fit_for_start():
                self.process.start()
            # What only the worker holds ends with it.
            theirs.close()
            sender.close()
        except OSError as error:
            raise WorkerError(f"a worker could not be started: {error.strerror or error}") from error
        self.ready = False
        self.tasks: deque[_Task] = deque()
        self._sent = time.monotonic()
        self._short = False

    def takes(self, task: _Task, ahead: bool) -> bool:
        """Tell whether it is free for the task, or may have it ahead of time."""
        if not ahead or not self.tasks:
            return self.ready and not self.tasks
        return self._short and len(self.tasks) == 1 and len(self.tasks[0].content) + len(task.content) < _AHEAD_BYTES

    def send(self, task: _Task) -> None:
        """Send a task; where the worker is dead, whoever reads its results will notice."""
        if not self.tasks:
            self._sent = time.monotonic()
        self.tasks.append(task)
        with contextlib.suppress(OSError):
            self._sender.send_bytes(task.content)

    def answered(self) -> _Task | None:
        """Return the task that a message is the answer to; the first message says that the worker is ready."""
        if not self.ready:
            self.ready = True
            return None
        now = time.monotonic()
        self._short = now - self._sent < _SHORT_SECONDS
        self._sent = now
        return self.tasks.popleft()

    def end(self) -> None:
        """Let it end: at once where it computes, by itself where it waits."""
        if self.tasks or not self.ready:
            self.process.terminate()
        self._sender.close()

    def exit_code(self) -> int:
        """Return how it ended, negative for a signal; one that only closed its pipe is killed."""
        self.process.join(_STOP_SECONDS)
        if self.process.exitcode is None:
            self.process.kill()
        while self.process.exitcode is None:  # another thread may be waiting for it as well
            self.process.join()
            time.sleep(0.001)
        self.results.close()
        self._sender.close()
        return self.process.exitcode


def _how(code: int) -> str:
    return f"killed by signal {-code}" if code < 0 else f"exit code {code}"


def _hint(code: int) -> str:
    return "; if memory ran out, use fewer workers" if code == _KILLED else ""


def _answer(future: Future[Any], reply: bytes) -> None:
    """Give a future what the worker sent."""
    try:
        error, value = pickle.loads(reply)
    except Exception as reason:
        future.set_exception(RuntimeError(f"what a worker returned cannot be read: {type(reason).__name__}: {reason}"))
        return
    if error is None:
        future.set_result(value)
    else:
        error.__cause__ = _InWorker(value)
        future.set_exception(error)


class _InWorker(Exception):
    """The cause of an error that comes from a worker: its traceback there, as text."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self.text = text

    def __str__(self) -> str:
        return f"\n{self.text}"


# ---------------------------------------------------------------------- in the worker


def _work(tasks: Connection, results: Connection) -> None:
    """Compute what comes, one after the other, until nothing more can come."""
    with contextlib.suppress(ValueError):
        # The parent has blocked it where it can: when to stop is left to the parent alone.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_die_with_parent, daemon=True).start()
    results.send_bytes(b"ready")
    while True:
        try:
            content = tasks.recv_bytes()
        except EOFError:
            return
        results.send_bytes(_computed(content))


def _computed(content: bytes) -> bytes:
    """Return the error of a task or None, and its value or the traceback."""
    try:
        function, args, kwargs = pickle.loads(content)
        return pickle.dumps((None, function(*args, **kwargs)))
    except BaseException as error:
        text = traceback.format_exc()
        try:
            return pickle.dumps((error, text))
        except Exception:
            return pickle.dumps((RuntimeError(f"{type(error).__name__}: {error}"), text))


def _die_with_parent() -> None:
    """End this worker when its parent has been killed, in the middle of a task or not."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextlib.contextmanager
def _fit_for_start() -> Iterator[None]:
    """Make what a new process inherits right: one thread each, and no reaction to the Ctrl-C of the terminal.

    The environment has to be set before a worker imports numpy, and the signal blocked before it can run a
    handler, so neither can be left to the worker.
    """
    with _starting, deferred_interrupt():
        before = {name: os.environ.get(name) for name in _THREADS}
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
