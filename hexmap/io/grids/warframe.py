"""Voxel maps of the Warframe benchmarks (``.3dmap``): Brewer and Sturtevant, "Benchmarks for pathfinding in 3D", 2018.

``voxel X Y Z``, then a blocked voxel ``x y z`` a line.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from hexmap.base.errors import FormatError
from hexmap.base.text import quoted, whole_number
from hexmap.io.grids.grid_map import GridMap, check_size
from hexmap.maps.cell_state import CellState

__all__ = ["parse"]


def parse(path: Path, data: bytes, cell: float) -> GridMap:
    """Make a grid of the text of a ``.3dmap`` file: all voxels are free but those that it lists.

    The centre of the voxel (x, y, z) lies at (x, y, z) times ``cell`` metres.

    Raises:
        FormatError: naming the line and what is wrong with it.
        TooLargeError: more voxels than a dense array may have.
    """
    from hexmap.io.grids import _kernels as kernels

    head = data.partition(b"\n")[0]
    words = head.split()
    sizes = [whole_number(word) for word in words[1:]]
    if words[:1] != [b"voxel"] or len(sizes) != 3 or None in sizes:
        raise FormatError(f"{path}, line 1: a voxel map begins with 'voxel X Y Z', not with {quoted(head)}")
    shape = tuple(size for size in sizes if size is not None)
    if 0 in shape:
        raise FormatError(f"{path}, line 1: the map is empty: {' x '.join(map(str, shape))} voxels")
    check_size(path, shape, len(data))
    states = np.full(shape, CellState.FREE, np.uint8)
    text = np.frombuffer(data, np.uint8)
    begin = min(len(head) + 1, len(data))
    wrong = kernels.read_voxels(text, begin, np.array(shape, np.int64), int(CellState.OCCUPIED), states.reshape(-1))
    if wrong >= 0:
        line = data[wrong : wrong + 4096].partition(b"\n")[0]
        number = data.count(b"\n", 0, wrong) + 1
        raise FormatError(f"{path}, line {number}: {_complaint(line, shape)}")
    states.setflags(write=False)
    return GridMap(states, cell, np.full(3, -0.5 * cell), path=str(path), kind="warframe")


def _complaint(line: bytes, shape: tuple[int, ...]) -> str:
    words = line.split()
    if len(words) != 3:
        return f"a voxel is three integers, not {quoted(line)}"
    for axis, word, size in zip("xyz", words, shape, strict=True):
        if not re.fullmatch(rb"-?[0-9]+", word):
            return f"{axis} is {quoted(word)}, which is no integer"
        # Without int(): a number may have any number of digits.
        value = whole_number(word.lstrip(b"0") or b"0")
        if value is None or value >= size:
            return f"the voxel {quoted(line.strip())} is out of bounds: {axis} goes from 0 to {size - 1}"
    return f"a voxel is three integers, not {quoted(line)}"
