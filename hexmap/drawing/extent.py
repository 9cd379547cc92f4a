"""What a picture is made for: the bulk of the cells, without the strays far from it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["FIT", "bulk"]

# Beams through windows, off mirrors and along glass leave lone cells and rays far outside. On each side this fraction
# of the cells may stray: an outer wall holds more of the occupied cells, a room more of the free ones.
FIT = 0.995  # of the occupied cells are no strays, on each side
_FREE = 0.98
_NEAR = 0.08  # of the width of the bulk: what is no farther off is no stray
_MOST_HITS = 10  # that a cell counts for: seen again and again it is a wall, however long the robot stood before it
_RAYS = 0.1  # of the free cells: as many beyond a side of the occupied ones' box are rays, more are a place


def bulk(
    occupied: NDArray[np.float64], *free: NDArray[np.float64], hits: NDArray[np.int64] | None = None
) -> list[NDArray[np.float64]]:
    """Return the corners (2, 2), metres, of the boxes around the bulk of the occupied and of the free cells.

    A box reaches to the last cell that is near the bulk. That of free cells ends a margin beyond the occupied ones
    where only few of them lie farther out: the far ends of rays that met nothing or almost nothing. Kinds without a
    cell are left out.

    Args:
        occupied: (N, n) centres, metres, of which x and y count.
        free: (M, n) the same, if there are any.
        hits: (N,) of the occupied cells, which count for that many, up to ten.
    """
    boxes: list[NDArray[np.float64]] = []
    if len(occupied):
        weights = np.ones(len(occupied)) if hits is None else np.minimum(hits, _MOST_HITS).astype(np.float64)
        boxes.append(_box(occupied[:, :2], weights, FIT))
    for centres in (c[:, :2] for c in free if len(c)):
        box = _box(centres, np.ones(len(centres)), _FREE)
        if len(occupied):
            low, high = boxes[0]
            margin = _NEAR * float((high - low).max())
            low, high = low - margin, high + margin
            box[0] = np.where((centres < low).mean(axis=0) <= _RAYS, np.maximum(box[0], low), box[0])
            box[1] = np.where((centres > high).mean(axis=0) <= _RAYS, np.minimum(box[1], high), box[1])
        boxes.append(box)
    return boxes


def _box(centres: NDArray[np.float64], weights: NDArray[np.float64], fit: float) -> NDArray[np.float64]:
    """Return the corners (2, 2) of the box around the bulk of weighted centres (N, 2)."""
    low, high = np.empty(2), np.empty(2)
    for axis in range(2):
        order = np.argsort(centres[:, axis], kind="stable")
        share = np.cumsum(weights[order]) / weights.sum()
        first, last = np.searchsorted(share, (1.0 - fit, fit))
        low[axis], high[axis] = centres[order[[first, min(last, len(order) - 1)]], axis]
    room = _NEAR * (high - low)
    return np.stack([np.maximum(centres.min(axis=0), low - room), np.minimum(centres.max(axis=0), high + room)])
