"""The graph layer: free cells and their moves on any lattice, kept as a padded flat window and constant offsets.

``lattice_graph`` is the graph itself, ``moves`` its neighbourhoods and what moves sweep, ``window`` its cells in
memory; ``arrays`` turns it into what numpy, scipy and networkx know; ``clearance``, ``obstacles`` and ``bodies``
measure distances to obstacles, ``queries`` answers questions about a graph in metres.
"""

from __future__ import annotations

from hexmap.graph.lattice_graph import MAX_CELLS, LatticeGraph
from hexmap.graph.moves import Neighbourhood, swept_cells

__all__ = ["MAX_CELLS", "LatticeGraph", "Neighbourhood", "swept_cells"]
