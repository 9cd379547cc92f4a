"""Published maps: what the readers make of them, what they refuse, and the graphs that come of them."""

from __future__ import annotations

import gzip
import itertools
import math
import struct
import zlib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hexmap.base.errors import ArgumentError, BoundsError, FileAccessError, FormatError, TooLargeError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.io.grids.grid_map import MAX_CELLS, GridMap
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.grids.ros_yaml import read_entries
from hexmap.io.grids.scenarios import read_scenario
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from tests.lattices import CASES, EXAMPLES, JIT, PART, SHEARED, Case

UNKNOWN, FREE, OCCUPIED = CellState
GRAPH_CASES = [*CASES, *SHEARED]
# Without the compiler only the smallest of the real maps are read.
compiled = pytest.mark.skipif(not JIT, reason="takes minutes without the compiler")


def random_states(rng: np.random.Generator, shape: tuple[int, ...], unknown: bool = True) -> np.ndarray:
    return rng.choice(np.array([OCCUPIED, FREE, FREE, UNKNOWN if unknown else FREE], np.uint8), shape)


def write(path: Path, data: bytes | str) -> Path:
    data = data.encode() if isinstance(data, str) else data
    path.write_bytes(gzip.compress(data) if path.suffix == ".gz" else data)
    return path


def exact_cell(grid: GridMap, point: np.ndarray) -> tuple[int, ...]:
    """The cell of a point of a grid that is not turned, in exact numbers after the rounding to 2^-32."""
    quotient = (point - grid.origin) / grid.cell
    return tuple(math.floor(Fraction(round(Fraction(float(q)) * 2**32), 2**32)) for q in quotient)


def exact_state(grid: GridMap, point: np.ndarray) -> int:
    cell = exact_cell(grid, point)
    inside = all(0 <= c < s for c, s in zip(cell, grid.states.shape, strict=True))
    return int(grid.states[cell]) if inside else OCCUPIED


# ---------------------------------------------------------------------- the value


@pytest.mark.parametrize("dim", [2, 3])
def test_states_of_points_are_those_of_the_exact_cell(dim: int) -> None:
    rng = np.random.default_rng(5)
    grid = GridMap(random_states(rng, (7, 5, 6)[:dim]), 0.1, [0.3, -0.7, 1.1][:dim])
    uniform = rng.uniform(grid.low - 0.2, grid.high + 0.2, (int(800 * PART), dim))
    # Whole centimetres, in three spellings that differ in their last bits: ties.
    ticks = rng.integers(-20, 90, (int(800 * PART), dim))
    spellings = [ticks * 0.01, ticks / 100.0, ticks * 0.1 / 10.0]
    for points in [uniform, *spellings]:
        assert grid.state_at(points).tolist() == [exact_state(grid, p) for p in points]
        assert grid.cell_of(points).tolist() == [list(exact_cell(grid, p)) for p in points]
    assert len({grid.state_at(points).tobytes() for points in spellings}) == 1


def test_a_point_on_a_border_is_in_the_higher_cell() -> None:
    grid = GridMap(np.array([[FREE, OCCUPIED], [OCCUPIED, FREE]], np.uint8), 0.1, [0.0, 0.0])
    points = [[0.1, 0.1], [0.3 - 0.2, 0.05], [0.0, 0.0], [0.2, 0.1], [0.1, 0.2], [-1e-13, 0.0], [-1e-9, 0.0]]
    assert grid.state_at(points).tolist() == [FREE, OCCUPIED, FREE, OCCUPIED, OCCUPIED, FREE, OCCUPIED]


def test_far_and_not_finite_points_are_blocked() -> None:
    grid = GridMap(np.ones((2, 2), np.uint8), 1.0, [0, 0])
    points = np.array([[1, 1], [math.nan, 1], [1, math.inf], [-math.inf, 0], [1e300, 0], [1e18, 1], [-1e18, 1]])
    assert grid.state_at(points).tolist() == [FREE] + [OCCUPIED] * 6
    assert grid.free_at(points, unknown="free").tolist() == [True] + [False] * 6
    for bad in points[[1, 2, 3, 4]]:
        with pytest.raises(BoundsError, match="point 1 is not finite or out of range"):
            grid.cell_of([[0, 0], bad])


def test_unknown_cells_are_what_they_are_said_to_be() -> None:
    grid = GridMap(np.array([[OCCUPIED, FREE, UNKNOWN]], np.uint8), 1.0, [0, 0])
    points = [[0.5, 0.5], [0.5, 1.5], [0.5, 2.5], [0.5, 3.5]]
    assert grid.state_at(points).tolist() == [OCCUPIED, FREE, UNKNOWN, OCCUPIED]
    assert grid.free_at(points).tolist() == [False, True, False, False]
    assert grid.free_at(points, unknown="free").tolist() == [False, True, True, False]
    assert grid.has_unknown
    with pytest.raises(ArgumentError, match="blocked or free, not 'open'"):
        grid.free_at(points, unknown="open")


@pytest.mark.parametrize("dim", [2, 3])
def test_centres_and_cells_are_inverse_also_turned(dim: int) -> None:
    rng = np.random.default_rng(2)
    grid = GridMap(random_states(rng, (4, 6, 3)[:dim]), 0.25, np.arange(dim) - 3.3, yaw=0.7)
    cells = rng.integers(-50, 50, (200, dim))
    assert np.array_equal(grid.cell_of(grid.centre(cells)), cells)
    inside = np.stack(np.indices(grid.states.shape), axis=-1).reshape(-1, dim)
    assert np.array_equal(grid.state_at(grid.centre(inside)), grid.states.ravel())
    low, high = grid.low, grid.high
    for point in (grid.centre(inside - 0.5), grid.centre(inside + 0.5)):
        assert (point >= low - 1e-12).all()
        assert (point <= high + 1e-12).all()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("angle", [0.0, 0.3, -2.0, math.pi / 2, math.pi, 9.0])
@pytest.mark.parametrize("about", [None, "somewhere"])
def test_turning_a_grid_turns_what_lies_at_every_point(dim: int, angle: float, about: str | None) -> None:
    rng = np.random.default_rng(8)
    grid = GridMap(random_states(rng, (9, 4, 3)[:dim]), 0.5, [1.0, -2.0, 0.25][:dim], yaw=0.2, kind="x", y_down=True)
    fixed = np.array([3.0, 1.0, 7.0])[:dim] if about else grid.centre([np.array(grid.states.shape) / 2 - 0.5])[0]
    turned = grid.turned(angle, fixed if about else None)
    assert (turned.kind, turned.y_down, turned.cell) == ("x", True, 0.5)
    rotation = np.eye(dim)
    rotation[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    points = rng.uniform(grid.low - 1, grid.high + 1, (500, dim))
    moved = (points - fixed) @ rotation.T + fixed
    assert np.array_equal(turned.state_at(moved), grid.state_at(points))
    cells = np.stack(np.indices(grid.states.shape), axis=-1).reshape(-1, dim)
    assert np.allclose(turned.centre(cells), (grid.centre(cells) - fixed) @ rotation.T + fixed, atol=1e-12)
    if about is None:
        assert np.allclose((turned.low + turned.high) / 2, (grid.low + grid.high) / 2, atol=1e-12)


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_a_quarter_turn_permutes_the_centres_to_the_last_cell(quarter: int) -> None:
    rng = np.random.default_rng(1)
    grid = GridMap(random_states(rng, (6, 6)), 1.0, [-3, -3])
    turned = grid.turned(quarter * math.pi / 2)
    cells = np.stack(np.indices((6, 6)), axis=-1).reshape(-1, 2)
    assert np.array_equal(
        turned.state_at(grid.centre(cells)).reshape(6, 6), np.rot90(grid.states, quarter, axes=(0, 1))
    )
    graph = turned.to_graph(Lattice.named("Z2", resolution=1.0))
    full = graph.inner_states()
    assert full.sum() == (grid.states == FREE).sum()


def test_a_grid_map_is_a_value() -> None:
    states = np.ones((2, 3), np.uint8)
    grid = GridMap(states, 1, [0, 0])
    states[0, 0] = OCCUPIED
    assert grid.states[0, 0] == FREE
    for array in (grid.states, grid.origin):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    grid.low[0] = 9
    assert grid.low[0] == 0
    states = np.asfortranarray(np.array([[FREE, OCCUPIED], [UNKNOWN, FREE]], np.uint8))
    fortran = GridMap(states, 1.0, [0, 0])
    assert fortran.state_at([[0.5, 1.5], [1.5, 0.5]]).tolist() == [OCCUPIED, UNKNOWN]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((np.ones((2, 2), np.int64), 1.0, [0, 0]), "uint8"),
        ((np.ones(2, np.uint8), 1.0, [0]), "uint8"),
        ((np.ones((0, 2), np.uint8), 1.0, [0, 0]), r"\(0, 2\)"),
        ((np.full((2, 2), 3, np.uint8), 1.0, [0, 0]), "not 3"),
        ((np.ones((2, 2), np.uint8), 0.0, [0, 0]), "positive number of metres, not 0.0"),
        ((np.ones((2, 2), np.uint8), math.inf, [0, 0]), "not inf"),
        ((np.ones((2, 2), np.uint8), "wide", [0, 0]), "not 'wide'"),
        ((np.ones((2, 2), np.uint8), 1.0, [0, 0, 0]), "2 finite numbers"),
        ((np.ones((2, 2), np.uint8), 1.0, [0, math.nan]), "2 finite numbers"),
        ((np.ones((2, 2), np.uint8), 1.0, [0, 0], math.nan), "yaw"),
    ],
)
def test_what_is_no_grid_is_refused(arguments: tuple, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        GridMap(*arguments)


def test_wrong_arguments_of_a_grid_are_refused() -> None:
    grid = GridMap(np.ones((2, 2), np.uint8), 1.0, [0, 0])
    for call in (grid.state_at, grid.centre, grid.cell_of):
        with pytest.raises(ArgumentError, match=r"\(N, 2\), not \(1, 3\)"):
            call([[0, 0, 0]])
        assert len(call([])) == 0
    with pytest.raises(ArgumentError, match="angle"):
        grid.turned(math.nan)
    with pytest.raises(ArgumentError, match="2 finite numbers"):
        grid.turned(1.0, [0, 0, 0])
    with pytest.raises(ArgumentError, match="dimension 2 does not fit Z3"):
        grid.to_graph(Lattice.named("Z3"))
    with pytest.raises(ArgumentError, match="at most 50 are allowed"):
        grid.to_graph(Lattice.named("Z2", resolution=0.1), max_cells=50)


# ---------------------------------------------------------------------- graphs


@pytest.mark.parametrize("case", GRAPH_CASES, ids=str)
@pytest.mark.parametrize("unknown", ["blocked", "free"])
@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_a_graph_is_free_where_the_grid_is_free_at_the_centre(case: Case, unknown: str, yaw: float) -> None:
    rng = np.random.default_rng(11)
    lattice = case.lattice
    shape = ((11, 9, 7) if JIT else (5, 4, 3))[: case.dim]
    grid = GridMap(random_states(rng, shape), 2.0 * lattice.resolution, -3.7 * np.ones(case.dim), yaw=yaw)
    for neighbourhood in (None, "nearest", "faces", "extended") if JIT else ("extended",):
        graph = grid.to_graph(lattice, unknown=unknown, neighbourhood=neighbourhood)
        flat = graph._inner_flat()
        centres = graph.centres(flat)
        assert np.array_equal(graph.free[flat] != 0, grid.free_at(centres, unknown))
        assert graph.free.sum() == graph.free[flat].sum()
        assert graph.free.any()
    # Clearance: from the blocked cells of the grid alone, not from unknown ones nor from the outside.
    cells = grid.cell_of(centres)
    inside = ((cells >= 0) & (cells < np.array(shape))).all(axis=1)
    blocked = centres[inside & (grid.state_at(centres) == OCCUPIED)]
    some = flat[rng.integers(0, len(flat), 200)]
    some = some[graph.free[some] != 0]
    slow = np.array([np.sqrt(((blocked - c) ** 2).sum(axis=1)).min() for c in graph.centres(some)])
    assert np.allclose(graph.clearance_at(some), slow, rtol=1e-12, atol=0)
    assert np.array_equal(graph.clearance_at(some), graph.clearance()[some])


@pytest.mark.parametrize("case", CASES, ids=str)
def test_obstacles_may_be_told_from_what_is_blocked(case: Case) -> None:
    n = case.dim
    low, high = np.zeros(n), np.full(n, 9.0 * case.lattice.resolution)
    middle = high / 2

    def distance(points: np.ndarray) -> np.ndarray:
        return np.sqrt(((points - middle) ** 2).sum(axis=1))

    r = case.lattice.resolution
    # A ball of obstacle with a blocked shell around it that is none, and an obstacle that is free.
    graph = LatticeGraph.rasterise(
        lambda p: distance(p) > 3 * r, case.lattice, low, high, occupied_at=lambda p: distance(p) < 1.5 * r
    )
    flat = graph._inner_flat()
    centres = graph.centres(flat)
    within = ((centres >= low) & (centres <= high)).all(axis=1)
    assert np.array_equal(graph.free[flat] != 0, within & (distance(centres) > 3 * r))
    solid = centres[within & (distance(centres) < 1.5 * r)]
    outside = flat[distance(centres) >= 1.5 * r]
    slow = np.array([np.sqrt(((solid - c) ** 2).sum(axis=1)).min() for c in graph.centres(outside)])
    assert np.allclose(graph.clearance_at(outside), slow, rtol=1e-12, atol=0)
    derived = graph.with_clearance(2 * r)
    assert np.array_equal(derived.clearance_at(outside), graph.clearance_at(outside))
    same = LatticeGraph.rasterise(
        lambda p: distance(p) > 3 * r, case.lattice, low, high, occupied_at=lambda p: distance(p) <= 3 * r
    )
    plain = LatticeGraph.rasterise(lambda p: distance(p) > 3 * r, case.lattice, low, high)
    assert np.array_equal(same.clearance(), plain.clearance())
    assert np.isinf(
        LatticeGraph.rasterise(
            lambda p: distance(p) > 0, case.lattice, low, high, occupied_at=lambda p: p[:, 0] > 1e9
        ).clearance_at(flat[:3])
    ).all()


def test_wrong_answers_and_positions_are_refused() -> None:
    lattice = Lattice.named("A2", resolution=1.0)
    everywhere = lambda p: np.ones(len(p), bool)
    with pytest.raises(ArgumentError, match="occupied_at must answer"):
        LatticeGraph.rasterise(everywhere, lattice, [0, 0], [5, 5], occupied_at=lambda p: np.ones(1, bool))
    graph = LatticeGraph.rasterise(everywhere, lattice, [0, 0], [5, 5])
    for bad in ([-1], [graph.size], [[0]], [0.5]):
        with pytest.raises(ArgumentError, match="flat positions"):
            graph.clearance_at(bad)
    assert graph.clearance_at(np.empty(0, np.int64)).shape == (0,)


@pytest.mark.parametrize(("name", "shape"), [("Z2", (7, 5)), ("Z3", (7, 5, 6))])
@pytest.mark.parametrize("cell", [1.0, 0.1, 0.37, 3.0])
def test_square_and_cubic_graphs_are_the_source_grid_index_for_index(
    tmp_path: Path, name: str, shape: tuple[int, ...], cell: float
) -> None:
    rng = np.random.default_rng(4)
    states = random_states(rng, shape, unknown=False)
    path = write_map(tmp_path, states)
    grid = open_grid(path, cell=cell)
    assert np.array_equal(grid.states, states)
    for neighbourhood in (None, "extended", 8 if len(shape) == 2 else 26):
        graph = grid.to_graph(Lattice.named(name, resolution=cell), neighbourhood=neighbourhood)
        assert graph.first.tolist() == [0] * len(shape)
        assert np.array_equal(graph.inner_states(), states == FREE)
    fine = grid.to_graph(Lattice.named(name, resolution=cell / 3))
    # A third of a cell: the middle one of three has the source cell's own centre.
    middle = np.stack(np.indices(shape), axis=-1).reshape(-1, len(shape)) * 3
    assert np.array_equal(fine.free[fine.index_to_flat(middle)], states.ravel() == FREE)


@pytest.mark.parametrize("cell", [1.0, 0.1, 0.37])
def test_centres_on_the_border_of_the_grid_belong_to_one_side_only(cell: float) -> None:
    # Half cells have centres on the low and the high border: the low one is in, the high one is not.
    grid = GridMap(np.ones((4, 4), np.uint8), cell, [-0.5 * cell] * 2)
    graph = grid.to_graph(Lattice.named("Z2", resolution=cell / 2))
    assert graph.inner_states().sum() == 64
    assert graph.first.tolist() == [-1, -1]
    assert np.isinf(graph.clearance_at(graph._inner_flat())).all()


# ---------------------------------------------------------------------- MovingAI and Warframe


def movingai_text(states: np.ndarray, end: str = "\n") -> str:
    rows = ["".join(("@" if v == OCCUPIED else ".") for v in column) for column in states.T]
    return end.join(["type octile", f"height {states.shape[1]}", f"width {states.shape[0]}", "map", *rows]) + end


def warframe_text(states: np.ndarray, end: str = "\n") -> str:
    lines = [" ".join(map(str, v)) for v in np.argwhere(states == OCCUPIED).tolist()]
    return end.join([f"voxel {' '.join(map(str, states.shape))}", *lines]) + end


def write_map(folder: Path, states: np.ndarray, suffix: str = "") -> Path:
    flat = states.ndim == 2
    return write(
        folder / f"{'a.map' if flat else 'a.3dmap'}{suffix}", movingai_text(states) if flat else warframe_text(states)
    )


@settings(max_examples=EXAMPLES, deadline=None)
@given(
    hnp.arrays(
        np.uint8, hnp.array_shapes(min_dims=2, max_dims=3, max_side=9), elements=st.sampled_from([OCCUPIED, FREE])
    ),
    st.sampled_from(["\n", "\r\n"]),
    st.booleans(),
    st.booleans(),
)
def test_grids_come_back_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, states: np.ndarray, end: str, packed: bool, cut: bool
) -> None:
    folder = tmp_path_factory.getbasetemp()
    text = movingai_text(states, end) if states.ndim == 2 else warframe_text(states, end)
    text = text.removesuffix(end) if cut else text + end
    path = write(folder / (("grid.map" if states.ndim == 2 else "grid.3dmap") + (".gz" if packed else "")), text)
    grid = open_grid(path)
    assert np.array_equal(grid.states, states)
    assert grid.cell == 1.0
    assert grid.origin.tolist() == [-0.5] * states.ndim
    assert (grid.kind, grid.y_down) == (("movingai", True) if states.ndim == 2 else ("warframe", False))
    assert grid.path == str(path)


def test_the_kind_is_in_the_content_not_in_the_name(tmp_path: Path) -> None:
    states = np.array([[FREE, OCCUPIED], [FREE, FREE]], np.uint8)
    for name in ("odd.txt", "odd", "odd.bt", "odd.map"):
        assert np.array_equal(open_grid(write(tmp_path / name, movingai_text(states))).states, states)
    packed = gzip.compress(movingai_text(states).encode())
    assert np.array_equal(open_grid(write(tmp_path / "no_gz.map", packed)).states, states)


def test_terrain_of_movingai(tmp_path: Path) -> None:
    path = write(tmp_path / "a.map", "type octile\nwidth 7\nheight 1\nmap\n.GS@OTW")
    assert open_grid(path).states.ravel().tolist() == [FREE] * 3 + [OCCUPIED] * 4


HEAD = "type octile\nheight 2\nwidth 3\nmap\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.map", "height 2\nwidth 3\nmap\n...\n...\n", "line 1: a MovingAI map begins with 'type octile'"),
        ("a.map", "type tile\nheight 2\nwidth 3\nmap\n", "line 1: only maps of type octile are read, not 'type tile'"),
        ("a.map", "type octile\nheight two\nwidth 3\nmap\n", "line 2: .*not 'height two'"),
        ("a.map", "type octile\nheight -2\nwidth 3\nmap\n", "line 2: .*not 'height -2'"),
        ("a.map", "type octile\nheight 2\nheight 3\nmap\n", "line 3: .*not 'height 3'"),
        ("a.map", "type octile\nheight 2", "line 3: .*the end of the file"),
        ("a.map", "type octile", "line 2: .*the end of the file"),
        ("a.map", "type octile\nheight 2\nwidth 0\nmap\n", "line 3: the map is empty: its width is 0"),
        ("a.map", "type octile\nheight 2\nwidth 3\n...\n...\n", "line 4: 'map' belongs here, not '...'"),
        ("a.map", "type octile\nheight 2\nwidth 3", "line 4: 'map' belongs here, not the end of the file"),
        ("a.map", HEAD + "...\n", "line 5: the map ends after 1 rows, its height is 2"),
        ("a.map", HEAD, "line 4: the map ends after 0 rows, its height is 2"),
        ("a.map", HEAD + "...\n...\n...\n", "line 7: the map ends after 3 rows, its height is 2"),
        ("a.map", HEAD + "...\n....\n", "line 6: row 1 has 4 characters, the width is 3"),
        ("a.map", HEAD + "..\n...\n", "line 5: row 0 has 2 characters, the width is 3"),
        ("a.map", HEAD + "...\n.x.\n", "line 6: column 1 is 'x'"),
        ("a.map", HEAD + "...\n.\x07.\n", r"line 6: column 1 is '\\x07'"),
        ("a.map", "", "the file is empty"),
        ("a.map.gz", "", "the file is empty"),
        ("a.3dmap", "vox 2 2 2\n", "line 1: a voxel map begins with 'voxel X Y Z', not with 'vox 2 2 2'"),
        ("a.3dmap", "voxel 2 2\n", "line 1: .*not with 'voxel 2 2'"),
        ("a.3dmap", "voxel 2 2 2.5\n", "line 1: .*not with 'voxel 2 2 2.5'"),
        ("a.3dmap", "voxel 2 0 2\n", "line 1: the map is empty: 2 x 0 x 2"),
        ("a.3dmap", "voxel 2 3 4\n0 0 0\n1 3 0\n", "line 3: the voxel '1 3 0' is out of bounds: y goes from 0 to 2"),
        ("a.3dmap", "voxel 2 3 4\n0 0 -1\n", "line 2: the voxel '0 0 -1' is out of bounds: z"),
        ("a.3dmap", "voxel 2 3 4\n0 0 99999999999999999999999999\n", "line 2: .*out of bounds: z goes from 0 to 3"),
        ("a.3dmap", "voxel 2 3 4\n0 0 1.5\n", "line 2: z is '1.5', which is no integer"),
        ("a.3dmap", "voxel 2 3 4\n\n0 x 1\n", "line 3: y is 'x', which is no integer"),
        ("a.3dmap", "voxel 2 3 4\n0 0\n0 0 1\n", "line 2: a voxel is three integers, not '0 0'"),
        ("a.3dmap", "voxel 2 3 4\n0 0 1\n0 0", "line 3: a voxel is three integers, not '0 0'"),
        ("a.3dmap", "voxel 2 3 4\n0 0 1 1\n", "line 2: a voxel is three integers, not '0 0 1 1'"),
        ("a.txt", "hello\n", r"of no known kind \(it begins with 'hello\\n'\); a map is a MovingAI .map"),
        ("a", b"\x00\x01", "of no known kind"),
        ("a.bt", "# Octomap OcTree file\n", "full OctoMap"),
        ("a.scen", "version 1\n", "scenario, the queries of a map; name the map"),
        ("a.pgm", "P5\n1 1\n255\n ", r"name the .yaml of map_server \(a.yaml\)"),
        ("a.png", b"\x89PNG\r\n\x1a\n", "picture alone"),
    ],
)
def test_what_is_wrong_with_a_map_is_said_in_one_line(
    tmp_path: Path, name: str, text: str | bytes, message: str
) -> None:
    path = write(tmp_path / name, text)
    with pytest.raises(FormatError, match=message) as caught:
        open_grid(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for reader in (open_grid, read_scenario):
        with pytest.raises(FileAccessError, match="no such file"):
            reader(tmp_path / "none.map")
        with pytest.raises(FileAccessError, match="cannot be read: Is a directory"):
            reader(tmp_path)
    whole = gzip.compress(movingai_text(np.ones((50, 50), np.uint8)).encode())
    path = write(tmp_path / "cut.map", whole[:-20])
    with pytest.raises(FormatError, match="gzip file is cut off"):
        open_grid(path)
    damaged = bytearray(whole)
    damaged[-6] ^= 0xFF
    with pytest.raises(FormatError, match="gzip file is damaged"):
        open_grid(write(tmp_path / "bad.map", bytes(damaged)))
    with pytest.raises(FormatError, match="gzip file is"):
        open_grid(write(tmp_path / "bad2.map", whole[:10] + b"\xff" * 20))


def test_sizes_are_refused_before_anything_is_allocated(tmp_path: Path) -> None:
    with pytest.raises(TooLargeError, match=r"100000 x 100000 x 100000 cells would take 931322.6 GiB"):
        open_grid(write(tmp_path / "a.3dmap", "voxel 100000 100000 100000\n"))
    with pytest.raises(TooLargeError, match="999999 x 999999"):
        open_grid(write(tmp_path / "a.map", "type octile\nheight 999999\nwidth 999999\nmap\n"))


@pytest.mark.parametrize("cell", [0, -1.0, math.nan, math.inf, "1"])
def test_a_cell_is_a_positive_number(tmp_path: Path, cell: object) -> None:
    with pytest.raises(ArgumentError, match="positive number of metres"):
        open_grid(write_map(tmp_path, np.ones((2, 2), np.uint8)), cell=cell)


# ---------------------------------------------------------------------- ROS


YAML = "image: m.pgm\nresolution: 0.5\norigin: [1.0, -2, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def ros(folder: Path, image: bytes, yaml: str = YAML, name: str = "m.pgm") -> GridMap:
    write(folder / name, image)
    return open_grid(write(folder / "m.yaml", yaml))


def test_a_ros_map_has_its_top_row_at_the_largest_y(tmp_path: Path) -> None:
    grid = ros(tmp_path, b"P5\n# made by hand\n3 2\n255\n" + bytes([0, 254, 205, 254, 254, 0]))
    assert grid.states.tolist() == [[FREE, OCCUPIED], [FREE, FREE], [OCCUPIED, UNKNOWN]]
    assert (grid.cell, grid.origin.tolist(), grid.yaw) == (0.5, [1.0, -2.0], 0.0)
    assert (grid.kind, grid.y_down) == ("ros", False)
    assert grid.state_at([[1.25, -1.25], [2.25, -1.25], [2.25, -1.75]]).tolist() == [OCCUPIED, UNKNOWN, OCCUPIED]
    assert grid.low.tolist() == [1.0, -2.0]
    assert grid.high.tolist() == [2.5, -1.0]


def test_a_turned_ros_map(tmp_path: Path) -> None:
    grid = ros(tmp_path, b"P5 3 2 255\n" + bytes([0, 254, 205, 254, 254, 0]), YAML.replace("-2, 0]", "-2, 1.5707963]"))
    assert grid.state_at([[0.25, -1.75]]).tolist() == [OCCUPIED]
    assert np.allclose(grid.low, [0.0, -2.0])
    assert np.allclose(grid.high, [1.0, -0.5])


@pytest.mark.parametrize("maximum", [255, 100, 1, 1000, 65535])
@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_every_grey_is_what_map_server_makes_of_it(
    tmp_path: Path, maximum: int, plain: bool, negate: int, mode: str
) -> None:
    greys = np.unique(np.linspace(0, maximum, 300).astype(int))
    if plain:
        values = "\n".join(f"{g}  # {k}" if k % 3 else str(g) for k, g in enumerate(greys))
        image = f"P2\n# comment\n{len(greys)} # and here\n1\n{maximum}\n{values}\n".encode()
    else:
        image = f"P5\n{len(greys)} 1\n{maximum}\n".encode() + greys.astype(">u2" if maximum > 255 else "u1").tobytes()
    grid = ros(tmp_path, image, YAML.replace("negate: 0", f"negate: {negate}") + f"mode: {mode}\n")

    def expected(grey: int) -> int:
        colour = grey if maximum == 255 else grey * (255.0 / maximum)
        colour = 255 - colour if negate else colour
        if mode == "raw":
            value = int(colour)
            p = value / 100
            if value > 100:
                return UNKNOWN
        else:
            p = (255 - colour) / 255.0
        return OCCUPIED if p > 0.65 else FREE if p < 0.196 else UNKNOWN

    assert grid.states[:, 0].tolist() == [expected(int(g)) for g in greys]


def test_png_images(tmp_path: Path) -> None:
    from matplotlib.image import imsave

    grey = np.array([[0, 254, 205], [254, 254, 0]], np.uint8)
    colour = np.repeat(grey[:, :, None], 3, axis=2)
    imsave(tmp_path / "m.png", colour)
    # matplotlib writes an opaque alpha: map_server counts it in the mode trinary, (3 * 205 + 255) / 4 is free.
    grid = open_grid(write(tmp_path / "m.yaml", YAML.replace("m.pgm", "m.png")))
    assert grid.states.tolist() == [[FREE, OCCUPIED], [FREE, FREE], [OCCUPIED, FREE]]
    grid = open_grid(write(tmp_path / "m.yaml", YAML.replace("m.pgm", "m.png") + "mode: scale\n"))
    assert grid.states.tolist() == [[FREE, OCCUPIED], [FREE, FREE], [OCCUPIED, UNKNOWN]]
    cut = (tmp_path / "m.png").read_bytes()
    for data in (cut[:20], cut[:60]):
        write(tmp_path / "m.png", data)
        with pytest.raises(FormatError, match=r"m.png: the PNG image"):
            open_grid(tmp_path / "m.yaml")


@pytest.mark.parametrize(
    "kind", ["P", "P with alpha", "2 bits", "4 bits", "16 bits", "1 bit", "BMP", "BMP of a palette"]
)
def test_a_picture_of_another_kind_is_the_same_map(tmp_path: Path, kind: str) -> None:
    from PIL import Image

    greys = {"2 bits": [0, 85, 170, 255], "4 bits": [0, 51, 119, 255], "1 bit": [0, 255]}.get(kind, [0, 60, 205, 254])
    values = np.random.default_rng(3).choice(greys, (6, 8)).astype(np.uint8)
    expected = ros(tmp_path, b"P5 8 6 255\n" + values.tobytes())
    picture, options, suffix = Image.fromarray(values), {}, ".bmp" if kind.startswith("BMP") else ".png"
    if kind in ("P", "P with alpha", "BMP of a palette"):
        picture = Image.fromarray((values + 1).astype(np.uint8)).convert("P")
        picture.putpalette([max(0, k // 3 - 1) for k in range(768)])
        options = {"transparency": 3} if "alpha" in kind else {}
    elif kind in ("2 bits", "4 bits"):
        bits = int(kind[0])
        (tmp_path / "m.png").write_bytes(png_of_bits(values // (255 // (2**bits - 1)), bits))
        picture = None
    elif kind == "16 bits":
        picture = Image.fromarray(values.astype(np.uint16) * 257)
    elif kind == "1 bit":
        picture = picture.convert("1")
    if picture is not None:
        picture.save(tmp_path / f"m{suffix}", **options)
    yaml = YAML.replace("m.pgm", f"m{suffix}") + ("mode: scale\n" if "alpha" in kind else "")
    assert np.array_equal(open_grid(write(tmp_path / "m.yaml", yaml)).states, expected.states)
    with pytest.raises(FormatError, match="picture alone"):
        open_grid(tmp_path / f"m{suffix}")


def png_of_bits(values: np.ndarray, bits: int) -> bytes:
    """A PNG of few bits a grey; values (H, W) whose rows fill whole bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    single = ((values[:, :, None] >> np.arange(bits)[::-1]) & 1).astype(np.uint8).reshape(len(values), -1)
    rows = b"".join(b"\0" + row.tobytes() for row in np.packbits(single, axis=1))
    head = struct.pack(">IIBBBBB", values.shape[1], values.shape[0], bits, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def test_a_picture_that_is_too_large_is_refused_by_its_header(tmp_path: Path) -> None:
    data = bytearray(png_of_bits(np.zeros((1, 8), np.uint8), 4))
    data[16:24] = struct.pack(">II", 99_999_999, 99_999_999)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    with pytest.raises(TooLargeError, match="99999999 x 99999999 cells"):
        ros(tmp_path, bytes(data))


@settings(max_examples=EXAMPLES, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, len(YAML)), st.sampled_from("[]{}'\"|>-#&*!%@:\t\n ,?~0a")), min_size=1, max_size=6
    )
)
def test_damaged_yaml_is_one_clear_error_or_a_map(edits: list[tuple[int, str]]) -> None:
    text = YAML
    for at, mark in edits:
        text = text[:at] + mark + text[at:]
    try:
        read_entries(Path("m.yaml"), text.encode())
    except FormatError as error:
        assert str(error).startswith("m.yaml") and "\n" not in str(error)


@pytest.mark.parametrize(
    "yaml",
    [
        "\ufeff%YAML 1.1\n---\n" + YAML,
        YAML.replace("\n", "\r\n"),
        YAML.replace("m.pgm", '"m.pgm"   # the image'),
        YAML.replace("m.pgm", "'m.pgm'").replace("0.5", "5e-1").replace("negate: 0", "negate: false"),
        YAML.replace("[1.0, -2, 0]", "[ +1. ,-2.0,\t.0 ] # x y yaw"),
        YAML.replace("[1.0, -2, 0]", "\n- 1.0\n- -2\n- 0"),
        YAML.replace("[1.0, -2, 0]", "\n  - 1.0\n  - -2\n  - 0"),
        YAML + '\n# a remark\nmode: trinary\nauthor: "somebody: else"\n...\n',
        YAML.replace("m.pgm", "../{folder}/m.pgm"),
        YAML.replace("negate: 0\n", "negate:\t0\t# no\nit's:\t'a\ttab'\n").replace("0.65\n", "0.65\t\n"),
        "{image: m.pgm, resolution: 0.5, origin: [1.0,\n -2, 0], negate: off, occupied_thresh: .65, free_thresh: .196}",
        YAML + "zones:\n  - name: [a, {b: c}]\n    at: [1, 2]\nnote: |\n  two: lines\n  of: text\n",
        YAML + "---\nimage: another.pgm\nresolution: [\n",
        YAML.replace("m.pgm", "&file m.pgm") + "again: *file\nround: &round [*round]\n",
    ],
)
def test_spellings_of_the_yaml_file(tmp_path: Path, yaml: str) -> None:
    grid = ros(tmp_path, b"P5 2 1 255\n\x00\xfe", yaml.replace("{folder}", tmp_path.name))
    assert grid.states.tolist() == [[OCCUPIED], [FREE]]
    assert (grid.cell, grid.origin.tolist(), grid.yaw) == (0.5, [1.0, -2.0], 0.0)


def test_names_with_blanks_and_marks(tmp_path: Path) -> None:
    for name, text in (("my map#1.pgm", "my map#1.pgm"), ("it's.pgm", "'it''s.pgm'"), ('a"b.pgm', '"a\\"b.pgm" # "')):
        assert ros(tmp_path, b"P5 1 1 255\n\xfe", YAML.replace("m.pgm", text), name).states.tolist() == [[FREE]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("resolution: 0.5\n", "", "no 'resolution' in the file"),
        ("free_thresh: 0.196\n", "", "no 'free_thresh' in the file"),
        ("0.5", "fine", "line 2: 'resolution' must be a finite number, not 'fine'"),
        ("0.5", "-0.5", "line 2: the resolution must be positive, not -0.5"),
        ("0.5", "1e999", "line 2: 'resolution' must be a finite number, not '1e999'"),
        ("[1.0, -2, 0]", "[1.0, -2]", r"line 3: 'origin' must be \[x, y, yaw\], not '\[1.0, -2\]'"),
        ("[1.0, -2, 0]", "[1.0, -2, north]", "line 3: 'origin' must be"),
        ("[1.0, -2, 0]", "[1.0, -2, 0", "line 3: the list .* does not end in this line"),
        ("[1.0, -2, 0]", "1.0", "line 3: 'origin' must be"),
        ("negate: 0", "negate: 2", "line 4: 'negate' must be 0 or 1, not '2'"),
        ("negate: 0", "negate 0", "line 4: not 'key: value': 'negate 0'"),
        ("negate: 0", "negate: 0\nnegate: 1", "line 5: 'negate' stands in line 4 already"),
        ("0.65", "0.1", "line 6: thresholds must be 0 <= free_thresh <= occupied_thresh <= 1, not 0.196 and 0.1"),
        ("m.pgm", "'m.pgm", "line 1: the quotes of .* do not match"),
        ("m.pgm", "[m.pgm]", "line 1: the image must be the name of a file"),
        ("m.pgm", "", "line 1: the image must be the name of a file, not ''"),
        ("negate: 0", "negate: 0\nmode: colour", "line 5: the mode is one of trinary, scale, raw, not 'colour'"),
        ("negate: 0", "negate: 0\n- 5", "line 5: not 'key: value': '- 5'"),
        ("negate: 0", "negate: 0\nauthor: a: b", "line 5: not 'key: value': 'author: a: b'"),
        ("negate: 0", "negate: 0x1", "line 4: 'negate' must be 0 or 1, not '0x1'"),
        ("0.5", "1_0", "line 2: 'resolution' must be a finite number, not '1_0'"),
        ("0.5", ".nan", "line 2: 'resolution' must be a finite number, not '.nan'"),
        ("0.5", "{a: 1}", "line 2: 'resolution' must be a finite number, not a nested value"),
        ("[1.0, -2, 0]", "[1.0, -2, [0]]", r"line 3: 'origin' must be \[x, y, yaw\], not a nested value"),
        (YAML, "- image\n", "line 1: not 'key: value': '- image'"),
        ("negate: 0", "negate: *no", "line 4: not 'key: value': 'negate: \\*no' .found undefined alias"),
        ("negate: 0", "note: " + "[" * 2000, "not YAML: maximum recursion|line 4"),
        ("negate: 0", "note: a\x07b", "m.yaml: not YAML: unacceptable character"),
        ("negate: 0", "# " + "x" * 300_000, "bytes are too many for the YAML file of a ROS map"),
    ],
)
def test_what_is_wrong_with_a_yaml_file(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in YAML
    with pytest.raises(FormatError, match=message) as caught:
        ros(tmp_path, b"P5 1 1 255\n\xfe", YAML.replace(old, new, 1))
    assert str(caught.value).startswith(str(tmp_path / "m.yaml"))


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (b"P5\n2 2\n255\n\x00\x00\x00", "cut off: 3 bytes of pixels, 2 x 2 need 4"),
        (b"P5\n2 2\n255", "cut off: 0 bytes"),
        (b"P5\n2 2\n1000\n" + bytes(7), "7 bytes of pixels, 2 x 2 need 8"),
        (b"P5\n2 x\n255\n", "line 2: the height of the image must be an integer, not 'x'"),
        (b"P5\n2 -2\n255\n", "not '-2'"),
        (b"P5\n# c\n2\n", "line 3: the height of the image must be an integer, not the end of the file"),
        (b"P5\n0 2\n255\n", "the image is empty: 0 x 2"),
        (b"P5\n1 1\n0\n\x00", "maximum of the image must be 1 to 65535, not 0"),
        (b"P5\n1 1\n70000\n\x00", "not 70000"),
        (b"P5\n1 1\n100\n\xff", "a pixel is 255, and the image's maximum is 100"),
        (b"P2\n2 1\n255\n1\n", "1 values, and 2 x 1 pixels"),
        (b"P2\n2 1\n255\n1 b\n", "'b', which is no integer"),
        (b"GIF89a", "neither PGM nor PPM nor PNG"),
    ],
)
def test_what_is_wrong_with_an_image(tmp_path: Path, image: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message) as caught:
        ros(tmp_path, image)
    assert str(caught.value).startswith(str(tmp_path / "m.pgm"))


def test_a_ros_map_whose_image_is_missing_or_huge(tmp_path: Path) -> None:
    path = write(tmp_path / "m.yaml", YAML)
    with pytest.raises(FileAccessError, match=r"m.yaml, line 1: the image .*m.pgm: no such file"):
        open_grid(path)
    with pytest.raises(TooLargeError, match="99999999 x 99999999 cells"):
        ros(tmp_path, b"P5\n99999999 99999999\n255\n")
    with pytest.raises(ArgumentError, match="the file says how large its cells are"):
        open_grid(path, cell=1.0)


def test_what_hexmap_exports_comes_back(tmp_path: Path) -> None:
    from hexmap.io.ros_map import export_ros
    from hexmap.maps.map import Level, Map
    from hexmap.maps.voxel_list import VoxelList

    rng = np.random.default_rng(9)
    lattice = Lattice.named("Z2", resolution=0.1)
    lists = []
    for seed in range(2):
        cells = rng.integers(-9, 12, (60 + 90 * seed, 2))
        points = np.repeat(lattice.centres(cells), 3, axis=0)
        lists.append(VoxelList.from_points(points, lattice))
    map = Map([Level(*lists)])
    path, _ = export_ros(map, tmp_path / "x.yaml")
    grid = open_grid(path)
    states = map.state()
    assert (grid.state_at(states.occupied.centres()) == OCCUPIED).all()
    assert (grid.state_at(states.free.centres()) == FREE).all()
    assert [(grid.states == s).sum() for s in (OCCUPIED, FREE)] == [len(states.occupied), len(states.free)]


# ---------------------------------------------------------------------- OctoMap


def octree(
    rng: np.random.Generator, depth: int, focus: int
) -> tuple[bytes, int, list[tuple[tuple[int, ...], int, int]]]:
    """A random tree near one corner of the key space: its bytes, its nodes and its leaves (key, side, state)."""
    leaves: list[tuple[tuple[int, ...], int, int]] = []
    nodes = 0

    def node(level: int, key: tuple[int, int, int]) -> bytes:
        nonlocal nodes
        nodes += 1
        side = 1 << (15 - level)
        kinds = []
        for child in range(8):
            leaf = rng.choice([0, 0, 1, 2])
            on_way = level < 16 - depth and child == focus
            kinds.append(
                3
                if on_way or (level >= 16 - depth and level < 15 and rng.random() < 0.3)
                else 0
                if level < 16 - depth
                else int(leaf)
            )
        below = b""
        for child, kind in enumerate(kinds):
            at = tuple(k + side * ((child >> i) & 1) for i, k in enumerate(key))
            if kind == 3:
                below += node(level + 1, at)
            elif kind:
                nodes += 1
                leaves.append((at, side, FREE if kind == 1 else OCCUPIED))
        bits = sum(kind << (2 * child) for child, kind in enumerate(kinds))
        return bytes([bits & 255, bits >> 8]) + below

    return node(0, (0, 0, 0)), nodes, leaves


def octomap_bytes(tree: bytes, nodes: int, edge: float = 0.05) -> bytes:
    return (
        b"# Octomap OcTree binary file\n# (a comment)\n#\nid OcTree\n"
        + f"size {nodes}\nres {edge}\ndata\n".encode()
        + tree
    )


def small_octree() -> bytes:
    """The bytes of a small tree."""
    tree, nodes, _ = octree(np.random.default_rng(3), 4, 3)
    return octomap_bytes(tree, nodes)


@pytest.mark.parametrize("seed", range(12))
def test_octrees_against_their_leaves(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    tree, nodes, leaves = octree(rng, 4, seed % 8)
    if not leaves:
        pytest.skip("a tree without leaves")
    grid = open_grid(write(tmp_path / "a.bt", octomap_bytes(tree, nodes)))
    low = np.min([key for key, _, _ in leaves], axis=0)
    high = np.max([np.add(key, side) for key, side, _ in leaves], axis=0)
    expected = np.full(high - low, UNKNOWN, np.uint8)
    for key, side, state in leaves:
        a, b, c = key - low
        expected[a : a + side, b : b + side, c : c + side] = state
    assert np.array_equal(grid.states, expected)
    assert (grid.kind, grid.cell) == ("octomap", 0.05)
    key, side, state = leaves[-1]
    centre = (np.array(key) - 32768 + 0.5) * 0.05
    assert grid.state_at([centre]).tolist() == [state]
    assert np.allclose(grid.centre([key - low])[0], centre, atol=1e-9)


def test_what_is_wrong_with_an_octomap(tmp_path: Path) -> None:
    tree, nodes, _ = octree(np.random.default_rng(0), 4, 3)
    good = octomap_bytes(tree, nodes)
    deep = octomap_bytes(b"\x03\x00" * 17, 17)
    cases = [
        (good[:-1], f"cut off: the file ends at byte {len(good) - 1}, after "),
        (octomap_bytes(b"", 5), "cut off"),
        (octomap_bytes(tree, nodes + 1), f"it has {nodes} nodes, the header says {nodes + 1}"),
        (deep, "a node at depth 16 has children"),
        (octomap_bytes(b"\x00\x00", 1), "the map is empty"),
        (octomap_bytes(b"", 0), "the map is empty"),
        (good.replace(b"data\n", b""), "ends with a line 'data', which is missing"),
        (good.replace(b"res 0.05\n", b""), "line 6: the header ends without 'res'"),
        (good.replace(b"size", b"sizes"), "line 7: the header ends without 'size'"),
        (good.replace(b"0.05", b"-1"), "line 6: the resolution must be a positive number, not '-1'"),
        (good.replace(b"0.05", b"nan"), "line 6: .*not 'nan'"),
        (good.replace(b"id OcTree", b"id CountingOcTree"), "line 4: only trees of id OcTree, .*, not 'CountingOcTree'"),
        (
            good.replace(f"size {nodes}".encode(), b"size many"),
            "line 5: the size must be a number of nodes, not 'many'",
        ),
        (b"OctoMap\n" + good, "line 1: an OctoMap begins with"),
    ]
    for k, (data, message) in enumerate(cases):
        path = write(tmp_path / f"{k}.bt", data)
        with pytest.raises(FormatError, match=message) as caught:
            open_grid(path)
        assert str(caught.value).startswith(str(path))
    with pytest.raises(ArgumentError, match=r"a cell of 0.1 m cannot change that"):
        open_grid(write(tmp_path / "a.bt", good), cell=0.1)
    # Two leaves in opposite corners of the key space.
    corners = bytes([0b01, 0b01000000])
    with pytest.raises(TooLargeError, match=r"65536 x 65536 x 65536 cells would take 262144.0 GiB"):
        open_grid(write(tmp_path / "b.bt", octomap_bytes(corners, 3)))


# ---------------------------------------------------------------------- scenarios


SCEN = "version 1\n0\tmaps/a b.map\t3\t2\t0\t0\t2\t1\t2.41421\n4\tmaps/a b.map\t3\t2\t2\t1\t0\t0\t2\n\n"
SCEN3 = "version 1\na.3dmap\n0 0 0 1 2 3 4.5 1.002\n1 2 3 0 0 0 10 1.0\n"


def test_scenarios(tmp_path: Path) -> None:
    for name in ("a.map.scen", "a.scen.gz", "odd.txt"):
        found = read_scenario(write(tmp_path / name, SCEN))
        assert (found.dim, len(found), found.size, found.map_name) == (2, 2, (3, 2), "maps/a b.map")
        assert found.starts.tolist() == [[0, 0], [2, 1]]
        assert found.goals.tolist() == [[2, 1], [0, 0]]
        assert found.lengths.tolist() == [2.41421, 2.0]
        assert found.texts == ("2.41421", "2")
        assert found.decimals.tolist() == [5, 0]
        assert found.lines.tolist() == [2, 3]
        assert found.buckets.tolist() == [0, 4]
    for name in ("a.3dscen", "a.3dscen.gz", "odd.txt"):
        found = read_scenario(write(tmp_path / name, SCEN3))
        assert (found.dim, len(found), found.size, found.map_name) == (3, 2, None, "a.3dmap")
        assert found.starts.tolist() == [[0, 0, 0], [1, 2, 3]]
        assert found.goals.tolist() == [[1, 2, 3], [0, 0, 0]]
        assert found.texts == ("4.5", "10")
        assert found.lines.tolist() == [3, 4]
    spaces = read_scenario(write(tmp_path / "s.scen", "version 1.0\r\n0 m.map 3 2 0 0 2 1 2.41\r\n"))
    assert spaces.map_name == "m.map"


def test_a_scenario_is_checked_against_its_map(tmp_path: Path) -> None:
    scenario = read_scenario(write(tmp_path / "a.scen", SCEN))
    scenario.check(GridMap(np.ones((3, 2), np.uint8), 1.0, [0, 0]))
    with pytest.raises(FormatError, match="made for a map of 3 x 2 cells, the map given has 2 x 3"):
        scenario.check(GridMap(np.ones((2, 3), np.uint8), 1.0, [0, 0]))
    walls = np.ones((3, 2), np.uint8)
    walls[2, 1] = OCCUPIED
    with pytest.raises(FormatError, match=r"a.scen, line 3: the start \(2, 1\) is not free in the map given"):
        scenario.check(GridMap(walls, 1.0, [0, 0]))
    solid = read_scenario(write(tmp_path / "a.3dscen", SCEN3))
    solid.check(GridMap(np.ones((2, 3, 4), np.uint8), 1.0, [0, 0, 0]))
    with pytest.raises(FormatError, match=r"line 3: the goal \(1, 2, 3\) is not in the map given of 9 x 3 x 3"):
        solid.starts.setflags(write=True)
        solid.starts[:] = 0
        solid.check(GridMap(np.ones((9, 3, 3), np.uint8), 1.0, [0, 0, 0]))
    with pytest.raises(FormatError, match="3 coordinates, the map given has 2 dimensions"):
        solid.check(GridMap(walls, 1.0, [0, 0]))


LINE = "0\ta.map\t3\t2\t0\t0\t2\t1\t2.4\n"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.scen", LINE, "line 1: a scenario begins with 'version 1', not with "),
        ("a.scen", "version 2\n" + LINE, "line 1: only scenarios of version 1 are read, not of '2'"),
        ("a.scen", "version 1\n", "no query in the file"),
        (
            "a.scen",
            "version 1\n" + LINE + LINE.replace("\t0\t0", "\t0"),
            "line 3: 8 fields, and a query has 'bucket map",
        ),
        ("a.scen", "version 1\n" + LINE.replace("2.4", "far"), "line 2: the length must be .*not 'far'"),
        ("a.scen", "version 1\n" + LINE.replace("2.4", "nan"), "not 'nan'"),
        ("a.scen", "version 1\n" + LINE.replace("2.4", "-1"), "not '-1'"),
        ("a.scen", "version 1\n" + LINE.replace("\t0\t0", "\t0\t0.5"), "line 2: a coordinate must be .*not '0.5'"),
        (
            "a.scen",
            "version 1\n" + LINE.replace("\t0\t0", "\t3\t0"),
            "line 2: the query 3 0 2 1 leaves its map of 3 x 2",
        ),
        (
            "a.scen",
            "version 1\n" + LINE + LINE.replace("\t3\t2", "\t4\t2"),
            "line 3: a map of 4 x 2 cells, and one of 3 x 2",
        ),
        ("a.scen", "version 1\n" + LINE + LINE.replace("a.map", "b.map"), "line 3: the map is 'b.map', and 'a.map'"),
        ("a.scen", "version 1\n" + LINE.replace("0\ta", "x\ta"), "line 2: the bucket must be .*not 'x'"),
        ("a.3dscen", "version 1\n1 2 3 4 5 6 7 8\n", "line 2: the name of the map belongs here"),
        ("a.3dscen", "version 1\na.3dmap\n1 2 3 4 5 6 7\n", "line 3: 7 fields, and a query has 'sx sy sz"),
        ("a.3dscen", "version 1\na.3dmap\n1 2 3 4 5 z 7 8\n", "line 3: a coordinate must be .*not 'z'"),
        ("a.3dscen", "version 1\na.3dmap\n1 2 3 4 5 6 7 x\n", "line 3: the ratio must be .*not 'x'"),
        ("a.3dscen", "version 1\na.3dmap\n", "no query in the file"),
        ("a.3dscen", "version 1\n", "line 2: the name of the map belongs here, not ''"),
        ("a.3dscen.gz", "", "the file is empty"),
    ],
)
def test_what_is_wrong_with_a_scenario(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = write(tmp_path / name, text)
    with pytest.raises(FormatError, match=message) as caught:
        read_scenario(path)
    assert str(caught.value).startswith(str(path))


# ---------------------------------------------------------------------- real maps


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "shape", "free"),
    [
        ("arena", (49, 49), 2054),
        pytest.param("AR0011SR", (512, 512), 120458, marks=compiled),
        pytest.param("Berlin_0_512", (512, 512), 196667, marks=compiled),
        pytest.param("brc202d", (530, 481), 43151, marks=compiled),
        pytest.param("den520d", (256, 257), 28178, marks=compiled),
        pytest.param("maze512-8-0", (512, 512), 232931, marks=compiled),
        pytest.param("random512-25-0", (512, 512), 195313, marks=compiled),
    ],
)
def test_movingai_maps_and_their_scenarios(data_dir: Path, name: str, shape: tuple[int, int], free: int) -> None:
    path = data_dir / "planning" / "movingai" / f"{name}.map"
    grid = open_grid(path)
    assert grid.states.shape == shape
    assert (grid.states == FREE).sum() == free
    rows = [line for line in path.read_text().splitlines()[4:] if line]
    x, y = np.random.default_rng(0).integers(0, shape, (500, 2)).T
    assert [grid.states[a, b] == FREE for a, b in zip(x, y, strict=True)] == [
        rows[b][a] in ".GS" for a, b in zip(x, y, strict=True)
    ]
    scenario = read_scenario(f"{path}.scen")
    scenario.check(grid)
    graph = grid.to_graph(Lattice.named("Z2", resolution=1.0), neighbourhood=8)
    assert np.array_equal(graph.inner_states(), grid.states == FREE)
    assert graph.first.tolist() == [0, 0]
    # The octile distance is a bound of every published length, to the digits published.
    d = np.sort(np.abs(scenario.goals - scenario.starts), axis=1)
    octile = d[:, 1] + (math.sqrt(2) - 1) * d[:, 0]
    # Six significant digits or two decimals are the fewest that are published.
    assert (scenario.lengths >= octile - np.maximum(0.006, 5e-6 * octile)).all()


@pytest.mark.data
def test_published_lengths_are_those_of_the_graph(data_dir: Path) -> None:
    from scipy.sparse.csgraph import dijkstra

    path = data_dir / "planning" / "movingai" / "arena.map"
    graph = open_grid(path).to_graph(Lattice.named("Z2", resolution=1.0), neighbourhood=8)
    scenario = read_scenario(f"{path}.scen")
    matrix, nodes = graph.to_csr()
    at = np.searchsorted(nodes, graph.index_to_flat(scenario.starts))
    to = np.searchsorted(nodes, graph.index_to_flat(scenario.goals))
    found = dijkstra(matrix, indices=at)[np.arange(len(at)), to]
    assert [f"{v:.6g}" for v in found] == list(scenario.texts)


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "shape", "blocked"),
    [
        ("Simple", (105, 132, 105), 512),
        ("Complex", (246, 154, 205), 46298),
        ("A1", (896, 390, 255), 123236),
    ],
)
def test_warframe_maps_and_their_scenarios(data_dir: Path, name: str, shape: tuple[int, ...], blocked: int) -> None:
    path = data_dir / "planning" / "warframe" / f"{name}.3dmap.gz"
    grid = open_grid(path)
    assert grid.states.shape == shape
    with gzip.open(path, "rt") as handle:
        voxels = np.loadtxt(itertools.islice(handle, 1, None), dtype=np.int64)
    assert len(np.unique(voxels, axis=0)) == blocked == np.count_nonzero(grid.states == OCCUPIED)
    assert (grid.states[tuple(voxels.T)] == OCCUPIED).all()
    scenario = read_scenario(path.with_name(f"{name}.3dmap.3dscen.gz"))
    assert len(scenario) == 10000
    scenario.check(grid)


@pytest.mark.data
@compiled
@pytest.mark.parametrize(
    ("name", "edge", "occupied", "free"), [("fr_079", 0.05, 401_373, 4_807_673), ("geb079", 0.08, 185_673, 950_759)]
)
def test_octomaps_of_real_places(data_dir: Path, name: str, edge: float, occupied: int, free: int) -> None:
    grid = open_grid(data_dir / "maps" / f"{name}.bt")
    assert grid.cell == edge
    assert [np.count_nonzero(grid.states == s) for s in (OCCUPIED, FREE)] == [occupied, free]
    # The box is that of the known voxels.
    for axis in range(3):
        for end in (0, -1):
            assert (np.take(grid.states, end, axis=axis) != UNKNOWN).any()


@pytest.mark.data
@compiled
@pytest.mark.parametrize("name", ["utexas_gdc_1", "willow-2010-02-18-0.10"])
def test_ros_maps_of_real_places(data_dir: Path, name: str) -> None:
    from matplotlib.image import imread

    grid = open_grid(data_dir / "maps" / f"{name}.yaml")
    picture = imread(data_dir / "maps" / f"{name}.pgm")[::-1].T
    for state, grey in ((FREE, 254), (UNKNOWN, 205), (OCCUPIED, 0)):
        assert (grid.states[picture == grey] == state).all()
    graph = grid.to_graph(Lattice.named("A2", resolution=0.2))
    some = np.flatnonzero(graph.free)[::997]
    assert grid.free_at(graph.centres(some)).all()
    # Unknown cells are no obstacles: some are nearer than the nearest wall.
    from scipy.spatial import cKDTree

    flat = graph._inner_flat()
    unknown = graph.centres(flat[grid.state_at(graph.centres(flat)) == UNKNOWN])
    assert (cKDTree(unknown).query(graph.centres(some))[0] < graph.clearance_at(some)).any()
    with pytest.raises(FormatError, match=f"{name.split('.')[0]}.*yaml"):
        open_grid(data_dir / "maps" / f"{name}.pgm")


def test_dense_arrays_are_bounded_by_one_number() -> None:
    assert MAX_CELLS == 2_000_000_000


# ---------------------------------------------------------------------- clearance to the squares themselves


def to_squares(grid: GridMap, points: np.ndarray) -> np.ndarray:
    """The distance of points (N, n) to the nearest of all occupied squares or cubes, turned back, each tried."""
    c, s = math.cos(grid.yaw), math.sin(grid.yaw)
    d = points - grid.origin
    d[:, :2] = d[:, :2] @ np.array([[c, -s], [s, c]])
    best = np.full(len(points), np.inf)
    for cell in np.argwhere(grid.states == OCCUPIED):
        nearest = np.clip(d, cell * grid.cell, (cell + 1) * grid.cell)
        best = np.minimum(best, np.linalg.norm(d - nearest, axis=1))
    return best


# Without the compiler one yaw and the plain lattices must do.
@pytest.mark.parametrize("case", GRAPH_CASES if JIT else CASES, ids=str)
@pytest.mark.parametrize("yaw", [0.0, 0.4, math.pi / 2] if JIT else [0.4])
@pytest.mark.parametrize("scale", [0.4, 2.3])
def test_clearance_is_that_to_the_squares_of_the_grid(
    case: Case, yaw: float, scale: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(3)
    lattice = case.lattice
    # Squares smaller than the lattice's cells, of which some hold no centre, and larger ones.
    r = lattice.resolution
    small, large = ((19, 15, 11), (8, 7, 6)) if JIT else ((9, 8, 7), (6, 5, 4))
    shape = (small if scale < 1 else large)[: case.dim]
    states = random_states(rng, shape)
    states[rng.random(shape) < 0.4] = UNKNOWN
    states[:3, :4] = OCCUPIED  # a solid with an inside
    grid = GridMap(states, scale * r, -3.71 * r * np.ones(case.dim), yaw=yaw)
    graph = grid.to_graph(lattice, unknown="free")
    flat = graph._inner_flat()
    x = graph.centres(flat)
    found = graph.clearance("cell")
    some = rng.permutation(len(flat))[: int(1500 * PART)]
    assert np.allclose(found[flat[some]], to_squares(grid, x[some]), rtol=1e-9, atol=1e-9 * r)
    assert (found[flat][grid.state_at(x, outside=UNKNOWN) == OCCUPIED] == 0.0).all()
    assert np.array_equal(graph.clearance_at(flat, "cell"), found[flat])
    free = graph.free[flat] != 0
    for radius in (0.0, *rng.choice(found[flat[free]], 3 if JIT else 1), 0.3 * r, 1.1 * r):
        wide = graph.with_clearance(radius, to="cell")
        assert np.array_equal(wide.free[flat] != 0, free & ~(found[flat] < radius * (1 - 1e-9)))
        assert wide.free.sum() == wide.free[flat].sum()
        monkeypatch.setattr("hexmap.graph.clearance._BALL", 0)
        assert np.array_equal(graph.with_clearance(radius, to="cell").free, wide.free)
        monkeypatch.undo()
        assert np.array_equal(wide.clearance_at(flat, "cell"), found[flat])
    assert not graph.with_clearance(1e4 * r, to="cell").free.any()


def test_distances_to_squares_in_plain_numbers() -> None:
    states = np.ones((9, 9), np.uint8)
    states[4, 4] = OCCUPIED
    grid = GridMap(states, 1.0, [-0.5, -0.5])
    graph = grid.to_graph(Lattice.named("Z2", resolution=0.5))
    at = graph.index_to_flat([[8, 8], [9, 8], [7, 8], [7, 7], [10, 8], [10, 10], [2, 8]])
    # Half a metre from the centre is the border, and the border has no clearance.
    expected = [0.0, 0.0, 0.0, 0.0, 0.5, math.sqrt(0.5), 2.5]
    assert graph.clearance_at(at, "cell") == pytest.approx(expected, rel=1e-14)
    free = graph.with_clearance(0.5, "cell").free
    assert free[at].tolist() == [0, 0, 0, 0, 1, 1, 1]
    # Nothing is blocked: nothing is near, and what is outside the grid is no obstacle.
    empty = GridMap(np.full((4, 3), UNKNOWN, np.uint8), 1.0, [0, 0]).to_graph(
        Lattice.named("A2", resolution=0.4), unknown="free"
    )
    assert np.isinf(empty.clearance("cell")[empty.free != 0]).all()
    assert np.array_equal(empty.with_clearance(3.0, "cell").free, empty.free)
    # A square that no centre of a coarse lattice fell into is an obstacle all the same.
    lone = GridMap(states, 0.1, [0.03, 0.03]).to_graph(Lattice.named("Z2", resolution=0.35))
    free = lone.free != 0
    assert np.isinf(lone.clearance()[free]).all() and (lone.clearance("cell")[free] < 0.5).all()


@pytest.mark.data
@compiled
@pytest.mark.parametrize("name", ["arena", "den520d"])
def test_a_robot_in_a_published_map_touches_no_square(data_dir: Path, name: str) -> None:
    grid = open_grid(data_dir / "planning" / "movingai" / f"{name}.map").turned(0.3)
    graph = grid.to_graph(Lattice.named("A2", resolution=0.5))
    nodes = np.flatnonzero(graph.with_clearance(0.5, to="cell").free)
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = 0.499999 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    some = graph.centres(nodes)[::7]
    inside = ((some > grid.low + 1) & (some < grid.high - 1)).all(axis=1)
    assert (grid.state_at((some[inside][:, None] + rim).reshape(-1, 2), outside=UNKNOWN) != OCCUPIED).all()
    # By centres alone it did.
    near = np.flatnonzero(graph.with_clearance(0.5).free)
    assert (graph.clearance_at(near, "cell") < 0.3).any()
