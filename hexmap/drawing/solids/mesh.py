"""Sets of cells in space as surfaces of triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.drawing.figure_layout import HEIGHTS
from hexmap.lattice.keys import key_delta
from hexmap.lattice.lattice import Cell, Lattice
from hexmap.lattice.window import IndexBox
from hexmap.maps.outlines import CellCorners, row_numbers
from hexmap.maps.voxel_list import VoxelList

__all__ = [
    "Mesh",
    "check_spatial",
    "exposed_faces",
    "height_colours",
    "height_range",
    "linear_light",
    "mesh_of_cells",
    "outward_rings",
]

_STRAYS = 0.005  # fraction of the cells at either end that is coloured as its neighbours in height are
_DARKEST = 0.12  # of the colour map


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles, each a part of a face of a cell.

    Corners that cells share are the same row of ``vertices``. Seen from outside, triangles run
    counter-clockwise. Triangles are in the order of the cells; those of one face follow each other and are
    a fan around its first corner.

    Attributes:
        vertices: (V, 3) float64, metres, in the frame of the cells.
        triangles: (T, 3) int32, rows of ``vertices``.
        normals: (T, 3) float32, unit vectors out of the cell.
        cells: (T,) int32, the row in the list of cells.
        faces: (T,) int32, the number of the polygon it is a part of, from 0.
        colours: (T, 3) uint8, sRGB, by the height of the cell's centre.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    normals: NDArray[np.float32]
    cells: NDArray[np.int32]
    faces: NDArray[np.int32]
    colours: NDArray[np.uint8]

    __repr__ = one_line

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.vertices, self.triangles, self.normals, self.cells, self.faces, self.colours):
            array.setflags(write=False)

    @property
    def face_count(self) -> int:
        """How many polygons there are."""
        return int(self.faces[-1]) + 1 if len(self.faces) else 0

    @cached_property
    def volume(self) -> float:
        """Volume inside, cubic metres, by the divergence theorem; of no use where faces are counted twice."""
        if len(self.triangles) == 0:
            return 0.0
        a, b, c = (self.vertices[self.triangles[:, k]] - self.vertices[0] for k in range(3))
        return float(np.einsum("ti,ti->", a, np.cross(b, c))) / 6.0

    def moved(self, offset: NDArray[np.float64]) -> Mesh:
        """Return the same surface moved by ``offset`` (3,), metres."""
        return replace(self, vertices=self.vertices + offset)

    def split(self) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int64]]:
        """Return the same surface with corners of its own for each face, as flat shading wants it.

        Returns:
            The row of :attr:`vertices` for each corner (C,), the triangles (T, 3) by corners, and
            for each corner (C,) a triangle that it is of.
        """
        starts = np.flatnonzero(np.diff(self.faces, prepend=-1))
        sizes = np.diff(starts, append=len(self.triangles))
        # A fan of k triangles has k + 2 corners: two of its first triangle and the last one of each.
        first = starts + 2 * np.arange(len(starts))
        own = np.arange(len(self.triangles)) + 2 * np.repeat(np.arange(1, len(starts) + 1), sizes)
        corners = np.empty(len(self.triangles) + 2 * len(starts), np.int64)
        corners[first], corners[first + 1] = self.triangles[starts, 0], self.triangles[starts, 1]
        corners[own] = self.triangles[:, 2]
        triangles = np.stack([np.repeat(first, sizes), own - 1, own], axis=1).astype(np.int32)
        return corners, triangles, np.repeat(starts, sizes + 2)


def check_spatial(lattice: Lattice) -> None:
    """Refuse a lattice whose cells are no solids.

    Raises:
        ArgumentError: the lattice is one of the plane.
    """
    if lattice.dim != 3:
        raise ArgumentError(f"only cells in space are solids; {lattice.name} is a lattice of the plane")


def outward_rings(cell: Cell) -> list[NDArray[np.int64]]:
    """Return the corners of each face in order, counter-clockwise as seen from outside."""
    rings = []
    for ring, normal in zip(cell.rings, cell.normals, strict=True):
        ring = np.asarray(ring, np.int64)
        a, b, c = cell.vertices[ring[:3]]
        rings.append(ring if np.cross(b - a, c - b) @ normal > 0.0 else ring[::-1].copy())
    return rings


def exposed_faces(cells: VoxelList) -> NDArray[np.bool_]:
    """Tell for each cell and face (M, F) whether the cell beyond it is not in the list."""
    vectors = cells.lattice.cell.faces
    out = np.ones((len(cells), len(vectors)), np.bool_)
    if len(cells) == 0:
        return out
    room = cells.lattice.limit - 1 - int(np.abs(vectors).max())
    keys = cells.keys
    # The sorted keys can be shifted as they are, but for cells at the rim of the range of indices.
    safe = int(np.abs(cells.index).max()) <= room
    for face, vector in enumerate(vectors):
        if safe:
            wanted = keys + key_delta(vector)
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            out[:, face] = keys[at] != wanted
        else:
            out[:, face] = ~cells.contains(cells.index.astype(np.int64) + vector)
    return out


def height_range(heights: NDArray[np.float64]) -> tuple[float, float]:
    """Return the heights, metres, between which colours change: strays above and below do not stretch them."""
    if len(heights) == 0:
        return 0.0, 0.0
    low, high = np.quantile(heights, (_STRAYS, 1.0 - _STRAYS))
    return float(low), float(high)


def height_colours(heights: NDArray[np.float64], low: float, high: float) -> NDArray[np.uint8]:
    """Return a colour (N, 3), sRGB, for each height, metres; ``low`` and ``high`` are the ends of the colour map."""
    import matplotlib

    fraction = np.clip((heights - low) / ((high - low) or 1.0), 0.0, 1.0)
    # Not from the very dark: the shaded sides of the lowest cells would all be black.
    colours = matplotlib.colormaps[HEIGHTS](_DARKEST + (1.0 - _DARKEST) * fraction, bytes=True)
    return np.asarray(colours[:, :3], np.uint8)


def linear_light(colours: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return sRGB bytes, an array of any shape, as linear light, 0 to 1."""
    byte = np.arange(256) / 255.0
    return np.asarray(np.where(byte <= 0.04045, byte / 12.92, ((byte + 0.055) / 1.055) ** 2.4)[colours])


def mesh_of_cells(cells: VoxelList, *, hidden: bool = True) -> Mesh:
    """Return the surface of a set of cells of any lattice in space.

    Corners are identified by integers (a lattice point and one of the few kinds of corners), so
    what touches shares vertices exactly and the surface is watertight: each edge belongs to an
    even number of triangles (four or more where cells touch in an edge only).

    Args:
        cells: the cells.
        hidden: leave out faces between two cells of the list, which cannot be seen.

    Raises:
        ArgumentError: the lattice is one of the plane.

    Examples:
        >>> from hexmap import Lattice, VoxelList
        >>> from hexmap.drawing.solids import mesh_of_cells
        >>> two = VoxelList.from_cells([[0, 0, 0], [1, 0, 0]], Lattice.named("Z3", resolution=0.5))
        >>> mesh = mesh_of_cells(two)
        >>> mesh.face_count, len(mesh.vertices), round(mesh.volume, 9)
        (10, 12, 0.25)
    """
    check_spatial(cells.lattice)
    cell = cells.lattice.cell
    rings = outward_rings(cell)
    # The cell as a fan of triangles a face; the surface is a selection of copies of these.
    fan = np.array([(r[0], r[k], r[k + 1]) for r in rings for k in range(1, len(r) - 1)], np.int64)
    fan_face = np.repeat(np.arange(len(rings)), [len(r) - 2 for r in rings])
    exposed = exposed_faces(cells) if hidden else np.ones((len(cells), len(rings)), np.bool_)
    owner, triangle = np.nonzero(exposed[:, fan_face])
    number, vertices = _corners(cells, exposed, rings)
    first = np.cumsum(exposed.reshape(-1)).reshape(exposed.shape) - 1
    normals = cell.normals / np.linalg.norm(cell.normals, axis=1, keepdims=True)
    heights = cells.centres()[:, 2]
    return Mesh(
        vertices=vertices,
        triangles=number[owner[:, None], fan[triangle]],
        normals=normals[fan_face[triangle]].astype(np.float32),
        cells=owner.astype(np.int32),
        faces=first[owner, fan_face[triangle]].astype(np.int32),
        colours=height_colours(heights, *height_range(heights))[owner],
    )


def _corners(
    cells: VoxelList, exposed: NDArray[np.bool_], rings: Sequence[NDArray[np.int64]]
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return the row (M, V) of each corner of each cell, -1 where it is not used, and their positions (K, 3)."""
    corners = CellCorners(cells.lattice)
    used = np.zeros((len(cells), len(corners.names)), np.bool_)
    for face, ring in enumerate(rings):
        used[:, ring] |= exposed[:, face, None]
    owner, corner = np.nonzero(used)
    number = np.full(used.shape, -1, np.int32)
    if len(owner) == 0:
        return number, np.empty((0, 3))
    names = corners.names[corner]
    names[:, :3] += cells.index[owner]
    # A number for each name: its position in a dense box where that can be counted, else by sorting.
    box = IndexBox.of_cells(names)
    keys = box.flat(names) if box.size < 2**62 else row_numbers(names)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    number[owner, corner] = inverse
    return number, corners.points(names[first])
