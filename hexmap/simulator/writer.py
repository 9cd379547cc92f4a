"""The log of a run, as CARMEN text, and the true poses beside it."""

from __future__ import annotations

import gzip
import io
import math
import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

import numpy as np
from numpy.typing import NDArray

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from hexmap.simulator.buildings import Building
from hexmap.simulator.events import OdometryNoise, plan_drive, simulate
from hexmap.simulator.laser import NO_RETURN, Laser

__all__ = ["LogSummary", "write_log"]


@dataclass(frozen=True)
class LogSummary:
    """What was written.

    Attributes:
        scans: number of laser readings.
        odometry: number of odometry readings.
        metres: distance driven.
        seconds: time of the last event; the first is at 0.
        path: the log.
        truth_path: the true poses, if they were asked for.
    """

    scans: int
    odometry: int
    metres: float
    seconds: float
    path: Path
    truth_path: Path | None


def write_log(
    path: str | os.PathLike[str],
    building: Building,
    truth_path: str | os.PathLike[str] | None = None,
    *,
    laser: Laser | None = None,
    odometry: OdometryNoise | None = None,
    seed: int = 0,
    speed: float = 0.5,
    duration: float | None = None,
) -> LogSummary:
    """Simulate a run and write it as a CARMEN log, with the true poses as a TUM file.

    The log has ``FLASER`` lines (ranges to the centimetre, 81.83 for no return) and ``ODOM`` lines; the same
    arguments give the same bytes. CARMEN text holds neither the angles of the beams nor where the laser is mounted:
    a reader assumes 180 degrees counter-clockwise from -90 and has to be told of any other ``laser``. The true poses
    are T_map_robot, the map's frame being the building's, one line ``stamp x y z qx qy qz qw`` for each event, in the
    order of the log; the odometry begins at 0 instead. Each file appears complete or not at all.

    Args:
        path: the log; compressed if the name ends in ``.gz``.
        building: the walls and the path.
        truth_path: the true poses; None writes none.
        laser: settings of the laser; a SICK LMS by default.
        odometry: settings of the wheels.
        seed: of the random numbers.
        speed: metres a second.
        duration: seconds after which to stop, if that is before the end of the path.

    Raises:
        ArgumentError: a setting out of its range, or one name for both files.
        FileAccessError: a file that cannot be written.
    """
    laser = laser or Laser()
    drive, _ = plan_drive(building, seed, speed, duration)
    events = simulate(building, laser, odometry, seed, speed, duration)
    log_path, tum_path = Path(path), None if truth_path is None else Path(truth_path)
    if log_path == tum_path:
        raise ArgumentError(f"the log and the true poses cannot both be {log_path}")
    scans = readings = 0
    stamp = 0.0
    previous: tuple[float, Pose] | None = None
    with ExitStack() as files:
        # Entered first, so left last: the log takes its name only when the true poses have theirs.
        log = files.enter_context(_open(log_path))
        truth = None if tum_path is None else files.enter_context(_open(tum_path))
        name = " ".join(building.name.split())
        log.write(f"# CARMEN log, simulated by hexmap: building {name}, seed {seed}\n")
        for simulated in events:
            event = simulated.event
            stamp = event.stamp
            if isinstance(event, Scan):
                scans += 1
                assert simulated.ranges is not None and event.odometry is not None
                log.write(_flaser(stamp, simulated.ranges, event.odometry, laser.mount))
            else:
                readings += 1
                log.write(_odom(stamp, event.pose, previous))
                previous = stamp, event.pose
            if truth is not None:
                truth.write(_tum(stamp, simulated.T_map_robot))
    return LogSummary(scans, readings, drive.length_until(stamp), stamp, log_path, tum_path)


def _flaser(stamp: float, ranges: NDArray[np.float64], T_odom_robot: Pose, mount: Pose) -> str:
    """Return a line ``FLASER n r1..rn x y theta odom_x odom_y odom_theta ipc_time host logger_time``."""
    written = np.where(np.isfinite(ranges), ranges, NO_RETURN).tolist()
    values = ("%.2f " * len(written)) % tuple(written)
    poses = f"{_pose(T_odom_robot @ mount)} {_pose(T_odom_robot)}"
    return f"FLASER {len(written)} {values}{poses} {stamp:.6f} sim {stamp:.6f}\n"


def _odom(stamp: float, pose: Pose, previous: tuple[float, Pose] | None) -> str:
    """Return a line ``ODOM x y theta tv rv accel ipc_time host logger_time``, velocities as the wheels see them."""
    tv = rv = 0.0
    if previous is not None:
        seconds, step = stamp - previous[0], previous[1].inverse() @ pose
        tv, rv = math.hypot(step.x, step.y) / seconds, step.theta / seconds
    return f"ODOM {_pose(pose)} {tv:.6f} {rv:.6f} 0.000000 {stamp:.6f} sim {stamp:.6f}\n"


def _pose(pose: Pose) -> str:
    return f"{pose.x:.6f} {pose.y:.6f} {pose.theta:.6f}"


def _tum(stamp: float, pose: Pose) -> str:
    half = 0.5 * pose.theta
    return f"{stamp:.6f} {pose.x:.9f} {pose.y:.9f} 0 0 0 {math.sin(half):.9f} {math.cos(half):.9f}\n"


@contextmanager
def _open(path: Path) -> Iterator[IO[str]]:
    """Open a text file that takes its name only once it is complete; compressed if the name ends in ``.gz``."""
    with ExitStack() as stack:
        data: IO[bytes] = stack.enter_context(atomic_write(path))
        if path.suffix == ".gz":
            # Neither a time nor a name in the header: the same log is the same bytes.
            data = cast("IO[bytes]", stack.enter_context(gzip.GzipFile("", "wb", 6, data, mtime=0)))
        text = io.TextIOWrapper(data, encoding="utf-8", newline="\n")
        try:
            yield text
        finally:
            # Flushes, and leaves closing to those who opened.
            text.detach()
