"""Graphs as the arrays of numpy, the matrices of scipy and the graphs of networkx."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.text import quoted
from hexmap.lattice.lattice import Lattice

if TYPE_CHECKING:
    import networkx
    import scipy.sparse

__all__ = ["FreeCells", "as_networkx", "costs_as_csr", "free_of_blocked", "joined", "some_moves"]

_WIDEST = 2**31 - 1  # entries of a matrix that int32 numbers


class FreeCells(Protocol):
    """What is needed of a :class:`~hexmap.graph.LatticeGraph`, which says what each of these is."""

    free: NDArray[np.uint8]
    offsets: NDArray[np.int64]
    swept_starts: NDArray[np.int64]
    swept: NDArray[np.int64]
    size: int

    def flat_to_index(self, flat: ArrayLike) -> NDArray[np.int32]:
        """Return the indices (M, n) of flat positions (M,)."""

    def centres(self, flat: ArrayLike) -> NDArray[np.float64]:
        """Return the centres (M, n), metres, of the cells at flat positions (M,)."""


def free_of_blocked(blocked: ArrayLike, lattice: Lattice) -> NDArray[np.bool_]:
    """Return which cells of an array are free, of one that says which are blocked.

    Raises:
        ArgumentError: not booleans or integers, or not as many axes as the lattice has dimensions.
    """
    try:
        array = np.asarray(blocked)
    except ValueError as error:  # rows of different lengths
        raise ArgumentError(f"an array of blocked cells has rows of one length, not {quoted(blocked)}") from error
    if array.dtype.kind not in "biu":
        raise ArgumentError(f"an array of blocked cells is of booleans or integers, not {array.dtype}")
    if array.ndim != lattice.dim or array.size == 0:
        raise ArgumentError(
            f"an array of blocked cells of {lattice.name} has {lattice.dim} axes and a cell at least, not {array.shape}"
        )
    return np.asarray(array == 0)


def joined(lists: list[NDArray[np.int64]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return where each list begins in all of them one after the other (K + 1,), and these (S,)."""
    starts = np.concatenate([[0], np.cumsum([len(s) for s in lists])]).astype(np.int64)
    return starts, np.ascontiguousarray(np.concatenate(lists), dtype=np.int64)


def some_moves(
    graph: FreeCells, which: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return offsets, starts and swept cells, as the graph's attributes are, of some moves in another order."""
    starts, swept = joined([graph.swept[graph.swept_starts[k] : graph.swept_starts[k + 1]] for k in which])
    return graph.offsets[which], starts, swept


def costs_as_csr(
    graph: FreeCells, lengths: NDArray[np.float64], terrain: NDArray[np.float64] | None
) -> tuple[scipy.sparse.csr_matrix, NDArray[np.int64]]:
    """Return the costs of all moves as a sparse matrix (M, M), and the flat positions (M,) of the free cells."""
    from scipy.sparse import csr_matrix

    from hexmap.graph import _kernels as kernels

    nodes = np.flatnonzero(graph.free).astype(np.int64)
    # By flat offset, so that the columns of each row ascend, as scipy wants them.
    order = np.argsort(graph.offsets)
    offsets, starts, swept = some_moves(graph, order)
    rows = np.empty(len(nodes) + 1, np.int64)
    kernels.count_edges(graph.free, nodes, offsets, starts, swept, rows)
    number = np.empty(graph.size, np.int32)
    number[nodes] = np.arange(len(nodes), dtype=np.int32)
    wide = rows[-1] > _WIDEST
    columns = np.empty(rows[-1], np.int64 if wide else np.int32)
    costs = np.empty(rows[-1], np.float64)
    multipliers = np.empty(0) if terrain is None else terrain
    kernels.fill_edges(
        graph.free, nodes, offsets, starts, swept, lengths[order], multipliers, number, columns, costs
    )
    rows = rows if wide else rows.astype(np.int32)
    return csr_matrix((costs, columns, rows), shape=(len(nodes), len(nodes))), nodes


def as_networkx(graph: FreeCells, matrix: scipy.sparse.csr_matrix, nodes: NDArray[np.int64]) -> networkx.Graph:
    """Return the graph of a matrix of costs between the cells at flat positions (M,): see ``to_networkx``."""
    import networkx as nx

    names = [tuple(row) for row in graph.flat_to_index(nodes).tolist()]
    edges = matrix.tocoo()
    once = edges.row < edges.col
    made = nx.Graph()
    made.add_nodes_from(
        (name, {"pos": tuple(centre)}) for name, centre in zip(names, graph.centres(nodes).tolist(), strict=True)
    )
    made.add_weighted_edges_from(
        (names[a], names[b], c)
        for a, b, c in zip(
            edges.row[once].tolist(), edges.col[once].tolist(), edges.data[once].tolist(), strict=True
        )
    )
    return made
