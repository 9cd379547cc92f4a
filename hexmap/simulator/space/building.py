"""A building in space: boxes of any attitude and upright cylinders, a path through it, and rays cast into it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import FloatArray, frozen
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line

__all__ = ["Building3D", "Scene", "SolidList", "cast_in_space"]

# Edge of a cell of the grid that rays walk, metres: about the size of a piece of furniture. It only costs time.
_CELL = 1.0
# Solids are listed in every cell that they come this near to, so that rounding at the side of a cell loses no hit.
_MARGIN = 1e-6


class Scene(NamedTuple):
    """The solids of a building and the grid over them, as the kernel takes them.

    Attributes:
        centres: (B, 3) middles of the boxes, metres.
        rotations: (B, 3, 3) their axes as columns.
        halves: (B, 3) half of their edges, metres.
        cylinders: (C, 5) x, y, radius, bottom and top of the upright cylinders, metres.
        low: (3,) the corner of the grid with the least coordinates, metres.
        size: edge of a cell, metres.
        shape: (3,) int64 number of cells along each axis.
        first: (cells + 1,) int64; the solids of cell c are ``items[first[c]:first[c + 1]]``.
        items: (I,) int64 numbers of solids: the boxes in their order, then the cylinders.
    """

    centres: FloatArray
    rotations: FloatArray
    halves: FloatArray
    cylinders: FloatArray
    low: FloatArray
    size: float
    shape: NDArray[np.int64]
    first: NDArray[np.int64]
    items: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Building3D:
    """A building of several floors and a path through it, in the building's frame (metres, z up).

    Attributes:
        name: what logs and messages call it.
        box_centres: (B, 3) middles of the boxes.
        box_rotations: (B, 3, 3) their axes as columns: turned about z, or tilted as a ramp is.
        box_halves: (B, 3) half of the edges along those axes, positive.
        cylinders: (C, 5) x, y, radius, bottom and top of the upright cylinders.
        reflectivity: (B + C,) how strongly each solid reflects, 0 to 1: the boxes, then the cylinders.
        waypoints: (W, 3) corners of the path on the floors. Legs that rise are straight on with the legs beside them.
    """

    name: str
    box_centres: FloatArray
    box_rotations: FloatArray
    box_halves: FloatArray
    cylinders: FloatArray
    reflectivity: FloatArray
    waypoints: FloatArray

    __repr__ = one_line

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only copies.

        Raises:
            ArgumentError: shapes that do not fit, nothing solid, fewer than two way points, values that are not finite,
                or a solid without volume.
        """
        names = ("box_centres", "box_rotations", "box_halves", "cylinders", "reflectivity", "waypoints")
        for name in names:
            object.__setattr__(self, name, frozen(getattr(self, name)))
        b, c = len(self.box_centres), len(self.cylinders)
        shapes = [(b, 3), (b, 3, 3), (b, 3), (c, 5), (b + c,), (len(self.waypoints), 3)]
        for name, shape in zip(names, shapes, strict=True):
            array = getattr(self, name)
            if array.shape != shape:
                raise ArgumentError(f"the {name} of the building {self.name} must be {shape}, not {array.shape}")
            if not np.isfinite(array).all():
                raise ArgumentError(f"the {name} of the building {self.name} must be finite")
        if b + c == 0 or len(self.waypoints) < 2:
            raise ArgumentError(f"the building {self.name} needs at least one solid and two way points")
        radius, bottom, top = self.cylinders[:, 2:].T
        if not ((self.box_halves > 0.0).all() and (radius > 0.0).all() and (top > bottom).all()):
            raise ArgumentError(f"every box and cylinder of the building {self.name} must have a volume")
        gram = np.einsum("bki,bkj->bij", self.box_rotations, self.box_rotations)
        if np.abs(gram - np.eye(3)).max(initial=0.0) > 1e-9:
            raise ArgumentError(f"the box_rotations of the building {self.name} must be rotations")

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest corner (S, 3) of the box around each solid, boxes first."""
        reach = np.einsum("bij,bj->bi", np.abs(self.box_rotations), self.box_halves)
        x, y, radius, bottom, top = self.cylinders.T
        low = np.concatenate([self.box_centres - reach, np.column_stack([x - radius, y - radius, bottom])])
        high = np.concatenate([self.box_centres + reach, np.column_stack([x + radius, y + radius, top])])
        return low, high

    @cached_property
    def scene(self) -> Scene:
        """The solids with the grid over them, made at the first ray."""
        low, high = self.bounds()
        corner = low.min(axis=0) - 2.0 * _MARGIN
        extent = high.max(axis=0) + 2.0 * _MARGIN - corner
        # A cell may grow where a building is very large; a million cells are a few megabytes.
        size = max(_CELL, float(np.cbrt(np.prod(extent) / 1e6)), float(extent.max()) / 1e5)
        shape = np.maximum(np.ceil(extent / size), 1.0).astype(np.int64)
        first_cell = np.clip(np.floor((low - _MARGIN - corner) / size), 0, shape - 1).astype(np.int64)
        last_cell = np.clip(np.floor((high + _MARGIN - corner) / size), 0, shape - 1).astype(np.int64)
        cells, solids = [], []
        for s, (a, b) in enumerate(zip(first_cell, last_cell, strict=True)):
            i, j, k = np.ix_(*[np.arange(a[n], b[n] + 1) for n in range(3)])
            flat = ((i * shape[1] + j) * shape[2] + k).ravel()
            cells.append(flat)
            solids.append(np.full(len(flat), s))
        cell, solid = np.concatenate(cells), np.concatenate(solids)
        order = np.lexsort((solid, cell))
        first = np.searchsorted(cell[order], np.arange(int(np.prod(shape)) + 1)).astype(np.int64)
        return Scene(
            self.box_centres, self.box_rotations, self.box_halves, self.cylinders,
            corner, size, shape, first, solid[order].astype(np.int64),
        )  # fmt: skip


def cast_in_space(
    building: Building3D, origins: ArrayLike, directions: ArrayLike, max_range: float = math.inf
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return how far each ray goes until it meets a solid, and which one.

    Args:
        building: the solids.
        origins: (R, 3) where the rays start, metres, in the building's frame.
        directions: (R, 3) unit vectors in that frame.
        max_range: how far to look, metres.

    Returns:
        (R,) float64 ranges in metres, 0 for a ray that starts inside a solid, inf where it meets nothing within
        ``max_range``; (R,) int64 numbers of the solids that were hit (the boxes, then the cylinders), -1 for none.

    Raises:
        ArgumentError: arrays of other shapes, values that are not finite, or directions that are not unit vectors.

    Examples:
        >>> from hexmap.simulator.space import SolidList, cast_in_space
        >>> solids = SolidList()
        >>> solids.box((2.0, -1.0, -1.0), (3.0, 1.0, 1.0))
        >>> room = solids.building("wall", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
        >>> cast_in_space(room, [[0.0, 0.0, 0.0]] * 2, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])[0].tolist()
        [2.0, inf]
    """
    from hexmap.simulator.space._cast_kernels import cast_rays

    o = np.ascontiguousarray(origins, dtype=np.float64)
    d = np.ascontiguousarray(directions, dtype=np.float64)
    if o.ndim != 2 or o.shape[1] != 3 or d.shape != o.shape:
        raise ArgumentError(f"rays take origins (R, 3) and as many directions, not {o.shape} and {d.shape}")
    if not (np.isfinite(o).all() and np.isfinite(d).all()):
        raise ArgumentError("origins and directions of rays must be finite")
    if np.abs((d * d).sum(axis=1) - 1.0).max(initial=0.0) > 1e-6:
        raise ArgumentError("directions of rays must be unit vectors")
    if not max_range >= 0.0:
        raise ArgumentError(f"the maximum range of rays must be zero or more metres, not {max_range}")
    ranges, hits = np.empty(len(o)), np.empty(len(o), dtype=np.int64)
    cast_rays(building.scene, o, d, float(max_range), ranges, hits)
    return ranges, hits


@dataclass
class SolidList:
    """Collects the solids of a building while it is drawn.

    Examples:
        >>> from hexmap.simulator.space import SolidList
        >>> solids = SolidList()
        >>> solids.box((0.0, 0.0, -0.3), (10.0, 8.0, 0.0))
        >>> solids.cylinder(5.0, 4.0, 0.25, 0.0, 3.0)
        >>> len(solids.building("hall", [(1.0, 1.0, 0.0), (9.0, 1.0, 0.0)]).cylinders)
        1
    """

    _boxes: list[tuple[FloatArray, FloatArray, FloatArray, float]] = field(default_factory=list)
    _cylinders: list[tuple[float, float, float, float, float, float]] = field(default_factory=list)

    __repr__ = one_line

    def box(self, low: ArrayLike, high: ArrayLike, reflectivity: float = 0.4) -> None:
        """Add a box along the axes from its lowest to its highest corner (3,), metres."""
        a, b = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        self._boxes.append((0.5 * (a + b), np.eye(3), 0.5 * (b - a), reflectivity))

    def turned_box(
        self, bottom: tuple[float, float, float], edges: tuple[float, float, float], turn: float, reflectivity: float
    ) -> None:
        """Add a box on the middle of its underside (3,), with its edges (3,), turned about z by ``turn`` radians."""
        c, s = math.cos(turn), math.sin(turn)
        centre = np.array([bottom[0], bottom[1], bottom[2] + 0.5 * edges[2]])
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self._boxes.append((centre, rotation, 0.5 * np.array(edges), reflectivity))

    def ramp(self, foot: ArrayLike, head: ArrayLike, width: float, thickness: float, reflectivity: float = 0.4) -> None:
        """Add a ramp: a tilted box whose upper side runs from ``foot`` to ``head`` (3,), the middles of its ends."""
        a, b = np.asarray(foot, dtype=np.float64), np.asarray(head, dtype=np.float64)
        along = (b - a) / np.linalg.norm(b - a)
        across = np.array([-along[1], along[0], 0.0]) / math.hypot(along[0], along[1])
        up = np.cross(along, across)
        halves = 0.5 * np.array([float(np.linalg.norm(b - a)), width, thickness])
        self._boxes.append(
            (0.5 * (a + b) - 0.5 * thickness * up, np.column_stack([along, across, up]), halves, reflectivity)
        )

    def cylinder(self, x: float, y: float, radius: float, bottom: float, top: float, reflectivity: float = 0.4) -> None:
        """Add an upright cylinder, metres."""
        self._cylinders.append((x, y, radius, bottom, top, reflectivity))

    def wall(
        self,
        a: tuple[float, float],
        b: tuple[float, float],
        heights: tuple[float, float],
        thickness: float,
        openings: list[tuple[float, float, float, float]] | None = None,
    ) -> None:
        """Add a wall along x or y with rectangular openings in it.

        Args:
            a: where it begins, x and y on its middle line.
            b: where it ends; only one coordinate differs from ``a``, and it is greater.
            heights: bottom and top.
            thickness: across the middle line.
            openings: from and to as distances from ``a``, bottom and top, one after the other without overlap.
        """
        axis = 0 if b[0] > a[0] else 1
        half = 0.5 * thickness

        def piece(start: float, end: float, bottom: float, top: float) -> None:
            if end - start > 1e-9 and top - bottom > 1e-9:
                low, high = [a[0] - half, a[1] - half, bottom], [a[0] + half, a[1] + half, top]
                low[axis], high[axis] = a[axis] + start, a[axis] + end
                self.box(low, high)

        done = 0.0
        for start, end, bottom, top in sorted(openings or []):
            piece(done, start, *heights)
            piece(start, end, heights[0], bottom)
            piece(start, end, top, heights[1])
            done = end
        piece(done, b[axis] - a[axis], *heights)

    def building(self, name: str, waypoints: ArrayLike) -> Building3D:
        """Return the finished building with a path (W, 3) through it.

        Raises:
            ArgumentError: what :class:`Building3D` refuses.
        """
        cylinders = np.array(self._cylinders, dtype=np.float64).reshape(-1, 6)
        return Building3D(
            name,
            np.array([box[0] for box in self._boxes]).reshape(-1, 3),
            np.array([box[1] for box in self._boxes]).reshape(-1, 3, 3),
            np.array([box[2] for box in self._boxes]).reshape(-1, 3),
            cylinders[:, :5],
            np.array([box[3] for box in self._boxes] + cylinders[:, 5].tolist()),
            np.asarray(waypoints, dtype=np.float64),
        )
