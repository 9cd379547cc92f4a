"""Maps in space: a slice shows what the plane cuts, a trajectory goes into pictures and meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.drawing import slice_drawing
from hexmap.drawing.figure_layout import SHADES
from hexmap.drawing.slice_drawing import draw_slice
from hexmap.drawing.solids import renderer as scene
from hexmap.drawing.solids.draw_solids import draw_solids
from hexmap.drawing.solids.mesh import mesh_of_cells
from hexmap.drawing.solids.mesh_files import save_mesh
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Map
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList
from tests.drawing.test_solids import pixels, read_glb
from tests.lattices import JIT, SPATIAL, Case
from tests.mapping import room_in_space

spatial = pytest.mark.parametrize("case", SPATIAL, ids=str)
COLOURS = {CellState.OCCUPIED: SHADES[-2], CellState.FREE: "#ffffff", CellState.UNKNOWN: "#dde3ea"}
RED = np.array([0xE4, 0x57, 0x2E]) / 255.0


@pytest.fixture(autouse=True)
def less_light_without_the_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    if not JIT:
        for name, value in (("_SKY", 8), ("_SUN", 3), ("_GROUND_SIDE", 16.0), ("_MAP_SIDES", (60.0, 3000.0))):
            monkeypatch.setattr(scene, name, value)


def reddish(image: NDArray[np.float64]) -> int:
    return int((np.abs(image - RED).max(axis=2) < 0.02).sum())


@spatial
def test_a_slice_shows_the_cell_that_each_point_of_the_plane_lies_in(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lattice = case.lattice
    cells = lattice.disk([7, -4, 2], 3)
    kind = np.random.default_rng(3).integers(0, 3, len(cells))
    states = States(*(VoxelList.from_cells(cells[kind == k], lattice) for k in (1, 2)))
    z = float(lattice.centres(cells)[:, 2].mean()) + 0.13 * lattice.resolution
    layouts = []
    save = slice_drawing.save_figure
    monkeypatch.setattr(
        slice_drawing, "save_figure", lambda layout, *rest: (layouts.append(layout), save(layout, *rest))
    )
    image = pixels(draw_slice(states, z, tmp_path / "a.png", dpi=40.0))
    (layout,) = layouts
    (width, height), pixel = layout.pixels, (layout.high - layout.low)[0] / layout.pixels[0]
    top = image.shape[0] - round(layout.bottom * layout.dpi) - height
    left = round(layout.left * layout.dpi)
    rows, columns = (grid.ravel() for grid in np.meshgrid(np.arange(height), np.arange(width), indexing="ij"))
    points = np.empty((len(rows), 3))
    points[:, 0] = layout.low[0] + (columns + 0.5) * pixel
    points[:, 1], points[:, 2] = layout.high[1] - (rows + 0.5) * pixel, z
    found = states.of(lattice.quantise(points))
    seen = image[top + rows, left + columns]
    for state, colour in COLOURS.items():
        pure = np.abs(seen - [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]).max(axis=1) < 1e-3
        # The frame is half a pixel wide; what else is of one colour lies in one kind of cells.
        assert (found[pure] == state).mean() > 0.99
        assert pure.sum() > 0.5 * (found == state).sum() > 0


def test_a_slice_is_exact_where_cubes_are_cut(tmp_path: Path) -> None:
    cubes = Lattice.named("Z3", 1.0)
    states = States(VoxelList.from_cells([[9, 0, 0]], cubes), VoxelList.from_cells([[10, 0, 0], [9, 1, 0]], cubes))
    image = pixels(draw_slice(states, 0.49, tmp_path / "a.png", dpi=50.0))
    dark = np.abs(image - [int(SHADES[-2][i : i + 2], 16) / 255.0 for i in (1, 3, 5)]).max(axis=2) < 1e-3
    rows, columns = np.nonzero(dark[: image.shape[0] - 60])
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert dark[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1].mean() > 0.95
    assert abs(int(height) - int(width)) <= 1 and height > 30
    # A hair higher is the next layer, of which nothing is known.
    with pytest.raises(ArgumentError, match=r"no known cell is at the height of 0.51 m; .* between 0.00 and 0.00"):
        draw_slice(states, 0.51, tmp_path / "b.png")


def test_what_is_no_slice(tmp_path: Path) -> None:
    cubes, flat = Lattice.named("Z3", 1.0), Lattice.named("Z2", 1.0)
    states = States(VoxelList.from_cells([[0, 0, 0]], cubes), VoxelList.empty(cubes))
    with pytest.raises(ArgumentError, match=r"as \.png, not as \.svg"):
        draw_slice(states, 0.0, tmp_path / "a.svg")
    with pytest.raises(ArgumentError, match="lattice of the plane"):
        draw_slice(States(VoxelList.empty(flat), VoxelList.empty(flat)), 0.0, tmp_path / "a.png")
    with pytest.raises(ArgumentError, match="the map is empty"):
        draw_slice(States(VoxelList.empty(cubes), VoxelList.empty(cubes)), 0.0, tmp_path / "a.png")
    with pytest.raises(ArgumentError, match="finite height"):
        draw_slice(states, float("nan"), tmp_path / "a.png")
    with pytest.raises(ArgumentError, match=r"in space must be \(N, 3\), not \(2, 2\)"):
        draw_slice(states, 0.0, tmp_path / "a.png", trajectory=[[0.0, 0.0], [1.0, 1.0]])


@pytest.mark.parametrize("name", ["Z3", "D3", "D3*", "A2xZ"])
def test_a_trajectory_is_drawn_where_it_is_seen_and_dotted_where_walls_hide_it(name: str, tmp_path: Path) -> None:
    lattice = Lattice.named(name, 0.25)
    y, z = np.meshgrid(np.arange(-3.0, 3.0, 0.1), np.arange(0.0, 2.0, 0.1))
    wall = VoxelList.from_points(np.stack([np.zeros(y.size), y.ravel(), z.ravel()], axis=1), lattice)
    ink = {}
    for x in (-1.0, 1.0):
        line = [[x, -2.0, 1.0], [x, 2.0, 1.0], [np.nan] * 3, [x, 2.5, 1.0]]
        path = draw_solids(wall, tmp_path / f"{x}.png", view=(0.0, 5.0), size=(400, 300), dpi=80, trajectory=line)
        ink[x] = reddish(pixels(path))
    # Seen from +x; the ends' marks and the legend are the same in both.
    assert ink[1.0] > 1.5 * ink[-1.0] > 0
    assert reddish(pixels(draw_solids(wall, tmp_path / "none.png", size=(400, 300), dpi=80))) == 0


def test_cells_of_others_are_drawn_where_they_lie(tmp_path: Path) -> None:
    cubes = Lattice.named("Z3", 0.5)
    cells = VoxelList.from_cells([[0, 0, 0], [1, 0, 0]], cubes)
    moved = mesh_of_cells(cells).moved(np.array([0.25, 0.25, 10.25]))
    assert np.allclose(moved.vertices.min(axis=0), [0.0, 0.0, 10.0])
    assert moved.volume == pytest.approx(0.25)
    with pytest.raises(ArgumentError, match="no known cell"):
        draw_slice(States(cells, VoxelList.empty(cubes)), 0.1, tmp_path / "a.png", offset=(0.25, 0.25, 10.25))
    draw_slice(States(cells, VoxelList.empty(cubes)), 10.1, tmp_path / "a.png", offset=(0.25, 0.25, 10.25))


def test_a_mesh_takes_the_trajectory_along(tmp_path: Path) -> None:
    mesh = mesh_of_cells(VoxelList.from_cells([[100, 0, 0]], Lattice.named("D3", 0.1)))
    line = np.array([[10.0, 0.0, 0.5], [10.5, 0.0, 0.5], [np.nan] * 3, [11.0, 1.0, 0.5], [11.0, 2.0, 0.5]])
    document, arrays = read_glb(save_mesh(tmp_path / "a.glb", mesh, line))
    assert [node["name"] for node in document["nodes"]] == ["cells", "trajectory"]
    primitive = document["meshes"][1]["primitives"][0]
    assert primitive["mode"] == 1 and document["scenes"][0]["nodes"] == [0, 1]
    places = arrays[primitive["attributes"]["POSITION"]] + np.array(document["nodes"][1]["translation"])
    # Back from y up. The gap is none of the segments.
    assert np.allclose(places[:, [0, 2, 1]] * (1, -1, 1), line[[0, 1, 3, 4]], atol=1e-6)
    header, _, body = save_mesh(tmp_path / "a.ply", mesh, line).read_bytes().partition(b"end_header\n")
    assert b"element edge 2\nproperty int vertex1\nproperty int vertex2\n" in header
    edges = np.frombuffer(body[-16:], "<i4").reshape(2, 2)
    vertices = np.frombuffer(body, np.dtype([("p", "<f8", 3), ("c", "u1", 3)]), count=edges.max() + 1)["p"]
    assert np.array_equal(vertices[edges].reshape(-1, 3), line[[0, 1, 3, 4]])
    assert (
        save_mesh(tmp_path / "b.glb", mesh, line[:1]).read_bytes() == save_mesh(tmp_path / "c.glb", mesh).read_bytes()
    )


@pytest.mark.parametrize("name", ["Z3", "D3", "D3*", "A2xZ"])
def test_a_room_has_free_air_within_its_walls_at_any_height(name: str) -> None:
    made: Map = room_in_space(Lattice.named(name, 0.2))
    states = made.state()
    inside = np.random.default_rng(1).uniform([-1.5, -1.0, 0.5], [0.2, 1.0, 1.6], (500, 3))
    assert (states.of(made.lattice.quantise(inside)) == CellState.FREE).mean() > 0.98
    beyond = np.array([[4.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 3.0, 1.0]])
    assert (states.of(made.lattice.quantise(beyond)) == CellState.UNKNOWN).all()
