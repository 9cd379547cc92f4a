"""Canonical orderings of moves, derived from the moves alone: which pairs of moves a search may leave out.

A total order of the moves makes of all shortest paths between two cells one *canonical* path: of
those with the fewest moves the one whose sequence of ranks is lexicographically smallest. A pair
of consecutive moves (d, e) from p over y = p + d to z = y + e cannot be on it where another path
from p to z is legal and better: a single move f = d + e that costs no more, or a pair (f, g) with
f + g = d + e that costs less, or as much with f of a lower rank than d. Such paths are the pair's
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
from planners.search.offsets import Vector, plus

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
        alternative_starts: (P + 1,) where the alternatives of each pair begin.
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
    alternative_starts: IntArray
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


def canonical_ordering(moves: IntArray, lengths: IntArray, swept: tuple[tuple[Vector, ...], ...]) -> Ordering:
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


class _Table(NamedTuple):
    """Moves, ready for looking at pairs of them.

    Attributes:
        moves: the K offsets.
        number: which move an offset is.
        costs: their K integer lengths.
        rank: their K ranks.
        swept: for each move the further cells, from its start, that must be free.
        reach: (n,) how far moves and what they sweep reach along each index, which is the window's padding.
    """

    moves: list[Vector]
    number: dict[Vector, int]
    costs: list[int]
    rank: list[int]
    swept: tuple[tuple[Vector, ...], ...]
    reach: IntArray


class _Alternative(NamedTuple):
    """A better path than a pair of moves: its middle, and the cells it needs beyond those that the pair needs."""

    middle: Vector
    cells: list[Vector]


@lru_cache(maxsize=64)
def _ordering(moves: bytes, lengths: bytes, n: int, swept: tuple[tuple[Vector, ...], ...]) -> Ordering:
    """Return the ordering of moves (K, n) and integer lengths (K,), both int64 and as bytes; see :class:`Ordering`.

    **Worked example: A2-6**, with the moves 0 to 5 = (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), all of
    length 1, which sweep nothing. Around the circle they are 5, 3, 1, 0, 2, 4.

    The order found is 2, 1, 5, 3, 4, 0: three moves a third of the circle apart rank before the three
    between them. What may follow the move 0, from p = (1, 0) over y = (0, 0) to z?

    - 0, to (-1, 0): no other two moves lead there. The pair (0, 0) is natural.
    - 2, to (0, -1): no single move leads there, but the pair (2, 0) does, over (1, -1), and 2 ranks before 0. It is
      an alternative that needs the cell (1, -1): (0, 2) is forced where (1, -1) is blocked. Likewise 1, where
      (0, 1) is blocked.
    - 4, to (1, -1): the single move 2 leads there at half the cost and needs no further cell. Such an
      alternative is legal wherever the pair is: (0, 4) is left out everywhere. Likewise 3 and 5.

    So the move 0 is followed naturally by itself alone: its level is 0, and the search jumps along it.
    Its guards are (1, -1) and (0, 1): while both are free, nothing is forced after it. The move 2 may
    be followed by itself and by its neighbours around the circle, 0 and 4: its level is 1, and
    no pair that begins with it can be forced. Hence a path in the open first takes its moves of 2, 1 or 5,
    then those of 0, 3 or 4, and there is one such path to every cell.
    """
    v, costs = np.frombuffer(moves, np.int64).reshape(-1, n), np.frombuffer(lengths, np.int64)
    count = len(v)
    order, natural = _order_of(moves, lengths, n)
    rank = np.empty(count, np.int64)
    rank[order] = np.arange(count)
    vectors = [tuple(move) for move in v.tolist()]
    reach = np.abs(np.array([*vectors, *(cell for cells in swept for cell in cells)])).max(axis=0)
    number = {move: k for k, move in enumerate(vectors)}
    table = _Table(vectors, number, costs.tolist(), rank.tolist(), swept, reach)

    guard_starts, guards = [0], []
    pair_starts, seconds = [0], []
    alternative_starts, cell_starts = [0], [0]
    cells: list[Vector] = []
    for d in range(count):
        forcible = []
        for e in order[~natural[d, order]].tolist():
            alternatives = _alternatives(d, e, table)
            if not alternatives[0].cells:
                continue  # legal wherever the pair is
            forcible.append(alternatives)
            seconds.append(e)
            for alternative in alternatives:
                cells += alternative.cells
                cell_starts.append(len(cells))
            alternative_starts.append(len(cell_starts) - 1)
        guards += _guards(forcible, reach)
        guard_starts.append(len(guards))
        pair_starts.append(len(seconds))
    out = Ordering(
        order=order,
        natural=_bits(natural),
        level=_levels(order, natural),
        guard_starts=np.array(guard_starts),
        guards=np.array(guards, dtype=np.int64).reshape(-1, n),
        pair_starts=np.array(pair_starts),
        seconds=np.array(seconds, dtype=np.int64),
        alternative_starts=np.array(alternative_starts),
        cell_starts=np.array(cell_starts),
        cells=np.array(cells, dtype=np.int64).reshape(-1, n),
    )
    for array in out:
        array.setflags(write=False)
    return out


def _alternatives(d: int, e: int, table: _Table) -> list[_Alternative]:
    """Return the alternatives of the pair (d, e), those that need the fewest cells first.

    All cells are relative to the middle of the pair. One that needs all that another needs, and
    more, is left out: it is never the only one that is free.
    """
    moves, number, costs, rank, swept, _ = table
    y = (0,) * len(moves[d])
    p, z = tuple(-x for x in moves[d]), moves[e]
    if p == z:
        return [_Alternative(y, [])]  # not to move at all
    found: list[_Alternative] = []
    total = costs[d] + costs[e]
    whole = number.get(plus(z, moves[d]))
    if whole is not None and costs[whole] <= total:
        found.append(_Alternative(p, [plus(p, s) for s in swept[whole]]))
    for f, first in enumerate(moves):
        middle = plus(p, first)
        g = number.get(tuple(b - a for a, b in zip(middle, z, strict=True)))
        if g is None or f == d:
            continue
        if costs[f] + costs[g] < total or (costs[f] + costs[g] == total and rank[f] < rank[d]):
            # The middle first: while it is free, what is swept around it lies inside the window's padding.
            needed = [middle, *(plus(p, s) for s in swept[f]), *(plus(middle, s) for s in swept[g])]
            found.append(_Alternative(middle, needed))
    known = {p, y, z, *(plus(p, s) for s in swept[d]), *swept[e]}
    found = [_Alternative(m, [c for c in dict.fromkeys(cells) if c not in known]) for m, cells in found]
    found.sort(key=lambda alternative: len(alternative.cells))
    kept: list[_Alternative] = []
    for alternative in found:
        if not any(set(other.cells) <= set(alternative.cells) for other in kept):
            kept.append(alternative)
    return kept


def _guards(forcible: list[list[_Alternative]], reach: IntArray) -> list[Vector]:
    """Return cells such that while all are free, one alternative of each pair is.

    Args:
        forcible: the alternatives of each pair with the same first move.
        reach: see :class:`_Table`; where a cell lies beyond it the alternative's middle is looked at before.
    """
    guards: dict[Vector, None] = {}
    options = [
        [[m, *cells] if (np.abs(cells) > reach).any() else cells for m, cells in alternatives]
        for alternatives in forcible
    ]
    # Of each pair the alternative that adds the fewest, so that few cells guard all.
    for cells_of in sorted(options, key=len):
        fewest = min(cells_of, key=lambda cells: len([c for c in cells if c not in guards]))
        guards.update(dict.fromkeys(fewest))
    return list(guards)


def _bits(natural: NDArray[np.bool_]) -> IntArray:
    """Return the rows of ``natural`` (K, K) as bits (K + 1,), with all of them for the start in the end."""
    count = len(natural)
    bits = [sum(1 << e for e in np.flatnonzero(row).tolist()) for row in natural]
    return np.array([*bits, (1 << count) - 1], dtype=np.int64)


def _levels(order: IntArray, natural: NDArray[np.bool_]) -> IntArray:
    """Return the level (K,) of each move, from the last rank up: natural pairs of different moves ascend in rank."""
    count = len(order)
    level = np.zeros(count, np.int64)
    for d in order[::-1].tolist():
        level[d] = max((level[e] + 1 for e in range(count) if natural[d, e] and e != d), default=0)
    return level
