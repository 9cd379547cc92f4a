"""The page: size of the file, time to open, to find a path and to draw a frame, in Chromium without a graphics card.

``python -m tests.benchmarks.page``; ``--map`` measures a map of your own. The simulated one is an office mapped from
true poses, at the resolution that gives the number of cells; the large one is many of it side by side.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.io.map_file import load_map
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.scan import Scan
from hexmap.simulator.buildings import make_building
from hexmap.simulator.events import simulate
from hexmap.simulator.laser import Laser
from hexmap.web.page import write_page
from tests.benchmarks._common import table

_FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
_SCREEN = {"width": 1200, "height": 800}

# Milliseconds until the answer to a query is there, the first one not counted, and what the search alone took.
_PATH = """async ([start, goal, moves, any]) => {
  const turn = () => new Promise((done) => {
    const channel = new MessageChannel();
    channel.port1.onmessage = done;
    channel.port2.postMessage(0);
  });
  document.getElementById("neighbourhood").value = moves;
  document.getElementById("any-angle").checked = any;
  ends.start = start;
  const whole = [], searched = [];
  for (let k = 0; k < 25; k++) {
    ends.goal = goal;
    panes[0].answer = null;
    const begin = performance.now();
    plan();
    while (!panes[0].answer) await turn();
    if (k) whole.push(performance.now() - begin);
    if (k) searched.push(panes[0].answer.ms);
  }
  const { expansions, length } = panes[0].answer;
  return [Math.min(...whole), Math.min(...searched), expansions, length ?? 0];
}"""
_FRAME = """() => {
  const {gl} = panes[0].drawing, one = new Uint8Array(4), times = [];
  for (let k = 0; k < 60; k++) {
    const begin = performance.now();
    view.x += 0.01;
    panes[0].draw();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, one);
    times.push(performance.now() - begin);
  }
  return Math.min(...times);
}"""


def office(cells: int) -> Map:
    """Return a map of an office with about so many known cells on its finest level."""
    events = list(simulate(make_building("office"), seed=7))
    resolution, found = 0.1, 0
    for levels in (1, 1, 3):
        builder = MapBuilder(Lattice.named("A2", resolution), levels)
        for event in events:
            if isinstance(event.event, Scan):
                builder.fuse(event.event, event.T_map_robot @ Laser().mount)
        made = builder.build()
        found = len(made.levels[0].columns()[0])
        resolution *= (found / cells) ** 0.5
    return made


def repeated(world: Map, times: int) -> Map:
    """Return ``times`` x ``times`` copies of a map side by side."""
    levels = []
    for level in world.levels:
        lists = []
        spread = np.concatenate([level.hits.index, level.passes.index])
        step = np.ptp(spread, axis=0) + 2
        for cells in (level.hits, level.passes):
            shifts = np.indices((times, times)).reshape(2, -1).T * step
            index = (cells.index[None] + shifts[:, None]).reshape(-1, 2)
            lists.append(VoxelList.from_cells(index, level.lattice, np.tile(cells.counts, times * times)))
        levels.append(Level(*lists))
    return Map(levels[:1])


def far_ends(world: Map) -> tuple[list[float], list[float]]:
    """Return the two free cells, metres, of the largest connected area that are farthest apart along a diagonal."""
    graph = LatticeGraph.from_map(world)
    labels = graph.components()
    inside = np.flatnonzero(labels == np.bincount(labels[labels >= 0]).argmax())
    centres = graph.centres(inside)
    along = centres.sum(axis=1)
    return centres[along.argmin()].tolist(), centres[along.argmax()].tolist()


def measure(browser: Any, name: str, world: Map, path: Path, paths: bool = True) -> None:
    """Write a map as a page, open it three times, and print what that takes."""
    begin = time.perf_counter()
    write_page(world, path, title=name)
    rows: list[list[object]] = [["page", "figure"], ["known cells", len(world.levels[0].columns()[0])]]
    rows += [["written, s", time.perf_counter() - begin], ["file, MB", path.stat().st_size / 1e6]]
    opened = []
    for _ in range(3):
        context = browser.new_context(viewport=_SCREEN)
        page = context.new_page()
        page.goto(f"file://{path}")
        while page.evaluate("document.documentElement.dataset.state") is None:
            page.wait_for_timeout(20)
        assert page.evaluate("document.documentElement.dataset.state") == "ready"
        opened.append(page.evaluate("performance.getEntriesByName('ready')[0].startTime"))
        if len(opened) < 3:
            context.close()
    rows.append(["opened, ms (least of 3)", min(opened)])
    rows.append(["frame of the whole map, ms", page.evaluate(_FRAME)])
    page.evaluate("view.scale *= 12")
    rows.append(["frame near by, ms", page.evaluate(_FRAME)])
    if paths:
        ends = far_ends(world)
        for moves, straight in (("neighbours", False), ("extended", False), ("neighbours", True)):
            whole, searched, expansions, length = page.evaluate(_PATH, [*ends, moves, straight])
            words = "any angle" if straight else moves
            rows.append([f"path of {length:.1f} m, {words}: {expansions:,} cells entered, ms", whole])
            rows.append(["   of which the search, ms", searched])
    context.close()
    print(name)
    table(rows)


def main(arguments: list[str] | None = None) -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--map", type=Path, help="a map of your own (.parquet)")
    parser.add_argument("--cells", type=int, default=500_000)
    parser.add_argument("--copies", type=int, default=49, help="of it in the large map; 0 for none")
    given = parser.parse_args(arguments)
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        print("the page is measured in Chromium, which is not installed")
        return
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver, tempfile.TemporaryDirectory() as folder:
        browser = driver.chromium.launch(executable_path=chromium, args=_FLAGS)
        world = load_map(given.map) if given.map else office(given.cells)
        measure(browser, given.map.name if given.map else "office", world, Path(folder) / "page.html")
        if given.copies:
            times = round(given.copies**0.5)
            measure(browser, f"{times} x {times} of it", repeated(world, times), Path(folder) / "large.html")
        browser.close()


if __name__ == "__main__":
    main()
