"""Numba kernels of the graph layer: moves over a padded flat window, without bounds checks.

All take the window as plain arrays: ``free`` (size,) uint8, the flat ``offsets`` (K,) of the moves
and, a move after the other, the flat offsets ``swept`` of the cells that it sweeps. The padding
around the window is blocked, and wide enough that no offset from a free cell leaves the array.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _is_open(free, at, k, offsets, swept_starts, swept):
    """Tell whether move ``k`` from the free cell ``at`` is allowed."""
    if free[at + offsets[k]] == 0:
        return False
    for s in range(swept_starts[k], swept_starts[k + 1]):  # noqa: SIM110 (a generator does not compile)
        if free[at + swept[s]] == 0:
            return False
    return True


@njit(cache=True, nogil=True)
def open_moves(free, at, offsets, swept_starts, swept, out):
    """Write which moves (K,) are allowed from the free cell ``at``."""
    for k in range(offsets.shape[0]):
        out[k] = _is_open(free, at, k, offsets, swept_starts, swept)


@njit(cache=True, nogil=True)
def count_edges(free, nodes, offsets, swept_starts, swept, starts):
    """Write into ``starts`` (M + 1,) where the edges of each of the ``nodes`` (M,) begin."""
    total = 0
    for i in range(nodes.shape[0]):
        starts[i] = total
        for k in range(offsets.shape[0]):
            if _is_open(free, nodes[i], k, offsets, swept_starts, swept):
                total += 1
    starts[nodes.shape[0]] = total


@njit(cache=True, nogil=True)
def fill_edges(free, nodes, offsets, swept_starts, swept, lengths, terrain, number, columns, costs):
    """Write the edges of all nodes in their order: the other end's number and the cost.

    ``number`` (size,) is the number of each free cell; ``terrain`` is empty where there is none.
    """
    w = 0
    for i in range(nodes.shape[0]):
        a = nodes[i]
        for k in range(offsets.shape[0]):
            if _is_open(free, a, k, offsets, swept_starts, swept):
                b = a + offsets[k]
                columns[w] = number[b]
                costs[w] = lengths[k]
                if terrain.shape[0] > 0:
                    costs[w] = lengths[k] * (terrain[a] + terrain[b]) / 2.0
                w += 1


@njit(cache=True, nogil=True)
def _root(parent, i):
    """Return the root of ``i``, halving the path on the way; parents are never above their children."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def label(free, backward, swept_starts, swept, out):
    """Write the component (size,) of each free cell, -1 for blocked ones; returns how many there are.

    Union-find in one pass: ``backward`` are the moves with negative flat offsets, which reach every
    edge once, because each move's opposite is a move as well. Roots are the lowest cells of their
    trees, so that a second pass in ascending order turns parents into labels in place.
    """
    for i in range(free.shape[0]):
        if free[i] == 0:
            out[i] = -1
            continue
        out[i] = i
        for k in range(backward.shape[0]):
            if _is_open(free, i, k, backward, swept_starts, swept):
                a = _root(out, i)
                b = _root(out, i + backward[k])
                if a < b:
                    out[b] = a
                elif b < a:
                    out[a] = b
    count = 0
    for i in range(free.shape[0]):
        if out[i] == i:
            out[i] = count
            count += 1
        elif out[i] >= 0:
            out[i] = out[out[i]]
    return count


@njit(cache=True, nogil=True)
def cells_in_box(begin, end, first, inner, pad, strides, basis, low, high, flat, points):
    """Write those of the inner cells ``begin`` to ``end`` whose centre lies in the box; returns how many.

    Inner cells are counted row by row without the padding; ``first`` (n,) is the index of the first.
    """
    n = first.shape[0]
    at = np.empty(n, np.int64)
    centre = np.empty(n, np.float64)
    w = 0
    for c in range(begin, end):
        rest = c
        for i in range(n - 1, -1, -1):
            at[i] = rest % inner[i]
            rest //= inner[i]
        inside = True
        for i in range(n):
            x = basis[i, 0] * (at[0] + first[0])
            for j in range(1, n):
                x += basis[i, j] * (at[j] + first[j])
            centre[i] = x
            if x < low[i] or x > high[i]:
                inside = False
                break
        if inside:
            here = 0
            for i in range(n):
                here += (at[i] + pad[i]) * strides[i]
                points[w, i] = centre[i]
            flat[w] = here
            w += 1
    return w


@njit(cache=True, nogil=True)
def mark_surface(solid, faces, inner, pad, strides, out):
    """Mark in ``out`` (size,) the solid cells that share a face with one that is not solid.

    No other solid cell can be the nearest one to a cell that is not solid: from inside a solid,
    some neighbour across a face is always nearer.
    """
    n = inner.shape[0]
    rows = 1
    for i in range(n - 1):
        rows *= inner[i]
    for r in range(rows):
        rest = r
        base = pad[n - 1]
        for i in range(n - 2, -1, -1):
            base += (rest % inner[i] + pad[i]) * strides[i]
            rest //= inner[i]
        for here in range(base, base + inner[n - 1]):
            if solid[here] == 0:
                for k in range(faces.shape[0]):
                    if solid[here + faces[k]] != 0:
                        out[here + faces[k]] = 1
            else:
                for k in range(faces.shape[0]):
                    if solid[here + faces[k]] == 0:
                        out[here] = 1
                        break


@njit(cache=True, nogil=True)
def block_around(cells, ball, first, inner, pad, strides, free):
    """Block all cells of the window that are one of the offsets ``ball`` (B, n) away from one of ``cells`` (M, n)."""
    n = first.shape[0]
    for c in range(cells.shape[0]):
        for b in range(ball.shape[0]):
            here = 0
            inside = True
            for i in range(n):
                x = cells[c, i] + ball[b, i] - first[i]
                if x < 0 or x >= inner[i]:
                    inside = False
                    break
                here += (x + pad[i]) * strides[i]
            if inside:
                free[here] = 0
