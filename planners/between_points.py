"""Paths between points in metres: a planner goes from cell to cell, and the path begins and ends in the points."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray
from hexmap.lattice.rays import traverse
from planners.path import Path, measure, to_cell
from planners.search.astar import astar

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["between_points", "path_between"]

_BESIDE = 1e-3  # of a cell: a line that passes a blocked cell's corner as near as this counts as one that meets it


def path_between(
    graph: LatticeGraph, start: ArrayLike, goal: ArrayLike, planner: Callable[..., Path] = astar, **options: Any
) -> Path:
    """Return a path from the point ``start`` to the point ``goal`` (n,), metres.

    The planner finds a path between the centres of the cells that hold them; see :func:`between_points`.

    Args:
        graph: where to go.
        start: a point, metres.
        goal: a point, metres.
        planner: :func:`planners.astar` or another that takes a graph and two cells.
        options: of the planner.

    Raises:
        NoPath: an end is blocked or outside the map, or nothing connects them.
        ArgumentError: not two points of the graph's dimension, or an option is out of its range.
        BoundsError: a point is not finite or farther away than indices can tell.

    Examples:
        >>> import numpy as np
        >>> from hexmap.graph import LatticeGraph
        >>> from hexmap.lattice import Lattice
        >>> from planners import path_between
        >>> graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((3, 9), np.uint8))
        >>> path = path_between(graph, (0.2, 0.0), (0.0, 7.6))
        >>> path.points[[0, -1]].tolist(), round(path.length, 3)
        ([[0.2, 0.0], [0.0, 7.6]], 7.62)
    """
    return between_points(graph, planner(graph, to_cell(graph, start), to_cell(graph, goal), **options), start, goal)


def between_points(graph: LatticeGraph, path: Path, start: ArrayLike, goal: ArrayLike) -> Path:
    """Return a path that begins and ends in points (n,), metres, of its first and of its last cell.

    From a point the path goes straight to the second centre, where no blocked cell is met on that line or touches it;
    else to the centre of its own cell first. With terrain it always does, and the end pieces cost what their cells do.
    Length, turning and cost include the end pieces. A path that did not reach the goal ends where it did.

    Args:
        graph: in which the path was found.
        path: between the cells of the two points.
        start: a point, metres.
        goal: a point, metres.
    """
    a, b = np.asarray(start, np.float64), np.asarray(goal, np.float64)
    points, cells = _begun(graph, path.points, path.cells, a)
    if path.goal_reached:
        points, cells = (rows[::-1] for rows in _begun(graph, points[::-1], cells[::-1], b))
    length, turning = measure(points)
    cost, bound = length, path.bound
    if graph.terrain is not None:
        ends = graph.index_to_flat(path.cells[[0, -1]])
        pieces = [np.linalg.norm(path.points[0] - points[0]), np.linalg.norm(path.points[-1] - points[-1])]
        cost = math.fsum([path.cost, *(float(p * graph.terrain[e]) for p, e in zip(pieces, ends, strict=True))])
    elif path.cost == path.length and path.bound > 1.0:
        straight = float(np.linalg.norm(points[-1] - points[0]))
        bound = min(path.bound, max(1.0, length / straight)) if straight > 0.0 else 1.0
    return replace(
        path, points=np.ascontiguousarray(points), cells=np.ascontiguousarray(cells), cost=cost, length=length,
        turning=turning, bound=bound,
    )  # fmt: skip


def _begun(graph: LatticeGraph, points: FloatArray, cells: Any, start: FloatArray) -> tuple[FloatArray, Any]:
    """Return the points and cells of a path that begins in the point ``start`` (n,) of its first cell."""
    if np.array_equal(points[0], start):
        return points, cells
    if len(points) > 1 and graph.terrain is None and _is_free(graph, start, points[1]):
        if np.array_equal(points[1], start):  # which is the other end
            return points[1:], cells[1:]
        return np.concatenate([start[None], points[1:]]), cells
    if len(points) == 1 and graph.terrain is None:  # in a cell, which is convex
        return np.concatenate([start[None], points]), np.concatenate([cells, cells])
    return np.concatenate([start[None], points]), np.concatenate([cells[:1], cells])


def _is_free(graph: LatticeGraph, a: FloatArray, b: FloatArray) -> bool:
    """Tell whether the line between two points (n,), and those just beside it, meet free cells alone."""
    n = graph.lattice.dim
    length = float(np.linalg.norm(b - a))
    if length == 0.0:
        return True
    along = (b - a) / length
    across = np.linalg.svd(along[None])[2][1:] * (_BESIDE * graph.lattice.resolution)
    shifts = np.concatenate([np.zeros((1, n)), across, -across])
    met = traverse(graph.lattice, a + shifts, b + shifts).index
    flat = graph.index_to_flat(met)
    return bool((flat >= 0).all() and graph.free[flat].all())
