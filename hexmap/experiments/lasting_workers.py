"""Worker processes of this machine that are replaced when they die: a task that a worker died at begins again."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future
from pathlib import Path
from typing import Any, TypeVar

from hexmap.experiments.case import CaseError
from hexmap.experiments.local_workers import LocalWorkers

__all__ = ["LastingWorkers"]

T = TypeVar("T")
_TRIES = 2  # a worker that was killed says nothing of its task; two that died at it do


class LastingWorkers(Executor):
    """Pools of one worker each: where one dies, the others go on, and its task is begun again, once.

    Args:
        count: how many workers.
        folder: for the notes of :class:`LocalWorkers`.
    """

    def __init__(self, count: int, folder: Path) -> None:
        self._tasks: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._stopped = threading.Event()
        # One process is started at a time: what it inherits is set for that moment.
        self._starting = threading.Lock()
        self._pools: dict[int, LocalWorkers] = {}
        self._folder = folder
        self._threads = [threading.Thread(target=self._serve, args=(k,), daemon=True) for k in range(count)]
        for thread in self._threads:
            thread.start()

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Give a task to the next worker that is free."""
        if self._stopped.is_set():
            raise RuntimeError("the workers have been stopped")
        future: Future[T] = Future()
        self._tasks.put((future, fn, args, kwargs))
        return future

    def stop(self) -> None:
        """End all workers, those that are computing at once, and wait for them; tasks not yet begun are cancelled."""
        self._stopped.set()
        while not self._tasks.empty():
            self._tasks.get()[0].cancel()
        for _ in self._threads:
            self._tasks.put(None)
        with self._starting:
            pools = list(self._pools.values())
        for pool in pools:
            pool.stop()
        for thread in self._threads:
            thread.join(timeout=2.0)

    def _serve(self, number: int) -> None:
        while (task := self._tasks.get()) is not None:
            future, fn, args, kwargs = task
            if not future.set_running_or_notify_cancel():
                continue
            try:
                future.set_result(self._compute(number, fn, args, kwargs))
            except BaseException as error:
                future.set_exception(error)

    def _compute(self, number: int, fn: Callable[..., Any], args: Any, kwargs: Any) -> Any:
        for _ in range(_TRIES):
            with self._starting:
                if self._stopped.is_set():
                    break
                pool = self._pools.setdefault(number, LocalWorkers(1, self._folder))
                inner = pool.submit(fn, *args, **kwargs)
            try:
                return inner.result()
            except BrokenExecutor:
                if self._stopped.is_set():
                    break
                pool.stop()
                with self._starting:
                    self._pools.pop(number, None)
        else:
            raise CaseError(f"the worker died, {_TRIES} times; if memory ran out, use fewer workers")
        raise CaseError("the workers have been stopped")
