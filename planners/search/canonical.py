"""Canonical search with jumping on any lattice and neighbourhood: of equally short paths one is enough.

Many shortest paths differ only in the order of their moves. :mod:`planners.search.canonical_order` derives from
the moves, their lengths and what they sweep which pairs of moves can be left out, so that about
one path to each cell is followed; :func:`canonical` is A* over what remains.

**Why it is exact.** Order paths of equal cost by their number of moves, then lexicographically by
their moves' ranks, and let P be the least of all cheapest paths from the start to the goal. (1) Each
prefix of P is the least one to its last cell, for a better one would improve P. (2) No two
consecutive moves (d, e) of P have a legal alternative, for that would improve P as well. Hence, by
induction along P, each cell of P is reached at its least cost by the very move d of P, and the next
move e is among those tried: it is natural after d, or forced as all alternatives are blocked. The
argument needs every direction of arrival at the least cost, so that they are kept as a set of bits
for each cell; a cell that was expanded before one of them was known is expanded again for that one,
unless nothing new can follow. It needs exact sums too: lengths are rounded to integers of which any
sum along a path is exact. Nothing in it depends on the order of the moves, which only decides how
much is left out, nor on the lattice.

**Jumping.** Natural pairs of different moves ascend in rank, as (e, d) leads wherever (d, e) does.
Hence some moves are followed by themselves alone in open space (level 0: the odd directions of A2-6,
the straight ones of Z2-8 and Z3-26). Along such a line no other move need be tried until one is
forced or the goal is met, so that only the cells where that happens are entered in the queue.
Looking along lines of level 0 from each cell of a line of level 1, as jump point search on squares
does, was measured too: up to three times fewer entries in rooms and corridors, but in no less time,
up to twice the time among random obstacles and ten times in open space of three dimensions.
In the plane, orderings of three levels (A2-12, Z2-16) still enter a large part of all cells, and
looking along a line from each took 1.5 to 7 times as long as the ordering alone: they have no lines.

**Which end first.** Levels of opposite moves differ (on A2-6, opposite directions are even and odd), and
a path is found with the fewest entries where it runs mostly along moves of low level. Moves can be
taken back, so that the search starts from the goal where that is so for the opposite direction.

Sources: Harabor and Grastien, "Online graph pruning for pathfinding on grid maps" (2011), for jump
points on squares; Sturtevant and Rabin, "Canonical orderings on grids" (2016). For hexagons, FCC and
BCC nothing was found published.
"""

from __future__ import annotations

import itertools
import time
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import IntArray
from hexmap.base.errors import ArgumentError
from hexmap.base.sparse_arrays import sparse_zeros
from hexmap.lattice import window
from planners.path import NoPath, Path, cells_to_flat, make_path
from planners.search.canonical_order import canonical_ordering
from planners.search.heuristics import gauge_planes
from planners.search.offsets import offset_vectors

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph
    from planners.search._canonical_kernels import Estimates, Rules

__all__ = ["Found", "canonical", "search_flat"]

_KEY_BITS = 32  # of the queue's keys, to the cheapest move
# Of the lengths, to the shortest: sums are exact for 2^14 moves with the first, 2^18 with the second.
_LENGTH_BITS = (36, 32, 28, 24, 20, 16)
_MOST_MOVES = 61  # a bit each, one for the start, and a sign
_LONGEST = 128  # steps of a jump: in the open a longer look ahead costs more than what it saves
_MOST_LEVEL_IN_PLANE = 1  # with lines
_HIGHEST = 7  # level that breaks ties in eighths of a unit


class _Prepared(NamedTuple):
    """What searches on windows of the same shape share.

    Attributes:
        lengths: (K,) float64 integers.
        planes: (F, n) facets of the gauge in these units.
        heuristic_steps: (K + 1, F) products of the moves with the planes, the last row zero.
        rules: the ordering with flat offsets, as the kernels take it.
        longest: steps along a line, 1 where there are to be none.
        towards: (K, n), of which the product with an index offset is largest for the move nearest in direction.
        higher: (K,) whether a move's level is above that of the opposite move.
    """

    lengths: NDArray[np.float64]
    planes: NDArray[np.float64]
    heuristic_steps: NDArray[np.float64]
    rules: Rules
    longest: int
    towards: NDArray[np.float64]
    higher: NDArray[np.bool_]


class Found(NamedTuple):
    """The flat cells of a path (None: nothing leads there) and what finding it took.

    Attributes:
        flat: (M,) int64 from the start to the goal, or None.
        expansions: cells whose moves were tried.
        pushes: entries made in the queue.
        scanned: cells looked at along lines.
        tried: moves tried.
    """

    flat: NDArray[np.int64] | None
    expansions: int
    pushes: int
    scanned: int
    tried: int


def canonical(
    graph: LatticeGraph,
    start: ArrayLike,
    goal: ArrayLike,
    *,
    jump: bool = True,
    clearance: NDArray[np.float64] | None = None,
) -> Path:
    """Return a shortest path by A* that tries only canonical moves and jumps along lines.

    The cost is that of :func:`planners.astar`; where there are several shortest paths the two may
    return different ones. Fewer cells enter the queue, most so in open space, rooms and corridors
    of the plane, where it is several times as fast. Among dense random obstacles there is little to
    leave out, and in space A* with its ties to the larger g enters little anyway: there A* is as fast
    or faster. All intermediate cells of the path are filled in; ``scanned`` counts those looked at in jumps.

    Args:
        graph: where to go; without terrain, as two orders of the same moves must cost the same.
        start: a cell's index (n,).
        goal: a cell's index (n,).
        jump: false for the canonical ordering alone, every cell entered in the queue. In the plane orderings
            of three levels and more (A2-12) never jump: lines cost more there than they save.
        clearance: (size,) metres, of which the path's least is reported.

    Raises:
        NoPath: an end is blocked or outside the map, or nothing connects them.
        ArgumentError: the graph has terrain or more than 61 moves, or more than one cell is given.

    Examples:
        >>> import numpy as np
        >>> from hexmap.graph import LatticeGraph
        >>> from hexmap.lattice import Lattice
        >>> from planners import canonical
        >>> graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((9, 9), np.uint8), neighbourhood=8)
        >>> path = canonical(graph, [0, 0], [8, 3])
        >>> round(path.cost, 6), len(path)
        (9.242641, 9)
    """
    if graph.terrain is not None:
        raise ArgumentError("canonical search takes no terrain: the order of moves would change what they cost")
    if len(graph.moves) > _MOST_MOVES:
        raise ArgumentError(f"canonical search takes at most {_MOST_MOVES} moves, not {len(graph.moves)}")
    ends = []
    for cell, role in ((start, "start"), (goal, "goal")):
        found = cells_to_flat(graph, cell, role)
        if len(found) != 1:
            raise ArgumentError(f"canonical search goes between two cells, not {len(found)} as the {role}")
        ends.append(int(found[0]))
    begin = time.perf_counter()
    labels = graph.known_components
    if ends[0] == ends[1]:
        result = Found(np.array(ends[:1]), 0, 0, 0, 0)
    elif labels is not None and labels[ends[0]] != labels[ends[1]]:
        result = Found(None, 0, 0, 0, 0)  # the components are known already
    else:
        result = search_flat(graph, ends[0], ends[1], jump=jump)
    seconds = time.perf_counter() - begin
    if result.flat is None:
        a, b = (tuple(np.ravel(cell).tolist()) for cell in (start, goal))
        raise NoPath("not connected", f"nothing leads from {a} to {b}")
    return make_path(
        graph,
        result.flat,
        clearance=clearance,
        expansions=result.expansions,
        pushes=result.pushes,
        scanned=result.scanned,
        seconds=seconds,
    )


def search_flat(graph: LatticeGraph, start: int, goal: int, *, jump: bool = True) -> Found:
    """Search between two different flat cells; a ``goal`` of -1 is never met, and everything is searched.

    Starts and goals are not checked: :func:`canonical` does.
    """
    from planners.search import _canonical_kernels as kernels

    passable = kernels.Passable(graph.free, graph.offsets, graph.swept_starts, graph.swept)
    record = np.int32 if len(graph.moves) <= 30 else np.int64
    records = sparse_zeros(graph.size, [("g", np.float64), ("seen", record), ("waiting", record)])
    positions = graph.flat_to_index(np.array([start, max(goal, 0)])) - graph.low
    # With fewer bits a length where the sums of a very long path were not exact.
    for bits in (0,) if graph.equal_edges else _LENGTH_BITS:
        prepared = _prepare(graph, bits)
        # From the goal where the moves towards the start have the lower level.
        nearest_move = int(np.argmax(prepared.towards @ (positions[1] - positions[0])))
        reverse = goal >= 0 and bool(prepared.higher[nearest_move])
        first, last, target = (goal, start, positions[0]) if reverse else (start, goal, positions[1])
        reached = kernels.Reached(sparse_zeros(graph.size, np.uint8), records)
        cost, *counts = kernels.search(
            passable,
            prepared.lengths,
            prepared.rules,
            _estimates(graph, prepared, target, goal >= 0),
            first,
            last,
            2.0 ** (_KEY_BITS - bits),
            min(_LONGEST if jump else 1, prepared.longest),
            reached,
        )
        if cost != kernels.OVERFLOW:
            break
    if not np.isfinite(cost):
        return Found(None, *counts)
    flat = kernels.follow(graph.offsets, prepared.lengths, first, last, reached)
    return Found(np.ascontiguousarray(flat if reverse else flat[::-1]), *counts)


def _estimates(graph: LatticeGraph, prepared: _Prepared, target: IntArray, directed: bool) -> Estimates:
    """Return the heuristic to a target in window coordinates (n,); none for a search that is not directed."""
    from planners.search import _canonical_kernels as kernels

    planes, steps = prepared.planes, prepared.heuristic_steps
    if not directed:
        planes, steps = planes[:0], np.ascontiguousarray(steps[:, :0])
    target = np.ascontiguousarray(target, dtype=np.int64)
    return kernels.Estimates(planes, steps, target, graph.strides, 1.0 / graph.strides)


def _prepare(graph: LatticeGraph, bits: int) -> _Prepared:
    """Return what searches share whose lengths have so many bits more than the shortest."""
    fields = (graph.moves, graph.lengths, graph.swept, graph.swept_starts, graph.pad, graph.shape, graph.lattice.basis)
    return _prepared(*(field.tobytes() for field in fields), bits)


@lru_cache(maxsize=128)
def _prepared(
    moves: bytes, metres: bytes, swept: bytes, swept_starts: bytes, pad: bytes, shape: bytes, basis: bytes, bits: int
) -> _Prepared:
    """Return what searches share, by the bytes of a graph's arrays: once for all windows of the same shape."""
    from planners.search import _canonical_kernels as kernels

    padding, size = np.frombuffer(pad, np.int64), np.frombuffer(shape, np.int64)
    n = len(size)
    v = np.frombuffer(moves, np.int64).reshape(-1, n)
    strides = window.strides(size)
    metre_lengths = np.frombuffer(metres)
    lengths = np.rint(metre_lengths / metre_lengths.min() * 2.0**bits)
    swept_vectors = offset_vectors(np.frombuffer(swept, np.int64), padding, size, strides)
    cells = [tuple(cell) for cell in swept_vectors.tolist()]
    ends = np.frombuffer(swept_starts, np.int64).tolist()
    sweeps = tuple(tuple(cells[a:b]) for a, b in itertools.pairwise(ends))
    ordering = canonical_ordering(v, lengths.astype(np.int64), sweeps)
    planes = gauge_planes(v, lengths)
    heuristic_steps = np.zeros((len(v) + 1, len(planes)))
    heuristic_steps[:-1] = v @ planes.T
    # Copies: read-only arrays would compile the kernels a second time.
    natural, level, *tables = (
        np.array(table, dtype=np.int64)
        for table in (
            ordering.natural,
            np.minimum(ordering.level, _HIGHEST),
            ordering.guard_starts,
            ordering.guards @ strides,
            ordering.pair_starts,
            ordering.seconds,
            ordering.alternative_starts,
            ordering.cell_starts,
            ordering.cells @ strides,
        )
    )
    straight = all(int(ordering.natural[k]) >> k & 1 for k in range(len(v)))
    lines = straight and (n == 3 or int(ordering.level.max()) <= _MOST_LEVEL_IN_PLANE)
    B = np.frombuffer(basis).reshape(n, n)
    number = {tuple(move): k for k, move in enumerate(v.tolist())}
    opposite = [number.get(tuple(-x for x in move), k) for k, move in enumerate(v.tolist())]
    return _Prepared(
        lengths,
        np.array(planes),
        heuristic_steps,
        kernels.Rules(natural, level, kernels.Pairs(*tables)),
        _LONGEST if lines else 1,
        (v @ B.T / metre_lengths[:, None]) @ B,
        ordering.level > ordering.level[opposite],
    )
