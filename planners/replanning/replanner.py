"""Replanning: a path that is kept shortest while cells change and the robot moves."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import IntArray
from hexmap.base.errors import ArgumentError
from planners.path import NoPath, Path, cells_to_flat, make_path
from planners.search.astar import astar
from planners.search.heuristics import gauge_planes

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["Replanner"]

# Lengths are rounded as in A*, to this part of the shortest, so that both tell the same paths apart.
_LENGTH_STEPS = 2.0**36
_MOST_COST = 2**61  # of a path; keys are sums of three costs and fit into int64
_MOST_SHIFT = 2**60  # of the keys, after which they are made anew
_MOST_MOVES = 126  # they share a byte with two marks
_MOST_MULTIPLE = 1 << 10  # of lengths, that makes the heuristic's planes whole numbers
_MOST_CUT = 0.5  # cells cut off, as a part of those that planning anew would expand, beyond which it is cheaper
_MOST_CHANGED = 0.25  # the same for cells that changed
_FEW = 256  # cells; so few are never worth planning anew
_FIRST_LOOK = 2048  # expansions, after which, and after each doubling, a look is taken whether the robot is shut in
_POCKET = 4  # expansions to one cell of the pocket looked for
# Expansions of a search, to those that planning anew would take, after which a forward A* answers. Less bounds
# the worst repair better, but then moderate ones are not brought to their end: in total that took longer.
_PATIENCE = 1.5
_LEAST_BUDGET = 2048  # expansions that a search always gets
_NO_BUDGET = 2**62
_USUAL = 32  # expansions of A* to a cell of the path, at most, until it has been asked
_QUEUE_FACTOR, _QUEUE_SLACK = 4, 1 << 16  # how far the queue grows before stale entries are removed


class Replanner:
    """A shortest path between two cells, repaired after changes instead of searched anew.

    The search runs from the goal to the start, so that what changes near the robot lies at the
    leaves of its tree. Keys and their shift when the start moves are those of D* Lite (Koenig and
    Likhachev, AAAI 2002); changes are mended as in D* Extra Lite (Przybylski and Putz, Int. J.
    Appl. Math. Comput. Sci. 27(2), 2017): the branches that a change invalidates are cut off, and
    A* fills the gap from the cells around it. Other than there, a cell that loses its parent is
    cut off only where no other neighbour holds its cost just as well; on a lattice, where
    most cells have many equal shortest paths, few are. When more is to be cut off than planning
    anew would search, that is done. Costs are whole numbers inside, thus exact: after every change
    the path costs what A* finds on the same graph. Which of several equal paths is returned
    depends on the changes and calls before, and on nothing else.

    A search from the goal must finish every cell whose f lies below the new cost. Where a detour
    near the robot raises it by little, that can be most of the map, while A* from the robot looks
    around its end alone. Hence each search has a budget; when that is spent, :func:`planners.astar`
    answers, and the next search goes on with the tree as it stands. This bounds a single repair by
    a few times what A* takes.

    Changes are only noted when they are made; :meth:`path` does the work, so that many changes
    between two paths cost what their sum costs, and a cell that changes and changes back nothing.
    As long as changes make nothing cheaper and leave the last path open, and the robot is on it,
    what remains of it is shortest, and nothing else is done.

    With terrain, costs are rounded to 2^-36 of the cheapest move (coarser where the sum over all
    cells would not fit into 61 bits), and paths that differ by less are not told apart.

    Examples:
        >>> import numpy as np
        >>> from hexmap.graph import LatticeGraph
        >>> from hexmap.lattice import Lattice
        >>> from planners import Replanner
        >>> graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((3, 5), np.uint8))
        >>> robot = Replanner(graph, [0, 0], [0, 4])
        >>> robot.path().cost
        4.0
        >>> robot.block([[0, 2], [1, 2]])
        >>> robot.path().cost
        8.0
    """

    def __init__(self, graph: LatticeGraph, start: ArrayLike, goal: ArrayLike) -> None:
        """Prepare; nothing is searched yet. Later changes leave ``graph`` as it is.

        Args:
            graph: where to go.
            start: a cell's index (n,); it may be blocked, as the goal may, until a path is asked for.
            goal: a cell's index (n,).

        Raises:
            NoPath: an end is outside the map.
            ArgumentError: not one cell, or the graph has more than 126 moves.
        """
        if len(graph.moves) > _MOST_MOVES:
            raise ArgumentError(f"replanning takes at most {_MOST_MOVES} moves, not {len(graph.moves)}")
        self._base = graph
        self._start = self._one(start, "start")
        self._goal = self._one(goal, "goal")
        self._free = graph.free.copy()
        self._known = np.zeros(0, np.uint8)
        self._terrain = np.empty(0) if graph.terrain is None else graph.terrain.copy()
        self._touched: list[IntArray] = []
        self._priced: list[IntArray] = []
        self._g, self._via = np.empty(graph.size, np.int64), np.zeros(graph.size, np.uint8)
        self._queue = (np.empty(1024, np.int64), np.empty(1024, np.int64), np.empty(1024, np.int64))
        self._count = 0
        self._live = 0
        self._shift = 0
        self._keyed = self._start  # the start that the keys are for
        self._anew = True
        self._effort = 0  # cells expanded when last planned anew
        self._way = 1  # and the estimate of the way then
        self._usual = 0.0  # cells that a forward A* expands
        self._span = 1  # and the way then
        # What was found for the states of ``_known``: flat cells of a shortest path, or the start that none leads from.
        self._route: IntArray | None = None
        self._shut_in = -1
        self._eased = False  # whether terrain has become cheaper since
        self._forced: int | None = None  # tests set the budget of searches
        self._measure()

    def _one(self, cell: ArrayLike, role: str) -> int:
        if np.ndim(cell) != 1:
            raise ArgumentError(
                f"a {role} for replanning is one cell ({self._base.lattice.dim},), not {np.shape(cell)}"
            )
        return int(cells_to_flat(self._base, cell, role, blocked=False)[0])

    def _measure(self) -> None:
        """Fix the unit of cost, and lengths and planes in it."""
        graph = self._base
        terrain = self._terrain
        self._least = float(terrain.min()) if len(terrain) else 1.0
        self._most = float(terrain.max()) if len(terrain) else 1.0
        planes = gauge_planes(graph.moves, graph.lengths)
        least = graph.lengths * self._least
        unit = 2.0 ** np.floor(np.log2(least.min() / _LENGTH_STEPS))
        worst = float(graph.lengths.max()) * self._most * graph.size
        while True:
            steps = [int(v) for v in np.rint(least / unit)]
            multiple, whole = _whole_planes(graph.moves, steps, planes)
            if worst / unit * multiple < _MOST_COST:
                break
            unit *= 2.0
        self._lengths = np.array(steps, dtype=np.int64) * multiple
        self._scaled = graph.lengths * (multiple / unit)
        self._planes = whole
        self._rises = np.zeros((len(graph.moves) + 1, len(whole)), np.int64)
        self._rises[:-1] = graph.moves @ whole.T

    # ------------------------------------------------------------------ changes

    def block(self, cells: ArrayLike) -> None:
        """Note that ``cells`` (M, n) are blocked now.

        Raises:
            ArgumentError: not integers of that shape, or one lies outside the window; nothing is changed then.
        """
        self._set(self._flat(cells), 0)

    def free(self, cells: ArrayLike) -> None:
        """Note that ``cells`` (M, n) are free now; with terrain they cost what was last set for them, else the least.

        Raises:
            ArgumentError: not integers of that shape, or one lies outside the window; nothing is changed then.
        """
        self._set(self._flat(cells), 1)

    def set_cells(self, cells: ArrayLike, free: ArrayLike) -> None:
        """Note which of ``cells`` (M, n) are ``free`` (M,) bool now; of a cell given twice the last counts.

        Raises:
            ArgumentError: not of these shapes, or a cell lies outside the window; nothing is changed then.
        """
        flat = self._flat(cells)
        states = np.asarray(free)
        if states.shape != flat.shape or states.dtype != np.bool_:
            raise ArgumentError(
                f"states of {len(flat)} cells must be bool ({len(flat)},), not {states.dtype} {states.shape}"
            )
        flat, last = _last_of_each(flat)
        self._set(flat, states[last])

    def set_terrain(self, cells: ArrayLike, values: ArrayLike) -> None:
        """Note the multipliers of cost ``values`` (M,) of ``cells`` (M, n); of a cell given twice the last counts.

        A value below the least or above the greatest so far changes the unit of cost: then all is planned anew.

        Raises:
            ArgumentError: the graph has no terrain, the arrays are not of these shapes, a cell lies outside
                the window or a value is not positive and finite; nothing is changed then.
        """
        if len(self._terrain) == 0:
            raise ArgumentError("the graph has no terrain to change; give it one with with_terrain")
        flat = self._flat(cells)
        given = np.asarray(values, dtype=np.float64)
        if given.shape != flat.shape:
            raise ArgumentError(f"the terrain of {len(flat)} cells must be ({len(flat)},), not {given.shape}")
        wrong = ~(np.isfinite(given) & (given > 0.0))
        if wrong.any():
            raise ArgumentError(f"the terrain of a cell must be positive and finite, not {given[wrong][0]:g}")
        flat, last = _last_of_each(flat)
        given = given[last]
        differ = self._terrain[flat] != given
        flat, given = flat[differ], given[differ]
        if len(flat) == 0:
            return
        self._eased = self._eased or bool((given < self._terrain[flat]).any())
        self._terrain[flat] = given
        if given.min() < self._least or given.max() > self._most:
            self._measure()
            self._anew = True
        elif not self._anew:
            self._priced.append(flat)

    def move_to(self, start: ArrayLike) -> None:
        """Note that the robot is in the cell ``start`` (n,) now.

        Raises:
            NoPath: the cell is outside the map; the robot stays where it was.
            ArgumentError: not one cell.
        """
        self._start = self._one(start, "start")

    def _flat(self, cells: ArrayLike) -> IntArray:
        flat = self._base.index_to_flat(cells)
        if (flat < 0).any():
            outside = tuple(np.asarray(cells)[flat < 0][0].tolist())
            raise ArgumentError(f"cell {outside} lies outside the window of the graph")
        return flat

    def _set(self, flat: IntArray, states: ArrayLike) -> None:
        self._free[flat] = states
        if not self._anew and len(flat):
            self._touched.append(flat)

    @property
    def graph(self) -> LatticeGraph:
        """A copy of the graph as it is now; clearance is measured from the obstacles of the one given at first."""
        free = self._free.copy()
        if len(self._terrain) == 0:
            return self._base._derived(free, None)
        return self._base._derived(free, None).with_terrain(self._terrain)

    # ------------------------------------------------------------------ paths

    def path(self) -> Path:
        """Return a cheapest path from where the robot is to the goal.

        ``expansions``, ``pushes`` and ``seconds`` count what mending took this time, A* included
        where that answers; cells cut off count as expansions.

        Raises:
            NoPath: an end is blocked or nothing connects them, as things are now.
        """
        from planners.replanning import _kernels as kernels

        for flat, role in ((self._start, "start"), (self._goal, "goal")):
            if not self._free[flat]:
                raise NoPath(f"{role} blocked", f"cell {self._name(flat)}")
        begin = time.perf_counter()
        graph = self._base
        place = self._place(self._start)
        moved = self._estimate(self._keyed, self._start)
        ahead = self._estimate(self._start, self._goal)
        tables = (
            self._free, graph.offsets, self._lengths, self._scaled, graph.swept_starts, graph.swept, self._terrain,
            graph.strides, self._planes, self._rises,
        )  # fmt: skip
        expansions = pushes = 0
        touched, priced = self._changes()
        self._touched, self._priced = [touched], [priced]
        if not (self._anew or self._eased or self._free[touched].any()):
            if self._shut_in == self._start:
                raise self._unconnected()
            kept = self._kept(priced)
            if kept is not None:
                return make_path(self._now(), kept, seconds=time.perf_counter() - begin)
        severed = self._shut_in >= 0
        self._route, self._shut_in = None, -1
        # Planning anew searches the less, the nearer the goal.
        effort = self._effort * min(ahead / self._way, 1.0)
        fresh = self._anew or len(touched) + len(priced) > max(_FEW, _MOST_CHANGED * effort)
        self._anew = True  # should anything break off in between
        if not fresh:
            self._shift += moved
            full = self._count > _QUEUE_FACTOR * self._live + _QUEUE_SLACK
            if self._shift > _MOST_SHIFT or full:
                self._count = kernels.rekey(
                    *self._queue, self._count, place, graph.strides, self._planes, self._rises, self._g, self._via
                )
                self._live = self._count
                self._shift = 0
            if len(touched) + len(priced):
                limit = int(max(_FEW, _MOST_CUT * effort))
                *queue, self._count, cut, pushes = kernels.amend(
                    *tables, place, self._shift, *self._queue, self._count, self._g, self._via,
                    self._known, touched, priced, limit,
                )  # fmt: skip
                self._queue = (queue[0], queue[1], queue[2])
                fresh = cut < 0
                expansions = max(cut, 0)
        if fresh:
            self._known = self._free.copy()
            self._via.fill(0)
            self._via[self._goal] = kernels.OPEN | kernels.ROOT
            self._g[self._goal] = 0
            for entries, value in zip(self._queue, (ahead, 0, self._goal), strict=True):
                entries[0] = value
            self._count = 1
            self._shift = 0
            pushes += 1
        # Where A* found no way, the search from the goal comes to its end once instead, for later changes.
        usual = self._usual * min(ahead / self._span, 1.0)
        expected = max(effort, usual) if fresh else usual
        budget = int(max(_PATIENCE * expected, _LEAST_BUDGET)) if self._usual and not severed else _NO_BUDGET
        if self._forced is not None:
            budget = self._forced
        searched, look = 0, min(_FIRST_LOOK, budget)
        enclosed = False
        while True:
            *queue, self._count, done, pushed = kernels.search(
                *tables, self._start, place, self._shift, *self._queue, self._count, self._g, self._via, look
            )
            self._queue = (queue[0], queue[1], queue[2])
            searched += done
            pushes += pushed
            ended = self._final()
            if ended or searched >= budget:
                break
            # A robot shut in a pocket would have all that is open to the goal searched to its end.
            enclosed = not self._via[self._start] and kernels.enclosed(
                self._free, graph.offsets, graph.swept_starts, graph.swept, self._start, self._goal, look // _POCKET
            )
            if enclosed:
                break
            look = min(2 * look, budget - searched)
        self._touched, self._priced = [], []
        self._eased = False
        self._keyed = self._start
        self._anew = False
        expansions += searched
        if fresh:
            self._live = self._count
            if ended or enclosed:
                self._effort, self._way = searched, max(ahead, 1)
        if not (ended or enclosed):
            # The tree stays as it is; the next search goes on from there.
            try:
                path = astar(self._now(), self._index(self._start), self._index(self._goal))
            except NoPath:
                self._shut_in = self._start
                raise self._unconnected() from None
            # A change near the goal can flood A* as one near the robot does the search from the goal.
            self._usual, self._span = max(min(path.expansions, 2 * usual), 1), max(ahead, 1)
            self._route = self._base.index_to_flat(path.cells)
            return replace(
                path,
                expansions=expansions + path.expansions,
                pushes=pushes + path.pushes,
                seconds=time.perf_counter() - begin,
            )
        if not self._via[self._start]:
            self._shut_in = self._start
            raise self._unconnected()
        flat = kernels.follow(self._via, graph.offsets, self._start)
        self._route = flat
        if fresh:
            self._usual, self._span = min(searched, _USUAL * len(flat)), max(ahead, 1)
        seconds = time.perf_counter() - begin
        return make_path(self._now(), flat, expansions=expansions, pushes=pushes, seconds=seconds)

    def _final(self) -> bool:
        """Tell whether the cost of the start is final, or that it cannot be reached."""
        if self._count == 0:
            return True
        return bool(self._via[self._start] and self._queue[0][0] >= self._g[self._start] + self._shift)

    def _kept(self, priced: IntArray) -> IntArray | None:
        """Return what is left of the last path, which is still shortest where changes touch none of it.

        That is so for changes that make nothing cheaper, and a robot that is on the path.

        Args:
            priced: flat cells whose terrain became dearer.
        """
        from planners.replanning import _kernels as kernels

        if self._route is None:
            return None
        at = np.flatnonzero(self._route == self._start)
        if len(at) == 0:
            return None
        rest = self._route[at[0] :]
        if len(priced) and np.isin(rest, priced).any():
            return None
        graph = self._base
        whole = kernels.stands(rest, self._free, graph.offsets, graph.swept_starts, graph.swept)
        return rest if whole else None

    def _unconnected(self) -> NoPath:
        return NoPath("not connected", f"nothing leads from {self._name(self._start)} to {self._name(self._goal)}")

    def _changes(self) -> tuple[IntArray, IntArray]:
        """Return the cells whose state differs from what the tree stands for, and those of other terrain."""
        none = np.empty(0, np.int64)
        if self._anew:
            return none, none
        touched = np.unique(np.concatenate(self._touched)) if self._touched else none
        touched = touched[self._free[touched] != self._known[touched]]
        if (touched == self._goal).any():
            self._anew = True
        return touched, np.unique(np.concatenate(self._priced)) if self._priced else none

    def _estimate(self, a: int, b: int) -> int:
        """Return what a path between two flat cells costs at least, in units."""
        return int(np.abs(self._planes @ (self._place(b) - self._place(a))).max(initial=0)) if a != b else 0

    def _place(self, flat: int) -> IntArray:
        """Return a flat cell in window coordinates (n,)."""
        place = np.empty(len(self._base.strides), np.int64)
        for i, stride in enumerate(self._base.strides.tolist()):
            place[i], flat = divmod(flat, stride)
        return place

    def _now(self) -> LatticeGraph:
        """Return the graph as it is now, without copies."""
        return self._base._derived(self._free, self._terrain if len(self._terrain) else None)

    def _index(self, flat: int) -> IntArray:
        return self._place(flat) + self._base.low

    def _name(self, flat: int) -> tuple[int, ...]:
        return tuple(self._index(flat).tolist())

    def __repr__(self) -> str:
        """Show the ends and the graph."""
        return f"<Replanner from {self._name(self._start)} to {self._name(self._goal)} in {self._base!r}>"


def _last_of_each(flat: IntArray) -> tuple[IntArray, IntArray]:
    """Return each flat cell once, and the place where it comes last."""
    cells, back = np.unique(flat[::-1], return_index=True)
    return cells, len(flat) - 1 - back


def _whole_planes(moves: IntArray, steps: list[int], planes: NDArray[np.float64]) -> tuple[int, IntArray]:
    """Return a multiple m, and planes (F, n) of whole numbers that span the gauge of the moves / (m * steps).

    ``steps`` are the moves' costs in whole numbers. A facet is solved for from the moves that span it,
    exactly; then the estimate is consistent without an allowance, and of equal f on a straight way
    none is a little larger than the other.

    Args:
        moves: (K, n) index offsets.
        steps: (K,) their costs.
        planes: (F, n) the facets in floats, in any unit of cost for which moves on a facet meet it.
    """
    n = moves.shape[1]
    costs = np.array(steps, dtype=np.float64)
    found: list[list[Fraction]] = []
    for plane in planes:
        products = moves @ plane
        ratio = products / costs
        near = np.flatnonzero(ratio >= ratio.max() * (1.0 - 1e-9)).tolist()
        for some in itertools.combinations(near, n):
            solved = _solve([moves[k].tolist() for k in some], [steps[k] for k in some])
            if solved is not None:
                found.append(solved)
                break
    multiple = math.lcm(*(x.denominator for plane in found for x in plane), 1)
    if multiple > _MOST_MULTIPLE:
        multiple = 1
    whole = []
    for plane in found:
        # Where rounding lets a move be estimated above its cost the plane gives way a little, or goes.
        for part in (Fraction(1), 1 - Fraction(1, 2**30), 1 - Fraction(1, 2**20)):
            row = [round(x * multiple * part) for x in plane]
            if all(
                abs(sum(a * int(b) for a, b in zip(row, move, strict=True))) <= multiple * cost
                for move, cost in zip(moves, steps, strict=True)
            ):
                whole.append(row)
                break
    return multiple, np.array(whole, dtype=np.int64).reshape(-1, n)


def _solve(rows: list[list[int]], right: list[int]) -> list[Fraction] | None:
    """Return the exact solution of a small system, or None where it has not just one."""
    n = len(rows)
    table = [[Fraction(v) for v in row] + [Fraction(c)] for row, c in zip(rows, right, strict=True)]
    for i in range(n):
        pivot = next((r for r in range(i, n) if table[r][i] != 0), None)
        if pivot is None:
            return None
        table[i], table[pivot] = table[pivot], table[i]
        table[i] = [v / table[i][i] for v in table[i]]
        for r in range(n):
            if r != i:
                table[r] = [v - table[r][i] * w for v, w in zip(table[r], table[i], strict=True)]
    return [row[n] for row in table]
