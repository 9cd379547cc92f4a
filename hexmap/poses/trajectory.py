"""Trajectories: poses with time stamps, in the order in which things happened.

Files are in the format of the TUM RGB-D benchmark, one pose a line, ``stamp x y z qx qy qz qw``
in seconds and metres. The order of the lines is the order of events; stamps may repeat and step
back, and nothing here sorts them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import FloatArray, frozen
from hexmap.base.errors import ArgumentError, TrajectoryError
from hexmap.base.pictures import drawing, picture_html
from hexmap.base.values import one_line, remade
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import quaternions_to_rotations

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Relations", "Trajectory"]


class Trajectory:
    """Poses with stamps, in file order; immutable.

    ``len(t)`` is the number of poses, ``t[i]`` a :class:`~hexmap.poses.Pose` (of the plane where
    the whole trajectory lies in it, see :attr:`planar`), ``t[a:b]`` a Trajectory, and iterating
    gives the poses.

    Attributes:
        stamps: (N,) float64 seconds; may repeat and step back.
        positions: (N, 3) float64 metres.
        quaternions: (N, 4) float64 unit quaternions x y z w.

    Examples:
        >>> from hexmap import Pose, Trajectory
        >>> t = Trajectory.from_poses([0.0, 1.0], [Pose.identity(2), Pose.planar(1.0, 0.0, 0.5)])
        >>> len(t), t.planar, t[1]
        (2, True, Pose.planar(1, 0, 0.5))
    """

    __slots__ = ("planar", "positions", "quaternions", "stamps")

    stamps: FloatArray
    positions: FloatArray
    quaternions: FloatArray
    planar: bool

    def __init__(self, stamps: ArrayLike, positions: ArrayLike, quaternions: ArrayLike) -> None:
        """Make a trajectory of its arrays; quaternions are normalised.

        Args:
            stamps: (N,) seconds.
            positions: (N, 3) metres.
            quaternions: (N, 4) x y z w, none of length zero.

        Raises:
            ArgumentError: shapes that do not fit, values that are not finite, a quaternion of
                length zero; the text names the first such row.
        """
        s, p, q = frozen(stamps), frozen(positions), np.array(quaternions, dtype=np.float64)
        if s.ndim != 1 or p.shape != (len(s), 3) or q.shape != (len(s), 4):
            raise ArgumentError(
                f"a trajectory takes arrays of shape (N,), (N, 3) and (N, 4), not {s.shape}, {p.shape} and {q.shape}"
            )
        norms = np.linalg.norm(q, axis=1)
        bad = ~(np.isfinite(s) & np.isfinite(p).all(axis=1) & np.isfinite(norms) & (norms > 1e-9))
        if bad.any():
            raise ArgumentError(f"pose {int(np.argmax(bad))} of the trajectory is not finite or has no rotation")
        q /= norms[:, None]
        q.setflags(write=False)
        object.__setattr__(self, "stamps", s)
        object.__setattr__(self, "positions", p)
        object.__setattr__(self, "quaternions", q)
        # Files carry six to nine digits, so exact zeros cannot be asked for after a conversion.
        planar = bool((np.abs(p[:, 2]) < 1e-9).all() and (np.abs(q[:, :2]) < 1e-6).all())
        object.__setattr__(self, "planar", planar)

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse: a trajectory is a value."""
        raise AttributeError("a Trajectory is immutable")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle through the constructor."""
        return (Trajectory, (np.array(self.stamps), np.array(self.positions), np.array(self.quaternions)))

    @classmethod
    def from_poses(cls, stamps: Iterable[float], poses: Iterable[Pose]) -> Trajectory:
        """Make a trajectory of stamps (seconds) and as many poses of the plane or of space.

        Raises:
            ArgumentError: not as many stamps as poses.
        """
        listed = list(poses)
        times = np.array(list(stamps), dtype=np.float64)
        positions = np.zeros((len(listed), 3))
        quaternions = np.empty((len(listed), 4))
        for i, pose in enumerate(listed):
            positions[i, : pose.dim] = pose.translation
            quaternions[i] = pose.quaternion()
        if times.shape != (len(listed),):
            raise ArgumentError(f"{len(times)} stamps do not fit {len(listed)} poses")
        return cls(times, positions, quaternions)

    def __len__(self) -> int:
        """Return the number of poses."""
        return int(self.stamps.shape[0])

    @overload
    def __getitem__(self, index: int) -> Pose: ...
    @overload
    def __getitem__(self, index: slice | NDArray[Any]) -> Trajectory: ...
    def __getitem__(self, index: Any) -> Pose | Trajectory:
        """Return one pose for an integer, a trajectory for a slice or an array of indices."""
        if isinstance(index, (slice, np.ndarray)):
            return Trajectory(self.stamps[index], self.positions[index], self.quaternions[index])
        p, q = self.positions[index], self.quaternions[index]
        if self.planar:
            return Pose.planar(float(p[0]), float(p[1]), 2.0 * math.atan2(float(q[2]), float(q[3])))
        return Pose.from_quaternion(p, q)

    def __iter__(self) -> Iterator[Pose]:
        """Iterate over the poses."""
        return (self[i] for i in range(len(self)))

    def rotations(self) -> FloatArray:
        """Return the rotations as matrices, (N, 3, 3)."""
        return quaternions_to_rotations(self.quaternions)

    def length(self) -> float:
        """Return the length of the path in metres."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def nearest(self, stamps: ArrayLike) -> tuple[NDArray[np.int64], FloatArray]:
        """Find the pose nearest in time to each of ``stamps``.

        The trajectory's own stamps need not be sorted. Poses are looked up in the order of their
        stamps, those of one stamp in the order of the file: the last one before is compared with
        the first one at or after, and the earlier one wins where both are as near.

        Args:
            stamps: (M,) seconds.

        Returns:
            Indices (M,) into the trajectory, and how far off the poses found are, (M,) seconds.

        Raises:
            TrajectoryError: the trajectory is empty.
        """
        if len(self) == 0:
            raise TrajectoryError("the trajectory has no poses")
        wanted = np.atleast_1d(np.asarray(stamps, dtype=np.float64))
        order = np.argsort(self.stamps, kind="stable")
        ordered = self.stamps[order]
        after = np.searchsorted(ordered, wanted)
        right, left = np.minimum(after, len(self) - 1), np.maximum(after - 1, 0)
        to_left, to_right = np.abs(wanted - ordered[left]), np.abs(ordered[right] - wanted)
        use_left = to_left <= to_right
        found = order[np.where(use_left, left, right)].astype(np.int64)
        return found, np.where(use_left, to_left, to_right)

    def plot(self, ax: Axes | None = None, **style: Any) -> Axes:
        """Draw where the poses lead on axes of matplotlib, in metres: a ring at the first one, a disc at the last.

        Seen from above; on axes in space (``projection="3d"``) in space.

        Args:
            ax: axes to draw on, of a map for example; new ones where none are given.
            style: of the line, as :meth:`matplotlib.axes.Axes.plot` takes it: ``color``, ``linewidth``, ``label``, ...

        Returns:
            The axes.

        Examples:
            >>> from hexmap import Pose, Trajectory
            >>> axes = Trajectory.from_poses([0.0, 1.0], [Pose.identity(2), Pose.planar(1.0, 0.0, 0.5)]).plot()
            >>> axes.get_xlabel()
            'x, m'
        """
        return drawing().plot_line(self.positions, ax, **style)

    def _repr_html_(self) -> str:
        """Show a small picture in a notebook."""
        return picture_html(self)

    def __repr__(self) -> str:
        """Show how many poses there are and their time range."""
        if len(self) == 0:
            return "Trajectory(0 poses)"
        return f"Trajectory({len(self)} poses, stamps {self.stamps.min():.6f} to {self.stamps.max():.6f} s)"


@dataclass(frozen=True, eq=False)
class Relations:
    """True relative poses: where the sensor was at ``to_stamps``, seen from ``from_stamps``.

    Attributes:
        from_stamps: (N,) float64 seconds.
        to_stamps: (N,) float64 seconds.
        translations: (N, 3) float64 metres, in the frame at ``from_stamps``.
        rotations: (N, 3, 3) float64.
    """

    from_stamps: FloatArray
    to_stamps: FloatArray
    translations: FloatArray
    rotations: FloatArray

    __repr__ = one_line

    def __post_init__(self) -> None:
        """Make the arrays read-only float64 and check their shapes."""
        for name in ("from_stamps", "to_stamps", "translations", "rotations"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        n = len(self.from_stamps)
        shapes = (self.from_stamps.shape, self.to_stamps.shape, self.translations.shape, self.rotations.shape)
        if shapes != ((n,), (n,), (n, 3), (n, 3, 3)):
            raise ArgumentError(f"relations take arrays of shape (N,), (N,), (N, 3) and (N, 3, 3), not {shapes}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy through the constructor: arrays that are unpickled can be written to."""
        return remade(self)

    def __len__(self) -> int:
        """Return the number of relations."""
        return len(self.from_stamps)
