"""The planning benchmark: squares against hexagons, cubes against FCC and BCC, on maps other people published.

First the baseline check: on the source cells themselves, with all neighbours and without corner cutting, every
problem that is run must have the published length. Then the same queries on the same map,
rasterised by cell centre onto each lattice at equal cell size, at a half and a quarter of the source cell,
the map turned by several angles, because real buildings are aligned to nobody's grid. Lengths are
taken from the query's own start point to its own goal point and compared with the true
any-angle optimum on the source map (in space: with the best path that anything found).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.local_workers import LocalWorkers
from hexmap.experiments.run_cases import run_cases
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.lattice import Lattice
from planners.benchmark import source_map
from planners.benchmark.cases import baseline_case, grid_case, open_case, optimum_case
from planners.benchmark.problem_set import ProblemSet, open_problem_set
from planners.benchmark.results import Answer, Baseline, FreeSpace, GridRun, Optimum, Results
from planners.benchmark.settings import BenchmarkSettings, Grid

__all__ = ["run_benchmark"]

Progress = Callable[[int, int], None]
Case: TypeAlias = dict[str, Any]
Runner: TypeAlias = Callable[[Any, list[Case], dict[str, Any]], list[dict[str, Any]]]
_CHUNK = 50  # queries a case: what an interruption can cost
_OPEN_RADIUS = {2: 200.0, 3: 40.0}  # cells, of the check in free space
_OPEN_DIRECTIONS = 4000


def run_benchmark(
    maps: Sequence[Path],
    settings: BenchmarkSettings,
    *,
    folder: Path | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Results:
    """Compute all cases; arguments and errors are those of :func:`planning_benchmark`."""
    if not maps:
        raise ArgumentError("the benchmark needs at least one map")
    if executor is None and workers > 1:
        # They last over all maps and stages: each has to load the kernels of all planners once.
        with LocalWorkers(workers) as pool:
            return run_benchmark(maps, settings, folder=folder, executor=pool, progress=progress)
    names = [path.name for path in maps]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"two maps are called {name}")
    problem_sets = [open_problem_set(path, settings) for path in maps]
    plans = [_plan(problems, settings) for problems in problem_sets]
    dims = sorted({problems.grid_map.dim for problems in problem_sets})
    open_cases = {dim: _open_cases(dim, settings) for dim in dims}
    total = sum(len(cases) for cases in open_cases.values()) + sum(plan.size for plan in plans)
    # What finished cases depend on besides the file of their function.
    helpers = [Path(source_map.__file__), Path(source_map.__file__).with_name("_source_map_kernels.py")]
    code = b"".join(path.read_bytes() for path in helpers)
    fingerprint = hashlib.blake2b(code, digest_size=20).hexdigest()
    done = 0

    def run(function: Any, cases: list[Case], shared: dict[str, Any]) -> list[dict[str, Any]]:
        nonlocal done
        before = done
        report = None if progress is None else lambda now, _: progress(before + now, total)
        found = run_cases(
            function, cases, shared=shared, folder=folder, workers=workers, executor=executor, seed=settings.seed,
            progress=report, fingerprint=fingerprint,
        )  # fmt: skip
        done += len(cases)
        return found

    baselines: list[Baseline] = []
    optima: list[Optimum | None] = []
    runs: list[GridRun] = []
    for number, (problems, plan) in enumerate(zip(problem_sets, plans, strict=True)):
        shared = _shared(problems, settings, plan.reach)
        baselines.append(_run_baseline(plan, run, shared))
        optima.append(_run_optimum(plan, run, shared) if problems.grid_map.dim == 2 else None)
        # The small cells come last and take longest: begun first, no worker is left alone with one of them at the end.
        found = run(grid_case, plan.grid_cases[::-1], shared)[::-1]
        runs += _joined(number, problems.grid_map.dim, plan.grid_cases, found)
    free_space: list[FreeSpace] = []
    for dim, cases in open_cases.items():
        bases = [grid.make().basis.tolist() for grid in settings.grids(dim)]
        for case, result in zip(cases, run(open_case, cases, {"bases": bases}), strict=True):
            about = {name: case[name] for name in ("dim", "lattice", "radius", "directions")}
            free_space.append(FreeSpace(**about, **result))
    left_out = [text for plan in plans for text in plan.left_out]
    return Results(settings, problem_sets, baselines, optima, runs, left_out, free_space)


# ---------------------------------------------------------------------- what is to be computed


@dataclass(frozen=True, eq=False)
class _Plan:
    """The cases of a map.

    Attributes:
        chunks: queries that are answered together.
        grid_cases: for every grid, angle and cell size, and every chunk.
        reach: around pinches what is closed, in cells of the grids.
        left_out: sentences on what is too large.
    """

    chunks: list[Case]
    grid_cases: list[Case]
    reach: float
    left_out: list[str]
    planar: bool

    @property
    def size(self) -> int:
        """Number of cases."""
        return len(self.chunks) * (2 if self.planar else 1) + len(self.grid_cases)


def _plan(problems: ProblemSet, settings: BenchmarkSettings) -> _Plan:
    """Return the cases of a map."""
    grid_map = problems.grid_map
    grids = settings.grids(grid_map.dim)
    count = len(problems.starts)
    chunks: list[Case] = [{"first": a, "last": min(a + _CHUNK, count)} for a in range(0, count, _CHUNK)]
    reach = max(float(np.linalg.norm(g.make().centres(g.make().nearest[:1])[0])) for g in grids) / math.sqrt(2)
    left_out: list[str] = []
    cases: list[Case] = []
    # On cells of the source's own size for the time only: at that size lattices leak.
    for fraction, angles in [(1, (0.0,)), *((f, settings.angles) for f in settings.fractions)]:
        size, label = _largest_window(grid_map, grids, fraction, angles)
        # All grids or none: a mean over fewer maps could not be compared.
        if size > settings.max_cells:
            left_out.append(f"{problems.name} at 1/{fraction} of its cell's edge: up to {size:,} cells on {label}")
            continue
        for degrees in angles:
            for k, grid in enumerate(grids):
                names = list(settings.planners) if degrees == angles[0] else ["astar"]
                names += ["any_angle"] if grid.any_angle else []
                base = {"lattice": k, "moves": grid.moves, "fraction": fraction, "degrees": degrees, "planners": names}
                cases += [{**base, **chunk} for chunk in chunks]
    return _Plan(chunks, cases, reach, left_out, grid_map.dim == 2)


def _largest_window(
    grid_map: GridMap, grids: Sequence[Grid], fraction: int, angles: Sequence[float]
) -> tuple[int, str]:
    """Return about how many cells the largest window has, and on which grid."""
    lattices = [grid.make().scaled(grid_map.cell / fraction) for grid in grids]
    return max(
        (_window(grid_map.turned(math.radians(degrees)), lattice), grid.label)
        for degrees in angles
        for lattice, grid in zip(lattices, grids, strict=True)
    )


def _window(grid_map: GridMap, lattice: Lattice) -> int:
    """Return about how many cells the window of a lattice around a map has."""
    n = grid_map.dim
    corners = np.array([[(grid_map.low, grid_map.high)[(c >> i) & 1][i] for i in range(n)] for c in range(2**n)])
    u = corners @ np.linalg.inv(lattice.basis).T
    return math.prod(int(s) + 5 for s in np.ptp(u, axis=0))


def _open_cases(dim: int, settings: BenchmarkSettings) -> list[Case]:
    """Return the cases of the check in free space."""
    return [
        {"lattice": k, "moves": grid.moves, "dim": dim, "radius": _OPEN_RADIUS[dim], "directions": _OPEN_DIRECTIONS}
        for k, grid in enumerate(settings.grids(dim))
    ]


def _shared(problems: ProblemSet, settings: BenchmarkSettings, reach: float) -> dict[str, Any]:
    """Return what all cases of a map are given."""
    grid_map = problems.grid_map
    return {
        "states": grid_map.states,
        "cell": grid_map.cell,
        "origin": np.asarray(grid_map.origin, dtype=np.float64),
        "yaw": grid_map.yaw,
        "starts": problems.starts,
        "goals": problems.goals,
        "bases": [grid.make().basis.tolist() for grid in settings.grids(grid_map.dim)],
        "reach": reach,
        "max_cells": settings.max_cells,
    }


# ---------------------------------------------------------------------- what was found, put together


def _run_baseline(plan: _Plan, run: Runner, shared: dict[str, Any]) -> Baseline:
    found = run(baseline_case, plan.chunks, shared)
    return Baseline([c for chunk in found for c in chunk["cost"]], [s for chunk in found for s in chunk["steps"]])


def _run_optimum(plan: _Plan, run: Runner, shared: dict[str, Any]) -> Optimum:
    found = run(optimum_case, plan.chunks, shared)
    return Optimum(_numbers(chunk["length"] for chunk in found), _numbers(chunk["seconds"] for chunk in found))


def _numbers(chunks: Iterable[list[float | None]]) -> NDArray[np.float64]:
    return np.array([math.nan if v is None else v for chunk in chunks for v in chunk], dtype=np.float64)


def _joined(number: int, dim: int, cases: list[Case], found: list[dict[str, Any]]) -> list[GridRun]:
    """Put the chunks of each grid, angle and cell size together; ``number`` is that of the map."""
    runs: dict[tuple[Any, ...], GridRun] = {}
    for case, result in zip(cases, found, strict=True):
        key = (case["lattice"], case["fraction"], case["degrees"])
        if key not in runs:
            runs[key] = GridRun(
                number, dim, *key, {name: [] for name in result["answers"]},
                result["window"], result["free"], result["bytes"],
            )  # fmt: skip
        for name, rows in result["answers"].items():
            runs[key].answers[name] += [None if row is None else Answer(**row) for row in rows]
    return list(runs.values())
