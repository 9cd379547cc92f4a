"""Which cells of a graph meet bodies of one shape, such as the occupied pixels of a picture.

Two convex bodies P + p and Q + q share inner points where q - p lies inside the Minkowski sum of P and -Q, which is
convex too (de Berg et al., Computational Geometry, 3rd ed., theorem 13.5). All cells of a lattice have one shape, and
all bodies have one, so that one sum serves for all pairs, on any lattice and however the bodies are turned.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["block_met"]

_GRAIN = 1e-6  # of the smaller of the two: bodies that overlap by less share a border only


def block_met(graph: LatticeGraph, centres: NDArray[np.float64], corners: NDArray[np.float64]) -> LatticeGraph:
    """Return the graph without the cells that meet the inside of a body.

    What clearance is measured from stays as it is.

    Args:
        graph: the graph.
        centres: (M, n), metres, of the bodies.
        corners: (V, n), metres, of the convex body about its centre.
    """
    from scipy.spatial import ConvexHull

    from hexmap.graph import _meeting_kernels as kernels

    if len(centres) == 0:
        return graph
    lattice = graph.lattice
    cell = lattice.cell.vertices
    total = (corners[:, None, :] - cell[None, :, :]).reshape(-1, lattice.dim)
    # A hull of triangles has a plane several times.
    planes = np.unique(np.round(ConvexHull(total).equations, 12), axis=0)
    normals = np.ascontiguousarray(planes[:, :-1])
    # From the corners, not from the hull's own offsets, which are rounded.
    grain = _GRAIN * min(float(np.ptp(corners, axis=0).min()), float(np.ptp(cell, axis=0).min()))
    limits = (total @ normals.T).max(axis=0) - grain
    inverse = np.linalg.inv(lattice.basis)
    span = np.abs(total @ inverse.T).max(axis=0)
    free = graph.free.copy()
    kernels.block_met(
        np.ascontiguousarray(centres), inverse, np.ascontiguousarray(lattice.basis).copy(), span, normals, limits,
        graph.layout, free,
    )  # fmt: skip
    return graph.with_free(free)
