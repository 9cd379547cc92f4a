"""Graphs as the arrays of numpy, the matrices of scipy and the graphs of networkx."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.text import quoted
from hexmap.base.values import integers
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox

if TYPE_CHECKING:
    import networkx
    import scipy.sparse

__all__ = ["ArrayViews", "free_of_blocked", "joined", "some_moves"]

_WIDEST = 2**31 - 1  # entries of a matrix that int32 numbers


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
    graph: ArrayViews, which: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return offsets, starts and swept cells, as the graph's attributes are, of some moves in another order."""
    starts, swept = joined([graph.swept[graph.swept_starts[k] : graph.swept_starts[k + 1]] for k in which])
    return graph.offsets[which], starts, swept


class ArrayViews:
    """What a :class:`~hexmap.graph.LatticeGraph` is to numpy, scipy and networkx; it says what each attribute is."""

    free: NDArray[np.uint8]
    size: int
    pad: NDArray[np.int64]
    lengths: NDArray[np.float64]
    offsets: NDArray[np.int64]
    swept_starts: NDArray[np.int64]
    swept: NDArray[np.int64]
    terrain: NDArray[np.float64] | None

    if TYPE_CHECKING:

        @property
        def box(self) -> IndexBox: ...  # noqa: D102
        def index_to_flat(self, index: ArrayLike) -> NDArray[np.int64]: ...  # noqa: D102
        def flat_to_index(self, flat: ArrayLike) -> NDArray[np.int32]: ...  # noqa: D102
        def centres(self, flat: ArrayLike) -> NDArray[np.float64]: ...  # noqa: D102

    def to_array(self, values: ArrayLike | None = None) -> NDArray[Any]:
        """Return a value a cell as an array (``inner_shape``) with an axis an index: ``array[cell - first]``.

        Args:
            values: (size,) by flat position, such as ``DistanceField.distance`` or :meth:`clearance`. None: which cells
                are blocked, what :meth:`from_array` takes.

        Raises:
            ArgumentError: not one value for each flat position.
        """
        array = self.free == 0 if values is None else np.asarray(values)
        if array.shape != (self.size,):
            raise ArgumentError(f"values by flat position are ({self.size},), not {array.shape}")
        return np.ascontiguousarray(self.box.without_padding(array, self.pad))

    def ids_to_cells(self, ids: ArrayLike | None = None) -> NDArray[np.int32]:
        """Return the free cells (M, n) with the numbers ``ids`` (M,), all of them where none are given.

        Free cells are numbered from 0 in the order of their indices: the rows and columns of :meth:`to_csr`.

        Raises:
            ArgumentError: not integers (M,), or no free cell has such a number.
        """
        nodes = np.flatnonzero(self.free)
        if ids is None:
            return self.flat_to_index(nodes)
        wanted = integers(ids)
        if wanted is None or wanted.ndim != 1 or ((wanted < 0) | (wanted >= len(nodes))).any():
            raise ArgumentError(f"the numbers of free cells are integers (M,) from 0 to {len(nodes) - 1}")
        return self.flat_to_index(nodes[wanted])

    def cells_to_ids(self, cells: ArrayLike) -> NDArray[np.int64]:
        """Return the number (M,) of each of ``cells`` (M, n), see :meth:`ids_to_cells`; -1 where it is not free.

        Examples:
            >>> from hexmap import LatticeGraph
            >>> graph = LatticeGraph.from_array([[0, 1], [0, 0]], "A2")
            >>> graph.cells_to_ids([[0, 0], [0, 1], [1, 1]]).tolist()
            [0, -1, 2]
            >>> graph.ids_to_cells([2]).tolist()
            [[1, 1]]
        """
        flat = self.index_to_flat(cells)
        nodes = np.flatnonzero(self.free)
        free = (flat >= 0) & (self.free[flat] != 0)
        return np.where(free, np.searchsorted(nodes, flat), -1)

    # ------------------------------------------------------------------ for other libraries

    def to_csr(self) -> tuple[scipy.sparse.csr_matrix, NDArray[np.int64]]:
        """Return the costs of all moves as a sparse matrix (M, M), and the flat positions (M,) of its free cells."""
        from scipy.sparse import csr_matrix

        from hexmap.graph import _kernels as kernels

        nodes = np.flatnonzero(self.free).astype(np.int64)
        # By flat offset, so that the columns of each row ascend, as scipy wants them.
        order = np.argsort(self.offsets)
        offsets, starts, swept = some_moves(self, order)
        rows = np.empty(len(nodes) + 1, np.int64)
        kernels.count_edges(self.free, nodes, offsets, starts, swept, rows)
        number = np.empty(self.size, np.int32)
        number[nodes] = np.arange(len(nodes), dtype=np.int32)
        wide = rows[-1] > _WIDEST
        columns = np.empty(rows[-1], np.int64 if wide else np.int32)
        costs = np.empty(rows[-1], np.float64)
        multipliers = np.empty(0) if self.terrain is None else self.terrain
        kernels.fill_edges(
            self.free, nodes, offsets, starts, swept, self.lengths[order], multipliers, number, columns, costs
        )
        rows = rows if wide else rows.astype(np.int32)
        return csr_matrix((costs, columns, rows), shape=(len(nodes), len(nodes))), nodes

    def to_networkx(self) -> networkx.Graph:
        """Return the graph for networkx: nodes are index tuples, ``weight`` is the cost of a move, metres.

        Each node has its centre, metres, as ``pos``, by which networkx draws it.

        Examples:
            >>> import numpy as np
            >>> from hexmap import LatticeGraph
            >>> graph = LatticeGraph.from_array(np.zeros((2, 2), bool), "Z2", 0.5).to_networkx()
            >>> graph.nodes[1, 0]["pos"], graph.edges[(0, 0), (1, 0)]["weight"]
            ((0.5, 0.0), 0.5)
        """
        import networkx as nx

        matrix, nodes = self.to_csr()
        names = [tuple(row) for row in self.flat_to_index(nodes).tolist()]
        edges = matrix.tocoo()
        once = edges.row < edges.col
        made = nx.Graph()
        made.add_nodes_from(
            (name, {"pos": tuple(centre)}) for name, centre in zip(names, self.centres(nodes).tolist(), strict=True)
        )
        made.add_weighted_edges_from(
            (names[a], names[b], c)
            for a, b, c in zip(
                edges.row[once].tolist(), edges.col[once].tolist(), edges.data[once].tolist(), strict=True
            )
        )
        return made
