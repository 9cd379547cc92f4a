"""Lattices as values: quantising, cells and neighbours, packed indices, rays through cells, dense boxes of indices.

The mathematics of every lattice is here, and no other package asks a lattice for its name.
"""

from __future__ import annotations

from hexmap.lattice.keys import key_delta, layout, pack, unpack
from hexmap.lattice.lattice import NAMES, Cell, Lattice
from hexmap.lattice.rays import RayCells, traverse

__all__ = ["NAMES", "Cell", "Lattice", "RayCells", "key_delta", "layout", "pack", "traverse", "unpack"]
