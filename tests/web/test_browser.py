"""The page in a browser: it shows the true cells, pans, zooms, plans and resizes, and says nothing on its console."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import planners
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.keys import pack
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Map
from hexmap.maps.voxel_list import VoxelList
from hexmap.web.frame import page_frame
from hexmap.web.page import write_page
from tests.lattices import SKEW2, SPATIAL
from tests.mapping import room_in_space
from tests.web.conftest import until
from tests.web.worlds import rooms

A2 = Lattice.named("A2", resolution=0.1)
PAIRS = [(A2, Lattice.named("Z2", resolution=0.1)), (SKEW2.lattice, Lattice([[0.1, 0.3], [0.0, 0.1]], "sheared"))]
START, GOAL = [1.0, 1.0], [7.0, 1.2]
Open = Callable[..., Any]

# What the graphics card drew, as 0 unknown, 1 free, 2 occupied, 3 anything else; the first row is the lowest.
PIXELS = """k => {
  const {gl} = panes[k].drawing, w = gl.drawingBufferWidth, h = gl.drawingBufferHeight, out = new Uint8Array(w * h * 4);
  panes[k].draw();
  gl.readPixels(0, 0, w, h, gl.RGBA, gl.UNSIGNED_BYTE, out);
  const known = ["paper", "free", "wall"].map(n => colours.cells[n].map(v => Math.round(v * 255)));
  const states = [];
  for (let i = 0; i < out.length; i += 4) {
    const state = known.findIndex(c => c.every((v, j) => Math.abs(v - out[i + j]) < 2));
    states.push(state < 0 ? 3 : state);
  }
  return [w, h, states];
}"""


STATES = f"k => [...new Set(({PIXELS})(k)[2])]"


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    way = np.array([[1.0, 1.0], [3.0, 4.8], [6.0, 4.8]])
    path = tmp_path_factory.mktemp("page") / "rooms.html"
    return write_page(rooms(A2, 2), path, compare="Z2", trajectory=way, title="Rooms <b>")


def look(page: Any, x: float, y: float, scale: float) -> None:
    page.evaluate("([x, y, s]) => { view.x = x; view.y = y; view.scale = s; }", [x, y, scale])


def resampled(world: Map, lattice: Lattice, cells: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Return states of cells: what the map has at their centres, walls where centres of walls fall in."""
    states = world.state()
    walls = VoxelList.from_points(states.occupied.centres(), lattice)
    found = states.of(states.occupied.lattice.quantise(lattice.centres(cells)))
    return np.where(walls.contains(cells), np.uint8(CellState.OCCUPIED.value), found)


@pytest.mark.parametrize(("first", "second"), PAIRS, ids=["A2 and Z2", "skewed and sheared"])
def test_every_pixel_shows_its_cell(first: Lattice, second: Lattice, tmp_path: Path, opened: Open) -> None:
    world = rooms(first, 1)
    page = opened(write_page(world, tmp_path / "m.html", compare=second), 800, 400)
    scale = 5.0 / first.resolution  # pixels a metre: cells without outlines
    look(page, 4.013, 3.007, scale)
    for k, lattice in enumerate((first, second)):
        w, h, states = page.evaluate(PIXELS, k)
        shown = np.array(states).reshape(h, w)
        i, j = np.mgrid[0:h, 0:w]
        points = np.stack([4.013 + (j + 0.5 - w / 2) / scale, 3.007 + (i + 0.5 - h / 2) / scale], axis=-1)
        cells = lattice.quantise(points.reshape(-1, 2))
        want = resampled(world, lattice, cells).reshape(h, w)
        assert set(np.unique(want)) >= {1, 2}
        wrong = shown != want
        # On a border a pixel's centre may fall either way, in single precision.
        assert wrong.mean() < 1e-3
        away = np.linalg.norm(points[wrong] - lattice.centres(cells[wrong.ravel()]), axis=1)
        assert (away > 0.9 * lattice.inradius).all()


@pytest.mark.parametrize("second", [case.lattice for case in SPATIAL[2:]], ids=lambda lattice: lattice.name)
def test_every_pixel_of_a_slice_shows_the_cell_in_space(second: Lattice, tmp_path: Path, opened: Open) -> None:
    first = Lattice.named("D3", resolution=0.15)
    second = second.scaled(0.15 / second.resolution)
    world = room_in_space(first, 1, 3000)
    page = opened(write_page(world, tmp_path / "m.html", compare=second, height=0.9), 900, 400)
    scale, z = 8.0 / first.resolution, page.evaluate("view.z")
    look(page, 0.613, -0.207, scale)
    for k, lattice in enumerate((first, second)):
        w, h, states = page.evaluate(f"k => {{ cut({k}0); return ({PIXELS})(k); }}", k)
        z = page.evaluate("view.z")
        i, j = np.mgrid[0:h, 0:w]
        points = np.stack([0.613 + (j + 0.5 - w / 2) / scale, -0.207 + (i + 0.5 - h / 2) / scale, z + 0.0 * i], axis=-1)
        cells = lattice.quantise(points.reshape(-1, 3))
        want = resampled(world, lattice, cells).reshape(h, w)
        shown = np.array(states).reshape(h, w)
        # A plane at the height of centres may run along faces, and there are outlines at this scale.
        told = shown != 3
        assert told.mean() > 0.5 and (shown != want)[told].mean() < 5e-3
    page.locator(".lines").first.click(position={"x": 200, "y": 100})
    assert page.evaluate("ends.start") is None
    before = page.inner_text("#height-shown")
    page.keyboard.press("PageUp")
    assert page.inner_text("#height-shown") != before
    until(page, "panes[0].caption.textContent.split(',').length > 4")


def test_seen_from_afar_no_wall_vanishes(compared: Path, opened: Open) -> None:
    page = opened(compared)
    look(page, 4.0, 3.0, 4.0)  # cells of 0.4 pixels: the wall across is thinner than a pixel
    w, h, states = page.evaluate(PIXELS, 0)
    column = np.array(states).reshape(h, w)[h // 2 - 10 : h // 2, w // 2 - 2 : w // 2 + 2]
    assert (column == 2).any(axis=1).all()


def test_a_path_on_both_lattices_by_two_clicks(compared: Path, opened: Open) -> None:
    page = opened(compared)
    assert page.title() == "Rooms <b>"
    for point in (START, GOAL):
        u, v = page.evaluate("([x, y]) => panes[0].toPixels(x, y)", point)
        page.locator(".lines").first.click(position={"x": u, "y": v})
    until(page, "panes.every(p => p.answer && p.answer.cells)")
    ends = page.evaluate("[ends.start, ends.goal]")
    np.testing.assert_allclose(ends, [START, GOAL], atol=0.02)
    for k, name in enumerate(("A2", "Z2")):
        on = Lattice.named(name, 0.1)
        graph = LatticeGraph.rasterise(
            lambda p: rooms(A2, 1).state().of(A2.quantise(p)) == 1, on, [-0.5, -0.5], [8.5, 6.5],
            occupied_at=lambda p: rooms(A2, 1).state().of(A2.quantise(p)) == 2,
        )  # fmt: skip
        path = planners.astar(graph, *on.quantise(ends).tolist())
        assert page.evaluate("k => panes[k].answer.length", k) == pytest.approx(path.length, abs=1e-9)
        assert page.inner_text(f"#length-{k}") == f"{path.length:.2f} m"
    # What was entered can be played back.
    assert all(3 in page.evaluate(STATES, k) for k in (0, 1))
    page.click("#play")
    until(page, "playing && document.getElementById('time').value < 900")
    until(page, "!playing && document.getElementById('time').value == 1000")
    page.click("#clear")
    assert not any(3 in page.evaluate(STATES, k) for k in (0, 1))


def test_settings_change_the_path(compared: Path, opened: Open) -> None:
    page = opened(compared)
    for field, value in {"start-x": "1", "start-y": "1", "goal-x": "7", "goal-y": "1"}.items():
        page.fill(f"#{field}", value)

    def answered() -> list[float]:
        page.evaluate("document.activeElement.blur()")
        until(page, "panes.every(p => p.asked === null && p.answer && p.answer.ticket === ticket)")
        return page.evaluate("panes.map(p => [p.answer.length ?? null, p.answer.clearance ?? null])")[0]

    plain = answered()
    page.select_option("#neighbourhood", "extended")
    more = answered()
    assert more[0] <= plain[0]
    page.check("#any-angle")
    straight = answered()
    assert straight[0] < more[0] and page.is_disabled("#weight")
    page.uncheck("#any-angle")
    page.fill("#radius", "0.3")
    wide = answered()
    assert wide[0] > more[0] and wide[1] >= 0.3 * (1 - 1e-9)
    page.evaluate("document.getElementById('weight').value = 5; plan()")
    assert answered()[1] > wide[1]
    page.fill("#radius", "0.7")
    answered()
    assert "Nothing leads" in page.inner_text("#status")
    page.fill("#goal-x", "4")
    answered()
    assert "The goal is" in page.inner_text("#status")
    page.select_option("#level", "1")
    page.fill("#radius", "0")
    page.fill("#goal-x", "7")
    assert answered()[0] > 0


def test_it_pans_zooms_and_reads_cells_by_mouse_and_keyboard(compared: Path, opened: Open) -> None:
    page = opened(compared)
    first = page.locator(".lines").first
    box = first.bounding_box()
    before = page.evaluate("({...view})")
    page.mouse.move(200, 300)
    page.mouse.down()
    page.mouse.move(260, 280, steps=4)
    page.mouse.up()
    after = page.evaluate("({...view})")
    assert after["x"] == pytest.approx(before["x"] - 60 / before["scale"])
    assert after["y"] == pytest.approx(before["y"] - 20 / before["scale"])
    assert page.evaluate("ends.start") is None
    at = [260 - box["x"], 280 - box["y"]]
    under = page.evaluate("([u, v]) => panes[0].toMetres(u, v)", at)
    page.mouse.wheel(0, -400)
    until(page, f"view.scale > {after['scale']}")
    np.testing.assert_allclose(page.evaluate("([u, v]) => panes[0].toMetres(u, v)", at), under, atol=1e-9)
    cell = A2.quantise([under])[0].tolist()
    until(page, f"panes[0].caption.textContent.includes('cell ({cell[0]}, {cell[1]})')")
    fine = rooms(A2, 1).levels[0]
    hits, passes = (int(v.select(v.keys == pack(np.array([cell], np.int32))).total) for v in (fine.hits, fine.passes))
    assert f"{hits:,} hits, {passes:,} passes" in page.inner_text("figcaption output >> nth=0")
    page.keyboard.press("Tab")
    first.focus()
    page.keyboard.press("0")
    page.keyboard.press("a")
    assert page.evaluate("ends.start") == pytest.approx([4.0, 3.0], abs=0.2)
    page.keyboard.press("ArrowRight")
    page.keyboard.press("+")
    page.keyboard.press("b")
    assert page.evaluate("ends.goal[0] > ends.start[0]")
    page.keyboard.press("Escape")
    assert page.evaluate("ends.start") is None


def test_it_fits_phones_and_windows_that_change(compared: Path, opened: Open) -> None:
    page = opened(compared, 400, 800, has_touch=True, device_scale_factor=2, color_scheme="dark")
    assert page.evaluate("document.documentElement.scrollWidth") == 400
    for width, height in ((400, 800), (1200, 500), (700, 390)):
        page.set_viewport_size({"width": width, "height": height})
        until(page, "panes.every(p => p.canvas.width === Math.round(2 * p.lines.clientWidth) && p.canvas.width > 100)")
        assert page.evaluate("document.documentElement.scrollWidth") == width
        for k in (0, 1):
            assert {1, 2} <= set(page.evaluate(STATES, k))
    page.locator(".lines").first.tap(position={"x": 50, "y": 60})
    until(page, "ends.start !== null")
    # Two fingers that move apart.
    before = page.evaluate("view.scale")
    fingers = page.context.new_cdp_session(page)
    for kind, apart in (("touchStart", 20), ("touchMove", 25), ("touchMove", 35), ("touchMove", 50), ("touchEnd", 0)):
        points = [{"x": 150 + s * apart, "y": 200, "id": s} for s in (-1, 1)] if apart else []
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    until(page, f"view.scale > 1.3 * {before}")
    assert page.evaluate("ends.goal") is None


def test_a_map_of_others_and_a_frame_in_a_notebook(tmp_path: Path, opened: Open) -> None:
    states = np.ones((40, 30), np.uint8)
    states[20, 3:] = 2
    grid = GridMap(states, 0.1, np.array([5.0, 5.0]), yaw=0.2, y_down=True)
    shown = page_frame(grid, pixels=400)._repr_html_()
    (tmp_path / "notebook.html").write_text(f'<!DOCTYPE html><html data-state="ready">{shown}</html>')
    page = opened(tmp_path / "notebook.html")
    frame = page.frames[1]
    until(frame, "document.documentElement.dataset.state === 'ready'")
    a, b = grid.centre(np.array([[5, 20], [35, 20]])).tolist()
    frame.evaluate("([a, b]) => { place(a, 'start'); place(b, 'goal'); }", [a, b])
    until(frame, "panes[0].answer && panes[0].answer.cells")
    assert frame.evaluate("panes[0].answer.length") == pytest.approx(6.6)
    assert frame.evaluate("panes[0].toPixels(0, 1)[1] > panes[0].toPixels(0, 0)[1]")


def test_the_cells_come_back_after_the_graphics_card_was_taken_away(compared: Path, opened: Open) -> None:
    page = opened(compared)
    page.evaluate("card = panes[0].drawing.gl.getExtension('WEBGL_lose_context'); card.loseContext()")
    until(page, "panes[0].drawing.gl.isContextLost()")
    page.wait_for_timeout(50)
    page.evaluate("card.restoreContext()")
    until(page, f"!panes[0].drawing.gl.isContextLost() && ({STATES})(0).includes(2)")


def test_without_webgl_the_picture_is_shown(compared: Path, opened: Open, browser: Any) -> None:
    context = browser.new_context()
    context.add_init_script(
        "const get = HTMLCanvasElement.prototype.getContext;"
        "HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {"
        " return kind === 'webgl2' ? null : get.call(this, kind, ...rest); };"
    )
    page = context.new_page()
    page.goto(f"file://{compared}")
    until(page, "document.documentElement.dataset.state === 'ready'")
    assert page.locator(".pane img").first.is_visible() and not page.locator(".lines").first.is_visible()
    page.evaluate("([a, b]) => { place(a, 'start'); place(b, 'goal'); }", [START, GOAL])
    until(page, "panes.every(p => p.answer && p.answer.cells)")
    context.close()
