"""Grid maps of the MovingAI benchmarks (``.map``): Sturtevant, "Benchmarks for grid-based pathfinding", 2012.

Four lines of header (``type octile``, ``height``, ``width``, ``map``), then a row of characters a line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hexmap.base.errors import FormatError
from hexmap.base.text import quoted, whole_number
from hexmap.io.grids.grid_map import GridMap, check_size
from hexmap.maps.cell_state import CellState

__all__ = ["parse"]

# Water can be swum in but not be entered from land, so that the benchmark's routes never do.
_PASSABLE, _BLOCKED = b".GS", b"@OTW"
_BAD = 255


def parse(path: Path, data: bytes, cell: float) -> GridMap:
    """Make a grid of the text of a ``.map`` file; ``.`` ``G`` ``S`` are free, ``@`` ``O`` ``T`` ``W`` occupied.

    Cell (x, y) is column x of row y, the top row is 0, and its centre lies at (x, y) times ``cell`` metres.

    Raises:
        FormatError: naming the line and what is wrong with it.
        TooLargeError: more cells than a dense array may have.
    """
    # Header and rows apart: a file may have any number of lines.
    lines = data.split(b"\n", 4)
    kind = lines[0].split()
    if kind[:1] != [b"type"]:
        raise FormatError(f"{path}, line 1: a MovingAI map begins with 'type octile', not with {quoted(lines[0])}")
    if kind != [b"type", b"octile"]:
        raise FormatError(f"{path}, line 1: only maps of type octile are read, not {quoted(lines[0])}")
    sizes: dict[bytes, int] = {}
    for k in (1, 2):
        words = lines[k].split() if k < len(lines) else []
        size = whole_number(words[1]) if len(words) == 2 else None
        if not words or words[0] not in (b"height", b"width") or words[0] in sizes or size is None:
            where = quoted(lines[k]) if k < len(lines) else "the end of the file"
            raise FormatError(f"{path}, line {k + 1}: 'height' and 'width' with an integer belong here, not {where}")
        if size == 0:
            raise FormatError(f"{path}, line {k + 1}: the map is empty: its {words[0].decode()} is 0")
        sizes[words[0]] = size
    if len(lines) < 4 or lines[3].split() != [b"map"]:
        where = quoted(lines[3]) if len(lines) > 3 else "the end of the file"
        raise FormatError(f"{path}, line 4: 'map' belongs here, not {where}")
    width, height = sizes[b"width"], sizes[b"height"]
    check_size(path, (width, height))
    text = lines[4].rstrip() if len(lines) > 4 else b""
    found = text.count(b"\n") + 1 if text else 0
    if found != height:
        raise FormatError(f"{path}, line {4 + found}: the map ends after {found} rows, its height is {height}")
    rows = [line.rstrip() for line in text.split(b"\n")]
    for k, row in enumerate(rows):
        if len(row) != width:
            raise FormatError(f"{path}, line {5 + k}: row {k} has {len(row)} characters, the width is {width}")
    table = np.full(256, _BAD, np.uint8)
    table[list(_PASSABLE)] = CellState.FREE
    table[list(_BLOCKED)] = CellState.OCCUPIED
    states = table[np.frombuffer(b"".join(rows), np.uint8).reshape(height, width)]
    if int(states.max()) == _BAD:
        y, x = (int(v) for v in np.argwhere(states == _BAD)[0])
        raise FormatError(
            f"{path}, line {5 + y}: column {x} is {quoted(rows[y][x : x + 1])}; "
            f"a cell is one of {' '.join((_PASSABLE + _BLOCKED).decode())}"
        )
    turned = np.ascontiguousarray(states.T)
    turned.setflags(write=False)
    return GridMap(turned, cell, np.full(2, -0.5 * cell), path=str(path), kind="movingai", y_down=True)
