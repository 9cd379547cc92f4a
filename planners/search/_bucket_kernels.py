"""Numba kernels of Dijkstra's fields on unequal edges without terrain: a ring of buckets, masks of allowed moves.

What is slow in the plain search (:func:`planners.search._dijkstra_kernels.buckets`) are branches that no processor
can predict and the memory they wait for: whether a neighbour is free, whether what the move sweeps is, whether its
cost becomes less. Here none of them is a branch. Which moves a cell allows is a bit each, computed for some hundred
cells in a row, over whole vectors; a table lists the set bits of a byte; and cells are taken from their bucket by the
batch, so that what a batch needs is fetched from memory all at once before it is used.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

_BATCH = 128  # cells at a time: what they try stays in the processor's first cache
_BLOCK = 512  # cells in a row of which the allowed moves are found together
_FIRST_ROOM = 4096  # entries of a bucket, doubled as needed
_NEVER = 9e15  # bucket of a cell without a cost, finite so that it can be converted


class Masks(NamedTuple):
    """Which moves lead from each cell: bit k % 8 of byte k // 8 for the move k.

    Attributes:
        allowed: (size, bytes) uint8, of the blocks that are known.
        known: (blocks,) bool, one for :data:`_BLOCK` flat cells.
        move: (block,) uint8 scratch.
        byte: (block,) uint8 scratch.
    """

    allowed: np.ndarray
    known: np.ndarray
    move: np.ndarray
    byte: np.ndarray


class Bits(NamedTuple):
    """What each value of a byte of a mask says.

    Attributes:
        count: (256,) uint8 set bits.
        moves: (256 bytes, 8) uint8 their moves, the first ``count`` of them; row 256 g + v for the value v of byte g.
        offsets: (256 bytes, 8) int32 the flat offsets of these.
    """

    count: np.ndarray
    moves: np.ndarray
    offsets: np.ndarray


class Tries(NamedTuple):
    """The moves of a batch of cells.

    Attributes:
        to: (room,) uint32 the cell that each leads to.
        move: (room,) uint8 its number.
        cost: (room,) float64 of the cell that it leads from.
        fetched: (room,) float64 only read into: what is loaded here is near when it is needed.
        near: (room,) uint8 likewise.
    """

    to: np.ndarray
    move: np.ndarray
    cost: np.ndarray
    fetched: np.ndarray
    near: np.ndarray


@njit(cache=True, nogil=True)
def _bits(offsets):
    """Return the tables of the bits of a mask."""
    moves = offsets.shape[0]
    width = (moves + 7) // 8
    count = np.zeros(256, np.uint8)
    numbers = np.zeros((256 * width, 8), np.uint8)
    flat = np.zeros((256 * width, 8), np.int32)
    for value in range(256):
        found = 0
        for bit in range(8):
            if (value >> bit) & 1:
                for g in range(width):
                    k = min(8 * g + bit, moves - 1)  # bits beyond the last move are never set
                    numbers[256 * g + value, found] = k
                    flat[256 * g + value, found] = offsets[k]
                found += 1
        count[value] = found
    return Bits(count, numbers, flat)


@njit(cache=True, nogil=True)
def _learn(block, graph, reach, masks):
    """Find which moves the cells of a block allow; ``reach`` is the farthest of all offsets."""
    free, offsets, _, swept_starts, swept, _ = graph
    allowed, known, move, byte = masks
    # What is nearer to an end of the array than a move reaches is padding, which is never asked for.
    first = max(block * _BLOCK, reach)
    last = min((block + 1) * _BLOCK, free.shape[0] - reach)
    count = max(last - first, 0)
    moves = offsets.shape[0]
    for g in range(allowed.shape[1]):
        for i in range(count):
            byte[i] = 0
        for k in range(8 * g, min(8 * g + 8, moves)):
            bit = np.uint8(1 << (k - 8 * g))
            end = free[first + offsets[k] : last + offsets[k]]
            for i in range(count):
                move[i] = end[i] * bit
            for s in range(swept_starts[k], swept_starts[k + 1]):
                side = free[first + swept[s] : last + swept[s]]
                for i in range(count):
                    move[i] *= side[i]
            for i in range(count):
                byte[i] |= move[i]
        for i in range(count):
            allowed[first + i, g] = byte[i]
    known[block] = True


@njit(cache=True, nogil=True)
def _list_moves(cells, turn, inverse_width, distance, graph, reach, masks, bits, tries):
    """List the allowed moves of a batch of cells, of those that are due in the bucket ``turn``.

    Returns (how many moves, how many cells).
    """
    to, move, cost, fetched, near = tries
    allowed, known, _, _ = masks
    counts, numbers, flat = bits
    width = np.uint64(allowed.shape[1])
    # All loads of the batch are on their way before the first is used.
    for j in range(cells.shape[0]):
        block = cells[j] // _BLOCK
        if not known[block]:
            _learn(block, graph, reach, masks)
    for j in range(cells.shape[0]):
        fetched[j] = distance[cells[j]]
        near[j] = allowed[cells[j], 0]
    count = np.uint64(0)  # unsigned indices cannot count from the end of an array: Numba tests nothing
    settled = 0
    for j in range(cells.shape[0]):
        a = cells[j]
        d = fetched[j]
        # Otherwise it was reached at less cost since, and settled in an earlier bucket.
        due = np.int64(d * inverse_width) == turn
        settled += due
        for g in range(width):
            value = allowed[a, g]
            row = np.uint64(256) * np.uint64(g) + np.uint64(value)
            # Eight are written always, and as many kept as there are: without a branch.
            for i in range(8):
                to[count + np.uint64(i)] = np.uint32(np.int32(a) + flat[row, i])
            for i in range(8):
                move[count + np.uint64(i)] = numbers[row, i]
            for i in range(8):
                cost[count + np.uint64(i)] = d
            count += np.uint64(counts[value]) * np.uint64(due)
    return np.int64(count), settled


@njit(cache=True, nogil=True)
def _enter(count, turn, slot, limit, inverse_width, lengths, distance, tries, node, fill):
    """Enter what ``count`` moves lead to into the buckets, where their cost is less than what was known.

    Each bucket has room for all of them.
    """
    to, move, cost, _, _ = tries
    slots = fill.shape[0]
    # Nine of ten lead to a cell that has no greater cost already. Nothing is written to it here: all loads can overlap.
    kept = np.uint64(0)
    for i in range(count):
        b = to[i]
        reached = cost[i] + lengths[move[i]]
        to[kept] = b
        cost[kept] = reached
        kept += np.uint64((reached < distance[b]) & (reached <= limit))
    for i in range(kept):
        b = to[i]
        reached = cost[i]
        old = distance[b]  # less by now where two of them lead to the same cell
        less = reached < old
        distance[b] = reached if less else old
        due = np.int64(reached * inverse_width)
        was = np.int64(min(old * inverse_width, _NEVER))
        s = slot + (due - turn)
        s = np.uint64(s - slots if s >= slots else s)
        # Written always and kept only if it is new: in the bucket ``was`` it stands already.
        node[s, fill[s]] = b
        fill[s] += np.uint64(less & ((was != due) | (due == turn)))


@njit(cache=True, nogil=True)
def _wait(goals, turn, inverse_width, distance):
    """Tell whether a goal is not final after the bucket ``turn``."""
    for i in range(goals.shape[0]):
        d = distance[goals[i]]
        if d == np.inf or np.int64(d * inverse_width) > turn:
            return True
    return False


@njit(cache=True, nogil=True)
def ring(graph, sources, goals, limit, inverse_width, slots, distance):
    """Write the least cost from ``sources`` into ``distance`` (size,), given as infinite everywhere.

    A bucket is no wider than the cheapest move, so that no move ends in the bucket it began in: every cell is final
    when its bucket's turn comes, and the order within a bucket is free. ``slots`` buckets, more than the dearest move
    can reach, form a ring. Stops when all ``goals`` are final; costs beyond ``limit`` are not entered. What is not
    final at the end is infinite again. ``graph`` has no terrain.

    Returns (expansions, pushes).
    """
    free, offsets, lengths, _, swept, _ = graph
    width = (offsets.shape[0] + 7) // 8
    reach = np.abs(offsets).max()
    if swept.shape[0] > 0:
        reach = max(reach, np.abs(swept).max())
    masks = Masks(
        np.empty((free.shape[0], width), np.uint8),
        np.zeros(free.shape[0] // _BLOCK + 1, np.bool_),
        np.empty(_BLOCK, np.uint8),
        np.empty(_BLOCK, np.uint8),
    )
    bits = _bits(offsets)
    most = (_BATCH * width + 1) * 8
    tries = Tries(
        np.empty(most, np.uint32), np.empty(most, np.uint8), np.empty(most), np.empty(most), np.empty(most, np.uint8)
    )
    node = np.empty((slots, max(_FIRST_ROOM, sources.shape[0])), np.uint32)
    fill = np.zeros(slots, np.uint64)
    for i in range(sources.shape[0]):
        if distance[sources[i]] != 0.0:
            distance[sources[i]] = 0.0
            node[0, fill[0]] = sources[i]
            fill[0] += np.uint64(1)
    settled = 0
    pushes = 0
    turn = 0
    slot = 0
    while fill.max() > 0:
        # The bucket grows meanwhile only where a cost is so large that rounding absorbs a part of a move.
        begin = 0
        while begin < np.int64(fill[slot]):
            end = min(begin + _BATCH, np.int64(fill[slot]))
            count, cells = _list_moves(
                node[slot, begin:end], turn, inverse_width, distance, graph, reach, masks, bits, tries
            )
            settled += cells
            begin = end
            if np.int64(fill.max()) + count >= node.shape[1]:
                larger = np.empty((slots, 2 * (node.shape[1] + count)), np.uint32)
                larger[:, : node.shape[1]] = node
                node = larger
            _enter(count, turn, slot, limit, inverse_width, lengths, distance, tries, node, fill)
        pushes += np.int64(fill[slot])
        fill[slot] = 0
        # A goal is final once its bucket has had its turn.
        if goals.shape[0] > 0 and not _wait(goals, turn, inverse_width, distance):
            break
        turn += 1
        slot = slot + 1 if slot + 1 < slots else 0
    # Cells that still wait have a cost, but not a final one.
    for s in range(slots):
        pushes += np.int64(fill[s])
        for i in range(np.int64(fill[s])):
            a = node[s, i]
            if distance[a] < np.inf and np.int64(distance[a] * inverse_width) > turn:
                distance[a] = np.inf
    return settled, pushes
