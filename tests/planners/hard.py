"""Maps on which looking along whole lines is dear: a spiral, a serpentine and sparse fields."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["MAPS", "serpentine", "sparse", "spiral"]

Case = tuple[NDArray[np.uint8], tuple[int, int], tuple[int, int]]


def spiral(side: int, width: int) -> Case:
    """Return the states of one corridor ``width`` cells wide that winds from the corner to the middle, and its ends."""
    free = np.ones((side, side), np.uint8)
    at, pitch = width, width + 1
    while side - 1 - 2 * at >= 2 * pitch:
        far = side - 1 - at
        free[at, max(at - pitch, 0) : far + 1] = 0
        free[at : far + 1, far] = 0
        free[far, at : far + 1] = 0
        free[at + pitch : far + 1, at] = 0
        at += pitch
    return free, (0, 0), (side // 2, side // 2)


def serpentine(side: int, width: int) -> Case:
    """Return the states of one corridor ``width`` cells wide that goes to and fro between two corners, and its ends."""
    free = np.ones((side, side), np.uint8)
    for turn, row in enumerate(range(width, side - width, width + 1)):
        if turn % 2 == 0:
            free[row, : side - width] = 0
        else:
            free[row, width:] = 0
    return free, (0, 0), (side - 1, side - 1)


def sparse(side: int, share: float) -> Case:
    """Return the states of a field of which a ``share`` of the cells is blocked, and two corners."""
    free = (np.random.default_rng(0).random((side, side)) >= share).astype(np.uint8)
    free[:3, :3] = free[-3:, -3:] = 1
    return free, (0, 0), (side - 1, side - 1)


MAPS = {
    "spiral, 3 wide": lambda side: spiral(side, 3),
    "spiral, 10 wide": lambda side: spiral(side, 10),
    "spiral, 40 wide": lambda side: spiral(side, 40),
    "serpentine, 1 wide": lambda side: serpentine(side, 1),
    "serpentine, 10 wide": lambda side: serpentine(side, 10),
    "serpentine, 1/5 wide": lambda side: serpentine(side, side // 5),
    "0.1 % blocked": lambda side: sparse(side, 0.001),
    "1 % blocked": lambda side: sparse(side, 0.01),
    "5 % blocked": lambda side: sparse(side, 0.05),
}
