"""Cells as shapes: which class each pixel is of, and the outlines of whole sets of cells.

Used by pictures and exports. Everything follows from the lattice's basis and the polytope of its
cell, so squares, hexagons and the cells of any other lattice go through the same lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexmap.base.values import one_line
from hexmap.lattice.keys import key_delta, pack
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox
from hexmap.maps.voxel_list import VoxelList

__all__ = ["CellCorners", "ClassTable", "Rings", "outline", "pixel_rows", "row_numbers", "silhouette"]

# A window of this many cells is looked up by address (one byte a cell), a larger one by searching.
_WINDOW = 1 << 28
_PIXELS_AT_ONCE = 1 << 18


class ClassTable:
    """Small numbers by cell, for looking up many points of the plane at once."""

    def __init__(self, lattice: Lattice, lists: list[tuple[VoxelList, NDArray[np.uint8]]]) -> None:
        """Make a table of disjoint lists, each with a class (M,) from 1 to 255 for each cell; 0 elsewhere."""
        self.lattice = lattice
        index = np.concatenate([cells.index for cells, _ in lists] or [np.empty((0, lattice.dim), np.int32)])
        classes = np.concatenate([c for _, c in lists] or [np.empty(0, np.uint8)])
        self._empty = len(index) == 0
        if self._empty:
            return
        self._box = IndexBox.of_cells(index)
        self._dense = self._box.size <= _WINDOW
        if self._dense:
            # One more at the end, where the position -1 of all cells outside the box leads.
            self._window = np.zeros(self._box.size + 1, np.uint8)
            self._window[self._box.flat(index)] = classes
        else:
            keys = pack(index)
            order = np.argsort(keys)
            self._keys, self._classes = keys[order], classes[order]

    def at(self, points: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the class (N,) of the cell that each of ``points`` (N, n), metres, lies in."""
        if self._empty:
            return np.zeros(len(points), np.uint8)
        index = self.lattice.quantise(points)
        if not self._dense:
            keys = pack(index)
            at = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
            return np.where(self._keys[at] == keys, self._classes[at], 0).astype(np.uint8)
        return self._window[self._box.flat(index)]


def pixel_rows(
    xs: NDArray[np.float64], ys: NDArray[np.float64], multiple: int = 1
) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Yield the points (K, 2) of a grid with columns ``xs`` and rows ``ys``, some whole rows at a time.

    How many rows at a time is a multiple of ``multiple``, so that the samples of a pixel stay together.
    """
    rows = max(1, _PIXELS_AT_ONCE // (multiple * max(1, len(xs)))) * multiple
    for start in range(0, len(ys), rows):
        some = ys[start : start + rows]
        points = np.empty((len(some), len(xs), 2))
        points[:, :, 0] = xs
        points[:, :, 1] = some[:, None]
        yield slice(start, start + len(some)), points.reshape(-1, 2)


@dataclass(frozen=True)
class Rings:
    """Closed polygons: ``points`` (P, 2), metres; ring k is ``points[ends[k - 1]:ends[k]]``.

    Outer boundaries run counter-clockwise and holes clockwise, so both common filling rules agree.
    """

    points: NDArray[np.float64]
    ends: NDArray[np.int64]

    __repr__ = one_line


def outline(cells: VoxelList) -> Rings:
    """Return the boundary of the union of the cells of a list in the plane.

    Edges that two of the cells share cancel; the others are chained by vertices that are known by
    integers, not by their coordinates, so nothing depends on rounding. Corners between edges that
    go straight on are left out.
    """
    corners = CellCorners(cells.lattice)
    starts, ends, faces = _boundary_edges(cells, corners)
    if len(faces) == 0:
        return Rings(np.empty((0, 2)), np.empty(0, np.int64))
    number = row_numbers(np.concatenate([starts, ends]))
    # As many edges end in a vertex as start there: pair them in order. Following is then a permutation.
    by_start = np.argsort(number[: len(starts)], kind="stable")
    by_end = np.argsort(number[len(starts) :], kind="stable")
    following = np.empty(len(starts), np.int64)
    following[by_end] = by_start
    order, sizes = _cycles(following)
    first = np.cumsum(sizes) - sizes
    before = np.arange(len(order)) - 1
    before[first] = first + sizes - 1
    bends = faces[order] != faces[order[before]]
    ring = np.repeat(np.arange(len(sizes)), sizes)
    return Rings(corners.points(starts[order[bends]]), np.cumsum(np.bincount(ring[bends], minlength=len(sizes))))


class CellCorners:
    """The corners of all cells of a lattice, each known by integers: a lattice point and a kind, n + 1 numbers.

    Two corners of a cell that differ by a lattice vector are of one kind: hexagons have two kinds, squares and
    cubes one, a truncated octahedron six. So a corner has one name, whichever of its cells it is reached from.

    Attributes:
        names: (V, n + 1) int64, of the corners of the cell at the origin, in the order of its vertices.
        kinds: (K, n) float64, metres, a corner of each kind.
    """

    def __init__(self, lattice: Lattice) -> None:
        """Name the corners of the cell at the origin."""
        self._lattice = lattice
        kinds: list[NDArray[np.float64]] = []
        self.names = np.array([self._name(vertex, kinds) for vertex in lattice.cell.vertices], np.int64)
        self.kinds = np.array(kinds)

    def _name(self, vertex: NDArray[np.float64], kinds: list[NDArray[np.float64]]) -> list[int]:
        """Return lattice point and kind of a corner; a kind that is not known yet is added to ``kinds``."""
        for kind, known in enumerate(kinds):
            apart = np.linalg.solve(self._lattice.basis, vertex - known)
            if np.abs(apart - np.rint(apart)).max() < 1e-6:
                return [*np.rint(apart).astype(int).tolist(), kind]
        kinds.append(vertex)
        return [*(0 for _ in vertex), len(kinds) - 1]

    def points(self, names: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the positions (N, n), metres, of corners (N, n + 1)."""
        return self._lattice.centres(names[:, :-1]) + self.kinds[names[:, -1]]


def _boundary_edges(
    cells: VoxelList, corners: CellCorners
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return the edges with a cell of the list on one side only: corners (E, 3), (E, 3) and faces (E,).

    Edges run with the cell on their left.
    """
    cell = cells.lattice.cell
    starts, ends, faces = [], [], []
    for face, (vector, ring) in enumerate(zip(cell.faces, cell.rings, strict=True)):
        alone = cells.select(~_contains(cells.keys, cells.keys + key_delta(vector))).index.astype(np.int64)
        i, j = ring
        if np.linalg.det(cell.vertices[[i, j]]) < 0.0:
            i, j = j, i
        base = np.column_stack([alone, np.zeros(len(alone), np.int64)])
        starts.append(base + corners.names[i])
        ends.append(base + corners.names[j])
        faces.append(np.full(len(alone), face, np.int64))
    return np.concatenate(starts), np.concatenate(ends), np.concatenate(faces)


def _contains(keys: NDArray[np.int64], wanted: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which of ``wanted`` (N,) are among the sorted ``keys``."""
    if len(keys) == 0:
        return np.zeros(len(wanted), np.bool_)
    return np.asarray(keys[np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)] == wanted)


def row_numbers(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number (N,) for each row (N, k), the same for the same rows, in lexicographic order."""
    number = np.zeros(len(rows), np.int64)
    for column in rows.T:
        # Ranks instead of values: the product of the numbers of distinct values cannot overflow.
        values, rank = np.unique(column, return_inverse=True)
        number = number * len(values) + rank
    return number


def _cycles(following: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the elements of a permutation cycle by cycle, and the length of each cycle."""
    following_list: list[int] = following.tolist()
    seen = bytearray(len(following_list))
    order: list[int] = []
    sizes: list[int] = []
    for start in range(len(following_list)):
        if seen[start]:
            continue
        before = len(order)
        at = start
        while not seen[at]:
            seen[at] = 1
            order.append(at)
            at = following_list[at]
        sizes.append(len(order) - before)
    return np.array(order, np.int64), np.array(sizes, np.int64)


def silhouette(lattice: Lattice, seen: tuple[int, int] = (0, 1)) -> NDArray[np.float64]:
    """Return the cell as it looks along the axis not ``seen``: a convex polygon (K, 2), metres, counter-clockwise.

    By default it is seen from above.
    """
    if lattice.dim == 2:
        return lattice.cell.vertices
    from scipy.spatial import ConvexHull

    flat = lattice.cell.vertices[:, seen]
    # Vertices above one another differ by rounding only; the hull should not see two of them.
    flat = np.unique(np.round(flat, 9 - int(np.floor(np.log10(lattice.resolution)))), axis=0)
    return np.asarray(flat[ConvexHull(flat).vertices])
