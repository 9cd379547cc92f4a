"""The any-angle optimum against a slow reference in fractions, its symmetries and bounds, and the benchmark's maps."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.grids.scenarios import read_scenario
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from planners import astar
from planners.any_angle.optimum import AnyAngleOptimum, OptimalPath
from planners.path import NoPath
from tests.lattices import EXAMPLES, JIT, PART

Map = NDArray[np.bool_]
Point = tuple[Fraction, Fraction]
HALF = Fraction(1, 2)


# ---------------------------------------------------------------------- the slow reference


def ref_cells(free: Map, point: Point) -> set[tuple[int, int]]:
    """Free cells whose closure holds the point."""
    sides = [{math.floor(v + HALF), math.ceil(v - HALF)} for v in point]
    inside = ((i, j) for i in sides[0] for j in sides[1] if 0 <= i < free.shape[0] and 0 <= j < free.shape[1])
    return {cell for cell in inside if free[cell]}


def ref_clear(free: Map, a: Point, b: Point) -> bool:
    """Whether the leg is allowed: cut at all edges' lines, its pieces touch free cells that edges join at the cuts."""
    cuts = {Fraction(0), Fraction(1)}
    for p, q in zip(a, b, strict=True):
        if p != q:
            lines = range(math.floor(min(p, q)) - 1, math.ceil(max(p, q)) + 2)
            cuts |= {t for t in ((m + HALF - p) / (q - p) for m in lines) if 0 < t < 1}
    ts = sorted(cuts)

    def at(t: Fraction) -> Point:
        return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])

    before: set[tuple[int, int]] | None = None
    for t, after in pairwise(ts):
        here = ref_cells(free, at((t + after) / 2))
        reach = here if before is None else set(before)
        around = ref_cells(free, at(t))
        for _ in range(3):
            reach = reach | {c for c in around for r in reach if abs(c[0] - r[0]) + abs(c[1] - r[1]) == 1}
        if not reach & here:
            return False
        before = here
    return True


def ref_lengths(free: Map, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths (P, P) between all ``points`` (P, 2): every corner of a blocked cell, every clear leg, Dijkstra."""
    framed = np.pad(free, 1)
    corners = [
        (Fraction(i) - HALF, Fraction(j) - HALF)
        for i in range(free.shape[0] + 1)
        for j in range(free.shape[1] + 1)
        if framed[i : i + 2, j : j + 2].sum() == 3
    ]
    nodes = corners + [(Fraction(float(x)), Fraction(float(y))) for x, y in points]
    n, m = len(corners), len(points)
    # Nobody goes on from a point that is no corner: legs lead from points to corners, never back.
    legs = np.full((n + m, n + m), np.inf)
    for i in range(n + m):
        for j in range(i):
            if ref_clear(free, nodes[i], nodes[j]):
                legs[i, j] = legs[j, i] = math.hypot(*(float(p - q) for p, q in zip(nodes[i], nodes[j], strict=True)))
    between = np.where(np.isinf(legs[:n, :n]), 0.0, legs[:n, :n])
    corner = dijkstra(csr_array(between), directed=False) if n else np.zeros((0, 0))
    out = legs[n:, n:].copy()
    if n:
        reached = (legs[n:, :n, None] + corner[None]).min(axis=1)
        out = np.minimum(out, (reached[:, None] + legs[None, n:, :n]).min(axis=2))
    np.fill_diagonal(out, 0.0)
    return out


def compare(free: Map, points: NDArray[np.float64]) -> None:
    want = ref_lengths(free, points)
    a, b = (v.ravel() for v in np.indices(want.shape))
    found = AnyAngleOptimum(free).lengths(points[a], points[b]).reshape(want.shape)
    note = f"free cells {free.astype(int).tolist()}, points {points.tolist()}"
    np.testing.assert_array_equal(np.isnan(found), np.isinf(want), err_msg=note)
    np.testing.assert_allclose(found, np.where(np.isinf(want), np.nan, want), rtol=1e-12, atol=1e-12, err_msg=note)


def some_points(free: Map, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Points of free cells: centres, corners and edges, dyadic and arbitrary ones, and a hair beside a corner."""
    cells = np.argwhere(free)
    out = cells[rng.integers(len(cells), size=count)].astype(float)
    for p in out:
        kind = rng.integers(6)
        if kind == 1:
            p += rng.choice([-0.5, 0.0, 0.5], 2)
        elif kind == 2:
            p += rng.uniform(-0.5, 0.5, 2)
        elif kind == 3:
            p += rng.integers(-8, 9, 2) / 16
        elif kind == 4:
            p += rng.choice([-0.5, 0.5], 2) * (1 - rng.choice([1e-15, 1e-12, 1e-9, 1e-6], 2))
    return out


def from_text(text: str) -> Map:
    """Return the map of rows of '.' and '#', x to the right, y down."""
    return np.array([[c == "." for c in row] for row in text.split()]).T


SPIRAL = from_text("""
    ...........
    .#########.
    .#.......#.
    .#.#####.#.
    .#.#...#.#.
    .#.#.#.#.#.
    .#.#.###.#.
    .#.#.....#.
    .#.#######.
    .#.........
    .##########""")
DOUBLE = from_text("""
    .....#...
    ....#....
    ...#...#.
    ..#...#..
    .#.......
    ....##...
    ..#.#..#.
    .#.....#.
    .........""")
COMB = from_text("""
    .........
    .#.#.#.#.
    .#.#.#.#.
    .#.#.#.#.
    .........
    #.#.#.#.#
    #.#.#.#.#
    .........""")
STEPS = from_text("""
    .........
    ..##.....
    ...##..#.
    ....##...
    .#...##..
    ......##.
    ..#....#.
    .........""")


@pytest.mark.parametrize("size, count", [(5, 120), (9, 60), (14, 4)])
def test_no_random_map_tells_it_from_the_reference(size: int, count: int) -> None:
    rng = np.random.default_rng(size)
    for _ in range(max(1, int(count * PART))):
        shape = rng.integers(max(1, size - 4), size + 1, 2)
        free = rng.random(shape) >= rng.uniform(0.0, 0.6)
        if free.any():
            compare(free, some_points(free, 7, rng))


@pytest.mark.parametrize("free", [SPIRAL, DOUBLE, COMB, STEPS], ids=["spiral", "double corners", "comb", "steps"])
def test_nor_does_a_made_one(free: Map) -> None:
    compare(free, some_points(free, 12, np.random.default_rng(3)))


@settings(max_examples=EXAMPLES, deadline=None)
@given(st.data())
def test_nor_does_any_point(data: st.DataObject) -> None:
    nx, ny = data.draw(st.tuples(st.integers(1, 5), st.integers(1, 5)))
    free = np.array(data.draw(st.lists(st.booleans(), min_size=nx * ny, max_size=nx * ny))).reshape(nx, ny)
    cells = np.argwhere(free)
    if len(cells) == 0:
        return
    inside = st.floats(-0.5, 0.5, allow_nan=False, allow_subnormal=False)
    picks = data.draw(st.lists(st.tuples(st.integers(0, len(cells) - 1), inside, inside), min_size=2, max_size=4))
    compare(free, np.array([cells[k] + (x, y) for k, x, y in picks]))


# ---------------------------------------------------------------------- what is allowed


def test_a_path_touches_corners_and_runs_along_walls() -> None:
    free = from_text("""
        .....
        ..#..
        .....""")
    path = AnyAngleOptimum(free).path([0, 1], [4, 1])
    assert path.points.tolist() in ([[0, 1], [1.5, y], [2.5, y], [4, 1]] for y in (0.5, 1.5))
    assert path.length == pytest.approx(1 + 2 * math.hypot(1.5, 0.5), abs=1e-15)
    assert AnyAngleOptimum(free).path([0, 0.5], [4, 0.5]).points.tolist() == [[0, 0.5], [4, 0.5]]
    # Between a corner on the left and a later one on the right there is no width, and the leg passes.
    upright = from_text("""
        ....
        .#..
        ....
        ..#.
        ....""")
    assert AnyAngleOptimum(upright).path([1.5, 0], [1.5, 4]).points.tolist() == [[1.5, 0], [1.5, 4]]
    slanting = from_text("""
        .#..
        ....
        ....
        ..#.""")
    assert AnyAngleOptimum(slanting).path([0, 0], [3, 3]).points.tolist() == [[0, 0], [3, 3]]


def test_a_leg_between_two_blocked_cells_or_across_a_double_corner_is_none() -> None:
    walls = from_text("""
        .##.
        .##.
        ....""")
    straight = AnyAngleOptimum(walls).path([0, 0.5], [3, 0.5])
    assert straight.length == pytest.approx(2 + 2 * math.hypot(0.5, 1.0))
    double = from_text("""
        .#
        #.""")
    optimum = AnyAngleOptimum(double)
    with pytest.raises(NoPath, match="not connected"):
        optimum.path([0, 0], [1, 1])
    # The point itself belongs to both of its cells.
    assert optimum.path([0.5, 0.5], [0, 0]).length == optimum.path([1, 1], [0.5, 0.5]).length == math.sqrt(0.5)
    # A path that could go through it goes round it.
    around = from_text("""
        ...
        .#.
        ..#""")
    path = AnyAngleOptimum(around).path([1, 2], [2, 1])
    assert path.points.tolist() == [[1, 2], [0.5, 1.5], [0.5, 0.5], [1.5, 0.5], [2, 1]]


def test_an_end_may_lie_on_a_wall_but_not_in_one() -> None:
    optimum = AnyAngleOptimum(from_text("..#"))
    assert optimum.path([-0.5, -0.5], [1.5, 0.5]).length == math.hypot(2.0, 1.0)
    cases: list[tuple[list[float], list[float], str]] = [
        ([2, 0], [0, 0], "start blocked"),
        ([0, 0], [1.6, 0], "goal blocked"),
        ([-0.6, 0], [0, 0], "start outside the map"),
        ([0, 0], [0, 7], "goal outside the map"),
    ]
    for start, goal, reason in cases:
        with pytest.raises(NoPath) as error:
            optimum.path(start, goal)
        assert error.value.reason == reason
    assert np.isnan(optimum.lengths([[2, 0], [0, 0]], [[0, 0], [9, 9]])).all()


def test_a_point_a_hair_beside_a_double_corner_is_on_its_own_side() -> None:
    optimum = AnyAngleOptimum(np.eye(2, dtype=bool))
    beside = np.nextafter(0.5, 1.0)
    assert optimum.path([beside, beside], [1, 1]).length < 1
    with pytest.raises(NoPath, match="not connected"):
        optimum.path([beside, beside], [0, 0])


@pytest.mark.parametrize(
    "free", [np.ones((2, 2), int), np.ones(4, bool), np.ones((0, 3), bool), np.ones((2, 2, 2), bool)]
)
def test_what_is_no_map_is_an_error(free: NDArray[np.generic]) -> None:
    with pytest.raises(ArgumentError, match="a map must be bool"):
        AnyAngleOptimum(free)


def test_bad_arguments_are_errors() -> None:
    optimum = AnyAngleOptimum(np.ones((3, 3), bool))
    with pytest.raises(ArgumentError, match="start must be a point"):
        optimum.path([0, 0, 0], [1, 1])
    with pytest.raises(BoundsError, match="goal must be finite"):
        optimum.path([0, 0], [1, math.nan])
    with pytest.raises(ArgumentError, match="same shape"):
        optimum.lengths([[0, 0]], [[1, 1], [2, 2]])
    with pytest.raises(ArgumentError, match="at least one worker, not 0"):
        optimum.lengths([[0, 0]], [[1, 1]], workers=0)
    assert optimum.lengths(np.empty((0, 2)), np.empty((0, 2))).shape == (0,)


# ---------------------------------------------------------------------- what must hold on any map


def medium(seed: int, blocked: float, size: int = 40) -> tuple[Map, NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    free = rng.random((size, size + 5)) >= blocked
    return free, some_points(free, int(60 * PART) + 2, rng), some_points(free, int(60 * PART) + 2, rng)


@pytest.mark.parametrize("blocked", [0.03, 0.2, 0.35])
def test_a_result_is_what_it_says(blocked: float) -> None:
    free, starts, goals = medium(5, blocked)
    optimum = AnyAngleOptimum(free)
    lengths = optimum.lengths(starts, goals)
    assert np.isfinite(lengths).any()
    corners = np.pad(free, 1)
    for start, goal, length in zip(starts, goals, lengths, strict=True):
        if np.isnan(length):
            continue
        path = optimum.path(start, goal)
        assert isinstance(path, OptimalPath)
        assert path.length == length == math.fsum(np.hypot(*np.diff(path.points, axis=0).T))
        assert (path.points[0] == start).all() and (path.points[-1] == goal).all()
        assert path.expansions >= 1 and path.seconds >= 0.0 and len(path) == len(path.points)
        for turn in path.points[1:-1]:
            i, j = (turn + 0.5).astype(int)
            assert corners[i : i + 2, j : j + 2].sum() == 3
        exact = [(Fraction(float(x)), Fraction(float(y))) for x, y in path.points]
        # From a point that is no short binary fraction the first leg may brush a corner by a rounding error.
        for a, b in pairwise(exact[1:-1]):
            assert ref_clear(free, a, b)


@pytest.mark.parametrize("blocked", [0.1, 0.3])
def test_neither_turning_the_map_nor_swapping_the_ends_changes_a_length(blocked: float) -> None:
    free, starts, goals = medium(6, blocked)
    want = AnyAngleOptimum(free).lengths(starts, goals)
    np.testing.assert_allclose(AnyAngleOptimum(free).lengths(goals, starts), want, rtol=1e-13)
    last = np.array(free.shape) - 1
    for flips in range(4):
        turned, a, b = free, starts, goals
        for axis in range(2):
            if flips >> axis & 1:
                turned = np.flip(turned, axis)
                sign = np.where(np.arange(2) == axis, -1.0, 1.0)
                shift = np.where(np.arange(2) == axis, last, 0)
                a, b = shift + sign * a, shift + sign * b
        np.testing.assert_allclose(AnyAngleOptimum(turned).lengths(a, b), want, rtol=1e-12)
        np.testing.assert_allclose(AnyAngleOptimum(turned.T).lengths(a[:, ::-1], b[:, ::-1]), want, rtol=1e-12)


def test_threads_change_nothing() -> None:
    free, starts, goals = medium(7, 0.25)
    optimum = AnyAngleOptimum(free)
    np.testing.assert_array_equal(optimum.lengths(starts, goals), optimum.lengths(starts, goals, workers=3))
    again = AnyAngleOptimum(free)
    np.testing.assert_array_equal(optimum.lengths(starts, goals), again.lengths(starts, goals))


def test_no_detour_is_shorter() -> None:
    free, starts, goals = medium(8, 0.25)
    optimum = AnyAngleOptimum(free)
    middle = np.roll(goals, 1, axis=0)
    # A double corner joins what no path may join, so a detour over one proves nothing.
    on_corner = (np.abs(middle % 1.0 - 0.5) < 1e-9).all(axis=1)
    direct, detour = optimum.lengths(starts, goals), optimum.lengths(starts, middle) + optimum.lengths(middle, goals)
    assert not (direct > detour + 1e-11)[~on_corner].any()


def octile(free: Map, start: NDArray[np.int64], goal: NDArray[np.int64], times: int) -> float:
    """Length over the 8 neighbours of cells ``times`` as fine, an odd number, in cells of the map."""
    fine = np.repeat(np.repeat(free, times, axis=0), times, axis=1)
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], fine, neighbourhood="extended")
    return astar(graph, start * times + times // 2, goal * times + times // 2).length / times


@pytest.mark.parametrize("blocked", [0.1, 0.3])
def test_it_lies_between_the_straight_line_and_the_octile_path_of_any_resolution(blocked: float) -> None:
    rng = np.random.default_rng(9)
    free = rng.random((20, 24)) >= blocked
    cells = np.argwhere(free)
    optimum = AnyAngleOptimum(free)
    for _ in range(max(2, int(20 * PART))):
        start, goal = cells[rng.integers(len(cells), size=2)]
        try:
            length = optimum.path(start, goal).length
        except NoPath:
            with pytest.raises(NoPath, match="not connected"):
                octile(free, start, goal, 1)
            continue
        assert length >= math.hypot(*(goal - start)) * (1 - 1e-15)
        assert all(octile(free, start, goal, times) >= length * (1 - 1e-12) for times in (1, 3, 7))


# ---------------------------------------------------------------------- the benchmark's maps

MAPS = ["arena", "den520d", "AR0011SR"]
if JIT:
    MAPS += ["brc202d", "Berlin_0_512", "random512-25-0", "maze512-8-0"]


@pytest.mark.data
@pytest.mark.parametrize("name", MAPS)
def test_published_octile_lengths_are_no_shorter_and_little_longer(data_dir: Path, name: str) -> None:
    folder = data_dir / "planning" / "movingai"
    optimum = AnyAngleOptimum(open_grid(folder / f"{name}.map").states == CellState.FREE)
    scenario = read_scenario(folder / f"{name}.map.scen")
    count = len(scenario.lengths)
    tried = count if name == "arena" and PART >= 1 else max(5, int(50 * PART))
    chosen = np.sort(np.random.default_rng(1).permutation(count)[:tried])
    starts, goals, published = scenario.starts[chosen], scenario.goals[chosen], scenario.lengths[chosen]
    lengths = optimum.lengths(starts, goals)
    # Some are published with two digits behind the point.
    assert (lengths <= published + 0.01).all()
    assert (lengths >= np.hypot(*(goals - starts).T) * (1 - 1e-15)).all()
    far = lengths > 0
    # A diagonal step past a corner is forbidden to the octile path, so single blocked cells cost it most.
    assert 1.0 <= (published[far] / lengths[far]).mean() < (1.15 if name.startswith("random") else 1.085)
