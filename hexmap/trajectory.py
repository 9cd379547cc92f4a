"""Trajectories: poses with time stamps, in the order in which things happened.

Files are in the format of the TUM RGB-D benchmark, one pose a line, ``stamp x y z qx qy qz qw``
in seconds and metres. The order of the lines is the order of events; stamps may repeat and step
back, and nothing here sorts them.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.atomic import atomic_write
from hexmap.errors import ArgumentError, FileAccessError, TrajectoryError
from hexmap.pose import Pose

__all__ = ["Relations", "Trajectory", "TumWriter", "read_relations", "read_tum", "write_tum"]

FloatArray = NDArray[np.float64]


def _frozen(values: ArrayLike) -> FloatArray:
    a = np.array(values, dtype=np.float64, order="C")
    a.setflags(write=False)
    return a


def _quaternions_to_rotations(q: FloatArray) -> FloatArray:
    """Return the (N, 3, 3) rotations of unit quaternions (N, 4) x y z w."""
    x, y, z, w = q.T
    R = np.empty((len(q), 3, 3))
    R[:, 0, 0] = 1 - 2 * (y * y + z * z)
    R[:, 0, 1] = 2 * (x * y - z * w)
    R[:, 0, 2] = 2 * (x * z + y * w)
    R[:, 1, 0] = 2 * (x * y + z * w)
    R[:, 1, 1] = 1 - 2 * (x * x + z * z)
    R[:, 1, 2] = 2 * (y * z - x * w)
    R[:, 2, 0] = 2 * (x * z - y * w)
    R[:, 2, 1] = 2 * (y * z + x * w)
    R[:, 2, 2] = 1 - 2 * (x * x + y * y)
    return R


class Trajectory:
    """Poses with stamps, in file order; immutable.

    ``len(t)`` is the number of poses, ``t[i]`` a :class:`~hexmap.pose.Pose` (of the plane where
    the whole trajectory lies in it, see :attr:`planar`), ``t[a:b]`` a Trajectory, and iterating
    gives the poses.

    Attributes:
        stamps: (N,) float64 seconds; may repeat and step back.
        positions: (N, 3) float64 metres.
        quaternions: (N, 4) float64 unit quaternions x y z w.

    Examples:
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
        s, p, q = _frozen(stamps), _frozen(positions), np.array(quaternions, dtype=np.float64)
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
        return _quaternions_to_rotations(self.quaternions)

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
        place = np.searchsorted(ordered, wanted)
        right, left = np.minimum(place, len(self) - 1), np.maximum(place - 1, 0)
        to_left, to_right = np.abs(wanted - ordered[left]), np.abs(ordered[right] - wanted)
        use_left = to_left <= to_right
        found = order[np.where(use_left, left, right)].astype(np.int64)
        return found, np.where(use_left, to_left, to_right)

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

    def __post_init__(self) -> None:
        """Make the arrays read-only float64 and check their shapes."""
        for name in ("from_stamps", "to_stamps", "translations", "rotations"):
            object.__setattr__(self, name, _frozen(getattr(self, name)))
        n = len(self.from_stamps)
        shapes = (self.from_stamps.shape, self.to_stamps.shape, self.translations.shape, self.rotations.shape)
        if shapes != ((n,), (n,), (n, 3), (n, 3, 3)):
            raise ArgumentError(f"relations take arrays of shape (N,), (N,), (N, 3) and (N, 3, 3), not {shapes}")

    def __len__(self) -> int:
        """Return the number of relations."""
        return len(self.from_stamps)


def _read_table(path: str | os.PathLike[str], columns: tuple[str, ...], what: str) -> tuple[FloatArray, list[int]]:
    """Read lines of numbers; comments (#) and blank lines are skipped. Returns rows and line numbers."""
    rows: list[list[float]] = []
    lines: list[int] = []
    try:
        with open(path, "rb") as handle:
            for number, raw in enumerate(handle, 1):
                tokens = raw.split()
                if not tokens or tokens[0].startswith(b"#"):
                    continue
                try:
                    row = [float(token) for token in tokens]
                except ValueError:
                    row = []
                # One test for all three complaints keeps the loop quick; the text is made below.
                if len(row) != len(columns) or not math.isfinite(sum(row)):
                    raise TrajectoryError(f"{path}, line {number}: {_complaint(tokens, columns)}")
                rows.append(row)
                lines.append(number)
    except OSError as error:
        raise FileAccessError(f"{path}: cannot be read: {error.strerror or error}") from error
    if not rows:
        raise TrajectoryError(f"{path}: no {what} in the file")
    return np.array(rows, dtype=np.float64), lines


def _complaint(tokens: list[bytes], columns: tuple[str, ...]) -> str:
    for token in tokens:
        text = token[:24].decode("utf-8", "replace")
        # A binary file ends here on its first line: escape what a terminal should not see.
        shown = text if text.isprintable() else ascii(text)[1:-1]
        try:
            if not math.isfinite(float(token)):
                return f"'{shown}' is not finite"
        except ValueError:
            return f"'{shown}' is not a number; expected: {' '.join(columns)}"
    if len(tokens) == len(columns):
        return "the numbers are too large"
    return f"{len(tokens)} numbers, expected {len(columns)}: {' '.join(columns)}"


def read_tum(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory in TUM format: ``stamp x y z qx qy qz qw``, in seconds and metres.

    Lines starting with ``#`` and blank lines are skipped. Quaternions are normalised.

    Raises:
        FileAccessError: the file cannot be opened.
        TrajectoryError: a line without eight finite numbers or with a quaternion whose length is
            not 1 (to 1 %), or a file without poses; the text names file, line and value.
    """
    table, lines = _read_table(path, ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw"), "poses")
    norms = np.linalg.norm(table[:, 4:], axis=1)
    bad = np.abs(norms - 1.0) > 0.01
    if bad.any():
        i = int(np.argmax(bad))
        raise TrajectoryError(f"{path}, line {lines[i]}: the quaternion's length is {norms[i]:.6g}, not 1")
    return Trajectory(table[:, 0], table[:, 1:4], table[:, 4:])


def read_relations(path: str | os.PathLike[str]) -> Relations:
    """Read true relative poses: ``t1 t2 dx dy dz roll pitch yaw``, seconds, metres, radians.

    The pose at t2 seen from the pose at t1 (Kuemmerle et al. 2009); the rotation is
    Rz(yaw) Ry(pitch) Rx(roll).

    Raises:
        FileAccessError: the file cannot be opened.
        TrajectoryError: a line without eight finite numbers, or a file without relations; the
            text names file, line and value.
    """
    table, _ = _read_table(path, ("t1", "t2", "dx", "dy", "dz", "roll", "pitch", "yaw"), "relations")
    half = 0.5 * table[:, 5:8]
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    quaternions = np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=1,
    )
    return Relations(table[:, 0], table[:, 1], table[:, 2:5], _quaternions_to_rotations(quaternions))


class TumWriter:
    """Write a trajectory pose by pose; the file appears, whole, when the block ends well.

    On an exception, Ctrl-C included, an older file of that name stays as it was.

    Attributes:
        path: where the trajectory goes.
        count: poses appended so far.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with TumWriter(Path(folder) / "a.tum") as writer:
        ...         writer.append(0.5, Pose.planar(1.0, 2.0, 0.0))
        ...     (Path(folder) / "a.tum").read_text().split()[:4]
        ['0.500000', '1.000000000', '2.000000000', '0.000000000']
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Take the path; the file is opened by ``with``."""
        self.path = Path(path)
        self.count = 0
        self._stack = contextlib.ExitStack()
        self._handle: IO[str] | None = None

    def __enter__(self) -> TumWriter:
        """Open the temporary file.

        Raises:
            FileAccessError: the folder is missing or not writable.
        """
        self._handle = self._stack.enter_context(atomic_write(self.path, "w"))
        return self

    def append(self, stamp: float, pose: Pose) -> None:
        """Append one pose at ``stamp`` seconds.

        Raises:
            ArgumentError: a stamp that is not finite, or a writer outside its ``with`` block.
        """
        if self._handle is None:
            raise ArgumentError(f"{self.path}: a TumWriter is used inside a with block")
        if not math.isfinite(stamp):
            raise ArgumentError(f"{self.path}: the stamp of pose {self.count} is {stamp}")
        t, q = pose.translation, pose.quaternion()
        z = float(t[2]) if pose.dim == 3 else 0.0
        self._handle.write(
            f"{stamp:.6f} {t[0]:.9f} {t[1]:.9f} {z:.9f} {q[0]:.12f} {q[1]:.12f} {q[2]:.12f} {q[3]:.12f}\n"
        )
        self.count += 1

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        """Put the file in its place, or remove the temporary one after an exception."""
        self._handle = None
        return self._stack.__exit__(kind, error, trace)


def write_tum(path: str | os.PathLike[str], trajectory: Trajectory) -> None:
    """Write a trajectory in TUM format; an older file of that name is replaced in one step.

    Raises:
        FileAccessError: the folder is missing or not writable.
    """
    with TumWriter(path) as writer:
        for stamp, pose in zip(trajectory.stamps.tolist(), trajectory, strict=True):
            writer.append(stamp, pose)
