"""Replanning: a path that is kept shortest while cells change and the robot moves."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import IntArray
from hexmap.base.errors import ArgumentError
from planners.path import NoPath, Path, cells_to_flat, make_path
from planners.replanning.dstar_lite import DStarLite
from planners.replanning.policy import ReplanningPolicy
from planners.search.astar import astar

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["Replanner"]

_MOST_MOVES = 126  # they share a byte with two marks


class Replanner:
    """A shortest path between two cells, repaired after changes instead of searched anew.

    The search runs from the goal to the start, so that what changes near the robot lies at the
    leaves of its tree (:class:`planners.replanning.dstar_lite.DStarLite`). Costs are whole numbers inside, thus
    exact: after every change the path costs what A* finds on the same graph. Which of several equal paths
    is returned depends on the changes and calls before, and on nothing else.

    A policy (:class:`planners.replanning.policy.ReplanningPolicy`) decides how. When more of the tree is
    to be cut off than planning anew would search, all is planned anew. A search from the goal must
    finish every cell whose f lies below the new cost. Where a detour near the robot raises it by
    little, that can be most of the map, while A* from the robot looks around its end alone. Hence each
    search has a budget; when that is spent, :func:`planners.astar` answers, and the next search goes on
    with the tree as it stands. This bounds a single repair by a few times what A* takes.

    Changes are only noted when they are made; :meth:`path` does the work, so that many changes
    between two paths cost what their sum costs, and a cell that changes and changes back nothing.
    As long as changes make nothing cheaper and leave the last path open, and the robot is on it,
    what remains of it is shortest, and nothing else is done.

    With terrain, costs are rounded to 2^-36 of the cheapest move (coarser where the sum over all
    cells would not fit into 61 bits), and paths that differ by less are not told apart. Where terrain
    spans so much that this is no small part of the cheapest move, every answer is A*'s.

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

    def __init__(
        self, graph: LatticeGraph, start: ArrayLike, goal: ArrayLike, *, policy: ReplanningPolicy | None = None
    ) -> None:
        """Prepare; nothing is searched yet. Later changes leave ``graph`` as it is.

        Args:
            graph: where to go.
            start: a cell's index (n,); it may be blocked, as the goal may, until a path is asked for.
            goal: a cell's index (n,).
            policy: when to repair and when to plan anew; it learns, and serves one replanner only.
                None for one with the usual settings.

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
        self._terrain = np.empty(0) if graph.terrain is None else graph.terrain.copy()
        self._policy = ReplanningPolicy() if policy is None else policy
        self._tree = DStarLite(graph, self._free, self._terrain, self._goal)
        # Changes that the tree has not been told of; all there are where it is to be made anew.
        self._anew = True
        self._touched: list[IntArray] = []
        self._priced: list[IntArray] = []
        self._eased = False  # whether terrain has become cheaper since the last path
        # The last answer: flat cells of a shortest path, or the start that none leads from.
        self._route: IntArray | None = None
        self._shut_in = -1

    def _one(self, cell: ArrayLike, role: str) -> int:
        if np.ndim(cell) != 1:
            raise ArgumentError(
                f"a {role} for replanning is one cell ({self._base.lattice.dim},), not {np.shape(cell)}"
            )
        return int(cells_to_flat(self._base, cell, role, blocked=False)[0])

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
        if not self._tree.measures(given):
            self._tree.measure()
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

        ``expansions``, ``pushes`` and ``seconds`` count what the repair took this time, A* included
        where that answers; cells cut off count as expansions.

        Raises:
            NoPath: an end is blocked or nothing connects them, as things are now.
        """
        for flat, role in ((self._start, "start"), (self._goal, "goal")):
            if not self._free[flat]:
                raise NoPath(f"{role} blocked", f"cell {self._name(flat)}")
        begin = time.perf_counter()
        if not self._tree.tells_apart:  # terrain of so wide a range: whole numbers would take one path for another
            self._anew, self._route = True, None
            return self._answer_of_astar(_Work(begin, 1, True))
        touched, priced = self._changes()
        if self._holds(touched):
            if self._shut_in == self._start:
                raise self._unconnected()
            rest = self._rest_of_route(priced)
            if rest is not None:
                return make_path(self._now(), rest, seconds=time.perf_counter() - begin)
        severed = self._shut_in >= 0
        self._route, self._shut_in = None, -1
        work = self._update(touched, priced, begin)
        final = self._search(work, severed)
        return self._answer(work) if final else self._answer_of_astar(work)

    def _changes(self) -> tuple[IntArray, IntArray]:
        """Return the flat cells whose state differs from what the tree stands for, and those of other terrain."""
        none = np.empty(0, np.int64)
        touched = priced = none
        if not self._anew:
            if self._touched:
                touched = self._tree.differing(np.unique(np.concatenate(self._touched)))
            if self._priced:
                priced = np.unique(np.concatenate(self._priced))
            self._anew = bool((touched == self._goal).any())
        # Each once: an answer that still holds leaves them for later.
        self._touched, self._priced = [touched], [priced]
        return touched, priced

    def _holds(self, touched: IntArray) -> bool:
        """Tell whether no change since the last answer can have made a path cheaper."""
        return not (self._anew or self._eased or self._free[touched].any())

    def _rest_of_route(self, priced: IntArray) -> IntArray | None:
        """Return what is left of the last path, which is still shortest where changes touch none of it.

        None where the robot is not on it, or some of it is blocked or became dearer.

        Args:
            priced: flat cells whose terrain became dearer.
        """
        if self._route is None or not self._policy.keep_paths:
            return None
        at = np.flatnonzero(self._route == self._start)
        if len(at) == 0:
            return None
        rest = self._route[at[0] :]
        if len(priced) and np.isin(rest, priced).any():
            return None
        return rest if self._tree.is_allowed(rest) else None

    def _update(self, touched: IntArray, priced: IntArray, begin: float) -> _Work:
        """Bring the tree up to date with the start and the changes: by a repair, or by making it anew."""
        distance = self._tree.estimate(self._start, self._goal)
        changed = len(touched) + len(priced)
        work = _Work(begin, distance, self._anew or self._policy.plans_anew(changed, distance))
        self._anew = True  # should anything break off in between
        if not work.anew:
            self._tree.move_start(self._start)
            if changed:
                repaired = self._tree.repair(touched, priced, self._policy.cut_limit(distance))
                if repaired is None:
                    work.anew = True
                else:
                    work.expansions, work.pushes = repaired
        if work.anew:
            work.pushes += self._tree.initialize(self._start)
        return work

    def _search(self, work: _Work, severed: bool) -> bool:
        """Search within the policy's budget; return whether the tree has the answer.

        Args:
            work: what was done so far; added to.
            severed: whether there was no path last time.
        """
        tree, policy = self._tree, self._policy
        budget = policy.search_budget(work.distance, anew=work.anew, severed=severed)
        searched, look = 0, min(policy.first_look, budget)
        while True:
            expansions, pushes = tree.compute_shortest_path(look)
            searched += expansions
            work.pushes += pushes
            ended = tree.is_final()
            if ended or searched >= budget:
                break
            # A robot shut in a pocket would have all that is open to the goal searched to its end.
            ended = not tree.is_reached() and tree.is_enclosed(look // policy.pocket)
            if ended:
                break
            look = min(2 * look, budget - searched)
        self._touched, self._priced = [], []
        self._eased = self._anew = False
        work.searched = searched
        work.expansions += searched
        policy.note_search(searched, work.distance, anew=work.anew, ended=ended)
        return ended

    def _answer(self, work: _Work) -> Path:
        """Return the path that the tree holds."""
        if not self._tree.is_reached():
            self._shut_in = self._start
            raise self._unconnected()
        self._route = self._tree.path()
        if work.anew:
            self._policy.note_path(work.searched, work.distance, len(self._route))
        seconds = time.perf_counter() - work.begin
        return make_path(self._now(), self._route, expansions=work.expansions, pushes=work.pushes, seconds=seconds)

    def _answer_of_astar(self, work: _Work) -> Path:
        """Return the path that a forward A* finds; the tree stays as it is, and the next search goes on from there."""
        try:
            path = astar(self._now(), self._index(self._start), self._index(self._goal))
        except NoPath:
            self._shut_in = self._start
            raise self._unconnected() from None
        self._policy.note_astar(path.expansions, work.distance)
        self._route = self._base.index_to_flat(path.cells)
        return replace(
            path,
            expansions=work.expansions + path.expansions,
            pushes=work.pushes + path.pushes,
            seconds=time.perf_counter() - work.begin,
        )

    def _unconnected(self) -> NoPath:
        return NoPath("not connected", f"nothing leads from {self._name(self._start)} to {self._name(self._goal)}")

    def _now(self) -> LatticeGraph:
        """Return the graph as it is now, without copies."""
        return self._base._derived(self._free, self._terrain if len(self._terrain) else None)

    def _index(self, flat: int) -> IntArray:
        return self._tree.position(flat) + self._base.low

    def _name(self, flat: int) -> tuple[int, ...]:
        return tuple(self._index(flat).tolist())

    def __repr__(self) -> str:
        """Show the ends and the graph."""
        return f"<Replanner from {self._name(self._start)} to {self._name(self._goal)} in {self._base!r}>"


@dataclass
class _Work:
    """What answering took so far.

    Attributes:
        begin: when, in seconds of the performance counter.
        distance: from the start to the goal at least, in the tree's units.
        anew: whether the tree was made anew.
        expansions: cells cut off or expanded.
        pushes: entries made in the queue.
        searched: cells expanded by the search from the goal.
    """

    begin: float
    distance: int
    anew: bool
    expansions: int = 0
    pushes: int = 0
    searched: int = 0


def _last_of_each(flat: IntArray) -> tuple[IntArray, IntArray]:
    """Return each flat cell once, and where it comes last."""
    cells, back = np.unique(flat[::-1], return_index=True)
    return cells, len(flat) - 1 - back
