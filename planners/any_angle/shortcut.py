"""Make paths shorter by line of sight."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hexmap.base.errors import ArgumentError
from planners.path import Path, cells_to_flat, leg_costs, measure

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph


def shortcut(graph: LatticeGraph, path: Path) -> Path:
    """Return the path with legs replaced by straight lines where every cell that these meet is free.

    From each kept cell the path goes straight to the last cell up to which it sees every one, by
    :func:`planners.line_of_sight`; a line that only touches a corner of a blocked cell does not count as
    free. Consecutive cells of the result are no neighbours any more. With terrain a leg is replaced
    only where the line runs over one kind of terrain and costs no more, so that the cost stays exact.

    Args:
        graph: in which the path was found.
        path: whose consecutive cells are neighbours.

    Raises:
        ArgumentError: consecutive cells are no neighbours (a path is made shorter once).
    """
    if len(path) < 3:
        return path
    flat = cells_to_flat(graph, path.cells, "cell of the path", blocked=False)
    if not np.isin(np.diff(flat), graph.offsets).all():
        raise ArgumentError("only a path of neighbouring cells can be made shorter by line of sight")
    from planners.any_angle import _kernels as kernels
    from planners.any_angle.theta_star import make_view

    view = make_view(graph)
    terrain = np.empty(0) if graph.terrain is None else graph.terrain
    so_far = np.concatenate([[0.0], np.cumsum(leg_costs(graph, flat))])
    kept = [0]
    costs = []
    while kept[-1] < len(path) - 1:
        last, cost = kernels.farthest(view, graph.free, terrain, flat, so_far, kept[-1])
        kept.append(last)
        costs.append(cost)
    points = path.points[kept]
    length, turning = measure(points)
    cost = math.fsum(costs)
    return replace(
        path, cells=path.cells[kept], points=points, cost=cost, length=length, turning=turning, clearance=None
    )
