"""Numba kernels of lazy Theta* on any lattice, over the line of sight of :mod:`planners.any_angle._kernels`."""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from planners.any_angle._kernels import (
    BETTER,
    EXPANSIONS,
    LINES,
    PUSHES,
    SCANNED,
    Cells,
    empty_segment,
    sees,
    span,
)
from planners.any_angle._wedge_kernels import WEDGE, sees_by_wedge
from planners.search._shared_kernels import drop_top, rise

# What is known of a cell that Theta* has reached; WEDGE, 16, is the wedges' own.
SEEN = np.uint8(1)  # has a g, perhaps by a parent that does not see it
SURE = np.uint8(2)  # its parent is known to see it
DONE = np.uint8(4)  # expanded with its present g
EXPANDED = np.uint8(8)  # expanded once: its g never rises

# Why a search stops.
NO_PATH, FOUND, QUEUE_FULL, BLOCKS_WANTED, LIMIT = range(5)

GLANCE = 15  # of so many expansions and one more, one looks along the line to the goal


class Moves(NamedTuple):
    """The moves of a graph.

    Attributes:
        offsets: (K,) int64 flat offsets.
        lengths: (K,) float64, metres.
        steps: (K, n) float64, metres along each axis.
        shifts: (K, n) int64, the same along each index.
        swept_starts: (K + 1,) where the cells that a move sweeps begin.
        swept: (S,) flat offsets of those cells.
    """

    offsets: NDArray[np.int64]
    lengths: NDArray[np.float64]
    steps: NDArray[np.float64]
    shifts: NDArray[np.int64]
    swept_starts: NDArray[np.int64]
    swept: NDArray[np.int64]


# What a search knows of a cell; all but the mark are read only where a bit of it says so. One record a cell: what
# belongs together is fetched together, and one array has fewer references to count than six.
TREE = np.dtype(
    [
        ("g", np.float64),  # length of the path to the cell, metres
        ("low", np.float64),  # least slope of the wedge in which the parent sees the cell, where WEDGE is set
        ("high", np.float64),  # the greatest
        ("parent", np.int32),  # the flat cell from which a straight line leads to it
        ("refused", np.int32),  # the last cell that was found not to see it, plus one
        ("blocker", np.int32),  # a blocked cell, plus one, that hides it from that, where one is known
        ("mark", np.uint8),  # the bits SEEN, SURE, DONE, EXPANDED and WEDGE; zero before a search
    ],
    align=True,
)


class Queue(NamedTuple):
    """The open cells: a heap by f.

    Attributes:
        key: (N,) float64 f in steps of the key.
        cost: (N,) float64 the g with which a cell was entered.
        node: (N,) int64 flat cells.
        count: (1,) int64 entries in use.
    """

    key: NDArray[np.float64]
    cost: NDArray[np.float64]
    node: NDArray[np.int64]
    count: NDArray[np.int64]


class Query(NamedTuple):
    """What is searched for.

    Attributes:
        start: flat cell.
        goal: flat cell.
        scale: keys a metre.
        weight: of the straight distance to the goal in f.
        lazy: whether lines are looked along late.
        glance: whether a free line is reason enough that moves lead along it: those across the faces do.
        limit: expansions after which the search stops.
    """

    start: int
    goal: int
    scale: float
    weight: float
    lazy: bool
    glance: bool
    limit: int


@njit(cache=True, nogil=True)
def begin(view, query, tree, queue, counts):
    """Enter the start of a search."""
    segment = empty_segment(view.strides.shape[0])
    start = query.start
    tree[start]["g"] = 0.0
    tree[start]["parent"] = start
    tree[start]["mark"] = SEEN | SURE
    away = span(view.strides, view.basis, start, query.goal, segment.at, segment.v)
    queue.key[0] = np.floor(query.weight * away * query.scale + 0.5)
    queue.cost[0] = 0.0
    queue.node[0] = start
    queue.count[0] = 1
    counts[PUSHES] = 1


@njit(cache=True, nogil=True)
def weigh(view, query, tree, queue):
    """Order the queue anew by the weight of the query; entries out of date are left out."""
    segment = empty_segment(view.strides.shape[0])
    count = 0
    for i in range(queue.count[0]):
        a = queue.node[i]
        entered = queue.cost[i]
        if entered != tree[a]["g"] or (tree[a]["mark"] & DONE) != 0:
            continue
        away = span(view.strides, view.basis, a, query.goal, segment.at, segment.v)
        f = np.floor((entered + query.weight * away) * query.scale + 0.5)
        # At most as many entries as have been read: none is overwritten.
        rise(queue.key, queue.cost, queue.node, count, f, entered, a)
        count += 1
    queue.count[0] = count


@njit(cache=True, nogil=True)
def search(view, free, distances, moves, query, tree, queue, counts):
    """Go on with a search by Theta* after :func:`begin`; the path is written in ``tree``.

    A cell is reached from its neighbour's parent if that sees it, else from the neighbour (Nash and
    others, 2007); whether it does is looked up when the cell is expanded (lazily; Nash, Koenig and
    Tovey, 2010). A cell that has been expanded is only ever reached anew by a line that is free, and
    then expanded again. So g of expanded cells never rises, every neighbour of an expanded cell has
    an entry of at most g + the move, and the argument for A* holds: with a weight of one the path is at most
    as long as the shortest one of moves.

    The caller makes arrays longer: in a loop that could replace an array Numba counts references at each turn.

    Args:
        view: the lattice and the window.
        free: (size,) the graph's cells.
        distances: see :class:`planners.any_angle._kernels.Cells`.
        moves: the graph's moves.
        query: Query.
        tree: (size,) of TREE; it is written.
        queue: Queue, the same.
        counts: (4,) int64, zero at first: expansions, pushes, lines of sight, cells looked at on them.

    Returns:
        NO_PATH, FOUND; or QUEUE_FULL, BLOCKS_WANTED, LIMIT, after which the search can go on.
    """
    strides, shape, basis, gram = view.strides, view.shape, view.basis, view.gram
    generators, reach, touch = view.generators, view.reach, view.touch
    offsets, lengths, steps, shifts, swept_starts, swept = moves
    key, cost, node, entries = queue
    _, goal, scale, weight, lazy, glance, limit = query
    n = strides.shape[0]
    cells = Cells(free, distances, np.empty(0, np.float64))
    segment = empty_segment(n)
    # Positions of the cell that is expanded, its parent and the goal, and the displacement from the parent.
    here, there, last = np.empty(n, np.int64), np.empty(n, np.int64), np.empty(n, np.int64)
    v = np.empty(n, np.int64)
    inverse = 1.0 / strides
    known = np.int64(-1)
    rest = np.int64(goal)
    for i in range(n):
        last[i] = rest // strides[i]
        rest -= last[i] * strides[i]
    ahead, behind = np.empty(n, np.float64), np.empty(n, np.float64)
    tried = np.empty(offsets.shape[0] + 1, np.int64)
    room = key.shape[0] - offsets.shape[0] - 1
    # Making them takes as long as this many looks; in the plane wedges leave few lines that they shorten.
    worth = free.shape[0] << 2 if n == 2 else free.shape[0] >> 2
    if distances.shape[0] > 0:
        worth = np.int64(2**62)
    count = entries[0]
    pushes, expansions = counts[PUSHES], counts[EXPANSIONS]
    status = NO_PATH
    while count > 0:
        # An expansion enters each neighbour once at the most, so that room need not be asked for there.
        if count > room:
            status = QUEUE_FULL
            break
        # Worth making once as many cells have been looked at as it takes.
        if counts[SCANNED] > worth:
            status = BLOCKS_WANTED
            break
        if expansions >= limit:
            status = LIMIT
            break
        a = node[0]
        entered = cost[0]
        count = drop_top(key, cost, node, count)
        # Cells are entered again where they are reached anew; only the entry with the present g counts.
        if entered != tree[a]["g"] or (tree[a]["mark"] & DONE) != 0:
            continue

        # Exact, as half a cell is far more than the error of a product below 2^31; a division takes longer.
        rest = a
        for i in range(n):
            here[i] = np.int64((rest + 0.5) * inverse[i])
            rest -= here[i] * strides[i]
        # Before a cell is expanded its parent must see it (SetVertex of the paper). With another parent g may have
        # grown; then the cell waits for its turn in the queue.
        p = np.int64(tree[a]["parent"])
        if (tree[a]["mark"] & SURE) == 0:
            tree[a]["mark"] |= SURE
            seen = False
            if n == 2:
                if p != known:
                    known = p
                    there[0] = np.int64((p + 0.5) * inverse[0])
                    there[1] = p - there[0] * strides[0]
                v[0] = here[0] - there[0]
                v[1] = here[1] - there[1]
                looked = sees_by_wedge(
                    free, strides, shape, generators, gram, reach, touch, there, v, a, p, offsets, shifts, tree
                )
                counts[SCANNED] += abs(looked)
                counts[LINES] += 1
                seen = looked > 0
            # From the far end: the parent has seen a neighbour, so that what hides this cell is near to it.
            if not seen and np.int64(tree[a]["refused"]) != p + 1 and not sees(view, cells, a, p, segment, counts):
                tree[a]["refused"] = p + 1
                tree[a]["blocker"] = 0
            if not seen and np.int64(tree[a]["refused"]) == p + 1:
                tree[a]["g"] = _find_parent(view, cells, moves, tree, a, segment, tried, counts)
                p = np.int64(tree[a]["parent"])
                away = span(strides, basis, a, goal, segment.at, segment.v)
                f = np.floor((tree[a]["g"] + weight * away) * scale + 0.5)
                if count > 0 and f > key[0]:
                    rise(key, cost, node, count, f, tree[a]["g"], a)
                    count += 1
                    pushes += 1
                    continue
        tree[a]["mark"] |= DONE | EXPANDED
        expansions += 1
        if a == goal:
            status = FOUND
            break
        # No path can be shorter than one by a straight line from the cell of the least f.
        if glance and (expansions & GLANCE) == 1 and sees(view, cells, a, goal, segment, counts):
            tree[goal]["parent"] = a
            tree[goal]["g"] = tree[a]["g"] + span(strides, basis, a, goal, segment.at, segment.v)
            status = FOUND
            break

        # A neighbour's distances from the parent and to the goal are those of a, a move further.
        if p != known:
            known = p
            rest = p
            for i in range(n):
                there[i] = np.int64((rest + 0.5) * inverse[i])
                rest -= there[i] * strides[i]
        for r in range(n):
            behind[r] = 0.0
            ahead[r] = 0.0
            for i in range(n):
                behind[r] += basis[r, i] * (here[i] - there[i])
                ahead[r] += basis[r, i] * (last[i] - here[i])
        before, so_far = tree[p]["g"], tree[a]["g"]
        for k in range(offsets.shape[0]):
            b = a + offsets[k]
            if free[b] == 0 or b == p:
                continue
            old = tree[b]["mark"]
            if old != 0 and np.int64(tree[b]["parent"]) == p:
                continue  # by the same line, and with a g that an entry has
            # Path 2 of the paper: straight from the parent, as if it saw b.
            total = 0.0
            for r in range(n):
                x = behind[r] + steps[k, r]
                total += x * x
            reached = before + np.sqrt(total)
            if old != 0 and reached >= tree[b]["g"] * BETTER:
                continue
            shut = False
            for i in range(swept_starts[k], swept_starts[k + 1]):
                if free[a + swept[i]] == 0:
                    shut = True
                    break
            if shut:
                continue
            parent_b = p
            if lazy and (old & SURE) == 0:
                tree[b]["mark"] = SEEN
            else:
                # A g that a line is known to give is never replaced by one that is only hoped for.
                blocked = np.int64(tree[b]["refused"]) == p + 1
                wedge = np.uint8(0)
                if n == 2 and not blocked:
                    v[0] = here[0] + shifts[k, 0] - there[0]
                    v[1] = here[1] + shifts[k, 1] - there[1]
                    looked = sees_by_wedge(
                        free, strides, shape, generators, gram, reach, touch, there, v, b, p, offsets, shifts, tree
                    )
                    counts[SCANNED] += abs(looked)
                    counts[LINES] += 1
                    wedge = WEDGE if looked > 0 else wedge
                blocked = np.int64(tree[b]["refused"]) == p + 1
                if not blocked and wedge == 0 and not sees(view, cells, b, p, segment, counts):
                    tree[b]["refused"] = p + 1
                    tree[b]["blocker"] = 0
                    blocked = True
                if blocked:
                    parent_b = a  # path 1: by the move
                    reached = so_far + lengths[k]
                    if old != 0 and reached >= tree[b]["g"] * BETTER:
                        continue
                tree[b]["mark"] = SEEN | SURE | wedge | (old & EXPANDED)
            tree[b]["g"] = reached
            tree[b]["parent"] = parent_b
            total = 0.0
            for r in range(n):
                x = ahead[r] - steps[k, r]
                total += x * x
            f = np.floor((reached + weight * np.sqrt(total)) * scale + 0.5)
            rise(key, cost, node, count, f, reached, b)
            count += 1
            pushes += 1
    entries[0] = count
    counts[PUSHES], counts[EXPANSIONS] = pushes, expansions
    return status


@njit(cache=True, nogil=True)
def _find_parent(view, cells, moves, tree, a, segment, tried, counts):
    """Give the cell ``a``, which its parent does not see, the best other one; return the g by it.

    Candidates are the expanded neighbours, as in the paper, and, beyond it, their parents where they see
    ``a``. ``tried`` (K + 1,) is scratch.
    """
    strides, shape, basis, gram = view.strides, view.shape, view.basis, view.gram
    generators, reach, touch = view.generators, view.reach, view.touch
    offsets, lengths, _, shifts, swept_starts, swept = moves
    free = cells.free
    at, v, _ = segment
    n = strides.shape[0]
    before = np.int64(tree[a]["parent"])
    tree[a]["mark"] &= ~WEDGE
    best = np.inf
    # The neighbour from which a was reached has been expanded and may move here: one is always found.
    for k in range(offsets.shape[0]):
        b = a - offsets[k]
        if (tree[b]["mark"] & EXPANDED) == 0 or tree[b]["g"] + lengths[k] >= best:
            continue
        shut = False
        for i in range(swept_starts[k], swept_starts[k + 1]):
            shut = shut or free[b + swept[i]] == 0
        if not shut:
            best = tree[b]["g"] + lengths[k]
            tree[a]["parent"] = b
    # Neighbours share parents, and a look is dear: each parent is tried once, and only if it would be better.
    tried[0] = before
    many = 1
    for k in range(offsets.shape[0]):
        b = a - offsets[k]
        if (tree[b]["mark"] & EXPANDED) == 0:
            continue
        p = np.int64(tree[b]["parent"])
        known = False
        for i in range(many):
            known = known or tried[i] == p
        if known:
            continue
        tried[many] = p
        many += 1
        rest_p, rest_a = p, a
        for i in range(n):
            at[i] = rest_p // strides[i]
            rest_p -= at[i] * strides[i]
            x = rest_a // strides[i]
            rest_a -= x * strides[i]
            v[i] = x - at[i]
        squared = 0.0
        for r in range(n):
            metres = 0.0
            for i in range(n):
                metres += basis[r, i] * v[i]
            squared += metres * metres
        reached = tree[p]["g"] + np.sqrt(squared)
        if reached >= best * BETTER:
            continue
        wide = np.int64(0)
        if n == 2:
            wide = sees_by_wedge(
                free, strides, shape, generators, gram, reach, touch, at, v, a, p, offsets, shifts, tree
            )
            counts[SCANNED] += abs(wide)
            counts[LINES] += 1
        if wide <= 0 and np.int64(tree[a]["refused"]) == p + 1:
            continue
        if wide > 0 or sees(view, cells, a, p, segment, counts):
            best = reached
            tree[a]["parent"] = p
            if wide <= 0:
                tree[a]["mark"] &= ~WEDGE
        else:
            tree[a]["refused"] = p + 1
            tree[a]["blocker"] = 0
    return best


@njit(cache=True, nogil=True)
def follow(tree, at):
    """Return the flat cells from the start to ``at``."""
    # Counted first: an array that grows takes half a second to compile.
    count = 1
    cell = np.int64(at)
    while tree[cell]["parent"] != cell:
        cell = np.int64(tree[cell]["parent"])
        count += 1
    out = np.empty(count, np.int64)
    out[count - 1] = at
    for i in range(count - 2, -1, -1):
        out[i] = tree[out[i + 1]]["parent"]
    return out
