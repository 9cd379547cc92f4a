"""Make paths shorter by line of sight."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from planners.path import Path, cells_to_flat, leg_costs, measure

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph


_AHEAD = 64  # cells of the path that are tried at once
_SAMPLES = 8  # of the terrain, a cell of the line


def shortcut(graph: LatticeGraph, path: Path, *, across_terrain: bool = False, taut: bool = False) -> Path:
    """Return the path with legs replaced by straight lines where every cell that these meet is free.

    From each kept cell the path goes straight to the last cell up to which it sees every one, by
    :func:`planners.line_of_sight`; a line that only touches a corner of a blocked cell does not count as
    free. Consecutive cells of the result are no neighbours any more. With terrain a leg is replaced
    only where the line runs over one kind of terrain and costs no more, so that the cost stays exact; or, across
    terrain of any kind, only where the integral of the terrain along the line, summed over points an eighth of a
    cell apart, is no more than the moves cost.

    Args:
        graph: in which the path was found.
        path: whose consecutive cells are neighbours.
        across_terrain: whether lines may run over terrain of several kinds.
        taut: whether turning cells are then left out, moved and cut off as :func:`planners.any_angle` does, as long
            as that shortens; not with terrain.

    Raises:
        ArgumentError: consecutive cells are no neighbours (a path is made shorter once).
    """
    if len(path) < 3:
        return path
    flat = cells_to_flat(graph, path.cells, "cell of the path", blocked=False)
    if not np.isin(np.diff(flat), graph.offsets).all():
        raise ArgumentError("only a path of neighbouring cells can be made shorter by line of sight")
    from planners.any_angle import _kernels as kernels
    from planners.any_angle.theta_star import Effort, make_view, tightened

    view = make_view(graph)
    terrain = np.empty(0) if graph.terrain is None else graph.terrain
    so_far = np.concatenate([[0.0], np.cumsum(leg_costs(graph, flat))])
    kept = [0]
    costs = []
    while kept[-1] < len(path) - 1:
        if across_terrain and graph.terrain is not None:
            last, cost = _best_across_terrain(graph, path, so_far, kept[-1])
        else:
            last, cost = kernels.farthest(view, graph.free, terrain, flat, so_far, kept[-1])
        kept.append(last)
        costs.append(cost)
    cells, points, cost = path.cells[kept], path.points[kept], math.fsum(costs)
    if taut and graph.terrain is None:
        cells = graph.flat_to_index(tightened(graph, view, flat[kept], np.zeros(len(Effort._fields), np.int64)))
        points = np.ascontiguousarray(graph.lattice.centres(cells), dtype=np.float64)
        cost = measure(points)[0]
    length, turning = measure(points)
    return replace(path, cells=cells, points=points, cost=cost, length=length, turning=turning, clearance=None)


def _best_across_terrain(graph: LatticeGraph, path: Path, so_far: FloatArray, first: int) -> tuple[int, float]:
    """Return the cell of the path to which a line from ``first`` saves most over the path, and the line's cost.

    The line sees every cell of the path up to there. ``so_far`` (M,) is what the path costs up to each of its cells.
    The farthest cell would do where terrain is of one kind; else a line to it may pay with all that it saved before.
    """
    from planners.any_angle.theta_star import line_of_sight

    best, best_cost, most = first + 1, float(so_far[first + 1] - so_far[first]), 0.0
    for begin in range(first + 2, len(path), _AHEAD):
        some = np.arange(begin, min(begin + _AHEAD, len(path)))
        seen = np.asarray(line_of_sight(graph, path.cells[first], path.cells[some]))
        before = best
        for last in some[: len(some) if seen.all() else int(seen.argmin())].tolist():
            cost = _line_cost(graph, path.points[first], path.points[last])
            saved = float(so_far[last] - so_far[first]) - cost
            # A line that saves nothing still has fewer turns, but for the error of a sum.
            if saved >= most - 1e-12 * cost:
                best, best_cost, most = last, cost, max(saved, most)
        if best == before or not seen.all():
            break
    return best, best_cost


def _line_cost(graph: LatticeGraph, a: FloatArray, b: FloatArray) -> float:
    """Return the integral of the terrain along the line between points (n,), metres, that meets free cells alone."""
    assert graph.terrain is not None
    length = math.dist(a, b)
    count = max(1, math.ceil(_SAMPLES * length / graph.lattice.resolution))
    at = a + (b - a) * ((np.arange(count) + 0.5) / count)[:, None]
    terrain = graph.terrain[graph.index_to_flat(graph.lattice.quantise(at))]
    return length * math.fsum(terrain.tolist()) / count
