"""What the planning benchmark measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexmap.base.values import one_line
from planners.benchmark.problem_set import ProblemSet
from planners.benchmark.settings import BenchmarkSettings


@dataclass(frozen=True)
class Answer:
    """One planner's path for one query.

    Attributes:
        length: from the query's start point to its goal point, metres.
        cost: of the path between the centres of its cells, metres.
        turning: radians.
        clearance: least distance to the nearest blocked source cell, metres.
        mean_clearance: the mean along the path, metres.
        expansions, pushes, scanned, seconds: those of :class:`planners.path.Path`.
    """

    length: float
    cost: float
    turning: float
    clearance: float
    mean_clearance: float
    expansions: int
    pushes: int
    scanned: int
    seconds: float


@dataclass(frozen=True, eq=False)
class GridRun:
    """All queries of a map on one grid, at one angle and cell size.

    Attributes:
        map: number of the problem set.
        dim: of the map.
        lattice: number of the grid in the settings.
        fraction: of the source cell's edge: 2 for half of it.
        degrees: by which the map is turned.
        answers: planner -> an answer a query, None where there is no path.
        window: cells of the graph's window.
        free: how many of them are free.
        memory: of the graph, bytes.
    """

    map: int
    dim: int
    lattice: int
    fraction: int
    degrees: float
    answers: dict[str, list[Answer | None]]
    window: int
    free: int
    memory: int

    __repr__ = one_line


@dataclass(frozen=True, eq=False)
class Baseline:
    """The answers on the source cells of a map, which the published lengths are compared with.

    Attributes:
        costs: (Q,) lengths in source cells, None where there is no path.
        steps: (Q,) how many steps go along 1, 2 (and 3) axes.
    """

    costs: list[float | None]
    steps: list[list[int] | None]

    __repr__ = one_line


@dataclass(frozen=True, eq=False)
class Optimum:
    """The true any-angle optimum on a planar map.

    Attributes:
        lengths: (Q,) metres, nan where there is no path.
        seconds: (Q,) what finding each took.
    """

    lengths: NDArray[np.float64]
    seconds: NDArray[np.float64]

    __repr__ = one_line


@dataclass(frozen=True)
class FreeSpace:
    """Lengths by the moves of a grid over straight ones, in an empty window.

    Attributes:
        dim: of the grid.
        lattice: number of the grid in the settings.
        radius: to which was measured, cells.
        directions: how many.
        mean, worst, sd: of the ratio over the directions.
    """

    dim: int
    lattice: int
    radius: float
    directions: int
    mean: float
    worst: float
    sd: float


@dataclass(frozen=True, eq=False)
class Results:
    """All that was measured.

    Attributes:
        settings: what was asked for.
        problem_sets: the maps and their queries.
        baselines: one a map.
        optima: one a map, None in space.
        runs: one a map, grid, angle and cell size.
        left_out: sentences on what was too large.
        free_space: one a grid.
    """

    settings: BenchmarkSettings
    problem_sets: list[ProblemSet]
    baselines: list[Baseline]
    optima: list[Optimum | None]
    runs: list[GridRun]
    left_out: list[str]
    free_space: list[FreeSpace]

    __repr__ = one_line
