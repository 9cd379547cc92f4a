"""Small inputs that users' situations led to, with the values that are right for them (the folder of HEXMAP_CASES)."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from hexmap.io.clouds.read_points import read_points
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.logs.log import LogSettings
from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import read_trajectory
from hexmap.maps.cell_state import CellState
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan

pytestmark = pytest.mark.data

# The corners of the room and of the two boxes in it, metres.
BOXES = (((0, 0), (10, 6)), ((7, 1), (8, 3)), ((2, 4.5), (2.6, 5.1)))


def wall_distance(points: np.ndarray) -> np.ndarray:
    """Distance of points (N, 2) to the nearest wall of the room."""
    best = np.full(len(points), np.inf)
    for low, high in BOXES:
        corners = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low], dtype=float)
        for a, b in itertools.pairwise(corners):
            part = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            best = np.minimum(best, np.linalg.norm(points - a - part[:, None] * (b - a), axis=1))
    return best


def worst_distance(path: Path, **settings: object) -> tuple[float, int, int, int, list[str], Pose | None]:
    """Return the worst distance to a wall, scans, scans without odometry, readings, warnings and the mount."""
    log = open_log(path, LogSettings(**settings))
    worst, without, last = 0.0, 0, -np.inf
    for event in log:
        if not isinstance(event, Scan):
            last = event.stamp
        elif event.odometry is None:
            without += 1
        elif event.stamp <= last + 0.1 and len(event.points):
            points = (event.odometry @ (log.mount or Pose.identity(2))).apply(event.points)
            worst = max(worst, float(wall_distance(points).max()))
    return worst, log.scans, without, log.odometry, log.warnings, log.mount


@pytest.mark.parametrize(
    ("name", "scans", "readings"),
    [
        ("plain1.bag", 60, 60), ("plain1_tf.bag", 60, 60), ("odom_map.bag", 60, 60), ("mir.bag", 60, 60),
        ("map_jump_oc.bag", 60, 60), ("tor_odomlink.bag", 60, 60), ("world_static_r1.bag", 60, 60), ("pan.bag", 60, 60),
        ("baddef.bag", 20, 20), ("m_ros1.mcap", 40, 40), ("multiecho.bag", 10, 10),
    ],
)  # fmt: skip
def test_every_point_lies_on_a_wall(cases_dir: Path, name: str, scans: int, readings: int) -> None:
    worst, found, without, odometry, warnings, _ = worst_distance(cases_dir / "bags" / name)
    assert (found, without, odometry, warnings) == (scans, 0, readings, [])
    assert worst < 5e-4


@pytest.mark.parametrize("name", ["q_dyn_zero.bag", "q_zero_first_odom.bag"])
def test_a_bad_transform_is_ignored_and_told(cases_dir: Path, name: str) -> None:
    worst, scans, without, odometry, (warning,), _ = worst_distance(cases_dir / "bags" / name)
    assert (scans, without, odometry) == (60, 0, 60) and worst < 5e-4 and "ignored" in warning


def test_two_lasers_on_one_topic(cases_dir: Path) -> None:
    path = cases_dir / "bags" / "twolasers.bag"
    for settings, mount in (({}, Pose.planar(0.3, 0, 0)), ({"scan_frame": "laser_rear"}, Pose.planar(-0.3, 0, np.pi))):
        _, scans, _, _, (warning,), found = worst_distance(path, **settings)
        assert scans == 60 and "60 scans of other frames on /scan left out" in warning
        assert found is not None and found.is_close(mount, 1e-6, 1e-6)
    assert worst_distance(path)[0] < 5e-4


def test_what_cannot_be_right_is_warned_of(cases_dir: Path) -> None:
    (warning,) = worst_distance(cases_dir / "bags" / "notf.bag")[4]
    assert "tf does not say how the laser" in warning
    (warning,) = worst_distance(cases_dir / "bags" / "incneg_wrong.bag")[4]
    assert "angle_increment -0.02 span -4 rad" in warning and "angle_max 2 are 4" in warning
    worst, scans, without, odometry, warnings, _ = worst_distance(cases_dir / "bags" / "st_late_odo.bag")
    assert (scans, without, odometry, warnings) == (60, 10, 50, [])
    assert worst < 0.05, "but for the last scan, which no reading follows, all lie on walls"


def test_carmen_logs(cases_dir: Path) -> None:
    log = open_log(cases_dir / "carmen" / "spin.log")
    assert len(list(log)) == 60 and log.mount is not None and log.mount.is_close(Pose.planar(0.3, 0.0, 0.0))
    worst, scans, without, odometry, warnings, _ = worst_distance(cases_dir / "carmen" / "raw.log")
    assert (scans, without, odometry, warnings) == (30, 0, 30, []) and worst < 2e-3


def test_maps_of_others(cases_dir: Path) -> None:
    folder = cases_dir / "maps"
    plain, coloured = open_grid(folder / "band.yaml"), open_grid(folder / "bandpal.yaml")
    assert np.array_equal(plain.states, coloured.states)
    counts = [int((open_grid(folder / "g_bmp.yaml").states == state).sum()) for state in CellState]
    assert counts == [5, 71, 20], "unknown, free, occupied"


@pytest.mark.parametrize(
    ("name", "count", "dropped"),
    [
        ("hall5.bin", 12_000, 0), ("lower.pcd", 40, 0), ("msnan.pcd", 40, 2), ("paraview.csv", 12, 0),
        ("scan.ptx", 12, 0), ("twoheads.csv", 12, 0), ("hall32_utm.ply", 12_000, 0),
    ],
)  # fmt: skip
def test_points_of_others(cases_dir: Path, name: str, count: int, dropped: int) -> None:
    found = read_points(cases_dir / "points" / name, offset="auto")
    assert (len(found), found.dropped) == (count, dropped)
    extent = found.points.max(axis=0) - found.points.min(axis=0)
    assert (extent < 15.0).all(), "all of them are within a hall"


def test_trajectories_of_others(cases_dir: Path) -> None:
    kitti = read_trajectory(cases_dir / "trajectories" / "kitti.txt")
    euroc = read_trajectory(cases_dir / "trajectories" / "euroc.csv")
    assert (len(kitti), len(euroc)) == (80, 80) and np.allclose(np.diff(euroc.stamps), 0.1, atol=1e-6)
    assert kitti[0].is_close(Pose.planar(2.0, 2.5, 0.0), 1e-6, 1e-6) and euroc[0].is_close(kitti[0], 1e-6, 1e-6)
    assert abs(kitti[1].theta - np.radians(1.00224)) < 1e-4 and abs(euroc[1].theta - 2 * 0.0087462) < 1e-5
