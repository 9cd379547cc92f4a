"""Which moves are worth trying after which: pairs of moves that no cheapest path has in a row are left out.

Jump point search calls the moves that remain natural or forced neighbours (Harabor and Grastien, "Online graph
pruning for pathfinding on grid maps", 2011); here they follow from the moves, their lengths and the corner rule of
any lattice.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from hexmap.base.arrays import IntArray
from planners.search.offsets import Vector, offset_vectors, plus

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["onward_moves"]

_MOST_MOVES = 64  # of which every pair is looked at


def onward_moves(graph: LatticeGraph) -> tuple[IntArray, IntArray]:
    """Return the moves worth trying after each of the moves, and at the start, as starts (K + 2,) and moves.

    After the move k the move m is not, where a strictly shorter path leads from the cell before both to
    the cell after both through cells that are free if k and m are allowed: no cheapest path has
    the two in a row. Terrain could make the shorter path dearer: with it all are tried.
    """
    moves = len(graph.moves)
    if graph.terrain is not None or moves > _MOST_MOVES:
        return np.arange(moves + 2, dtype=np.int64) * moves, np.tile(np.arange(moves, dtype=np.int64), moves + 1)
    swept = offset_vectors(graph.swept, graph.pad, graph.shape, graph.strides)
    return _onward(
        tuple(map(tuple, graph.moves.tolist())),
        tuple(graph.lengths.tolist()),
        tuple(map(tuple, swept.tolist())),
        tuple(graph.swept_starts.tolist()),
    )


@lru_cache(maxsize=64)
def _onward(
    moves: tuple[Vector, ...], lengths: tuple[float, ...], swept: tuple[Vector, ...], starts: tuple[int, ...]
) -> tuple[IntArray, IntArray]:
    """Return what :func:`onward_moves` does, once for equal moves."""
    number = {move: k for k, move in enumerate(moves)}
    sweeps = [swept[starts[k] : starts[k + 1]] for k in range(len(moves))]

    def length(a: Vector, b: Vector, free: set[Vector]) -> float:
        """Return the length of the move from a to b, infinite if there is none or it is not known to be free."""
        k = number.get(tuple(y - x for x, y in zip(a, b, strict=True)))
        if k is None or not all(plus(a, s) in free for s in sweeps[k]):
            return math.inf
        return lengths[k]

    rows: list[list[int]] = []
    for k, first in enumerate(moves):
        rows.append([])
        origin = (0,) * len(first)
        for m, second in enumerate(moves):
            end = plus(first, second)
            # All that is known to be free where both moves are allowed; the shorter path needs no other cell.
            free = {origin, first, end, *sweeps[k], *(plus(first, s) for s in sweeps[m])}
            least = min(length(origin, c, free) + (0.0 if c == end else length(c, end, free)) for c in free - {origin})
            if end != origin and least >= (lengths[k] + lengths[m]) * (1.0 - 1e-9):
                rows[-1].append(m)
    rows.append(list(range(len(moves))))
    onward_starts = np.cumsum([0, *map(len, rows)]).astype(np.int64)
    onward = np.array([m for row in rows for m in row], dtype=np.int64)
    return onward_starts, onward
