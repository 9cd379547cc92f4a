"""Maps that other people published, read into one value that any lattice can be laid over.

MovingAI grids (``.map``), Warframe voxels (``.3dmap``), ROS map_server maps (``.yaml`` and its image),
OctoMaps (``.bt``), the map of Wean Hall (``.dat``), and the benchmark problems that belong to the first two
(``.scen``, ``.3dscen``).

Examples:
    >>> from hexmap import Lattice
    >>> from hexmap.io.grids import open_grid, read_scenario
    >>> grid = open_grid("arena.map")  # doctest: +SKIP
    >>> graph = grid.to_graph(Lattice.named("A2", resolution=0.5))  # doctest: +SKIP
"""

from __future__ import annotations

from hexmap.io.grids.grid_map import MAX_CELLS, GridMap
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.grids.scenarios import Scenario, read_scenario

__all__ = ["MAX_CELLS", "GridMap", "Scenario", "open_grid", "read_scenario"]
