"""The run: a robot drives through a building, and its laser and its wheels report what they believe."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan
from hexmap.simulator.buildings import Building
from hexmap.simulator.drive import Drive
from hexmap.simulator.laser import Laser, cast_unchecked

__all__ = ["OdometryNoise", "SimulatedEvent", "simulate"]

# Separate streams of random numbers, so that other beams leave the wheels as they were.
_WHEELS, _BEAMS = 0, 1


@dataclass(frozen=True)
class OdometryNoise:
    """Settings of the wheels: how often they report and how they drift.

    White noise grows with the square root of the distance, so the drift does not depend on the rate. A bias is constant
    over a run: its sign is drawn and its size is between half of the setting and the whole of it, so that every seed
    drifts.

    Attributes:
        rate: readings a second; 0 for none (the scans carry the odometry all the same).
        translation: white noise of the distance, metres per root metre.
        rotation: white noise of the heading, radians per root radian turned.
        heading: white noise of the heading, radians per root metre driven.
        scale_bias: metres too many or too few a metre.
        rotation_bias: radians too many or too few a radian.
        heading_bias: radians of turn per metre driven that never happened.
    """

    rate: float = 10.0
    translation: float = 0.03
    rotation: float = 0.02
    heading: float = 0.005
    scale_bias: float = 0.03
    rotation_bias: float = 0.03
    heading_bias: float = 0.004

    def __post_init__(self) -> None:
        """Refuse settings that are negative or not finite.

        Raises:
            ArgumentError: such a setting.
        """
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value >= 0.0):
                raise ArgumentError(f"the setting {name} of the odometry must be zero or more, not {value}")

    @classmethod
    def none(cls, rate: float = 10.0) -> OdometryNoise:
        """Return wheels that never err."""
        return cls(rate, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class SimulatedEvent:
    """What the log holds, and what is true.

    Attributes:
        event: the scan, in the laser's frame, or the reading of the odometry. The odometry's frame has its origin
            where the robot starts, x ahead.
        T_map_robot: the true pose of the robot. The map's frame is the building's, that of the walls; the first pose is
            the first way point, not the identity.
        ranges: (B,) what the laser reported in metres, inf for no return; None for odometry.
    """

    event: Event
    T_map_robot: Pose
    ranges: NDArray[np.float64] | None = None

    __repr__ = one_line


def simulate(
    building: Building,
    laser: Laser | None = None,
    odometry: OdometryNoise | None = None,
    seed: int = 0,
    speed: float = 0.5,
    duration: float | None = None,
) -> Iterator[SimulatedEvent]:
    """Drive through a building and yield what laser and wheels report, in the order of time.

    Stamps begin at 0. Where both report at the same time the wheels come first. A scan is taken at one instant. The
    same arguments give the same numbers, bit for bit; a shorter duration gives the beginning of the longer run.

    Args:
        building: the walls and the path.
        laser: settings of the laser; a SICK LMS by default.
        odometry: settings of the wheels.
        seed: of the random numbers, zero or more.
        speed: metres a second.
        duration: seconds after which to stop, if that is before the end of the path.

    Raises:
        ArgumentError: a setting out of its range.
    """
    # Checked here rather than in the generator, so that the caller hears of it at once.
    drive, seconds = plan_drive(building, seed, speed, duration)
    return _events(building, drive, seconds, laser or Laser(), odometry or OdometryNoise(), seed)


def plan_drive(building: Building, seed: int, speed: float, duration: float | None) -> tuple[Drive, float]:
    """Return the drive and how many seconds of it are wanted."""
    if seed < 0:
        raise ArgumentError(f"a seed must be zero or more, not {seed}")
    if duration is not None and not (math.isfinite(duration) and duration > 0.0):
        raise ArgumentError(f"the duration of a run must be positive, not {duration}")
    drive = Drive(building.waypoints, speed=speed)
    return drive, drive.duration if duration is None else min(duration, drive.duration)


def _stamps(rate: float, seconds: float) -> NDArray[np.float64]:
    """Return the times (N,) of ``rate`` readings a second from 0 up to ``seconds``."""
    return np.arange(math.floor(seconds * rate) + 1) / rate if rate > 0.0 else np.empty(0)


def _events(
    building: Building, drive: Drive, seconds: float, laser: Laser, odometry: OdometryNoise, seed: int
) -> Iterator[SimulatedEvent]:
    wheel_stamps, laser_stamps = _stamps(odometry.rate, seconds), _stamps(laser.rate, seconds)
    times = np.concatenate([wheel_stamps, laser_stamps])
    order = np.argsort(times, kind="stable")
    times, scans = times[order], order >= len(wheel_stamps)
    truth = drive.poses(times)
    believed = _drift(truth, odometry, np.random.Generator(np.random.PCG64((seed, _WHEELS))))
    rng = np.random.Generator(np.random.PCG64((seed, _BEAMS)))
    angles = laser.angles
    rays = np.column_stack([np.cos(angles), np.sin(angles)])
    for stamp, is_scan, pose, wheels in zip(
        times.tolist(), scans.tolist(), truth.tolist(), believed.tolist(), strict=True
    ):
        T_map_robot, T_odom_robot = Pose.planar(*pose), Pose.planar(*wheels)
        if not is_scan:
            yield SimulatedEvent(Odometry(stamp, T_odom_robot), T_map_robot)
            continue
        T_map_laser = T_map_robot @ laser.mount
        heading = angles + T_map_laser.theta
        ranges = laser.measure(cast_unchecked(building.walls, T_map_laser.translation, heading), rng)
        hit = np.isfinite(ranges)
        scan = Scan(stamp, ranges[hit, None] * rays[hit], rays[~hit], T_odom_robot)
        yield SimulatedEvent(scan, T_map_robot, ranges)


def _drift(truth: NDArray[np.float64], settings: OdometryNoise, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return what the wheels make of true poses (N, 3): x, y, heading in their own frame, starting at 0."""
    signs = np.where(rng.random(3) < 0.5, -1.0, 1.0)
    scale_bias, rotation_bias, heading_bias = (
        signs * rng.uniform(0.5, 1.0, 3) * [settings.scale_bias, settings.rotation_bias, settings.heading_bias]
    )
    steps = np.diff(truth, axis=0)
    white = rng.standard_normal((len(steps), 2))
    metres, turn = np.hypot(steps[:, 0], steps[:, 1]), steps[:, 2]
    bearing = np.arctan2(steps[:, 1], steps[:, 0]) - truth[:-1, 2]
    metres_seen = metres * (1.0 + scale_bias) + settings.translation * np.sqrt(metres) * white[:, 0]
    spread = np.sqrt(settings.rotation**2 * np.abs(turn) + settings.heading**2 * metres)
    turn_seen = turn * (1.0 + rotation_bias) + heading_bias * metres + spread * white[:, 1]
    believed = np.zeros_like(truth)
    believed[1:, 2] = np.cumsum(turn_seen)
    direction = believed[:-1, 2] + bearing
    believed[1:, 0] = np.cumsum(metres_seen * np.cos(direction))
    believed[1:, 1] = np.cumsum(metres_seen * np.sin(direction))
    return believed
