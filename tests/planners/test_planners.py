"""The planners against scipy's Dijkstra, networkx's A* and published optima; validity of every path."""

from __future__ import annotations

import itertools
import pickle
from pathlib import Path as FilePath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra as scipy_dijkstra

from hexmap.base.errors import ArgumentError, HexmapError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from planners import (
    DistanceField,
    NoPath,
    Path,
    astar,
    dijkstra,
    line_of_sight,
    nearest_reachable,
    plan_many,
    shortcut,
    to_cell,
)
from planners.search.heuristics import estimate, gauge_planes
from tests.lattices import CASES, EXAMPLES, JIT, LONG, Case

NEIGHBOURHOODS = (None, "nearest", "faces", "extended")
ALL = list(itertools.product(CASES, NEIGHBOURHOODS))
IDS = [f"{case}-{nb}" for case, nb in ALL]


def random_graph(
    case: Case, neighbourhood: str | None, seed: int, obstacles: float = 0.25, terrain: bool = False, side: int = 0
) -> LatticeGraph:
    """A random window around a random index, with terrain of a few kinds or of random numbers."""
    rng = np.random.default_rng(seed)
    shape = rng.integers(1, side or (9 if case.dim == 2 else 6), case.dim, endpoint=True)
    states = (rng.random(shape) >= obstacles).astype(np.uint8)
    graph = LatticeGraph.from_states(case.lattice, rng.integers(-20, 20, case.dim), states, neighbourhood=neighbourhood)
    if terrain:
        values = rng.integers(1, 4, shape) if seed % 2 else rng.uniform(0.5, 9.0, shape)
        graph = graph.with_terrain(values.astype(np.float64))
    return graph


def edges(graph: LatticeGraph) -> dict[tuple[int, int], float]:
    """Every move and its cost, one cell after the other: the reference."""
    out: dict[tuple[int, int], float] = {}
    for a in np.flatnonzero(graph.free).tolist():
        for k, offset in enumerate(graph.offsets.tolist()):
            b = a + offset
            swept = graph.swept[graph.swept_starts[k] : graph.swept_starts[k + 1]]
            if graph.free[b] and all(graph.free[a + int(s)] for s in swept):
                times = 1.0 if graph.terrain is None else (graph.terrain[a] + graph.terrain[b]) / 2
                out[a, b] = float(graph.lengths[k]) * times
    return out


def reference(graph: LatticeGraph, sources: list[int]) -> np.ndarray:
    """Least costs (size,) by scipy."""
    moves = edges(graph)
    rows = [a for a, _ in moves]
    columns = [b for _, b in moves]
    matrix = csr_matrix((list(moves.values()), (rows, columns)), shape=(graph.size, graph.size))
    return scipy_dijkstra(matrix, indices=sources, min_only=True)


def check_path(graph: LatticeGraph, path: Path, start: np.ndarray, goal: np.ndarray) -> None:
    """Hold a path to what it promises."""
    assert path.cells.dtype == np.int32 and path.points.dtype == np.float64
    assert (path.cells[0] == start).all() and (path.cells[-1] == goal).all()
    flat = graph.index_to_flat(path.cells)
    assert graph.free[flat].all()
    moves = edges(graph)
    cost = sum(moves[a, b] for a, b in itertools.pairwise(flat.tolist()))  # KeyError: not a move
    assert path.cost == pytest.approx(cost, rel=1e-12, abs=1e-15)
    np.testing.assert_allclose(path.points, graph.lattice.centres(path.cells))
    legs = np.diff(path.points, axis=0)
    assert path.length == pytest.approx(np.linalg.norm(legs, axis=1).sum(), rel=1e-12)
    units = legs / np.linalg.norm(legs, axis=1)[:, None]
    angles = np.arccos(np.clip((units[1:] * units[:-1]).sum(axis=1), -1, 1))
    assert path.turning == pytest.approx(angles.sum(), abs=1e-6 * (len(path) + 1))


def free_cells(graph: LatticeGraph, seed: int, count: int) -> np.ndarray | None:
    free = np.flatnonzero(graph.free)
    if len(free) == 0:
        return None
    return graph.flat_to_index(np.random.default_rng(seed).choice(free, count))


@pytest.mark.parametrize(("case", "neighbourhood"), ALL, ids=IDS)
@pytest.mark.parametrize("terrain", [False, True], ids=["plain", "terrain"])
@settings(max_examples=max(EXAMPLES // 4, 2), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), obstacles=st.sampled_from([0.0, 0.1, 0.3, 0.5]))
def test_every_planner_finds_the_least_cost(
    case: Case, neighbourhood: str | None, terrain: bool, seed: int, obstacles: float
) -> None:
    graph = random_graph(case, neighbourhood, seed, obstacles, terrain)
    ends = free_cells(graph, seed, 2)
    if ends is None:
        return
    start, goal = ends
    a, b = graph.index_to_flat(ends).tolist()
    expected = reference(graph, [a])
    field = dijkstra(graph, start)
    np.testing.assert_allclose(field.distance, expected, rtol=1e-12)
    assert field.settled == np.isfinite(expected).sum()
    parents = field.parents
    for cell in np.flatnonzero(np.isfinite(expected)):
        if cell == a:
            assert parents[cell] == len(graph.moves)
        else:
            before = cell - graph.offsets[parents[cell]]
            assert edges(graph)[before, cell] + expected[before] == pytest.approx(expected[cell], rel=1e-12)
    assert (parents[~np.isfinite(expected)] == len(graph.moves)).all()
    searches = [
        lambda s, g: astar(graph, s, g),
        lambda s, g: astar(graph, s, g, heuristic="none"),
        lambda s, g: astar(graph, s, g, bidirectional=True),
        lambda s, g: dijkstra(graph, s).path_to(g),
        lambda s, g: dijkstra(graph, s, goals=g).path_to(g),
    ]
    for search in searches:
        if not np.isfinite(expected[b]):
            with pytest.raises(NoPath, match="not connected") as caught:
                search(start, goal)
            assert caught.value.reason == "not connected"
            continue
        path = search(start, goal)
        assert path.cost == pytest.approx(expected[b], rel=1e-12, abs=1e-15)
        check_path(graph, path, start, goal)
        assert search(goal, start).cost == pytest.approx(path.cost, rel=1e-12, abs=1e-15)
    if np.isfinite(expected[b]):
        assert estimate(graph, start, goal) <= expected[b] * (1 + 1e-9)
        fast = astar(graph, start, goal, weight=2.5)
        check_path(graph, fast, start, goal)
        assert 1.0 <= fast.bound <= 2.5
        assert fast.cost <= fast.bound * expected[b] * (1 + 1e-10)


@pytest.mark.parametrize(("case", "neighbourhood"), ALL, ids=IDS)
def test_costs_equal_networkx(case: Case, neighbourhood: str | None) -> None:
    networkx = pytest.importorskip("networkx")
    for seed in range(4):
        graph = random_graph(case, neighbourhood, seed, terrain=seed > 1, side=7)
        other = networkx.DiGraph()
        other.add_nodes_from(np.flatnonzero(graph.free).tolist())
        other.add_weighted_edges_from([(a, b, cost) for (a, b), cost in edges(graph).items()])
        ends = free_cells(graph, seed, 2)
        if ends is None:
            continue
        start, goal = ends
        a, b = graph.index_to_flat(ends).tolist()

        def ahead(u: int, v: int, graph: LatticeGraph = graph) -> float:
            cells = graph.flat_to_index(np.array([u, v]))
            return estimate(graph, cells[0], cells[1]) * (1 - 1e-12)

        try:
            expected = networkx.astar_path_length(other, a, b, heuristic=ahead)
        except networkx.NetworkXNoPath:
            with pytest.raises(NoPath):
                astar(graph, start, goal)
            continue
        assert astar(graph, start, goal).cost == pytest.approx(expected, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(("case", "neighbourhood"), ALL, ids=IDS)
def test_the_heuristic_is_consistent_and_tight(case: Case, neighbourhood: str | None) -> None:
    graph = random_graph(case, neighbourhood, 1, 0.0)
    planes = gauge_planes(graph.moves, graph.lengths)
    reach = np.abs(graph.moves @ planes.T).max(axis=1, initial=0.0)
    assert (reach <= graph.lengths * (1 + 1e-12)).all()
    if np.linalg.matrix_rank(graph.moves) == case.dim:
        # Some move is as long as its estimate, in every facet.
        assert np.isclose(np.abs(planes @ graph.moves.T), graph.lengths).sum(axis=1).min() >= case.dim
    else:
        assert len(planes) == 0


@pytest.mark.parametrize(
    ("name", "size", "far"),
    [("Z2", 4, 3.0), ("Z2", 8, 2.414213562373095), ("A2", 6, None), ("D3", 12, None), ("Z3", 26, None)],
)
def test_free_space_needs_few_expansions(name: str, size: int, far: float | None) -> None:
    # Where the heuristic is exact, ties to the larger g lead straight to the goal.
    lattice = Lattice.named(name)
    side = 31 if lattice.dim == 2 else 13
    graph = LatticeGraph.from_states(lattice, [0] * lattice.dim, np.ones((side,) * lattice.dim, np.uint8),
                                     neighbourhood=size)  # fmt: skip
    goal = np.array([2, 1] if lattice.dim == 2 else [2, 1, 1]) * (side // 2 - 1)
    goal = np.minimum(goal, side - 1)
    path = astar(graph, [0] * lattice.dim, goal)
    assert path.cost == pytest.approx(estimate(graph, [0] * lattice.dim, goal), rel=1e-12)
    assert path.expansions <= 2 * len(path)
    if far is not None:
        assert astar(graph, [0, 0], [2, 1]).cost == pytest.approx(far)


def test_equal_sums_open_no_cell_again() -> None:
    # Lengths that are no binary fractions: the order of a sum must not look like an improvement.
    states = (np.random.default_rng(3).random((24, 24, 24)) >= 0.2).astype(np.uint8)
    states[0, 0, 0] = states[-1, -1, -1] = 1
    if not JIT:
        states = states[-8:, -8:, -8:].copy()
        states[0, 0, 0] = 1
    graph = LatticeGraph.from_states(Lattice.named("D3", 0.1), [0, 0, 0], states, neighbourhood=18)
    for plan in (graph, graph.with_terrain(np.full(states.shape, 1.7))):
        path = astar(plan, [0, 0, 0], np.array(states.shape) - 1)
        assert path.expansions <= states.sum()
        assert astar(plan, [0, 0, 0], np.array(states.shape) - 1, bidirectional=True).expansions <= 2 * states.sum()


def test_wide_differences_of_terrain_are_exact_too() -> None:
    rng = np.random.default_rng(5)
    for name in ("A2", "Z3"):
        lattice = Lattice.named(name)
        shape = (14, 14) if lattice.dim == 2 else (6, 6, 6)
        graph = LatticeGraph.from_states(lattice, [0] * lattice.dim, np.ones(shape, np.uint8), neighbourhood="extended")
        graph = graph.with_terrain(10.0 ** rng.uniform(-4, 5, shape))
        source = graph.index_to_flat(np.zeros((1, lattice.dim), int)).tolist()
        expected = reference(graph, source)
        field = dijkstra(graph, [0] * lattice.dim)
        np.testing.assert_allclose(field.distance, expected, rtol=1e-12)
        goal = np.array(shape) - 1
        assert field.path_to(goal).cost == pytest.approx(float(field.distance_to(goal[None])[0]), rel=1e-12)
        assert astar(graph, [0] * lattice.dim, goal).cost == pytest.approx(field.path_to(goal).cost, rel=1e-12)


@pytest.mark.parametrize("neighbourhood", ["nearest", "extended"])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_many_sources_limits_and_goals(case: Case, neighbourhood: str) -> None:
    for seed in range(5):
        graph = random_graph(case, neighbourhood, seed, 0.2, terrain=seed == 4, side=8)
        cells = free_cells(graph, seed, 5)
        if cells is None:
            continue
        flat = graph.index_to_flat(cells)
        expected = reference(graph, flat[:3].tolist())
        field = dijkstra(graph, cells[:3])
        np.testing.assert_allclose(field.distance, expected, rtol=1e-12)
        np.testing.assert_allclose(field.distance_to(cells), expected[flat], rtol=1e-12)
        for goal, cost in zip(cells, expected[flat], strict=True):
            if np.isfinite(cost):
                path = field.path_to(goal)
                assert path.cost == pytest.approx(cost, rel=1e-12, abs=1e-15)
                assert any((path.cells[0] == s).all() for s in cells[:3])
        limit = float(np.median(expected[np.isfinite(expected)])) * (1 + 1e-9)
        near = dijkstra(graph, cells[:3], limit=limit)
        np.testing.assert_allclose(near.distance, np.where(expected <= limit, expected, np.inf), rtol=1e-12)
        # Stopped early: whatever is finite is final.
        early = dijkstra(graph, cells[:3], goals=cells[3:])
        final = np.isfinite(early.distance)
        np.testing.assert_allclose(early.distance[final], expected[final], rtol=1e-12)
        np.testing.assert_allclose(early.distance_to(cells), expected[flat], rtol=1e-12)


def test_goal_sets() -> None:
    case = CASES[1]
    for seed in range(20):
        graph = random_graph(case, "extended", seed, 0.2, side=9)
        cells = free_cells(graph, seed, 25)
        if cells is None:
            continue
        for goals in (cells[1:4], cells[1:]):  # few, and more than the heuristic is worth
            expected = reference(graph, graph.index_to_flat(cells[:1]).tolist())[graph.index_to_flat(goals)].min()
            if np.isinf(expected):
                with pytest.raises(NoPath, match="any of"):
                    astar(graph, cells[0], goals)
                continue
            outside = np.vstack([goals, cells[:1] + 1000])
            for path in (astar(graph, cells[0], outside), astar(graph, cells[0], goals, bidirectional=True)):
                assert path.cost == pytest.approx(expected, rel=1e-12, abs=1e-15)
                assert (goals == path.cells[-1]).all(axis=1).any()


def wall() -> LatticeGraph:
    """Squares: a wall from edge to edge in the third row."""
    states = np.ones((5, 6), np.uint8)
    states[2] = 0
    return LatticeGraph.from_states(Lattice.named("Z2", 0.5), [10, 20], states)


@pytest.mark.parametrize(
    ("start", "goal", "reason"),
    [
        ([12, 21], [10, 20], "start blocked"),
        ([10, 20], [12, 21], "goal blocked"),
        ([10, 20], [13, 20], "not connected"),
        ([9, 20], [13, 20], "start outside the map"),
        ([10, 20], [10, 26], "goal outside the map"),
        ([10, 20], [10, 2**40], "goal outside the map"),
    ],
)
def test_no_path_says_why(start: list[int], goal: list[int], reason: str) -> None:
    graph = wall()
    for again in range(2):  # without and with components at hand
        searches = [
            lambda: astar(graph, start, goal),
            lambda: astar(graph, start, goal, bidirectional=True),
            lambda: dijkstra(graph, start).path_to(goal),
        ]
        for search in searches:
            with pytest.raises(NoPath) as caught:
                search()
            assert caught.value.reason == reason
            assert isinstance(caught.value, HexmapError) and isinstance(caught.value, ValueError)
            assert "\n" not in str(caught.value) and reason in str(caught.value)
            assert pickle.loads(pickle.dumps(caught.value)).reason == reason
        if not again:
            graph.components()


def test_beyond_the_limit_is_not_unconnected() -> None:
    graph = wall()
    with pytest.raises(NoPath) as caught:
        dijkstra(graph, [10, 20], limit=1.0).path_to([10, 25])
    assert caught.value.reason == "beyond the limit"
    assert dijkstra(graph, [10, 20], limit=2.5).path_to([10, 25]).cost == 2.5
    with pytest.raises(NoPath) as caught:
        dijkstra(graph, [10, 20], limit=1.0).path_to([13, 25])
    assert caught.value.reason == "not connected"
    with pytest.raises(NoPath) as caught:
        dijkstra(graph, [10, 20], goals=[10, 21]).path_to([10, 25])
    assert caught.value.reason == "beyond the limit"


@pytest.mark.parametrize("case", CASES, ids=str)
def test_start_is_goal_and_one_cell(case: Case) -> None:
    graph = LatticeGraph.from_states(case.lattice, [3] * case.dim, np.ones((1,) * case.dim, np.uint8))
    cell = [3] * case.dim
    for path in (astar(graph, cell, cell), astar(graph, cell, cell, bidirectional=True),
                 dijkstra(graph, cell).path_to(cell)):  # fmt: skip
        assert path.cells.tolist() == [cell]
        assert (path.cost, path.length, path.turning, path.clearance) == (0.0, 0.0, 0.0, None)
    field = dijkstra(graph, cell)
    assert isinstance(field, DistanceField) and field.settled == 1
    assert np.isinf(field.distance_to(np.array([cell, [99] * case.dim]))).tolist() == [False, True]
    blocked = LatticeGraph.from_states(case.lattice, [0] * case.dim, np.zeros((2,) * case.dim, np.uint8))
    with pytest.raises(NoPath, match="start blocked"):
        astar(blocked, [0] * case.dim, [1] * case.dim)
    assert to_cell(graph, case.lattice.centres(np.array([cell]))[0]).tolist() == cell


def test_arguments() -> None:
    graph = wall()
    wrong = [
        lambda: astar(graph, [10.0, 20.0], [10, 21]),
        lambda: astar(graph, [10, 20, 0], [10, 21]),
        lambda: astar(graph, [[10, 20]], [10, 21]),
        lambda: astar(graph, [10, 20], np.empty((0, 2), int)),
        lambda: astar(graph, [10, 20], [10, 21], weight=0.9),
        lambda: astar(graph, [10, 20], [10, 21], weight=float("nan")),
        lambda: astar(graph, [10, 20], [10, 21], weight=2.0, bidirectional=True),
        lambda: astar(graph, [10, 20], [10, 21], heuristic="octile"),  # type: ignore[arg-type]
        lambda: dijkstra(graph, [10, 20], limit=-1.0),
        lambda: dijkstra(graph, [10, 20], limit=float("nan")),
        lambda: dijkstra(graph, [10, 20]).path_to([[10, 21]]),
        lambda: dijkstra(graph, [10, 20]).distance_to([10, 21]),
        lambda: plan_many(graph, [[10, 20]], [[10, 21], [10, 22]]),
        lambda: plan_many(graph, [[10, 20]], [[10, 21]], workers=0),
        lambda: to_cell(graph, [0.0, 1.0, 2.0]),
    ]
    for call in wrong:
        with pytest.raises(ArgumentError):
            call()


def test_clearance_of_a_path() -> None:
    graph = wall()
    values = graph.clearance()
    path = astar(graph, [10, 20], [11, 25], clearance=values)
    assert path.clearance == values[graph.index_to_flat(path.cells)].min() == 0.5
    assert dijkstra(graph, [10, 20]).path_to([10, 25], clearance=values).clearance == 1.0


@pytest.mark.parametrize("case", CASES, ids=str)
def test_batches_do_not_depend_on_threads(case: Case) -> None:
    graph = random_graph(case, None, 7, 0.3, side=12 if case.dim == 2 else 8)
    inner = np.stack(
        [np.random.default_rng(k).integers(graph.first, graph.first + graph.inner_shape) for k in range(40)]
    )
    starts, goals = inner[:20], inner[20:]
    one, many = plan_many(graph, starts, goals, 1), plan_many(graph, starts, goals, 4)
    assert len(one) == len(many) == 20
    for a, b, start, goal in zip(one, many, starts, goals, strict=True):
        if isinstance(a, NoPath):
            assert isinstance(b, NoPath) and a.reason == b.reason
        else:
            assert isinstance(b, Path)
            assert (a.cells == b.cells).all() and (a.cells[0] == start).all() and (a.cells[-1] == goal).all()
            assert (a.cost, a.expansions, a.pushes) == (b.cost, b.expansions, b.pushes)
    assert plan_many(graph, np.empty((0, case.dim), int), np.empty((0, case.dim), int)) == []


@pytest.mark.parametrize("neighbourhood", ["nearest", "extended"])
@pytest.mark.parametrize("case", CASES, ids=str)
def test_shortcuts_are_free_and_never_longer(case: Case, neighbourhood: str) -> None:
    for seed in range(6):
        graph = random_graph(case, neighbourhood, seed, 0.2, terrain=seed > 3, side=14 if case.dim == 2 else 8)
        cells = free_cells(graph, seed, 2)
        if cells is None:
            continue
        try:
            path = astar(graph, cells[0], cells[1])
        except NoPath:
            continue
        short = shortcut(graph, path)
        assert short.cost <= path.cost * (1 + 1e-12)
        assert (short.cells[0] == path.cells[0]).all() and (short.cells[-1] == path.cells[-1]).all()
        if graph.terrain is None:
            assert short.cost == pytest.approx(short.length, rel=1e-12)
            taut = shortcut(graph, path, taut=True)
            assert taut.cost == taut.length <= short.length * (1 + 1e-12)
            assert np.all(line_of_sight(graph, taut.cells[:-1], taut.cells[1:]))
        t = np.linspace(0.0, 1.0, 257)[:, None]
        for a, b in itertools.pairwise(short.points):
            # Points of the line, but those that lie on a face to the last digits: they could go either way.
            line = a + t * (b - a)
            both = [graph.lattice.quantise(line + s * 1e-9 * case.lattice.resolution) for s in (-1.0, 1.0)]
            inner = both[0][(both[0] == both[1]).all(axis=1)]
            assert graph.free[graph.index_to_flat(inner)].all()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_shortcuts_across_terrain_cost_no_more_than_the_moves(case: Case) -> None:
    side = 14 if case.dim == 2 else 8
    shape = (side,) * case.dim
    # Dear on one side, cheap on the other, as near walls that are to be kept off.
    slope = 1.0 + 3.0 * np.indices(shape)[0] / side
    graph = LatticeGraph.from_states(case.lattice, [0] * case.dim, np.ones(shape, np.uint8)).with_terrain(slope)
    path = astar(graph, [side - 1] * case.dim, [side // 2, *[0] * (case.dim - 1)])
    short = shortcut(graph, path, across_terrain=True)
    assert len(short) < len(path) and short.cost <= path.cost * (1 + 1e-12)
    fine = np.linspace(0.0, 1.0, 20_001)[:, None]
    cost = 0.0
    for a, b in itertools.pairwise(short.points):
        flat = graph.index_to_flat(case.lattice.quantise(a + fine * (b - a)))
        cost += float(graph.terrain[flat].mean() * np.linalg.norm(b - a))  # type: ignore[index]
    assert short.cost == pytest.approx(cost, rel=0.02)


def test_shortcuts_do_not_cut_corners() -> None:
    states = np.ones((6, 6), np.uint8)
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], states, neighbourhood=4)
    assert shortcut(graph, astar(graph, [0, 0], [5, 5])).length == pytest.approx(np.hypot(5, 5))
    # Only a corner of the wall touches the straight line.
    states[1, 0] = 0
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], states, neighbourhood=4)
    short = shortcut(graph, astar(graph, [0, 0], [1, 1]))
    assert len(short) == 3 and short.length == 2.0
    with pytest.raises(ArgumentError):
        shortcut(graph, shortcut(graph, astar(graph, [0, 0], [5, 5])))


# ---------------------------------------------------------------------- published optima


def read_movingai(folder: FilePath, name: str) -> tuple[np.ndarray, list[tuple[list[int], list[int], str]]]:
    """The free cells (rows, columns) of a map, and start, goal (row, column) and optimum of its problems."""
    lines = (folder / name).read_text().splitlines()
    free = np.array([[c in ".GS" for c in row] for row in lines[4:]])
    problems = []
    for line in (folder / f"{name}.scen").read_text().splitlines()[1:]:
        if not line.strip():
            continue
        _, _, _, _, x0, y0, x1, y1, best = line.split()
        problems.append(([int(y0), int(x0)], [int(y1), int(x1)], best))
    return free, problems


@pytest.mark.data
def test_arena_equals_the_published_optima(data_dir: FilePath) -> None:
    folder = data_dir / "planning" / "movingai"
    if not (folder / "arena.map").exists():
        pytest.skip(f"no planning maps in {folder}")
    free, problems = read_movingai(folder, "arena.map")
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], free.astype(np.uint8), neighbourhood=8)
    assert len(problems) > 100
    for start, goal, best in problems if JIT else problems[::10]:
        digits = len(best.partition(".")[2])
        for cost in (astar(graph, start, goal).cost, astar(graph, start, goal, bidirectional=True).cost):
            assert abs(cost - float(best)) <= 0.5000001 * 10.0**-digits, (start, goal)
    # One search answers them all.
    by_start = {tuple(start) for start, _, _ in problems}
    start = min(by_start)
    field = dijkstra(graph, list(start))
    for s, goal, best in problems:
        if tuple(s) == start:
            assert abs(field.path_to(goal).cost - float(best)) <= 0.5000001 * 10.0 ** -len(best.partition(".")[2])


# ---------------------------------------------------------------------- the nearest reachable cell


def nearest_by_brute_force(graph: LatticeGraph, start: np.ndarray, point: np.ndarray) -> np.ndarray:
    """The nearest cell of the start's component, all of them measured; ties to the lowest flat position."""
    labels = graph.components()
    flat = np.flatnonzero(labels == labels[graph.index_to_flat(start[None])[0]])
    distance = np.linalg.norm(graph.centres(flat) - point, axis=1)
    near = flat[distance <= distance.min() + 1e-9 * graph.lattice.resolution]
    return graph.flat_to_index(near[:1])[0]


@pytest.mark.parametrize("neighbourhood", NEIGHBOURHOODS)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_nearest_reachable_equals_brute_force(case: Case, neighbourhood: str | None) -> None:
    for seed in range(6 if JIT or LONG else 3):
        side = (24 if case.dim == 2 else 9) if JIT or LONG else (12 if case.dim == 2 else 6)
        graph = random_graph(case, neighbourhood, seed, (0.2, 0.5, 0.8)[seed % 3], side=side)
        rng = np.random.default_rng(seed)
        starts = free_cells(graph, seed, 4)
        if starts is None:
            continue
        low, high = case.lattice.centres(np.array([graph.first, graph.first + graph.inner_shape - 1]))
        width = np.linalg.norm(high - low) + case.lattice.resolution
        for start in starts:
            points = [low + rng.random(case.dim) * (high - low) for _ in range(4)]
            points += [low + rng.normal(size=case.dim) * width * far for far in (1.0, 30.0, 1e5)]
            # Cells' centres, and the middle between two: ties.
            cells = rng.integers(graph.first - 1, graph.first + graph.inner_shape + 1, (4, case.dim))
            points += [*case.lattice.centres(cells), *case.lattice.centres(cells + 0.5), 0.5 * (low + high)]
            for point in points:
                found = nearest_reachable(graph, start, point)
                assert found.dtype == np.int32 and found.shape == (case.dim,)
                np.testing.assert_array_equal(found, nearest_by_brute_force(graph, start, point))


def test_nearest_reachable_of_a_lonely_start() -> None:
    for case in CASES:
        states = np.zeros((5,) * case.dim, np.uint8)
        states[(0,) * case.dim] = states[(4,) * case.dim] = 1
        graph = LatticeGraph.from_states(case.lattice, [7] * case.dim, states)
        start = [7] * case.dim
        for goal in ([11] * case.dim, [9] * case.dim, [10**6] * case.dim):
            assert nearest_reachable(graph, start, case.lattice.centres(np.array([goal]))[0]).tolist() == start
            path = astar(graph, start, goal, nearest=True)
            assert path.cells.tolist() == [start] and path.cost == 0.0 and not path.goal_reached
        with pytest.raises(NoPath, match="start blocked"):
            nearest_reachable(graph, [8] * case.dim, np.zeros(case.dim))
        with pytest.raises(NoPath, match="start outside"):
            nearest_reachable(graph, [0] * case.dim, np.zeros(case.dim))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_paths_to_the_nearest_reachable_cell(case: Case) -> None:
    for seed in range(8):
        graph = random_graph(case, None, seed, 0.4, side=14 if case.dim == 2 else 7)
        starts = free_cells(graph, seed, 1)
        if starts is None:
            continue
        rng = np.random.default_rng(seed)
        for goal in rng.integers(graph.first - 3, graph.first + graph.inner_shape + 3, (6, case.dim)):
            path = astar(graph, starts[0], goal, nearest=True)
            assert path.goal_reached == graph.connected(starts[0], goal)
            end = goal
            if not path.goal_reached:
                end = nearest_by_brute_force(graph, starts[0], case.lattice.centres(goal[None])[0])
                with pytest.raises(NoPath):
                    astar(graph, starts[0], goal)
            check_path(graph, path, starts[0], end)
            plain = astar(graph, starts[0], end)
            assert plain.goal_reached and (path.cells == plain.cells).all()


def test_arguments_of_the_nearest_reachable_cell() -> None:
    graph = wall()
    wrong = [
        lambda: nearest_reachable(graph, [10, 20], [0.0, 1.0, 2.0]),
        lambda: nearest_reachable(graph, [10, 20], [0.0, float("nan")]),
        lambda: nearest_reachable(graph, [10, 20], [0.0, 1e300]),
        lambda: nearest_reachable(graph, [[10, 20]], [0.0, 1.0]),
        lambda: nearest_reachable(graph, [10.0, 20.0], [0.0, 1.0]),
        lambda: astar(graph, [10, 20], [[13, 20], [12, 21]], nearest=True),
        lambda: astar(graph, [10, 20], [13.0, 20.0], nearest=True),
    ]
    for call in wrong:
        with pytest.raises(ValueError) as caught:
            call()
        assert isinstance(caught.value, HexmapError) and not isinstance(caught.value, NoPath)


# ---------------------------------------------------------------------- moves worth a try


@pytest.mark.parametrize(("case", "neighbourhood"), ALL, ids=IDS)
def test_moves_left_out_are_on_no_cheapest_path(case: Case, neighbourhood: str | None) -> None:
    # Many windows of all densities, from one start to every cell.
    for seed in range(6 if JIT else 1):
        graph = random_graph(case, neighbourhood, seed, (0.1, 0.35, 0.6)[seed % 3], side=8 if case.dim == 2 else 4)
        cells = free_cells(graph, seed, 1)
        if cells is None:
            continue
        field = dijkstra(graph, cells[0]).distance
        for flat in np.flatnonzero(np.isfinite(field))[1 :: 1 if JIT else 5].tolist():
            path = astar(graph, cells[0], graph.flat_to_index([flat])[0])
            assert path.cost == pytest.approx(field[flat], rel=1e-12, abs=1e-15)


# ---------------------------------------------------------------------- terrain of any spread


def test_paths_end_where_a_sum_absorbs_the_step() -> None:
    # From 5e16 on a step of 1 changes no sum: cells are equally far, and could be each other's parents.
    terrain = np.ones((1, 6))
    terrain[0, 0] = 1e17
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((1, 6), bool)).with_terrain(terrain)
    field = dijkstra(graph, [0, 0])
    assert field.path_to([0, 3]).cells.tolist() == [[0, 0], [0, 1], [0, 2], [0, 3]]
    assert field.path_to([0, 5]).cells[:, 1].tolist() == list(range(6))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_every_chain_of_parents_ends_in_a_source(case: Case) -> None:
    rng = np.random.default_rng(2)
    side = (20 if case.dim == 2 else 7) if JIT else 5
    states = rng.random([side] * case.dim) >= 0.1
    states[(0,) * case.dim] = True
    for decades in (3.0, 17.0, 40.0):
        terrain = 10.0 ** rng.uniform(0.0, decades, states.shape)
        terrain[(0,) * case.dim] = terrain.max()
        graph = LatticeGraph.from_states(case.lattice, [0] * case.dim, states).with_terrain(terrain)
        field = dijkstra(graph, [0] * case.dim)
        source = int(graph.index_to_flat(np.zeros((1, case.dim), int))[0])
        for at in np.flatnonzero(np.isfinite(field.distance)).tolist():
            steps = 0
            while field.parents[at] < len(graph.moves):
                at -= int(graph.offsets[field.parents[at]])
                steps += 1
                assert steps < graph.size
            assert at == source
        for cell in graph.flat_to_index(np.flatnonzero(np.isfinite(field.distance)))[::7]:
            path = field.path_to(cell)
            assert path.cells[0].tolist() == [0] * case.dim and path.cells[-1].tolist() == cell.tolist()


def test_terrain_over_many_decades_costs_a_few_pushes_a_cell() -> None:
    side = 150 if JIT else 20
    rng = np.random.default_rng(0)
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((side, side), bool), neighbourhood=8)
    for decades in (3, 6, 12):
        rough = graph.with_terrain(10.0 ** rng.uniform(0, decades, (side, side)))
        field = dijkstra(rough, [0, 0])
        assert field.settled == side * side
        assert field.pushes < 2 * side * side
        matrix, nodes = rough.to_csr()
        first = int(np.searchsorted(nodes, rough.index_to_flat(np.array([[0, 0]]))[0]))
        expected = scipy_dijkstra(matrix, indices=first)
        np.testing.assert_allclose(field.distance[nodes], expected, rtol=1e-12)
        # Up to a limit, and to a goal, the same numbers.
        limit = float(np.median(expected))
        near = dijkstra(rough, [0, 0], limit=limit)
        assert (near.distance[nodes] == np.where(field.distance[nodes] <= limit, field.distance[nodes], np.inf)).all()
        goal = dijkstra(rough, [0, 0], goals=[side // 2, side // 2])
        assert goal.distance_to(np.array([[side // 2] * 2])) == field.distance_to(np.array([[side // 2] * 2]))
        final = np.isfinite(goal.distance)
        assert (goal.distance[final] == field.distance[final]).all()
        with pytest.raises(NoPath):
            near.path_to(rough.flat_to_index(nodes[[np.argmax(expected)]])[0])


def test_terrain_whose_costs_would_overflow_is_refused() -> None:
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((4, 5), bool))
    with pytest.raises(ArgumentError, match="overflow"):
        graph.with_terrain(np.full((4, 5), 1e308))
    assert astar(graph.with_terrain(np.full((4, 5), 1e300)), [0, 0], [3, 4]).cost == pytest.approx(7e300)
