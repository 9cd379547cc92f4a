"""Any-angle paths on any lattice: lazy Theta* with an exact line of sight, and making its paths taut."""

from __future__ import annotations

import itertools
import math
import time
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import IntArray
from hexmap.base.errors import ArgumentError
from hexmap.base.sparse_arrays import sparse_zeros
from hexmap.lattice.lattice import Lattice
from planners.path import NoPath, Path, cells_to_flat, clearances, make_path, measure, not_connected
from planners.search.astar import MOST_MOVES, astar

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph
    from planners.any_angle._kernels import View
    from planners.any_angle._theta_kernels import Query

__all__ = ["any_angle", "line_of_sight"]

_KEY_STEPS = 2.0**32  # keys of the queue a shortest move
_AT_FIRST = 1024  # expansions, a millisecond: A* is not asked how many it takes before
_WEIGHTS = (1.003, 1.01, 1.03)  # of the straight distance, one after the other
_SHARE = 0.25  # of A*'s expansions, that a search may take with each of them but the last
_CORNERS = 2000  # turning cells up to which sliding them by two steps takes little of the whole time
_NO_LIMIT = 2**62
_FIRST_QUEUE = 1024  # entries that fit at first
_ROUNDS = 20  # of making a path taut; three or four are the rule
_WINDOW = 8  # turning cells that a straight line may leave out, plus one
_TOUCH = 2e-9  # of the cell's width: the tolerance of hexmap.graph.swept_cells


@lru_cache(maxsize=64)
def _generators(lattice: Lattice) -> NDArray[np.float64]:
    """Return the edges (E, n) of the lattice's cell, one of each direction, in index coordinates."""
    cell = lattice.cell
    edges = np.concatenate([np.roll(cell.vertices[ring], -1, axis=0) - cell.vertices[ring] for ring in cell.rings])
    unit = lattice.resolution
    found: list[NDArray[np.float64]] = []
    for edge in edges:
        # Parallel edges are equally long.
        if np.linalg.norm(edge) > 1e-10 * unit and not any(
            min(np.linalg.norm(edge - z), np.linalg.norm(edge + z)) < 1e-8 * unit for z in found
        ):
            found.append(edge)
    return np.ascontiguousarray(np.linalg.solve(lattice.basis, np.array(found).T).T)


def make_view(graph: LatticeGraph) -> View:
    """Return the tables of a graph."""
    from planners.any_angle._kernels import View

    lattice = graph.lattice
    generators = _generators(lattice)
    reach = 0.5 * np.abs(generators).sum(axis=0)
    basis = np.ascontiguousarray(lattice.basis, dtype=np.float64).copy()
    blocks = -(-graph.shape // 4)
    block_strides = np.array([math.prod(blocks[i + 1 :].tolist()) for i in range(lattice.dim)], dtype=np.int64)
    return View(
        np.ascontiguousarray(graph.strides),
        np.ascontiguousarray(graph.shape),
        block_strides,
        basis,
        np.ascontiguousarray(basis.T @ basis),
        generators,
        reach,
        lattice.inradius**2,
        _TOUCH,
        bool((np.floor(reach + 1e-6) > graph.pad).any()),
        np.empty((2, len(generators))),
    )


def line_of_sight(graph: LatticeGraph, a: ArrayLike, b: ArrayLike) -> bool | NDArray[np.bool_]:
    """Tell whether the straight line between the centres of two cells is free.

    It is where every cell is free whose closed Voronoi cell meets the line (to 1e-9 of a cell), the
    sentence of the graph's corner rule: a line through a corner of a blocked cell, along its face or
    between two blocked cells that meet in a corner is not free. Cells outside the window are not free.

    Args:
        graph: whose cells may be free.
        a: a cell's index (n,), or many (M, n).
        b: the other ends, as many, or one for all.

    Returns:
        bool, or (M,) bool where ``a`` or ``b`` are many.

    Raises:
        ArgumentError: not integers of that shape.

    Examples:
        >>> import numpy as np
        >>> from hexmap.graph import LatticeGraph
        >>> from hexmap.lattice import Lattice
        >>> from planners import line_of_sight
        >>> graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.array([[1, 1, 1], [1, 0, 1]], np.uint8))
        >>> line_of_sight(graph, [0, 0], [[0, 2], [1, 0], [1, 2]]).tolist()
        [True, True, False]
    """
    starts, ends = np.asarray(a), np.asarray(b)
    n = graph.lattice.dim
    for cells in (starts, ends):
        if cells.dtype.kind not in "iu" or cells.ndim not in (1, 2) or cells.shape[-1] != n:
            raise ArgumentError(
                f"a line of sight joins cells ({n},) or (M, {n}) of integers, not {cells.dtype} {cells.shape}"
            )
    if starts.ndim == ends.ndim == 2 and len(starts) != len(ends):
        raise ArgumentError(f"lines of sight need as many ends as starts, not {len(starts)} and {len(ends)}")
    from planners.any_angle import _kernels as kernels

    many = starts.ndim == 2 or ends.ndim == 2
    pairs = np.broadcast_arrays(np.atleast_2d(starts), np.atleast_2d(ends))
    inside = (graph.index_to_flat(pairs[0]) >= 0) & (graph.index_to_flat(pairs[1]) >= 0)
    places = [np.ascontiguousarray(p.astype(np.int64) - graph.low) for p in pairs]
    out = np.zeros(len(inside), np.bool_)
    kernels.sights(make_view(graph), graph.free, np.empty(0, np.uint8), places[0], places[1], inside, out)
    return out if many else bool(out[0])


def any_angle(
    graph: LatticeGraph,
    start: ArrayLike,
    goal: ArrayLike,
    *,
    clearance: NDArray[np.float64] | None = None,
    lazy: bool = True,
    tighten: bool = True,
) -> Path:
    """Return a short path of straight lines at any angle from ``start`` to ``goal``.

    Lazy Theta* (Nash, Koenig and Tovey, 2010, "Lazy Theta*: Any-Angle Path Planning and Path Length Analysis in
    3D") over the graph's moves with :func:`line_of_sight`. Other than there, a cell whose parent does
    not see it also tries its neighbours' parents, goes back into the queue, and is expanded again where a
    shorter way to it turns up; so the path is never longer than A*'s on the same graph. A search that has expanded as
    many cells as A* does, which is found by running it, goes on with a weight of up to 1.03 on the straight
    distance, as in sparse fields hardly any cell is much worse than the best; A*'s path stands in for a longer
    one. The path is then made taut: turning cells are left out, moved by a step or two and cut off, as long as
    that shortens.

    The path is not the shortest one of its kind in general; where obstacles lie on both sides the
    planner may pass them on the wrong one. Turning points are centres of cells, as far from walls as
    these are: on coarse cells that alone makes it longer than that of a point.

    Args:
        graph: where to go, without terrain.
        start: a cell's index (n,).
        goal: a cell's index (n,).
        clearance: (size,) metres, of which the least of all cells that the path touches is reported.
        lazy: look along a line when its end is expanded, not when it is reached. Fewer lines are
            looked along (Theta*, Nash and others, 2007, is the other one); lengths hardly differ.
        tighten: make the path taut.

    Returns:
        the path; its ``cells`` are the start, the turning cells and the goal, each of which sees the next,
            and its ``bound`` is its length over the straight distance; nothing closer is known.

    Raises:
        NoPath: an end is blocked or outside the map, or nothing connects them.
        ArgumentError: the graph has terrain, or an end is not one cell.

    Examples:
        >>> import numpy as np
        >>> from hexmap.graph import LatticeGraph
        >>> from hexmap.lattice import Lattice
        >>> from planners import any_angle
        >>> graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((4, 5), np.uint8))
        >>> any_angle(graph, [0, 0], [3, 4]).length
        5.0
    """
    if graph.terrain is not None:
        raise ArgumentError("an any-angle path takes no terrain: its straight lines are compared by their length alone")
    for role, cell in (("start", start), ("goal", goal)):
        if np.ndim(cell) != 1:
            raise ArgumentError(
                f"an any-angle path has one {role}, a cell ({graph.lattice.dim},), not {np.shape(cell)}"
            )
    source = cells_to_flat(graph, start, "start")
    target = cells_to_flat(graph, goal, "goal")
    begin = time.perf_counter()
    if source[0] == target[0]:
        return make_path(graph, source, clearance=clearance, seconds=time.perf_counter() - begin)
    labels = graph.known_components
    if labels is not None and labels[source[0]] != labels[target[0]]:
        raise not_connected(start, goal)
    turning_cells, effort = search_path(graph, int(source[0]), int(target[0]), lazy=lazy, tighten=tighten)
    if len(turning_cells) == 0:
        raise not_connected(start, goal)
    seconds = time.perf_counter() - begin
    cells = graph.flat_to_index(turning_cells)
    points = np.ascontiguousarray(graph.lattice.centres(cells), dtype=np.float64)
    length, turning = measure(points)
    least = None
    if clearance is not None:
        along = [touched_cells(graph, a, b) for a, b in itertools.pairwise(turning_cells)]
        least = float(clearances(graph, clearance)[np.concatenate(along)].min())
    bound = max(length / float(np.linalg.norm(points[-1] - points[0])), 1.0)
    return Path(
        cells, points, length, length, turning, least,
        effort.expansions, effort.pushes, effort.scanned, seconds, bound,
    )  # fmt: skip


class Effort(NamedTuple):
    """What a search took: expansions, entries made in the queue, lines looked along, cells looked at on them."""

    expansions: int
    pushes: int
    lines: int
    scanned: int


def search_path(
    graph: LatticeGraph, source: int, target: int, *, lazy: bool = True, tighten: bool = True
) -> tuple[IntArray, Effort]:
    """Return the flat turning cells (M,) from ``source`` to ``target``, none without a path, and what it took."""
    from planners.any_angle import _theta_kernels as theta

    view = make_view(graph)
    counts = np.zeros(len(Effort._fields), np.int64)
    scale = _KEY_STEPS / float(graph.lengths.min())
    glance = bool(np.isin(graph.lattice.faces @ graph.strides, graph.offsets).all())
    limit = _AT_FIRST if len(graph.moves) <= MOST_MOVES else _NO_LIMIT
    path = _search(graph, view, theta.Query(source, target, scale, 1.0, lazy, glance, limit), counts)
    if tighten and len(path):
        path = tightened(graph, view, path, counts)
    return path, Effort(*counts.tolist())


def tightened(graph: LatticeGraph, view: View, path: IntArray, counts: IntArray) -> IntArray:
    """Return flat turning cells (M,), each of which sees the next, made taut; ``counts`` as of :class:`Effort`."""
    from planners.any_angle import _kernels as kernels

    near = np.unique(np.concatenate([graph.offsets, graph.lattice.faces @ graph.strides]))
    if len(path) <= _CORNERS:
        # Two steps away as well: over a cell that one step leads onto, which may be no better.
        near = np.unique(np.concatenate([near, (near[:, None] + near).ravel()]))
    return kernels.tighten(view, graph.free, path, near, _ROUNDS, _WINDOW, counts)


def _search(graph: LatticeGraph, view: View, query: Query, counts: IntArray) -> IntArray:
    """Return the flat turning cells (M,) of a path before it is made taut, none where there is no path.

    A search that has expanded as many cells as A* does from the same start goes on with a weight, which grows the
    longer it takes.
    """
    from planners.any_angle import _kernels as kernels
    from planners.any_angle import _theta_kernels as theta

    steps = np.ascontiguousarray(graph.moves @ graph.lattice.basis.T)
    shifts = np.ascontiguousarray(graph.moves, dtype=np.int64)
    moves = theta.Moves(graph.offsets, graph.lengths, steps, shifts, graph.swept_starts, graph.swept)
    # Pages that a short search does not touch cost nothing.
    tree = sparse_zeros(graph.size, theta.TREE)
    queue = theta.Queue(
        np.empty(_FIRST_QUEUE), np.empty(_FIRST_QUEUE), np.empty(_FIRST_QUEUE, np.int64), np.zeros(1, np.int64)
    )
    distances = np.empty(0, np.uint8)
    moved: Path | None = None
    theta.begin(view, query, tree, queue, counts)
    while True:
        status = theta.search(view, graph.free, distances, moves, query, tree, queue, counts)
        if status == theta.QUEUE_FULL:
            key, cost, node = (np.concatenate([array, np.empty_like(array)]) for array in queue[:3])
            queue = theta.Queue(key, cost, node, queue.count)
        elif status == theta.BLOCKS_WANTED:
            distances = kernels.block_distances(view, graph.free)
        elif status != theta.LIMIT:
            break
        elif moved is None:
            try:
                moved = astar(graph, *graph.flat_to_index(np.array([query.start, query.goal])))
            except NoPath:
                break
            query = query._replace(limit=max(moved.expansions, _AT_FIRST))
        else:
            stage = 1 if query.weight == 1.0 else _WEIGHTS.index(query.weight) + 2
            share = 1.0 + _SHARE * stage if stage < len(_WEIGHTS) else math.inf
            most = int(share * max(moved.expansions, _AT_FIRST)) if share < math.inf else _NO_LIMIT
            query = query._replace(weight=_WEIGHTS[stage - 1], limit=most)
            theta.weigh(view, query, tree, queue)
    if status != theta.FOUND:
        return np.empty(0, np.int64)
    # With a weight the path may be longer than that of moves, by more than sums of many lengths are off.
    if moved is not None and query.weight > 1.0 and moved.cost < float(tree[query.goal]["g"]) * (1.0 - 1e-9):
        return cells_to_flat(graph, moved.cells, "cell of the path")
    return np.asarray(theta.follow(tree, query.goal))


def touched_cells(graph: LatticeGraph, a: int, b: int) -> IntArray:
    """Return the flat cells (M,) touched by the straight line between the flat cells ``a`` and ``b``, which is free."""
    from planners.any_angle import _kernels as kernels

    return kernels.touched(make_view(graph), graph.free, a, b)
