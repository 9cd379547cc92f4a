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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexmap.errors import ArgumentError
from hexmap.experiments.runner import run_cases
from hexmap.lattice import Lattice
from hexmap.worlds import FREE, GridWorld, open_world, read_scenario
from planners._benchmark_cases import grid_case, open_case, optimum_case, random_queries, ruler_case

if TYPE_CHECKING:
    from planners._benchmark_report import Outcome

__all__ = ["GRIDS", "BenchmarkSettings", "Grid", "planning_benchmark", "run_benchmark"]

Progress = Callable[[int, int], None]
_CHUNK = 50  # queries a case: what an interruption can cost
LEAST_QUERIES = 8  # an interval over fewer says nothing
MOST_DROPPED = 0.02  # part of the queries; more says that the grids are too coarse for the map
_OPEN_RADIUS = {2: 200.0, 3: 40.0}  # cells, of the check in free space
_OPEN_DIRECTIONS = 4000


# Lengths on the source cells are whole numbers of steps times these: published ones were added up with
# roots of few digits, and which ones shows in every problem of a file.
ROOTS = {
    "exact roots": (1.0, 2.0**0.5, 3.0**0.5),
    "roots of 9 decimals": (1.0, 1.414213562, 1.732050808),
    "roots in single precision": (1.0, float(np.float32(2.0**0.5)), float(np.float32(3.0**0.5))),
}


@dataclass(frozen=True)
class Grid:
    """A lattice with a neighbourhood, and the planners to run on it.

    Attributes:
        lattice: a name, or a basis (columns are generators, in any unit).
        moves: size of the neighbourhood.
        any_angle: whether any-angle paths are sought on it too.
    """

    lattice: str | tuple[tuple[float, ...], ...]
    moves: int
    any_angle: bool = False

    def make(self) -> Lattice:
        """Return the lattice, scaled to cells of size 1."""
        made = Lattice.named(self.lattice) if isinstance(self.lattice, str) else Lattice(np.array(self.lattice), "own")
        return made.scaled(1.0 / made.resolution)

    @property
    def label(self) -> str:
        """Such as A2-6."""
        return f"{self.lattice if isinstance(self.lattice, str) else 'own'}-{self.moves}"


GRIDS = {
    2: (Grid("Z2", 4), Grid("Z2", 8, True), Grid("A2", 6, True), Grid("A2", 12)),
    3: (
        Grid("Z3", 6),
        Grid("Z3", 26, True),
        Grid("D3", 12),
        Grid("D3", 18, True),
        Grid("D3*", 8),
        Grid("D3*", 14, True),
    ),
}


@dataclass(frozen=True)
class BenchmarkSettings:
    """What the benchmark does.

    Attributes:
        queries: a map; drawn from its problems, or all of them if it has fewer.
        angles: degrees by which the maps are turned.
        fractions: 2 for grids whose resolution is a half of the source cell's edge, and so on.
        max_cells: of a window; what would be larger is left out, and said.
        seed: chooses queries and resamples.
        planners: on every grid; ``any_angle`` is added where a grid asks for it.
        planar: the grids in the plane.
        spatial: the grids in space.
    """

    queries: int = 200
    angles: tuple[float, ...] = (0.0, 17.0, 31.0)
    fractions: tuple[int, ...] = (2, 4)
    max_cells: int = 300_000_000
    seed: int = 0
    planners: tuple[str, ...] = ("astar", "canonical")
    planar: tuple[Grid, ...] = GRIDS[2]
    spatial: tuple[Grid, ...] = GRIDS[3]

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.queries < LEAST_QUERIES:
            raise ArgumentError(f"an interval needs {LEAST_QUERIES} queries a map at the least, not {self.queries}")
        if not self.angles or not all(math.isfinite(a) for a in self.angles):
            raise ArgumentError(f"angles must be numbers of degrees, not {self.angles}")
        if len(set(self.angles)) < len(self.angles):
            raise ArgumentError(f"an angle is given twice: {self.angles}")
        if not self.fractions or any(isinstance(f, bool) or f < 2 for f in self.fractions):
            raise ArgumentError(
                f"cells must measure a half of the source cell's edge or less, not 1/{min(self.fractions, default=0)}"
            )
        if len(set(self.fractions)) < len(self.fractions):
            raise ArgumentError(f"a fraction is given twice: {self.fractions}")
        for grids in (self.planar, self.spatial):
            if len({grid.label for grid in grids}) < len(grids):
                raise ArgumentError(f"a grid is given twice: {', '.join(grid.label for grid in grids)}")
        if self.seed < 0:
            raise ArgumentError(f"the seed must be 0 or larger, not {self.seed}")
        if self.max_cells < 1:
            raise ArgumentError(f"a window needs room for a cell, not for {self.max_cells}")

    def grids(self, dim: int) -> tuple[Grid, ...]:
        """Return the grids of a dimension."""
        return self.planar if dim == 2 else self.spatial


@dataclass(frozen=True, eq=False)
class Course:
    """A map and the queries on it.

    Attributes:
        name: of the file.
        world: the map.
        starts: (Q, n) source cells.
        goals: (Q, n) source cells.
        texts: published lengths as they stand in the file; empty where there are none.
        problem: (Q,) the number of each in its file.
        style: how the publisher printed: decimals, or significant digits.
    """

    name: str
    world: GridWorld
    starts: NDArray[np.int64]
    goals: NDArray[np.int64]
    texts: tuple[str, ...]
    problem: NDArray[np.int64]
    style: tuple[str, int]


def scenario_beside(path: Path) -> Path | None:
    """Return the file of problems beside a map, None if there is none."""
    stem = path.name.removesuffix(".gz")
    for suffix in (".scen", ".3dscen", ".scen.gz", ".3dscen.gz"):
        there = path.with_name(stem + suffix)
        if there.is_file():
            return there
    return None


def print_style(texts: Sequence[str]) -> tuple[str, int]:
    """Return how lengths were printed: ("f", decimals), or ("g", significant digits) where decimals vary."""
    decimals = {len(t.partition(".")[2]) for t in texts}
    if len(decimals) == 1:
        return "f", decimals.pop()
    return "g", max(len(t.replace(".", "").lstrip("0")) for t in texts)


def same_to_the_digits(length: float, text: str, style: tuple[str, int]) -> bool:
    """Tell whether a length is what the publisher printed, to the last digit printed."""
    return format(length, f".{style[1]}{style[0]}") == (
        text if style[0] == "f" else format(float(text), f".{style[1]}g")
    )


def publishers_roots(
    steps: Sequence[Sequence[int] | None], texts: Sequence[str], style: tuple[str, int]
) -> tuple[str, NDArray[np.bool_]]:
    """Find with which roots of two and three the lengths of a file were added up.

    Args:
        steps: of each of our paths, how many steps go along 1, 2 (and 3) axes; None where there is no path.
        texts: published lengths.
        style: how they were printed.

    Returns:
        The key of :data:`ROOTS` with the most equal lengths (the first of those), and which (Q,) are equal.
    """
    best, equal = "", np.zeros(len(texts), np.bool_)
    for name, roots in ROOTS.items():
        now = np.array(
            [
                s is not None
                and same_to_the_digits(math.fsum(n * r for n, r in zip(s, roots, strict=False)), text, style)
                for s, text in zip(steps, texts, strict=True)
            ],
            np.bool_,
        )
        if not best or now.sum() > equal.sum():
            best, equal = name, now
    return best, equal


def open_course(path: Path, settings: BenchmarkSettings) -> Course:
    """Read a map and draw its queries: from the problems beside it, or at random where there are none.

    Raises:
        FormatError: a file is not what it should be.
        ArgumentError: the map has no two connected free cells.
    """
    world = open_world(path)
    beside = scenario_beside(path)
    if beside is None:
        starts, goals = random_queries(world.states, settings.queries, settings.seed)
        if len(starts) == 0:
            raise ArgumentError(f"{path}: no two free cells are connected")
        return Course(path.name, world, starts, goals, (), np.arange(len(starts)), ("f", 0))
    scenario = read_scenario(beside)
    scenario.check(world)
    rng = np.random.default_rng([settings.seed, len(scenario.lengths)])
    useful = np.flatnonzero((scenario.starts != scenario.goals).any(axis=1))
    chosen = useful
    if len(useful) > settings.queries:
        chosen = np.sort(rng.choice(useful, settings.queries, replace=False))
    if len(chosen) == 0:
        raise ArgumentError(f"{beside}: has no problem whose start is not its goal")
    texts = tuple(scenario.texts[int(k)] for k in chosen)
    style = print_style([scenario.texts[int(k)] for k in useful])
    return Course(path.name, world, scenario.starts[chosen], scenario.goals[chosen], texts, chosen, style)


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


def _window(world: GridWorld, lattice: Lattice) -> int:
    """Return about how many cells the window of a lattice around a world has."""
    n = world.dim
    corners = np.array([[(world.low, world.high)[(c >> i) & 1][i] for i in range(n)] for c in range(2**n)])
    u = corners @ np.linalg.inv(lattice.basis).T
    return math.prod(int(s) + 5 for s in np.ptp(u, axis=0))


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


def planning_benchmark(
    maps: Sequence[Path],
    settings: BenchmarkSettings | None = None,
    *,
    command: str = "",
    folder: Path | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Outcome:
    """Run the benchmark on maps and return its report, and whether the ruler is straight.

    Args:
        maps: files that :func:`hexmap.worlds.open_world` reads, with their problems beside them.
        settings: what to do.
        command: the command line, for the report.
        folder: where finished cases are kept; an interrupted run goes on from there.
        workers: processes; the numbers do not depend on it, times aside.
        progress: called with the cases done and their number.

    Raises:
        ArgumentError: no map, or two of the same name.
        FormatError: a file is not what it should be.
    """
    from planners._benchmark_report import make_report

    settings = settings or BenchmarkSettings()
    return make_report(run_benchmark(maps, settings, folder=folder, workers=workers, progress=progress), command)


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


def free_cells(course: Course) -> int:
    """Return how many source cells are free."""
    return int((course.world.states == FREE).sum())


def settings_table(settings: BenchmarkSettings) -> dict[str, Any]:
    """Return the settings as plain values."""
    plain = asdict(settings)
    for key in ("planar", "spatial"):
        plain[key] = [grid.label for grid in getattr(settings, key)]
    return plain
