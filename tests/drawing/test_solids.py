"""Solids: surfaces are watertight and of the right size, files are readable, pictures show what is there."""

from __future__ import annotations

import json
import struct
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError, FileAccessError, MissingDependencyError
from hexmap.drawing.solids import _kernels as kernels
from hexmap.drawing.solids import renderer as scene
from hexmap.drawing.solids.draw_solids import Cut, draw_solids, find_cut, view_solids
from hexmap.drawing.solids.mesh import Mesh, exposed_faces, height_colours, height_range, mesh_of_cells
from hexmap.drawing.solids.mesh_files import save_mesh
from hexmap.drawing.solids.renderer import Camera, directions
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from tests.lattices import JIT, PLANAR, SPATIAL, Case

spatial = pytest.mark.parametrize("case", SPATIAL, ids=str)
SIZE = (320, 240) if JIT else (64, 64)
Z3 = Lattice.named("Z3", resolution=0.1)


def some_cells(lattice: Lattice, seed: int = 0, count: int = 120) -> VoxelList:
    """Cells of a small box, most of which touch others in faces, edges or corners."""
    return VoxelList.from_cells(np.random.default_rng(seed).integers(-3, 4, (count, 3)), lattice)


@pytest.fixture(autouse=True)
def less_light_without_the_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    if not JIT:
        for name, value in (("_SKY", 8), ("_SUN", 3), ("_GROUND_SIDE", 16.0), ("_MAP_SIDES", (60.0, 3000.0))):
            monkeypatch.setattr(scene, name, value)


def pixels(path: Path) -> NDArray[np.float64]:
    from matplotlib.image import imread

    return np.asarray(imread(path)[:, :, :3], np.float64)


def edges(mesh: Mesh) -> NDArray[np.int64]:
    """The directed edges (3 T, 2) of all triangles."""
    return np.concatenate([mesh.triangles[:, k] for k in ([0, 1], [1, 2], [2, 0])]).astype(np.int64)


# ---------------------------------------------------------------------- the mesh


@spatial
def test_one_cell_is_its_polytope(case: Case) -> None:
    mesh = mesh_of_cells(VoxelList.from_cells([[5, -3, 2]], case.lattice))
    cell = case.lattice.cell
    assert mesh.face_count == len(cell.faces)
    assert len(mesh.vertices) == len(cell.vertices)
    assert len(mesh.triangles) == sum(len(ring) - 2 for ring in cell.rings)
    assert mesh.volume == pytest.approx(case.lattice.cell_volume, rel=1e-9)


@spatial
def test_two_neighbours_share_a_face(case: Case) -> None:
    cell = case.lattice.cell
    for vector, ring in zip(cell.faces, cell.rings, strict=True):
        two = VoxelList.from_cells([[0, 0, 0], vector], case.lattice)
        mesh = mesh_of_cells(two)
        assert mesh.face_count == 2 * len(cell.faces) - 2
        assert len(mesh.vertices) == 2 * len(cell.vertices) - len(ring)
        whole = mesh_of_cells(two, hidden=False)
        assert whole.face_count == 2 * len(cell.faces)
        assert len(whole.vertices) == len(mesh.vertices)


@spatial
@pytest.mark.parametrize("seed", range(3))
def test_surface_is_watertight_and_holds_the_volume(case: Case, seed: int) -> None:
    cells = some_cells(case.lattice, seed)
    mesh = mesh_of_cells(cells)
    directed = edges(mesh)
    # Each edge is run through as often one way as the other: there is no hole, and inside is inside everywhere.
    there, n = np.unique(directed, axis=0, return_counts=True)
    back, m = np.unique(directed[:, ::-1], axis=0, return_counts=True)
    assert np.array_equal(there, back) and np.array_equal(n, m)
    assert mesh.volume == pytest.approx(len(cells) * case.lattice.cell_volume, rel=1e-9)


@spatial
def test_triangles_know_their_cell_and_face(case: Case) -> None:
    cells = some_cells(case.lattice)
    mesh = mesh_of_cells(cells)
    corners = mesh.vertices[mesh.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    assert np.allclose(normals, mesh.normals, atol=1e-5)
    middle = corners.mean(axis=1)
    beyond = middle + 1e-3 * case.lattice.resolution * mesh.normals
    inside = middle - 1e-3 * case.lattice.resolution * mesh.normals
    assert np.array_equal(case.lattice.quantise(inside), cells.index[mesh.cells])
    assert not cells.contains(case.lattice.quantise(beyond)).any()
    assert mesh.face_count == exposed_faces(cells).sum()
    assert (np.diff(mesh.faces) >= 0).all() and (np.diff(mesh.cells) >= 0).all()
    assert np.array_equal(np.unique(mesh.triangles), np.arange(len(mesh.vertices)))


def test_corners_at_one_place_are_one_vertex() -> None:
    for case in SPATIAL:
        mesh = mesh_of_cells(some_cells(case.lattice), hidden=False)
        places = np.round(mesh.vertices / (1e-6 * case.lattice.resolution))
        assert len(np.unique(places, axis=0)) == len(places), case


@spatial
def test_cells_at_the_rim_of_the_range(case: Case) -> None:
    rim = case.lattice.limit - 1
    cells = VoxelList.from_cells([[rim, rim, rim], [-rim, -rim, -rim], [rim, -rim, 0]], case.lattice)
    mesh = mesh_of_cells(cells)
    assert mesh.face_count == 3 * len(case.lattice.cell.faces)
    assert len(mesh.vertices) == 3 * len(case.lattice.cell.vertices)


def test_mesh_is_a_value() -> None:
    mesh = mesh_of_cells(some_cells(Z3))
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 0.0
    assert mesh.vertices.dtype == np.float64 and mesh.triangles.dtype == np.int32 and mesh.colours.dtype == np.uint8


def test_empty_mesh() -> None:
    mesh = mesh_of_cells(VoxelList.empty(Z3))
    assert mesh.triangles.shape == (0, 3) and mesh.vertices.shape == (0, 3)
    assert mesh.volume == 0.0 and mesh.face_count == 0


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_cells_of_the_plane_are_no_solids(case: Case, tmp_path: Path) -> None:
    flat = VoxelList.from_cells([[0, 0]], case.lattice)
    for attempt in (lambda: mesh_of_cells(flat), lambda: draw_solids(flat, tmp_path / "a.png"), lambda: find_cut(flat)):
        with pytest.raises(ArgumentError, match="lattice of the plane"):
            attempt()


def test_colours_follow_the_height() -> None:
    column = VoxelList.from_cells([[0, 0, k] for k in range(20)], Z3)
    mesh = mesh_of_cells(column)
    low, high = height_range(column.centres()[:, 2])
    expected = height_colours(column.centres()[:, 2], low, high)
    assert np.array_equal(mesh.colours, expected[mesh.cells])
    # The green of viridis grows with the height.
    assert (np.diff(expected[:, 1].astype(int)) >= 0).all() and expected[-1, 1] > expected[0, 1] + 100


# ---------------------------------------------------------------------- files


def read_ply(path: Path) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """The vertices and faces of a PLY file of triangles, read by what its header says."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    kinds = {"double": "<f8", "uchar": "u1", "int": "<i4"}
    elements: list[tuple[int, list[Any]]] = []
    for line in head.decode().splitlines():
        words = line.split()
        if words[0] == "element":
            elements.append((int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            elements[-1][1].extend([("n", kinds[words[2]]), (words[4], kinds[words[3]], 3)])
        elif words[0] == "property":
            elements[-1][1].append((words[2], kinds[words[1]]))
    out = []
    for count, fields in elements:
        dtype = np.dtype(fields)
        out.append(np.frombuffer(body, dtype, count))
        body = body[count * dtype.itemsize :]
    assert body == b""
    return out[0], out[1]


@spatial
def test_ply_holds_the_mesh(case: Case, tmp_path: Path) -> None:
    mesh = mesh_of_cells(some_cells(case.lattice))
    vertices, faces = read_ply(save_mesh(tmp_path / "a.ply", mesh))
    assert np.array_equal(np.stack([vertices[k] for k in "xyz"], axis=1), mesh.vertices)
    assert (faces["n"] == 3).all()
    assert np.array_equal(faces["vertex_indices"], mesh.triangles)
    assert np.array_equal(np.stack([faces[k] for k in ("red", "green", "blue")], axis=1), mesh.colours)
    assert np.array_equal(faces["cell"], mesh.cells)


def read_glb(path: Path) -> tuple[dict[str, Any], list[NDArray[np.float64]]]:
    """The document and the arrays of a GLB file; all that the format demands of their layout is checked."""
    raw = path.read_bytes()
    magic, version, total = struct.unpack_from("<4sII", raw)
    assert (magic, version, total) == (b"glTF", 2, len(raw))
    size, kind = struct.unpack_from("<I4s", raw, 12)
    assert kind == b"JSON" and size % 4 == 0
    document = json.loads(raw[20 : 20 + size])
    length, kind = struct.unpack_from("<I4s", raw, 20 + size)
    body = raw[28 + size :]
    assert kind == b"BIN\0" and length % 4 == 0 and len(body) == length == document["buffers"][0]["byteLength"]
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        dtype = {5126: "<f4", 5123: "<u2", 5125: "<u4"}[accessor["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        assert view["byteOffset"] % 4 == 0 and (np.dtype(dtype).itemsize * width) % 4 == 0
        assert view["byteLength"] == accessor["count"] * width * np.dtype(dtype).itemsize
        array = np.frombuffer(body, dtype, accessor["count"] * width, view["byteOffset"]).reshape(-1, width)
        arrays.append(array)
    return document, arrays


@spatial
def test_glb_holds_the_mesh(case: Case, tmp_path: Path) -> None:
    cells = some_cells(case.lattice).shift(np.array([1000, -2000, 500]))
    mesh = mesh_of_cells(cells)
    document, (places, normals, colours, index) = read_glb(save_mesh(tmp_path / "a.glb", mesh))
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["attributes"] == {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2} and primitive["indices"] == 3
    position = document["accessors"][0]
    assert position["min"] == places.min(axis=0).tolist() and position["max"] == places.max(axis=0).tolist()
    # Back from y up: x, -z, y.
    absolute = places + np.array(document["nodes"][0]["translation"])
    corners = absolute[index[:, 0]][:, [0, 2, 1]] * (1, -1, 1)
    assert np.allclose(corners.reshape(-1, 3, 3), mesh.vertices[mesh.triangles], atol=1e-5)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    turned = np.cross(places[index[1::3, 0]] - places[index[::3, 0]], places[index[2::3, 0]] - places[index[1::3, 0]])
    assert (np.einsum("ti,ti->t", turned, normals[index[::3, 0]]) > 0).all()
    linear = colours[index[::3, 0]][:, :3] / 65535.0
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(255.0 * encoded - mesh.colours).max() < 0.6
    assert len(places) == sum(len(case.lattice.cell.rings[f]) for f in np.nonzero(exposed_faces(cells))[1])


def test_saving_is_atomic_and_says_what_is_wrong(tmp_path: Path) -> None:
    mesh = mesh_of_cells(some_cells(Z3))
    with pytest.raises(ArgumentError, match=r"\.ply or \.glb, not as \.obj"):
        save_mesh(tmp_path / "a.obj", mesh)
    with pytest.raises(ArgumentError, match="the mesh is empty"):
        save_mesh(tmp_path / "a.glb", mesh_of_cells(VoxelList.empty(Z3)))
    with pytest.raises(FileAccessError, match="there is no folder"):
        save_mesh(tmp_path / "none" / "a.ply", mesh)
    assert list(tmp_path.iterdir()) == []
    assert save_mesh(tmp_path / "A.GLB", mesh).read_bytes() == save_mesh(tmp_path / "b.glb", mesh).read_bytes()


# ---------------------------------------------------------------------- the camera and what it sees


@pytest.mark.parametrize("view", [(-120.0, 35.0), (0.0, 0.0), (77.0, 90.0), (10.0, -30.0)])
def test_camera_is_as_near_as_the_frame_allows(view: tuple[float, float]) -> None:
    places = np.random.default_rng(1).normal(size=(500, 3)) * (5.0, 2.0, 1.0) + (100.0, -50.0, 3.0)
    frame = (20.0, 30.0, 620.0, 400.0)
    camera = Camera.fitted(directions(*view), places, np.zeros((1, 3)), frame, 1.0)
    seen = camera.project(places)
    low, high = seen.min(axis=0), seen.max(axis=0)
    assert (low > np.array(frame[:2]) - 1e-6).all() and (high < np.array(frame[2:]) + 1e-6).all()
    touches = np.isclose(low, frame[:2]) & np.isclose(high, frame[2:])
    assert touches.any()


def ray_cast(cells: VoxelList, camera: Camera, size: tuple[int, int], n: int) -> NDArray[np.int64]:
    """What each sample shows, slowly: the first exposed face that a ray enters, as a cell and a face."""
    cell, centres = cells.lattice.cell, cells.centres()
    half = 0.5 * (cell.normals**2).sum(axis=1)
    out = np.full((size[1] * n, size[0] * n), kernels.NOTHING, np.int64)
    for row, column in np.ndindex(*out.shape):
        at = (np.array([column, row]) + 0.5) / n
        ray = np.array([*((at - camera.middle) / camera.focal), 1.0]) @ camera.rotation
        slope = cell.normals @ ray
        room = half - (camera.eye - centres) @ cell.normals.T
        with np.errstate(divide="ignore"):
            along = room / slope
        enter = np.where(slope < 0, along, -np.inf)
        leave = np.where(slope > 0, along, np.inf)
        first, last = enter.max(axis=1), leave.min(axis=1)
        first[first >= last] = np.inf
        if np.isfinite(first).any():
            m = int(np.argmin(first))
            out[row, column] = m * len(half) + int(np.argmax(enter[m]))
    return out


@spatial
def test_the_nearest_face_is_shown(case: Case, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = case.lattice.disk([0, 0, 0], 2)
    cells = VoxelList.from_cells(ball[::2], case.lattice)
    size, seen = (36, 30), {}
    rasterise = kernels.rasterise

    def spy(*arguments: object) -> None:
        rasterise(*arguments)
        seen["shown"] = arguments[-1].shown.copy()  # type: ignore[attr-defined]

    monkeypatch.setattr(kernels, "rasterise", spy)
    view = directions(-110.0, 25.0)
    camera = Camera.fitted(view, cells.centres(), case.lattice.cell.vertices, (2.0, 2.0, 34.0, 28.0), 1.0)
    scene.render(cells, exposed_faces(cells), np.zeros((len(cells), 3), np.uint8), camera, view, size, (255,) * 3)
    expected = ray_cast(cells, camera, size, 3)
    shown = seen["shown"]
    assert (shown >= 0).mean() > 0.1
    # Rays through an edge may go either way.
    assert (shown != expected).mean() < 1e-3


# ---------------------------------------------------------------------- pictures


@spatial
def test_picture_of_every_lattice(case: Case, tmp_path: Path) -> None:
    cells = some_cells(case.lattice)
    first = draw_solids(cells, tmp_path / "a.png", title="cells", size=SIZE, dpi=50)
    image = pixels(first)
    assert image.shape == (SIZE[1], SIZE[0], 3)
    assert (image[0, 0] == 1.0).all()
    coloured = np.ptp(image, axis=2) > 0.15
    assert 0.05 < coloured.mean() < 0.9
    second = draw_solids(cells, tmp_path / "b.png", title="cells", size=SIZE, dpi=50)
    assert first.read_bytes() == second.read_bytes()


def test_faces_in_the_light_are_brighter(tmp_path: Path) -> None:
    cube = VoxelList.from_cells(np.argwhere(np.ones((4, 4, 4), bool)), Z3)
    image = pixels(draw_solids(cube, tmp_path / "a.png", view=(-90.0, 35.0), size=SIZE, dpi=30))
    column = image[:, SIZE[0] // 2].sum(axis=1)
    middle = SIZE[1] // 2
    # From the top of the picture downwards: paper, the top of the cube in the sun, its front.
    inked = np.flatnonzero(column < 2.0)
    assert inked.size and inked[0] > 2
    assert np.median(image[inked[0] : middle, SIZE[0] // 2].max(axis=1)) > 0.3


def test_shadow_falls_on_the_ground(tmp_path: Path) -> None:
    plate = VoxelList.from_cells(
        [[a, b, c] for a in range(8) for b in range(8) for c in (0, 9) if c or a == b == 0], Z3
    )
    image = pixels(draw_solids(plate, tmp_path / "a.png", fit=1.0, size=SIZE, dpi=30))
    grey = (np.ptp(image, axis=2) < 0.02) & (image[:, :, 0] < 0.95) & (image[:, :, 0] > 0.4)
    assert grey.mean() > 0.004


def test_a_picture_far_from_the_origin_is_the_same(tmp_path: Path) -> None:
    cells = some_cells(Z3)
    near = pixels(draw_solids(cells, tmp_path / "a.png", size=SIZE, dpi=30))
    far = pixels(draw_solids(cells.shift(np.array([400_000, -300_000, 0])), tmp_path / "b.png", size=SIZE, dpi=30))
    assert np.abs(near - far).mean() < 2e-3


def test_empty_list_draws_a_page_that_says_so(tmp_path: Path) -> None:
    image = pixels(draw_solids(VoxelList.empty(Z3), tmp_path / "a.png", size=(400, 300), dpi=100))
    words = image[100:200]
    assert (words < 0.9).any() and (words > 0.99).mean() > 0.9
    draw_solids(some_cells(Z3), tmp_path / "b.png", cut=Cut(above=-100.0), size=(400, 300))


def test_one_cell_and_odd_pages(tmp_path: Path) -> None:
    one = VoxelList.from_cells([[0, 0, 0]], Z3)
    for size, dpi in (((64, 64), 400.0), ((201, 97), 33.3)):
        image = pixels(draw_solids(one, tmp_path / "a.png", size=size, dpi=dpi, view=(0.0, 90.0)))
        assert image.shape[:2] == size[::-1]
        assert (np.ptp(image, axis=2) > 0.1).any()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"size": (10, 10)}, "pixels a side"),
        ({"size": (20_000, 20_000)}, "pixels a side"),
        ({"view": (0.0, 95.0)}, "an elevation from -90 to 90"),
        ({"view": (np.nan, 0.0)}, "an elevation"),
        ({"fit": 0.2}, "at least half"),
        ({"dpi": 0.0}, "pixels an inch"),
    ],
)
def test_what_is_no_page(changes: dict[str, object], words: str, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=words) as caught:
        draw_solids(some_cells(Z3), tmp_path / "a.png", **changes)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_only_png(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"\.png, not as \.svg"):
        draw_solids(some_cells(Z3), tmp_path / "a.svg")


# ---------------------------------------------------------------------- cuts


def room(lattice: Lattice, ceiling: bool = True) -> VoxelList:
    """The walls and the floor of a room of 4 x 3 x 2.5 metres as a scan sees them, without inside."""
    rng = np.random.default_rng(0)
    points = rng.uniform(0.0, 1.0, (40_000, 3))
    side = rng.integers(0, 6 if ceiling else 5, len(points))
    points[side < 2, 0] = side[side < 2]
    points[(side == 2) | (side == 3), 1] = side[(side == 2) | (side == 3)] - 2
    points[side >= 4, 2] = side[side >= 4] - 4
    return VoxelList.from_points(points * (4.0, 3.0, 2.5) + (0.0, 0.0, -0.3), lattice)


@spatial
def test_a_ceiling_is_found(case: Case) -> None:
    lattice = case.lattice
    cells = room(lattice)
    cut = find_cut(cells)
    assert cut.above is not None and 2.2 - 5.0 * lattice.resolution <= cut.above <= 2.2
    left = cells.select(cut.keep(cells, 0.0))
    # The walls stay, the lid goes: what is left, seen from above, shows the floor.
    high = left.centres()[:, 2] > 1.5
    middle = (np.abs(left.centres()[:, :2] - (2.0, 1.5)) < 1.0).all(axis=1)
    assert high.any() and not (high & middle).any()


@spatial
def test_where_there_is_no_ceiling_nothing_is_cut(case: Case) -> None:
    assert find_cut(room(case.lattice, ceiling=False)) == Cut()
    block = VoxelList.from_cells(np.argwhere(np.ones((9, 9, 9), bool)), case.lattice)
    assert find_cut(block) == Cut()
    assert find_cut(VoxelList.from_cells([[0, 0, 0]], case.lattice)) == Cut()
    assert find_cut(VoxelList.empty(case.lattice)) == Cut()


def test_the_near_part_is_towards_the_viewer() -> None:
    line = VoxelList.from_cells([[k, 0, 0] for k in range(100)], Z3)
    kept = line.select(Cut(near=0.25).keep(line, 0.0))
    assert kept.index[:, 0].max() < 76 and kept.index[:, 0].min() == 0
    assert Cut(near=0.25).keep(line, 90.0).all()
    assert len(line.select(Cut(above=-1.0).keep(line, 0.0))) == 0
    for wrong in ({"near": 1.0}, {"above": np.inf}):
        with pytest.raises(ArgumentError, match="a cut"):
            Cut(**wrong)


# ---------------------------------------------------------------------- the viewer


def stand_in(monkeypatch: pytest.MonkeyPatch, opened: bool = True, says: str = "") -> list[str]:
    """Replace Open3D by something that only notes what is asked of it."""
    asked: list[str] = []

    class Anything:
        def __getattr__(self, name: str) -> object:
            def call(*_: object, **__: object) -> object:
                asked.append(name)
                if name == "create_window":
                    sys.stdout.write(says)
                    return opened
                return Anything()

            return call

    module = types.ModuleType("open3d")
    for part in ("geometry", "utility", "visualization"):
        setattr(module, part, Anything())
    monkeypatch.setitem(sys.modules, "open3d", module)
    monkeypatch.setenv("DISPLAY", ":0")
    return asked


def test_viewer_shows_and_closes(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = stand_in(monkeypatch)
    view_solids(mesh_of_cells(some_cells(Z3)))
    assert asked[-1] == "destroy_window" and "run" in asked and "add_geometry" in asked


def test_viewer_without_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = mesh_of_cells(some_cells(Z3))
    for arguments in ({"opened": False}, {"says": "No display detected, falling back to EGL offscreen rendering."}):
        asked = stand_in(monkeypatch, **arguments)  # type: ignore[arg-type]
        with pytest.raises(MissingDependencyError, match="no display"):
            view_solids(mesh)
        assert "run" not in asked
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(MissingDependencyError, match="no display"):
        view_solids(mesh)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ModuleNotFoundError("No module named 'open3d'", name="open3d"), r"pip install 'hexmap\[open3d\]'"),
        (ModuleNotFoundError("No module named 'dash'", name="dash"), "lacks the package dash"),
        (OSError("libusb-1.0.so.0: cannot open shared object file"), "libusb-1.0.so.0.*apt install libusb-1.0-0"),
    ],
)
def test_viewer_says_what_to_install(error: Exception, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Missing:
        def find_spec(self, name: str, *_: object) -> None:
            if name == "open3d":
                raise error

    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Missing(), *sys.meta_path])
    with pytest.raises(MissingDependencyError, match=words) as caught:
        view_solids(mesh_of_cells(some_cells(Z3)))
    assert "\n" not in str(caught.value)


def test_an_empty_mesh_is_not_shown() -> None:
    with pytest.raises(ArgumentError, match="nothing to show"):
        view_solids(mesh_of_cells(VoxelList.empty(Z3)))
