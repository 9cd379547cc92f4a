"""Occupied voxel lists and the maps made of them: counting, fusing, what a cell is, its outline, its metrics.

``voxel_list`` is the paper's list, ``counter`` the grid of counts that grows while scans come in, ``builder`` fuses
scans into a ``map``; ``state_rule`` says what a cell is, ``outlines`` what sets of cells look like, ``metrics`` how
well a lattice represents points.
"""

from __future__ import annotations

from hexmap.maps.builder import MapBuilder
from hexmap.maps.cell_state import CellState
from hexmap.maps.counter import CellCounter
from hexmap.maps.map import Level, Map, MapDiff
from hexmap.maps.metrics import coefficient_of_variation, distortion, interquartile_variability, voxel_count
from hexmap.maps.state_rule import StateRule, States
from hexmap.maps.voxel_list import VoxelList

__all__ = [
    "CellCounter",
    "CellState",
    "Level",
    "Map",
    "MapBuilder",
    "MapDiff",
    "StateRule",
    "States",
    "VoxelList",
    "coefficient_of_variation",
    "distortion",
    "interquartile_variability",
    "voxel_count",
]
