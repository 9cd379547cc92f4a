"""A warehouse of several floors that resemble one another, joined by ramps one above the other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.simulator.space.building import Building3D, SolidList

__all__ = ["BUILDINGS_3D", "make_building_3d"]

BUILDINGS_3D = ("warehouse3d",)
"""Names of the built-in buildings in space."""

# The plan, metres: a hall of 30 x 20 m with a bay for the ramps along its south side.
_LENGTH, _DEPTH, _STOREY = 30.0, 20.0, 3.6
_SLAB, _WALL = 0.3, 0.3
_BAY = 2.6  # the ramps lie south of this
_RAMP = (7.0, 23.0)  # from where to where they rise, along x: 12.7 degrees
_RAMP_THICKNESS = 0.25
# Three rows of racks with a cross aisle between their halves; the aisles between them are 2.8 m wide.
_ROWS, _HALVES = (6.6, 10.4, 14.2), (6.0, 16.2)
_UNIT, _RACK_DEPTH, _UNITS = 2.6, 1.0, 3
_MIDDLE = 15.0
# How strongly things reflect, beside the 0.4 of walls and floors.
_STEEL, _CARDBOARD, _PAINT = 0.25, 0.6, 0.85


def make_building_3d(name: str, seed: int = 0, floors: int = 3) -> Building3D:
    """Return the built-in building in space called ``name``: one of ``BUILDINGS_3D``.

    The walls, the ramps, the rows of racks, the pillars and the path are the same for every seed, and the racks and a
    part of what stands in them are the same on every floor. The rest, the windows and the rooms differ by seed and
    floor.

    Args:
        name: which one.
        seed: of what differs, zero or more.
        floors: how many storeys, 1 to 20.

    Raises:
        ArgumentError: no building of that name, or a seed or a number of floors out of its range.

    Examples:
        >>> from hexmap.simulator.space import make_building_3d
        >>> make_building_3d("warehouse3d", seed=3).waypoints.max(axis=0).tolist()
        [26.8, 16.8, 7.2]
    """
    if name not in BUILDINGS_3D:
        raise ArgumentError(f"no building in space is called {name!r}; known are {', '.join(BUILDINGS_3D)}")
    if seed < 0:
        raise ArgumentError(f"a seed must be zero or more, not {seed}")
    if not 1 <= floors <= 20:
        raise ArgumentError(f"a building must have 1 to 20 floors, not {floors}")
    solids = SolidList()
    # The first stream is of what all floors share, the others are of one floor each.
    shared = np.random.Generator(np.random.PCG64((seed, 0)))
    absent = shared.random((len(_ROWS), len(_HALVES), _UNITS)) < 0.12
    heights = shared.choice([1.9, 2.3, 2.7], (len(_ROWS), len(_HALVES)))
    for floor in range(floors):
        z = floor * _STOREY
        own = np.random.Generator(np.random.PCG64((seed, 1 + floor)))
        _slab(solids, z, opened=floor > 0)
        _outer_walls(solids, z, own, ground=floor == 0)
        _pillars(solids, z)
        repeated = np.random.Generator(np.random.PCG64((seed, 1000)))
        _racks(solids, z, absent, heights, repeated, own)
        _north_side(solids, z, own)
        if floor + 1 < floors:
            _ramp(solids, z)
        if floor > 0:
            _railing(solids, z)
    _slab(solids, floors * _STOREY, opened=False)
    return solids.building(name, _path(floors))


def _slab(solids: SolidList, top: float, opened: bool) -> None:
    """Add a floor, with the opening that the ramp from below comes through."""
    bottom = top - _SLAB
    if not opened:
        solids.box((0.0, 0.0, bottom), (_LENGTH, _DEPTH, top))
        return
    solids.box((0.0, _BAY, bottom), (_LENGTH, _DEPTH, top))
    solids.box((0.0, 0.0, bottom), (_RAMP[0], _BAY, top))
    solids.box((_RAMP[1], 0.0, bottom), (_LENGTH, _BAY, top))


def _outer_walls(solids: SolidList, z: float, rng: np.random.Generator, ground: bool) -> None:
    """Add the four outer walls with windows, and doors on the ground floor; beyond them is nothing to see."""
    heights = (z, z + _STOREY)
    half = 0.5 * _WALL
    corners = {
        "south": ((0.0, -half), (_LENGTH, -half)),
        "north": ((0.0, _DEPTH + half), (_LENGTH, _DEPTH + half)),
        "west": ((-half, -_WALL), (-half, _DEPTH + _WALL)),
        "east": ((_LENGTH + half, -_WALL), (_LENGTH + half, _DEPTH + _WALL)),
    }
    for side, (a, b) in corners.items():
        length = max(b[0] - a[0], b[1] - a[1])
        openings = []
        at = float(rng.uniform(1.0, 3.0))
        while at < length - 4.0:
            width = float(rng.uniform(1.0, 2.2))
            if rng.random() < 0.6:
                openings.append((at, at + width, z + 1.0, z + 2.2))
            elif ground and side in ("north", "east") and rng.random() < 0.5:
                openings.append((at, at + 2.4, z, z + 2.6))
            at += 2.4 + float(rng.uniform(0.8, 2.5))
        solids.wall(a, b, heights, _WALL, openings)


def _pillars(solids: SolidList, z: float) -> None:
    """Add the pillars at the ends of the rows: round in the west, square in the east, on every floor alike."""
    top = z + _STOREY - _SLAB
    for y in _ROWS:
        solids.cylinder(5.6, y, 0.22, z, top)
        solids.box((24.3, y - 0.2, z), (24.7, y + 0.2, top))
    for x in (7.5, 22.5):
        solids.cylinder(x, 18.8, 0.06, z, top, _STEEL)


def _racks(
    solids: SolidList,
    z: float,
    absent: NDArray[np.bool_],
    heights: NDArray[np.float64],
    repeated: np.random.Generator,
    own: np.random.Generator,
) -> None:
    """Add the rows of racks and the boxes in them: half of those stand at the same place on every floor."""
    for row, y in enumerate(_ROWS):
        for half, x0 in enumerate(_HALVES):
            height = heights[row, half]
            boards = [0.15 + 0.85 * k for k in range(math.ceil(height / 0.85))]
            for unit in range(_UNITS):
                x = x0 + unit * _UNIT
                gone = absent[row, half, unit]
                if not gone:
                    _frame(solids, x, y, z, height, boards)
                for board in boards:
                    # Drawn for missing racks too, so that what stands in one depends on no other.
                    for rng in (repeated, own):
                        u = rng.random(6)
                        room = min(0.7, height - board) - 0.1
                        if gone or u[0] > 0.7 or room < 0.2:
                            continue
                        edges = (0.4 + 0.5 * u[1], 0.4 + 0.4 * u[2], room * (0.4 + 0.6 * u[3]))
                        middle = x + (0.75 if rng is repeated else 1.85)
                        bottom = (middle + 0.1 * (u[4] - 0.5), y + 0.1 * (u[4] - 0.5), z + board + 0.04)
                        solids.turned_box(bottom, edges, 0.3 * (u[5] - 0.5), _CARDBOARD)


def _frame(solids: SolidList, x: float, y: float, z: float, height: float, boards: list[float]) -> None:
    """Add the posts and the boards of a rack whose west end is at ``x``."""
    half = 0.5 * _RACK_DEPTH
    for px in (x, x + _UNIT - 0.08):
        for py in (y - half, y + half - 0.08):
            solids.box((px, py, z), (px + 0.08, py + 0.08, z + height), _PAINT)
    for board in boards:
        solids.box((x, y - half, z + board), (x + _UNIT, y + half, z + board + 0.04), _STEEL)


def _north_side(solids: SolidList, z: float, rng: np.random.Generator) -> None:
    """Add what differs most between floors: a room along the north wall, and pallets beside it."""
    top = z + _STOREY - _SLAB
    # The path keeps to y = 16.8; nothing here comes south of 17.8.
    x, width = float(rng.uniform(8.5, 14.0)), float(rng.uniform(4.0, 7.0))
    south = float(rng.uniform(17.8, 18.2))
    door = float(rng.uniform(0.5, width - 1.6))
    solids.wall((x, south), (x + width, south), (z, top), 0.12, [(door, door + 1.0, z, z + 2.1)])
    for side in (x, x + width):
        solids.wall((side, south), (side, _DEPTH), (z, top), 0.12)
    for low, high in ((1.0, x - 1.0), (x + width + 1.0, _LENGTH - 1.0)):
        at = low
        while at + 1.2 < high:
            # Around the slender post that stands there on every floor.
            if rng.random() < 0.5 and min(abs(at + 0.6 - 7.5), abs(at + 0.6 - 22.5)) > 1.0:
                bottom = (at + 0.6, float(rng.uniform(18.6, 19.2)), z)
                turn = float(rng.uniform(-0.4, 0.4))
                solids.turned_box(bottom, (1.1, 0.8, float(rng.uniform(0.3, 1.9))), turn, _CARDBOARD)
            at += float(rng.uniform(1.3, 3.0))


def _ramp(solids: SolidList, z: float) -> None:
    """Add the ramp to the next floor."""
    middle = 0.5 * _BAY
    solids.ramp((_RAMP[0], middle, z), (_RAMP[1], middle, z + _STOREY), _BAY, _RAMP_THICKNESS)


def _railing(solids: SolidList, z: float) -> None:
    """Add the railing along the opening in a floor: posts, a rail at the top and one in the middle."""
    for x in np.arange(_RAMP[0], _RAMP[1] + 0.1, 2.0).tolist():
        solids.cylinder(x, _BAY + 0.1, 0.03, z, z + 1.1, _STEEL)
    for height in (0.55, 1.05):
        low, high = (_RAMP[0], _BAY + 0.07, z + height), (_RAMP[1], _BAY + 0.13, z + height + 0.06)
        solids.box(low, high, _STEEL)


def _path(floors: int) -> list[tuple[float, float, float]]:
    """Return the way points: around every floor on the way up, and straight back down to where it began.

    Each round crosses itself, the way down follows floors that have been seen, and the end is the beginning.
    """
    west, east, south, bay = 3.2, 26.8, 4.4, 0.5 * _BAY
    path: list[tuple[float, float, float]] = [(_MIDDLE, south, 0.0), (east, south, 0.0)]
    for floor in range(floors):
        z = floor * _STOREY
        path += [(east, 8.5, z), (west, 8.5, z), (west, 16.8, z), (_MIDDLE, 16.8, z), (_MIDDLE, south, z)]
        if floor + 1 < floors:
            path += [(west, south, z), (west, bay, z), (_RAMP[0], bay, z), (_RAMP[1], bay, z + _STOREY)]
            path.append((east, bay, z + _STOREY))
        elif floors > 1:
            path += [(east, south, z), (east, bay, z)]
    for floor in range(floors - 2, -1, -1):
        z = floor * _STOREY
        path += [(_RAMP[1], bay, z + _STOREY), (_RAMP[0], bay, z), (west, bay, z), (west, south, z)]
        if floor > 0:
            path += [(east, south, z), (east, bay, z)]
    if floors > 1:
        path.append((_MIDDLE, south, 0.0))
    return path
