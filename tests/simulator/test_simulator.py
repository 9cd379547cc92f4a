"""The simulator: rays against an obvious reference, drives clear of walls, logs that say what was simulated."""

import dataclasses
import gzip
import math

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, FileAccessError
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from hexmap.simulator.buildings import BUILDINGS, Building, make_building
from hexmap.simulator.drive import Drive, clearance
from hexmap.simulator.events import OdometryNoise, simulate
from hexmap.simulator.laser import NO_RETURN, Laser, cast
from hexmap.simulator.writer import write_log

EXACT = Laser(noise=0.0, resolution=0.0, missing=0.0, max_range=80.0)
SQUARE = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[2, 2], [-2, 2]], [[-2, 2], [-2, -2]]], dtype=float)


def ref_cast(walls, origin, angle):
    """One ray, one wall after the other: solve origin + t d = a + s e."""
    d = np.array([math.cos(angle), math.sin(angle)])
    best = math.inf
    for a, b in walls:
        e = b - a
        det = -d[0] * e[1] + d[1] * e[0]
        if abs(det) < 1e-14:
            continue
        r = a - origin
        t = (-r[0] * e[1] + r[1] * e[0]) / det
        s = (d[0] * r[1] - d[1] * r[0]) / det
        if t >= 0.0 and 0.0 <= s <= 1.0:
            best = min(best, t)
    return best


def gaps(points, walls):
    """Distance of each point from the nearest wall."""
    a, e = walls[:, 0], walls[:, 1] - walls[:, 0]
    rel = points[:, None] - a
    share = np.clip((rel * e).sum(-1) / (e * e).sum(-1), 0.0, 1.0)
    return np.linalg.norm(rel - share[..., None] * e, axis=-1).min(axis=1)


# --- rays ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_rays_equal_the_reference(seed):
    rng = np.random.default_rng(seed)
    walls = rng.uniform(-10, 10, (40, 2, 2))
    for _ in range(10):
        origin, angles = rng.uniform(-10, 10, 2), rng.uniform(-20, 20, 60)
        expected = [ref_cast(walls, origin, angle) for angle in angles]
        np.testing.assert_allclose(cast(walls, origin, angles), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", BUILDINGS)
def test_rays_in_the_buildings_equal_the_reference(name):
    w = make_building(name)
    drive = Drive(w.waypoints)
    for x, y, theta in drive.poses(np.linspace(0, drive.duration, 4)):
        angles = theta + np.linspace(-math.pi, math.pi, 61) + 0.003
        expected = [ref_cast(w.walls, np.array([x, y]), angle) for angle in angles]
        np.testing.assert_allclose(cast(w.walls, [x, y], angles), expected, rtol=0, atol=1e-9)


def test_rays_through_corners_do_not_leak():
    rng = np.random.default_rng(1)
    for _ in range(200):
        turns = np.sort(rng.uniform(0, 2 * math.pi, 7))
        corners = rng.uniform(3, 9, 7)[:, None] * np.column_stack([np.cos(turns), np.sin(turns)])
        walls = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
        if np.diff(turns, append=turns[0] + 2 * math.pi).max() > 3.0:
            continue  # the origin may be outside of such a polygon
        ranges = cast(walls, [0.0, 0.0], np.arctan2(corners[:, 1], corners[:, 0]))
        np.testing.assert_allclose(ranges, np.hypot(*corners.T), atol=1e-9)


def test_a_ray_hits_the_very_end_of_a_wall():
    wall = [[[3.0, 0.0], [3.0, 5.0]]]
    assert cast(wall, [0.0, 0.0], [0.0]).tolist() == [3.0]
    assert np.isinf(cast(wall, [0.0, 0.0], [-1e-6]))[0]


def test_parallel_rays():
    wall = [[[3.0, 0.0], [5.0, 0.0]]]
    assert cast(wall, [0.0, 0.0], [0.0, math.pi]).tolist() == [3.0, math.inf]
    assert np.isinf(cast(wall, [0.0, 1e-6], [0.0]))[0]
    # Along the y axis cos is not quite zero; the wall is seen end on all the same.
    np.testing.assert_allclose(cast([[[0.0, 5.0], [0.0, 3.0]]], [0.0, 0.0], [math.pi / 2]), [3.0], atol=1e-12)


def test_an_origin_on_a_wall_sees_nothing_but_it():
    for origin in ([2.0, 0.3], [2.0, 2.0]):
        assert cast(SQUARE, origin, np.linspace(-3, 3, 9)).tolist() == [0.0] * 9


def test_an_origin_close_to_a_wall_sees_the_room_on_its_side():
    ranges = cast(SQUARE, [2.0 - 1e-8, 0.0], [math.pi, 0.0, math.pi / 2 + 1e-3])
    np.testing.assert_allclose(ranges, [4.0, 1e-8, 2.0], atol=1e-5)


def test_walls_without_length_and_no_walls():
    assert cast([[[2.0, 0.0], [2.0, 0.0]]], [0.0, 0.0], [0.0, 1.0]).tolist() == [2.0, math.inf]
    assert cast(np.empty((0, 2, 2)), [0.0, 0.0], [0.0]).tolist() == [math.inf]
    assert cast(SQUARE, [0.0, 0.0], []).shape == (0,)


def test_rays_refuse_other_shapes_and_nan():
    with pytest.raises(ArgumentError, match="walls"):
        cast([[0.0, 1.0]], [0.0, 0.0], [0.0])
    with pytest.raises(ArgumentError, match="finite"):
        cast(SQUARE, [math.nan, 0.0], [0.0])


# --- buildings and drives --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUILDINGS)
def test_drives_keep_clear_of_walls(name):
    w = make_building(name)
    drive = Drive(w.waypoints)
    assert clearance(drive, w.walls, every=0.02) >= 0.3
    assert clearance(Drive(w.waypoints, speed=1.0), w.walls) >= 0.3


@pytest.mark.parametrize("name", BUILDINGS)
def test_drives_are_continuous_and_keep_their_limits(name):
    drive = Drive(make_building(name).waypoints, speed=0.5, turn_rate=0.8)
    dt = 0.01
    poses = drive.poses(np.arange(0.0, drive.duration, dt))
    steps = np.diff(poses, axis=0)
    assert np.hypot(steps[:, 0], steps[:, 1]).max() <= 0.5 * dt + 1e-9
    assert np.abs(steps[:, 2]).max() <= 0.8 * dt + 1e-9
    np.testing.assert_allclose(
        drive.poses([-1.0, drive.duration + 5.0])[:, :2], make_building(name).waypoints[[0, -1]], atol=1e-9
    )
    # The wheels of a robot do not slip sideways.
    middle = 0.5 * (poses[1:, 2] + poses[:-1, 2])
    # (A step that begins straight and ends in an arc is not quite along its middle heading.)
    assert np.abs(np.cos(middle) * steps[:, 1] - np.sin(middle) * steps[:, 0]).max() < 1e-5


def test_the_office_drive_closes_its_loop_and_is_of_a_size_for_a_demonstration():
    w = make_building("office")
    drive = Drive(w.waypoints)
    assert 120.0 <= drive.length <= 200.0 and 300.0 <= drive.duration <= 480.0
    np.testing.assert_allclose(np.ptp(w.walls.reshape(-1, 2), axis=0), [26.0, 26.0])
    poses = drive.poses(np.arange(0.0, drive.duration, 0.1))
    late = poses[len(poses) // 2 :]
    assert np.hypot(*(late[:, :2] - w.waypoints[0]).T).min() < 0.1


def test_a_drive_that_goes_back_turns_on_the_spot():
    drive = Drive([(0, 0), (2, 0), (0, 0)], speed=0.5, turn_rate=1.0)
    assert drive.duration == pytest.approx(8.0 + math.pi)
    assert drive.length == pytest.approx(4.0)
    np.testing.assert_allclose(drive.poses([4.0 + math.pi / 2])[0, :2], [2.0, 0.0], atol=1e-12)


def test_drives_refuse_nonsense():
    with pytest.raises(ArgumentError, match="two finite way points"):
        Drive([(0, 0)])
    with pytest.raises(ArgumentError, match="way point 2 of the drive repeats"):
        Drive([(0, 0), (1, 0), (1, 0)])
    with pytest.raises(ArgumentError, match="speed"):
        Drive([(0, 0), (1, 0)], speed=0.0)


def test_unknown_buildings_and_bad_buildings():
    with pytest.raises(ArgumentError, match="'moon'; known are office, castle, room"):
        make_building("moon")
    with pytest.raises(ArgumentError, match="walls"):
        Building("mine", np.zeros((2, 2)), np.zeros((2, 2)))
    with pytest.raises(ArgumentError, match="finite"):
        Building("mine", np.full((1, 2, 2), np.nan), np.zeros((2, 2)))
    with pytest.raises(ValueError, match="read-only"):
        make_building("room").walls[0] = 0.0


# --- runs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUILDINGS)
def test_exact_returns_lie_on_walls_and_nothing_is_seen_behind_one(name):
    w = make_building(name)
    for simulated in simulate(w, dataclasses.replace(EXACT, rate=0.1)):
        if isinstance(simulated.event, Scan):
            T = simulated.T_map_robot
            seen = T.apply(simulated.event.points)
            assert gaps(seen, w.walls).max() < 1e-9
            # Every wall between the robot and a point would be the nearer one.
            nearer = T.translation + 0.999 * (seen - T.translation)
            assert (gaps(nearer, w.walls) > 0.0).all()
            blocked = _crossings(T.translation, nearer, w.walls)
            assert not blocked.any()


def _crossings(origin, points, walls):
    """Tell which of the segments from the origin to the points properly cross a wall."""

    def side(p, q, r):
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    p, a, b = points[:, None], walls[None, :, 0], walls[None, :, 1]
    o = np.broadcast_to(origin, p.shape)
    return ((side(o, p, a) * side(o, p, b) < -1e-12) & (side(a, b, o) * side(a, b, p) < -1e-12)).any(axis=1)


def test_noise_has_the_size_that_was_asked_for():
    w = Building("box", SQUARE, [(0.0, 0.0), (0.5, 0.0)])
    noisy = dataclasses.replace(EXACT, noise=0.02, rate=200.0)
    errors = []
    for seen, true in zip(simulate(w, noisy), simulate(w, dataclasses.replace(noisy, noise=0.0)), strict=True):
        if seen.ranges is not None:
            errors.append(seen.ranges - true.ranges)
    assert np.std(errors) == pytest.approx(0.02, rel=0.05)
    assert abs(np.mean(errors)) < 1e-3


def test_the_default_laser_reports_whole_centimetres():
    for simulated in simulate(make_building("room"), duration=2.0):
        if simulated.ranges is not None:
            ranges = simulated.ranges[np.isfinite(simulated.ranges)]
            np.testing.assert_allclose(ranges * 100, np.round(ranges * 100), atol=1e-9)


def test_missing_returns_and_maximum_range():
    w = make_building("room")
    lost = [e.event for e in simulate(w, Laser(missing=0.25)) if isinstance(e.event, Scan)]
    assert np.mean([len(scan.no_return) for scan in lost]) == pytest.approx(0.25 * 181, rel=0.03)
    assert all(len(scan.points) + len(scan.no_return) == 181 for scan in lost)
    for simulated in simulate(w, Laser(max_range=2.0, missing=0.0)):
        if simulated.ranges is not None:
            scan = simulated.event
            assert np.hypot(*scan.points.T).max() <= 2.0 + 1e-9
            far = cast(w.walls, simulated.T_map_robot.translation, Laser().angles + simulated.T_map_robot.theta) > 2.1
            assert far.any() and np.isinf(simulated.ranges[far]).all()
            np.testing.assert_allclose(np.hypot(*scan.no_return.T), 1.0)
    nothing = next(e.event for e in simulate(w, Laser(missing=1.0)) if isinstance(e.event, Scan))
    assert nothing.points.shape == (0, 2)


@pytest.mark.parametrize(
    ("beams", "step", "last"), [(180, 1.0, 89.0), (181, 1.0, 90.0), (360, 0.5, 89.5), (361, 0.5, 90.0)]
)
def test_beams_lie_where_a_reader_of_carmen_logs_expects_them(beams, step, last):
    angles = np.degrees(Laser(beams=beams).angles)
    assert angles[0] == pytest.approx(-90.0) and angles[-1] == pytest.approx(last)
    np.testing.assert_allclose(np.diff(angles), step)


def test_a_mounted_laser_sees_from_where_it_sits():
    w = make_building("room")
    mount = Pose.planar(0.2, 0.05, math.pi / 3)
    laser = dataclasses.replace(EXACT, mount=mount)
    for simulated in simulate(w, laser, duration=3.0):
        if isinstance(simulated.event, Scan):
            seen = (simulated.T_map_robot @ mount).apply(simulated.event.points)
            assert gaps(seen, w.walls).max() < 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_raw_odometry_drifts_but_is_locally_good(seed):
    w = make_building("office")
    readings = [e for e in simulate(w, Laser(beams=1, rate=0.01), seed=seed) if isinstance(e.event, Odometry)]
    T_map_odom = readings[0].T_map_robot
    assert readings[0].event.pose.is_close(Pose.identity())
    errors = [e.T_map_robot.inverse() @ T_map_odom @ e.event.pose for e in readings]
    assert max(np.hypot(error.x, error.y) for error in errors) > 2.0
    assert max(error.angle for error in errors) > math.radians(10.0)
    # Over a second: half a metre, or most of a corner.
    local = [
        (a.T_map_robot.inverse() @ b.T_map_robot).inverse() @ (a.event.pose.inverse() @ b.event.pose)
        for a, b in zip(readings, readings[10:], strict=False)
    ]
    assert np.median([np.hypot(error.x, error.y) for error in local]) < 0.04
    assert np.percentile([error.angle for error in local], 95) < math.radians(3.0)


def test_wheels_that_never_err_follow_the_true_poses():
    readings = list(simulate(make_building("room"), odometry=OdometryNoise.none()))
    T_map_odom = readings[0].T_map_robot
    for simulated in readings:
        event = simulated.event
        pose = event.odometry if isinstance(event, Scan) else event.pose
        assert (T_map_odom @ pose).is_close(simulated.T_map_robot, 1e-9, 1e-9)


def test_the_drift_does_not_depend_on_the_laser_and_a_short_run_begins_like_a_long_one():
    w = make_building("room")
    wheels = [e.event.pose for e in simulate(w, duration=20.0) if isinstance(e.event, Odometry)]
    other = [e.event.pose for e in simulate(w, Laser(beams=361)) if isinstance(e.event, Odometry)]
    assert wheels == other[: len(wheels)]
    short, long = list(simulate(w, duration=5.0)), list(simulate(w, duration=10.0))
    assert all(
        a.event.stamp == b.event.stamp and (a.ranges is None or np.array_equal(a.ranges, b.ranges))
        for a, b in zip(short, long, strict=False)
    )


def test_events_come_in_the_order_of_time_at_their_rates():
    events = [e.event for e in simulate(make_building("room"), Laser(rate=4.0), OdometryNoise(rate=10.0), duration=2.0)]
    stamps = [event.stamp for event in events]
    assert stamps == sorted(stamps) and stamps[0] == 0.0
    assert [event.stamp for event in events if isinstance(event, Scan)] == [k / 4 for k in range(9)]
    assert [event.stamp for event in events if isinstance(event, Odometry)] == [k / 10 for k in range(21)]
    assert isinstance(events[0], Odometry) and isinstance(events[1], Scan)


def test_settings_out_of_range_are_refused_at_once():
    room = make_building("room")
    for bad in ({"seed": -1}, {"speed": 0.0}, {"speed": math.nan}, {"duration": 0.0}):
        with pytest.raises(ArgumentError):
            simulate(room, **bad)
    for bad in (
        {"beams": 0},
        {"rate": 0.0},
        {"noise": -1.0},
        {"resolution": -0.01},
        {"missing": 1.5},
        {"max_range": 90.0},
        {"first": math.inf},
        {"mount": Pose.identity(3)},
    ):
        with pytest.raises(ArgumentError):
            Laser(**bad)
    with pytest.raises(ArgumentError, match="heading"):
        OdometryNoise(heading=-0.1)


# --- logs ---------------------------------------------------------------------------------------------------------


def test_the_same_seed_writes_the_same_bytes(tmp_path):
    w = make_building("castle")
    for name in ("a.clf", "a.clf.gz"):
        contents = []
        for folder, seed in (("one", 3), ("two", 3), ("three", 4)):
            (tmp_path / folder).mkdir(exist_ok=True)
            path, truth = tmp_path / folder / name, tmp_path / folder / "a.tum"
            write_log(path, w, truth, seed=seed, duration=20.0)
            contents.append((path.read_bytes(), truth.read_bytes()))
        assert contents[0] == contents[1]
        assert contents[0][0] != contents[2][0]
        assert contents[0][1] == contents[2][1]  # another seed, the same drive
    assert gzip.decompress((tmp_path / "one" / "a.clf.gz").read_bytes()) == (tmp_path / "one" / "a.clf").read_bytes()


def test_log_lines_say_what_was_simulated(tmp_path):
    w = make_building("room")
    mount = Pose.planar(0.1, 0.0, 0.2)
    laser = Laser(beams=361, missing=0.02, mount=mount)
    summary = write_log(tmp_path / "a.clf", w, tmp_path / "a.tum", laser=laser, seed=5, duration=12.0)
    header, *lines = (tmp_path / "a.clf").read_text().splitlines()
    assert header.startswith("#") and "hexmap" in header and "building room" in header and "seed 5" in header
    truth = np.loadtxt(tmp_path / "a.tum")
    events = list(simulate(w, laser, seed=5, duration=12.0))
    assert len(lines) == len(truth) == len(events) == summary.scans + summary.odometry
    assert (summary.scans, summary.odometry) == (61, 121)
    assert summary.seconds == 12.0 and summary.metres == pytest.approx(6.0, rel=0.05)
    assert (summary.path, summary.truth_path) == (tmp_path / "a.clf", tmp_path / "a.tum")
    for line, row, simulated in zip(lines, truth, events, strict=True):
        words = line.split()
        event = simulated.event
        assert words[-2] == "sim"
        assert float(words[-3]) == float(words[-1]) == row[0] == pytest.approx(event.stamp, abs=1e-6)
        x, y, theta = simulated.T_map_robot.x, simulated.T_map_robot.y, simulated.T_map_robot.theta
        np.testing.assert_allclose(row[1:], [x, y, 0, 0, 0, math.sin(theta / 2), math.cos(theta / 2)], atol=1e-8)
        if isinstance(event, Odometry):
            assert words[0] == "ODOM" and len(words) == 10
            np.testing.assert_allclose([float(v) for v in words[1:4]], _numbers(event.pose), atol=1e-6)
        else:
            assert words[0] == "FLASER" and words[1] == "361" and len(words) == 2 + 361 + 9
            ranges = np.array([float(v) for v in words[2:363]])
            expected = np.where(np.isfinite(simulated.ranges), simulated.ranges, NO_RETURN)
            np.testing.assert_allclose(ranges, expected, atol=1e-9)
            assert all(len(v.split(".")[1]) == 2 for v in words[2:363])
            np.testing.assert_allclose([float(v) for v in words[363:366]], _numbers(event.odometry @ mount), atol=1e-6)
            np.testing.assert_allclose([float(v) for v in words[366:369]], _numbers(event.odometry), atol=1e-6)


def _numbers(pose):
    return [pose.x, pose.y, pose.theta]


def test_a_log_of_the_laser_alone(tmp_path):
    summary = write_log(tmp_path / "a.clf", make_building("room"), odometry=OdometryNoise(rate=0.0), duration=2.0)
    lines = (tmp_path / "a.clf").read_text().splitlines()[1:]
    assert summary.odometry == 0 and summary.truth_path is None
    assert len(lines) == summary.scans == 11 and all(line.startswith("FLASER") for line in lines)
    assert [p.name for p in tmp_path.iterdir()] == ["a.clf"]


def test_files_that_cannot_be_written(tmp_path):
    room = make_building("room")
    with pytest.raises(FileAccessError, match="cannot be written"):
        write_log(tmp_path / "nowhere" / "a.clf", room, duration=1.0)
    with pytest.raises(ArgumentError, match="cannot both"):
        write_log(tmp_path / "a", room, tmp_path / "a")
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_run_leaves_the_old_log(tmp_path, monkeypatch):
    log = tmp_path / "a.clf.gz"
    log.write_bytes(b"old")

    def stop(*_args):
        raise KeyboardInterrupt

    monkeypatch.setattr("hexmap.simulator.writer._flaser", stop)
    with pytest.raises(KeyboardInterrupt):
        write_log(log, make_building("room"), tmp_path / "a.tum")
    assert [p.name for p in tmp_path.iterdir()] == ["a.clf.gz"] and log.read_bytes() == b"old"
