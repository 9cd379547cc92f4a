"""Pictures: pixels and outlines are those of the true cells, files are whole, small and repeatable."""

from __future__ import annotations

import xml.etree.ElementTree
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError, FileAccessError
from hexmap.drawing.extent import bulk
from hexmap.drawing.figure_layout import FREE_COLOUR, NEAR_COLOUR, SHADES, UNKNOWN_COLOUR, FigureLayout, thresholds
from hexmap.drawing.map_drawing import SUFFIXES, draw_map, highest_cells, save_figure
from hexmap.drawing.path_drawing import draw_path
from hexmap.drawing.path_sections import PathSections
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Level, Map
from hexmap.maps.outlines import outline, silhouette
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.trajectory import Trajectory
from planners import Path as Path_
from planners import astar, to_cell
from tests.lattices import CASES, JIT, PLANAR, SPATIAL, Case

UNKNOWN, FREE, OCCUPIED = CellState

each = pytest.mark.parametrize("case", CASES, ids=str)
planar = pytest.mark.parametrize("case", PLANAR, ids=str)
spatial = pytest.mark.parametrize("case", SPATIAL, ids=str)
each_suffix = pytest.mark.parametrize("suffix", SUFFIXES)
# Every lattice in pixels; a picture in curves knows cells as polygons only, and two lattices show that.
each_in_each_suffix = pytest.mark.parametrize(
    ("case", "suffix"),
    [
        pytest.param(
            case, suffix, marks=[] if suffix == ".png" or case.label in ("A2@0.1", "D3*@0.1") else pytest.mark.long
        )
        for case in CASES
        for suffix in SUFFIXES
    ],
    ids=str,
)
DPI = 40.0 if JIT else 10.0


def random_map(lattice: Lattice, seed: int = 0, count: int = 150) -> Map:
    rng = np.random.default_rng(seed)
    hits, passes = (rng.uniform(-1.5, 1.5, (n, lattice.dim)) for n in (count, 3 * count))
    scaled = [lattice.scaled(2.0**k) for k in range(2)]
    return Map([Level(VoxelList.from_points(hits, s), VoxelList.from_points(passes, s)) for s in scaled])


def empty_map(lattice: Lattice) -> Map:
    return Map([Level(VoxelList.empty(lattice), VoxelList.empty(lattice))])


def rgb(colour: str) -> list[int]:
    return [int(colour[k : k + 2], 16) for k in (1, 3, 5)]


# ---------------------------------------------------------------------- outlines


def signed_area(ring: NDArray[np.float64]) -> float:
    following = np.roll(ring, -1, axis=0)
    return 0.5 * float((ring[:, 0] * following[:, 1] - ring[:, 1] * following[:, 0]).sum())


def rings_of(cells: VoxelList) -> list[NDArray[np.float64]]:
    rings = outline(cells)
    return np.split(rings.points, rings.ends[:-1]) if len(rings.ends) else []


@planar
def test_outline_of_one_cell_is_the_cell(case: Case) -> None:
    (ring,) = rings_of(VoxelList.from_cells([[3, -2]], case.lattice))
    wanted = case.lattice.cell.vertices + case.lattice.centres(np.array([[3, -2]]))
    assert len(ring) == len(wanted)
    start = int(np.argmin(np.linalg.norm(ring - wanted[0], axis=1)))
    assert np.allclose(np.roll(ring, -start, axis=0), wanted, atol=1e-12)


@planar
def test_outline_keeps_the_area(case: Case) -> None:
    cells = random_map(case.lattice, count=500).state().free
    areas = [signed_area(ring) for ring in rings_of(cells)]
    assert sum(areas) == pytest.approx(len(cells) * case.lattice.cell_volume)
    assert min(areas) < 0.0 < max(areas)  # holes run the other way round


@planar
def test_outline_says_what_is_inside(case: Case) -> None:
    from matplotlib.path import Path as Curve

    cells = random_map(case.lattice, count=60).state().occupied
    points = np.random.default_rng(1).uniform(-1.8, 1.8, (2000, 2))
    winding = sum(
        np.sign(signed_area(ring)) * Curve(ring).contains_points(points).astype(int) for ring in rings_of(cells)
    )
    assert np.array_equal(winding > 0, cells.contains(case.lattice.quantise(points)))


@planar
def test_outline_of_a_disk_with_a_hole(case: Case) -> None:
    disk = case.lattice.disk([0, 0], 3)
    cells = VoxelList.from_cells(disk[(disk != 0).any(axis=1)], case.lattice)
    areas = sorted(signed_area(ring) for ring in rings_of(cells))
    assert areas[0] == pytest.approx(-case.lattice.cell_volume) and len(areas) == 2


def test_outline_leaves_straight_corners_out() -> None:
    squares = Lattice.named("Z2", resolution=1.0)
    block = np.stack(np.meshgrid(np.arange(30), np.arange(20)), axis=-1).reshape(-1, 2)
    (ring,) = rings_of(VoxelList.from_cells(block, squares))
    assert sorted(map(tuple, ring.tolist())) == [(-0.5, -0.5), (-0.5, 19.5), (29.5, -0.5), (29.5, 19.5)]


def test_outline_of_nothing_and_of_cells_far_apart() -> None:
    hexagons = Lattice.named("A2", resolution=0.1)
    assert rings_of(VoxelList.empty(hexagons)) == []
    far = hexagons.limit - 1
    rings = rings_of(VoxelList.from_cells([[-far, -far], [far, far], [-far, far]], hexagons))
    assert [len(ring) for ring in rings] == [6, 6, 6]


@each
def test_silhouette_is_convex_and_holds_the_cell(case: Case) -> None:
    corners = silhouette(case.lattice)
    edges = np.roll(corners, -1, axis=0) - corners
    turns = np.roll(edges, -1, axis=0)
    assert (edges[:, 0] * turns[:, 1] - edges[:, 1] * turns[:, 0] > 0).all()
    for vertex in case.lattice.cell.vertices[:, :2]:
        side = edges[:, 0] * (vertex[1] - corners[:, 1]) - edges[:, 1] * (vertex[0] - corners[:, 0])
        assert side.min() > -1e-9
    if case.dim == 2:
        assert len(corners) == len(case.lattice.cell.vertices)


# ---------------------------------------------------------------------- pixels


@pytest.mark.skipif(not JIT, reason="a million quantised samples take too long without the compiler")
@planar
def test_every_pixel_well_inside_a_cell_has_the_colour_of_its_state(case: Case, tmp_path: Path) -> None:
    from PIL import Image

    map_ = random_map(case.lattice)
    states = map_.state()
    draw_map(map_, tmp_path / "m.png", dpi=100.0)
    image = np.asarray(Image.open(tmp_path / "m.png").convert("RGB"))
    places = np.concatenate([states.occupied.centres(), states.free.centres()])
    layout = FigureLayout.around(places, case.lattice, 100.0, False)
    counts = np.array(layout.pixels)
    pixel = (layout.high - layout.low) / counts
    left, bottom = round(layout.left * 100), round(layout.bottom * 100)
    part = image[image.shape[0] - bottom - counts[1] : image.shape[0] - bottom, left : left + counts[0]][::-1]
    index = np.concatenate([states.occupied.index, states.free.index, np.add(states.free.index, [40, 0])])
    centres = case.lattice.centres(index)
    inside = ((centres > layout.low + 2 * pixel) & (centres < layout.high - 2 * pixel)).all(axis=1)
    inside &= np.hypot(*(centres / pixel).T) > 10.0  # where the origin is marked
    index, centres = index[inside], centres[inside]
    columns, rows = ((centres - layout.low) / pixel).astype(int).T
    colours = part[rows, columns]
    shade = np.searchsorted(thresholds(states.occupied), states.occupied.find(index), side="right")
    wanted = np.array([rgb(c) for c in (UNKNOWN_COLOUR, FREE_COLOUR)])[np.minimum(states.of(index), 1)]
    wanted = np.where((states.of(index) == 2)[:, None], np.array([rgb(c) for c in SHADES])[shade], wanted)
    assert np.array_equal(colours, wanted)


def test_walls_stay_on_a_small_picture_of_a_large_map(tmp_path: Path) -> None:
    from PIL import Image

    lattice = Lattice.named("A2", resolution=0.05)
    line = lattice.line([0, 0], [3000, 1000])
    map_ = Map([Level(VoxelList.from_cells(line, lattice), VoxelList.empty(lattice))])
    draw_map(map_, tmp_path / "m.png", dpi=30.0)
    image = np.asarray(Image.open(tmp_path / "m.png").convert("RGB"))
    dark = (image == rgb(SHADES[-2])).all(axis=2)
    assert dark.any(axis=0).sum() > 0.9 * 8 * 30


@planar
def test_strays_are_off_the_page_unless_asked_for(case: Case, tmp_path: Path) -> None:
    xs, ys = np.meshgrid(np.arange(40), np.arange(40))
    room = np.stack([xs.ravel(), ys.ravel()], axis=1)
    strays = np.array([[400, 7], [401, 7], [30, -500]])
    lattice = case.lattice
    map_ = Map([Level(VoxelList.from_cells(np.vstack([room, strays]), lattice), VoxelList.empty(lattice))])
    alone = Map([Level(VoxelList.from_cells(room, lattice), VoxelList.empty(lattice))])
    for name, drawn, whole in (("a", map_, False), ("b", alone, False), ("c", map_, True), ("d", alone, True)):
        draw_map(drawn, tmp_path / f"{name}.svg", whole=whole)
    a, b, c, d = ((tmp_path / f"{name}.svg").read_bytes() for name in "abcd")
    assert len({a, b, c}) == 3 and b == d

    def extent(drawn: Map) -> NDArray[np.float64]:
        corners = np.vstack(bulk(drawn.state().occupied.centres(), drawn.state().free.centres()))
        return np.array([corners.min(axis=0), corners.max(axis=0)])

    centres = lattice.centres(room)
    assert np.array_equal(extent(alone), [centres.min(axis=0), centres.max(axis=0)])
    width = np.ptp(centres, axis=0)
    # What is beyond the bulk by less than a tenth of its width may stay.
    assert (np.abs(extent(map_) - extent(alone)) <= 0.1 * width).all()


def test_a_few_cells_and_a_thin_line_lose_none() -> None:
    line = np.column_stack([np.arange(900.0), np.zeros(900)])
    for centres in (np.zeros((1, 2)), np.array([[0.0, 0.0], [9.0, 1.0]]), line):
        (corners,) = bulk(centres, np.empty((0, 2)))
        assert np.array_equal(corners, [centres.min(axis=0), centres.max(axis=0)])
    assert bulk(np.empty((0, 2)), np.empty((0, 2))) == []


def test_the_coordinates_are_those_of_the_map(tmp_path: Path) -> None:
    from matplotlib.figure import Figure

    for low, high in (((-3.0, -2.0), (5.0, 6.0)), ((1000.0, 20.0), (1002.0, 20.5))):
        layout = FigureLayout.around(np.array([low, high]), Lattice.named("A2", 0.1), 100.0, False)
        figure = Figure(figsize=(layout.width, layout.height), dpi=100.0)
        axes = layout.add_axes(figure)
        figure.canvas.draw()
        assert axes.get_xlabel() == "x, m" and axes.get_ylabel() == "y, m"
        for tick, label in zip(axes.get_xticks(), axes.get_xticklabels(), strict=True):
            assert float(label.get_text().replace("\N{MINUS SIGN}", "-")) == pytest.approx(tick)
        assert layout.shows_origin == (low[0] < 0.0) == (len(axes.lines) > 0)
        assert all(line.get_xydata().tolist() == [[0.0, 0.0]] for line in axes.lines)


def test_more_hits_are_darker() -> None:
    lattice = Lattice.named("A2", resolution=0.05)
    for counts in ([1, 1, 1], [1, 2, 3, 4], list(range(1, 500)), [10**9]):
        cells = VoxelList.from_cells([[k, 0] for k in range(len(counts))], lattice, counts)
        steps = thresholds(cells)
        assert len(steps) == len(SHADES) - 1 and (np.diff(steps) >= 1).all() and steps[0] >= 2
    brightness = [sum(rgb(colour)) for colour in (FREE_COLOUR, UNKNOWN_COLOUR, *SHADES)]
    assert brightness == sorted(brightness, reverse=True)


# ---------------------------------------------------------------------- files


@each_in_each_suffix
def test_every_lattice_in_every_format(case: Case, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"m{suffix}"
    way = np.array([[-1.0, -1.0], [0.0, 0.5], [1.0, 1.0]])
    assert draw_map(random_map(case.lattice), path, trajectory=way, dpi=DPI, title="A map") == path
    first = path.read_bytes()
    assert first.startswith({".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}[suffix])
    if suffix == ".svg":
        xml.etree.ElementTree.fromstring(first)
    draw_map(random_map(case.lattice), path, trajectory=way, dpi=DPI, title="A map")
    assert path.read_bytes() == first
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("case", [PLANAR[1], SPATIAL[1]], ids=str)
@each_suffix
def test_empty_maps_give_an_empty_picture(case: Case, suffix: str, tmp_path: Path) -> None:
    path = draw_map(empty_map(case.lattice), tmp_path / f"m{suffix}", dpi=DPI)
    draw_map(empty_map(case.lattice), tmp_path / f"n{suffix}", trajectory=[[1.0, 2.0]], dpi=DPI)
    assert path.stat().st_size > 500


@spatial
def test_the_highest_cell_of_a_column_is_seen(case: Case) -> None:
    occupied = random_map(case.lattice, count=400).state().occupied
    tops = highest_cells(occupied).centres
    assert (np.diff(tops[:, 2]) >= 0).all()
    seen = {tuple(np.round(c[:2], 6)): c[2] for c in tops}
    assert len(seen) == len(tops)
    for centre in occupied.centres():
        assert seen[tuple(np.round(centre[:2], 6))] >= centre[2]


def test_level_and_rule_count(tmp_path: Path) -> None:
    map_ = random_map(Lattice.named("A2", resolution=0.1))
    drawn = [
        draw_map(map_, tmp_path / f"{k}.svg", level, None, rule).read_bytes()
        for k, (level, rule) in enumerate([(0, None), (1, None), (0, StateRule(min_hits=2))])
    ]
    assert len(set(drawn)) == 3
    with pytest.raises(ArgumentError, match="levels 0 to 1"):
        draw_map(map_, tmp_path / "m.svg", level=2)


def test_trajectories_and_arrays_of_positions_draw_alike(tmp_path: Path) -> None:
    map_ = random_map(Lattice.named("A2", resolution=0.1))
    poses = [Pose.planar(0.1 * k, 0.5, 0.0) for k in range(20)]
    trajectory = Trajectory.from_poses(np.arange(20.0), poses)
    draw_map(map_, tmp_path / "a.svg", trajectory=trajectory)
    draw_map(map_, tmp_path / "b.svg", trajectory=trajectory.positions[:, :2])
    draw_map(map_, tmp_path / "c.svg")
    a, b, c = ((tmp_path / f"{name}.svg").read_bytes() for name in "abc")
    assert a == b != c
    broken = trajectory.positions.copy()
    broken[7] = np.nan
    draw_map(map_, tmp_path / "d.svg", trajectory=broken)
    draw_map(map_, tmp_path / "e.svg", trajectory=np.empty((0, 2)))
    draw_map(map_, tmp_path / "f.svg", trajectory=np.full((3, 2), np.nan))
    assert (tmp_path / "e.svg").read_bytes() == (tmp_path / "f.svg").read_bytes() == c


def test_arguments_are_checked(tmp_path: Path) -> None:
    map_ = random_map(Lattice.named("A2", resolution=0.1))
    with pytest.raises(ArgumentError, match=r"known are \.png, \.svg, \.pdf"):
        draw_map(map_, tmp_path / "m.jpg")
    with pytest.raises(ArgumentError, match="without a suffix"):
        draw_map(map_, tmp_path / "m")
    with pytest.raises(ArgumentError, match=r"\(3, 4\)"):
        draw_map(map_, tmp_path / "m.png", trajectory=np.zeros((3, 4)))
    with pytest.raises(ArgumentError, match="pixels an inch"):
        draw_map(map_, tmp_path / "m.png", dpi=0.0)
    with pytest.raises(ArgumentError, match="too large"):
        draw_map(map_, tmp_path / "m.png", dpi=4000.0)
    with pytest.raises(FileAccessError, match="there is no folder"):
        draw_map(map_, tmp_path / "none" / "m.svg")
    assert list(tmp_path.iterdir()) == []


def test_narrow_maps_and_single_cells(tmp_path: Path) -> None:
    lattice = Lattice.named("A2", resolution=0.05)
    for k, cells in enumerate(([[0, 0]], [[0, 0], [900, -450]], [[0, 0], [0, 900]])):
        map_ = Map([Level(VoxelList.from_cells(cells, lattice), VoxelList.empty(lattice))])
        assert draw_map(map_, tmp_path / f"{k}.png", dpi=DPI).stat().st_size > 0


def test_the_users_style_stays_out_and_unharmed(tmp_path: Path) -> None:
    import matplotlib

    map_ = random_map(Lattice.named("A2", resolution=0.1))
    draw_map(map_, tmp_path / "a.svg", title="A")
    with matplotlib.rc_context(
        {"lines.linewidth": 9.0, "axes.facecolor": "red", "font.size": 30.0, "savefig.bbox": "tight"}
    ):
        draw_map(map_, tmp_path / "b.svg", title="A")
        assert matplotlib.rcParams["lines.linewidth"] == 9.0
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


@pytest.mark.skipif(not JIT, reason="a million quantised samples take too long without the compiler")
@each_suffix
def test_a_building_stays_small(suffix: str, tmp_path: Path) -> None:
    lattice = Lattice.named("A2", resolution=0.05)
    xs, ys = np.meshgrid(np.arange(0, 26, 0.04), np.arange(0, 26, 0.04))
    free = VoxelList.from_points(np.stack([xs, ys], axis=-1).reshape(-1, 2), lattice)
    edge = np.arange(0, 26, 0.02)
    walls = [np.stack([edge, np.full_like(edge, y)], axis=1) for y in (0.0, 7.0, 13.0, 26.0)]
    walls += [wall[:, ::-1] for wall in walls]
    map_ = Map([Level(VoxelList.from_points(np.concatenate(walls), lattice), free)])
    assert len(map_.state().free) > 250_000
    path = draw_map(map_, tmp_path / f"m{suffix}", dpi=100.0)
    assert path.stat().st_size < 2_000_000


# ---------------------------------------------------------------------- paths


def walled(lattice: Lattice) -> LatticeGraph:
    """A box with a wall across it that leaves a gap."""
    n = lattice.dim
    free = lambda points: (np.abs(points[:, 0]) > 0.15) | (points[:, 1] > 0.4)
    return LatticeGraph.rasterise(free, lattice, [-1.5] * n, [1.5] * n)


def way_around(graph: LatticeGraph) -> Path_:
    start, goal = np.full((2, graph.lattice.dim), -0.7)
    goal[0] = 0.7
    return astar(graph, to_cell(graph, start), to_cell(graph, goal))


@each_in_each_suffix
def test_a_path_is_drawn_the_same_each_time(case: Case, suffix: str, tmp_path: Path) -> None:
    graph = walled(case.lattice.scaled(0.12 / case.lattice.resolution))
    path = way_around(graph)
    files = [tmp_path / f"{k}{suffix}" for k in "ab"]
    for file in files:
        options = dict(goal=np.zeros(case.lattice.dim), title="a path", words="more", dpi=DPI, y_down=True)
        assert draw_path(path.points, file, graph.with_clearance(0.13), **options) == file
    assert files[0].read_bytes() == files[1].read_bytes()
    assert files[0].stat().st_size > 500


@planar
@pytest.mark.parametrize("y_down", [False, True])
def test_a_picture_of_a_path_shows_true_cells(case: Case, y_down: bool, tmp_path: Path) -> None:
    from matplotlib.image import imread

    lattice = case.lattice.scaled(0.2 / case.lattice.resolution)
    graph = walled(lattice)

    def state_at(points: NDArray[np.float64]) -> NDArray[np.uint8]:
        states = np.where(graph.free[graph.index_to_flat(lattice.quantise(points))] != 0, FREE, OCCUPIED)
        return np.where(points[:, 0] > 0.9, UNKNOWN, states).astype(np.uint8)

    blocked = graph.with_clearance(0.25)
    corners = np.full(2, -1.5), np.full(2, 1.5)
    line = np.array([[-1.3, 1.3]])
    file = draw_path(line, tmp_path / "p.png", blocked, state_at, extent=corners, whole=True, y_down=y_down, dpi=60.0)
    image = np.rint(255 * imread(file)[:, :, :3]).astype(int)
    layout = FigureLayout.around(np.array(corners), lattice, 60.0, False, y_down)
    known = blocked.flat_to_index(np.flatnonzero(blocked.free | graph.free | 1))
    centres = lattice.centres(known)
    inside = np.all(np.abs(centres) < 1.5, axis=1) & (np.hypot(*(centres - line[0]).T) > 0.35)
    inside &= np.hypot(*centres.T) > 0.15  # where the origin is marked
    for index, centre in zip(known[inside], centres[inside], strict=True):
        offset = (centre - layout.low) if y_down else (np.array([1, -1]) * (centre - (layout.low[0], layout.high[1])))
        column, row = (offset / layout.metres_per_inch * 60.0).astype(int)
        pixel = image[
            image.shape[0] - round(layout.bottom * 60) - layout.pixels[1] + row, round(layout.left * 60) + column
        ]
        state = int(state_at(centre[None])[0])
        near = state == FREE and not blocked.free[blocked.index_to_flat(index[None])[0]]
        wanted = NEAR_COLOUR if near else {UNKNOWN: UNKNOWN_COLOUR, FREE: FREE_COLOUR, OCCUPIED: SHADES[-2]}[state]
        assert pixel.tolist() == rgb(wanted), (centre, state)


@spatial
def test_sections_along_a_path_show_the_cells_it_meets(case: Case, tmp_path: Path) -> None:
    from matplotlib.image import imread

    lattice = case.lattice.scaled(0.2 / case.lattice.resolution)
    graph = walled(lattice)
    line = np.array([[-1.0, -0.6, -0.4], [0.1, 0.5, 0.2], [0.9, 0.5, 0.6]])
    colours = {int(UNKNOWN): UNKNOWN_COLOUR, int(FREE): FREE_COLOUR, int(OCCUPIED): SHADES[-2]}

    def kinds_of(index: NDArray[np.int64], centres: NDArray[np.float64]) -> NDArray[np.uint8]:
        states = np.where(graph.free[graph.index_to_flat(index)] != 0, FREE, OCCUPIED)
        return np.where(centres[:, 1] > 0.8, UNKNOWN, states).astype(np.uint8)

    box = np.full(3, -1.4), np.full(3, 1.4)
    dpi = 60.0 if JIT else 15.0
    sections = PathSections(graph, kinds_of, tuple(colours.values()), line, box, dpi, False)
    layout = sections.layout
    profile: list[NDArray[np.float64]] = []

    def draw(figure: Any, axes: Any) -> None:
        sections.draw(figure, axes, ".png")
        axes = sections.draw_profile(figure, ".png")
        at = axes.get_position().get_points() * [layout.width * dpi, layout.height * dpi]
        profile.extend([at, np.array([axes.get_xlim(), axes.get_ylim()]).T])

    save_figure(layout, tmp_path / "p.png", draw)
    assert sections.kinds_seen() == set(colours)
    image = np.rint(255 * imread(tmp_path / "p.png")[::-1, :, :3]).astype(int)
    top = np.array([[layout.left, layout.bottom], [layout.left, layout.bottom] + np.array(layout.pixels) / dpi]) * dpi
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    s = np.linspace(0.05, along[-1] - 0.05, 200)
    points = np.column_stack([np.interp(s, along, line[:, k]) for k in range(3)])
    # On the path the two sections show the same cells, those of its points.
    for (corners, limits), where in (
        ((top, np.array([layout.low, layout.high])), points[:, :2]),
        (profile, np.column_stack([s, points[:, 2]])),
    ):
        columns, rows = (corners[0] + (where - limits[0]) / (limits[1] - limits[0]) * (corners[1] - corners[0])).T
        seen = image[rows.astype(int), columns.astype(int)]
        index = lattice.quantise(points)
        wanted = np.array([rgb(colours[k]) for k in kinds_of(index.astype(np.int64), lattice.centres(index))])
        assert (seen == wanted).all(axis=1).mean() > (0.75 if JIT else 0.4)  # but on the faces of cells


@pytest.mark.parametrize(
    "change",
    [
        {"points": np.zeros((2, 3))},
        {"points": np.zeros((0, 2))},
        {"points": np.full((2, 2), np.nan)},
        {"goal": [1.0]},
        {"extent": ((0, 0), (-1, 1))},
        {"dpi": 1.0},
        {"path": "p.gif"},
    ],
)
def test_what_is_no_picture_of_a_path(change: dict[str, Any], tmp_path: Path) -> None:
    graph = walled(Lattice.named("A2", 0.2))
    values: dict[str, Any] = {"points": np.zeros((2, 2)), "path": "p.png", **change}
    points, path = values.pop("points"), tmp_path / values.pop("path")
    with pytest.raises(ArgumentError):
        draw_path(points, path, graph, **values)
    assert not list(tmp_path.iterdir())


def test_the_far_ends_of_a_few_rays_do_not_make_the_page() -> None:
    rng = np.random.default_rng(8)
    angle = rng.uniform(0, 2 * np.pi, 2000)
    walls = np.clip(8.0 * np.column_stack([np.cos(angle), np.sin(angle)]), -5.0, 5.0)
    room = rng.uniform(-5, 5, (20_000, 2))
    ray = np.column_stack([np.full(900, 1.0), np.linspace(5.0, 40.0, 900)])  # 4% of what is free
    far = np.column_stack([np.linspace(0.9, 1.1, 30), np.full(30, 40.0)])  # where it ends, a hit a cell
    hits = np.concatenate([np.full(len(walls), 200), np.ones(len(far), np.int64)])
    top = np.vstack(bulk(np.vstack([walls, far]), np.vstack([room, ray]), hits=hits)).max(axis=0)[1]
    assert 5.0 <= top < 8.0
    # A place without walls is no ray.
    field = np.vstack([room, rng.uniform(5, 15, (9000, 2))])
    assert np.vstack(bulk(walls, field, hits=np.ones(len(walls), np.int64))).max() > 14.0
