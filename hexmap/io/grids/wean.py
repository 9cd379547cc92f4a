"""The map of Wean Hall, CMU, and others that BeeSoft wrote (``.dat``).

Header lines such as ``robot_specifications->resolution 10``, in centimetres, then ``global_map[0]: Y X`` and X lines
of Y numbers each: -1 where nothing is known, else 0 to 1.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import FormatError
from hexmap.base.text import quoted, shown, whole_number
from hexmap.io.grids.grid_map import GridMap, check_size
from hexmap.maps.cell_state import CellState

__all__ = ["parse"]

_PREFIX = b"robot_specifications->"
_TITLE = b"global_map[0]:"
_METRE = 100.0  # in the file's units
# Of the numbers: one minus map_server's defaults of free_thresh and occupied_thresh, 0.196 and 0.65.
_FREE, _OCCUPIED = 0.804, 0.35


def parse(path: Path, data: bytes) -> GridMap:
    """Make a grid of the text of a BeeSoft map.

    A number is the probability that the cell is *free*, although the note beside the map of Wean Hall says that 1 is
    occupied: its corridors are 1 and its walls 0. With p one minus that number, a cell is free where p < 0.196 and
    occupied where p > 0.65, as map_server has it. What no beam has reached is 0.2 to 0.5 there and stays unknown.

    The low corner of the cell (x, y) lies at (x, y) times the resolution, x the line, y the number in it, and both axes
    ascend as the file does; so does BeeSoft's own reader name them. The logs confirm the handedness, which is all that
    they can tell of it, as they do not know where they are: drives of 60 s, matched over the whole map and all yaws,
    meet more walls so than with x and y exchanged (log 2, 120 s and 180 s after its start, in squares of 0.1 m seen as
    hexagons: 967 against 763 of 1,387 and 1,198 against 966 of 1,628 cells; both logs together 5,278 against 4,748 of
    7,380, and of log 1 in one piece 1,052 against 935 of 1,473). In straight corridors there is no difference.

    Raises:
        FormatError: naming the line and what is wrong with it.
        TooLargeError: more cells than a dense array may have.
    """
    lines = data.split(b"\n")
    head = next((k for k, line in enumerate(lines) if line.startswith(_TITLE)), None)
    if head is None:
        raise FormatError(f"{path}: no line 'global_map[0]: Y X' in the file; it is cut off, or of another kind")
    resolution = _resolution(path, lines[:head])
    sizes = [whole_number(word) for word in lines[head][len(_TITLE) :].split()]
    if len(sizes) != 2 or None in sizes:
        found = quoted(lines[head])
        raise FormatError(f"{path}, line {head + 1}: two integers belong after global_map[0]:, not {found}")
    height, width = (size for size in sizes if size is not None)
    if width == 0 or height == 0:
        raise FormatError(f"{path}, line {head + 1}: the map is empty: {width} x {height} cells")
    check_size(path, (width, height))
    rows = lines[head + 1 :]
    while rows and not rows[-1].strip():
        rows.pop()
    if len(rows) != width:
        raise FormatError(f"{path}, line {head + 1 + len(rows)}: the map ends after {len(rows)} lines of {width}")
    states = np.empty((width, height), np.uint8)
    for x, row in enumerate(rows):
        states[x] = _states(path, head + 2 + x, row, height)
    states.setflags(write=False)
    return GridMap(states, resolution, np.zeros(2), path=str(path), kind="wean")


def _resolution(path: Path, lines: list[bytes]) -> float:
    """Return the edge of a cell in metres, from the header."""
    for k, line in enumerate(lines):
        words = line.split()
        if words[:1] == [_PREFIX + b"resolution"]:
            try:
                value = float(words[1]) if len(words) == 2 else math.nan
            except ValueError:
                value = math.nan
            if not (math.isfinite(value) and value > 0.0):
                found = shown(b" ".join(words[1:]))
                raise FormatError(f"{path}, line {k + 1}: the resolution must be a positive number, not '{found}'")
            return value / _METRE
    raise FormatError(f"{path}: no line 'robot_specifications->resolution' before the map; it says how large a cell is")


def _states(path: Path, number: int, line: bytes, count: int) -> NDArray[np.uint8]:
    """Return the states (count,) of a line of numbers."""
    words = line.split()
    if len(words) != count:
        raise FormatError(f"{path}, line {number}: {len(words)} numbers, where {count} belong")
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        values = np.array([_number(word) for word in words])
    known = values != -1.0
    wrong = ~((values >= 0.0) & (values <= 1.0)) & known
    if wrong.any():
        at = int(np.argmax(wrong))
        raise FormatError(f"{path}, line {number}: number {at} is '{shown(words[at])}'; a cell is -1, or 0 to 1")
    out = np.full(count, CellState.UNKNOWN, np.uint8)
    out[known & (values > _FREE)] = CellState.FREE
    out[known & (values < _OCCUPIED)] = CellState.OCCUPIED
    return out


def _number(word: bytes) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan
