"""The planning benchmark: squares against hexagons, cubes against FCC and BCC, on maps other people published.

First the ruler: on the source cells themselves, with all neighbours and without corner cutting, every
problem that is run must have the published length. Then the same queries on the same world,
rasterised by cell centre onto each lattice at equal cell size, at a half and a quarter of the source cell,
the map turned by several angles, because real worlds are aligned to nobody's grid. Lengths are
taken from the query's own start point to its own goal point and compared with the true
any-angle optimum on the source map (in space: with the best path that anything found).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.experiments.run_cases import run_cases
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.lattice import Lattice
from planners.benchmark.cases import grid_case, open_case, optimum_case, ruler_case
from planners.benchmark.course import Course, open_course
from planners.benchmark.results import Results
from planners.benchmark.settings import BenchmarkSettings

__all__ = ["run_benchmark"]

Progress = Callable[[int, int], None]
_CHUNK = 50  # queries a case: what an interruption can cost
_OPEN_RADIUS = {2: 200.0, 3: 40.0}  # cells, of the check in free space
_OPEN_DIRECTIONS = 4000


def _shared(course: Course, settings: BenchmarkSettings, reach: float) -> dict[str, Any]:
    world = course.world
    return {
        "states": world.states,
        "cell": world.cell,
        "origin": np.asarray(world.origin, dtype=np.float64),
        "yaw": world.yaw,
        "starts": course.starts,
        "goals": course.goals,
        "bases": [grid.make().basis.tolist() for grid in settings.grids(world.dim)],
        "reach": reach,
        "max_cells": settings.max_cells,
    }


def _window(world: GridMap, lattice: Lattice) -> int:
    """Return about how many cells the window of a lattice around a world has."""
    n = world.dim
    corners = np.array([[(world.low, world.high)[(c >> i) & 1][i] for i in range(n)] for c in range(2**n)])
    u = corners @ np.linalg.inv(lattice.basis).T
    return math.prod(int(s) + 5 for s in np.ptp(u, axis=0))


def run_benchmark(
    maps: Sequence[Path],
    settings: BenchmarkSettings,
    *,
    folder: Path | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Results:
    """Compute all cases; arguments and errors are those of :func:`planning_benchmark`."""
    if not maps:
        raise ArgumentError("the benchmark needs at least one map")
    names = [path.name for path in maps]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"two maps are called {name}")
    courses = [open_course(path, settings) for path in maps]
    plans = [_plan(course, settings) for course in courses]
    dims = sorted({course.world.dim for course in courses})
    opens = [
        {"lattice": k, "moves": grid.moves, "dim": dim, "radius": _OPEN_RADIUS[dim], "directions": _OPEN_DIRECTIONS}
        for dim in dims
        for k, grid in enumerate(settings.grids(dim))
    ]
    total = len(opens) + sum(len(cases) for plan in plans for _, cases in plan.work)
    done = 0

    def run(function: Any, cases: list[dict[str, Any]], shared: dict[str, Any]) -> list[dict[str, Any]]:
        nonlocal done
        before = done
        report = None if progress is None else lambda now, _: progress(before + now, total)
        found = run_cases(
            function, cases, shared=shared, folder=folder, workers=workers, seed=settings.seed, progress=report
        )
        done += len(cases)
        return found

    ruler: list[tuple[list[float | None], list[Any]]] = []
    optimum: list[NDArray[np.float64] | None] = []
    optimum_seconds: list[NDArray[np.float64] | None] = []
    runs: list[tuple[dict[str, Any], dict[str, Any]]] = []
    left_out: list[str] = []
    for course, plan in zip(courses, plans, strict=True):
        shared = _shared(course, settings, plan.reach)
        left_out += plan.left_out
        found = {name: run(function, cases, shared) for (name, function), cases in plan.work}
        ruler.append(
            (
                [c for part in found["ruler"] for c in part["cost"]],
                [c for part in found["ruler"] for c in part["steps"]],
            )
        )
        if "optimum" in found:
            optimum.append(_numbers(part["length"] for part in found["optimum"]))
            optimum_seconds.append(_numbers(part["seconds"] for part in found["optimum"]))
        else:
            optimum.append(None)
            optimum_seconds.append(None)
        runs += _joined(course, plan, found["grid"])
    free_space = []
    for dim in dims:
        cases = [case for case in opens if case["dim"] == dim]
        bases = [grid.make().basis.tolist() for grid in settings.grids(dim)]
        for case, result in zip(cases, run(open_case, cases, {"bases": bases}), strict=True):
            free_space.append({**case, **result})
    return Results(settings, courses, ruler, optimum, optimum_seconds, runs, left_out, free_space)


def _numbers(parts: Any) -> NDArray[np.float64]:
    return np.array([math.nan if v is None else v for part in parts for v in part], dtype=np.float64)


@dataclass(frozen=True, eq=False)
class _Plan:
    work: list[tuple[tuple[str, Any], list[dict[str, Any]]]]
    reach: float
    left_out: list[str]


def _plan(course: Course, settings: BenchmarkSettings) -> _Plan:
    """Return the cases of a map."""
    world, n = course.world, course.world.dim
    grids = settings.grids(n)
    count = len(course.starts)
    chunks = [(a, min(a + _CHUNK, count)) for a in range(0, count, _CHUNK)]
    reach = max(float(np.linalg.norm(g.make().centres(g.make().nearest[:1])[0])) for g in grids) / math.sqrt(2)
    left_out: list[str] = []
    cases: list[dict[str, Any]] = []
    # On cells of the source's own size for the time only: at that size lattices leak.
    for fraction, angles in [(1, (0.0,)), *((f, settings.angles) for f in settings.fractions)]:
        lattices = [grid.make().scaled(world.cell / fraction) for grid in grids]
        size, label = max(
            (_window(world.turned(math.radians(degrees)), lattice), grid.label)
            for degrees in angles
            for lattice, grid in zip(lattices, grids, strict=True)
        )
        # All grids or none: a mean over fewer maps could not be compared.
        if size > settings.max_cells:
            left_out.append(f"{course.name} at 1/{fraction} of its cell's edge: up to {size:,} cells on {label}")
            continue
        for degrees in angles:
            for k, grid in enumerate(grids):
                names = list(settings.planners) if degrees == angles[0] else ["astar"]
                names += ["any_angle"] if grid.any_angle else []
                base = {"lattice": k, "moves": grid.moves, "fraction": fraction, "degrees": degrees, "planners": names}
                cases += [{**base, "first": a, "last": b} for a, b in chunks]
    parts = [{"first": a, "last": b} for a, b in chunks]
    work: list[tuple[tuple[str, Any], list[dict[str, Any]]]] = [(("ruler", ruler_case), parts)]
    if n == 2:
        work.append((("optimum", optimum_case), parts))
    work.append((("grid", grid_case), cases))
    return _Plan(work, reach, left_out)


def _joined(course: Course, plan: _Plan, found: list[dict[str, Any]]) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Put the chunks of each case together."""
    cases = plan.work[-1][1]
    out: dict[tuple[Any, ...], tuple[dict[str, Any], dict[str, Any]]] = {}
    for case, result in zip(cases, found, strict=True):
        key = (case["lattice"], case["moves"], case["fraction"], case["degrees"])
        if key not in out:
            head = {"map": course.name, "dim": course.world.dim, **{k: v for k, v in case.items() if k != "planners"}}
            out[key] = (head, {**result, "answers": {name: list(rows) for name, rows in result["answers"].items()}})
        else:
            for name, rows in result["answers"].items():
                out[key][1]["answers"][name] += rows
    return list(out.values())


