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


def bulk(occupied: NDArray[np.float64], *free: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the corners (2, 2), metres, of the boxes around the bulk of the occupied and of the free cells.

    A box reaches to the last cell that is near the bulk. Kinds without a cell are left out.

    Args:
        occupied: (N, n) centres, metres, of which x and y count.
        free: (M, n) the same, if there are any.
    """
    boxes = []
    for centres, fit in ((occupied, FIT), *((c, _FREE) for c in free)):
        if len(centres):
            flat = centres[:, :2]
            low, high = np.quantile(flat, (1.0 - fit, fit), axis=0)
            room = _NEAR * (high - low)
            corners = np.maximum(flat.min(axis=0), low - room), np.minimum(flat.max(axis=0), high + room)
            boxes.append(np.stack(corners))
    return boxes
