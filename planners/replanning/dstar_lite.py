"""D* Lite on a lattice graph: a tree of shortest paths from the goal, kept after changes of cells and of the start.

The procedures have the names of Koenig and Likhachev, "D* Lite", AAAI 2002, and km is theirs. Changes are
repaired as in D* Extra Lite (Przybylski and Putz, Int. J. Appl. Math. Comput. Sci. 27(2), 2017): the branches
that a change invalidates are cut off, and the search fills the gap from the cells around it. Other than
there, a cell that loses its parent is cut off only where no other neighbour holds its cost just as well; on a
lattice, where most cells have many equal shortest paths, few are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import IntArray
from planners.replanning.whole_costs import whole_costs

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph
    from planners.replanning._kernels import Metric, Start, Tree
    from planners.search._shared_kernels import GraphArrays

__all__ = ["DStarLite"]

_MOST_KM = 2**60  # after which the keys are made anew
_QUEUE_FACTOR, _QUEUE_SLACK = 4, 1 << 16  # how far the queue grows before entries out of date are removed
_FIRST_QUEUE = 1024  # entries that fit at first
# Units to the cheapest move. Rounding to them is at most as large a part of a path's cost.
_FINE = 2.0**24


class DStarLite:
    """The search tree from a goal to a start, on states and terrain that its owner changes.

    The owner calls :meth:`initialize` first and after everything that :meth:`repair` is not told of,
    :meth:`measure` among it;
    then :meth:`move_start` and :meth:`repair` in any order, and :meth:`compute_shortest_path` until :meth:`is_final`.

    Attributes:
        free: (size,) uint8 the owner's states of the cells.
        terrain: (size,) float64 the owner's multipliers of cost, (0,) for none.
        goal: flat cell.
        start: flat cell that the keys are for (s_last in D* Lite).
    """

    def __init__(self, graph: LatticeGraph, free: NDArray[np.uint8], terrain: NDArray[np.float64], goal: int) -> None:
        """Prepare for the window and the moves of a graph; nothing is searched yet."""
        self.free = free
        self.terrain = terrain
        self.goal = goal
        self._graph = graph
        self._shape = tuple(int(s) for s in graph.shape)
        self._set_start(goal)
        self._known = np.zeros(0, np.uint8)
        self._g, self._parent_move = np.empty(graph.size, np.int64), np.zeros(graph.size, np.uint8)
        self._queue = tuple(np.empty(_FIRST_QUEUE, np.int64) for _ in range(3))
        self._count = 0
        self._count_anew = 0  # entries after the search that followed initializing, or when all keys were made anew
        self._just_initialized = False
        self._km = 0
        self.measure()

    def measure(self) -> None:
        """Fix the unit of cost by the terrain's range; the tree stands for nothing until it is initialized."""
        terrain = self.terrain
        self._least = float(terrain.min()) if len(terrain) else 1.0
        self._most = float(terrain.max()) if len(terrain) else 1.0
        self._costs = whole_costs(self._graph, self._least, self._most)

    @property
    def tells_apart(self) -> bool:
        """Whether the unit of cost is fine enough to order paths as A* does: a small part of the cheapest move."""
        return float(self._costs.scaled.min()) * self._least >= _FINE

    def measures(self, values: NDArray[np.float64]) -> bool:
        """Tell whether multipliers of cost lie in the range that the unit of cost was fixed for."""
        return bool(values.min() >= self._least and values.max() <= self._most)

    def _set_start(self, start: int) -> None:
        self.start = start
        self._position = self.position(start)

    # ------------------------------------------------------------------ the procedures

    def initialize(self, start: int) -> int:
        """Forget the tree but for the goal, which is open; returns the entries made (Initialize)."""
        from planners.replanning import _kernels as kernels

        self._hand_over()
        self._set_start(start)
        self._known = self.free.copy()
        self._parent_move.fill(0)
        self._parent_move[self.goal] = kernels.OPEN | kernels.ROOT
        self._g[self.goal] = 0
        for entries, value in zip(self._queue, (self.estimate(start, self.goal), 0, self.goal), strict=True):
            entries[0] = value
        self._count = 1
        self._km = 0
        self._just_initialized = True
        return 1

    def move_start(self, start: int) -> None:
        """Go on with the search to another start: new keys grow by km, instead of all old ones being lowered."""
        from planners.replanning import _kernels as kernels

        self._just_initialized = False
        if start != self.start:
            self._km += self.estimate(self.start, start)
            self._set_start(start)
        full = self._count > _QUEUE_FACTOR * self._count_anew + _QUEUE_SLACK
        if self._km > _MOST_KM or full:
            self._km = 0
            queue = kernels.Queue(*self._queue)
            self._count = kernels.rekey(queue, self._count, self._start(), self._metric, self._tree)
            self._count_anew = self._count

    def repair(self, touched: IntArray, priced: IntArray, limit: int) -> tuple[int, int] | None:
        """Restore the invariants of the tree and the queue; None if more than ``limit`` cells are to be cut off.

        Args:
            touched: flat cells whose state has changed, other than the goal.
            priced: flat cells whose terrain has changed.
            limit: cells.

        Returns:
            (cells cut off, entries made).
        """
        from planners.replanning import _kernels as kernels

        *queue, self._count, cut, pushes = kernels.repair(
            self._arrays,
            self._metric,
            self._tree,
            kernels.Queue(*self._queue),
            self._count,
            self._start(),
            self._known,
            touched,
            priced,
            limit,
        )
        self._queue = tuple(queue)
        return None if cut < 0 else (cut, pushes)

    def compute_shortest_path(self, most: int) -> tuple[int, int]:
        """Search until the start's cost is final, or for ``most`` expansions (ComputeShortestPath).

        Returns:
            (expansions, entries made).
        """
        from planners.replanning import _kernels as kernels

        *queue, self._count, expansions, pushes = kernels.compute_shortest_path(
            self._arrays,
            self._metric,
            self._tree,
            kernels.Queue(*self._queue),
            self._count,
            self._start(),
            most,
        )
        self._queue = tuple(queue)
        if self._just_initialized:
            self._count_anew = self._count
        return expansions, pushes

    # ------------------------------------------------------------------ what is known

    def is_final(self) -> bool:
        """Tell whether the cost of the start is final, or that it cannot be reached."""
        if self._count == 0:
            return True
        return self.is_reached() and bool(self._queue[0][0] >= self._g[self.start] + self._km)

    def is_reached(self) -> bool:
        """Tell whether the tree holds a path to the start, final or not."""
        return bool(self._parent_move[self.start])

    def path(self) -> IntArray:
        """Return the flat cells (M,) from the start, which is reached, to the goal."""
        from planners.replanning import _kernels as kernels

        return kernels.follow(self._parent_move, self._graph.offsets, self.start)

    def is_enclosed(self, most: int) -> bool:
        """Tell whether moves lead from the start to at most ``most`` cells, and not to the goal."""
        from planners.replanning import _kernels as kernels

        return kernels.enclosed(self._arrays, self.start, self.goal, most)

    def is_allowed(self, route: IntArray) -> bool:
        """Tell whether a path of flat cells (M,), of which the first is free, is allowed as things are now."""
        from planners.replanning import _kernels as kernels

        return kernels.is_allowed(route, self._arrays)

    def differing(self, cells: IntArray) -> IntArray:
        """Return those of the flat cells whose state is another than the tree stands for."""
        return cells[self.free[cells] != self._known[cells]]

    def estimate(self, a: int, b: int) -> int:
        """Return what a path between two flat cells costs at least, in units."""
        if a == b:
            return 0
        return int(np.abs(self._costs.planes @ (self.position(b) - self.position(a))).max(initial=0))

    def position(self, flat: int) -> IntArray:
        """Return a flat cell in window coordinates (n,)."""
        return np.array(np.unravel_index(flat, self._shape), dtype=np.int64)

    # ------------------------------------------------------------------ as the kernels take it

    def _hand_over(self) -> None:
        """Put together what does not change until the tree is initialized again."""
        from planners.replanning import _kernels as kernels
        from planners.search import _shared_kernels

        graph, costs = self._graph, self._costs
        self._arrays: GraphArrays = _shared_kernels.GraphArrays(
            self.free, graph.offsets, costs.lengths, graph.swept_starts, graph.swept, self.terrain
        )
        self._metric: Metric = kernels.Metric(costs.scaled, costs.planes, costs.steps, graph.strides)
        self._tree: Tree = kernels.Tree(self._g, self._parent_move)

    def _start(self) -> Start:
        from planners.replanning import _kernels as kernels

        return kernels.Start(self.start, self._position, self._km)
