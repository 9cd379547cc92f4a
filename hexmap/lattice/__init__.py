"""Lattices as values: quantising, cells and neighbours, packed indices, rays through cells, dense boxes of indices.

``lattice`` is the value that everything is made of, ``geometry`` its mathematics, ``keys`` the packed indices,
``convert`` makes one of a name or a basis, ``rays`` finds the cells that a line passes, ``window`` has the boxes of
indices behind dense arrays. No other package asks a lattice for its name.
"""

from __future__ import annotations

from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.keys import key_delta, layout, pack, unpack
from hexmap.lattice.lattice import NAMES, Cell, Lattice
from hexmap.lattice.rays import RayCells, traverse

__all__ = [
    "NAMES",
    "Cell",
    "Lattice",
    "LatticeLike",
    "RayCells",
    "as_lattice",
    "key_delta",
    "layout",
    "pack",
    "traverse",
    "unpack",
]
