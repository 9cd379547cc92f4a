"""Pictures: maps and paths as true cells in the plane, and as shaded solids in space.

``map_drawing`` draws maps, ``path_drawing`` paths, ``figure_layout`` what surrounds both; ``value_drawing`` is behind
the ``plot`` of values and what notebooks show; ``solids`` has meshes of cells in space and the renderer.
"""

from __future__ import annotations

from hexmap.drawing.map_drawing import SUFFIXES, check_picture, draw_map
from hexmap.drawing.path_drawing import draw_path

__all__ = ["SUFFIXES", "check_picture", "draw_map", "draw_path"]
