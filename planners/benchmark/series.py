"""What the planning benchmark compares: the ruler, the queries that count, and a value a query and grid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from planners.benchmark.course import publishers_roots
from planners.benchmark.results import Results
from planners.benchmark.settings import Grid


@dataclass(frozen=True, eq=False)
class Series:
    """One way of planning on one grid: a value a kept query, the mean over the angles.

    Attributes:
        dim, fraction: which part of the benchmark it belongs to.
        grid: the lattice and neighbourhood.
        planner: what answered.
        values: name -> (Q,), queries of all maps one after the other.
        maps: (Q,) number of the map of each.
        by_angle: degrees -> (Q,) length over the optimum.
        megabytes: of the graph, the mean over maps and angles.
        bytes_a_cell: of the graph, a free cell.
    """

    dim: int
    fraction: int
    grid: Grid
    planner: str
    values: dict[str, FloatArray]
    maps: NDArray[np.int64]
    by_angle: dict[float, FloatArray]
    megabytes: float
    bytes_a_cell: float

    @property
    def label(self) -> str:
        """Such as A2-6, or A2-6 any-angle."""
        return self.grid.label + (" any-angle" if self.planner == "any_angle" else "")


@dataclass(frozen=True, eq=False)
class RulerRow:
    """What became of one published problem."""

    map: str
    problem: int
    published: str
    ours: float
    equal: bool


def ruler_rows(results: Results) -> tuple[list[RulerRow], dict[str, str]]:
    """Compare every length on the source cells with the published one; with which roots, by map."""
    rows, roots = [], {}
    for course, (costs, steps) in zip(results.courses, results.ruler, strict=True):
        if not course.texts:
            continue
        roots[course.name], equal = publishers_roots(steps, course.texts, course.style)
        for k, text in enumerate(course.texts):
            cost = costs[k]
            ours = math.nan if cost is None else cost
            rows.append(RulerRow(course.name, int(course.problem[k]), text, ours, bool(equal[k])))
    return rows, roots


def kept_queries(results: Results) -> list[NDArray[np.bool_]]:
    """Tell for each map which queries stay connected on every grid, at every angle and cell size."""
    kept = []
    for i, course in enumerate(results.courses):
        good = np.ones(len(course.starts), np.bool_)
        known = results.optimum[i]
        if known is not None:
            good &= np.isfinite(known)
        for head, result in results.runs:
            if head["map"] == course.name and head["fraction"] > 1:
                for rows in result["answers"].values():
                    good &= np.array([row is not None for row in rows])
        # From a point to itself there is no ratio.
        good &= (course.starts != course.goals).any(axis=1)
        kept.append(good)
    return kept


def optima(results: Results) -> list[FloatArray]:
    """Return for each map the lengths (Q,) that others are measured by: the optimum, or the best found."""
    out = []
    for i, course in enumerate(results.courses):
        known = results.optimum[i]
        if known is not None:
            out.append(known)
            continue
        best = np.full(len(course.starts), np.inf)
        for head, result in results.runs:
            if head["map"] == course.name and head["fraction"] > 1:
                for rows in result["answers"].values():
                    best = np.minimum(best, [math.inf if row is None else row["length"] for row in rows])
        out.append(best)
    return out


_KEYS = ("turning", "clearance", "mean_clearance", "expansions", "pushes", "scanned", "seconds")


def collect(results: Results, kept: list[NDArray[np.bool_]], best: list[FloatArray]) -> list[Series]:
    """Put the runs together by grid, cell size and planner."""
    number = {course.name: i for i, course in enumerate(results.courses)}
    # On cells of the source's own size: what is connected on every grid.
    own_size = [np.ones(len(course.starts), np.bool_) for course in results.courses]
    for head, result in results.runs:
        if head["fraction"] == 1:
            for rows in result["answers"].values():
                own_size[number[head["map"]]] &= np.array([row is not None for row in rows])
    groups: dict[tuple[int, int, int, str], list[tuple[int, float, list[Any], dict[str, Any]]]] = {}
    for head, result in results.runs:
        for planner, rows in result["answers"].items():
            key = (head["dim"], head["fraction"], head["lattice"], planner)
            groups.setdefault(key, []).append((number[head["map"]], head["degrees"], rows, result))
    out = []
    for (dim, fraction, k, planner), runs in groups.items():
        grid = results.settings.grids(dim)[k]
        values: dict[str, list[FloatArray]] = {name: [] for name in ("ratio", "optimum", *_KEYS)}
        maps: list[NDArray[np.int64]] = []
        angles: dict[float, list[FloatArray]] = {}
        for i in sorted({run[0] for run in runs}):
            mine = [run for run in runs if run[0] == i]
            course, use = results.courses[i], np.flatnonzero(kept[i])
            if fraction == 1:  # at that size some way may be closed; it counts for the time only
                use = use[own_size[i][use]]
            if len(use) == 0:
                continue
            unit = course.world.cell
            scale = {"clearance": 1 / unit, "mean_clearance": 1 / unit, "seconds": 1e3, "turning": 180 / math.pi}
            table = {
                name: np.array([[run[2][q][name] for q in use] for run in mine]) * scale.get(name, 1.0)
                for name in _KEYS
            }
            lengths = np.array([[run[2][q]["length"] for q in use] for run in mine])
            ratio = lengths / best[i][use]
            values["ratio"].append(ratio.mean(axis=0))
            values["optimum"].append(best[i][use] / unit)
            for name in _KEYS:
                values[name].append(table[name].mean(axis=0))
            for run, row in zip(mine, ratio, strict=True):
                angles.setdefault(run[1], []).append(row)
            maps.append(np.full(len(use), i))
        if not maps:
            continue
        size = float(np.mean([run[3]["bytes"] for run in runs])) / 1e6
        world = float(np.mean([run[3]["bytes"] / max(run[3]["free"], 1) for run in runs]))
        out.append(
            Series(
                dim, fraction, grid, planner, {name: np.concatenate(v) for name, v in values.items()},
                np.concatenate(maps), {a: np.concatenate(v) for a, v in angles.items()}, size, world,
            )
        )  # fmt: skip
    return out
