"""Values on axes of matplotlib, and small ones in notebooks, on every lattice."""

from __future__ import annotations

import base64
import io
import re
import subprocess
import sys
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from hexmap import LatticeGraph, Map, MapBuilder, Pose, Scan, Trajectory, VoxelList
from hexmap.base import pictures
from hexmap.base.errors import ArgumentError
from hexmap.maps import Level
from planners import dijkstra
from tests.lattices import CASES, JIT, PLANAR, SPATIAL, Case

pytestmark = pytest.mark.skipif(not JIT, reason="pictures quantise every pixel")
each = pytest.mark.parametrize("case", CASES, ids=str)


def map_on(case: Case) -> Map:
    rng = np.random.default_rng(1)
    away = rng.normal(size=(60, case.dim))
    builder = MapBuilder(case.lattice, levels=2)
    points = away / np.linalg.norm(away, axis=1)[:, None] * 2.0
    builder.fuse(Scan(stamp=0.0, points=points), Pose.identity(case.dim))
    return builder.build()


def values_on(case: Case) -> list[Any]:
    n = case.dim
    blocked = np.zeros((6,) * n, bool)
    blocked[2, :4] = True
    field = dijkstra(LatticeGraph.from_array(blocked, case.lattice), [0] * n)
    made = map_on(case)
    trajectory = Trajectory.from_poses([0.0, 1.0], [Pose.identity(n), Pose(np.eye(n), [0.5] * n)])
    path, none = field.path_to([5] * n), VoxelList.empty(case.lattice)
    return [made, made.levels[0].hits, field.graph, field, path, trajectory, none]


def axes() -> Axes:
    return Figure().add_subplot()


def pixels_of(ax: Axes) -> Any:
    """Return the drawn figure (H, W, 3) and where positions in metres are in it."""
    canvas = FigureCanvasAgg(ax.figure)  # type: ignore[arg-type]
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[:, :, :3]

    def at(points: Any) -> Any:
        x, y = ax.transData.transform(points).astype(int).T
        return image[len(image) - 1 - y, x].astype(int)

    return at


def inline(html: str) -> Any:
    """Return the picture in some HTML, None where there is none."""
    found = re.search(r'<img alt="\w+" width="\d+" src="data:image/png;base64,([^"]+)">', html)
    return None if found is None else Image.open(io.BytesIO(base64.b64decode(found[1])))


@each
def test_everything_draws_itself_on_axes_and_returns_them(case: Case) -> None:
    for value in values_on(case):
        ax = axes()
        assert value.plot(ax) is ax
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("x, m", "y, m")
        assert ax.get_aspect() == 1.0
        ax.figure.canvas.draw()


@each
def test_notebooks_show_a_small_picture_and_a_line(case: Case) -> None:
    for value in values_on(case):
        html = value._repr_html_()
        picture = inline(html)
        assert picture is not None and max(picture.size) < 1000
        shown = re.search(r'<img alt="\w+" width="(\d+)"', html)
        assert shown is not None and int(shown[1]) == picture.width // 2  # twice the pixels, as wide on the page
        assert len(html) < 200_000
        assert html.count("<pre>") == 1 and "\n" not in html


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_walls_are_dark_where_they_are(case: Case) -> None:
    made = map_on(case)
    hits, free = made.state().occupied.centres(), made.state().free.centres()
    at = pixels_of(made.plot(Figure(figsize=(8, 8), dpi=150).add_subplot()))
    assert (at(hits).sum(axis=1) < 3 * 200).mean() > 0.95
    assert (at(free).sum(axis=1) > 3 * 250).mean() > 0.9


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_no_wall_fades_away_where_cells_are_smaller_than_pixels(case: Case) -> None:
    along = np.arange(-200.0, 200.0, 0.02)
    wall = VoxelList.from_points(np.column_stack([along, 0.5 * along]), case.lattice)
    at = pixels_of(wall.plot(axes()))
    around = np.linspace(-150.0, 150.0, 101)
    seen = at(np.column_stack([around, 0.5 * around])).sum(axis=1)
    assert (seen < 3 * 235).mean() > 0.8


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_space_is_seen_from_above_or_cut(case: Case) -> None:
    lattice = case.lattice
    low, high = lattice.quantise([[0.0, 0.0, 0.0]]), lattice.quantise([[3.0, 0.0, 1.0]])
    cells = VoxelList.from_cells(np.concatenate([low, high]), lattice)
    centres = cells.centres()
    at = pixels_of(cells.plot(axes()))
    colours = at(centres[:, :2])
    assert abs(colours[0] - colours[1]).sum() > 100  # by their heights
    top = centres[np.argmax(centres[:, 2])]
    at = pixels_of(cells.plot(axes(), height=float(top[2]), colour="black"))
    assert at(top[None, :2]).sum() == 0
    below = centres[np.argmin(centres[:, 2])]
    cut = cells.plot(axes(), height=float(top[2]))
    assert not cut.viewLim.contains(*below[:2])  # what the plane does not meet is not there
    for wrong in (float("nan"), float("inf")):
        with pytest.raises(ArgumentError, match="finite height"):
            cells.plot(axes(), height=wrong)


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_a_plane_has_no_height(case: Case) -> None:
    for value in values_on(case)[:4]:
        with pytest.raises(ArgumentError, match="of the plane"):
            value.plot(axes(), height=1.0)


@each
def test_what_was_drawn_before_stays_in_sight(case: Case) -> None:
    ax = axes()
    ax.plot([-50.0, 40.0], [3.0, 60.0])
    for value in values_on(case):
        value.plot(ax)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    assert left <= -50.0 and right >= 40.0 and bottom <= 3.0 and top >= 60.0


def test_lines_take_the_style_of_matplotlib_and_space_where_there_is_some() -> None:
    path = values_on(SPATIAL[0])[4]
    line = path.plot(axes(), c="tab:green", lw=3.0, label="mine").lines[0]
    assert (line.get_color(), line.get_linewidth(), line.get_label()) == ("tab:green", 3.0, "mine")
    space = path.plot(Figure().add_subplot(projection="3d"))
    assert space.get_zlabel() == "z, m"
    assert np.allclose(space.lines[0].get_data_3d(), path.points.T)


def test_a_field_marks_what_cannot_be_entered_and_what_cannot_be_reached() -> None:
    blocked = np.zeros((9, 9), bool)
    blocked[4] = True
    field = dijkstra(LatticeGraph.from_array(blocked, "Z2"), [0, 0])
    at = pixels_of(field.plot(axes(), colorbar=False))
    wall, beyond, near, far = at(np.array([[4.0, 4.0], [8.0, 8.0], [1.0, 1.0], [3.0, 8.0]]))
    assert wall.sum() < 400 and np.ptp(wall) == 0  # grey, which no cost is
    assert beyond.sum() == 3 * 255
    assert abs(near - far).sum() > 100
    assert len(field.plot(axes()).figure.axes) == 2  # the colours are explained
    assert len(field.plot(axes(), colorbar=False).figure.axes) == 1


def test_heights_of_cells_in_space_are_explained() -> None:
    cells = VoxelList.from_points([[0.0, 0.0, 0.0], [1.0, 0.0, 2.0]], "D3", 0.5)
    _, bar = cells.plot(axes()).figure.axes
    assert bar.get_ylabel() == "z, m"
    assert len(cells.plot(axes(), colorbar=False).figure.axes) == 1
    assert len(cells.plot(axes(), colour="red").figure.axes) == 1


def test_new_axes_are_made_where_none_are_given() -> None:
    ax = VoxelList.from_points([[0.0, 0.0]], "A2", 0.1).plot()
    assert plt.fignum_exists(ax.figure.number)  # type: ignore[union-attr]
    plt.close(ax.figure)  # type: ignore[arg-type]


def test_a_picture_is_small_however_large_the_map() -> None:
    far = VoxelList.from_points(np.random.default_rng(0).uniform(-1e6, 1e6, (200_000, 2)), "A2", 0.05)
    html = far._repr_html_()
    assert inline(html) is not None and len(html) < 300_000
    steps = np.cumsum(np.random.default_rng(0).normal(size=(100_000, 3)), axis=0)
    long = Trajectory(np.arange(len(steps)), steps, np.tile([0.0, 0.0, 0.0, 1.0], (len(steps), 1)))
    assert inline(long._repr_html_()) is not None


def test_html_never_raises_and_is_escaped(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(value: Any) -> str:
        raise RuntimeError("no canvas")

    monkeypatch.setattr(pictures.drawing(), "inline_picture", broken)
    html = VoxelList.from_points([[0.0, 0.0]], "A2", 0.1)._repr_html_()
    assert html == "<pre>&lt;VoxelList of 1 points on Lattice.named(&#x27;A2&#x27;, resolution=0.1)&gt;</pre>"
    monkeypatch.setattr(pictures, "_sources", [])
    assert "<pre>" in VoxelList.from_points([[0.0, 0.0]], "A2", 0.1)._repr_html_()


def test_values_load_no_drawing_before_a_picture_is_wanted() -> None:
    code = (
        "import sys; from hexmap import Map, VoxelList, Trajectory; from planners import Path, DistanceField; "
        "assert not [m for m in sys.modules if 'matplotlib' in m or m.startswith('hexmap.drawing')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_same_map_gives_the_same_picture() -> None:
    value = map_on(PLANAR[1])
    assert value._repr_html_() == value._repr_html_()


@pytest.mark.parametrize("case", [PLANAR[1], PLANAR[-1], SPATIAL[1]], ids=str)
def test_a_few_strays_do_not_make_the_rest_too_small_to_see(case: Case) -> None:
    rng = np.random.default_rng(0)
    hall = rng.uniform(-3.0, 3.0, (1000, case.dim))
    stray = np.full((2, case.dim), 900.0)
    alone, together = (VoxelList.from_points(p, case.lattice) for p in (hall, np.concatenate([hall, stray])))
    passes = VoxelList.empty(case.lattice)
    for a, b in ((alone, together), (Map([Level(alone, passes)]), Map([Level(together, passes)]))):
        seen = [np.asarray(inline(value._repr_html_()).convert("L")) < 240 for value in (a, b)]
        assert 0.5 < seen[1].mean() / seen[0].mean() < 2.0
        assert a._repr_html_() != b._repr_html_()  # the line tells of all
