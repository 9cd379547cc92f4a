"""Costs and a heuristic in whole numbers: no sum has a rounding error, and equal costs are equal."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import IntArray
from planners.search.heuristics import gauge_planes

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

__all__ = ["WholeCosts", "whole_costs"]

# Lengths are rounded as in A*, to this fraction of the shortest, so that both tell the same paths apart.
_LENGTH_STEPS = 2.0**36
_MOST_COST = 2**61  # of a path; keys are sums of three costs and fit into int64
_MOST_MULTIPLE = 1 << 10  # of lengths, that makes the heuristic's planes whole numbers


class WholeCosts(NamedTuple):
    """Costs of the K moves of a graph in whole units, for terrain from a least to a greatest multiplier.

    Attributes:
        lengths: (K,) int64 the least that each move costs.
        scaled: (K,) float64 what it costs on a terrain of one.
        planes: (F, n) int64 facets of the gauge of ``lengths``, one of each opposite pair.
        steps: (K + 1, F) int64 products of the moves with the planes, the last row zero.
    """

    lengths: IntArray
    scaled: NDArray[np.float64]
    planes: IntArray
    steps: IntArray


def whole_costs(graph: LatticeGraph, least: float, most: float) -> WholeCosts:
    """Return the costs of a graph's moves where the terrain is nowhere below ``least`` nor above ``most``.

    The unit is the finest of which the sum over all cells fits into 61 bits.
    """
    planes = gauge_planes(graph.moves, graph.lengths)
    cheapest = graph.lengths * least
    unit = 2.0 ** np.floor(np.log2(cheapest.min() / _LENGTH_STEPS))
    worst = float(graph.lengths.max()) * most * graph.size
    while True:
        steps = [int(v) for v in np.rint(cheapest / unit)]
        multiple, whole = _whole_planes(graph.moves, steps, planes)
        if worst / unit * multiple < _MOST_COST:
            break
        unit *= 2.0
    heuristic_steps = np.zeros((len(graph.moves) + 1, len(whole)), np.int64)
    heuristic_steps[:-1] = graph.moves @ whole.T
    lengths = np.array(steps, dtype=np.int64) * multiple
    return WholeCosts(lengths, graph.lengths * (multiple / unit), whole, heuristic_steps)


def _whole_planes(moves: IntArray, steps: list[int], planes: NDArray[np.float64]) -> tuple[int, IntArray]:
    """Return a multiple m, and planes (F, n) of whole numbers that span the gauge of the moves / (m * steps).

    ``steps`` are the moves' costs in whole numbers. A facet is solved for from the moves that span it,
    exactly; then the estimate is consistent without an allowance, and of equal f on a straight path
    none is a little larger than the other.

    Args:
        moves: (K, n) index offsets.
        steps: (K,) their costs.
        planes: (F, n) the facets in floats, in any unit of cost for which moves on a facet meet it.
    """
    n = moves.shape[1]
    costs = np.maximum(np.array(steps, dtype=np.float64), 1.0)  # of a unit that is too coarse some are 0
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
        for fraction in (Fraction(1), 1 - Fraction(1, 2**30), 1 - Fraction(1, 2**20)):
            row = [round(x * multiple * fraction) for x in plane]
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
