"""What a test asserts in place of a time: that something happens at all, and how many calls a function makes.

A clock says more about the machine than about the code, and a suite that shares its cores with others must not fail
for it. Speed is measured in ``tests/benchmarks``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

Value = TypeVar("Value")
PATIENCE = 120.0  # seconds, far beyond what anything here takes; only so that a hanging test ends


def wait_until(condition: Callable[[], Value]) -> Value:
    """Return the first true value of ``condition``."""
    end = time.monotonic() + PATIENCE
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError("what the test waits for has not happened")
        time.sleep(0.01)
    return value


def children(pid: int) -> set[int]:
    """Return the processes that a process has started and that are still there."""
    found = set()
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.add(int(entry.parent.name))
    return found


def count_calls(function: Callable[..., Value], *arguments: Any) -> tuple[Value, int]:
    """Return what ``function`` returns, and how many calls of Python and C functions it makes on the way."""
    calls = 0

    def note(_frame: object, event: str, _argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        value = function(*arguments)
    finally:
        sys.setprofile(before)
    return value, calls
