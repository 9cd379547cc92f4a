"""Worker processes: one that is killed costs its task only; one that dies each time is named; none stays behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import CancelledError
from pathlib import Path
from typing import Any

import pytest

from hexmap.base.local_workers import LocalWorkers, WorkerDied, WorkerError
from tests.observing import PATIENCE, wait_until

HERE = str(Path(__file__).resolve().parents[2])


class Unreadable(Exception):
    def __init__(self, one: str, two: str) -> None:
        super().__init__(one)


def noted(folder: str, number: int, times: int = 0, code: int = 0) -> int:
    """Note that the task has begun, and end this process so many times before it returns."""
    note = Path(folder) / f"begun-{number}"
    with note.open("a") as file:
        file.write("x")
    if len(note.read_text()) <= times:
        if code:
            os._exit(code)
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def begun(folder: Path, number: int) -> int:
    return len((folder / f"begun-{number}").read_text())


def pid_of(seconds: float = 0.0) -> int:
    time.sleep(seconds)
    return os.getpid()


def odd(what: str) -> Any:
    if what == "unreadable":
        raise Unreadable("a", "b")
    if what == "exit":
        sys.exit(3)
    return lambda: what


@pytest.fixture(scope="module")
def workers() -> Iterator[LocalWorkers]:
    with LocalWorkers(2) as pool:
        yield pool


def test_a_worker_that_is_killed_costs_its_task_only(workers: LocalWorkers, tmp_path: Path) -> None:
    # Enough short tasks that some lie in the pipe of a worker when it dies.
    deaths = {7: 1, 30: 2, 90: 1}
    futures = [workers.submit(noted, str(tmp_path), k, deaths.get(k, 0)) for k in range(100)]
    assert [future.result(timeout=PATIENCE) for future in futures] == [k * k for k in range(100)]
    assert [begun(tmp_path, k) for k in range(100)] == [1 + deaths.get(k, 0) for k in range(100)]


def test_a_task_that_kills_its_worker_each_time_fails_alone(workers: LocalWorkers, tmp_path: Path) -> None:
    killed = workers.submit(noted, str(tmp_path), 1, 9)
    left = workers.submit(noted, str(tmp_path), 2, 9, 7)
    well = [workers.submit(noted, str(tmp_path), k) for k in range(3, 9)]
    with pytest.raises(WorkerDied, match=r"^the worker died, 3 times \(killed by signal 9\); if memory ran out, use"):
        killed.result(timeout=PATIENCE)
    # One that ends by itself would do so again.
    with pytest.raises(WorkerDied, match=r"^the worker died \(exit code 7\)$"):
        left.result(timeout=PATIENCE)
    assert begun(tmp_path, 1) == 3 and begun(tmp_path, 2) == 1
    assert [future.result(timeout=PATIENCE) for future in well] == [k * k for k in range(3, 9)]


def test_workers_killed_between_tasks_are_replaced(workers: LocalWorkers) -> None:
    for _ in range(4):
        os.kill(workers.submit(pid_of).result(timeout=PATIENCE), signal.SIGKILL)
    futures = [workers.submit(pid_of, 0.2) for _ in range(4)]
    assert len({future.result(timeout=PATIENCE) for future in futures}) == 2


def test_large_and_odd_tasks_and_results_pass_or_are_named(workers: LocalWorkers) -> None:
    megabyte = b"x" * (1 << 20)
    futures = [workers.submit(bytes.__add__, megabyte, b"%d" % k) for k in range(20)]
    assert all(future.result(timeout=PATIENCE) == megabyte + b"%d" % k for k, future in enumerate(futures))
    for what, words in (("unreadable", "cannot be read"), ("lambda", "pickle"), ("exit", "3")):
        with pytest.raises(BaseException, match=words):
            workers.submit(odd, what).result(timeout=PATIENCE)
    with pytest.raises(ZeroDivisionError) as caught:
        workers.submit(divmod, 1, 0).result(timeout=PATIENCE)
    assert "Traceback" in str(caught.value.__cause__)


def test_a_pool_that_is_stopped_leaves_nothing_open() -> None:
    with LocalWorkers(1) as pool:
        pid = pool.submit(pid_of).result(timeout=PATIENCE)
        busy = pool.submit(pid_of, 60.0)
        waiting = [pool.submit(pid_of) for _ in range(3)]
        wait_until(busy.running)
    assert all(future.done() for future in [busy, *waiting])
    with pytest.raises(WorkerError, match="have been stopped"):
        busy.result()
    with pytest.raises(CancelledError):
        waiting[0].result()
    with pytest.raises(WorkerError, match="have been stopped"):
        pool.submit(pid_of)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.parametrize(("end", "words"), [("os.kill(os.getpid(), 9)", "killed by signal 9"), ("1 / 0", "__main__")])
def test_workers_that_cannot_begin_end_the_run(tmp_path: Path, end: str, words: str) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import os\nfrom hexmap.base.local_workers import LocalWorkers\n"
        f"if __name__ != '__main__':\n    {end}\n"
        "pool = LocalWorkers(2)\n"
        "errors = {str(future.exception()) for future in [pool.submit(len, 'a') for _ in range(9)]}\n"
        "print(errors)\npool.stop()\n"
    )
    run = subprocess.run(
        [sys.executable, str(script)], env={**os.environ, "PYTHONPATH": HERE}, capture_output=True, text=True,
        timeout=PATIENCE, check=False,
    )  # fmt: skip
    # Where all have died before the last task was handed over, that is refused with the same words.
    assert "a worker died before it began" in run.stdout + run.stderr and words in run.stdout + run.stderr
