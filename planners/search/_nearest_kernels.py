"""Numba kernel of the search for the reachable cell nearest to a point."""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit


class Window(NamedTuple):
    """A window of cells and where it lies in space.

    Attributes:
        first: (n,) index of the first inner cell.
        inner: (n,) inner cells along each index.
        pad: (n,) width of the padding.
        strides: (n,).
        basis: (n, n) of the lattice, columns, metres.
        row_norms: (n,) lengths of the rows of the inverse basis, 1 / metre.
    """

    first: np.ndarray
    inner: np.ndarray
    pad: np.ndarray
    strides: np.ndarray
    basis: np.ndarray
    row_norms: np.ndarray


@njit(cache=True, nogil=True)
def _rows_in_ball(window, position, radius, low, wide):
    """Write where rows begin and how many there are, by each index but the last, into ``low`` and ``wide``.

    The box around the ball, cut to the window: |index_i - position_i| <= row_norms[i] * distance.
    Returns the number of rows in all.
    """
    first, inner, _, _, _, row_norms = window
    total = np.int64(1)
    for i in range(low.shape[0]):
        reach = row_norms[i] * radius * (1.0 + 1e-9) + 1e-6
        begin = max(np.ceil(position[i] - reach), float(first[i]))
        end = min(np.floor(position[i] + reach), float(first[i] + inner[i] - 1))
        if begin > end:
            return np.int64(0)
        low[i] = np.int64(begin)
        wide[i] = np.int64(end) - low[i] + 1
        total *= wide[i]
    return total


@njit(cache=True, nogil=True)
def nearest_in_ball(labels, label, window, point, position, radius, any_one):
    """Return the cell of a component that is nearest to a point, and its distance; -1 if none is in the ball.

    Goes through the rows of the window (lines along the last index) in the order of the flat array,
    on each only through what lies in the ball, which shrinks with what is found. With ``any_one``
    the first cell in the ball is returned, which is the lowest.

    Args:
        labels: (size,) int32 component of each cell.
        label: the one wanted.
        window: of the cells.
        point: (n,) metres.
        position: (n,) the point in index coordinates.
        radius: metres.
        any_one: the first found will do.
    """
    first, inner, pad, strides, basis, _ = window
    n = strides.shape[0]
    last = n - 1
    low = np.empty(last, np.int64)
    wide = np.empty(last, np.int64)
    rows = _rows_in_ball(window, position, radius, low, wide)
    along = 0.0
    for j in range(n):
        along += basis[j, last] * basis[j, last]
    from_point = np.empty(n, np.float64)
    best = radius * radius
    found = np.int64(-1)
    for row in range(rows):
        # Where the row begins: flat, and in metres from the point at last index 0.
        rest = row
        flat = pad[last]
        for j in range(n):
            from_point[j] = -point[j]
        for i in range(last - 1, -1, -1):
            x = rest % wide[i]
            rest //= wide[i]
            x += low[i]
            flat += (x - first[i] + pad[i]) * strides[i]
            for j in range(n):
                from_point[j] += basis[j, i] * x
        # The row's points are from_point + t times the last basis vector; the nearest is at t = foot.
        foot = 0.0
        for j in range(n):
            foot -= from_point[j] * basis[j, last]
        foot /= along
        across = 0.0
        for j in range(n):
            v = from_point[j] + foot * basis[j, last]
            across += v * v
        # Half the chord that the ball cuts out of the row, with an allowance for rounding: the cells tell.
        half = best * (1.0 + 1e-9) - across
        if half < 0.0:
            continue
        half = np.sqrt(half / along) + 1e-6
        begin = max(np.ceil(foot - half), float(first[last]))
        end = min(np.floor(foot + half), float(first[last] + inner[last] - 1))
        if begin > end:
            continue
        for t in range(np.int64(begin), np.int64(end) + 1):
            if labels[flat + t - first[last]] != label:
                continue
            square = 0.0
            for j in range(n):
                v = from_point[j] + basis[j, last] * t
                square += v * v
            # On the ball's surface counts as inside; of equals the lowest flat cell stays.
            if square < best or (square == best and found < 0):
                best = square
                found = flat + t - first[last]
                if any_one:
                    return found, np.sqrt(best)
    return found, np.sqrt(best)
