"""Canonical search against Dijkstra's algorithm; the ordering against the sentences that define it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.base.errors import ArgumentError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.graph.moves import Neighbourhood, swept_by_moves
from hexmap.lattice.lattice import Lattice
from planners import NoPath, Path, astar, dijkstra, plan_many
from planners.search.canonical import canonical
from planners.search.canonical_order import Ordering, canonical_ordering, natural_pairs
from tests.lattices import CASES, EXAMPLES, JIT, LONG, PART, Case

NEIGHBOURHOODS: tuple[Neighbourhood, ...] = (None, "nearest", "faces", "extended")
# Every lattice and neighbourhood once, and the larger ones that have no name.
NAMED = [("Z2", 16), ("Z3", 26), ("A2", 24), ("D3*", 26)]
ALL: list[tuple[Lattice, Neighbourhood]] = [
    *((case.lattice, nb) for case, nb in itertools.product(CASES, NEIGHBOURHOODS)),
    *((Lattice.named(name, 0.1), size) for name, size in NAMED),
]
IDS = [f"{lattice.name}-{nb}" for lattice, nb in ALL]


def window(lattice: Lattice, neighbourhood: Neighbourhood, states: np.ndarray, seed: int = 0) -> LatticeGraph:
    low = np.random.default_rng(seed).integers(-9, 9, lattice.dim)
    return LatticeGraph.from_states(lattice, low, states, neighbourhood=neighbourhood)


def random_states(lattice: Lattice, seed: int, obstacles: float, side: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    shape = rng.integers(2, side, lattice.dim, endpoint=True)
    return (rng.random(shape) >= obstacles).astype(np.uint8)


def maze(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """One-cell corridors along the indices, carved depth first: one path between any two cells, on Z2 and Z3."""
    rng = np.random.default_rng(seed)
    states = np.zeros(shape, np.uint8)
    at = np.zeros(len(shape), np.int64)
    states[tuple(at)] = 1
    trail = [at]
    while trail:
        at = trail[-1]
        exits = []
        for axis, sign in itertools.product(range(len(shape)), (-2, 2)):
            to = at.copy()
            to[axis] += sign
            if 0 <= to[axis] < shape[axis] and not states[tuple(to)]:
                exits.append(to)
        if not exits:
            trail.pop()
            continue
        to = exits[rng.integers(len(exits))]
        states[tuple((at + to) // 2)] = states[tuple(to)] = 1
        trail.append(to)
    return states


def rooms(shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Rooms of six cells with walls of one, and doors of one cell."""
    rng = np.random.default_rng(seed)
    states = np.ones(shape, np.uint8)
    for axis, size in enumerate(shape):
        for wall in range(5, size, 6):
            layer = np.moveaxis(states, axis, 0)[wall]
            layer[...] = rng.random(layer.shape) < 0.12
    return states


def check_path(graph: LatticeGraph, path: Path, start: np.ndarray, goal: np.ndarray) -> None:
    """Consecutive cells are moves, with all they sweep free."""
    assert (path.cells[0] == start).all() and (path.cells[-1] == goal).all()
    flat = graph.index_to_flat(path.cells)
    number = {offset: k for k, offset in enumerate(graph.offsets.tolist())}
    cost = 0.0
    for a, b in itertools.pairwise(flat.tolist()):
        k = number[b - a]  # KeyError: not a move
        assert graph.free[a] and graph.free[b]
        assert graph.free[a + graph.swept[graph.swept_starts[k] : graph.swept_starts[k + 1]]].all()
        cost += float(graph.lengths[k])
    assert path.cost == pytest.approx(cost, rel=1e-12, abs=1e-15)


def check_queries(graph: LatticeGraph, seed: int, starts: int, goals: int) -> None:
    """Hold random queries to Dijkstra's costs."""
    rng = np.random.default_rng(seed)
    free = np.flatnonzero(graph.free)
    if len(free) == 0:
        return
    for start in graph.flat_to_index(rng.choice(free, starts)):
        distance = dijkstra(graph, start).distance
        to = rng.choice(free, goals)
        for flat, goal in zip(to.tolist(), graph.flat_to_index(to), strict=True):
            for jump in (True, False):
                if np.isfinite(distance[flat]):
                    path = canonical(graph, start, goal, jump=jump)
                    assert path.cost == pytest.approx(distance[flat], rel=1e-10, abs=1e-15)
                    assert jump or path.scanned == 0
                    check_path(graph, path, start, goal)
                else:
                    with pytest.raises(NoPath, match="not connected"):
                        canonical(graph, start, goal, jump=jump)


@pytest.mark.parametrize(("lattice", "neighbourhood"), ALL, ids=IDS)
@settings(max_examples=max(EXAMPLES // 3, 3), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), obstacles=st.sampled_from([0.0, 0.05, 0.2, 0.35, 0.5, 0.6]))
def test_the_cost_is_that_of_dijkstra(
    lattice: Lattice, neighbourhood: Neighbourhood, seed: int, obstacles: float
) -> None:
    states = random_states(lattice, seed, obstacles, 16 if lattice.dim == 2 else 7)
    check_queries(window(lattice, neighbourhood, states, seed), seed, 1, 4)


@pytest.mark.parametrize(("lattice", "neighbourhood"), ALL, ids=IDS)
@pytest.mark.parametrize("kind", [maze, rooms])
def test_mazes_rooms_and_corridors(lattice: Lattice, neighbourhood: Neighbourhood, kind: object) -> None:
    shape = (33, 27) if lattice.dim == 2 else (11, 9, 13)
    for seed in range(2 if JIT or LONG else 1):
        states = kind(shape, seed)  # type: ignore[operator]
        check_queries(window(lattice, neighbourhood, states), seed, 1, 8 if JIT else 2)


def metres_to_integers(graph: LatticeGraph) -> np.ndarray:
    return np.rint(graph.lengths / graph.lengths.min() * 2.0**36).astype(np.int64)


def ordering_of(graph: LatticeGraph) -> Ordering:
    swept = tuple(tuple(tuple(c) for c in cells.tolist()) for cells in swept_by_moves(graph.lattice, graph.moves))
    return canonical_ordering(graph.moves, metres_to_integers(graph), swept)


def least_path(graph: LatticeGraph, to_goal: np.ndarray, start: int, rank: np.ndarray) -> list[int]:
    """The moves of the canonical path: least cost, then fewest moves (equal here), then the lowest ranks."""
    moves = []
    at = start
    while to_goal[at] > 0:
        for k in np.argsort(rank).tolist():
            b = at + int(graph.offsets[k])
            sweeps = at + graph.swept[graph.swept_starts[k] : graph.swept_starts[k + 1]]
            onward = to_goal[b] + graph.lengths[k] if graph.free[b] and graph.free[sweeps].all() else np.inf
            if abs(onward - to_goal[at]) <= 1e-9 * graph.lengths[0]:
                moves.append(k)
                at = b
                break
        else:
            raise AssertionError("no move goes on")
    return moves


@pytest.mark.parametrize(("lattice", "neighbourhood"), ALL, ids=IDS)
def test_the_canonical_path_has_only_natural_and_forced_pairs(lattice: Lattice, neighbourhood: Neighbourhood) -> None:
    graph = window(lattice, neighbourhood, np.ones((3,) * lattice.dim, np.uint8))
    ordering = ordering_of(graph)
    rank = np.argsort(ordering.order)
    for seed in range(max(round(20 * PART), 2)):
        states = random_states(lattice, seed, 0.3, 12 if lattice.dim == 2 else 6)
        graph = window(lattice, neighbourhood, states)
        free = np.flatnonzero(graph.free)
        start, goal = np.random.default_rng(seed).choice(free, 2)
        to_goal = dijkstra(graph, graph.flat_to_index(np.array([goal]))[0]).distance
        if not np.isfinite(to_goal[start]):
            continue
        moves = least_path(graph, to_goal, int(start), rank)
        at = int(start)
        guards, cells = ordering.guards @ graph.strides, ordering.cells @ graph.strides
        for d, e in itertools.pairwise(moves):
            at += int(graph.offsets[d])
            if int(ordering.natural[d]) >> e & 1:
                continue
            pairs = range(ordering.pair_starts[d], ordering.pair_starts[d + 1])
            (pair,) = (i for i in pairs if ordering.seconds[i] == e)
            for alternative in range(ordering.alternative_starts[pair], ordering.alternative_starts[pair + 1]):
                needed = cells[ordering.cell_starts[alternative] : ordering.cell_starts[alternative + 1]]
                assert not graph.free[at + needed].all()
            own = at + guards[ordering.guard_starts[d] : ordering.guard_starts[d + 1]]
            # Beyond the window lies nothing that is free.
            inside = (own >= 0) & (own < graph.size)
            assert not inside.all() or not graph.free[own].all()


@pytest.mark.parametrize(("lattice", "neighbourhood"), ALL, ids=IDS)
def test_natural_pairs_reach_every_cell_at_its_least_cost(lattice: Lattice, neighbourhood: Neighbourhood) -> None:
    side = 11 if lattice.dim == 2 else 7
    graph = window(lattice, neighbourhood, np.ones((side,) * lattice.dim, np.uint8))
    middle = graph.first + side // 2
    natural = natural_pairs(ordering_of(graph).order, graph.moves, metres_to_integers(graph))
    # A pair for every cell two moves away that no single move reaches as cheaply, whatever the order.
    assert natural.sum() == natural_pairs(np.arange(len(graph.moves)), graph.moves, metres_to_integers(graph)).sum()
    # Sequences of natural pairs, in the whole lattice.
    free_cost: dict[tuple[int, ...], float] = {tuple(middle.tolist()): 0.0}
    states = {(tuple((middle + move).tolist()), k): float(graph.lengths[k]) for k, move in enumerate(graph.moves)}
    for _ in range(side // 2):
        onward: dict[tuple[tuple[int, ...], int], float] = {}
        for (cell, d), cost in states.items():
            free_cost[cell] = min(cost, free_cost.get(cell, np.inf))
            for e in np.flatnonzero(natural[d]).tolist():
                to = tuple((np.array(cell) + graph.moves[e]).tolist())
                onward[to, e] = min(onward.get((to, e), np.inf), cost + float(graph.lengths[e]))
        states = onward
    near = {tuple((middle + m).tolist()) for m in graph.moves} | {
        tuple((middle + a + b).tolist()) for a, b in itertools.product(graph.moves, graph.moves)
    }
    width = (4 if JIT or LONG else 3) * side
    wide = window(lattice, neighbourhood, np.ones((width,) * lattice.dim, np.uint8))
    centre = wide.first + width // 2
    distance = dijkstra(wide, centre).distance
    for cell in near:
        flat = wide.index_to_flat((np.array(cell) - middle + centre)[None])[0]
        assert free_cost[cell] == pytest.approx(distance[flat], rel=1e-9, abs=1e-15)


@pytest.mark.parametrize(
    ("name", "size", "degrees"),
    [
        ("Z2", 4, [1, 1, 3, 3]),
        ("Z2", 8, [1] * 4 + [3] * 4),
        ("A2", 6, [1, 1, 1, 3, 3, 3]),
        ("Z3", 6, [1, 1, 3, 3, 5, 5]),
        ("Z3", 26, [1] * 6 + [3] * 12 + [7] * 8),
        ("D3*", 8, [1, 1, 1, 3, 3, 3, 7, 7]),
        ("D3*", 14, [1] * 4 + [3] * 6 + [7] * 4),
    ],
)
def test_known_orderings_are_found_at_any_resolution(name: str, size: int, degrees: list[int]) -> None:
    orders = []
    for resolution in (1.0, 0.1, 0.37):
        lattice = Lattice.named(name, resolution)
        graph = window(lattice, size, np.ones((3,) * lattice.dim, np.uint8))
        natural = natural_pairs(ordering_of(graph).order, graph.moves, metres_to_integers(graph))
        assert sorted(natural.sum(axis=1).tolist()) == degrees
        assert natural.diagonal().all()
        orders.append(ordering_of(graph).order.tolist())
    assert orders[0] == orders[1] == orders[2]
    if name == "A2":
        # Even and odd directions in turn, around the circle.
        angle = np.arctan2(*lattice.centres(graph.moves).T[::-1])
        around = natural.sum(axis=1)[np.argsort(angle)]
        assert around.tolist() in ([1, 3] * 3, [3, 1] * 3)


@pytest.mark.parametrize(("lattice", "neighbourhood"), ALL, ids=IDS)
def test_open_space_takes_few_expansions(lattice: Lattice, neighbourhood: Neighbourhood) -> None:
    side = 61 if lattice.dim == 2 else 17
    graph = window(lattice, neighbourhood, np.ones((side,) * lattice.dim, np.uint8))
    goals = graph.flat_to_index(np.random.default_rng(1).choice(np.flatnonzero(graph.free), 5))
    for goal in goals:
        try:
            plain = astar(graph, graph.first, goal)
        except NoPath:
            continue
        path = canonical(graph, graph.first, goal)
        assert path.cost == pytest.approx(plain.cost, rel=1e-12)
        if graph.equal_edges:
            assert path.expansions <= plain.expansions + 2
            assert path.pushes <= plain.pushes + len(graph.moves)


@pytest.mark.skipif(not JIT, reason="too slow without the compiler")
def test_jumping_saves_pushes_among_sparse_obstacles() -> None:
    states = (np.random.default_rng(0).random((512, 512)) >= 0.05).astype(np.uint8)
    graph = LatticeGraph.from_states(Lattice.named("A2"), [0, 0], states)
    rng = np.random.default_rng(1)
    queries = graph.flat_to_index(rng.choice(np.flatnonzero(graph.free), 80)).reshape(-1, 2, 2)
    pushes = np.zeros(3)
    for a, b in queries:
        found = [astar(graph, a, b), canonical(graph, a, b, jump=False), canonical(graph, a, b)]
        assert np.ptp([path.cost for path in found]) < 1e-9 * found[0].cost + 1e-12
        pushes += [path.pushes for path in found]
    assert pushes[2] * 2.5 <= pushes[0]
    assert pushes[2] * 2.5 <= pushes[1]


@pytest.mark.skipif(not JIT, reason="too slow without the compiler")
@pytest.mark.parametrize(("name", "size"), [("Z2", 8), ("A2", 12), ("A2", 6)])
def test_very_long_paths_stay_exact(name: str, size: int) -> None:
    # Walls two cells thick, for moves of two cells; longer than sums of the finest lengths are exact.
    side = 330
    states = np.ones((side, side), np.uint8)
    for wall, row in enumerate(range(3, side - 2, 5)):
        states[row : row + 2, :] = 0
        states[row : row + 2, -3 if wall % 2 else 0 : None if wall % 2 else 3] = 1
    graph = LatticeGraph.from_states(Lattice.named(name), [0, 0], states, neighbourhood=size)
    plain = astar(graph, [0, 0], [side - 1, side - 1])
    assert len(plain) > 2**14
    for jump in (True, False):
        path = canonical(graph, [0, 0], [side - 1, side - 1], jump=jump)
        assert path.cost == pytest.approx(plain.cost, rel=1e-10)
    check_path(graph, path, np.array([0, 0]), np.array([side - 1, side - 1]))


@pytest.mark.parametrize("case", CASES, ids=str)
def test_no_path_is_said_as_by_astar(case: Case) -> None:
    states = np.ones((9,) * case.dim, np.uint8)
    states[3:6] = 0
    graph = window(case.lattice, None, states)
    ends = {
        "free": graph.first,
        "across": graph.first + 8,
        "blocked": graph.first + 4,
        "outside": graph.first - 1,
        "far": graph.first + 9,
    }
    for components in (False, True):
        if components:
            graph.components()
        for start, goal in itertools.product(ends.values(), repeat=2):
            said: list[tuple[str, str, str] | None] = []
            for planner in (astar, canonical):
                try:
                    planner(graph, start, goal)
                    said.append(None)
                except NoPath as error:
                    said.append((error.reason, error.detail, str(error)))
            assert said[0] == said[1]
    path = canonical(graph, graph.first, graph.first)
    assert (len(path), path.cost, path.pushes, path.scanned) == (1, 0.0, 0, 0)


def test_arguments_are_checked() -> None:
    graph = window(Lattice.named("A2"), None, np.ones((5, 5), np.uint8))
    with pytest.raises(ArgumentError, match="terrain"):
        canonical(graph.with_terrain(np.ones((5, 5))), graph.first, graph.first)
    for start, goal in ((graph.first, [graph.first] * 2), ([graph.first] * 2, graph.first)):
        with pytest.raises(ArgumentError, match="two cells, not 2"):
            canonical(graph, start, goal)
    with pytest.raises(ArgumentError, match="to_cell"):
        canonical(graph, graph.first, [0.5, 0.5])
    clearance = np.arange(graph.size, dtype=np.float64)
    path = canonical(graph, graph.first, graph.first + 4, clearance=clearance)
    assert path.clearance == clearance[graph.index_to_flat(path.cells)].min()


def test_many_queries_are_the_same_for_any_number_of_workers() -> None:
    graph = window(Lattice.named("D3"), None, random_states(Lattice.named("D3"), 3, 0.2, 12))
    free = graph.flat_to_index(np.flatnonzero(graph.free))
    rng = np.random.default_rng(0)
    starts, goals = rng.choice(free, 12), rng.choice(free, 12)
    one, two = (plan_many(graph, starts, goals, workers, planner=canonical) for workers in (1, 2))
    for a, b in zip(one, two, strict=True):
        assert type(a) is type(b)
        if isinstance(a, Path) and isinstance(b, Path):
            np.testing.assert_array_equal(a.cells, b.cells)
            assert (a.cost, a.pushes, a.scanned) == (b.cost, b.pushes, b.scanned)
