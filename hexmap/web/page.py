"""Write a map as one HTML file to look and plan in: it needs no other file, no network and no server.

What the page looks like is in ``page.html.jinja`` and ``page.css``, what it does in the scripts beside this module.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import os
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError
from hexmap.base.version import __version__
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule, States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.trajectory import Trajectory
from hexmap.web.payload import PageLevel, PageMap, heights_of, level_numbers, on_lattice, page_map, trajectory_runs

__all__ = ["check_suffix", "page_html", "write_page"]

# The first run in a worker.
_PLANNER = ("lattice.js", "planner.js", "sight.js", "worker.js")
_PAGE = ("cells.js", "draw.js", "overlay.js", "pane.js", "input.js", "page.js")
_STILL = 60.0  # pixels an inch of the picture for browsers without WebGL 2
_ROWS = {
    "length": "Length",
    "turning": "Turning",
    "clearance": "Least clearance",
    "expansions": "Cells entered",
    "ms": "Search",
}
_MOVES = {"neighbours": "nearest", "faces": "across faces", "extended": "extended"}


def write_page(
    source: Map | GridMap,
    path: str | os.PathLike[str],
    *,
    trajectory: Trajectory | FloatArray | None = None,
    compare: str | Lattice | None = None,
    rule: StateRule | None = None,
    title: str | None = None,
    height: float | None = None,
) -> Path:
    """Write a page (``.html``) and return its path; the same arguments give the same bytes.

    Args:
        source: a map, of hexmap or of others; in one that is in space there is only to look, at horizontal slices.
        path: of the file.
        trajectory: where the robot went, in the map's frame: a trajectory or positions (N, 2) or (N, 3), metres; a row
            that is not finite interrupts the line.
        compare: a second lattice on which the same world is shown beside the first: its name, or the lattice of the
            finest level.
        rule: what makes a cell occupied or free; the default rule where none is given.
        title: what the page is called; the file's name where there is none.
        height: of the first slice through a map in space, metres; the page shows the nearest height of any centre.

    Raises:
        ArgumentError: another suffix, a map without known cells, a map in space without a height or one in the plane
            with a height, a trajectory of another shape.
        LatticeError: there is no lattice of that name.
        TooLargeError: the cells are spread too widely for a browser.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    check_suffix(path)
    html = page_html(source, trajectory=trajectory, compare=compare, rule=rule, title=title or path.stem, height=height)
    with atomic_write(path) as file:
        file.write(html.encode("utf-8"))
    return path


def check_suffix(path: Path) -> None:
    """Check that a page is called one.

    Raises:
        ArgumentError: its suffix is another.
    """
    if path.suffix.lower() not in (".html", ".htm"):
        raise ArgumentError(f"{path}: a page is written as .html, not {path.suffix or 'a file without a suffix'}")


def page_html(
    source: Map | GridMap,
    *,
    trajectory: Trajectory | FloatArray | None = None,
    compare: str | Lattice | None = None,
    rule: StateRule | None = None,
    title: str = "Map",
    height: float | None = None,
) -> str:
    """Return the page as text, for a file or for the ``srcdoc`` of a frame; see :func:`write_page`."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    first = page_map(source, rule)
    maps = [first] if compare is None else [first, on_lattice(source, first, compare)]
    numbers, data = _numbers(maps)
    heights, at = _cut(first, height)
    header = {
        "heights": heights,
        "cut": at,
        "bounds": _bounds(maps),
        "yDown": first.y_down,
        "trajectory": trajectory_runs(trajectory, first.levels[0].lattice.resolution),
        "maps": numbers,
    }
    planner, script = _sources(_PLANNER), _sources(_PAGE)
    style = _sources(("page.css",))
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    text = (resources.files("hexmap.web") / "page.html.jinja").read_text(encoding="utf-8")
    return environment.from_string(text).render(
        title=title,
        version=__version__,
        summary=_summary(first, source),
        maps=[{"title": m.title, "label": f"{m.title}, {m.levels[0].lattice.resolution:.4g} m"} for m in maps],
        level_names=[f"{level.lattice.resolution:.4g} m" for level in first.levels],
        neighbourhoods={} if heights else _neighbourhood_words(numbers),
        heights=len(heights),
        rows=_ROWS,
        stills=[_still(m, heights[at] if heights else None) for m in maps],
        header=Markup(_json(header)),
        data=data,
        planner=Markup(planner),
        script=Markup(script),
        style=Markup(style),
        hashes=[Markup(_hash(planner)), Markup(_hash(script))],
        style_hash=Markup(_hash(style)),
    )


def _sources(names: Sequence[str]) -> str:
    folder = resources.files("hexmap.web")
    return "\n" + "\n".join((folder / name).read_text(encoding="utf-8") for name in names)


def _hash(text: str) -> str:
    """Return what a content security policy calls a script or a style of this text."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode('utf-8')).digest()).decode('ascii')}'"


def _json(value: Any) -> str:
    """Return JSON that cannot end the element that it stands in."""
    text = json.dumps(value, ensure_ascii=True, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _numbers(maps: Sequence[PageMap]) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Return the maps as plain numbers, and the text of each level's cells by the id of its element."""
    numbers, data = [], {}
    for m, page in enumerate(maps):
        levels = []
        for k, level in enumerate(page.levels):
            values, data[f"cells-{m}-{k}"] = level_numbers(level, page.rule)
            levels.append(values)
        numbers.append({"title": page.title, "rule": asdict(page.rule), "levels": levels})
    return numbers, data


def _cut(page: PageMap, height: float | None) -> tuple[list[float], int]:
    """Return the heights of a map in space, none of one in the plane, and which of them is shown first."""
    level = page.levels[0]
    if level.lattice.dim == 2:
        if height is not None:
            raise ArgumentError(f"the map is in the plane: there is no slice of it at {height:g} m")
        return [], 0
    if height is None or not math.isfinite(height):
        raise ArgumentError("the map is in space: a page shows slices of it, and needs the height of the first one")
    heights = heights_of(level)
    return heights, min(range(len(heights)), key=lambda k: abs(heights[k] - height))


def _bounds(maps: Sequence[PageMap]) -> list[float]:
    """Return left, low, right and high border of all cells of the finest levels, metres."""
    low, high = [], []
    for page in maps:
        level = page.levels[0]
        centres = level.lattice.centres(level.index) + level.origin
        low.append(centres.min(axis=0) - level.lattice.covering_radius)
        high.append(centres.max(axis=0) + level.lattice.covering_radius)
    return [*np.min(low, axis=0)[:2].tolist(), *np.max(high, axis=0)[:2].tolist()]


def _summary(page: PageMap, source: Map | GridMap) -> str:
    level = page.levels[0]
    states = level.states_by(page.rule)
    occupied, free = (int((states == s.value).sum()) for s in (CellState.OCCUPIED, CellState.FREE))
    frame = f", frame {source.frame}" if isinstance(source, Map) else f", {source.kind} map"
    return f"{occupied:,} occupied and {free:,} free cells of {level.lattice.resolution:.4g} m{frame}"


def _neighbourhood_words(numbers: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Return the neighbourhoods that every map has, and how many moves each of them has there."""
    counts = [{n["name"]: len(n["moves"]) for n in m["levels"][0]["neighbourhoods"]} for m in numbers]
    return {
        name: f"{_MOVES[name]}: {', '.join(str(count[name]) for count in counts)}"
        for name in counts[0]
        if all(name in count for count in counts)
    }


def _still(page: PageMap, height: float | None) -> str:
    """Return the picture of the finest level, or of a slice through it, PNG in base64."""
    from hexmap.drawing.map_drawing import draw_states
    from hexmap.drawing.slice_drawing import draw_slice

    level = page.levels[0]
    states = _states(level, page.rule)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.png"
        if height is None:
            draw_states(states, path, dpi=_STILL)
        else:
            draw_slice(states, height, path, offset=level.origin, dpi=_STILL)
        return base64.b64encode(path.read_bytes()).decode("ascii")


def _states(level: PageLevel, rule: StateRule) -> States:
    """Return a level as the drawing takes it, the cell 0 at the origin."""
    states = level.states_by(rule)
    occupied, free = (states == s.value for s in (CellState.OCCUPIED, CellState.FREE))
    counts = level.hits, level.passes
    lists = [
        VoxelList.from_cells(level.index[which], level.lattice, None if of is None else of[which])
        for which, of in zip((occupied, free), counts, strict=True)
    ]
    return States(*lists)
