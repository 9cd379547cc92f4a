"""The true cells of lattices in space, as shaded pictures, as meshes and in a viewer."""

from __future__ import annotations

from hexmap.drawing.solids.draw_solids import Cut, draw_solids, find_cut, view_solids
from hexmap.drawing.solids.mesh import Mesh, mesh_of_cells
from hexmap.drawing.solids.mesh_files import MESH_SUFFIXES, save_mesh

__all__ = ["MESH_SUFFIXES", "Cut", "Mesh", "draw_solids", "find_cut", "mesh_of_cells", "save_mesh", "view_solids"]
