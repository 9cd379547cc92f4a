"""The problem sets of the planning benchmark: maps, with published or random queries on them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.io.grids.grid_map import GridMap
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.grids.scenarios import read_scenario
from hexmap.maps.cell_state import CellState
from planners.benchmark.settings import BenchmarkSettings


@dataclass(frozen=True, eq=False)
class ProblemSet:
    """A map and the problems to solve on it.

    Attributes:
        name: of the file.
        grid_map: the map.
        starts: (Q, n) source cells.
        goals: (Q, n) source cells.
        texts: published lengths as they stand in the file; empty where there are none.
        problem: (Q,) the number of each in its file.
        style: how the publisher printed: decimals, or significant digits.
    """

    name: str
    grid_map: GridMap
    starts: NDArray[np.int64]
    goals: NDArray[np.int64]
    texts: tuple[str, ...]
    problem: NDArray[np.int64]
    style: tuple[str, int]

    __repr__ = one_line


def open_problem_set(path: Path, settings: BenchmarkSettings) -> ProblemSet:
    """Read a map and draw its queries: from the problems beside it, or at random where there are none.

    Raises:
        FormatError: a file is not what it should be.
        ArgumentError: the map has no two connected free cells.
    """
    grid_map = open_grid(path)
    beside = scenario_beside(path)
    if beside is None:
        starts, goals = random_queries(grid_map.states, settings.queries, settings.seed)
        if len(starts) == 0:
            raise ArgumentError(f"{path}: no two free cells are connected")
        return ProblemSet(path.name, grid_map, starts, goals, (), np.arange(len(starts)), ("f", 0))
    scenario = read_scenario(beside)
    scenario.check(grid_map)
    rng = np.random.default_rng([settings.seed, len(scenario.lengths)])
    useful = np.flatnonzero((scenario.starts != scenario.goals).any(axis=1))
    chosen = useful
    if len(useful) > settings.queries:
        chosen = np.sort(rng.choice(useful, settings.queries, replace=False))
    if len(chosen) == 0:
        raise ArgumentError(f"{beside}: has no problem whose start is not its goal")
    texts = tuple(scenario.texts[int(k)] for k in chosen)
    style = print_style([scenario.texts[int(k)] for k in useful])
    return ProblemSet(path.name, grid_map, scenario.starts[chosen], scenario.goals[chosen], texts, chosen, style)


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


# Lengths on the source cells are whole numbers of steps times these: published ones were added up with
# roots of few digits, and which ones shows in every problem of a file.
ROOTS = {
    "exact roots": (1.0, 2.0**0.5, 3.0**0.5),
    "roots of 9 decimals": (1.0, 1.414213562, 1.732050808),
    "roots in single precision": (1.0, float(np.float32(2.0**0.5)), float(np.float32(3.0**0.5))),
}


def free_cells(problems: ProblemSet) -> int:
    """Return how many source cells are free."""
    return int((problems.grid_map.states == CellState.FREE).sum())


def largest_component(states: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the source cells (M, n) of the largest component of free cells, connected by faces."""
    from scipy.ndimage import label

    labels, count = label(states == CellState.FREE)
    if count == 0:
        return np.empty((0, states.ndim), np.int64)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.argwhere(labels == int(sizes.argmax()))


def random_queries(states: NDArray[np.uint8], count: int, seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return seeded random starts and goals (count, n) in the largest component of free cells."""
    cells = largest_component(states)
    if len(cells) < 2:
        return np.empty((0, states.ndim), np.int64), np.empty((0, states.ndim), np.int64)
    rng = np.random.default_rng([seed, 7])
    first = rng.integers(0, len(cells), count)
    second = (first + rng.integers(1, len(cells), count)) % len(cells)
    return cells[first], cells[second]
