"""Numba kernels of replanning, over the arrays of :class:`planners.search._shared_kernels.GraphArrays`.

Costs are whole numbers, so that no sum has a rounding error and equal costs are equal. The search
goes from the goal to the start; every move has its opposite, which sweeps the same cells.

**What holds between searches.** ``parent_move`` is zero where a cell is not reached. A reached cell's
``g`` is at least that of its parent plus the move between them, and that move is allowed: ``g`` is never
below the true cost, and the parents form a tree, for ``g`` falls on the path to its root. And a
reached cell that is not open offers no neighbour a lesser ``g`` than it has. Then the start's ``g``
is the least cost as soon as no open cell has a smaller key: on a cheapest path from the goal, the
last cell of those that have the true cost is open or the start, and its key is no larger.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planners.search._shared_kernels import drop_top, may_move, rise

OPEN = 128  # set in ``parent_move`` where the moves of a cell have yet to be tried
MOVE = 127  # its bits that hold the move that reached a cell, plus one
ROOT = 127  # these bits at the goal


class Metric(NamedTuple):
    """What moves cost and what a path costs at least, in units; the graph's ``lengths`` are the least a move costs.

    Attributes:
        scaled: (K,) float64 what each move costs on a terrain of one.
        planes: (F, n) int64 facets of the gauge of the lengths, one of each opposite pair.
        steps: (K + 1, F) int64 products of the moves with the planes, the last row zero.
        strides: (n,) int64 of the window.
    """

    scaled: np.ndarray
    planes: np.ndarray
    steps: np.ndarray
    strides: np.ndarray


class Tree(NamedTuple):
    """How each cell was reached from the goal.

    Attributes:
        g: (size,) int64 the cost, written where ``parent_move`` is not zero.
        parent_move: (size,) uint8.
    """

    g: np.ndarray
    parent_move: np.ndarray


class Queue(NamedTuple):
    """The queue, int64: least key first, then the largest cost. Entries may be out of date.

    Attributes:
        key: (N,) of each entry when it was made.
        cost: (N,) its g then.
        node: (N,) its cell.
    """

    key: np.ndarray
    cost: np.ndarray
    node: np.ndarray


class Start(NamedTuple):
    """Where the search goes to.

    Attributes:
        flat: cell.
        position: (n,) int64 the same in window coordinates.
        km: what moves of the start have added to all keys. A key in the queue may be too small, and
            is put right when its turn comes (Koenig and Likhachev 2002).
    """

    flat: int
    position: np.ndarray
    km: int


# ---------------------------------------------------------------------- costs and keys


@njit(cache=True, nogil=True)
def cost_of(a, b, k, lengths, scaled, terrain):
    """Return what the move k between the cells a and b costs, never less than ``lengths[k]``."""
    if terrain.shape[0] == 0:
        return lengths[k]
    return max(lengths[k], np.int64(np.rint(scaled[k] * (0.5 * (terrain[a] + terrain[b])))))


@njit(cache=True, nogil=True)
def project(cell, position, planes, strides, out):
    """Write the product of each plane with the offset of ``cell`` from ``position`` (n,) into ``out`` (F,)."""
    out[:] = 0
    rest = cell
    for i in range(strides.shape[0]):
        x = rest // strides[i]
        rest -= x * strides[i]
        offset = x - position[i]
        for f in range(planes.shape[0]):
            out[f] += planes[f, i] * offset


@njit(cache=True, nogil=True)
def gauge(base, steps, k):
    """Return the gauge after the move k from the cell with the products ``base`` (F,)."""
    most = np.int64(0)
    for f in range(base.shape[0]):
        v = abs(base[f] + steps[k, f])
        if v > most:
            most = v
    return most


@njit(cache=True, nogil=True)
def calculate_key(a, g, start, metric, base):
    """Return CalculateKey of D* Lite for the cell ``a`` of cost ``g``; ``base`` (F,) is room for it."""
    project(a, start.position, metric.planes, metric.strides, base)
    return g + gauge(base, metric.steps, metric.steps.shape[0] - 1) + start.km


# ---------------------------------------------------------------------- the queue


@njit(cache=True, nogil=True)
def _with_room(queue, count, more):
    """Return the queue, longer where ``more`` entries would not fit after ``count``."""
    if count + more <= queue.key.shape[0]:
        return queue
    more = max(more, queue.key.shape[0])
    return Queue(
        np.append(queue.key, np.empty(more, np.int64)),
        np.append(queue.cost, np.empty(more, np.int64)),
        np.append(queue.node, np.empty(more, np.int64)),
    )


@njit(cache=True, nogil=True)
def _open(a, reached, move, start, metric, tree, queue, count, base):
    """Reach the cell ``a`` at a cost by a move (plus one), and enter it after ``count`` others."""
    tree.g[a] = reached
    tree.parent_move[a] = np.uint8(OPEN | move)
    rise(queue.key, queue.cost, queue.node, count, calculate_key(a, reached, start, metric, base), reached, a)


@njit(cache=True, nogil=True)
def rekey(queue, count, start, metric, tree):
    """Give the open cells the keys of the start, each once; returns how many entries there are."""
    key, cost, node = queue
    g, parent_move = tree
    base = np.empty(metric.planes.shape[0], np.int64)
    # First the cells, so that those entered twice are found by their mark; then the heap is made anew in place.
    kept = 0
    for i in range(count):
        a = node[i]
        if parent_move[a] & OPEN and g[a] == cost[i]:
            parent_move[a] &= np.uint8(MOVE)
            node[kept] = a
            kept += 1
    for i in range(kept):
        a = node[i]
        parent_move[a] |= np.uint8(OPEN)
        rise(key, cost, node, i, calculate_key(a, g[a], start, metric, base), g[a], a)
    return kept


# ---------------------------------------------------------------------- the search


@njit(cache=True, nogil=True)
def compute_shortest_path(graph, metric, tree, queue, count, start, most):
    """Try the moves of open cells, least key first, until the start's cost is final or no cell is open.

    ComputeShortestPath of D* Lite for cells that are never underconsistent: :func:`repair` has cut those off.

    Args:
        graph: GraphArrays, the lengths in units.
        metric: Metric.
        tree: Tree.
        queue: Queue.
        count: its entries.
        start: Start.
        most: stop after so many expansions; the search can go on from there.

    Returns:
        (key, cost, node, count, expansions, pushes), the first three the queue's.
    """
    # Taken apart once: each use of a tuple of arrays counts references. Helpers are given few arrays: the
    # more a call takes, the slower it is, up to twice the time of a repair.
    free, offsets, lengths, swept_starts, swept, terrain = graph
    scaled, planes, steps, strides = metric
    g, parent_move = tree
    key, cost, node = queue
    flat, position, km = start
    moves = offsets.shape[0]
    base = np.empty(planes.shape[0], np.int64)
    expansions = 0
    pushes = 0
    while count > 0 and expansions < most:
        if parent_move[flat] != 0 and key[0] >= g[flat] + km:
            break
        # An entry counts if its cell is open at that cost still.
        a = node[0]
        d = cost[0]
        old_key = key[0]
        count = drop_top(key, cost, node, count)
        if (parent_move[a] & OPEN) == 0 or g[a] != d:
            continue
        # Made for an earlier start, the key may be too small: then the cell goes back with its own.
        project(a, position, planes, strides, base)
        new_key = d + gauge(base, steps, moves) + km
        if count + moves > key.shape[0]:
            key, cost, node = _with_room(Queue(key, cost, node), count, moves)
        if old_key < new_key:
            rise(key, cost, node, count, new_key, d, a)
            count += 1
            pushes += 1
            continue
        parent_move[a] &= np.uint8(MOVE)
        expansions += 1
        # A neighbour reached at less cost takes the cell as its parent.
        for k in range(moves):
            b = a + offsets[k]
            if free[b] == 0:
                continue
            reached = d + cost_of(a, b, k, lengths, scaled, terrain)
            if parent_move[b] != 0 and reached >= g[b]:
                continue
            if not may_move(free, a, k, offsets, swept_starts, swept):
                continue
            g[b] = reached
            parent_move[b] = np.uint8(OPEN | (k + 1))
            rise(key, cost, node, count, reached + gauge(base, steps, k) + km, reached, b)
            count += 1
            pushes += 1
    # Not a Queue: Python is slow to make a named tuple of what a kernel returns.
    return key, cost, node, count, expansions, pushes


@njit(cache=True, nogil=True)
def enclosed(graph, start, goal, most):
    """Tell whether moves lead from ``start`` to at most ``most`` cells, and the ``goal`` is not among them."""
    free, offsets, _, swept_starts, swept, _ = graph
    # Breadth first; all moves are taken forwards, as each has its opposite.
    seen = np.zeros(free.shape[0], np.uint8)
    queue = np.empty(most + 1, np.int64)
    queue[0] = start
    seen[start] = 1
    head = 0
    count = 1
    while head < count:
        a = queue[head]
        head += 1
        for k in range(offsets.shape[0]):
            b = a + offsets[k]
            if seen[b] == 0 and may_move(free, a, k, offsets, swept_starts, swept):
                if b == goal or count > most:
                    return False
                seen[b] = 1
                queue[count] = b
                count += 1
    return start != goal


# ---------------------------------------------------------------------- the repair, step by step


@njit(cache=True, nogil=True)
def _least(a, graph, scaled, tree):
    """Return the least cost (or -1) that reached neighbours offer the cell ``a``, and the move by which."""
    free, offsets, lengths, swept_starts, swept, terrain = graph
    g, parent_move = tree
    best = np.int64(-1)
    move = 0
    for k in range(offsets.shape[0]):
        before = a - offsets[k]
        if parent_move[before] == 0:
            continue
        reached = g[before] + cost_of(before, a, k, lengths, scaled, terrain)
        if (best < 0 or reached < best) and may_move(free, before, k, offsets, swept_starts, swept):
            best = reached
            move = k
    return best, move


@njit(cache=True, nogil=True)
def _held(a, graph, scaled, tree):
    """Tell whether some neighbour still holds ``g`` of the reached cell ``a``, and make that its parent."""
    free, offsets, lengths, swept_starts, swept, terrain = graph
    g, parent_move = tree
    mark = parent_move[a] & MOVE
    if mark == ROOT:
        return True
    # The parent first, which needs no change; then all.
    for i in range(-1, offsets.shape[0]):
        k = mark - 1 if i < 0 else i
        before = a - offsets[k]
        if parent_move[before] == 0 or g[before] >= g[a]:
            continue
        if g[before] + cost_of(before, a, k, lengths, scaled, terrain) > g[a]:
            continue
        if may_move(free, before, k, offsets, swept_starts, swept):
            parent_move[a] = np.uint8((parent_move[a] & OPEN) | (k + 1))
            return True
    return False


@njit(cache=True, nogil=True)
def _doubt_children(a, offsets, parent_move, doubted, doubts):
    """Add the cells whose parent is ``a`` to the doubted ones, and return them and how many."""
    moves = offsets.shape[0]
    if doubts + moves > doubted.shape[0]:
        doubted = np.append(doubted, np.empty_like(doubted))
    for k in range(moves):
        b = a + offsets[k]
        if (parent_move[b] & MOVE) == k + 1:
            doubted[doubts] = b
            doubts += 1
    return doubted, doubts


@njit(cache=True, nogil=True)
def _doubt_changed(graph, tree, known, touched, priced):
    """Return the cells (N,) that may have lost the move from their parent, and how many; blocked ones leave the tree.

    Those are the children of a blocked cell, the cells reached by a move that sweeps it, and where
    the terrain has changed a cell and its children.
    """
    free, offsets, _, swept_starts, swept, _ = graph
    parent_move = tree.parent_move
    moves = offsets.shape[0]
    doubted = np.empty(max(256, 2 * moves + swept.shape[0]), np.int64)
    doubts = 0
    # Cells that were free and are blocked now.
    for i in range(touched.shape[0]):
        c = touched[i]
        if free[c] != 0 or known[c] == 0:
            continue
        if parent_move[c] != 0:
            parent_move[c] = 0
            doubted, doubts = _doubt_children(c, offsets, parent_move, doubted, doubts)
        while doubts + swept.shape[0] > doubted.shape[0]:
            doubted = np.append(doubted, np.empty_like(doubted))
        for k in range(moves):
            for j in range(swept_starts[k], swept_starts[k + 1]):
                b = c - swept[j] + offsets[k]
                if (parent_move[b] & MOVE) == k + 1:
                    doubted[doubts] = b
                    doubts += 1
    # Cells that may cost more now, as may the moves from and to them.
    for i in range(priced.shape[0]):
        c = priced[i]
        if parent_move[c] != 0:
            doubted, doubts = _doubt_children(c, offsets, parent_move, doubted, doubts)
            if doubts == doubted.shape[0]:
                doubted = np.append(doubted, np.empty_like(doubted))
            doubted[doubts] = c
            doubts += 1
    return doubted, doubts


@njit(cache=True, nogil=True)
def _cut_branches(graph, scaled, tree, doubted, doubts, limit):
    """Cut off the doubted cells whose cost no neighbour holds, and what depends on them; return them and how many.

    A cell cut off is not reached any more, and its children are doubted in turn. Where there are more
    than ``limit`` it gives up, and the number is -1.
    """
    parent_move = tree.parent_move
    lost = np.empty(256, np.int64)
    cut = 0
    # ``g`` falls towards the root, so that no cell can hold another that depends on it: this ends.
    while doubts > 0:
        doubts -= 1
        a = doubted[doubts]
        if parent_move[a] == 0 or _held(a, graph, scaled, tree):
            continue
        if cut == limit:
            return lost, -1
        if cut == lost.shape[0]:
            lost = np.append(lost, np.empty_like(lost))
        lost[cut] = a
        cut += 1
        parent_move[a] = 0
        doubted, doubts = _doubt_children(a, graph.offsets, parent_move, doubted, doubts)
    return lost, cut


@njit(cache=True, nogil=True)
def _open_cut(graph, metric, tree, queue, count, start, lost, cut, base):
    """Let each cell cut off take the best that its neighbours outside offer, and open it; return queue and count."""
    # All offers first: what one cell cut off takes must not be passed on to the next, half true.
    offer = np.empty(cut, np.int64)
    by = np.empty(cut, np.uint8)
    for i in range(cut):
        offer[i], by[i] = _least(lost[i], graph, metric.scaled, tree)
    queue = _with_room(queue, count, cut)
    for i in range(cut):
        if offer[i] >= 0:
            _open(lost[i], offer[i], by[i] + 1, start, metric, tree, queue, count, base)
            count += 1
    return queue, count


@njit(cache=True, nogil=True)
def _open_improved(c, graph, metric, tree, queue, count, start, base):
    """Let the free cell ``c`` take what its neighbours offer if that is less than it has; return queue and count."""
    best, k = _least(c, graph, metric.scaled, tree)
    if best >= 0 and (tree.parent_move[c] == 0 or best < tree.g[c]):
        queue = _with_room(queue, count, 1)
        _open(c, best, k + 1, start, metric, tree, queue, count, base)
        count += 1
    return queue, count


@njit(cache=True, nogil=True)
def _open_freed(graph, metric, tree, queue, count, start, known, touched, base):
    """Reach the cells that became free, and those that moves over them reach at less cost; return queue and count."""
    free, offsets, lengths, swept_starts, swept, terrain = graph
    g, parent_move = tree
    for i in range(touched.shape[0]):
        c = touched[i]
        if free[c] == 0 or known[c] != 0:
            continue
        queue, count = _open_improved(c, graph, metric, tree, queue, count, start, base)
        # The moves that sweep the cell were not allowed before.
        queue = _with_room(queue, count, swept.shape[0])
        for k in range(offsets.shape[0]):
            for j in range(swept_starts[k], swept_starts[k + 1]):
                a = c - swept[j]
                b = a + offsets[k]
                if parent_move[a] == 0 or free[b] == 0:
                    continue
                reached = g[a] + cost_of(a, b, k, lengths, metric.scaled, terrain)
                if parent_move[b] != 0 and reached >= g[b]:
                    continue
                if not may_move(free, a, k, offsets, swept_starts, swept):
                    continue
                _open(b, reached, k + 1, start, metric, tree, queue, count, base)
                count += 1
    return queue, count


@njit(cache=True, nogil=True)
def _open_priced(graph, metric, tree, queue, count, start, priced, base):
    """Reach the cells whose terrain changed at less cost, and open them: their moves may be cheaper."""
    g, parent_move = tree
    for i in range(priced.shape[0]):
        c = priced[i]
        if graph.free[c] == 0:
            continue
        queue, count = _open_improved(c, graph, metric, tree, queue, count, start, base)
        if parent_move[c] != 0:
            queue = _with_room(queue, count, 1)
            _open(c, g[c], parent_move[c] & MOVE, start, metric, tree, queue, count, base)
            count += 1
    return queue, count


@njit(cache=True, nogil=True)
def repair(graph, metric, tree, queue, count, start, known, touched, priced, limit):
    """Restore the invariants of the tree and the queue after changes of cells.

    Takes the place of the main loop's UpdateVertex in D* Lite, as in D* Extra Lite. Where a cell
    loses the move from its parent, another neighbour may hold its cost as well: then it only changes
    parents. Where none does, the cell is cut off, and its children are doubted in turn. What was cut
    off takes the best that its neighbours outside offer, and is open.

    Args:
        graph: GraphArrays as they are now, the lengths in units.
        metric: Metric.
        tree: Tree.
        queue: Queue.
        count: its entries.
        start: Start.
        known: (size,) uint8 the states that the tree stands for; brought up to date.
        touched: flat cells whose state may differ from those, repetitions allowed, never the goal.
        priced: flat cells whose terrain may have changed.
        limit: when more cells are cut off it gives up, and all must be planned anew.

    Returns:
        (key, cost, node, count, cells cut off or -1, pushes), the first three the queue's.
    """
    # From here on ``g`` of every cell that is reached must be held by its parent again.
    doubted, doubts = _doubt_changed(graph, tree, known, touched, priced)
    lost, cut = _cut_branches(graph, metric.scaled, tree, doubted, doubts, limit)
    if cut < 0:
        return queue.key, queue.cost, queue.node, count, cut, 0
    # It is; now every cell that offers a neighbour less than it has must be open.
    before = count
    base = np.empty(metric.planes.shape[0], np.int64)
    queue, count = _open_cut(graph, metric, tree, queue, count, start, lost, cut, base)
    queue, count = _open_freed(graph, metric, tree, queue, count, start, known, touched, base)
    queue, count = _open_priced(graph, metric, tree, queue, count, start, priced, base)
    for i in range(touched.shape[0]):
        known[touched[i]] = graph.free[touched[i]]
    return queue.key, queue.cost, queue.node, count, cut, count - before


# ---------------------------------------------------------------------- paths


@njit(cache=True, nogil=True)
def follow(parent_move, offsets, at):
    """Return the flat cells from the reached cell ``at`` to the goal."""
    out = np.empty(64, np.int64)
    out[0] = at
    count = 1
    while (parent_move[at] & MOVE) != ROOT:
        at -= offsets[(parent_move[at] & MOVE) - 1]
        if count == out.shape[0]:
            out = np.append(out, np.empty(count, np.int64))
        out[count] = at
        count += 1
    return out[:count].copy()


@njit(cache=True, nogil=True)
def is_allowed(route, graph):
    """Tell whether all moves along the flat cells ``route`` are allowed from its first cell, which is free, on."""
    free, offsets, _, swept_starts, swept, _ = graph
    for i in range(route.shape[0] - 1):
        step = route[i + 1] - route[i]
        for k in range(offsets.shape[0]):
            if offsets[k] == step:
                if not may_move(free, route[i], k, offsets, swept_starts, swept):
                    return False
                break
    return True
