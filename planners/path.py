"""Paths, what they measure, and why there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import IntArray
from hexmap.base.errors import ArgumentError, HexmapError
from hexmap.base.pictures import picture_html
from hexmap.base.text import quoted
from hexmap.base.values import integers

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = [
    "NoPath",
    "Path",
    "cells_to_flat",
    "clearances",
    "leg_costs",
    "make_path",
    "measure",
    "not_connected",
    "to_cell",
]


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
        scanned: cells looked at by searches that jump or look along lines, 0 by others.
        seconds: time of the search, without preparing the graph.
        bound: the cost is at most this times the least cost (to 1e-11 of a move).
        goal_reached: false where the path ends in the reachable cell nearest to the goal instead.
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
    goal_reached: bool = True

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.cells)

    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Draw the path on axes of matplotlib, in metres: a ring where it starts, a disc where it ends.

        Seen from above; on axes in space (``projection="3d"``) in space.

        Args:
            ax: axes to draw on, of a map or a field for example; new ones where none are given.
            style: of the line, as :meth:`matplotlib.axes.Axes.plot` takes it: ``color``, ``linewidth``, ``label``, ...

        Returns:
            The axes.

        Examples:
            >>> import numpy as np
            >>> from hexmap import LatticeGraph
            >>> from planners import dijkstra
            >>> field = dijkstra(LatticeGraph.from_array(np.zeros((9, 9), bool), "A2"), [0, 0])
            >>> axes = field.path_to([8, 3]).plot(field.plot())
        """
        from hexmap.drawing.value_drawing import plot_line

        return plot_line(self.points, ax, **style)

    def _repr_html_(self) -> str:
        """Show a small picture in a notebook."""
        return picture_html(self)

    def __repr__(self) -> str:
        """Say how long it is."""
        return f"Path({len(self)} cells, {self.length:.6g} m, cost {self.cost:.6g})"


def make_path(
    graph: LatticeGraph,
    flat: IntArray,
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
    length, turning = measure(points)
    cost = math.fsum(leg_costs(graph, flat))
    least = None if clearance is None else float(clearances(graph, clearance)[flat].min())
    return Path(cells, points, cost, length, turning, least, int(expansions), int(pushes), int(scanned), seconds, bound)


def clearances(graph: LatticeGraph, values: ArrayLike) -> NDArray[np.float64]:
    """Return the clearances (size,) of a graph's flat cells, given as they are or without the padding.

    Raises:
        ArgumentError: neither one number for each flat cell nor one for each cell of ``inner_shape``.
    """
    array = np.asarray(values, dtype=np.float64)
    if array.shape == (graph.size,):
        return array
    if array.shape == graph.inner_box.dims:
        out = np.zeros(graph.size)
        graph.box.without_padding(out, graph.pad)[...] = array
        return out
    raise ArgumentError(f"clearances are ({graph.size},) or {graph.inner_box.dims}, not {array.shape}")


def leg_costs(graph: LatticeGraph, flat: IntArray) -> NDArray[np.float64]:
    """Return what each move along neighbouring ``flat`` cells (M,) costs (M - 1,)."""
    order = np.argsort(graph.offsets)
    legs = graph.lengths[order[np.searchsorted(graph.offsets[order], np.diff(flat))]]
    if graph.terrain is not None:
        legs = legs * (0.5 * (graph.terrain[flat[:-1]] + graph.terrain[flat[1:]]))
    return np.asarray(legs)


def measure(points: NDArray[np.float64]) -> tuple[float, float]:
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


def cells_to_flat(graph: LatticeGraph, cells: ArrayLike, role: str, *, blocked: bool = True) -> IntArray:
    """Return the flat cells (M,) of one cell (n,) or many (M, n), held to be in the map and, if asked, free.

    Args:
        graph: where they are to lie.
        cells: integer indices, as an array or a list: a tuple could be a point in metres.
        role: "start" or "goal", for the error.
        blocked: a blocked cell is an error.

    Raises:
        ArgumentError: not integers of that shape, or none.
        NoPath: a cell lies outside the map or is blocked.
    """
    array = integers(cells)
    n = graph.lattice.dim
    if isinstance(cells, tuple):
        # (12, -8) is how a point in metres is written, and its numbers are often whole.
        raise ArgumentError(
            f"a {role} is a cell's index as an array or a list, not {quoted(cells)}: "
            "to_cell makes one of a point in metres"
        )
    if array is None:
        raise ArgumentError(f"a {role} is given as a cell's integer index; to_cell makes one of a point in metres")
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


def not_connected(start: ArrayLike, goal: ArrayLike) -> NoPath:
    """Return the error that nothing leads from ``start`` (n,) to ``goal``, one cell (n,) or any of many (M, n)."""
    cells = np.atleast_2d(np.asarray(goal))
    to = str(tuple(cells[0].tolist())) if len(cells) == 1 else f"any of {len(cells)} goals"
    return NoPath("not connected", f"nothing leads from {tuple(np.asarray(start).tolist())} to {to}")
