from .any_angle.optimum import AnyAngleOptimum, OptimalPath
from .any_angle.shortcut import shortcut
from .any_angle.theta_star import any_angle, line_of_sight
from .between_points import between_points, path_between
from .path import NoPath, Path, to_cell
from .path_files import PathTable, path_headings, read_path, write_path
from .replanning.replanner import Replanner
from .search.astar import astar
from .search.canonical import canonical
from .search.dijkstra import DistanceField, dijkstra
from .search.many import plan_many
from .search.nearest import nearest_reachable

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
    "between_points",
    "canonical",
    "dijkstra",
    "line_of_sight",
    "nearest_reachable",
    "path_between",
    "path_headings",
    "plan_many",
    "read_path",
    "shortcut",
    "to_cell",
    "write_path",
]
