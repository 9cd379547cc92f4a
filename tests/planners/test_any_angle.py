"""Any-angle paths: the line of sight against slow references on every lattice, and what a path promises."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from pathlib import Path as FilePath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_cdt

from hexmap.base.errors import ArgumentError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.graph.moves import swept_cells
from hexmap.lattice.lattice import Lattice
from planners import NoPath, Path, astar
from planners.any_angle import _kernels as kernels
from planners.any_angle import _theta_kernels as theta
from planners.any_angle import _wedge_kernels as wedges
from planners.any_angle.theta_star import any_angle, line_of_sight, make_view, search_path, touched_cells
from tests.lattices import CASES, EXAMPLES, JIT, PART, SHEARED, Case
from tests.planners import hard
from tests.planners.test_planners import NEIGHBOURHOODS, random_graph, read_movingai

EVERY = CASES + SHEARED
CELLS = list(itertools.product(CASES, NEIGHBOURHOODS))
IDS = [f"{case}-{nb}" for case, nb in CELLS]
Cells = set[tuple[int, ...]]


def free_window(case: Case, side: int) -> LatticeGraph:
    return LatticeGraph.from_states(case.lattice, [0] * case.dim, np.ones([side] * case.dim, np.uint8))


def by_kernel(graph: LatticeGraph, v: list[int]) -> Cells:
    """The cells touched from the middle of a free window along the displacement ``v``, less the middle."""
    middle = graph.first + graph.inner_shape // 2
    a, b = graph.index_to_flat(np.array([middle, middle + v])).tolist()
    return {tuple(c) for c in (graph.flat_to_index(touched_cells(graph, a, b)) - middle).tolist()}


def by_closed_cells(case: Case, v: list[int]) -> Cells:
    """The same by the corner rule's slow function: all cells of the bounding box, one after the other."""
    return {(0,) * case.dim, tuple(v), *map(tuple, swept_cells(case.lattice, v).tolist())}


def by_fractions(case: Case, displacement: list[int]) -> Cells:
    """The same in exact numbers, with the Gram matrix that the tests wrote down.

    A point t v lies in the closed cell of c where it is no nearer to any other cell: only cells around
    the line can be, so that those of a box are tried on either side.
    """
    n, G = case.dim, case.gram
    v = np.array(displacement, dtype=object)
    faces = case.lattice.faces.astype(object)
    out: Cells = set()
    reach = 2
    box = [range(min(0, w) - reach, max(0, w) + reach + 1) for w in displacement]
    for cell in itertools.product(*box):
        c = np.array(cell, dtype=object)
        low, high = Fraction(0), Fraction(1)
        for f in faces:
            # t (v G f) <= f G f / 2 + c G f
            rate, room = v @ G @ f, Fraction(f @ G @ f) / 2 + c @ G @ f
            if rate > 0:
                high = min(high, room / rate)
            elif rate < 0:
                low = max(low, room / rate)
            elif room < 0:
                high = Fraction(-1)
        if low <= high:
            out.add(cell)
    assert n == len(displacement)
    return out


@pytest.mark.parametrize("case", EVERY, ids=str)
def test_touched_cells_are_those_of_the_corner_rule(case: Case) -> None:
    near, far = ((5, 30) if case.dim == 2 else (2, 10)) if JIT else (1, 5)
    graph = free_window(case, 2 * far + 40)
    displacements = [list(w) for w in itertools.product(range(-near, near + 1), repeat=case.dim) if any(w)]
    rng = np.random.default_rng(3)
    displacements += [w for w in rng.integers(-far, far, (int(40 * PART), case.dim), endpoint=True).tolist() if any(w)]
    for v in displacements:
        assert by_kernel(graph, v) == by_closed_cells(case, v), v


@pytest.mark.parametrize("case", [c for c in CASES if c.integer_gram is not None], ids=str)
def test_touched_cells_are_exact(case: Case) -> None:
    graph = free_window(case, 40)
    size = 9 if case.dim == 2 else 3
    rng = np.random.default_rng(4)
    for v in rng.integers(-size, size, (int(20 * PART) + 2, case.dim), endpoint=True).tolist():
        if not any(v):
            continue
        assert by_kernel(graph, v) == by_fractions(case, v), v


@pytest.mark.parametrize("case", CASES, ids=str)
def test_long_lines_are_chains_of_short_ones(case: Case) -> None:
    # A short displacement, many times, touches what that touches, moved along: no rounding error adds up.
    times = 500 if JIT else 50
    short = [3, -2, 1][: case.dim]
    times = times if case.dim == 2 else 30
    shape = np.abs(short) * times + 9
    graph = LatticeGraph.from_states(case.lattice, [0] * case.dim, np.ones(shape.tolist(), np.uint8))
    start = np.where(np.array(short) > 0, 4, shape - 5)
    a, b = graph.index_to_flat(np.array([start, start + times * np.array(short)])).tolist()
    found = touched_cells(graph, a, b)
    one = graph.flat_to_index(touched_cells(graph, a, a + int(np.array(short) @ graph.strides))) - start
    expected = (np.arange(times)[:, None, None] * np.array(short) + one + start).reshape(-1, case.dim)
    assert len(np.unique(found)) == len(found)
    assert np.unique(found).tolist() == np.unique(graph.index_to_flat(expected)).tolist()


@pytest.mark.parametrize("case", EVERY, ids=str)
@settings(max_examples=EXAMPLES // 3, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_line_of_sight_needs_every_touched_cell(case: Case, seed: int) -> None:
    rng = np.random.default_rng(seed)
    graph = random_graph(case, None, seed, 0.1, side=24 if case.dim == 2 else 10)
    ends = rng.integers(-1, graph.inner_shape, (40, 2, case.dim), endpoint=True) + graph.first
    seen = line_of_sight(graph, ends[:, 0], ends[:, 1])
    assert isinstance(seen, np.ndarray) and seen.dtype == np.bool_
    for (a, b), sight in zip(ends, seen, strict=True):
        cells = np.array([a, *(a + swept_cells(case.lattice, b - a)), b])
        flat = graph.index_to_flat(cells)
        assert sight == bool(((flat >= 0) & (graph.free[np.maximum(flat, 0)] != 0)).all())
        assert line_of_sight(graph, a, b) is bool(sight)
        assert line_of_sight(graph, b, a) is bool(sight)
    one_by_one = [bool(line_of_sight(graph, ends[0, 0], b)) for b in ends[:, 1]]
    assert np.array_equal(line_of_sight(graph, ends[0, 0], ends[:, 1]), one_by_one)


@pytest.mark.parametrize("case", EVERY, ids=str)
def test_looking_at_blocks_of_free_cells_changes_nothing(case: Case) -> None:
    side = (120 if case.dim == 2 else 50) if JIT else 14
    shape = [side + 3, side, side + 1][: case.dim]
    states = np.ones(shape, np.uint8)
    rng = np.random.default_rng(5)
    states[tuple(rng.integers(0, shape, (20, case.dim)).T)] = 0
    graph = LatticeGraph.from_states(case.lattice, [0] * case.dim, states)
    view = make_view(graph)
    pairs = rng.integers(0, shape, (2, int(3000 * PART), case.dim)) + graph.pad
    inside = np.ones(pairs.shape[1], np.bool_)
    found, looks = [], []
    distances = kernels.block_distances(view, graph.free)
    for known in (np.empty(0, np.uint8), distances):
        out = np.zeros(len(inside), np.bool_)
        looks.append(kernels.sights(view, graph.free, known, pairs[0], pairs[1], inside, out))
        found.append(out)
    assert found[0].any() and not found[0].all()
    assert (found[0] == found[1]).all()
    assert not JIT or looks[1] < looks[0]
    # How far each block is from the nearest that is not all free, by the slow way.
    wide = [-(-int(s) // 4) for s in graph.shape]
    blocked = np.zeros(wide, bool)
    blocked[tuple(np.argwhere(graph.free.reshape(graph.shape) == 0).T // 4)] = True
    expected = distance_transform_cdt(np.pad(~blocked, 1), metric="chessboard")[(slice(1, -1),) * case.dim]
    assert (distances.reshape(wide) == expected).all()


def test_lines_that_touch_a_blocked_cell_are_not_free() -> None:
    states = np.ones((5, 5), np.uint8)
    states[2, 2] = 0
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], states)
    assert not line_of_sight(graph, [1, 2], [2, 1])  # through its corner
    assert not line_of_sight(graph, [0, 1], [3, 4])  # the same, longer
    assert line_of_sight(graph, [1, 0], [1, 4])
    states = np.ones((4, 4), np.uint8)
    states[1, 1] = states[2, 2] = 0
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], states)
    assert not line_of_sight(graph, [1, 2], [2, 1])  # between two that meet in a corner
    # On hexagons, along the edge that two cells share: from their one common neighbour to the other.
    for blocked in ([0, 1], [1, 0]):
        states = np.ones((4, 4), np.uint8)
        states[1 + blocked[0], 1 + blocked[1]] = 0
        graph = LatticeGraph.from_states(Lattice.named("A2"), [-1, -1], states)
        assert not line_of_sight(graph, [0, 0], [1, 1])
    # Outside the map nothing is free.
    assert not line_of_sight(graph, [0, 0], [0, 9])


def test_line_of_sight_takes_cells() -> None:
    graph = free_window(CASES[0], 5)
    for a, b in (([0.0, 1.0], [1, 1]), ([0, 0, 0], [1, 1]), ([[0, 0]] * 2, [[0, 0]] * 3), (3, [0, 0])):
        with pytest.raises(ArgumentError):
            line_of_sight(graph, a, b)
    assert np.shape(line_of_sight(graph, np.empty((0, 2), int), [0, 0])) == (0,)


# ---------------------------------------------------------------------- paths


def check_any_angle(graph: LatticeGraph, path: Path, start: np.ndarray, goal: np.ndarray) -> None:
    """Hold a path to what it promises, its lines by the slow reference."""
    assert path.cells.dtype == np.int32 and path.points.dtype == np.float64
    assert (path.cells[0] == start).all() and (path.cells[-1] == goal).all()
    np.testing.assert_allclose(path.points, graph.lattice.centres(path.cells))
    assert path.cost == path.length
    assert path.length == pytest.approx(np.linalg.norm(np.diff(path.points, axis=0), axis=1).sum(), rel=1e-12)
    assert path.length >= np.linalg.norm(path.points[-1] - path.points[0]) * (1 - 1e-12)
    for a, b in itertools.pairwise(path.cells.astype(np.int64)):
        cells = np.array([a, *(a + swept_cells(graph.lattice, b - a)), b])
        flat = graph.index_to_flat(cells)
        assert (flat >= 0).all() and graph.free[flat].all()


@pytest.mark.parametrize(("case", "neighbourhood"), CELLS, ids=IDS)
@settings(max_examples=max(EXAMPLES // 5, 2), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), obstacles=st.sampled_from([0.0, 0.1, 0.25, 0.4]))
def test_paths_are_free_and_no_longer_than_those_of_astar(
    case: Case, neighbourhood: str | None, seed: int, obstacles: float
) -> None:
    graph = random_graph(case, neighbourhood, seed, obstacles, side=20 if case.dim == 2 else 8)
    free = np.flatnonzero(graph.free)
    if len(free) == 0:
        return
    start, goal = graph.flat_to_index(np.random.default_rng(seed).choice(free, 2))
    try:
        least = astar(graph, start, goal).length
    except NoPath as error:
        for lazy in (True, False):
            with pytest.raises(NoPath) as found:
                any_angle(graph, start, goal, lazy=lazy)
            assert str(found.value) == str(error)
        graph.components()
        with pytest.raises(NoPath) as found:
            any_angle(graph, start, goal)
        assert str(found.value) == str(error)
        return
    for lazy, tighten in itertools.product((True, False), repeat=2):
        path = any_angle(graph, start, goal, lazy=lazy, tighten=tighten)
        check_any_angle(graph, path, start, goal)
        assert path.length <= least * (1 + 1e-9)
        again = any_angle(graph, start, goal, lazy=lazy, tighten=tighten)
        assert again.cells.tolist() == path.cells.tolist() and again.scanned == path.scanned
    if line_of_sight(graph, start, goal):
        straight = np.linalg.norm(graph.lattice.centres(np.array([goal - start]))[0])
        assert any_angle(graph, start, goal).length == pytest.approx(straight, rel=1e-12, abs=1e-15)


def test_start_is_goal_and_errors() -> None:
    graph = free_window(CASES[0], 5)
    path = any_angle(graph, [2, 2], [2, 2])
    assert len(path) == 1 and path.length == 0.0 and path.cost == 0.0
    with pytest.raises(NoPath, match="outside"):
        any_angle(graph, [2, 2], [9, 9])
    with pytest.raises(ArgumentError):
        any_angle(graph, [2, 2], [[1, 1], [0, 0]])
    with pytest.raises(ArgumentError):
        any_angle(graph, [0.5, 0.5], [1, 1])
    with pytest.raises(ArgumentError, match="terrain"):
        any_angle(graph.with_terrain(np.full((5, 5), 2.0)), [0, 0], [1, 1])


def test_clearance_is_that_of_all_touched_cells() -> None:
    states = np.ones((9, 9), np.uint8)
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], states)
    clearance = np.full(graph.size, 5.0)
    clearance[graph.index_to_flat(np.array([[4, 4]]))] = 1.5
    path = any_angle(graph, [0, 0], [8, 8], clearance=clearance)
    assert len(path) == 2 and path.clearance == 1.5
    assert any_angle(graph, [0, 0], [8, 0], clearance=clearance).clearance == 5.0


# ---------------------------------------------------------------------- how short they are


def shortest_of_all(graph: LatticeGraph) -> np.ndarray:
    """Lengths (M, M) of the shortest chains of free lines between all free cells."""
    from scipy.sparse.csgraph import dijkstra

    free = np.flatnonzero(graph.free)
    index = graph.flat_to_index(free)
    points = graph.lattice.centres(index)
    weights = np.zeros((len(free), len(free)))
    for i in range(len(free)):
        seen = line_of_sight(graph, index[i], index)
        weights[i] = np.where(seen, np.linalg.norm(points - points[i], axis=1), 0.0)
    return dijkstra(weights)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_paths_are_close_to_the_shortest_chains_of_lines(case: Case) -> None:
    ratios = []
    for seed in range(2 if JIT else 1):
        side = (28 if case.dim == 2 else 9) if JIT else 6
        rng = np.random.default_rng(seed)
        states = (rng.random([side] * case.dim) >= 0.2).astype(np.uint8)
        graph = LatticeGraph.from_states(case.lattice, [0] * case.dim, states, neighbourhood="extended")
        free = graph.flat_to_index(np.flatnonzero(graph.free))
        least = shortest_of_all(graph)
        for i, j in rng.integers(0, len(free), (80 if JIT else 10, 2)):
            if i == j or not np.isfinite(least[i, j]):
                continue
            length = any_angle(graph, free[i], free[j]).length
            assert length >= least[i, j] * (1 - 1e-9)
            ratios.append(length / least[i, j])
    assert np.mean(ratios) < 1.015
    assert max(ratios) < 1.15


def test_paths_of_a_corner_are_the_shortest() -> None:
    # One wall end between start and goal: the turning cell is the one diagonal to its corner.
    states = np.ones((21, 21), np.uint8)
    states[10, :15] = 0
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], states, neighbourhood=8)
    path = any_angle(graph, [5, 2], [15, 2])
    expected = min(
        math.dist((5, 2), (9, 15)) + 2.0 + math.dist((11, 15), (15, 2)),
        2 * math.dist((5, 2), (10, 16)),
    )
    assert path.length <= expected * (1 + 1e-12)


@pytest.mark.data
def test_arena_is_never_longer_than_the_published_octile_optimum(data_dir: FilePath) -> None:
    folder = data_dir / "planning" / "movingai"
    if not (folder / "arena.map").exists():
        pytest.skip(f"no planning maps in {folder}")
    free, problems = read_movingai(folder, "arena.map")
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], free.astype(np.uint8), neighbourhood=8)
    for start, goal, octile in problems if JIT else problems[::20]:
        path = any_angle(graph, start, goal)
        rounding = 10.0 ** -len(octile.partition(".")[2])
        assert math.dist(start, goal) * (1 - 1e-12) <= path.length <= float(octile) + rounding


# ---------------------------------------------------------------------- no cliff: corridors, spirals, sparse fields

PLANE = [case for case in EVERY if case.dim == 2]


@pytest.mark.parametrize("case", PLANE, ids=str)
@settings(max_examples=EXAMPLES // 3, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), obstacles=st.sampled_from([0.02, 0.1, 0.3]))
def test_wedges_tell_what_lines_tell(case: Case, seed: int, obstacles: float) -> None:
    # All cells around one, the nearest first, so that each has the wedges of those before it to go by.
    graph = random_graph(case, "extended", seed, obstacles, side=30 if JIT else 12)
    free = np.flatnonzero(graph.free)
    if len(free) < 2:
        return
    view, tree = make_view(graph), np.zeros(graph.size, theta.TREE)
    parent = int(np.random.default_rng(seed).choice(free))
    centre = graph.flat_to_index(np.array([parent]))[0].astype(np.int64)
    shifts = np.ascontiguousarray(graph.moves, dtype=np.int64)
    displacements = graph.flat_to_index(free).astype(np.int64) - centre
    seen = line_of_sight(graph, centre, displacements + centre)
    assert isinstance(seen, np.ndarray)
    for i in np.argsort(np.abs(displacements).max(axis=1), kind="stable"):
        cell, v = int(free[i]), displacements[i]
        if cell == parent:
            continue
        tree[cell]["parent"] = parent
        found = wedges.sees_by_wedge(
            graph.free, view.strides, view.shape, view.generators, view.gram, view.reach, view.touch,
            centre - graph.low, v, cell, parent, graph.offsets, shifts, tree,
        )  # fmt: skip
        refused = tree[cell]["refused"] == parent + 1
        assert (found > 0) == bool(tree[cell]["mark"] & wedges.WEDGE)
        assert found != 0 and not (found > 0 and refused)
        if found > 0:
            assert seen[i], (centre, v)
        elif refused:
            assert not seen[i], (centre, v)


@pytest.mark.parametrize("name", ["Z2", "A2"])
@pytest.mark.parametrize("label", hard.MAPS)
def test_hard_maps_take_a_few_looks_a_cell(name: str, label: str) -> None:
    # Counted, not timed: whole lines would be hundreds of looks a cell, and A* is what expansions are held to.
    side = 400 if JIT else 40
    if not JIT and label.endswith("40 wide"):
        return
    states, *ends_of = hard.MAPS[label](side)
    start, goal = (list(end) for end in ends_of)
    graph = LatticeGraph.from_states(Lattice.named(name), [0, 0], states, neighbourhood=8 if name == "Z2" else 6)
    path, moved = any_angle(graph, start, goal), astar(graph, start, goal)
    check_any_angle(graph, path, np.array(start), np.array(goal))
    assert path.length <= moved.length * (1 + 1e-12)
    assert path.expansions <= 2 * moved.expansions + 1100
    ends = graph.index_to_flat(np.array([start, goal])).tolist()
    raw, effort = search_path(graph, *ends, tighten=False)
    # Straight lines, not moves: making them taut must not become the dear part.
    assert 2 <= len(raw) <= 0.2 * len(moved) + 10
    if JIT and effort.expansions > 10_000:
        assert effort.scanned < 100 * effort.expansions


@pytest.mark.parametrize("case", PLANE, ids=str)
def test_a_weight_never_makes_paths_longer_than_those_of_astar(case: Case) -> None:
    side = 250 if JIT else 30
    for share in (0.02, 0.1):
        states = (np.random.default_rng(7).random((side, side)) >= share).astype(np.uint8)
        states[0, 0] = states[-1, -1] = states[side // 3, 0] = states[side // 2, -1] = 1
        graph = LatticeGraph.from_states(case.lattice, [0, 0], states)
        for start, goal in (([0, 0], [side - 1, side - 1]), ([side // 3, 0], [side // 2, side - 1])):
            path = any_angle(graph, start, goal)
            check_any_angle(graph, path, np.array(start), np.array(goal))
            assert path.length <= astar(graph, start, goal).length * (1 + 1e-12)
            assert any_angle(graph, start, goal).cells.tolist() == path.cells.tolist()
