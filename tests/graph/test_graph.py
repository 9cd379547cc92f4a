"""The graph layer against brute force, scipy and networkx, on every lattice."""

from __future__ import annotations

import itertools
import math
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import networkx as nx
import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components, dijkstra

from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.graph.moves import swept_cells
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from tests import reference
from tests.lattices import CASES, PART, SHEARED, Case

GRAPH_CASES = [*CASES, *SHEARED]


def neighbourhoods(case: Case) -> list:
    """The default, the named ones, and every size that there is up to 26."""
    return [None, "nearest", "faces", "extended", *case.lattice.shell_sizes[:3]]


def touched(case: Case, move: tuple[int, ...]) -> set[tuple[int, ...]]:
    """All cells whose closed Voronoi cell meets the line from 0 to ``move``, in exact numbers, but its ends.

    The point t v is in the closed cell of c where it is as near to c as to every other lattice
    point w: 2 t v.(w - c) <= |w|^2 - |c|^2, for all w in a box around c.
    """
    G, U = reference.reduced_gram(case), reference.to_public(case)
    v = case.lattice.reduced_index(np.array([move]))[0].astype(object)
    low, high = np.minimum(v, 0) - 2, np.maximum(v, 0) + 2
    box = np.array(list(itertools.product(*[range(a, b + 1) for a, b in zip(low, high, strict=True)])), dtype=object)
    x = case.lattice.centres((box @ U.T).astype(np.int64))
    along = case.lattice.centres(np.array([move]))[0]
    t = np.clip(x @ along / (along @ along), 0, 1)
    near = np.linalg.norm(x - t[:, None] * along, axis=1) < 1.001 * case.lattice.covering_radius
    around = np.array([w for w in itertools.product(range(-2, 3), repeat=case.dim) if any(w)], dtype=object)
    found = set()
    for c in box[near]:
        begin, end, inside = Fraction(0), Fraction(1), True
        w = around + c
        for rate, room in zip(2 * (around @ G @ v), ((w @ G) * w).sum(axis=1) - c @ G @ c, strict=True):
            if rate > 0:
                end = min(end, Fraction(int(room), int(rate)))
            elif rate < 0:
                begin = max(begin, Fraction(int(room), int(rate)))
            else:
                inside = inside and room >= 0
        if inside and begin <= end:
            found.add(tuple(int(k) for k in U @ c.astype(np.int64)))
    return found - {(0,) * case.dim, tuple(move)}


def random_free(case: Case, seed: int = 0, blocked: float = 0.25) -> tuple[np.ndarray, np.ndarray]:
    """A small window at negative indices: its first cell and which cells are free."""
    rng = np.random.default_rng(seed)
    shape = (9, 11) if case.dim == 2 else (5, 6, 7)
    return np.array([-7, -4, -3][: case.dim]), rng.random(shape) >= blocked


def brute_moves(case: Case, graph: LatticeGraph, free: set, sweeps: dict) -> dict[tuple, set]:
    """Every free cell's reachable neighbours, by sets of tuples alone."""
    out = {}
    for cell in free:
        out[cell] = set()
        for move in reference.as_tuples(graph.moves):
            at = lambda v, cell=cell: tuple(a + b for a, b in zip(cell, v, strict=True))
            if at(move) in free and all(at(s) in free for s in sweeps[move]):
                out[cell].add(at(move))
    return out


@pytest.fixture(scope="module")
def sweeps() -> dict:
    """What `touched` found, by case and move: every test needs it again."""
    known: dict = {}

    def of(case: Case, moves: np.ndarray) -> dict:
        for move in reference.as_tuples(moves):
            if (case.label, move) not in known:
                known[case.label, move] = touched(case, move)
        return {move: known[case.label, move] for move in reference.as_tuples(moves)}

    return of


# ---------------------------------------------------------------------- moves and the corner rule


@pytest.mark.parametrize("case", GRAPH_CASES, ids=str)
def test_swept_cells_are_those_that_the_line_touches(case, sweeps):
    longest = case.lattice.shell(case.lattice.shell_sizes[min(2, len(case.lattice.shell_sizes) - 1)])
    for move, expected in sweeps(case, np.unique(np.concatenate([longest, case.lattice.faces]), axis=0)).items():
        found = reference.as_tuples(swept_cells(case.lattice, move))
        assert found == sorted(expected)
        # Seen from the other end it is the same set: the labelling relies on it.
        assert {tuple(b - a for a, b in zip(c, move, strict=True)) for c in found} == expected


@pytest.mark.parametrize("case", GRAPH_CASES, ids=str)
def test_moves_across_faces_sweep_nothing(case, sweeps):
    graph = LatticeGraph.from_states(case.lattice, *random_free(case), neighbourhood="faces")
    assert len(graph.swept) == 0 and not graph.swept_starts.any()
    assert not any(sweeps(case, case.lattice.faces).values())


def test_the_named_corner_rules():
    square, cube = Lattice.named("Z2"), Lattice.named("Z3")
    assert reference.as_tuples(swept_cells(square, [1, -1])) == [(0, -1), (1, 0)]
    assert reference.as_tuples(swept_cells(square, [2, 1])) == [(1, 0), (1, 1)]
    box = set(itertools.product((0, 1), repeat=3)) - {(0, 0, 0), (1, 1, 1)}
    assert set(reference.as_tuples(swept_cells(cube, [1, 1, 1]))) == box
    assert reference.as_tuples(swept_cells(cube, [0, 1, 1])) == [(0, 0, 1), (0, 1, 0)]
    for name, size in (("A2", 6), ("D3", 12), ("D3*", 8), ("D3*", 14)):
        lattice = Lattice.named(name)
        assert all(len(swept_cells(lattice, move)) == 0 for move in lattice.shell(size))
    hexagons = Lattice.named("A2")
    assert all(len(swept_cells(hexagons, move)) == 2 for move in hexagons.shell(12)[6:])


@pytest.mark.parametrize("case", GRAPH_CASES, ids=str)
def test_neighbours_equal_brute_force(case, sweeps):
    low, states = random_free(case)
    free = {tuple(int(v) for v in row) for row in np.argwhere(states) + low}
    for neighbourhood in neighbourhoods(case):
        graph = LatticeGraph.from_states(case.lattice, low, states, neighbourhood=neighbourhood)
        expected = brute_moves(case, graph, free, sweeps(case, graph.moves))
        for cell in itertools.product(*[range(a - 1, a + s + 1) for a, s in zip(low, states.shape, strict=True)]):
            found = graph.neighbours(cell)
            assert found.dtype == np.int32 and found.shape[1] == case.dim
            assert set(reference.as_tuples(found)) == expected.get(cell, set())
        assert graph.lengths == pytest.approx(np.linalg.norm(graph.moves @ case.lattice.basis.T, axis=1), rel=1e-12)
        assert graph.equal_edges == (np.ptp(graph.lengths) < 1e-9 * graph.lengths.max())


def test_default_neighbourhood_and_its_names():
    for case in CASES:
        lattice, cells = case.lattice, np.ones((2,) * case.dim, bool)
        make = lambda k, lattice=lattice, cells=cells: LatticeGraph.from_states(
            lattice, [0] * lattice.dim, cells, neighbourhood=k
        )
        assert (make(None).moves == lattice.neighbours).all()
        assert (make("extended").moves == lattice.extended).all()
        for wrong in ("diagonal", 5, True, 1.5, []):
            with pytest.raises(ArgumentError):
                make(wrong)
    graph = LatticeGraph.from_states(Lattice.named("Z2", 0.1), [0, 0], np.ones((2, 2), bool), neighbourhood=8)
    assert not graph.equal_edges and set(graph.lengths) == {graph.lengths[0], graph.lengths[-1]}


# ---------------------------------------------------------------------- the window


@pytest.mark.parametrize("case", GRAPH_CASES, ids=str)
def test_flat_positions_and_padding(case):
    low, states = random_free(case)
    for neighbourhood in neighbourhoods(case):
        graph = LatticeGraph.from_states(case.lattice, low, states, neighbourhood=neighbourhood)
        cells = np.argwhere(np.ones(states.shape, bool)) + low
        flat = graph.index_to_flat(cells)
        assert len(set(flat.tolist())) == len(cells) and flat.min() >= 0
        assert (graph.flat_to_index(flat) == cells).all()
        assert (graph.free[flat] == states.ravel()).all() and graph.free.sum() == states.sum()
        assert (graph.inner_states() == states).all() and (graph._inner_flat() == flat).all()
        assert np.allclose(graph.centres(flat), case.lattice.centres(cells))
        # No offset leaves the array or wraps: each leads where the index says.
        shape = tuple(graph.shape)
        inner = np.array(np.unravel_index(flat, shape)).T
        for move, offset in zip(graph.moves, graph.offsets, strict=True):
            there = np.array(np.unravel_index(flat + offset, shape)).T
            assert (there == inner + move).all()
        for offset in graph.swept:
            there = np.array(np.unravel_index(flat + offset, shape)).T - inner
            assert (there == there[0]).all()
        outside = np.concatenate([low[None] - 1, low[None] + states.shape, np.full((1, case.dim), 2**62)])
        assert (graph.index_to_flat(outside) == -1).all()
        assert graph.memory >= graph.size


def test_windows_that_are_too_large_say_their_size():
    square, cube = Lattice.named("Z2"), Lattice.named("D3")
    none = VoxelList.empty(square)
    with pytest.raises(ArgumentError, match=r"400000 x 400000 cells is 160001600004 .*GiB.*at most 2000000000"):
        LatticeGraph.from_voxels(none, [0, 0], [399_999, 399_999])
    with pytest.raises(ArgumentError, match="at most"):
        LatticeGraph.rasterise(lambda p: np.ones(len(p), bool), cube, [0, 0, 0], [6000, 6000, 6000])
    with pytest.raises(ArgumentError, match="at most 99 "):
        LatticeGraph.from_states(square, [0, 0], np.ones((9, 9), bool), max_cells=99)
    with pytest.raises(ArgumentError, match="at most"):
        LatticeGraph.from_cells(VoxelList.from_cells([[0, 0], [10**6, 10**6]], square))
    with pytest.raises(ArgumentError, match="at most"):
        LatticeGraph.from_voxels(none, [-(2**63), 0], [2**63 - 1, 1])
    far = Level(VoxelList.from_cells([[0, 0], [10**6, 10**6]], square), none)
    for unknown in ("blocked", "free"):
        with pytest.raises(ArgumentError, match="at most"):
            LatticeGraph.from_map(Map([far]), unknown=unknown)


def test_windows_at_the_end_of_the_range():
    for name in ("Z2", "D3"):
        lattice = Lattice.named(name)
        edge = lattice.limit - 1
        ones = np.ones((2,) * lattice.dim, bool)
        for low in ([edge - 1] * lattice.dim, [-edge] * lattice.dim):
            graph = LatticeGraph.from_states(lattice, low, ones, neighbourhood="extended")
            assert set(reference.as_tuples(graph.neighbours(low))) <= set(
                reference.as_tuples(graph.flat_to_index(np.flatnonzero(graph.free)))
            )
            assert len(graph.neighbours(low)) and np.isinf(graph.clearance()[graph.free != 0]).all()
        with pytest.raises(BoundsError):
            LatticeGraph.from_states(lattice, [edge] * lattice.dim, ones)


def test_arguments_that_do_not_fit():
    square = Lattice.named("Z2")
    graph = LatticeGraph.from_states(square, [0, 0], np.ones((3, 3), bool))
    for wrong in (
        lambda: LatticeGraph.from_states(square, [0, 0], np.ones((3, 3))),
        lambda: LatticeGraph.from_states(square, [0, 0], np.ones(3, bool)),
        lambda: LatticeGraph.from_states(square, [0.5, 0], np.ones((3, 3), bool)),
        lambda: LatticeGraph.from_states(square, [0, 0], np.ones((0, 3), bool)),
        lambda: LatticeGraph.from_voxels(VoxelList.empty(square), [1, 0], [0, 0]),
        lambda: LatticeGraph.from_cells(VoxelList.empty(square)),
        lambda: LatticeGraph.from_map(Map([Level(VoxelList.empty(square), VoxelList.empty(square))])),
        lambda: LatticeGraph.rasterise(lambda p: p[:, 0] > 0, square, [0, 0], [np.nan, 1]),
        lambda: LatticeGraph.rasterise(lambda p: p > 0, square, [0, 0], [1, 1]),
        lambda: LatticeGraph.rasterise(lambda p: p[:, 0] > 0, square, [0.2, 0.2], [0.4, 0.4]),
        lambda: graph.index_to_flat([[0.0, 0.0]]),
        lambda: graph.neighbours([0, 0, 0]),
        lambda: graph.flat_to_index([graph.size]),
        lambda: graph.with_clearance(-1.0),
        lambda: graph.with_clearance(math.inf),
        lambda: graph.with_soft_clearance(0.0, 1.0),
        lambda: graph.with_terrain(np.ones((2, 2))),
        lambda: graph.with_terrain(np.zeros((3, 3))),
        lambda: graph.with_terrain(lambda p: np.full(len(p), np.nan)),
        lambda: graph.with_terrain(lambda p: np.ones(3)),
        lambda: graph.with_terrain(lambda p: 1.0),
        lambda: swept_cells(square, [1, 1, 1]),
    ):
        with pytest.raises(ArgumentError):
            wrong()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_one_cell_and_all_blocked_windows(case):
    here = [-5] * case.dim
    for neighbourhood in neighbourhoods(case):
        for value in (0, 1):
            states = np.full((1,) * case.dim, value, np.uint8)
            graph = LatticeGraph.from_states(case.lattice, here, states, neighbourhood=neighbourhood)
            assert graph.neighbours(here).shape == (0, case.dim)
            assert graph.connected(here, here) == bool(value)
            assert graph.components().max() == value - 1
            matrix, nodes = graph.to_csr()
            assert matrix.shape == (value, value) and matrix.nnz == 0 and len(nodes) == value
            assert graph.to_networkx().number_of_nodes() == value
            assert graph.clearance()[graph.index_to_flat([here])[0]] == (math.inf if value else 0.0)
            assert graph.with_clearance(1.0).free.sum() == value
            soft = graph.with_terrain(lambda p: np.full(len(p), 2.0)).with_soft_clearance(1.0, 5.0)
            assert soft.least_terrain == (2.0 if value else 1.0)


# ---------------------------------------------------------------------- constructors


@pytest.mark.parametrize("case", CASES, ids=str)
def test_from_map_with_unknown_cells_blocked_and_free(case):
    rng = np.random.default_rng(3)
    cells = np.argwhere(np.ones((7,) * case.dim, bool)) - 9
    chosen = rng.permutation(len(cells))
    half = len(cells) // 3
    walls, opened = cells[chosen[: half // 4]], cells[chosen[half // 8 : half]]
    hits, passes = VoxelList.from_cells(walls, case.lattice), VoxelList.from_cells(opened, case.lattice)
    map = Map([Level(hits, passes)])
    rule = StateRule(min_ratio=0.6)
    for given in (None, rule):
        states = map.state(given)
        blocked = LatticeGraph.from_map(map, rule=given)
        nodes = blocked.flat_to_index(np.flatnonzero(blocked.free))
        assert reference.as_tuples(nodes) == reference.as_tuples(states.free.index)
        known = np.concatenate([states.occupied.index, states.free.index])
        assert (blocked.index_to_flat(known) >= 0).all()
        opened_up = LatticeGraph.from_map(map, rule=given, unknown="free", neighbourhood="extended")
        centres = case.lattice.centres(known)
        everywhere = np.argwhere(np.ones((25,) * case.dim, bool)) - 18
        x = case.lattice.centres(everywhere)
        inside = ((x >= centres.min(axis=0) - 1e-9) & (x <= centres.max(axis=0) + 1e-9)).all(axis=1)
        expected = everywhere[inside & ~states.occupied.contains(everywhere)]
        nodes = opened_up.flat_to_index(np.flatnonzero(opened_up.free))
        assert reference.as_tuples(nodes) == reference.as_tuples(expected)
        # Clearance is that from occupied cells, in both.
        for graph in (blocked, opened_up):
            flat = np.flatnonzero(graph.free)
            away = np.linalg.norm(graph.centres(flat)[:, None] - states.occupied.centres(), axis=2).min(axis=1)
            assert np.allclose(graph.clearance()[flat], away)
    with pytest.raises(ArgumentError):
        LatticeGraph.from_map(map, unknown="maybe")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError):
        LatticeGraph.from_map(map, level=1)


def test_from_map_without_a_free_cell_and_at_a_coarser_level():
    fine, coarse = Lattice.named("A2", 0.1), Lattice.named("A2", 0.2)
    empty = VoxelList.empty(fine)
    map = Map(
        [
            Level(VoxelList.from_cells([[4, 4]], fine), empty),
            Level(VoxelList.from_cells([[2, 2]], coarse), VoxelList.from_cells([[1, 1]], coarse)),
        ]
    )
    assert LatticeGraph.from_map(map).free.sum() == 0
    graph = LatticeGraph.from_map(map, level=1)
    assert graph.lattice == map.levels[1].lattice
    assert graph.flat_to_index(np.flatnonzero(graph.free)).tolist() == [[1, 1]]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_from_voxels_from_cells_and_rasterise_agree_with_states(case):
    low, states = random_free(case, seed=5)
    cells = np.argwhere(np.ones(states.shape, bool)) + low
    same = LatticeGraph.from_states(case.lattice, low, states)
    walls = VoxelList.from_cells(np.concatenate([cells[~states.ravel()], [low - 3]]), case.lattice)
    boxed = LatticeGraph.from_voxels(walls, low, low + states.shape - 1)
    assert (boxed.free == same.free).all() and (boxed.low == same.low).all()
    # The wall outside the box counts for clearance.
    x, w = case.lattice.centres(cells), walls.centres()
    flat = same.index_to_flat(cells)
    assert np.allclose(boxed.clearance()[flat], np.linalg.norm(x[:, None] - w, axis=2).min(axis=1))
    listed = LatticeGraph.from_cells(VoxelList.from_cells(cells[states.ravel()], case.lattice))
    nodes = [reference.as_tuples(g.flat_to_index(np.flatnonzero(g.free))) for g in (same, listed)]
    assert nodes[0] == nodes[1]
    everywhere = np.argwhere(np.ones(np.array(states.shape) + 8, bool)) + low - 4
    solid = everywhere[~np.isin(np.arange(len(everywhere)), np.flatnonzero(same.index_to_flat(everywhere) >= 0))]
    solid = case.lattice.centres(np.concatenate([solid, cells[~states.ravel()]]))
    flat = np.flatnonzero(listed.free)
    away = np.linalg.norm(listed.centres(flat)[:, None] - solid, axis=2).min(axis=1)
    assert np.allclose(listed.clearance()[flat], away)

    r = case.lattice.resolution
    free_at = lambda p: np.sin(7.0 * p.sum(axis=1) / r) > -0.4
    box = np.full(case.dim, -2.3 * r), np.full(case.dim, 3.1 * r)
    graph = LatticeGraph.rasterise(free_at, case.lattice, *box)
    wide = np.argwhere(np.ones((31,) * case.dim, bool)) - 15
    x = case.lattice.centres(wide)
    inside = ((x >= box[0]) & (x <= box[1])).all(axis=1)
    nodes = graph.flat_to_index(np.flatnonzero(graph.free))
    assert reference.as_tuples(nodes) == reference.as_tuples(wide[inside & free_at(x)])
    away = np.linalg.norm(graph.centres(np.flatnonzero(graph.free))[:, None] - x[inside & ~free_at(x)], axis=2)
    assert np.allclose(graph.clearance()[graph.free != 0], away.min(axis=1))


# ---------------------------------------------------------------------- csr, networkx, components


@pytest.mark.parametrize("case", GRAPH_CASES, ids=str)
def test_csr_networkx_and_components(case, sweeps):
    low, states = random_free(case, seed=11, blocked=0.45)
    free = {tuple(int(v) for v in row) for row in np.argwhere(states) + low}
    terrain = np.random.default_rng(2).uniform(0.5, 3.0, states.shape)
    for neighbourhood, rough in itertools.product([None, "nearest", "extended"], [False, True]):
        graph = LatticeGraph.from_states(case.lattice, low, states, neighbourhood=neighbourhood)
        if rough:
            graph = graph.with_terrain(terrain)
        matrix, nodes = graph.to_csr()
        assert matrix.has_sorted_indices and (abs(matrix - matrix.T) > 1e-15).nnz == 0
        names = reference.as_tuples(graph.flat_to_index(nodes))
        expected = brute_moves(case, graph, free, sweeps(case, graph.moves))
        assert set(names) == free and matrix.nnz == sum(map(len, expected.values()))
        out = graph.to_networkx()
        assert set(out.nodes) == free and out.number_of_edges() * 2 == matrix.nnz
        for a, row in zip(names, range(len(names)), strict=True):
            for b, cost in zip(matrix[row].indices, matrix[row].data, strict=True):
                assert names[b] in expected[a] and out.edges[a, names[b]]["weight"] == cost
                length = np.linalg.norm(case.lattice.basis @ np.subtract(names[b], a))
                mean = (terrain[tuple(a - low)] + terrain[tuple(names[b] - low)]) / 2 if rough else 1.0
                assert cost == pytest.approx(length * mean, rel=1e-12)
        fields = dijkstra(matrix, indices=0)
        lengths = nx.single_source_dijkstra_path_length(out, names[0])
        assert {n: d for n, d in zip(names, fields, strict=True) if np.isfinite(d)} == pytest.approx(lengths)

        count, labels = connected_components(matrix, directed=False)
        found = graph.components()
        assert found.dtype == np.int32 and (found[graph.free == 0] == -1).all() and found.max() == count - 1
        # scipy may number them otherwise, but the pairs must be one to one.
        assert len(set(zip(labels.tolist(), found[nodes].tolist(), strict=True))) == count
        for k in range(0, len(names), 7):
            assert graph.connected(names[0], names[k]) == (labels[0] == labels[k])
        assert not graph.connected(names[0], low - 9)


# ---------------------------------------------------------------------- clearance and terrain


@pytest.mark.parametrize("case", GRAPH_CASES, ids=str)
def test_clearance_is_exact(case, monkeypatch):
    low, states = random_free(case, seed=8, blocked=0.06)
    states[:3] = True  # somewhere with room
    states[-2:] = False  # and a wall with an inside
    graph = LatticeGraph.from_states(case.lattice, low, states)
    cells = np.argwhere(np.ones(states.shape, bool)) + low
    flat = graph.index_to_flat(cells)
    x = case.lattice.centres(cells)
    away = np.linalg.norm(x[:, None] - x[~states.ravel()], axis=2).min(axis=1)
    found = graph.clearance()
    assert np.allclose(found[flat], away) and found.shape == (graph.size,)
    assert (np.delete(found, flat) == 0.0).all()
    assert len(graph.obstacles()) <= (~states).sum()
    step = float(graph.lengths[0])
    for radius in (0.0, 0.5 * step, step, 1.7 * step, 2 * step, 4.1 * step):
        expected = states.ravel() & ~(away < radius * (1 - 1e-9))
        wide = graph.with_clearance(radius)
        assert (wide.free[flat] == expected).all()
        monkeypatch.setattr("hexmap.graph.clearance._BALL", 0)  # the search tree instead
        assert (graph.with_clearance(radius).free == wide.free).all()
        monkeypatch.undo()
        # What was blocked for the radius is no obstacle: the clearance stays that from the walls.
        assert (wide.clearance() == found).all() and (wide.with_clearance(radius).free == wide.free).all()
    assert (graph.free[flat] == states.ravel()).all()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_terrain_and_soft_clearance(case):
    low, states = random_free(case, seed=4, blocked=0.1)
    graph = LatticeGraph.from_states(case.lattice, low, states)
    nodes = np.flatnonzero(graph.free)
    cost = lambda p: 2.0 + np.abs(p[:, 0])
    by_function = graph.with_terrain(cost)
    values = cost(graph.centres(nodes))
    assert by_function.terrain is not None and np.array_equal(by_function.terrain[nodes], values)
    assert by_function.least_terrain == values.min() and by_function.terrain.shape == (graph.size,)
    assert np.array_equal(graph.with_terrain(by_function.terrain).terrain, by_function.terrain)
    inner = np.full(states.shape, np.nan)  # blocked cells may hold anything
    inner[states] = values
    assert np.array_equal(graph.with_terrain(inner).terrain, by_function.terrain)
    reach = 2.5 * graph.lengths[0]
    d = graph.clearance()[nodes]
    expected = np.where(d < reach, 1 + 3.0 * np.clip(1 - d / reach, 0, None) ** 2, 1.0)
    assert np.allclose(graph.with_soft_clearance(reach, 3.0).terrain[nodes], expected)
    assert np.allclose(by_function.with_soft_clearance(reach, 3.0).terrain[nodes], expected * values)
    assert graph.terrain is None and graph.with_soft_clearance(reach, 0.0).least_terrain == 1.0


def polytope_distance(points: np.ndarray, normals: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """The distance of points (N, n) to {x : normals x <= heights} (unit normals), by the theorem of Kuhn and Tucker.

    The nearest point lies in the intersection of 0 to n faces' planes, so the least distance over all such
    feet that are in the polytope is it.
    """
    n = points.shape[1]
    best = np.full(len(points), np.inf)
    for m in range(n + 1):
        for chosen in itertools.combinations(range(len(heights)), m):
            A, b = normals[list(chosen)], heights[list(chosen)]
            feet = points - (points @ A.T - b) @ np.linalg.pinv(A, rcond=1e-9).T if m else points
            inside = (feet @ normals.T <= heights + 1e-9 * heights.max()).all(axis=1)
            best = np.where(inside, np.minimum(best, np.linalg.norm(points - feet, axis=1)), best)
    return best


def to_cells(lattice: Lattice, centres: np.ndarray, obstacles: np.ndarray) -> np.ndarray:
    """The distance of points (N, n) to the nearest of the closed Voronoi cells around others, all tried."""
    v = lattice.faces @ lattice.basis.T
    lengths = np.linalg.norm(v, axis=1)
    differences, back = np.unique(
        np.round((centres[:, None] - obstacles).reshape(-1, lattice.dim), 9), axis=0, return_inverse=True
    )
    away = polytope_distance(differences, v / lengths[:, None], lengths / 2)
    return away[back.ravel()].reshape(len(centres), -1).min(axis=1)


@pytest.mark.parametrize("case", GRAPH_CASES, ids=str)
def test_clearance_to_cells_is_exact(case, monkeypatch):
    low, states = random_free(case, seed=8, blocked=0.06)
    states[:3] = True
    states[-2:] = False
    graph = LatticeGraph.from_states(case.lattice, low, states)
    cells = np.argwhere(np.ones(states.shape, bool)) + low
    flat = graph.index_to_flat(cells)
    x, free = case.lattice.centres(cells), states.ravel()
    away = to_cells(case.lattice, x, x[~free])
    found, to_centres = graph.clearance("cell"), graph.clearance()
    scale = case.lattice.resolution
    assert np.allclose(found[flat], away, rtol=1e-7, atol=1e-7 * scale)
    # Also beneath the surface of the wall.
    assert (found[flat[~free]] == 0.0).all() and (found[flat[free]] > 0.0).all()
    assert found.shape == (graph.size,) and (np.delete(found, flat) == 0.0).all()
    assert np.array_equal(graph.clearance_at(flat, to="cell"), found[flat])
    assert (found[flat] <= to_centres[flat]).all()
    slack = 1e-9 * scale
    assert (found[flat[free]] >= to_centres[flat[free]] - case.lattice.covering_radius - slack).all()
    assert (found[flat[free]] <= to_centres[flat[free]] - case.lattice.inradius + slack).all()
    # At exactly a distance that there is, and between them.
    radii = np.unique(np.round(found[flat[free]], 12))
    for radius in (0.0, *radii[:: max(len(radii) // 5, 1)], 0.7 * scale, 1.9 * scale):
        wide = graph.with_clearance(radius, to="cell")
        assert np.array_equal(wide.free[flat] != 0, free & ~(found[flat] < radius * (1 - 1e-9)))
        monkeypatch.setattr("hexmap.graph.clearance._BALL", 0)  # the search tree instead
        assert np.array_equal(graph.with_clearance(radius, to="cell").free, wide.free)
        monkeypatch.undo()
        assert np.array_equal(wide.clearance("cell"), found)
    for radius in (1e3 * scale, 1e200):
        assert not graph.with_clearance(radius, to="cell").free.any()
    assert (graph.free[flat] == free).all()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_clearance_to_the_cells_of_each_kind_of_graph(case):
    low, states = random_free(case, seed=5, blocked=0.1)
    cells = np.argwhere(np.ones(states.shape, bool)) + low
    x, free = case.lattice.centres(cells), states.ravel()
    # The wall outside the box counts, as it does for centres.
    walls = VoxelList.from_cells(np.concatenate([cells[~free], [low - 1]]), case.lattice)
    opened = VoxelList.from_cells(cells[free], case.lattice)
    away = to_cells(case.lattice, x, walls.centres())
    scale = case.lattice.resolution
    boxed = LatticeGraph.from_voxels(walls, low, low + states.shape - 1)
    mapped = LatticeGraph.from_map(Map([Level(walls, opened)]))
    for graph in (boxed, mapped):
        flat = graph.index_to_flat(cells)
        assert np.allclose(graph.clearance_at(flat, "cell"), away, rtol=1e-7, atol=1e-7 * scale)
        safe = graph.with_clearance(0.8 * scale, "cell")
        assert np.array_equal(safe.free[flat] != 0, (graph.free[flat] != 0) & (away >= 0.8 * scale))
    # Of a list of free cells all others are obstacles, outside the window too.
    listed = LatticeGraph.from_cells(opened)
    around = np.argwhere(np.ones(np.array(states.shape) + 4, bool)) + low - 2
    solid = around[~opened.contains(around)]
    flat = listed.index_to_flat(opened.index)
    away = to_cells(case.lattice, opened.centres(), case.lattice.centres(solid))
    assert np.allclose(listed.clearance_at(flat, "cell"), away, rtol=1e-7, atol=1e-7 * scale)
    # Obstacles that are not what is blocked: a free cell deep in one has no clearance.
    middle = x.mean(axis=0)
    near = lambda p: np.linalg.norm(p - middle, axis=1) < 1.9 * scale
    graph = LatticeGraph.rasterise(
        lambda p: np.ones(len(p), bool), case.lattice, x.min(axis=0), x.max(axis=0), occupied_at=near
    )
    flat = np.flatnonzero(graph.free)
    inside = near(graph.centres(flat))
    found = graph.clearance_at(flat, "cell")
    assert inside.any() and (found[inside] == 0.0).all() and (found[~inside] > 0.0).all()
    assert np.array_equal(graph.with_clearance(0.01 * scale, "cell").free[flat] != 0, found >= 0.01 * scale)


def test_a_robot_kept_off_cells_does_not_overlap_them():
    # The centre of a square's neighbour is half an edge from it.
    states = np.ones((7, 7), np.uint8)
    states[3, 3] = 0
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], states)
    found = graph.clearance("cell")[graph.index_to_flat([[4, 3], [4, 4], [6, 3], [6, 6], [6, 4]])]
    assert found == pytest.approx([0.5, math.sqrt(0.5), 2.5, 2.5 * math.sqrt(2), math.hypot(2.5, 0.5)], rel=1e-14)
    assert graph.with_clearance(0.5, to="cell").free.sum() == 48
    assert graph.with_clearance(0.5001, to="cell").free.sum() == 44
    assert graph.with_clearance(1.0, to="centre").free.sum() == 48
    empty = LatticeGraph.from_states(Lattice.named("D3"), [0, 0, 0], np.ones((2, 2, 2), np.uint8))
    assert np.isinf(empty.clearance("cell")[empty.free != 0]).all()
    assert empty.with_clearance(5.0, "cell").free.sum() == 8 == empty.with_clearance(1e9, "cell").free.sum()
    for wrong in (
        lambda: graph.clearance("edge"),
        lambda: graph.clearance_at([0], "edge"),
        lambda: graph.with_clearance(1.0, "edge"),
        lambda: graph.with_soft_clearance(1.0, 1.0, "edge"),
    ):
        with pytest.raises(ArgumentError, match="centre or cell, not to 'edge'"):
            wrong()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_soft_clearance_to_cells(case):
    graph = LatticeGraph.from_states(case.lattice, *random_free(case, seed=4, blocked=0.1))
    nodes = np.flatnonzero(graph.free)
    reach = 1.7 * graph.lengths[0]
    d = graph.clearance("cell")[nodes]
    soft = graph.with_soft_clearance(reach, 3.0, to="cell")
    assert soft.terrain is not None
    assert np.allclose(soft.terrain[nodes], 1 + 3.0 * np.clip(1 - d / reach, 0, None) ** 2)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_many_obstacles_and_far_cells(case):
    """The search tree with many leaves, against the nearest 60 centres."""
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(1)
    side = max(int((3000 * PART) ** (1 / case.dim)), 4)
    cells = np.argwhere(rng.random((2 * side, *[side] * (case.dim - 1))) < 0.25)
    # All on one side: the other one is far from the lot.
    walls = VoxelList.from_cells(cells[cells[:, 0] < side], case.lattice)
    graph = LatticeGraph.from_voxels(walls, [0] * case.dim, [2 * side - 1] + [side - 1] * (case.dim - 1))
    flat = rng.permutation(np.flatnonzero(graph.free))[: int(100 * PART)]
    x = graph.centres(flat)
    order = cKDTree(walls.centres()).query(x, k=min(60, len(walls)))[1]
    v = case.lattice.faces @ case.lattice.basis.T
    lengths = np.linalg.norm(v, axis=1)
    differences = (x[:, None] - walls.centres()[order]).reshape(-1, case.dim)
    away = polytope_distance(differences, v / lengths[:, None], lengths / 2).reshape(len(x), -1).min(axis=1)
    found = graph.clearance_at(flat, "cell")
    assert np.allclose(found, away, rtol=1e-7, atol=1e-7 * case.lattice.resolution)
    assert np.array_equal(found, graph.clearance("cell")[flat])


def test_threads_may_share_a_fresh_graph() -> None:
    # What a graph finds when it is first asked is asked for by several threads at once.
    rng = np.random.default_rng(1)
    states = rng.random((30, 30)) >= 0.1
    lattice = Lattice.named("A2")
    expected = LatticeGraph.from_states(lattice, [0, 0], states).with_clearance(1.5).free
    labels = LatticeGraph.from_states(lattice, [0, 0], states).components()
    with ThreadPoolExecutor(8) as pool:
        for _ in range(60):
            graph = LatticeGraph.from_states(lattice, [0, 0], states)
            shrunk = [pool.submit(graph.with_clearance, 1.5) for _ in range(6)]
            parts = [pool.submit(graph.components) for _ in range(2)]
            fields = [pool.submit(graph.clearance, to) for to in ("centre", "cell")]
            assert all((future.result().free == expected).all() for future in shrunk)
            assert all((future.result() == labels).all() for future in parts)
            assert all(np.isfinite(future.result()).all() for future in fields)
