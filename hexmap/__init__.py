"""hexmap: scan matching, mapping and path planning on square, hexagonal, cubic, FCC and BCC lattices.

The names below are loaded when they are first used, so that ``import hexmap`` costs next to
nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOMES = {
    "HexmapError": "hexmap.errors",
    "Lattice": "hexmap.lattice",
    "Map": "hexmap.maps",
    "MapBuilder": "hexmap.maps",
    "Pose": "hexmap.pose",
    "Scan": "hexmap.scan",
    "StateRule": "hexmap.maps",
    "Trajectory": "hexmap.trajectory",
    "VoxelList": "hexmap.voxels",
    "draw_map": "hexmap.drawing",
    "export": "hexmap.exports",
    "load_map": "hexmap.files",
    "open_log": "hexmap.logs",
    "read_tum": "hexmap.trajectory",
    "save_map": "hexmap.files",
}

__all__ = [
    "HexmapError",
    "Lattice",
    "Map",
    "MapBuilder",
    "Pose",
    "Scan",
    "StateRule",
    "Trajectory",
    "VoxelList",
    "__version__",
    "draw_map",
    "export",
    "load_map",
    "open_log",
    "read_tum",
    "save_map",
]

if TYPE_CHECKING:
    from hexmap.drawing import draw_map
    from hexmap.errors import HexmapError
    from hexmap.exports import export
    from hexmap.files import load_map, save_map
    from hexmap.lattice import Lattice
    from hexmap.logs import open_log
    from hexmap.maps import Map, MapBuilder, StateRule
    from hexmap.pose import Pose
    from hexmap.scan import Scan
    from hexmap.trajectory import Trajectory, read_tum
    from hexmap.voxels import VoxelList


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'hexmap' has no attribute {name!r}")
    return getattr(importlib.import_module(home), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
