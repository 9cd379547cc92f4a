"""Surfaces in the cells of a lattice of space, and scans that are drawn onto them.

A cell knows how many points fell into it, their sum and the sums of their products: the plane through them, and how far
they lie off it. A scan is drawn to a place where its points lie on the planes of the cells that they fall into
(point-to-plane distances, Chen and Medioni 1992; a Gaussian a cell, Magnusson 2009, from all points and not from one
scan's). It begins nearer than half a cell, where odometry or a search on the lattice has put it.

A cell that only one ring of a LiDAR has crossed holds a line, which is no plane, and pulls nothing. Rings on floor and
ceiling, which move along with the sensor, therefore do not hold a scan back, as they do where points are drawn to
points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential

__all__ = ["Drawn", "SurfaceMap", "first_of_each_cell"]

_EMPTY = -(2**63)
_ROWS = 4096
# Points that make a plane at least: three lie on one by chance.
_LEAST = 10
# The second axis of a plane's points is that long at least, in resolutions: a ring's line is thinner, and
_SPREAD = 0.1
# the third one shorter than this share of the second: corners and bushes are no planes.
_FLAT = 0.35
# The widths within which distances count begin at this part of a resolution and end at so many standard deviations of
# what the planes' own points do.
_FIRST_WIDTH = 0.25
_SIGMAS = 3.0
# No range of a LiDAR is better than a centimetre.
_LEAST_SIGMA = 0.01
_STEPS = 12
# In resolutions and radians: a step shorter than this is the last.
_TOLERANCE = 2e-4
# Planes of a cell's few points lean by some hundredths: an axis that they hold less than this part of the best held one
# is one along which nothing holds, as along a corridor.
_HELD = 1e-3
# Points on planes that are ground to move a scan.
_ENOUGH = 30


@dataclass(frozen=True, eq=False)
class Drawn:
    """A scan that was drawn onto surfaces.

    Attributes:
        pose: T_map_scan; where it began if ``converged`` is False.
        information: (6, 6) of a small motion, translation and rotation vector in the map's axes about the sensor: what
            the planes say if their points are independent.
        share: of the points that lie on a plane within three standard deviations, 0 to 1.
        met: share of the points in cells that hold any points, 0 to 1.
        sigma: weighted root mean square distance from the planes, metres.
        converged: whether the last step was small and the pose stayed near where it began.
    """

    pose: Pose
    information: FloatArray
    share: float
    met: float
    sigma: float
    converged: bool

    __repr__ = one_line


class SurfaceMap:
    """The surfaces of a map in space, one plane a cell, on any lattice.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Lattice, Pose
        >>> from localisation.matching.surfaces import SurfaceMap
        >>> grid = np.stack(np.meshgrid(np.arange(0.0, 4.0, 0.05), np.arange(0.0, 4.0, 0.05)), -1).reshape(-1, 2)
        >>> floor = np.insert(grid, 2, 0.0, axis=1)
        >>> room = np.concatenate([floor, floor[:, [2, 0, 1]], floor[:, [1, 2, 0]]])
        >>> surfaces = SurfaceMap(Lattice.named("D3", resolution=0.4))
        >>> surfaces.add(room)
        >>> start = Pose.from_quaternion([0.04, -0.03, 0.02], [0.0, 0.0, 0.005, 1.0])
        >>> drawn = surfaces.draw(room, start)
        >>> drawn.converged, drawn.pose.is_close(Pose.identity(3), metres=0.002, radians=0.001)
        (True, True)
    """

    def __init__(self, lattice: LatticeLike) -> None:
        """Make one without points.

        Raises:
            ArgumentError: the lattice is one of the plane.
        """
        from localisation.matching import _surface_kernels as kernels

        lattice = as_lattice(lattice)
        if lattice.dim != 3:
            raise ArgumentError(f"surfaces lie in space, and {lattice.name} is a lattice of the plane")
        self.lattice = lattice
        self._used = 0
        self._arrays = kernels.SurfaceArrays(
            np.full(4 * _ROWS, _EMPTY, np.int64), np.zeros(4 * _ROWS, np.int64), np.zeros((_ROWS, kernels.SUMS)),
            np.zeros((_ROWS, 3)), np.zeros((_ROWS, 3)), np.full(_ROWS, -1.0),
        )  # fmt: skip
        self._basis = np.ascontiguousarray(lattice.basis)
        self._keys = np.zeros(0, np.int64)

    def __len__(self) -> int:
        """Return the number of cells that hold or held points."""
        return self._used

    def add(self, points: FloatArray) -> None:
        """Add points (N, 3) in the map's frame, metres.

        Raises:
            BoundsError: a point is not finite or out of range; nothing is added then.
        """
        self._change(points, 1.0)

    def take_away(self, points: FloatArray) -> None:
        """Take points (N, 3) away that were added before."""
        self._change(points, -1.0)

    def _change(self, points: FloatArray, sign: float) -> None:
        from localisation.matching import _surface_kernels as kernels

        points = np.ascontiguousarray(points, np.float64)
        index = self.lattice.quantise(points)
        begin = 0
        changed = np.zeros(len(self._arrays.sums), np.bool_)
        while True:
            begin, self._used = kernels.add(
                self._arrays, index, points, self._basis, sign, begin, self._used, changed
            )
            if begin == len(points):
                break
            self._make_room()
            changed = np.concatenate([changed, np.zeros(len(self._arrays.sums) - len(changed), np.bool_)])
        self._fit(np.flatnonzero(changed))

    def _make_room(self) -> None:
        from hexmap.maps import _counter_kernels as counting

        a = self._arrays
        if self._used >= len(a.table) // 2:
            table, rows = np.full(2 * len(a.table), _EMPTY, np.int64), np.zeros(2 * len(a.table), np.int64)
            counting.rehash(a.table, a.rows, table, rows)
            a = a._replace(table=table, rows=rows)
        if self._used >= len(a.sums):
            more = len(a.sums)
            grown: dict[str, Any] = {
                name: np.concatenate([getattr(a, name), np.zeros((more, *getattr(a, name).shape[1:]))])
                for name in ("sums", "means", "normals")
            }
            a = a._replace(**grown, variances=np.concatenate([a.variances, np.full(more, -1.0)]))
        self._arrays = a

    def _fit(self, rows: IntArray) -> None:
        """Find the planes of cells anew."""
        sums = self._arrays.sums[rows]
        enough = sums[:, 0] >= _LEAST
        self._arrays.variances[rows[~enough]] = -1.0
        rows, sums = rows[enough], sums[enough]
        if not len(rows):
            return
        means = sums[:, 1:4] / sums[:, :1]
        products = sums[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3) / sums[:, :1, None]
        values, axes = np.linalg.eigh(products - means[:, :, None] * means[:, None, :])
        flat = (values[:, 1] > (_SPREAD * self.lattice.resolution) ** 2) & (values[:, 0] < _FLAT**2 * values[:, 1])
        self._arrays.means[rows] = means + self._centres(rows)
        self._arrays.normals[rows] = axes[:, :, 0]
        self._arrays.variances[rows] = np.where(flat, np.maximum(values[:, 0], 0.0), -1.0)

    def _centres(self, rows: IntArray) -> FloatArray:
        """Return the centres (M, 3) of the cells of rows, metres."""
        from hexmap.lattice.keys import unpack

        if len(self._keys) < self._used:
            taken = self._arrays.table != _EMPTY
            self._keys = np.zeros(self._used, np.int64)
            self._keys[self._arrays.rows[taken]] = self._arrays.table[taken]
        return self.lattice.centres(unpack(self._keys[rows], 3))

    def cells(self) -> VoxelList:
        """Return the cells that hold points."""
        from hexmap.lattice.keys import unpack

        self._centres(np.zeros(0, np.int64))
        holds = self._arrays.sums[: self._used, 0] > 0.0
        return VoxelList.from_cells(unpack(self._keys[: self._used][holds], 3), self.lattice)

    def planes(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return points on the planes (M, 3), unit normals (M, 3), and how many points each has (M,)."""
        rows = np.flatnonzero(self._arrays.variances[: self._used] >= 0.0)
        return self._arrays.means[rows], self._arrays.normals[rows], self._arrays.sums[rows, 0]

    def draw(self, points: FloatArray, start: Pose, *, farthest: float = 1.0) -> Drawn:
        """Move a scan onto the surfaces.

        Args:
            points: (P, 3) the scan in the sensor's frame, metres; some thousand tell as much as all.
            start: T_map_scan, nearer than half a cell.
            farthest: in resolutions: a scan that moves by more has met something else.
        """
        from localisation.matching import _surface_kernels as kernels

        points = np.ascontiguousarray(points, np.float64)
        tables = self.lattice.quantiser_tables
        index, planes = np.empty((len(points), 3), np.int32), np.empty(len(points), np.int64)
        H, g = np.zeros((6, 6)), np.zeros(6)
        pose, width, small = start, _FIRST_WIDTH * self.lattice.resolution, False
        sigma, count, total, met = 0.0, 0, 0.0, 0
        for _ in range(_STEPS):
            placed = pose.apply(points)
            met = kernels.find_planes(self._arrays, tables, placed, index, planes)
            total, squares, count = kernels.normal_equations(
                self._arrays, placed, planes, pose.translation, width, H, g
            )
            if count < _ENOUGH:
                return Drawn(start, np.zeros((6, 6)), 0.0, met / max(1, len(points)), 0.0, False)
            sigma = math.sqrt(squares / total)
            if small:
                break
            step = -_held_inverse(H) @ g
            pose = Pose(exponential(step[3:]) @ pose.rotation, pose.translation + step[:3])
            least = max(_SIGMAS * max(sigma, _LEAST_SIGMA), 0.02)
            small = width <= least and float(np.abs(step).max()) < _TOLERANCE
            width = max(0.5 * width, least)
        moved = math.dist(pose.translation, start.translation)
        near = self._near(pose.apply(points), planes, 3.0 * max(sigma, _LEAST_SIGMA))
        share, met_share = near / max(1, len(points)), met / max(1, len(points))
        if moved > farthest * self.lattice.resolution:
            return Drawn(start, np.zeros((6, 6)), share, met_share, sigma, False)
        return Drawn(pose, H / max(sigma, _LEAST_SIGMA) ** 2, share, met_share, sigma, True)

    def _near(self, placed: FloatArray, planes: IntArray, metres: float) -> int:
        """Return how many points lie nearer to their planes than some metres."""
        on = planes >= 0
        off = ((placed[on] - self._arrays.means[planes[on]]) * self._arrays.normals[planes[on]]).sum(axis=1)
        return int((np.abs(off) <= metres).sum())


def _held_inverse(H: FloatArray) -> FloatArray:
    """Return the inverse (6, 6) of normal equations; what no plane holds gets no step and stays where it is.

    Rotations are counted in how far they move points, or a wide floor would hide what few walls say of translation.
    """
    lever = math.sqrt(float(np.trace(H[3:, 3:]) / np.trace(H[:3, :3])))
    scale = np.repeat([1.0, 1.0 / max(lever, 1e-9)], 3)
    values, axes = np.linalg.eigh(scale[:, None] * H * scale)
    held = values > _HELD * values[-1]
    axes = scale[:, None] * axes[:, held]
    return np.asarray((axes / values[held]) @ axes.T)


def first_of_each_cell(points: FloatArray, lattice: Lattice) -> FloatArray:
    """Return the first point of each cell of a lattice in the points' own frame, in their order: (K, 3)."""
    from localisation.matching import _surface_kernels as kernels

    if not len(points):
        return points
    index = lattice.quantise(points)
    chosen = np.zeros(len(points), np.bool_)
    kernels.first_of_each(index, np.empty(1 << (2 * len(points) - 1).bit_length(), np.int64), chosen)
    return points[chosen]
