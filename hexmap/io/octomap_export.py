"""Write a map in space as an OctoMap in its binary form (``.bt``), as :mod:`hexmap.io.grids.octomap` reads it.

Hornung et al., "OctoMap: an efficient probabilistic 3D mapping framework based on octrees", 2013.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap.base.atomic_files import PathLike, atomic_write
from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.maps.cubes import Cubes, cubes_of
from hexmap.maps.state_rule import States

__all__ = ["export_octomap", "octree"]

_DEPTH = 16
_CENTRE = 1 << (_DEPTH - 1)  # key of the voxel whose low corner is at 0
_FREE, _OCCUPIED, _INNER = 1, 2, 3  # the two bits of a child


def export_octomap(states: States, path: PathLike) -> Cubes:
    """Write the occupied and free cells of a map in space as a pruned octree of cubes.

    Args:
        states: the cells; :func:`hexmap.maps.cubes.cubes_of` says which cubes they fill, as large as a cell.
        path: the file.

    Returns:
        The cubes, and what they lose of the cells.

    Raises:
        ArgumentError: the map is in the plane.
        BoundsError: a cube is beyond the 2^15 on each side of the origin that an OctoMap holds.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    if states.occupied.lattice.dim != 3:
        raise ArgumentError(f"{path}: an OctoMap is in space and this map is in the plane; export it to .yaml or .csv")
    cubes = cubes_of(states)
    for kind in (cubes.occupied, cubes.free):
        beyond = ((kind < -_CENTRE) | (kind >= _CENTRE)).any(axis=1)
        if beyond.any():
            corner = (kind[int(np.argmax(beyond))] * cubes.edge).tolist()
            raise BoundsError(
                f"{path}: an OctoMap with voxels of {cubes.edge:g} m ends {_CENTRE * cubes.edge:g} m from the origin, "
                f"and a cell is at {', '.join(f'{v:g}' for v in corner)} m; export a coarser level, or crop the map"
            )
    nodes, words = octree(cubes.occupied + _CENTRE, cubes.free + _CENTRE)
    header = (
        "# Octomap OcTree binary file\n# (feel free to add / change comments, but leave the first line as it is!)\n#\n"
        f"id OcTree\nsize {nodes}\nres {cubes.edge!r}\ndata\n"
    )
    with atomic_write(path) as handle:
        handle.write(header.encode("ascii"))
        handle.write(words.astype("<u2").tobytes())
    return cubes


def octree(occupied: NDArray[np.int64], free: NDArray[np.int64]) -> tuple[int, NDArray[np.uint16]]:
    """Return how many nodes a pruned octree has, and the 16 bits of each inner node, depth first.

    Args:
        occupied: (A, 3) keys of voxels, each from 0 to 2^16 - 1.
        free: (B, 3) the same, none of them occupied.
    """
    codes = np.concatenate([_interleaved(occupied), _interleaved(free)])
    order = np.argsort(codes)
    codes = codes[order]
    kinds = np.concatenate([np.full(len(occupied), _OCCUPIED), np.full(len(free), _FREE)])[order].astype(np.uint16)
    if len(codes) == 0:
        return 0, np.empty(0, np.uint16)
    nodes, starts, depths, words = 1, [], [], []
    # From the leaves to the root: the children of a node stand together, since the codes are sorted.
    for depth in range(_DEPTH - 1, -1, -1):
        parents = codes >> 3
        first = np.flatnonzero(np.diff(parents, prepend=-1))
        word = np.bitwise_or.reduceat(kinds << (2 * (codes & 7)).astype(np.uint16), first)
        # Eight leaves of one kind are a leaf of that kind; the root stays a node, whatever it holds.
        kind = np.full(len(first), _INNER, np.uint16)
        if depth > 0:
            kind[word == 0xFFFF // 3 * _FREE] = _FREE
            kind[word == 0xFFFF // 3 * _OCCUPIED] = _OCCUPIED
        inner = kind == _INNER
        counts = np.diff(first, append=len(codes))
        nodes += int(counts[inner].sum())
        starts.append(parents[first][inner] << 3 * (_DEPTH - depth))
        depths.append(np.full(int(inner.sum()), depth))
        words.append(word[inner])
        codes, kinds = parents[first], kind
    # Depth first: a node stands before all that begin with its code, the shallower one first.
    order = np.lexsort((np.concatenate(depths), np.concatenate(starts)))
    return nodes, np.concatenate(words)[order]


def _interleaved(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the Morton codes (N,) of keys (N, 3): of each three bits x is the lowest, z the highest."""
    code = np.zeros(len(keys), np.int64)
    for axis in range(3):
        v = keys[:, axis].copy()
        # Two zeros between any two of the 16 bits, by halves.
        for shift, mask in ((16, 0x0000FF0000FF), (8, 0x00F00F00F00F), (4, 0x0C30C30C30C3), (2, 0x249249249249)):
            v = (v | (v << shift)) & mask
        code |= v << axis
    return code
