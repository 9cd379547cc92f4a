"""Search over the graph layer of hexmap's lattices.

The names below are loaded when they are first used. The modules of ``astar`` and ``dijkstra`` have an
underscore: importing a module binds its name in the package, where it would hide the function.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_HOMES = {
    "DistanceField": "planners._dijkstra",
    "NoPath": "planners.path",
    "Path": "planners.path",
    "astar": "planners._astar",
    "dijkstra": "planners._dijkstra",
    "plan_many": "planners._astar",
    "shortcut": "planners.path",
    "to_cell": "planners.path",
}

__all__ = ["DistanceField", "NoPath", "Path", "astar", "dijkstra", "plan_many", "shortcut", "to_cell"]

if TYPE_CHECKING:
    from planners._astar import astar, plan_many
    from planners._dijkstra import DistanceField, dijkstra
    from planners.path import NoPath, Path, shortcut, to_cell


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'planners' has no attribute {name!r}")
    return getattr(importlib.import_module(home), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
