"""Paths, why there is none, and making paths shorter by line of sight."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.errors import ArgumentError, HexmapError

if TYPE_CHECKING:
    from hexmap.graph import LatticeGraph

__all__ = ["NoPath", "Path", "cells_to_flat", "shortcut", "to_cell"]

IndexArray = NDArray[np.int64]


class NoPath(HexmapError, ValueError):
    """There is no path; the text names the cell.

    Attributes:
        reason: "start blocked", "goal blocked", "start outside the map", "goal outside the map",
            "not connected" or "beyond the limit".
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        """Say why, and in ``detail`` where."""
        super().__init__(f"no path: {reason}{': ' if detail else ''}{detail}")
        self.reason = reason
        self.detail = detail

    def __reduce__(self) -> tuple[type[NoPath], tuple[str, str]]:
        """Survive pickling with the reason."""
        return type(self), (self.reason, self.detail)


@dataclass(frozen=True, eq=False)
class Path:
    """A path, and what finding it took.

    Attributes:
        cells: (M, n) int32, from the start to the goal.
        points: (M, n) float64 centres of the cells, metres.
        cost: what was minimised: metres, times the terrain where there is one.
        length: metres.
        turning: sum of the absolute changes of heading, radians.
        clearance: least distance to an obstacle, metres, where it was asked for.
        expansions: cells whose moves were tried.
        pushes: entries made in the queue.
        scanned: cells looked at on the way by searches that jump or look along lines, 0 by others.
        seconds: time of the search, without preparing the graph.
        bound: the cost is at most this times the least cost (to 1e-11 of a move).
    """

    cells: NDArray[np.int32]
    points: NDArray[np.float64]
    cost: float
    length: float
    turning: float
    clearance: float | None = None
    expansions: int = 0
    pushes: int = 0
    scanned: int = 0
    seconds: float = 0.0
    bound: float = 1.0

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.cells)

    def __repr__(self) -> str:
        """Say how long it is."""
        return f"Path({len(self)} cells, {self.length:.6g} m, cost {self.cost:.6g})"


def make_path(
    graph: LatticeGraph,
    flat: IndexArray,
    *,
    clearance: NDArray[np.float64] | None = None,
    expansions: int = 0,
    pushes: int = 0,
    scanned: int = 0,
    seconds: float = 0.0,
    bound: float = 1.0,
) -> Path:
    """Return the path through the ``flat`` cells (M,), its cost summed without a rounding error."""
    cells = graph.flat_to_index(flat)
    points = np.ascontiguousarray(graph.lattice.centres(cells), dtype=np.float64)
    length, turning = _measure(points)
    cost = math.fsum(_leg_costs(graph, flat))
    least = None if clearance is None else float(np.asarray(clearance).reshape(-1)[flat].min())
    return Path(cells, points, cost, length, turning, least, int(expansions), int(pushes), int(scanned), seconds, bound)


def _leg_costs(graph: LatticeGraph, flat: IndexArray) -> NDArray[np.float64]:
    """Return what each move along neighbouring ``flat`` cells (M,) costs (M - 1,)."""
    order = np.argsort(graph.offsets)
    legs = graph.lengths[order[np.searchsorted(graph.offsets[order], np.diff(flat))]]
    if graph.terrain is not None:
        legs = legs * (0.5 * (graph.terrain[flat[:-1]] + graph.terrain[flat[1:]]))
    return np.asarray(legs)


def _measure(points: NDArray[np.float64]) -> tuple[float, float]:
    """Return length (m) and turning (rad) of a polyline (M, n)."""
    legs = np.diff(points, axis=0)
    lengths = np.sqrt((legs**2).sum(axis=1))
    turning = 0.0
    if len(legs) > 1:
        a, b = legs[:-1] / lengths[:-1, None], legs[1:] / lengths[1:, None]
        # The arc cosine of a product loses half the digits of a small angle; this loses none.
        turning = float((2.0 * np.arctan2(_norm(a - b), _norm(a + b)))[_norm(a - b) > 1e-9].sum())
    return float(math.fsum(lengths)), turning


def _norm(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.sqrt((v**2).sum(axis=1)))


def to_cell(graph: LatticeGraph, point: ArrayLike) -> NDArray[np.int32]:
    """Return the cell (n,) of a point (n,) in metres, in the map or not.

    Raises:
        ArgumentError: not one point of the lattice's dimension.
        BoundsError: not finite or beyond what an index can hold.
    """
    p = np.asarray(point, dtype=np.float64)
    if p.shape != (graph.lattice.dim,):
        raise ArgumentError(f"a point of this graph must be ({graph.lattice.dim},), not {p.shape}")
    return graph.lattice.quantise(p[None])[0]


def cells_to_flat(graph: LatticeGraph, cells: ArrayLike, role: str, *, blocked: bool = True) -> IndexArray:
    """Return the flat cells (M,) of one cell (n,) or many (M, n), held to be in the map and, if asked, free.

    Args:
        graph: where they are to lie.
        cells: integer indices.
        role: "start" or "goal", for the error.
        blocked: a blocked cell is an error.

    Raises:
        ArgumentError: not integers of that shape, or none.
        NoPath: a cell lies outside the map or is blocked.
    """
    array = np.asarray(cells)
    n = graph.lattice.dim
    if array.dtype.kind not in "iu":
        raise ArgumentError(f"a {role} is given as a cell's integer index; to_cell makes one of a point in metres")
    array = array.astype(np.int64)
    array = array[None] if array.ndim == 1 else array
    if array.ndim != 2 or array.shape[1] != n or len(array) == 0:
        raise ArgumentError(f"a {role} must be a cell ({n},) or cells (M, {n}), not {np.shape(cells)}")
    outside = ((array < graph.first) | (array >= graph.first + graph.inner_shape)).any(axis=1)
    if outside.any():
        raise NoPath(f"{role} outside the map", f"cell {tuple(array[outside][0].tolist())}")
    flat = np.ascontiguousarray((array - graph.low) @ graph.strides)
    shut = graph.free[flat] == 0
    if blocked and shut.any():
        raise NoPath(f"{role} blocked", f"cell {tuple(array[shut][0].tolist())}")
    return flat


# ---------------------------------------------------------------------- line of sight


def _probes(graph: LatticeGraph, way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return small shifts (P, n), metres, across the direction ``way`` (n,): a thin tube and its axis.

    A line through a corner or along a face meets cells that it crosses along no length, or of
    which only one is counted. The shifted lines cross them, so that no path slips between two walls.
    """
    size = 1e-6 * graph.lattice.resolution
    way = way / np.linalg.norm(way)
    if len(way) == 2:
        across = np.array([[-way[1], way[0]]]) * size
        return np.vstack([np.zeros((1, 2)), across, -across])
    u = np.cross(way, np.eye(3)[int(np.argmin(np.abs(way)))])
    u /= np.linalg.norm(u)
    w = np.cross(way, u)
    angle = 0.1 + np.arange(8) * (math.pi / 4)
    return np.vstack([np.zeros((1, 3)), size * (np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * w)])


def _sight(graph: LatticeGraph, start: NDArray[np.float64], ends: NDArray[np.float64]) -> list[IndexArray | None]:
    """Return for each of ``ends`` (E, n), metres, the flat cells met on the way from ``start``; None if one is shut."""
    from hexmap.rays import traverse

    shifts = [_probes(graph, end - start) for end in ends]
    rays = traverse(
        graph.lattice,
        np.concatenate([start + s for s in shifts]),
        np.concatenate([end + s for end, s in zip(ends, shifts, strict=True)]),
    )
    place = rays.index.astype(np.int64) - graph.low
    inside = ((place >= 0) & (place < graph.shape)).all(axis=1)
    flat = np.where(inside, place @ graph.strides, 0)
    good = inside & (graph.free[flat] != 0)
    out: list[IndexArray | None] = []
    r = 0
    for s in shifts:
        part = slice(int(rays.offsets[r]), int(rays.offsets[r + len(s)]))
        out.append(flat[part] if good[part].all() else None)
        r += len(s)
    return out


def shortcut(graph: LatticeGraph, path: Path, *, chunk: int = 16) -> Path:
    """Return the path with legs replaced by straight lines where every cell that these meet is free.

    From each kept cell the path goes straight to the last cell up to which it sees every one; a
    line that only touches a corner of a blocked cell does not count as free. Consecutive cells of
    the result are no neighbours any more. With terrain a leg is replaced only where the line runs
    over one kind of terrain and costs no more, so that the cost stays exact.

    Args:
        graph: in which the path was found.
        path: whose consecutive cells are neighbours.
        chunk: lines looked at together; it does not change the result.

    Raises:
        ArgumentError: consecutive cells are no neighbours (a path is made shorter once).
    """
    if len(path) < 3:
        return path
    points = path.points
    flat = cells_to_flat(graph, path.cells, "cell of the path", blocked=False)
    if not np.isin(np.diff(flat), graph.offsets).all():
        raise ArgumentError("only a path of neighbouring cells can be made shorter by line of sight")
    legs = _leg_costs(graph, flat)
    so_far = np.concatenate([[0.0], np.cumsum(legs)])
    kept = [0]
    cost = 0.0
    while kept[-1] < len(path) - 1:
        at = kept[-1]
        best, best_cost = at + 1, float(legs[at])
        first = at + 2
        while first < len(path):
            seen = _sight(graph, points[at], points[first : first + chunk])
            for j, cells in enumerate(seen, start=first):
                if cells is None:
                    break
                straight = float(np.linalg.norm(points[j] - points[at]))
                if graph.terrain is not None:
                    straight *= float(graph.terrain[flat[at]])
                    if (graph.terrain[cells] != graph.terrain[flat[at]]).any():
                        break
                if straight <= (so_far[j] - so_far[at]) * (1 + 1e-12):
                    best, best_cost = j, straight
            else:
                first += chunk
                continue
            break
        kept.append(best)
        cost += best_cost
    length, turning = _measure(points[kept])
    return replace(
        path, cells=path.cells[kept], points=points[kept], cost=cost, length=length, turning=turning, clearance=None
    )
