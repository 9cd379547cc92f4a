"""Questions about a graph in metres: the nearest free cell to a point, and what a line of points meets."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.rays import traverse

__all__ = ["least_clearance", "nearest_free_centre", "share_of_line"]

_MANY = 1 << 20  # cells in a piece
_STEPS = 24, 12  # to a radius at most, in the plane and in space, of the grid of points within a disc


def nearest_free_centre(graph: LatticeGraph, point: ArrayLike) -> NDArray[np.float64] | None:
    """Return the centre (n,), metres, of the free cell nearest to a point (n,), metres; None where no cell is free."""
    free = np.flatnonzero(graph.free)
    best, nearest = math.inf, None
    for k in range(0, len(free), _MANY):
        centres = graph.centres(free[k : k + _MANY])
        away = ((centres - np.asarray(point)) ** 2).sum(axis=1)
        if away.min() < best:
            best, nearest = float(away.min()), centres[away.argmin()]
    return nearest


def least_clearance(graph: LatticeGraph, cells: NDArray[np.integer], points: NDArray[np.float64]) -> float:
    """Return the least distance, metres, to an obstacle's cell of all cells that a path meets.

    Args:
        graph: that clearance is measured in.
        cells: (M, n) the cells of the path's points.
        points: (M, n) metres; cells that the line passes between them count as well.
    """
    met = cells
    if len(points) > 1:
        met = np.concatenate([cells, traverse(graph.lattice, points[:-1], points[1:]).index])
    flat = graph.index_to_flat(np.unique(met, axis=0))
    return float(np.min(graph.clearance_at(flat[flat >= 0], to="cell")))


def share_of_line(
    lattice: Lattice,
    points: NDArray[np.float64],
    radius: float,
    is_met: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
) -> float:
    """Return the share, 0 to 1, of a line along which a disc, in space a ball, around it meets something.

    The points that are looked at are those of a fine grid within the disc and on its rim, at steps of a cell
    along the line.

    Args:
        lattice: whose resolution sets how fine.
        points: (M, n) the line, metres.
        radius: of the disc, metres.
        is_met: tells of points (N, n), metres, which of them count.
    """
    disc = _disc(lattice, radius)
    pieces = [points[:1]]
    for a, b in pairwise(points):
        count = max(1, round(math.dist(a, b) / lattice.resolution))
        pieces.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    line = np.concatenate(pieces)
    met = 0
    for k in range(0, len(line), 256):
        some = line[k : k + 256]
        found = is_met((some[:, None] + disc).reshape(-1, lattice.dim))
        met += int(found.reshape(len(some), -1).any(axis=1).sum())
    return met / len(line)


def _disc(lattice: Lattice, radius: float) -> NDArray[np.float64]:
    """Return points (K, n), metres, of a fine grid within a disc or ball around the origin and on its rim."""
    n = lattice.dim
    count = max(1, min(math.ceil(2.0 * radius / lattice.resolution), _STEPS[n - 2]))
    steps = np.arange(-count - 1, count + 2) / count
    disc = np.stack(np.meshgrid(*[steps] * n, indexing="ij"), axis=-1).reshape(-1, n)
    away = np.linalg.norm(disc, axis=1)
    disc = disc[away < 1.0 + 1.0 / count]
    # Those just beyond are drawn in to the rim. What the disc only touches it does not meet.
    disc *= radius * (1.0 - 1e-9) / np.maximum(np.linalg.norm(disc, axis=1), 1.0)[:, None]
    return disc
