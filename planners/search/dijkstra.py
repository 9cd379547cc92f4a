"""Least costs from one cell, or many, to all others: a wavefront on equal edges, buckets on others."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.pictures import picture_html
from hexmap.base.values import integers
from planners.path import NoPath, Path, cells_to_flat, make_path
from planners.search.heuristics import least_terrain

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hexmap.graph.lattice_graph import LatticeGraph
    from planners.search._shared_kernels import GraphArrays

__all__ = ["DistanceField", "dijkstra"]

# A bucket's width over the cheapest move. A little less than one: rounding must not let a move end
# in the bucket that it began in.
_WIDTH = 1.0 - 1e-9
# A path's cost has no rounding error, the sums of the search have some: a cell at the limit itself is within it.
_ROUNDING = 1e-12
# Buckets at a time; where terrain differs more than that a heap takes their place.
_MOST_BUCKETS = 1 << 16
# The same of a ring, whose buckets have room for as many entries as the largest of them; else they are lists.
_MOST_IN_RING = 60


@dataclass(frozen=True, eq=False)
class DistanceField:
    """The least cost from the sources to every cell, and the paths there.

    Attributes:
        graph: in which it holds.
        sources: (M, n) int32 cells.
        steps: (size,) int32 moves to each cell, -1 where none leads there; None where the moves
            do not all cost the same.
        limit: costs beyond it were not looked for, metres.
        settled: cells expanded: those with a distance.
        pushes: entries made in the queue.
        seconds: time of the search.
    """

    graph: LatticeGraph
    sources: NDArray[np.int32]
    steps: NDArray[np.int32] | None
    limit: float
    settled: int
    pushes: int
    seconds: float
    _distance: NDArray[np.float64] | None = None
    _partial: bool = False

    def __repr__(self) -> str:
        """Show where from, how far it reaches and the graph."""
        count = len(self.sources)
        sources = "1 source" if count == 1 else f"{count} sources"
        return f"<DistanceField from {sources} to {self.settled:,} cells of {self.graph!r}>"

    @cached_property
    def distance(self) -> NDArray[np.float64]:
        """Least cost (size,) of each flat cell, metres (times terrain); inf where none leads there."""
        if self._distance is not None:
            return self._distance
        assert self.steps is not None
        out: NDArray[np.float64] = np.multiply(self.steps, self.graph.lengths[0], dtype=np.float64)
        out[self.steps < 0] = np.inf
        return out

    def _arrays(self) -> GraphArrays:
        """Return the graph's arrays by which the kernels find how a cell was reached."""
        from planners.search import _shared_kernels as kernels

        # Steps count moves: each costs one.
        lengths = None if self.steps is None else np.ones(len(self.graph.moves))
        return kernels.graph_arrays(self.graph, lengths)

    @property
    def _values(self) -> NDArray[Any]:
        return self.distance if self.steps is None else self.steps

    @cached_property
    def parents(self) -> NDArray[np.uint8]:
        """The move (size,) that leads to each cell from its parent; the number of moves where there is none.

        The lowest of the moves that are equally good. Computed from the distances when asked for.
        """
        from planners.search import _dijkstra_kernels as kernels

        out = np.empty(self.graph.size, np.uint8)
        kernels.parents(self._values, out, self._arrays())
        return out

    def to_array(self) -> NDArray[np.float64]:
        """Return the least costs with an axis an index, as :meth:`LatticeGraph.to_array` returns cells.

        Returns:
            (``graph.inner_shape``) float64 metres (times terrain): ``array[cell - graph.first]``; inf where no path
            leads.

        Examples:
            >>> import numpy as np
            >>> from hexmap import LatticeGraph
            >>> from planners import dijkstra
            >>> dijkstra(LatticeGraph.from_array(np.zeros((1, 4), bool), "Z2"), [0, 1]).to_array()
            array([[1., 0., 1., 2.]])
        """
        return self.graph.to_array(self.distance)

    def plot(self, ax: Axes | None = None, *, height: float | None = None, colorbar: bool = True) -> Axes:
        """Draw the least costs on axes of matplotlib: the sources as rings, cells that are not free grey.

        Cells that are free and out of reach are left blank. In space what a horizontal plane cuts is drawn.

        Args:
            ax: axes to draw on; new ones where none are given.
            height: of the cut through a field in space, metres; that of the first source where none is given.
            colorbar: whether the colours are explained beside it.

        Returns:
            The axes.

        Raises:
            ArgumentError: a height that is not finite, or of a field in the plane.

        Examples:
            >>> import numpy as np
            >>> from hexmap import LatticeGraph
            >>> from planners import dijkstra
            >>> graph = LatticeGraph.from_array(np.zeros((4, 4, 4), bool), "D3")
            >>> axes = dijkstra(graph, [0, 0, 0]).plot(height=1.0)
        """
        from hexmap.drawing.value_drawing import plot_values

        sources = self.graph.lattice.centres(self.sources)
        at = float(sources[0, 2]) if height is None and sources.shape[1] == 3 else height
        return plot_values(self.graph, self.distance, ax, marks=sources, height=at, colorbar=colorbar)

    def _repr_html_(self) -> str:
        """Show a small picture in a notebook."""
        return picture_html(self)

    def distance_to(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Return the least cost (M,) to ``cells`` (M, n); inf for those out of reach, blocked or outside.

        Raises:
            ArgumentError: not integer indices (M, n).
        """
        index = integers(cells)
        n = self.graph.lattice.dim
        if index is None or index.ndim != 2 or index.shape[1] != n:
            raise ArgumentError(f"cells must be integer indices (M, {n}), not {np.shape(cells)}")
        flat = self.graph.index_to_flat(index)
        inside = flat >= 0
        flat = np.where(inside, flat, 0)
        if self.steps is not None:  # without the whole field of distances
            steps = self.steps[flat]
            found = np.where(steps < 0, np.inf, steps * float(self.graph.lengths[0]))
        else:
            found = self.distance[flat]
        return np.asarray(np.where(inside, found, np.inf), dtype=np.float64)

    def path_to(self, goal: ArrayLike, *, clearance: NDArray[np.float64] | None = None) -> Path:
        """Return a cheapest path from the nearest source to the cell ``goal`` (n,), without searching again.

        Args:
            goal: a cell's index.
            clearance: (size,) metres, of which the path's least is reported.

        Raises:
            NoPath: the goal is blocked, outside the map, out of reach or beyond the limit of the search.
        """
        begin = time.perf_counter()
        if np.ndim(goal) != 1:
            raise ArgumentError(f"a path leads to one cell ({self.graph.lattice.dim},), not {np.shape(goal)}")
        flat = cells_to_flat(self.graph, goal, "goal")
        cost = float(self.distance_to(np.asarray(goal)[None])[0])
        if math.isinf(cost):
            where = f"cell {tuple(np.asarray(goal).tolist())}"
            if (self._partial or math.isfinite(self.limit)) and any(
                self.graph.connected(source, goal) for source in self.sources
            ):
                raise NoPath("beyond the limit", f"{where}, the search went no farther")
            raise NoPath("not connected", f"nothing leads to {where}")
        from planners.search import _dijkstra_kernels as kernels

        back = kernels.walk_back(self._values, flat[0], self._arrays())
        if self._values[back[-1]] > 0:
            # It ends where a sum absorbed a step: which way on to a source the whole field tells.
            back = kernels.follow_parents(self.parents, flat[0], self.graph.offsets)
        return make_path(
            self.graph,
            np.ascontiguousarray(back[::-1]),
            clearance=clearance,
            expansions=self.settled,
            pushes=self.pushes,
            seconds=self.seconds + time.perf_counter() - begin,
        )


def field_kernel(graph: LatticeGraph) -> Any:
    """Return the kernel that finds the fields of a graph."""
    from planners.search import _bucket_kernels, _dijkstra_kernels

    if graph.equal_edges and graph.terrain is None and len(graph.swept) == 0:
        return _dijkstra_kernels.wavefront
    width, dearest = _bucket_width(graph)
    if graph.terrain is None and dearest / width <= _MOST_IN_RING:
        return _bucket_kernels.ring
    return _dijkstra_kernels.buckets if dearest / width <= _MOST_BUCKETS else _dijkstra_kernels.heap


def _bucket_width(graph: LatticeGraph) -> tuple[float, float]:
    """Return how wide a bucket is that no move ends in where it began, and what the dearest move costs at most."""
    dearest = float(graph.lengths.max()) * (1.0 if graph.terrain is None else float(graph.terrain.max()))
    return float(graph.lengths.min()) * least_terrain(graph) * _WIDTH, dearest


def dijkstra(
    graph: LatticeGraph, sources: ArrayLike, *, goals: ArrayLike | None = None, limit: float | None = None
) -> DistanceField:
    """Return the least cost from the nearest of ``sources`` to every cell.

    Where all moves cost the same and sweep nothing, a wavefront without a queue of priorities finds the
    numbers of moves; else buckets as wide as the cheapest move, in which every cell is final
    when its bucket comes up. Both are exact, in float64.

    Args:
        graph: where to go.
        sources: a cell's index (n,), or many (M, n).
        goals: a cell's index (n,), or many (M, n): the search stops when it has all of them.
        limit: greatest cost that is looked for, metres, to 1e-12 of itself.

    Raises:
        NoPath: a source or a goal is blocked or outside the map.
        ArgumentError: the limit is negative or not a number.
    """
    most = math.inf if limit is None else float(limit)
    if math.isnan(most) or most < 0.0:
        raise ArgumentError(f"the limit of a search must be a number of metres, 0 or more, not {limit!r}")
    start = np.unique(cells_to_flat(graph, sources, "start"))
    wanted = np.empty(0, np.int64) if goals is None else cells_to_flat(graph, goals, "goal")
    from planners.search import _dijkstra_kernels as kernels
    from planners.search._shared_kernels import graph_arrays

    begin = time.perf_counter()
    steps: NDArray[np.int32] | None = None
    distance: NDArray[np.float64] | None = None
    kernel = field_kernel(graph)
    if kernel is kernels.wavefront:
        steps = np.full(graph.size, -1, np.int32)
        state = graph.free.copy()
        # One longer than there are cells: the kernel writes before it knows whether it keeps.
        queue = np.empty(graph.size + 1, np.int32 if graph.size < 2**31 - 1 else np.int64)
        queue[: len(start)] = start
        state[start] = 0
        rounds = min(most / float(graph.lengths[0]) * (1.0 + _ROUNDING), 2.0**31 - 2)
        settled = pushes = kernel(
            state, graph.offsets, queue, steps, len(start), wanted, np.int32(math.floor(rounds))
        )
    else:
        distance = np.full(graph.size, np.inf)
        width, dearest = _bucket_width(graph)
        reach = most * (1.0 + _ROUNDING)
        arrays = graph_arrays(graph)
        if kernel is kernels.heap:
            settled, pushes = kernel(arrays, start, wanted, reach, distance)
        else:
            settled, pushes = kernel(arrays, start, wanted, reach, 1.0 / width, int(dearest / width) + 3, distance)
    return DistanceField(
        graph,
        graph.flat_to_index(start),
        steps,
        most,
        int(settled),
        int(pushes),
        time.perf_counter() - begin,
        distance,
        goals is not None,
    )
