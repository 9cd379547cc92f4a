"""The graph layer: free cells and their moves on any lattice, kept as a padded flat window and constant offsets."""

from __future__ import annotations

from hexmap.graph.lattice_graph import MAX_CELLS, LatticeGraph
from hexmap.graph.moves import Neighbourhood, swept_cells

__all__ = ["MAX_CELLS", "LatticeGraph", "Neighbourhood", "swept_cells"]
