"""How long something takes, live: for the columns of a report that are costs."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

__all__ = ["median_seconds"]


def median_seconds(function: Callable[[], object], repeats: int = 7) -> float:
    """Return the median seconds of ``function``, after one run that is not counted."""
    function()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        function()
        times.append(time.perf_counter() - begin)
    return float(np.median(times))
