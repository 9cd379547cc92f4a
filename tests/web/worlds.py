"""Small worlds for the tests of the page: rooms with doors, on any lattice of the plane."""

from __future__ import annotations

import numpy as np

from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox, box_coordinates
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList

# Metres: a room of 8 x 6 with a wall across it, in which there is a door.
WIDTH, HEIGHT, DOOR = 8.0, 6.0, (4.2, 5.4)


def rooms(lattice: Lattice, levels: int = 2) -> Map:
    """Return a map of two rooms, with counts from 1 to some thousands, each level made from the same walls."""
    return Map([_level(lattice.scaled(2.0**k)) for k in range(levels)])


def _level(lattice: Lattice) -> Level:
    corners = box_coordinates(lattice.basis, np.array([0.0, 0.0]), np.array([WIDTH, HEIGHT]))
    box = IndexBox.of_corners(
        np.floor(corners.min(axis=0)).astype(np.int64) - 2, np.ceil(corners.max(axis=0)).astype(np.int64) + 2
    )
    index = box.cells()
    x, y = lattice.centres(index).T
    thick = 1.2 * lattice.covering_radius
    inside = (x > 0) & (x < WIDTH) & (y > 0) & (y < HEIGHT)
    near = inside & ((x < thick) | (x > WIDTH - thick) | (y < thick) | (y > HEIGHT - thick))
    across = inside & (np.abs(x - WIDTH / 2) < thick) & ~((y > DOOR[0]) & (y < DOOR[1]))
    wall = near | across
    counts = 1 + np.abs(index @ np.array([7, 13])) ** 2 % 3001
    hits = VoxelList.from_cells(index[wall], lattice, counts[wall])
    passes = VoxelList.from_cells(index[inside & ~wall], lattice, counts[inside & ~wall])
    return Level(hits, passes)
