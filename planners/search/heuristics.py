"""What a path costs at least where nothing stands in the way, derived from the moves alone.

The cost that a long free path tends to is the gauge of the convex hull of {move / its cost}: the
least k such that the offset to the goal lies in k times the hull. It never exceeds the true cost and never drops
by more than a move costs (admissible and consistent), whatever the lattice and the neighbourhood.
"""

from __future__ import annotations

import weakref
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["estimate", "gauge_planes", "least_terrain"]

_LEAST: weakref.WeakKeyDictionary[Any, float] = weakref.WeakKeyDictionary()


def gauge_planes(moves: ArrayLike, lengths: ArrayLike) -> FloatArray:
    """Return planes (F, n) with ``max |planes @ v|`` = the gauge of the offset ``v`` (n,), in index units.

    One plane of each opposite pair is given. (0, n), which estimates zero, where no gauge is to
    be had: the moves lie in a plane or line, or not every move has its opposite.

    Args:
        moves: (K, n) index offsets.
        lengths: (K,) their costs, metres.
    """
    v = np.ascontiguousarray(moves, dtype=np.int64)
    costs = np.ascontiguousarray(lengths, dtype=np.float64)
    return _planes(v.tobytes(), costs.tobytes(), v.shape[1])


@lru_cache(maxsize=64)
def _planes(moves: bytes, lengths: bytes, n: int) -> FloatArray:
    from scipy.spatial import ConvexHull, QhullError

    v = np.frombuffer(moves, np.int64).reshape(-1, n)
    costs = np.frombuffer(lengths)
    none: FloatArray = np.empty((0, n))
    motions = {(*move, cost) for move, cost in zip(v.tolist(), np.round(costs / costs.max(), 12).tolist(), strict=True)}
    if any((*(-x for x in motion[:-1]), motion[-1]) not in motions for motion in motions):
        return none
    unit = costs.max()  # Qhull's tolerances are absolute
    ends = v / (costs / unit)[:, None]
    try:
        hull = ConvexHull(ends)
    except QhullError:
        return none
    # Qhull says which moves span a facet; the plane through them is solved for to the last digits,
    # on which it depends whether equal f are seen to be equal.
    corners = v[hull.simplices].astype(np.float64)
    found = np.linalg.solve(corners, costs[hull.simplices][..., None])[..., 0]
    # A facet of many corners comes in several simplices.
    _, once = np.unique(np.round(found / unit, 9) + 0.0, axis=0, return_index=True)
    planes = found[once]
    first = np.argmax(np.abs(planes) > 1e-9 * unit, axis=1)
    planes = planes[planes[np.arange(len(planes)), first] > 0]
    # What was rounded away must not let a single move be estimated above its cost.
    excess = (np.abs(v @ planes.T).max(axis=1) / costs).max()
    planes = np.ascontiguousarray(planes / max(excess, 1.0))
    planes.setflags(write=False)
    return planes


def least_terrain(graph: LatticeGraph) -> float:
    """Return the least terrain of a free cell, 1 without terrain; looked for once a graph."""
    if graph.terrain is None:
        return 1.0
    if graph not in _LEAST:
        _LEAST[graph] = graph.least_terrain
    return _LEAST[graph]


def estimate(graph: LatticeGraph, start: ArrayLike, goal: ArrayLike) -> float:
    """Return what a path from the cell ``start`` (n,) to the cell ``goal`` (n,) costs at least."""
    offset = np.asarray(goal, dtype=np.float64) - np.asarray(start, dtype=np.float64)
    planes = gauge_planes(graph.moves, graph.lengths)
    return float(np.abs(planes @ offset).max(initial=0.0)) * least_terrain(graph)
