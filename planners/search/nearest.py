"""The reachable cell nearest to a point: where to go when the goal itself is out of reach."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError, BoundsError
from planners.path import cells_to_flat

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["nearest_reachable"]

_SAME = 1e-9  # distances that differ by less than this fraction of the resolution are ties
_FAR = 2.0**53  # index coordinates that float64 can tell apart


def nearest_reachable(graph: LatticeGraph, start: ArrayLike, point: ArrayLike) -> NDArray[np.int32]:
    """Return the cell (n,) int32 that ``start`` is connected with whose centre is nearest to a point.

    Exact; ties, to 1e-9 of the resolution, go to the lowest flat cell. Balls around the point
    are looked through, row by row and within the window only, each larger than the one before
    until one holds such a cell: what lies farther away is not touched. The components are computed
    where they are not known yet.

    Args:
        graph: where to go.
        start: a cell's index (n,).
        point: (n,) metres, in the window or not.

    Raises:
        NoPath: the start is blocked or outside the map.
        ArgumentError: not one start, or not one finite point.
        BoundsError: the point is farther away than indices can tell.

    Examples:
        >>> import numpy as np
        >>> from hexmap.graph import LatticeGraph
        >>> from hexmap.lattice import Lattice
        >>> from planners import nearest_reachable
        >>> graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((3, 5), np.uint8))
        >>> nearest_reachable(graph, [0, 0], [9.0, 3.2]).tolist()
        [2, 3]
    """
    lattice = graph.lattice
    p = np.array(point, dtype=np.float64)
    if p.shape != (lattice.dim,) or not np.isfinite(p).all():
        raise ArgumentError(f"a point of this graph must be {lattice.dim} finite numbers of metres, not {point!r}")
    if np.ndim(start) != 1:
        raise ArgumentError(f"a start is one cell ({lattice.dim},), not {np.shape(start)}")
    source = int(cells_to_flat(graph, start, "start")[0])
    inverse = np.linalg.inv(lattice.basis)
    u = inverse @ p
    if not np.abs(u).max() < _FAR:
        raise BoundsError(f"the point {p.tolist()} is too far away for this resolution")
    labels = graph.components()
    from planners.search import _nearest_kernels as kernels

    first, inner = graph.first, graph.inner_shape
    basis = np.ascontiguousarray(lattice.basis, dtype=np.float64).copy()
    row_norms = np.linalg.norm(inverse, axis=1)
    window = kernels.Window(first, inner, graph.pad, graph.strides, basis, row_norms)
    # |index_i - u_i| <= |row i of the inverse basis| * distance: as near as this nothing of the window can be.
    gap = np.maximum(np.maximum(first - u, u - (first + inner - 1)), 0.0)
    none_within = float((gap / row_norms).max())
    # The start itself is a candidate.
    enough = float(np.linalg.norm(graph.centres(np.array([source]))[0] - p)) + _SAME * lattice.resolution
    more = lattice.covering_radius
    while True:
        radius = min(none_within + more, enough)
        found, distance = kernels.nearest_in_ball(labels, labels[source], window, p, u, radius, False)
        if found >= 0:
            break
        more *= 2.0
    tied, _ = kernels.nearest_in_ball(labels, labels[source], window, p, u, distance + _SAME * lattice.resolution, True)
    return np.asarray(graph.flat_to_index(np.array([tied]))[0], dtype=np.int32)
