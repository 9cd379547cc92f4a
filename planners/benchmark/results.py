"""What the planning benchmark measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planners.benchmark.course import Course
from planners.benchmark.settings import BenchmarkSettings


@dataclass(frozen=True, eq=False)
class Results:
    """All that was measured; a row of ``runs`` is a map, a grid, an angle and a fraction.

    Attributes:
        settings: what was asked for.
        courses: the maps.
        ruler: for each map the costs (Q,) in source cells and the steps by kind.
        optimum: for each planar map the optimal lengths (Q,), metres, nan where there is none.
        optimum_seconds: what finding each took.
        runs: case -> its result, queries put together.
        left_out: sentences on what was too large.
        open: rows of the check in free space.
    """

    settings: BenchmarkSettings
    courses: list[Course]
    ruler: list[tuple[list[float | None], list[Any]]]
    optimum: list[NDArray[np.float64] | None]
    optimum_seconds: list[NDArray[np.float64] | None]
    runs: list[tuple[dict[str, Any], dict[str, Any]]]
    left_out: list[str]
    open: list[dict[str, Any]]
