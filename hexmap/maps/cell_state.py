"""What a cell is: one enumeration for maps that were built and maps of others alike."""

from __future__ import annotations

from enum import IntEnum


class CellState(IntEnum):
    """What is known of a cell; arrays of states are uint8.

    Zero is unknown, so that an array of zeros says nothing about any cell. Large arrays are best compared
    with ``CellState.FREE.value``: for a member of an enumeration numpy first widens the array to int64.
    """

    UNKNOWN = 0
    FREE = 1
    OCCUPIED = 2
