"""Values: nothing changes them, counts do not wrap, equal ones have equal hashes, no input loses digits in silence."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, BoundsError, HexmapError, LatticeError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.graph.moves import swept_cells
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.rays import traverse
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Level, Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from hexmap.poses.trajectory import Relations, Trajectory
from planners import Path, any_angle, astar, canonical, dijkstra
from tests.lattices import CASES, Case

each = pytest.mark.parametrize("case", CASES, ids=str)
MOST = 2**63 - 1


def lattice_values(lattice: Lattice) -> Iterator[Any]:
    """Ask a lattice for everything that it hands out."""
    yield from (lattice.basis, lattice.nearest, lattice.faces, lattice.neighbours, lattice.extended)
    yield lattice.point_group
    yield from (lattice.shell(size) for size in lattice.shell_sizes)
    yield from (lattice.cell.vertices, lattice.cell.faces, lattice.cell.normals, *lattice.cell.rings)
    yield from (v for v in (*lattice.ray_tables, *lattice.quantiser_tables) if isinstance(v, np.ndarray))


def map_of(lattice: Lattice) -> Map:
    """Make a map of one hit and one pass."""
    cells = VoxelList.from_cells([[0] * lattice.dim], lattice)
    return Map([Level(cells, cells.shift([1] * lattice.dim))])


# ---------------------------------------------------------------------- immutable


@each
def test_no_array_of_a_lattice_can_be_written_to(case: Case) -> None:
    for lattice in (case.lattice, copy.deepcopy(case.lattice), pickle.loads(pickle.dumps(case.lattice))):
        for array in lattice_values(lattice):
            with pytest.raises(ValueError, match="read-only"):
                array += 1
        assert lattice == case.lattice


@each
def test_values_stay_values_after_pickle_and_deepcopy(case: Case) -> None:
    lattice, n = case.lattice, case.dim
    values: list[tuple[Any, list[str]]] = [
        (VoxelList.from_points(np.eye(n), lattice), ["keys", "counts", "index"]),
        (Scan(0.0, np.eye(n), times=np.zeros(n)), ["points", "no_return", "times"]),
        (Pose.identity(n), ["rotation", "translation"]),
        (GridMap(np.ones((2,) * n, np.uint8), 1.0, np.zeros(n)), ["states", "origin"]),
        (Trajectory.from_poses([0.0], [Pose.identity(n)]), ["stamps", "positions", "quaternions"]),
        (Relations([0.0], [1.0], np.zeros((1, 3)), np.eye(3)[None]), ["from_stamps", "translations", "rotations"]),
    ]
    for value, arrays in values:
        for made in (value, copy.deepcopy(value), copy.copy(value), pickle.loads(pickle.dumps(value))):
            for name in arrays:
                with pytest.raises(ValueError, match="read-only"):
                    getattr(made, name)[...] = 7
    made = pickle.loads(pickle.dumps(map_of(lattice)))
    assert made == map_of(lattice)
    assert not made.levels[0].hits.counts.flags.writeable


@each
def test_attributes_of_values_cannot_be_assigned(case: Case) -> None:
    cells = map_of(case.lattice)
    for value, name in (
        (case.lattice, "basis"), (case.lattice, "name"), (case.lattice.cell, "vertices"),
        (cells.levels[0].hits, "counts"), (cells.levels[0].hits, "lattice"),
        (cells, "levels"), (cells, "frame"), (cells, "provenance"),
    ):  # fmt: skip
        before = getattr(value, name)
        with pytest.raises(AttributeError):
            setattr(value, name, None)
        with pytest.raises(AttributeError):
            delattr(value, name)
        assert getattr(value, name) is before


def test_the_callers_arrays_are_not_shared() -> None:
    squares = Lattice.named("Z2")
    points = np.zeros((1, 2))
    scan = Scan(0.0, points)
    keys, counts = np.zeros(1, np.int64), np.ones(1, np.int64)
    cells = VoxelList(squares, keys, counts)
    states = np.ones((2, 2), np.uint8)
    view = states[:]
    view.setflags(write=False)
    grid = GridMap(view, 1.0, [0, 0])
    points += 1.0
    counts += 1
    states[...] = 2
    assert scan.points.tolist() == [[0.0, 0.0]]
    assert cells.counts.tolist() == [1]
    assert grid.states.max() == 1


# ---------------------------------------------------------------------- equal, and equal hashes


def test_equal_values_have_equal_hashes() -> None:
    a, b = Lattice([[1, 0], [0, 1]]), Lattice([[1, -0.0], [0, 1]])
    assert a == b
    assert hash(a) == hash(b)
    assert Pose.planar(0.0, 0.0, 0.0) == Pose.identity(2)
    assert hash(Pose.planar(0.0, 0.0, 0.0)) == hash(Pose.identity(2))
    assert hash(Pose.planar(-0.0, 0.0, 0.0)) == hash(Pose.identity(2))


# ---------------------------------------------------------------------- counts


@each
def test_no_count_wraps(case: Case) -> None:
    lattice, at = case.lattice, [[0] * case.dim]
    half = VoxelList.from_cells(at, lattice, [2**62])
    with pytest.raises(BoundsError, match=r"add up to 9223372036854775808, beyond 2\^63 - 1"):
        half.merge(half)
    with pytest.raises(BoundsError, match="add up to"):
        VoxelList.from_cells(at * 2, lattice, [2**62, 2**62])
    with pytest.raises(BoundsError, match="at most"):
        VoxelList.from_cells(at, lattice, np.array([2**63], np.uint64))
    most = VoxelList.from_cells(at, lattice, [MOST])
    assert most.counts.tolist() == [MOST]
    assert VoxelList.from_cells(at * 2, lattice, [MOST - 1, 1]) == most
    other = VoxelList.from_cells([[1] * case.dim], lattice, [MOST])
    assert most.merge(other).total == 2 * MOST


def test_hits_and_passes_near_the_end_of_their_range_make_the_same_share() -> None:
    rule = StateRule(min_ratio=0.5)
    hits, passes = np.array([MOST, 1, 2**62]), np.array([1, MOST, 2**62])
    assert rule.occupied(hits, passes).tolist() == [True, False, True]


# ---------------------------------------------------------------------- what is taken


@each
@pytest.mark.parametrize(
    "points",
    [
        np.ma.masked_array(np.zeros((1, 3)), mask=True),
        np.zeros((1, 3), "datetime64[s]"),
        np.zeros((1, 3), complex),
        np.full((1, 3), 2**53 + 1),
        np.full((1, 3), "1"),
        np.full((1, 3), None),
        [[0.0, 0.0, 0.0], [0.0]],
    ],
    ids=["masked", "dates", "complex", "long", "texts", "objects", "ragged"],
)
def test_points_that_numbers_would_say_less_of_are_refused(case: Case, points: Any) -> None:
    given = points if isinstance(points, list) else points[:, : case.dim]
    with pytest.raises(ArgumentError, match="real numbers"):
        case.lattice.quantise(given)
    with pytest.raises(ArgumentError, match="real numbers"):
        Scan(0.0, given)


@each
def test_indices_beyond_int64_are_out_of_range_and_not_others(case: Case) -> None:
    lattice, n = case.lattice, case.dim
    far = np.full((1, n), 2**64 - 1, np.uint64)  # -1, if it wrapped
    cells = VoxelList.from_cells([[-1] * n], lattice)
    assert not cells.contains(far).any()
    with pytest.raises(BoundsError):
        VoxelList.from_cells(far, lattice)
    with pytest.raises(BoundsError):
        lattice.disk(far[0], 1)
    with pytest.raises(BoundsError):
        cells.shift(far[0])
    graph = LatticeGraph.from_states(lattice, [-1] * n, np.ones((3,) * n, np.uint8))
    assert graph.index_to_flat(far).tolist() == [-1]
    assert np.isinf(dijkstra(graph, [0] * n).distance_to(far)).all()
    with pytest.raises(HexmapError, match="outside the map"):
        astar(graph, [0] * n, far[0])


@each
def test_cells_that_are_no_integers_are_not_rounded(case: Case) -> None:
    n = case.dim
    with pytest.raises(ArgumentError):
        swept_cells(case.lattice, [1.5] * n)
    cells = VoxelList.from_cells([[0] * n], case.lattice)
    with pytest.raises(ArgumentError):
        LatticeGraph.from_voxels(cells, [0.5] * n, [2] * n)
    with pytest.raises(ArgumentError):
        cells.select(np.array([0]))


@each
def test_clearances_without_the_padding_are_those_of_their_cells(case: Case) -> None:
    n = case.dim
    graph = LatticeGraph.from_states(case.lattice, [0] * n, np.ones((5,) * n, np.uint8))
    inner = np.full((5,) * n, 100.0)
    inner[(1,) * n] = 7.0
    flat = np.zeros(graph.size)
    graph.box.without_padding(flat, graph.pad)[...] = inner
    goal = case.lattice.neighbours.max(axis=0)

    def by_dijkstra(graph: LatticeGraph, start: Any, end: Any, clearance: Any) -> Path:
        return dijkstra(graph, start).path_to(end, clearance=clearance)

    for find in (astar, canonical, any_angle, by_dijkstra):
        for a, b in (([0] * n, goal), ([1] * n, [1] * n)):
            found = find(graph, a, b, clearance=inner)
            assert found.clearance == find(graph, a, b, clearance=flat).clearance
            with pytest.raises(ArgumentError, match="clearances are"):
                find(graph, a, b, clearance=inner.ravel())

    assert astar(graph, [1] * n, [1] * n, clearance=inner).clearance == 7.0


def test_a_weight_is_a_number() -> None:
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((3, 3), np.uint8))
    for weight in ("2", None, 1j, float("nan")):
        with pytest.raises(ArgumentError, match="weight"):
            astar(graph, [0, 0], [2, 2], weight=weight)  # type: ignore[arg-type]


def test_the_cell_at_the_limit_itself_is_found() -> None:
    rng = np.random.default_rng(5)
    squares = Lattice.named("Z2", 0.1)
    free = rng.random((40, 40)) < 0.8
    free[0, 0] = True
    terrain = rng.uniform(1.0, 2.0, free.shape)
    graph = LatticeGraph.from_states(squares, [0, 0], free, neighbourhood=8).with_terrain(terrain)
    whole = dijkstra(graph, [0, 0])
    reached = graph.flat_to_index(np.flatnonzero(np.isfinite(whole.distance)))
    for cell in reached[:: len(reached) // 60]:
        cost = whole.path_to(cell).cost
        assert np.isfinite(dijkstra(graph, [0, 0], limit=cost).distance_to(cell[None]))[0]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Lattice("abc"),
        lambda: Lattice([[1, 0], [0]]),
        lambda: Lattice([[1, 0], [0, 1j]]),
        lambda: Lattice.named("A2", 10**400),
        lambda: Lattice.named("A2").scaled("2"),
        lambda: Lattice.named("A2").disk([0, 0], 1.5),
        lambda: MapBuilder(Lattice.named("A2"), 2.5),
        lambda: MapBuilder(Lattice.named("A2")).build(frame=5),
        lambda: MapBuilder(Lattice.named("A2")).build(source={"log": object()}),
        lambda: StateRule(min_hits=float("nan")),
        lambda: StateRule(min_hits=1.5),
        lambda: StateRule(min_ratio="0.1"),
        lambda: traverse(Lattice.named("A2"), [["a", "b"]], [[0, 0]]),
    ],
)
def test_what_is_no_value_of_its_kind_is_one_error_of_ours(make: Any) -> None:
    with pytest.raises((ArgumentError, LatticeError)):
        make()
