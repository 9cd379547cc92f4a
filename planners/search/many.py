"""Many queries on one graph, in threads."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.errors import ArgumentError
from planners.path import NoPath, Path
from planners.search.astar import astar
from planners.search.heuristics import least_terrain

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph


def plan_many(
    graph: LatticeGraph,
    starts: ArrayLike,
    goals: ArrayLike,
    workers: int | None = None,
    *,
    planner: Callable[[LatticeGraph, ArrayLike, ArrayLike], Path] = astar,
) -> list[Path | NoPath]:
    """Return the paths from each of ``starts`` (Q, n) to each of ``goals`` (Q, n), in their order.

    Where there is no path, its entry holds the :class:`NoPath` that says why. The queries run in
    threads, which the kernels do not block; all but ``seconds`` is the same for any number of them.

    Args:
        graph: where to go.
        starts: cells' indices.
        goals: cells' indices, as many.
        workers: threads; None for as many as there are processors.
        planner: what answers one query.

    Raises:
        ArgumentError: shapes that do not fit, or no worker.
    """
    a, b = np.asarray(starts), np.asarray(goals)
    if a.shape != b.shape or a.ndim != 2:
        raise ArgumentError(f"queries need starts and goals of the same shape (Q, n), not {a.shape} and {b.shape}")
    workers = (os.cpu_count() or 1) if workers is None else workers
    if workers < 1:
        raise ArgumentError(f"queries need at least one worker, not {workers}")
    # Computed once, before the threads would each do it.
    least_terrain(graph)
    if len(a):
        graph.components()

    def one(query: int) -> Path | NoPath:
        try:
            return planner(graph, a[query], b[query])
        except NoPath as error:
            return error

    if workers == 1 or len(a) < 2:
        return [one(q) for q in range(len(a))]
    # The first one alone: it compiles the kernels.
    first = one(0)
    with ThreadPoolExecutor(max_workers=workers) as pool:
        return [first, *pool.map(one, range(1, len(a)))]
