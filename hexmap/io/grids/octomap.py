"""Occupancy octrees of OctoMap in their binary form (``.bt``).

Hornung et al., "OctoMap: an efficient probabilistic 3D mapping framework based on octrees", 2013.
Each inner node is 16 bits, two a child: 00 unknown, 01 occupied, 10 free (the bit of lower value first),
11 an inner node, which follows depth first. Child 1 is on the far side in x, 2 in y, 4 in z.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hexmap.base.errors import FormatError
from hexmap.base.text import quoted, whole_number
from hexmap.io.grids.grid_map import GridMap, check_size
from hexmap.maps.cell_state import CellState

__all__ = ["MAGIC", "parse"]

MAGIC = b"# Octomap OcTree binary file"
# Trees of occupancy, whose binary form is the same: it holds neither colours nor stamps.
_TREES = (b"OcTree", b"ColorOcTree", b"OcTreeStamped")
_CENTRE = 32768  # key of the voxel whose low corner is at 0


def parse(path: Path, data: bytes) -> GridMap:
    """Make a grid of the bytes of a ``.bt`` file: the box of all known voxels, dense, at the finest depth.

    The voxel of key k is ``(k - 32768) res`` to ``(k - 32767) res`` metres along each axis. Pruned
    leaves fill the block that they stand for.

    Raises:
        FormatError: a bad header (the line is named), a tree that is cut off, too deep or of another
            number of nodes than the header says, or without any known voxel.
        TooLargeError: the box holds more voxels than a dense array may have.
    """
    from hexmap.io.grids import _kernels as kernels

    size, resolution, begin = _header(path, data)
    tree = np.frombuffer(data, np.uint8)
    counts = np.zeros(3, np.int64)
    low, high = np.full(3, 2**kernels.DEPTH, np.int64), np.zeros(3, np.int64)
    none = np.zeros(3, np.int64)
    # Plain integers: the kernel would compile again for an enumeration.
    occupied, free = int(CellState.OCCUPIED), int(CellState.FREE)

    def walk(fill: bool, first: np.ndarray, shape: np.ndarray, states: np.ndarray) -> int:
        return int(kernels.walk(tree, begin, low, high, counts, fill, first, shape, occupied, free, states))

    end = walk(False, none, none, np.empty(0, np.uint8)) if size else begin
    if end == -1:
        raise FormatError(
            f"{path}: the tree is cut off: the file ends at byte {len(data)}, after {counts[0]} of {size} nodes"
        )
    if end == -2:
        raise FormatError(f"{path}: damaged tree: a node at depth {kernels.DEPTH} has children")
    if int(counts[0] if size else 0) != size:
        raise FormatError(f"{path}: damaged tree: it has {counts[0]} nodes, the header says {size}")
    if not (low < high).all():
        raise FormatError(f"{path}: the map is empty: no voxel of it is known")
    shape = high - low
    check_size(path, tuple(int(s) for s in shape), len(data))
    states = np.full(tuple(int(s) for s in shape), CellState.UNKNOWN, np.uint8)
    walk(True, low, shape, states.reshape(-1))
    states.setflags(write=False)
    with np.errstate(over="ignore"):  # a grid says what is wrong with an origin that is not finite
        origin = np.asarray((low - _CENTRE) * resolution)
    return GridMap(states, resolution, origin, path=str(path), kind="octomap")


def _header(path: Path, data: bytes) -> tuple[int, float, int]:
    """Return the number of nodes, the edge of a voxel and where the tree begins."""
    found: dict[bytes, bytes] = {}
    at, number = 0, 0
    while True:
        end = data.find(b"\n", at)
        number += 1
        if end < 0 or end - at > 4096:
            raise FormatError(
                f"{path}, line {number}: the header of an OctoMap ends with a line 'data', which is missing"
            )
        line = data[at:end].strip()
        at = end + 1
        if number == 1 and not line.startswith(MAGIC):
            raise FormatError(f"{path}, line 1: an OctoMap begins with {quoted(MAGIC)}, not with {quoted(line)}")
        if line == b"data":
            break
        if not line or line.startswith(b"#"):
            continue
        key, _, value = line.partition(b" ")
        value = value.strip()
        if key == b"id" and value not in _TREES:
            raise FormatError(
                f"{path}, line {number}: only trees of id {b', '.join(_TREES).decode()} are read, not {quoted(value)}"
            )
        if key == b"size" and whole_number(value) is None:
            raise FormatError(f"{path}, line {number}: the size must be a number of nodes, not {quoted(value)}")
        if key == b"res" and _edge(value) is None:
            raise FormatError(f"{path}, line {number}: the resolution must be a positive number, not {quoted(value)}")
        found[key] = value
    for key in (b"id", b"size", b"res"):
        if key not in found:
            raise FormatError(f"{path}, line {number}: the header ends without {key.decode()!r}")
    size, resolution = whole_number(found[b"size"]), _edge(found[b"res"])
    assert size is not None and resolution is not None
    return size, resolution, at


def _edge(word: bytes) -> float | None:
    try:
        value = float(word)
    except ValueError:
        return None
    return value if math.isfinite(value) and value > 0.0 else None
