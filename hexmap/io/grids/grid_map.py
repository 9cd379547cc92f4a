"""A grid of squares or cubes that someone else published, as one value."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError, BoundsError, TooLargeError
from hexmap.base.values import kept, one_line, remade
from hexmap.io.read_file import inflation_limit
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList

if TYPE_CHECKING:
    from hexmap.graph.bodies import Boxes
    from hexmap.graph.lattice_graph import LatticeGraph
    from hexmap.graph.moves import Neighbourhood

__all__ = ["MAX_BYTES", "MAX_CELLS", "GridMap", "check_size"]

MAX_CELLS = 2_000_000_000  # of a dense array, a byte each
MAX_BYTES = 4 * 2**30  # of a file, as it is and decompressed
_SPARSE_CELLS = 1 << 28  # that any file may have, however few bytes it has
_FINE = 2.0**32  # parts of a cell that quotients are rounded to
_DRAWN_IN = 1e-6  # of a cell: how far inside its border the outermost samples lie
_SAMPLES_AT_ONCE = 1 << 21


@dataclass(frozen=True, eq=False)
class GridMap:
    """The cells of a square or cubic grid, where it lies, and what each cell is; an immutable value.

    The cell i holds the points origin + R(yaw) [i cell, (i + 1) cell), where R turns about the origin
    (in space about the z axis). A point on the border of two cells is in the one of the higher index;
    quotients are rounded to 2^-32 of a cell first, so that this does not depend on how they were computed.

    Attributes:
        states: (nx, ny[, nz]) uint8 of :class:`~hexmap.maps.CellState`, indexed by x, y(, z).
        cell: edge of a cell, metres.
        origin: (n,) float64, metres, the low corner of the cell 0, 0(, 0).
        yaw: by how much the grid is turned about its origin, radians, counter-clockwise.
        path: the file it came from.
        kind: "movingai", "warframe", "ros", "octomap" or "wean"; "" for one's own.
        y_down: whether pictures show y downwards, as MovingAI counts rows from the top.

    Examples:
        >>> import numpy as np
        >>> from hexmap.io.grids import GridMap
        >>> from hexmap.maps import CellState
        >>> grid = GridMap(np.array([[1, 2], [1, 1]], np.uint8), 0.5, [0, 0])
        >>> [CellState(s).name for s in grid.state_at([[0.1, 0.1], [0.1, 0.6], [7, 7]])]
        ['FREE', 'OCCUPIED', 'OCCUPIED']
    """

    states: NDArray[np.uint8] = field(repr=False)
    cell: float
    origin: NDArray[np.float64]
    yaw: float = 0.0
    path: str = ""
    kind: str = ""
    y_down: bool = False

    __repr__ = one_line

    def __post_init__(self) -> None:
        """Check the values and make the arrays read-only.

        Raises:
            ArgumentError: the states are not uint8 of 0 to 2 with two or three dimensions and at least one
                cell, or the other values are not finite numbers of their shape.
        """
        states = np.asarray(self.states)
        if states.ndim not in (2, 3) or states.dtype != np.uint8 or states.size == 0:
            raise ArgumentError(
                f"the states of a grid are uint8 (nx, ny) or (nx, ny, nz), not {states.dtype} {states.shape}"
            )
        if int(states.max()) > max(CellState):
            known = ", ".join(f"{state:d} ({state.name.lower()})" for state in CellState)
            raise ArgumentError(f"the state of a cell is one of {known}, not {int(states.max())}")
        states = kept(states, np.uint8)
        try:
            cell, yaw = float(self.cell), float(self.yaw)
            origin = np.array(self.origin, dtype=np.float64)
        except (TypeError, ValueError):
            raise ArgumentError(
                f"a grid takes numbers for its cell, origin and yaw, not {self.cell!r}, {self.origin!r}, {self.yaw!r}"
            ) from None
        if not (math.isfinite(cell) and cell > 0.0):
            raise ArgumentError(f"the edge of a cell must be a positive number of metres, not {self.cell!r}")
        if origin.shape != (states.ndim,) or not np.isfinite(origin).all():
            raise ArgumentError(f"the origin of a grid is {states.ndim} finite numbers, not {self.origin!r}")
        if not math.isfinite(yaw):
            raise ArgumentError(f"the yaw of a grid must be a finite number of radians, not {self.yaw!r}")
        origin.setflags(write=False)
        for name, value in (("states", states), ("cell", cell), ("origin", origin), ("yaw", yaw)):
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy through the constructor: arrays that are unpickled can be written to."""
        return remade(self)

    @property
    def dim(self) -> int:
        """2 or 3."""
        return self.states.ndim

    @cached_property
    def has_unknown(self) -> bool:
        """Whether any cell is unknown."""
        return bool((self.states == CellState.UNKNOWN.value).any())

    @cached_property
    def _box(self) -> NDArray[np.float64]:
        """The two corners (2, n) of the box that holds the grid."""
        n = self.dim
        ends = np.array([[s if (c >> i) & 1 else 0 for i, s in enumerate(self.states.shape)] for c in range(2**n)])
        corners = self._turned(ends * self.cell) + self.origin
        return np.array([corners.min(axis=0), corners.max(axis=0)])

    @property
    def low(self) -> NDArray[np.float64]:
        """(n,) low corner, metres, of the box that holds the grid, turned or not."""
        return self._box[0].copy()

    @property
    def high(self) -> NDArray[np.float64]:
        """(n,) high corner, metres, of the box that holds the grid, turned or not."""
        return self._box[1].copy()

    def _turned(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turn vectors (M, n) from the grid's own axes into those of its frame."""
        if self.yaw == 0.0:
            return v
        out = v.copy()
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        out[:, 0] = c * v[:, 0] - s * v[:, 1]
        out[:, 1] = s * v[:, 0] + c * v[:, 1]
        return out

    def _points(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return points as (N, n) float64, contiguous."""
        p = np.ascontiguousarray(points, dtype=np.float64)
        if p.size == 0 and p.ndim != 2:
            p = p.reshape(0, self.dim)
        if p.ndim != 2 or p.shape[1] != self.dim:
            raise ArgumentError(f"points in a grid of dimension {self.dim} are (N, {self.dim}), not {p.shape}")
        return p

    def state_at(self, points: ArrayLike, outside: int = CellState.OCCUPIED) -> NDArray[np.uint8]:
        """Return the state (N,) uint8 of the cell that each of ``points`` (N, n), metres, lies in.

        Args:
            points: (N, n), metres.
            outside: what is answered for points outside the grid, and for points that are not finite.

        Raises:
            ArgumentError: the array is not (N, n).
        """
        from hexmap.io.grids import _kernels as kernels

        p = self._points(points)
        out = np.empty(len(p), np.uint8)
        c, s = (1.0, 0.0) if self.yaw == 0.0 else (math.cos(self.yaw), math.sin(self.yaw))
        shape = np.array(self.states.shape, np.int64)
        # A plain integer: the kernel would compile again for an enumeration.
        kernels.look_up(p, self.origin, self.cell, c, s, shape, self.states.reshape(-1), int(outside), out)
        return out

    def free_at(self, points: ArrayLike, unknown: Literal["blocked", "free"] = "blocked") -> NDArray[np.bool_]:
        """Tell for each of ``points`` (N, n), metres, whether its cell is free.

        Args:
            points: (N, n), metres.
            unknown: what unknown cells count as; everything outside the grid is blocked all the same.

        Raises:
            ArgumentError: the array is not (N, n), or there is no such option.
        """
        _check_unknown(unknown)
        states = self.state_at(points)
        return states != CellState.OCCUPIED.value if unknown == "free" else states == CellState.FREE.value

    def centre(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Return the centres (M, n), metres, of cells (M, n), which may lie outside the grid.

        Raises:
            ArgumentError: the array is not (M, n).
        """
        return self._turned((self._points(cells) + 0.5) * self.cell) + self.origin

    def cell_of(self, points: ArrayLike) -> NDArray[np.int64]:
        """Return the cells (M, n) int64 that ``points`` (M, n), metres, lie in, within the grid or not.

        Raises:
            ArgumentError: the array is not (M, n).
            BoundsError: a point is not finite or too far away to count cells.
        """
        d = self._points(points) - self.origin
        if self.yaw != 0.0:
            c, s = math.cos(self.yaw), math.sin(self.yaw)
            d = np.concatenate([(c * d[:, :1] + s * d[:, 1:2]), (c * d[:, 1:2] - s * d[:, :1]), d[:, 2:]], axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            q = np.floor(np.rint(d / self.cell * _FINE) / _FINE)
        wrong = ~(np.abs(q) < 2.0**62).all(axis=1)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise BoundsError(f"point {row} is not finite or out of range: {self._points(points)[row].tolist()}")
        return q.astype(np.int64)

    def turned(self, angle: float, about: ArrayLike | None = None) -> GridMap:
        """Return the same map turned counter-clockwise, in space about the z axis.

        Args:
            angle: radians.
            about: the point (n,), metres, that stays where it is; the grid's middle where none is given.

        Raises:
            ArgumentError: the angle is not finite, or ``about`` is not a point.
        """
        if not math.isfinite(angle):
            raise ArgumentError(f"an angle must be a finite number of radians, not {angle!r}")
        if about is None:
            fixed = self.centre(np.array([self.states.shape]) / 2.0 - 0.5)[0]
        else:
            fixed = np.asarray(about, dtype=np.float64)
            if fixed.shape != (self.dim,) or not np.isfinite(fixed).all():
                raise ArgumentError(f"the point to turn about is {self.dim} finite numbers, not {about!r}")
        origin = self.origin.copy()
        c, s = math.cos(angle), math.sin(angle)
        x, y = (self.origin - fixed)[:2]
        origin[0] = fixed[0] + c * x - s * y
        origin[1] = fixed[1] + s * x + c * y
        return replace(self, origin=origin if angle else self.origin, yaw=self.yaw + angle)

    def to_graph(
        self,
        lattice: LatticeLike,
        *,
        unknown: Literal["blocked", "free"] = "blocked",
        neighbourhood: Neighbourhood = None,
        max_cells: int | None = None,
        rule: Literal["centre", "area"] = "centre",
    ) -> LatticeGraph:
        """Rasterise the grid onto a lattice: a cell of the lattice is what its centre lies in.

        With the rule "area" a cell that meets the inside of an occupied cell of the grid is blocked as well, wherever
        its centre lies: no path of the graph, straight lines from cell to cell included, runs through an occupied
        cell of the grid. Passages that are narrower than two cells of the lattice may close.

        With "centre" paths may cut off corners. At the resolution of :attr:`cell` a square or cubic lattice gives a
        MovingAI or Warframe map index for index. On another lattice of the same cell size routes leak through walls of
        one cell: take a half or a quarter of it.
        Clearance to an obstacle's centre is measured from the centres of the lattice's cells that lie in occupied
        cells of the grid, clearance to an obstacle's cell from the grid's own occupied squares or cubes, turned
        as they are; unknown cells and what lies outside are no obstacles.

        Args:
            lattice: the lattice to rasterise onto, of the grid's dimension, or its basis; the name of one is taken
                at half the size of :attr:`cell` in the plane and at that size in space, as ``hexmap plan`` takes it.
            unknown: what unknown cells count as.
            neighbourhood: None for ``lattice.neighbours``, or nearest, faces, extended, or a size.
            max_cells: how large a window may be, padding included.
            rule: whether occupied cells of the grid block by "centre" or by "area"; what is unknown or outside does
                by the centre always.

        Raises:
            ArgumentError: there is no such option, the lattice has another dimension, no centre lies in the grid's
                box, or the window is too large.
            BoundsError: the window leaves the range of indices.
        """
        from hexmap.graph import lattice_graph as graphs

        _check_unknown(unknown)
        if rule not in ("centre", "area"):
            raise ArgumentError(f"occupied cells block by centre or area, not by {rule!r}")
        if isinstance(lattice, str):
            lattice = as_lattice(lattice, 0.5 * self.cell if self.dim == 2 else self.cell)
        lattice = as_lattice(lattice)
        self._check_dimension(lattice)
        # A centre on the grid's border belongs to the grid or not, as the look-up decides it.
        grain = self.cell / _FINE
        low, high = self.low - 0.25 * grain, self.high - grain
        occupied_at: Callable[[NDArray[np.float64]], NDArray[np.bool_]] | None = None
        if self.yaw != 0.0 or self.has_unknown:
            low, high = self.low - grain, self.high + grain
            occupied_at = self._occupied_at
        graph = graphs.LatticeGraph.rasterise(
            lambda points: self.free_at(points, unknown),
            lattice,
            low,
            high,
            neighbourhood=neighbourhood,
            max_cells=graphs.MAX_CELLS if max_cells is None else max_cells,
            occupied_at=occupied_at,
            boxes=self._occupied_boxes,
        )
        if rule == "centre":
            return graph
        from hexmap.graph.meeting import block_met

        boxes = self._occupied_boxes()
        corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * self.dim), axis=-1).reshape(-1, self.dim)
        return block_met(graph, boxes.centres, boxes.edge * corners @ boxes.frame)

    def to_states(self, lattice: LatticeLike | None = None) -> States:
        """Return the occupied and free cells of the map on a lattice, for matching scans against it.

        A cell of the lattice is occupied where it meets the inside of an occupied cell of the grid: where one of the
        points of a regular sampling of that cell falls into it. Neighbouring samples are at most half of the smaller
        one's width apart, that of a lattice's cell being twice its inradius; those in the corners are drawn in by a
        millionth of a cell, so that cells which share a border only do not count. A cell of the lattice is free where
        it is not occupied and its centre lies in a free cell of the grid. All others are unknown. A square or cubic
        lattice whose cells are those of the grid gives back the grid's states.

        Args:
            lattice: a lattice of the grid's dimension, a basis, or a name, whose resolution is then :attr:`cell`;
                None: the square or cubic one.

        Returns:
            The cells, each with a count of 1.

        Raises:
            ArgumentError: the lattice has another dimension.
            BoundsError: a cell leaves the range of the lattice's indices.
            LatticeError: there is no lattice of that name.
        """
        wanted = f"Z{self.dim}" if lattice is None else lattice
        on = as_lattice(wanted, self.cell if isinstance(wanted, str) else None)
        self._check_dimension(on)
        width = 2.0 * on.inradius
        parts = math.ceil(self.cell / (0.5 * min(self.cell, width)) - 1e-9)
        ends = np.linspace(0.0, 1.0, parts + 1)
        ends[[0, -1]] = _DRAWN_IN, 1.0 - _DRAWN_IN
        occupied = self._cells_met(on, CellState.OCCUPIED, ends)
        # Each point of a cell is nearer than an inradius to one of these, so each centre in it is found.
        parts = math.ceil(1.001 * math.sqrt(self.dim) * self.cell / width)
        near = self._cells_met(on, CellState.FREE, (np.arange(parts) + 0.5) / parts)
        free = self.state_at(near.centres(), outside=CellState.UNKNOWN) == CellState.FREE.value
        near = near.select(free)
        return States(occupied, near.select(~occupied.contains(near.index)))

    def _cells_met(self, lattice: Lattice, state: CellState, along: NDArray[np.float64]) -> VoxelList:
        """Return the lattice's cells, each counted once, that samples of the grid's cells of one state fall into.

        Args:
            lattice: the lattice.
            state: of the cells that are sampled.
            along: (K,) where the samples lie along each axis of a cell, 0 to 1.
        """
        n = self.dim
        samples = np.stack(np.meshgrid(*[along] * n, indexing="ij"), axis=-1).reshape(-1, n)
        found = VoxelList.empty(lattice)
        # In slabs of the grid, and in pieces of those: all samples of a large map would not fit into memory.
        slab = max(1, _SAMPLES_AT_ONCE // max(1, math.prod(self.states.shape[1:])))
        piece = max(1, _SAMPLES_AT_ONCE // len(samples))
        for begin in range(0, self.states.shape[0], slab):
            cells = np.argwhere(self.states[begin : begin + slab] == state.value)
            cells[:, 0] += begin
            for first in range(0, len(cells), piece):
                points = (cells[first : first + piece, None, :] + samples - 0.5).reshape(-1, n)
                found = found.merge(VoxelList.from_points(self.centre(points), lattice))
        return VoxelList(lattice, found.keys, np.ones_like(found.counts))

    def _check_dimension(self, lattice: Lattice) -> None:
        if lattice.dim != self.dim:
            raise ArgumentError(
                f"a grid of dimension {self.dim} does not fit {lattice.name}, of dimension {lattice.dim}"
            )

    def _occupied_at(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell for each of points (N, n) whether it lies in an occupied cell of the grid."""
        return self.state_at(points, outside=CellState.UNKNOWN) == CellState.OCCUPIED.value

    def _occupied_boxes(self) -> Boxes:
        """Return the occupied cells as boxes, but for those with occupied cells across all their faces."""
        from hexmap.graph.bodies import Boxes

        solid = self.states == CellState.OCCUPIED.value
        surface = np.pad(solid, 1)
        inner = surface.copy()
        for axis in range(self.dim):
            for step in (-1, 1):
                inner &= np.roll(surface, step, axis=axis)
        cells = np.argwhere(surface & ~inner) - 1
        return Boxes(
            centres=self.centre(cells),
            edge=self.cell,
            frame=np.ascontiguousarray(self._turned(np.eye(self.dim))),
            grain=self.cell / _FINE,
            contains=self._occupied_at,
        )


def check_size(where: object, shape: tuple[int, ...], size: int | None = None) -> None:
    """Refuse a dense array that is too large, before it is allocated.

    Args:
        where: what the message begins with.
        shape: of the array.
        size: bytes of a file whose cells are not all written out; then they may be 2^28, or as many times the size as
            :func:`~hexmap.io.read_file.inflation_limit` has it. None: the file has bytes for all of them.

    Raises:
        TooLargeError: naming the size.
    """
    cells = 1
    for s in shape:
        cells *= s
    if cells > MAX_CELLS:
        raise TooLargeError(
            f"{where}: {' x '.join(map(str, shape))} cells would take {cells / 2**30:.1f} GiB; "
            f"at most {MAX_CELLS} are read"
        )
    if size is not None and cells > max(_SPARSE_CELLS, inflation_limit(size)):
        raise TooLargeError(
            f"{where}: {' x '.join(map(str, shape))} cells in a file of {size} bytes; at most "
            f"{max(_SPARSE_CELLS, inflation_limit(size))} are read; HEXMAP_MAX_INFLATION raises the limit"
        )


def _check_unknown(unknown: str) -> None:
    if unknown not in ("blocked", "free"):
        raise ArgumentError(f"unknown cells are blocked or free, not {unknown!r}")
