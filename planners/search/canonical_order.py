"""Canonical orderings of moves, derived from the moves alone: which pairs of moves a search may leave out.

A total order of the moves makes of all shortest paths between two cells one *canonical* path: of
those with the fewest moves the one whose sequence of ranks is lexicographically smallest. A pair
of consecutive moves (d, e) from p over y = p + d to z = y + e cannot be on it where another way
from p to z is legal and better: a single move f = d + e that costs no more, or a pair (f, g) with
f + g = d + e that costs less, or as much with f of a lower rank than d. Such ways are the pair's
*alternatives*. A pair without any is *natural*; any other is *forced* exactly where something
blocks each of its alternatives.

**Which order.** In open space one pair is left for every cell that is two moves away, whatever the
order; orders differ in how many sequences of more moves consist of natural pairs alone. The fewest
such sequences of eight moves is the criterion: an order that reaches a cell twice, or by a detour,
has more. Swaps of two ranks descend from the long moves first, and from seeded random orders. On
A2-6 this finds the alternation of even and odd directions, on Z2-8 and Z3-26 the diagonals first of
jump point search (Harabor and Grastien 2011, Sturtevant and Rabin 2016), on D3*-8 and D3*-14 orders of
three levels. In open space these leave one sequence to a cell (1.005 on D3*-8 in a box, whose sides cut
some off); the best found for D3-12 leaves 1.04, for D3-18 1.02, for A2-12 1.5. Any order is exact.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import IntArray

__all__ = ["Ordering", "canonical_ordering", "natural_pairs"]


_DEPTH = 8  # moves of the sequences that are counted
_RESTARTS = 24
_FAR = 2**62


class Ordering(NamedTuple):
    """What a canonical search needs of K moves; cells are relative to the middle of a pair, y.

    Attributes:
        order: (K,) the moves by rank.
        natural: (K + 1,) bits of the moves that may follow each move anywhere; all after the start (K).
        level: (K,) 0 where a move is followed naturally by itself alone, else one more than the
            highest level of the other moves that follow it.
        guard_starts: (K + 1,) where the guards of each move begin.
        guards: (G, n) cells around y; while those of d are free, no pair (d, e) is forced.
        pair_starts: (K + 1,) where the pairs of each first move begin that can be forced.
        seconds: (P,) the second move of each of these pairs.
        way_starts: (P + 1,) where the alternatives of each pair begin.
        cell_starts: (W + 1,) where the cells of each alternative begin.
        cells: (C, n) what must be free for an alternative, if (d, e) itself is legal.
    """

    order: IntArray
    natural: IntArray
    level: IntArray
    guard_starts: IntArray
    guards: IntArray
    pair_starts: IntArray
    seconds: IntArray
    way_starts: IntArray
    cell_starts: IntArray
    cells: IntArray


class _Candidates(NamedTuple):
    """The cheapest pairs of moves to each cell that no single move reaches as cheaply, by cell."""

    first: IntArray
    second: IntArray
    starts: IntArray


def _candidates(moves: IntArray, lengths: IntArray) -> _Candidates:
    count = len(moves)
    first, second = np.divmod(np.arange(count * count), count)
    ends, cell = np.unique(moves[first] + moves[second], axis=0, return_inverse=True)
    cell = cell.ravel()
    cost = lengths[first] + lengths[second]
    least = np.full(len(ends), _FAR)
    np.minimum.at(least, cell, cost)
    single = {tuple(move): length for move, length in zip(moves.tolist(), lengths.tolist(), strict=True)}
    single[(0,) * moves.shape[1]] = 0  # there and back
    open_ends = np.array([single.get(tuple(end), _FAR) for end in ends.tolist()]) > least
    kept = np.flatnonzero(open_ends[cell] & (cost == least[cell]))
    kept = kept[np.argsort(cell[kept], kind="stable")]
    return _Candidates(first[kept], second[kept], np.flatnonzero(np.diff(cell[kept], prepend=-1)))


def natural_pairs(order: IntArray, moves: IntArray, lengths: IntArray) -> NDArray[np.bool_]:
    """Return (K, K): whether the second move may follow the first anywhere, under an order (K,) of the moves."""
    return _natural(order, _candidates(moves, lengths)) > 0


def _natural(order: IntArray, pairs: _Candidates) -> NDArray[np.float64]:
    count = len(order)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    natural = np.zeros((count, count))
    if len(pairs.starts):
        least = np.minimum.reduceat(rank[pairs.first] * count + rank[pairs.second], pairs.starts)
        natural[order[least // count], order[least % count]] = 1.0
    return natural


def _sequences(order: IntArray, pairs: _Candidates) -> float:
    """Return how many sequences of moves consist of natural pairs."""
    natural = _natural(order, pairs)
    ends = np.ones(len(order))
    for _ in range(_DEPTH - 1):
        ends = natural @ ends
    return float(ends.sum())


def _best_order(lengths: IntArray, pairs: _Candidates) -> IntArray:
    """Return the order of fewest sequences that swaps of two ranks lead to; the first found among equals."""
    count = len(lengths)
    rng = np.random.default_rng(0)
    best: tuple[float, IntArray] | None = None
    for restart in range(_RESTARTS):
        order = rng.permutation(count) if restart else np.lexsort((np.arange(count), -lengths))
        least, before = _sequences(order, pairs), np.inf
        while least < before:
            before = least
            for i in range(count):
                for j in range(i + 1, count):
                    order[[i, j]] = order[[j, i]]
                    found = _sequences(order, pairs)
                    if found < least:
                        least = found
                    else:
                        order[[i, j]] = order[[j, i]]
        if best is None or least < best[0]:
            best = least, order
    assert best is not None
    return best[1].astype(np.int64)


def canonical_ordering(
    moves: IntArray, lengths: IntArray, swept: tuple[tuple[tuple[int, ...], ...], ...]
) -> Ordering:
    """Return the ordering of moves (K, n) of integer lengths (K,) and all that follows from it, computed once.

    Args:
        moves: index offsets.
        lengths: integers, so that equal sums are equal.
        swept: for each move the further cells, from its start, that must be free.
    """
    v = np.ascontiguousarray(moves, dtype=np.int64)
    return _ordering(v.tobytes(), np.ascontiguousarray(lengths, dtype=np.int64).tobytes(), v.shape[1], swept)


@lru_cache(maxsize=64)
def _order_of(moves: bytes, lengths: bytes, n: int) -> tuple[IntArray, NDArray[np.bool_]]:
    v, costs = np.frombuffer(moves, np.int64).reshape(-1, n), np.frombuffer(lengths, np.int64)
    pairs = _candidates(v, costs)
    order = _best_order(costs, pairs)
    return order, _natural(order, pairs) > 0


@lru_cache(maxsize=64)
def _ordering(moves: bytes, lengths: bytes, n: int, swept: tuple[tuple[tuple[int, ...], ...], ...]) -> Ordering:
    v, costs = np.frombuffer(moves, np.int64).reshape(-1, n), np.frombuffer(lengths, np.int64)
    count = len(v)
    order, natural = _order_of(moves, lengths, n)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    way_of = {tuple(move): k for k, move in enumerate(v.tolist())}
    reach = np.abs(np.array([*v.tolist(), *(cell for cells in swept for cell in cells)])).max(axis=0)

    def plus(a: tuple[int, ...], b: tuple[int, ...]) -> tuple[int, ...]:
        return tuple(x + y for x, y in zip(a, b, strict=True))

    def alternatives(d: int, e: int) -> list[tuple[tuple[int, ...], list[tuple[int, ...]]]]:
        """Return the middle of each alternative and the cells it needs beyond those that (d, e) itself needs."""
        y = (0,) * n
        p, z = tuple((-v[d]).tolist()), tuple(v[e].tolist())
        known = {p, y, z, *(plus(p, s) for s in swept[d]), *swept[e]}
        ways: list[tuple[tuple[int, ...], list[tuple[int, ...]]]] = []
        total = int(costs[d] + costs[e])
        if p == z:
            return [(y, [])]
        whole = way_of.get(plus(z, tuple(v[d].tolist())))
        if whole is not None and costs[whole] <= total:
            ways.append((p, [plus(p, s) for s in swept[whole]]))
        for f in range(count):
            middle = plus(p, tuple(v[f].tolist()))
            g = way_of.get(tuple(b - a for a, b in zip(middle, z, strict=True)))
            if g is None or f == d:
                continue
            if costs[f] + costs[g] < total or (costs[f] + costs[g] == total and rank[f] < rank[d]):
                # The middle first: while it is free, what is swept around it lies inside the window's padding.
                ways.append((middle, [middle, *(plus(p, s) for s in swept[f]), *(plus(middle, s) for s in swept[g])]))
        ways = [(m, [c for c in dict.fromkeys(cells) if c not in known]) for m, cells in ways]
        ways.sort(key=lambda way: len(way[1]))
        kept: list[tuple[tuple[int, ...], list[tuple[int, ...]]]] = []
        for m, cells in ways:
            if not any(set(other) <= set(cells) for _, other in kept):
                kept.append((m, cells))
        return kept

    bits = np.zeros(count + 1, np.int64)
    bits[count] = (1 << count) - 1
    guard_starts, guards = [0], []
    pair_starts, seconds = [0], []
    way_starts, cell_starts = [0], [0]
    cells: list[tuple[int, ...]] = []
    for d in range(count):
        guarding: dict[tuple[int, ...], None] = {}
        options = []
        for e in order.tolist():
            if natural[d, e]:
                bits[d] |= 1 << e
                continue
            ways = alternatives(d, e)
            if not ways[0][1]:
                continue  # legal wherever the pair is
            seconds.append(e)
            for _, needed in ways:
                cells += needed
                cell_starts.append(len(cells))
            way_starts.append(len(cell_starts) - 1)
            options.append([[m, *needed] if (np.abs(needed) > reach).any() else needed for m, needed in ways])
        # One alternative of each pair, so that few cells guard all.
        for ways_of in sorted(options, key=len):
            guarding.update(dict.fromkeys(min(ways_of, key=lambda way: len([c for c in way if c not in guarding]))))
        guards += list(guarding)
        guard_starts.append(len(guards))
        pair_starts.append(len(seconds))
    level = np.zeros(count, np.int64)
    for d in order[::-1].tolist():
        level[d] = max((level[e] + 1 for e in range(count) if natural[d, e] and e != d), default=0)

    def vectors(rows: list[tuple[int, ...]]) -> IntArray:
        return np.array(rows, dtype=np.int64).reshape(-1, n)

    out = Ordering(
        order,
        bits,
        level,
        np.array(guard_starts),
        vectors(guards),
        np.array(pair_starts),
        np.array(seconds, dtype=np.int64),
        np.array(way_starts),
        np.array(cell_starts),
        vectors(cells),
    )
    for array in out:
        array.setflags(write=False)
    return out
