"""What the sections of the benchmark's report share: words, and which groups they show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

from hexmap.base.arrays import FloatArray
from hexmap.experiments.statistics import Interval
from planners.benchmark.result_group import ResultGroup

__all__ = ["IntervalOf", "compared_sizes", "length_groups", "optimum_word", "share_word", "size_word"]

# The mean of values (Q,) with its confidence interval, or alone where there are too few for one.
IntervalOf: TypeAlias = Callable[[FloatArray], Interval | float]


def optimum_word(dim: int) -> str:
    """Return what lengths are compared with."""
    return "any-angle optimum" if dim == 2 else "best path found"


def share_word(fraction: int) -> str:
    """Return a cell size as a share of the source cell's edge; with a word, as a spreadsheet takes 1/2 for a date."""
    return f"edge 1/{fraction}"


def size_word(dim: int, fraction: int) -> str:
    """Return a cell size in words."""
    size = f"1/{fraction**dim} of its {'area' if dim == 2 else 'volume'}"
    return f"1/{fraction} of the source cell's edge (cells of {size}, whatever their shape)"


def length_groups(groups: Sequence[ResultGroup], dim: int, fraction: int) -> list[ResultGroup]:
    """Return the groups whose lengths are shown: each grid once, and its any-angle paths."""
    return [x for x in groups if x.dim == dim and x.fraction == fraction and x.planner in ("astar", "any_angle")]


def compared_sizes(groups: Sequence[ResultGroup]) -> list[tuple[int, int]]:
    """Return the dimensions and fractions at which lengths are compared."""
    return sorted({(x.dim, x.fraction) for x in groups if x.fraction > 1})
