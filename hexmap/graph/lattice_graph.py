"""The graph layer: which cells of a window are free, and which moves there are between them.

The graph is implicit. A window of cell states lies flat in memory with a blocked padding around it,
and the moves are constant flat offsets, so that a search needs neither an edge list nor a bounds
check: ``at + offsets[k]`` is the neighbour, and ``free`` says whether one may enter it.

**Corner rule.** A move is allowed where its two ends and every cell that it sweeps are free. It
sweeps every cell whose *closed* Voronoi cell meets the straight line between the two centres, also
in a single corner or along an edge. Moves across a face sweep nothing else, for the middle of such
a move lies inside the face. The diagonal of a square needs both side cells, the long diagonal of a
cube all eight cubes around the corner that it goes through; long steps of A2, D3 and all other
lattices follow from the same sentence.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.pictures import drawing, picture_html
from hexmap.base.values import integers
from hexmap.graph.arrays import ArrayViews, free_of_blocked, joined, some_moves
from hexmap.graph.bodies import Boxes
from hexmap.graph.clearance import Clearance, To, check_to
from hexmap.graph.moves import SAME_LENGTH, Neighbourhood, lengths_of, moves_of, swept_by_moves, swept_cells
from hexmap.graph.obstacles import BlockedCells, ListedCells
from hexmap.graph.window import CHUNK, Layout, cells_in_box, window_of_box
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox, strides
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MAX_CELLS", "LatticeGraph", "Neighbourhood", "swept_cells"]

MAX_CELLS = 2_000_000_000
_FLAT_LIMIT = 2**31 - 1  # labels and parents of a search are int32


def _window_numbers(lattice: Lattice, first: ArrayLike, inner_shape: ArrayLike) -> tuple[list[int], list[int]]:
    """Return the first index and the sizes of a window as Python's integers, which do not overflow.

    Raises:
        ArgumentError: they are not integers, not as many as the lattice has dimensions, or a size is below 1.
    """
    n = lattice.dim
    try:
        inner = [operator.index(s) for s in np.asarray(inner_shape).ravel()]
        start = [operator.index(s) for s in np.asarray(first).ravel()]
    except TypeError as error:
        raise ArgumentError(f"a window takes integers, not {first!r} and {inner_shape!r}") from error
    if len(inner) != n or len(start) != n or min(inner) < 1:
        raise ArgumentError(f"a window on {lattice.name} takes {n} indices and {n} sizes of at least 1, not {inner}")
    return start, inner


def _checked_size(inner: list[int], shape: list[int], most: int) -> int:
    """Return the number of cells of a window of ``shape``, padding included, before anything is allocated.

    Raises:
        ArgumentError: it is larger than ``most``.
    """
    size = math.prod(shape)
    if size > most:
        raise ArgumentError(
            f"a window of {' x '.join(map(str, inner))} cells is {size} with its padding "
            f"({size / 2**30:.1f} GiB); at most {most} are allowed: "
            "choose a smaller box or a coarser resolution"
        )
    return size


def _answers(name: str, asked: Callable[..., Any], points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return what a user's function says of points (N, n), as (N,) booleans."""
    answer = np.asarray(asked(points))
    if answer.shape != (len(points),):
        raise ArgumentError(f"{name} must answer {len(points)} points, not with an array {answer.shape}")
    return answer.astype(np.bool_)


class LatticeGraph(ArrayViews):
    """The free cells of a window and the moves between them; immutable by convention.

    Make one with the functions ``from_...`` and :meth:`rasterise`. A move costs its length, times
    the mean of the terrain multipliers of its two ends where there are any.

    Attributes:
        lattice: the lattice of the cells.
        moves: (K, n) int64 offsets of the neighbourhood, by length, then index.
        lengths: (K,) float64 length of each move, metres.
        low: (n,) int64 index of the window's first cell, padding included.
        shape: (n,) int64 cells along each index, padding included.
        pad: (n,) int64 width of the padding on either side.
        strides: (n,) int64 what one step along each index adds to a flat position (row-major).
        size: number of cells, padding included.
        free: (size,) uint8, 1 for free, 0 for blocked cells and the padding.
        offsets: (K,) int64 flat offsets of the moves.
        swept_starts: (K + 1,) int64; move k sweeps ``swept[swept_starts[k] : swept_starts[k + 1]]``.
        swept: (S,) int64 flat offsets, from the start of a move, of the further cells that must be free.
        terrain: (size,) float64 positive multipliers of cost, or None. Cells that are not free hold
            the least multiplier of the free ones, so that ``terrain.min()`` is a bound.
        equal_edges: whether all lengths are equal (the terrain not considered).

    Examples:
        >>> import numpy as np
        >>> from hexmap import Lattice
        >>> from hexmap.graph import LatticeGraph
        >>> graph = LatticeGraph.from_states(Lattice.named("A2"), [0, 0], np.ones((3, 3), np.uint8))
        >>> graph.neighbours([0, 0]).tolist()
        [[0, 1], [1, 0]]
    """

    def __init__(
        self,
        lattice: LatticeLike,
        first: ArrayLike,
        inner_shape: ArrayLike,
        neighbourhood: Neighbourhood = None,
        max_cells: int = MAX_CELLS,
    ) -> None:
        """Make a window of blocked cells: ``inner_shape`` (n,) of them from the index ``first`` (n,) on.

        Raises:
            ArgumentError: the window has no cell or more than ``max_cells`` with its padding, or
                there is no such neighbourhood.
            BoundsError: the window leaves the range of indices.
        """
        self.lattice = lattice = as_lattice(lattice)
        start, inner = _window_numbers(lattice, first, inner_shape)
        self.moves = moves_of(lattice, neighbourhood)
        self.lengths = lengths_of(lattice, self.moves)
        swept = swept_by_moves(lattice, self.moves)
        # Wide enough that neither a move, what it sweeps nor a face leads from a cell inside out of the array.
        reach = np.concatenate([self.moves, lattice.faces, *swept])
        self.pad = np.abs(reach).max(axis=0).astype(np.int64)
        shape = [s + 2 * int(p) for s, p in zip(inner, self.pad, strict=True)]
        self.size = _checked_size(inner, shape, min(max_cells, _FLAT_LIMIT))
        ends = [start, [a + s - 1 for a, s in zip(start, inner, strict=True)]]
        lattice.check_index(np.array(ends, dtype=object).clip(-(2**62), 2**62).astype(np.int64))
        self.shape = np.array(shape, dtype=np.int64)
        self.low = np.array(start, dtype=np.int64) - self.pad
        self.strides = strides(self.shape)
        self.offsets = self.moves @ self.strides
        self.swept_starts, self.swept = joined([s @ self.strides for s in swept])
        self.free = np.zeros(self.size, np.uint8)
        self.terrain: NDArray[np.float64] | None = None
        self.equal_edges = bool(np.ptp(self.lengths) <= SAME_LENGTH * self.lengths.max())
        self._clearance = Clearance(BlockedCells(self.free))
        self._labels: NDArray[np.int32] | None = None

    # ------------------------------------------------------------------ where graphs come from

    @classmethod
    def from_map(
        cls,
        map: Map,
        *,
        level: int = 0,
        rule: StateRule | None = None,
        unknown: Literal["blocked", "free"] = "blocked",
        neighbourhood: Neighbourhood = None,
        max_cells: int = MAX_CELLS,
    ) -> LatticeGraph:
        """Make the graph of a level of a map, by the map's rule of what is free and what occupied.

        Args:
            map: the map.
            level: which level, 0 is the finest.
            rule: what a cell is, from its hits and passes.
            unknown: what cells are that are neither. "free" reaches as far as the box (in metres) of
                the centres of all known cells, whatever the lattice's basis.
            neighbourhood: None for ``lattice.neighbours``, or nearest, faces, extended, or a size.
            max_cells: how large a window may be, padding included.

        Clearance is measured from the occupied cells alone, not from unknown ones.

        Raises:
            ArgumentError: the level has no known cell, the window is too large, or an option is none.
        """
        if unknown not in ("blocked", "free"):
            raise ArgumentError(f"unknown cells are blocked or free, not {unknown!r}")
        states = map.state(rule, level)
        known = np.concatenate([states.occupied.index, states.free.index]).astype(np.int64)
        if len(known) == 0:
            raise ArgumentError(f"level {level} of the map has no cell that is free or occupied")
        lattice = states.occupied.lattice
        if unknown == "free":
            centres = lattice.centres(known)
            slack = 1e-9 * lattice.resolution
            low, high = centres.min(axis=0) - slack, centres.max(axis=0) + slack
            graph = cls._of_box(lattice, window_of_box(lattice, low, high), neighbourhood, max_cells)
            for flat, _ in cells_in_box(graph, low, high):
                graph.free[flat] = 1
            graph.free[graph.index_to_flat(states.occupied.index)] = 0
        else:
            graph = cls._of_box(lattice, IndexBox.of_cells(known), neighbourhood, max_cells)
            graph.free[graph.index_to_flat(states.free.index)] = 1
        graph._clearance = Clearance(ListedCells(states.occupied.index.astype(np.int64)))
        return graph

    @classmethod
    def from_voxels(
        cls,
        occupied: VoxelList,
        low_index: ArrayLike,
        high_index: ArrayLike,
        *,
        neighbourhood: Neighbourhood = None,
        max_cells: int = MAX_CELLS,
    ) -> LatticeGraph:
        """Make the graph of a box of indices, ``low_index`` to ``high_index`` (n,) both included.

        All its cells are free but the ``occupied`` ones. Clearance is measured from all occupied
        cells, also from those outside the box.

        Raises:
            ArgumentError: the box is empty or too large.
            BoundsError: it leaves the range of indices.
        """
        lattice = occupied.lattice
        low, high = integers(low_index), integers(high_index)
        if (
            low is None
            or high is None
            or low.shape != (lattice.dim,)
            or high.shape != (lattice.dim,)
            or (low > high).any()
        ):
            raise ArgumentError(f"a box of cells takes two corners of {lattice.dim} integers, the low one first")
        # Python's integers: the box may span all of int64.
        inner = [int(b) - int(a) + 1 for a, b in zip(low, high, strict=True)]
        graph = cls(lattice, low, np.array(inner, dtype=object), neighbourhood, max_cells)
        graph.inner_states()[...] = 1
        flat = graph.index_to_flat(occupied.index)
        graph.free[flat[flat >= 0]] = 0
        graph._clearance = Clearance(ListedCells(occupied.index.astype(np.int64)))
        return graph

    @classmethod
    def from_cells(
        cls, free: VoxelList, *, neighbourhood: Neighbourhood = None, max_cells: int = MAX_CELLS
    ) -> LatticeGraph:
        """Make the graph of the cells in a list; all others are blocked, and clearance is measured from them.

        Raises:
            ArgumentError: the list is empty, or its box too large.
        """
        if len(free) == 0:
            raise ArgumentError("a graph needs at least one cell, and the list is empty")
        index = free.index.astype(np.int64)
        graph = cls._of_box(free.lattice, IndexBox.of_cells(index), neighbourhood, max_cells)
        graph.free[graph.index_to_flat(index)] = 1
        graph._clearance = Clearance(BlockedCells(graph.free, outside=True))
        return graph

    @classmethod
    def from_array(
        cls,
        blocked: ArrayLike,
        lattice: LatticeLike,
        resolution: float | None = None,
        *,
        first: ArrayLike | None = None,
        neighbourhood: Neighbourhood = None,
        max_cells: int = MAX_CELLS,
    ) -> LatticeGraph:
        """Make the graph of an array that says which cells are blocked, with an axis for each index of the lattice.

        ``blocked[i, j]`` (``[i, j, k]`` in space) is the cell ``first + (i, j)``, whose centre lies at
        ``lattice.basis @ (first + (i, j))`` metres. So on squares the first axis runs along x and the second along y:
        of a picture, whose rows run downwards, take ``picture[::-1].T``. On hexagons the array covers a parallelogram:
        the second axis runs along y, the first 30 degrees above x. A map in squares is laid over any lattice, in
        metres, by :meth:`GridMap.to_graph <hexmap.io.grids.GridMap.to_graph>`. :meth:`to_array` gives the array back.

        Clearance is measured from the array's blocked cells; what lies outside it is no obstacle.

        Args:
            blocked: booleans or integers; what is not 0 is blocked.
            lattice: a lattice of as many dimensions as the array, the name of one, or a basis.
            resolution: of its cells, metres; see :func:`~hexmap.lattice.as_lattice`.
            first: index (n,) of the array's first cell, 0 where none is given.
            neighbourhood: None for ``lattice.neighbours``, or nearest, faces, extended, or a size.
            max_cells: how large a window may be, padding included.

        Raises:
            ArgumentError: not an array of that kind, or too large.
            BoundsError: the array leaves the range of indices.

        Examples:
            >>> import numpy as np
            >>> from hexmap import LatticeGraph
            >>> from planners import astar
            >>> blocked = np.zeros((5, 5), bool)
            >>> blocked[2, :4] = True                         # a wall, open at its end
            >>> graph = LatticeGraph.from_array(blocked, "Z2", neighbourhood=8)
            >>> astar(graph, [0, 0], [4, 0])
            Path(11 cells, 10.8284 m, cost 10.8284)
            >>> bool((graph.to_array() == blocked).all())
            True
        """
        on = as_lattice(lattice, resolution)
        free = free_of_blocked(blocked, on)
        start = np.zeros(on.dim, np.int64) if first is None else first
        return cls.from_states(on, start, free, neighbourhood=neighbourhood, max_cells=max_cells)

    @classmethod
    def from_states(
        cls,
        lattice: LatticeLike,
        low: ArrayLike,
        free: ArrayLike,
        *,
        neighbourhood: Neighbourhood = None,
        max_cells: int = MAX_CELLS,
    ) -> LatticeGraph:
        """Make the graph of an array with a dimension an index: true or 1 for free, ``low`` (n,) its first cell.

        Clearance is measured from the array's blocked cells; what lies outside it is no obstacle.

        Raises:
            ArgumentError: not an array of that kind, or too large.
            BoundsError: the array leaves the range of indices.
        """
        lattice = as_lattice(lattice)
        states = np.asarray(free)
        if states.ndim != lattice.dim or states.dtype not in (np.dtype(np.uint8), np.dtype(np.bool_)):
            raise ArgumentError(
                f"states must be uint8 or bool with {lattice.dim} dimensions, not {states.dtype} {states.shape}"
            )
        graph = cls(lattice, low, states.shape, neighbourhood, max_cells)
        np.not_equal(states, 0, out=graph.inner_states(), casting="unsafe")
        return graph

    @classmethod
    def rasterise(
        cls,
        free_at: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
        lattice: LatticeLike,
        low_metres: ArrayLike,
        high_metres: ArrayLike,
        *,
        neighbourhood: Neighbourhood = None,
        max_cells: int = MAX_CELLS,
        occupied_at: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None,
        boxes: Callable[[], Boxes] | None = None,
    ) -> LatticeGraph:
        """Make the graph of anything that can tell whether a point is free, by the cells' centres.

        Args:
            free_at: takes points (N, n), metres, and tells for each whether it is free.
            lattice: the lattice to rasterise onto, its name or its basis.
            low_metres: low corner (n,) of the box, metres.
            high_metres: high corner. Cells whose centre is not in the box (corners included) are blocked.
            neighbourhood: None for ``lattice.neighbours``, or nearest, faces, extended, or a size.
            max_cells: how large a window may be, padding included.
            occupied_at: tells for each of the same points whether it is an obstacle, where not all
                that is blocked is one (unknown cells, say).
            boxes: makes the squares or cubes that the obstacles truly are, where there are any; then
                clearance "to the cell" is that to these.

        Clearance is measured from the blocked cells whose centre is in the box; from those of which
        ``occupied_at`` says so, blocked or not, where it is given.

        Raises:
            ArgumentError: the box holds no centre or is too large, or ``free_at`` or ``occupied_at``
                returns something else.
            BoundsError: the box leaves the range of indices.
        """
        low, high = np.array(low_metres, dtype=np.float64), np.array(high_metres, dtype=np.float64)
        lattice = as_lattice(lattice)
        n = lattice.dim
        if low.shape != (n,) or high.shape != (n,) or not (np.isfinite([low, high]).all() and (low <= high).all()):
            raise ArgumentError(f"a box in dimension {n} takes two corners of {n} finite numbers, the low one first")
        graph = cls._of_box(lattice, window_of_box(lattice, low, high), neighbourhood, max_cells)
        states = graph.free if occupied_at is None else np.ones(graph.size, np.uint8)
        centres = 0
        for flat, points in cells_in_box(graph, low, high):
            graph.free[flat] = _answers("free_at", free_at, points)
            if occupied_at is not None:
                states[flat] = ~_answers("occupied_at", occupied_at, points)
            centres += len(flat)
        if centres == 0:
            raise ArgumentError(f"no centre of a cell lies in the box {low.tolist()} to {high.tolist()}")
        graph._clearance = Clearance(BlockedCells(states, (low, high)), boxes)
        return graph

    @classmethod
    def _of_box(cls, lattice: Lattice, box: IndexBox, neighbourhood: Neighbourhood, max_cells: int) -> LatticeGraph:
        """Make a blocked window of the cells of a box."""
        return cls(lattice, box.low, box.shape, neighbourhood, max_cells)

    def with_free(self, free: NDArray[np.uint8]) -> LatticeGraph:
        """Return the same window with other free cells: ``free`` (size,) as in :attr:`free`, 0 in the padding.

        What clearance is measured from stays as it is.

        Raises:
            ArgumentError: the array is not (size,) uint8.
        """
        if free.shape != (self.size,) or free.dtype != np.uint8:
            raise ArgumentError(f"the free cells must be ({self.size},) uint8, not {free.shape} {free.dtype}")
        return self._derived(free, self.terrain)

    def _derived(self, free: NDArray[np.uint8] | None, terrain: NDArray[np.float64] | None) -> LatticeGraph:
        """Return the same window with other states or another terrain."""
        graph = object.__new__(type(self))
        graph.__dict__.update(self.__dict__)
        graph.terrain = terrain
        if free is not None:
            graph.free = free
            graph._labels = None
        return graph

    # ------------------------------------------------------------------ cells

    @property
    def first(self) -> NDArray[np.int64]:
        """(n,) index of the first cell inside the padding."""
        return self.low + self.pad

    @property
    def inner_shape(self) -> NDArray[np.int64]:
        """(n,) cells along each index, without the padding."""
        return self.shape - 2 * self.pad

    @cached_property
    def box(self) -> IndexBox:
        """The box of all cells, padding included."""
        return IndexBox(self.low, self.shape)

    @cached_property
    def inner_box(self) -> IndexBox:
        """The box of the cells inside the padding."""
        return IndexBox(self.first, self.inner_shape)

    @cached_property
    def layout(self) -> Layout:
        """How the cells lie in memory, for kernels."""
        return Layout(self.first, self.inner_shape, self.pad, self.strides)

    def inner_states(self) -> NDArray[np.uint8]:
        """Return the states without the padding, as a view with a dimension an index."""
        return self.box.without_padding(self.free, self.pad)

    def index_to_flat(self, index: ArrayLike) -> NDArray[np.int64]:
        """Return the flat positions (M,) of cells (M, n); -1 outside the window and in its padding."""
        i = np.asarray(index)
        if i.size == 0 and i.ndim != 2:
            i = np.empty((0, self.lattice.dim), np.int64)
        if i.ndim != 2 or i.shape[1] != self.lattice.dim or not np.issubdtype(i.dtype, np.integer):
            raise ArgumentError(f"indices must be integers (M, {self.lattice.dim}), not {i.dtype} {i.shape}")
        inside = self.inner_box.contains(i)
        # Indices far outside may be beyond the range in which positions can be computed.
        return np.where(inside, self.box.flat(np.where(inside[:, None], i, self.low)), -1)

    def flat_to_index(self, flat: ArrayLike) -> NDArray[np.int32]:
        """Return the indices (M, n) int32 of flat positions (M,).

        Raises:
            ArgumentError: a position is outside the array.
        """
        f = np.asarray(flat)
        if f.ndim != 1 or (f.size and (not np.issubdtype(f.dtype, np.integer) or f.min() < 0 or f.max() >= self.size)):
            raise ArgumentError(f"flat positions must be integers (M,) from 0 to {self.size - 1}")
        return np.asarray(self.box.index(f.astype(np.int64)), dtype=np.int32)

    def centres(self, flat: ArrayLike) -> NDArray[np.float64]:
        """Return the centres (M, n), metres, of the cells at flat positions (M,)."""
        return self.lattice.centres(self.flat_to_index(flat))

    def neighbours(self, node: ArrayLike) -> NDArray[np.int32]:
        """Return the cells (M, n) that one move leads to from the cell ``node`` (n,), in the order of ``moves``.

        None from a cell that is blocked or outside the window.
        """
        index = np.asarray(node)
        flat = self._flat_of(index)
        if flat < 0 or not self.free[flat]:
            return np.empty((0, self.lattice.dim), np.int32)
        from hexmap.graph import _kernels as kernels

        allowed = np.empty(len(self.moves), np.bool_)
        kernels.open_moves(self.free, flat, self.offsets, self.swept_starts, self.swept, allowed)
        return np.asarray(index.astype(np.int64) + self.moves[allowed], dtype=np.int32)

    def _flat_of(self, node: ArrayLike) -> int:
        """Return the flat position of one cell (n,), -1 outside the window."""
        index = np.asarray(node)
        if index.shape != (self.lattice.dim,):
            raise ArgumentError(f"a cell of {self.lattice.name} is {self.lattice.dim} integers, not {node!r}")
        return int(self.index_to_flat(index[None])[0])

    @property
    def memory(self) -> int:
        """Bytes of the states, the terrain and the labels that have been computed."""
        arrays = [self.free, self.terrain, self._labels, self.moves, self.lengths, self.offsets, self.swept]
        return sum(a.nbytes for a in arrays if a is not None)

    @property
    def least_terrain(self) -> float:
        """The least multiplier of cost of any free cell: 1 without terrain."""
        return 1.0 if self.terrain is None else float(self.terrain.min())

    def __repr__(self) -> str:
        """Show the window and the lattice."""
        inner = " x ".join(str(int(s)) for s in self.inner_shape)
        return f"<LatticeGraph of {inner} cells and {len(self.moves)} moves on {self.lattice!r}>"

    def plot(self, ax: Axes | None = None, *, height: float | None = None) -> Axes:
        """Draw the free cells and what blocks them on axes of matplotlib, in metres: white and grey.

        Args:
            ax: axes to draw on; new ones where none are given.
            height: of the horizontal cut through a graph in space, metres; that of its middle where none is given.

        Returns:
            The axes.

        Raises:
            ArgumentError: a height that is not finite, or of a graph in the plane.
        """
        return drawing().plot_graph(self, ax, height=height)

    def _repr_html_(self) -> str:
        """Show a small picture in a notebook."""
        return picture_html(self)

    # ------------------------------------------------------------------ what is connected

    def components(self) -> NDArray[np.int32]:
        """Return the number (size,) of the component that each cell belongs to, from 0; -1 where it is not free.

        Two cells are in the same component where a chain of allowed moves joins them. Computed once.
        """
        if self._labels is None:
            from hexmap.graph import _kernels as kernels

            labels = np.empty(self.size, np.int32)
            kernels.label(self.free, *some_moves(self, np.flatnonzero(self.offsets < 0)), labels)
            self._labels = labels
        return self._labels

    @property
    def known_components(self) -> NDArray[np.int32] | None:
        """What :meth:`components` has returned, or None while nobody has asked."""
        return self._labels

    def connected(self, a: ArrayLike, b: ArrayLike) -> bool:
        """Tell whether moves lead from the cell ``a`` (n,) to ``b`` (n,); never where one of them is not free."""
        at, to = self._flat_of(a), self._flat_of(b)
        if at < 0 or to < 0:
            return False
        labels = self.components()
        return bool(labels[at] >= 0 and labels[at] == labels[to])

    # ------------------------------------------------------------------ clearance

    def obstacles(self) -> NDArray[np.int64]:
        """Return the cells (M, n) that clearance is measured from.

        All occupied cells of a map or a list of voxels; of blocked cells only those on the surface,
        which are the ones that can be nearest. Graphs made from this one by ``with_...`` keep them. In
        a graph of a :class:`~hexmap.io.grids.GridMap` clearance "to the cell" is measured from the
        grid's own cells instead.
        """
        return self._clearance.cells(self)

    def _inner_flat(self) -> NDArray[np.int64]:
        """Return the flat positions of all cells inside the padding."""
        flat = np.zeros(1, np.int64)
        for p, s, stride in zip(self.pad, self.inner_shape, self.strides, strict=True):
            flat = (flat[:, None] + (np.arange(s) + p) * stride).ravel()
        return flat

    def clearance(self, to: To = "centre") -> NDArray[np.float64]:
        """Return for each cell (size,) the distance, metres, of its centre to the nearest obstacle.

        Exact for free cells. All cells have inf where there is no obstacle, and the padding has 0.

        Args:
            to: "centre" for the distance to the nearest obstacle's centre. What an obstacle measures is
                not taken off: an occupied cell may hold a point up to ``lattice.covering_radius`` from
                its centre. Obstacles on the surface have 0, those inside a solid their distance to
                its surface. "cell" for the distance to the nearest point of any obstacle, of which
                each fills its closed Voronoi cell, and in a graph of a
                :class:`~hexmap.io.grids.GridMap` of the grid's own blocked squares or cubes, also of
                those that hold no centre. Cells whose centre is in or on an obstacle have 0.

        Raises:
            ArgumentError: ``to`` is neither.
        """
        check_to(to)
        out = np.zeros(self.size, np.float64)
        inner = self._inner_flat()
        out[inner] = self._clearance.distances(self, inner, to=to)
        return out

    def clearance_at(self, flat: ArrayLike, to: To = "centre") -> NDArray[np.float64]:
        """Return the distance (M,), metres, of the centres of the cells ``flat`` (M,) to the nearest obstacle.

        What :meth:`clearance` holds there, to the obstacle's centre or cell, without the field: the
        least of a path needs its cells alone.

        Raises:
            ArgumentError: a position is outside the array, or ``to`` is neither "centre" nor "cell".
        """
        check_to(to)
        at = np.asarray(flat)
        self.flat_to_index(at)
        return self._clearance.distances(self, at.astype(np.int64), to=to)

    def with_clearance(self, radius: float, to: To = "centre") -> LatticeGraph:
        """Return the graph for a robot of a radius, metres: cells nearer than that to an obstacle are blocked.

        The distance is that to the obstacle's centre or cell, see :meth:`clearance`; a cell at exactly
        the radius (to 1e-9 of it) stays free. A robot at a free cell's centre may overlap an obstacle
        where the distance is that to centres; where it is that to cells, it does not.
        Moves are not checked between their ends but for what they sweep: their middle may be nearer
        by a fraction of a cell.

        Raises:
            ArgumentError: the radius is not a number of 0 or more, or ``to`` is neither "centre" nor "cell".
        """
        check_to(to)
        if not (math.isfinite(radius) and radius >= 0.0):
            raise ArgumentError(f"a radius must be a number of metres, 0 or more, not {radius!r}")
        free = self.free.copy()
        self._clearance.block_near(self, radius, free, to)
        return self._derived(free, self.terrain)

    # ------------------------------------------------------------------ terrain

    def with_terrain(self, terrain: ArrayLike | Callable[[NDArray[np.float64]], ArrayLike]) -> LatticeGraph:
        """Return the graph with multipliers of cost, in place of those it may have.

        Args:
            terrain: an array (size,), or one of ``inner_shape``, or a function that takes the
                centres (N, n), metres, of the free cells and returns a multiplier for each.

        Raises:
            ArgumentError: the array has another shape, or a free cell's multiplier is not positive and finite.
        """
        nodes = np.flatnonzero(self.free)
        if callable(terrain):
            return self._with_values(nodes, self._terrain_of_function(nodes, terrain))
        array, inner = np.asarray(terrain, dtype=np.float64), self.inner_box.dims
        if array.shape == (self.size,):
            return self._with_values(nodes, array[nodes])
        if array.shape == inner:
            return self._with_values(nodes, array[self.inner_states() != 0])
        raise ArgumentError(f"the terrain must be ({self.size},) or {inner}, not {array.shape}")

    def _terrain_of_function(
        self, nodes: NDArray[np.int64], terrain: Callable[[NDArray[np.float64]], ArrayLike]
    ) -> NDArray[np.float64]:
        """Return what a user's function says of the centres of the free cells ``nodes`` (M,), as (M,) numbers."""
        given = [np.atleast_1d(terrain(self.centres(nodes[k : k + CHUNK]))) for k in range(0, len(nodes), CHUNK)]
        values = np.concatenate(given).astype(np.float64) if given else np.empty(0)
        if values.shape != (len(nodes),):
            raise ArgumentError(f"the terrain must answer {len(nodes)} points, not with an array {values.shape}")
        return values

    def with_soft_clearance(self, reach: float, weight: float, to: To = "centre") -> LatticeGraph:
        """Return the graph with costs that keep paths off walls.

        A cell at distance d < ``reach`` from the nearest obstacle (see :meth:`clearance`) costs
        1 + ``weight`` (1 - d / reach)^2 times as much, on top of the terrain that there is.

        Args:
            reach: metres within which an obstacle is felt.
            weight: how much more a cell right at an obstacle costs; 0 changes nothing.
            to: whether d is the distance to the obstacle's "centre" or "cell".

        Raises:
            ArgumentError: the reach is not positive, the weight negative, or ``to`` neither of the two.
        """
        check_to(to)
        if not (math.isfinite(reach) and reach > 0.0 and math.isfinite(weight) and weight >= 0.0):
            raise ArgumentError(f"a soft clearance takes a reach > 0 and a weight >= 0, not {reach!r} and {weight!r}")
        nodes = np.flatnonzero(self.free)
        near = np.maximum(1.0 - self._clearance.distances(self, nodes, reach, to) / reach, 0.0)
        values = 1.0 + weight * near**2
        return self._with_values(nodes, values if self.terrain is None else values * self.terrain[nodes])

    def _with_values(self, nodes: NDArray[np.int64], values: NDArray[np.float64]) -> LatticeGraph:
        """Return the graph with these multipliers at the free cells."""
        wrong = ~(np.isfinite(values) & (values > 0.0))
        if wrong.any():
            k = int(np.argmax(wrong))
            cell = tuple(self.flat_to_index(nodes[k : k + 1])[0].tolist())
            raise ArgumentError(f"the terrain of a free cell must be positive and finite, not {values[k]:g} at {cell}")
        # The cost of a path through all cells must be a number.
        if len(values) and not math.isfinite(float(values.max()) * float(self.lengths.max()) * 4.0 * len(values)):
            raise ArgumentError(f"the terrain of a free cell is {values.max():g}: costs of paths would overflow")
        out = np.full(self.size, values.min() if len(values) else 1.0)
        out[nodes] = values
        return self._derived(None, out)
