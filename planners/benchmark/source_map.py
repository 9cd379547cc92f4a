"""The source map as the cases of the benchmark see it: its walls, and points that no path may slip through."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hexmap.base.arrays import FloatArray
from hexmap.io.grids.grid_map import GridMap
from hexmap.maps.cell_state import CellState

__all__ = ["Pinches", "Walls", "grid_coordinates", "grid_map_of"]

_NEAREST = {2: 24, 3: 96}  # blocked cells among which the nearest is; exact up to a cell's width of clearance


def grid_map_of(shared: Any) -> GridMap:
    """Return the source map that a worker was given."""
    return GridMap(
        states=np.asarray(shared["states"]),
        cell=float(shared["cell"]),
        origin=np.array(shared["origin"]),
        yaw=float(shared["yaw"]),
    )


def grid_coordinates(grid_map: GridMap, points: FloatArray) -> FloatArray:
    """Return points (N, n), metres, in units of the source cells: cell i spans i to i + 1."""
    shifted = points - grid_map.origin
    c, s = math.cos(grid_map.yaw), math.sin(grid_map.yaw)
    out = shifted.copy()
    out[:, 0] = c * shifted[:, 0] + s * shifted[:, 1]
    out[:, 1] = -s * shifted[:, 0] + c * shifted[:, 1]
    return out / grid_map.cell


class Pinches:
    """Points and edges of the source map where blocked cells touch only there, and free cells face each other across.

    No path may slip through between them: on the square grid the corner rule forbids it, but two cells
    of a finer or turned lattice may be neighbours right across. Two such cells, a move of length d
    apart, see the pinch at a right angle or more, so that the nearer of them is at most d / sqrt(2)
    from it: a map that is closed that far around every pinch leaks on no lattice.
    """

    def __init__(self, grid_map: GridMap, radius: float) -> None:
        """Find them; ``radius`` metres around each is closed, less than half a source cell."""
        self.grid_map = grid_map
        self.radius = radius
        # Vertices between the cells, the border included: vertex v touches the cells v - 1 and v.
        free = np.pad(grid_map.states == CellState.FREE, 1)
        n = grid_map.dim
        kinds = [axes for size in range(2, n + 1) for axes in itertools.combinations(range(n), size)]
        # Of the kinds that there are: many maps have none of most.
        masks = {axes: mask for axes in kinds if (mask := _pinched(free, axes)).any()}
        self._across = np.array([[axis in axes for axis in range(n)] for axes in masks], np.bool_).reshape(-1, n)
        self._shapes = np.array([mask.shape for mask in masks.values()], np.int64).reshape(-1, n)
        self._starts = np.cumsum([0, *(mask.size for mask in masks.values())], dtype=np.int64)
        self._pinched = np.concatenate([np.empty(0, np.bool_), *(mask.ravel() for mask in masks.values())])

    def closed(self, points: FloatArray) -> NDArray[np.bool_]:
        """Tell for each of ``points`` (N, n), metres, whether it is too near to a pinch."""
        w = self.grid_map
        out = np.zeros(len(points), np.bool_)
        if len(self._across) == 0:
            return out
        from planners.benchmark._source_map_kernels import near_pinch

        near_pinch(
            np.ascontiguousarray(points, dtype=np.float64),
            np.array(w.origin, dtype=np.float64),
            math.cos(w.yaw),
            math.sin(w.yaw),
            float(w.cell),
            float(self.radius) ** 2,
            self._across,
            self._shapes,
            self._starts,
            self._pinched,
            out,
        )
        return out


def _pinched(free: NDArray[np.bool_], axes: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return where the 2^k cells around a vertex of ``axes`` fall into groups of free cells that touch only there.

    ``free`` is padded by one cell; the answer is by vertex along ``axes`` and by padded cell along the others.
    """
    k = len(axes)
    corners = list(itertools.product((0, 1), repeat=k))

    def shifted(corner: tuple[int, ...]) -> NDArray[np.bool_]:
        cut = [slice(None)] * free.ndim
        for axis, c in zip(axes, corner, strict=True):
            cut[axis] = slice(c, free.shape[axis] - 1 + c)
        return free[tuple(cut)]

    code = np.zeros(shifted(corners[0]).shape, np.uint32)
    for bit, corner in enumerate(corners):
        code |= shifted(corner).astype(np.uint32) << np.uint32(bit)
    # Of each pattern of free cells around a vertex: whether steps over faces lead from one of them to all.
    table = np.zeros(1 << len(corners), np.bool_)
    for pattern in range(len(table)):
        cells = [c for bit, c in enumerate(corners) if pattern >> bit & 1]
        if len(cells) < 2:
            continue
        seen, todo = {cells[0]}, [cells[0]]
        while todo:
            a = todo.pop()
            for b in cells:
                if b not in seen and sum(x != y for x, y in zip(a, b, strict=True)) == 1:
                    seen.add(b)
                    todo.append(b)
        table[pattern] = len(seen) < len(cells)
    return np.asarray(table[code])


class Walls:
    """How far points are from the nearest blocked source cell, a true square or cube."""

    def __init__(self, states: NDArray[np.uint8]) -> None:
        """Find the blocked cells that a free cell touches; those around the map count too."""
        blocked = np.pad(states != CellState.FREE, 1, constant_values=True)
        inner = np.ones_like(blocked)
        for shift in itertools.product((-1, 0, 1), repeat=states.ndim):
            inner &= np.roll(blocked, shift, axis=tuple(range(states.ndim)))
        cells = np.argwhere(blocked & ~inner) - 1
        self.centres = cells + 0.5
        self.tree = cKDTree(self.centres)

    def distance(self, u: FloatArray) -> FloatArray:
        """Return the distances (N,) of points (N, n), all in units of the cells."""
        k = min(_NEAREST[u.shape[1]], len(self.centres))
        _, near = self.tree.query(u, k=k)
        gap = np.maximum(np.abs(u[:, None] - self.centres[near.reshape(len(u), k)]) - 0.5, 0.0)
        return np.asarray(np.sqrt((gap**2).sum(axis=2)).min(axis=1))
