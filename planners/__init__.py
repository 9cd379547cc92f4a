"""Search over the graph layer of hexmap's lattices.

The names below are loaded when they are first used. The modules of ``astar`` and ``dijkstra`` have an
underscore: importing a module binds its name in the package, where it would hide the function.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_HOMES = {
    "AnyAngleOptimum": "planners.optimum",
    "DistanceField": "planners._dijkstra",
    "NoPath": "planners.path",
    "OptimalPath": "planners.optimum",
    "Path": "planners.path",
    "PathTable": "planners.path_files",
    "Replanner": "planners._replanning",
    "any_angle": "planners._anyangle",
    "astar": "planners._astar",
    "canonical": "planners._canonical",
    "dijkstra": "planners._dijkstra",
    "line_of_sight": "planners._anyangle",
    "nearest_reachable": "planners._nearest",
    "plan_many": "planners._astar",
    "read_path": "planners.path_files",
    "shortcut": "planners.path",
    "to_cell": "planners.path",
    "write_path": "planners.path_files",
}

__all__ = [
    "AnyAngleOptimum",
    "DistanceField",
    "NoPath",
    "OptimalPath",
    "Path",
    "PathTable",
    "Replanner",
    "any_angle",
    "astar",
    "canonical",
    "dijkstra",
    "line_of_sight",
    "nearest_reachable",
    "plan_many",
    "read_path",
    "shortcut",
    "to_cell",
    "write_path",
]

if TYPE_CHECKING:
    from planners._anyangle import any_angle, line_of_sight
    from planners._astar import astar, plan_many
    from planners._canonical import canonical
    from planners._dijkstra import DistanceField, dijkstra
    from planners._nearest import nearest_reachable
    from planners._replanning import Replanner
    from planners.optimum import AnyAngleOptimum, OptimalPath
    from planners.path import NoPath, Path, shortcut, to_cell
    from planners.path_files import PathTable, read_path, write_path


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module 'planners' has no attribute {name!r}")
    return getattr(importlib.import_module(home), name)


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
