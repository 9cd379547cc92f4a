"""What the planning benchmark compares: the baseline check, the queries that count, a value a query and grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from planners.benchmark.problem_set import publishers_roots
from planners.benchmark.results import GridRun, Results
from planners.benchmark.settings import Grid


@dataclass(frozen=True, eq=False)
class ResultGroup:
    """One way of planning on one grid: a value a kept query, the mean over the angles.

    Attributes:
        dim, fraction: which comparison of the benchmark it belongs to.
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

    __repr__ = one_line

    @property
    def label(self) -> str:
        """Such as A2-6, or A2-6 any-angle."""
        return self.grid.label + (" any-angle" if self.planner == "any_angle" else "")


@dataclass(frozen=True, eq=False)
class BaselineRow:
    """What became of one published problem."""

    map: str
    problem: int
    published: str
    ours: float
    equal: bool


def baseline_rows(results: Results) -> tuple[list[BaselineRow], dict[str, str]]:
    """Compare every length on the source cells with the published one; with which roots, by map."""
    rows, roots = [], {}
    for problems, baseline in zip(results.problem_sets, results.baselines, strict=True):
        if not problems.texts:
            continue
        roots[problems.name], equal = publishers_roots(baseline.steps, problems.texts, problems.style)
        for k, text in enumerate(problems.texts):
            cost = baseline.costs[k]
            ours = math.nan if cost is None else cost
            rows.append(BaselineRow(problems.name, int(problems.problem[k]), text, ours, bool(equal[k])))
    return rows, roots


def kept_queries(results: Results) -> list[NDArray[np.bool_]]:
    """Tell for each map which queries stay connected on every grid, at every angle and cell size."""
    kept = []
    for i, problems in enumerate(results.problem_sets):
        good = np.ones(len(problems.starts), np.bool_)
        optimum = results.optima[i]
        if optimum is not None:
            good &= np.isfinite(optimum.lengths)
        for run in results.runs:
            if run.map == i and run.fraction > 1:
                good &= _answered(run)
        # From a point to itself there is no ratio.
        good &= (problems.starts != problems.goals).any(axis=1)
        kept.append(good)
    return kept


def _answered(run: GridRun) -> NDArray[np.bool_]:
    """Tell which queries (Q,) every planner found a path for."""
    found = np.array([[answer is not None for answer in answers] for answers in run.answers.values()])
    return np.asarray(found.all(axis=0))


def reference_lengths(results: Results) -> list[FloatArray]:
    """Return for each map the lengths (Q,) that others are measured by: the optimum, or the best found."""
    out = []
    for i, problems in enumerate(results.problem_sets):
        optimum = results.optima[i]
        if optimum is not None:
            out.append(optimum.lengths)
            continue
        best = np.full(len(problems.starts), np.inf)
        for run in results.runs:
            if run.map == i and run.fraction > 1:
                for answers in run.answers.values():
                    best = np.minimum(best, [math.inf if a is None else a.length for a in answers])
        out.append(best)
    return out


# ---------------------------------------------------------------------- the groups


# What a group has of each query besides its length: fields of an answer.
_MEASURES = ("turning", "clearance", "mean_clearance", "expansions", "pushes", "scanned", "seconds")


def _unit(measure: str, cell: float) -> float:
    """Return what a field of an answer is multiplied by for the report; ``cell`` is the source cell's edge, metres."""
    if measure in ("clearance", "mean_clearance"):
        return 1 / cell  # source cells
    return {"turning": 180 / math.pi, "seconds": 1e3}.get(measure, 1.0)  # degrees, milliseconds


@dataclass(frozen=True, eq=False)
class _MapValues:
    """What one map adds to a group: values (Q,) by name, and ratios (Q,) by angle."""

    values: dict[str, FloatArray]
    by_angle: dict[float, FloatArray]


def collect(results: Results, kept: list[NDArray[np.bool_]], best: list[FloatArray]) -> list[ResultGroup]:
    """Put the runs together by grid, cell size and planner."""
    # On cells of the source's own size: what is connected on every grid.
    own_size = [np.ones(len(problems.starts), np.bool_) for problems in results.problem_sets]
    for run in results.runs:
        if run.fraction == 1:
            own_size[run.map] &= _answered(run)
    groups: dict[tuple[int, int, int, str], list[GridRun]] = {}
    for run in results.runs:
        for planner in run.answers:
            groups.setdefault((run.dim, run.fraction, run.lattice, planner), []).append(run)
    out = []
    for (dim, fraction, lattice, planner), runs in groups.items():
        found: dict[int, _MapValues] = {}
        for i in sorted({run.map for run in runs}):
            use = np.flatnonzero(kept[i])
            if fraction == 1:  # at that size some passage may be closed; it counts for the time only
                use = use[own_size[i][use]]
            if len(use) > 0:
                cell = results.problem_sets[i].grid_map.cell
                found[i] = _values_of_map([run for run in runs if run.map == i], planner, use, best[i][use], cell)
        if found:
            out.append(_group(dim, fraction, results.settings.grids(dim)[lattice], planner, found, runs))
    return out


def _values_of_map(
    runs: list[GridRun], planner: str, use: NDArray[np.int64], best: FloatArray, cell: float
) -> _MapValues:
    """Return the values of the queries ``use`` (Q,) of one map, whose shortest lengths are ``best`` (Q,)."""

    def table(name: str) -> FloatArray:
        return np.array([[getattr(run.answers[planner][q], name) for q in use] for run in runs])

    ratio = table("length") / best
    values = {"ratio": ratio.mean(axis=0), "optimum": best / cell}
    for name in _MEASURES:
        values[name] = (table(name) * _unit(name, cell)).mean(axis=0)
    return _MapValues(values, {run.degrees: row for run, row in zip(runs, ratio, strict=True)})


def _group(
    dim: int, fraction: int, grid: Grid, planner: str, found: dict[int, _MapValues], runs: list[GridRun]
) -> ResultGroup:
    """Put the values of all maps, by their numbers, one after the other."""
    of_maps = list(found.values())
    by_angle: dict[float, list[FloatArray]] = {}
    for one in of_maps:
        for degrees, ratio in one.by_angle.items():
            by_angle.setdefault(degrees, []).append(ratio)
    return ResultGroup(
        dim=dim,
        fraction=fraction,
        grid=grid,
        planner=planner,
        values={name: np.concatenate([one.values[name] for one in of_maps]) for name in of_maps[0].values},
        maps=np.concatenate([np.full(len(one.values["ratio"]), i) for i, one in found.items()]),
        by_angle={degrees: np.concatenate(rows) for degrees, rows in by_angle.items()},
        megabytes=float(np.mean([run.memory for run in runs])) / 1e6,
        bytes_a_cell=float(np.mean([run.memory / max(run.free, 1) for run in runs])),
    )
