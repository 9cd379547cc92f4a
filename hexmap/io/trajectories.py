"""Trajectory files: TUM and KITTI in and out, EuRoC in, and true relations in."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import IO, Literal

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError, FileAccessError, TrajectoryError
from hexmap.base.text import shown
from hexmap.io.file_kinds import BOM, find_kind
from hexmap.io.read_file import cannot_read, check_regular
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import euler_to_quaternions, quaternions_to_rotations
from hexmap.poses.trajectory import Relations, Trajectory

_KITTI = tuple(f"{letter}{k}" for k in (1, 2, 3) for letter in ("r1", "r2", "r3", "t"))
_EUROC = ("nanoseconds", "x", "y", "z", "qw", "qx", "qy", "qz")
_LEAST_NANOSECONDS = 1e6  # a millisecond; a smaller stamp is one in seconds


def read_tum(path: str | os.PathLike[str]) -> Trajectory:
    """Read a trajectory in TUM format: ``stamp x y z qx qy qz qw``, in seconds and metres.

    Lines starting with ``#`` and blank lines are skipped. Quaternions are normalised.

    Raises:
        FileAccessError: the file cannot be opened.
        TrajectoryError: a line without eight finite numbers or with a quaternion whose length is
            not 1 (to 1 %), or a file without poses; the text names file, line and value.
    """
    table, lines = _read_table(path, ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw"), "poses")
    _check_quaternions(path, table[:, 4:], lines)
    return Trajectory(table[:, 0], table[:, 1:4], table[:, 4:])


def read_trajectory(path: str | os.PathLike[str], times: str | os.PathLike[str] | None = None) -> Trajectory:
    """Read a trajectory in the format of TUM, KITTI or EuRoC, whichever the first line of numbers is of.

    - TUM: ``stamp x y z qx qy qz qw``, see :func:`read_tum`.
    - KITTI: the twelve numbers of a 3 x 4 matrix, row after row; there are no stamps, so they count the poses, from 0,
      or come from ``times``.
    - EuRoC: ``nanoseconds,x,y,z,qw,qx,qy,qz`` and any number of columns more, with commas.

    The axes are those of the file. Comments (#), blank lines and a byte-order mark are skipped.

    Args:
        path: the file.
        times: for poses of KITTI, a file with the stamp of each, in seconds, a line each.

    Raises:
        FileAccessError: a file cannot be opened.
        TrajectoryError: a line that is not of the format, a rotation that is none (to 1 %), a file without poses, as
            many stamps as there are not poses, or stamps for poses that have their own; the text names file, line and
            value.
    """
    kind = trajectory_kind(path)
    if times is not None and kind != "KITTI":
        raise TrajectoryError(f"{path}: poses of {kind} have stamps of their own, and {times} would be others")
    if kind == "EuRoC":
        return _read_euroc(path)
    if kind == "TUM":
        return read_tum(path)
    poses = _read_kitti(path)
    if times is None:
        return poses
    stamps, _ = _read_table(times, ("seconds",), "stamps")
    if len(stamps) != len(poses):
        raise TrajectoryError(f"{times}: {len(stamps)} stamps do not fit the {len(poses)} poses of {path}")
    return Trajectory(stamps[:, 0], poses.positions, poses.quaternions)


def trajectory_kind(path: str | os.PathLike[str]) -> Literal["TUM", "KITTI", "EuRoC"]:
    """Return what the first line of numbers of a file of poses is of.

    Raises:
        FileAccessError: the file cannot be opened.
        TrajectoryError: there are no poses in it, or it is a file of another kind.
    """
    first = _first_line(path)
    foreign = find_kind(first)
    if foreign is not None:
        raise TrajectoryError(f"{path}: this is {foreign.name}, not a trajectory")
    if b"," in first:
        return "EuRoC"
    return "KITTI" if len(first.split()) == len(_KITTI) else "TUM"


def _read_kitti(path: str | os.PathLike[str]) -> Trajectory:
    from scipy.spatial.transform import Rotation

    table, lines = _read_table(path, _KITTI, "poses")
    matrices = table.reshape(-1, 3, 4)
    R = matrices[:, :, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
        bad = ~(off <= 0.01) | ~(np.linalg.det(R) > 0.0)
    if bad.any():
        i = int(np.argmax(bad))
        raise TrajectoryError(f"{path}, line {lines[i]}: the first three columns of the matrix are no rotation")
    quaternions = Rotation.from_matrix(R).as_quat(canonical=True)
    return Trajectory(np.arange(len(table), dtype=np.float64), matrices[:, :, 3], quaternions)


def _read_euroc(path: str | os.PathLike[str]) -> Trajectory:
    table, lines = _read_table(path, _EUROC, "poses", separator=b",")
    if not (np.abs(table[:, 0]) >= _LEAST_NANOSECONDS).all():
        i = int(np.argmax(np.abs(table[:, 0]) < _LEAST_NANOSECONDS))
        raise TrajectoryError(
            f"{path}, line {lines[i]}: the stamp {table[i, 0]:.10g} is no number of nanoseconds, with which a line of "
            f"EuRoC begins: {','.join(_EUROC)}"
        )
    _check_quaternions(path, table[:, 4:8], lines)
    return Trajectory(table[:, 0] * 1e-9, table[:, 1:4], table[:, [5, 6, 7, 4]])


def write_tum(path: str | os.PathLike[str], trajectory: Trajectory) -> None:
    """Write a trajectory in TUM format; an older file of that name is replaced in one step.

    Raises:
        FileAccessError: the folder is missing or not writable.
    """
    with TumWriter(path) as writer:
        for stamp, pose in zip(trajectory.stamps.tolist(), trajectory, strict=True):
            writer.append(stamp, pose)


def write_kitti(
    path: str | os.PathLike[str], trajectory: Trajectory, times: str | os.PathLike[str] | None = None
) -> None:
    """Write a trajectory in KITTI format: the twelve numbers of each pose's 3 x 4 matrix, row after row, in metres.

    The format has no stamps: ``times`` is where they go, in seconds, a line each. Axes stay as they are.

    Raises:
        FileAccessError: a folder is missing or not writable.
    """
    matrices = np.concatenate([trajectory.rotations(), trajectory.positions[:, :, None]], axis=2).reshape(-1, 12) + 0.0
    with contextlib.ExitStack() as stack:
        handle = stack.enter_context(atomic_write(path, "w"))
        handle.writelines(" ".join(f"{v:.12e}" for v in row) + "\n" for row in matrices.tolist())
        if times is not None:
            of_times = stack.enter_context(atomic_write(times, "w"))
            of_times.writelines(f"{stamp:.6f}\n" for stamp in trajectory.stamps.tolist())


class TumWriter:
    """Write a trajectory pose by pose; the file appears, whole, when the block ends well.

    On an exception, Ctrl-C included, an older file of that name stays as it was.

    Attributes:
        path: where the trajectory goes.
        count: poses appended so far.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from hexmap import Pose
        >>> from hexmap.io.trajectories import TumWriter
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
    rotations = quaternions_to_rotations(euler_to_quaternions(table[:, 5:8]))
    return Relations(table[:, 0], table[:, 1], table[:, 2:5], rotations)


def _check_quaternions(path: str | os.PathLike[str], quaternions: FloatArray, lines: list[int]) -> None:
    with np.errstate(over="ignore"):  # infinitely long is what they are
        norms = np.linalg.norm(quaternions, axis=1)
    bad = ~(np.abs(norms - 1.0) <= 0.01)
    if bad.any():
        i = int(np.argmax(bad))
        raise TrajectoryError(f"{path}, line {lines[i]}: the quaternion's length is {norms[i]:.6g}, not 1")


def _lines(path: str | os.PathLike[str]) -> Iterator[tuple[int, bytes]]:
    """Yield (number, line) of those that are neither blank nor comments."""
    try:
        check_regular(path, os.stat(path).st_mode)
        with open(path, "rb") as handle:
            for number, raw in enumerate(handle, 1):
                line = (raw.removeprefix(BOM) if number == 1 else raw).strip()
                if line and not line.startswith(b"#"):
                    yield number, line
    except FileAccessError:
        raise
    except (OSError, ValueError) as error:  # a ValueError: a path with a null character
        raise cannot_read(path, error) from error


def _first_line(path: str | os.PathLike[str]) -> bytes:
    """Return the first line of data; EuRoC's header may come without its #."""
    for _, line in _lines(path):
        if not line.lower().startswith((b"timestamp", b"time,", b"stamp")):
            return line
    raise TrajectoryError(f"{path}: no poses in the file")


def _read_table(
    path: str | os.PathLike[str], columns: tuple[str, ...], what: str, separator: bytes | None = None
) -> tuple[FloatArray, list[int]]:
    """Read lines of numbers; comments (#) and blank lines are skipped. Returns rows and line numbers.

    With a separator there may be more columns than those asked for, and a header in words.
    """
    rows: list[list[float]] = []
    lines: list[int] = []
    for number, line in _lines(path):
        tokens = line.split(separator)
        if separator is not None:
            if not rows and line[:1].isalpha():
                continue
            tokens = tokens[: len(columns)]
        try:
            row = [float(token) for token in tokens]
        except ValueError:
            row = []
        # One test for all three complaints keeps the loop quick; the text is made below.
        if len(row) != len(columns) or not math.isfinite(sum(row)):
            raise TrajectoryError(f"{path}, line {number}: {_complaint(tokens, columns)}")
        rows.append(row)
        lines.append(number)
    if not rows:
        raise TrajectoryError(f"{path}: no {what} in the file")
    return np.array(rows, dtype=np.float64), lines


def _complaint(tokens: list[bytes], columns: tuple[str, ...]) -> str:
    for token in tokens:
        try:
            if not math.isfinite(float(token)):
                return f"'{shown(token)}' is not finite"
        except ValueError:
            return f"'{shown(token)}' is not a number; expected: {' '.join(columns)}"
    if len(tokens) == len(columns):
        return "the numbers are too large"
    return f"{len(tokens)} numbers, expected {len(columns)}: {' '.join(columns)}"
