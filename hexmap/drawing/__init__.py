"""Pictures: maps and paths as true cells in the plane, and as shaded solids in space."""

from __future__ import annotations

from hexmap.drawing.map_drawing import SUFFIXES, check_picture, draw_map
from hexmap.drawing.path_drawing import draw_path

__all__ = ["SUFFIXES", "check_picture", "draw_map", "draw_path"]
