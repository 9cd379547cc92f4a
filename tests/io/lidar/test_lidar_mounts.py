"""Where a LiDAR sits on its robot, by tf: chains, the last static transform, bad ones, joints, and what is not used."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hexmap.io.lidar import LidarLog, LidarLogSettings, open_lidar
from hexmap.poses.pose import Pose
from tests.io.lidar.clouds import KINDS, CloudBag, room, xyz

# A mast that leans, and on it a LiDAR that hangs upside down.
MAST = Pose.from_quaternion([0.2, -0.1, 0.9], [0.0, math.sin(0.1), 0.0, math.cos(0.1)])
HEAD = Pose.from_quaternion([0.0, 0.05, 0.3], [1.0, 0.0, 0.0, 0.0])
TIMES = {"t": np.linspace(0, 1e8, 60).astype(np.uint32)}


def log_of(bag: CloudBag, **settings: object) -> LidarLog:
    log = open_lidar(bag.path, LidarLogSettings(**settings))  # type: ignore[arg-type]
    list(log)
    return log


@pytest.mark.parametrize("kind", KINDS)
def test_static_transforms_make_the_mount(tmp_path: Path, kind: str) -> None:
    with CloudBag(tmp_path, kind) as bag:
        # A first calibration that was wrong; the last static transform counts.
        bag.transforms(99.0, ("mast", "lidar", MAST), ("base_link", "/mast", MAST))
        for k in range(3):
            bag.write({**xyz(room(60, k)), **TIMES}, 100.0 + k)
        bag.transforms(100.5, ("mast", "lidar", HEAD))
    log = log_of(bag)
    assert log.mount is not None and log.mount.is_close(MAST @ HEAD, 1e-12, 1e-12)
    assert (log.robot, log.poses_of, log.unused, log.warnings) == ("base_link", "the robot ('base_link')", "", [])
    # Points stay in the sensor's frame: there their ranges and times mean something.
    np.testing.assert_array_equal(next(iter(log)).points, room(60, 0))


def test_a_bad_transform_costs_itself_only(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.transforms(99.0, ("base_link", "camera", (0.0, 0.0, 0.0, 0.0)), ("base_link", "lidar", MAST))
        bag.write({**xyz(room()), **TIMES}, 100.0)
    log = log_of(bag)
    assert log.mount is not None and log.mount.is_close(MAST)
    (warning,) = log.warnings
    assert "1 transform of /tf_static ignored, the first base_link -> camera" in warning


def test_a_frame_that_is_chosen_has_its_own_mount(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.transforms(99.0, ("base_link", "left", MAST), ("base_link", "right", HEAD))
        for frame in ("left", "right"):
            bag.write({**xyz(room()), **TIMES}, 100.0, frame=frame)
    for frame, T in (("left", MAST), ("right", HEAD)):
        log = log_of(bag, frame=frame)
        assert log.mount is not None and log.mount.is_close(T)


def test_without_tf_poses_are_the_sensors_and_a_gap_in_tf_is_said(tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    with CloudBag(tmp_path / "plain", "mcap") as bag:
        bag.write({**xyz(room()), **TIMES}, 100.0)
    log = log_of(bag)
    assert (log.mount, log.robot, log.poses_of, log.warnings) == (None, "", "the sensor", [])
    with CloudBag(tmp_path, "mcap") as bag:
        bag.transforms(99.0, ("base_link", "camera", MAST))
        bag.write({**xyz(room()), **TIMES}, 100.0)
    log = log_of(bag)
    assert log.mount is None and log.poses_of == "the sensor"
    assert log.warnings == [
        "run: tf does not say how the LiDAR ('lidar') is mounted on the robot ('base_link'); the poses are the LiDAR's"
    ]


def test_odometry_is_no_mount_and_said_to_be_unused(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.transforms(99.0, ("base_link", "lidar", MAST))
        for k in range(4):
            bag.transforms(100.0 + k, ("odom", "base_link", Pose(np.eye(3), [0.1 * k, 0.0, 0.0])), topic="/tf")
            bag.write({**xyz(room()), **TIMES}, 100.0 + k)
    log = log_of(bag)
    assert log.mount is not None and log.mount.is_close(MAST)
    assert log.unused == "odometry of tf ('odom' to 'base_link')"
    (tmp_path / "topic").mkdir()
    with CloudBag(tmp_path / "topic", "mcap") as bag:
        # The odometry's messages say which frame is the robot's, whatever its name.
        bag.transforms(99.0, ("vehicle", "lidar", MAST))
        bag.reading(100.0, Pose.identity(3), child="vehicle")
        bag.write({**xyz(room()), **TIMES}, 100.0)
    log = log_of(bag)
    assert log.mount is not None and log.mount.is_close(MAST)
    assert (log.robot, log.unused) == ("vehicle", "odometry on /odom")


def test_scans_of_a_joint_that_moves_are_as_from_its_first_place(tmp_path: Path) -> None:
    def nod(k: float) -> Pose:
        return Pose.from_quaternion([0.0, 0.0, 0.02 * k], [0.0, math.sin(0.05 * k), 0.0, math.cos(0.05 * k)])

    with CloudBag(tmp_path, "mcap") as bag:
        bag.transforms(99.0, ("base_link", "mast", MAST))
        for k in range(6):
            bag.transforms(100.0 + 0.1 * k, ("mast", "lidar", nod(k)), topic="/tf")
            # Between two readings of the joint.
            seen = (MAST @ nod(k + 0.5)).inverse().apply(room(60, k))
            bag.write({**xyz(seen), **TIMES}, 100.05 + 0.1 * k)
        bag.transforms(100.6, ("mast", "lidar", nod(6)), topic="/tf")
    log = open_lidar(bag.path)
    scans = list(log)
    assert log.mount is not None and log.mount.is_close(MAST @ nod(0)) and len(scans) == 6
    for k, scan in enumerate(scans):
        np.testing.assert_allclose(log.mount.apply(scan.points), room(60, k), atol=1e-5)
    (warning,) = log.warnings
    assert "the LiDAR moves on its robot by up to 0." in warning and "mounted first" in warning
