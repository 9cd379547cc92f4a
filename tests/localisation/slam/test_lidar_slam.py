"""Maps of simulated LiDAR drives: exact truth, loops, garbage, given poses, every lattice in space."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, TrajectoryError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.state_rule import StateRule
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from hexmap.poses.scan import Scan
from hexmap.poses.trajectory import Trajectory
from hexmap.simulator.space import RingLidar
from localisation.evaluation import absolute_error
from localisation.lidar_settings import LidarSettings
from localisation.localiser.lidar_localiser import LidarLocaliser
from localisation.mapping.lidar_map import LidarMappingResult, build_lidar_map, fuse_lidar_log
from localisation.odometry.lidar_odometry import LidarOdometry, RegisteredSweep
from localisation.slam import spatial
from localisation.slam.lidar_slam import LidarSlam, LidarSlamResult
from localisation.slam.pose_graph import Edge, PoseGraph
from tests.lattices import SPATIAL, Case
from tests.localisation.slam.lidar_drives import QUICK, SimulatedLidarLog, block, hall, off

COARSE = LidarSettings(resolution=0.2, levels=2)
# What the walls of the hall are, metres in the building's frame: x, y and z of its inner sides.
SIDES = ((-0.9, 14.9), (-0.9, 10.9), (0.0, 4.0))


@pytest.fixture(scope="module")
def log() -> SimulatedLidarLog:
    return SimulatedLidarLog(hall(), scans=30)


@pytest.fixture(scope="module")
def built(log: SimulatedLidarLog) -> LidarMappingResult:
    return build_lidar_map(log, COARSE)


def rmse(log: SimulatedLidarLog, result: LidarMappingResult) -> float:
    true = Trajectory.from_poses([s.stamp for s in log], log.truth)
    return absolute_error(true, result.poses, "time").translation.rmse


def fingerprint(result: LidarMappingResult) -> list[bytes]:
    cells = [a.tobytes() for level in result.map.levels for part in (level.hits, level.passes)
             for a in (part.index, part.counts)]  # fmt: skip
    return [*cells, result.poses.positions.tobytes(), result.poses.quaternions.tobytes()]


# --- the whole of it ------------------------------------------------------------------------------------------------


def test_a_drive_is_mapped_where_it_was(log: SimulatedLidarLog, built: LidarMappingResult) -> None:
    assert (built.scans, built.matched, built.unmatched, built.missed, built.skipped) == (30, 29, 0, 0, 0)
    assert rmse(log, built) < 0.03 and built.mean_share > 0.3
    way = np.linalg.norm(np.diff([pose.translation for pose in log.truth], axis=0), axis=1).sum()
    assert built.metres == pytest.approx(way, rel=0.05)
    assert [len(level.hits) > 100 and len(level.passes) > 1000 for level in built.map.levels] == [True, True]
    assert built.map.lattice.name == "D3" and built.warnings == []
    # The map in the building's frame: what is hit is its walls, floor and ceiling, or what stands in it.
    back = log.truth[0] @ built.poses[0].inverse()
    hit = back.apply(built.map.state(StateRule()).occupied.centres())
    beyond = [np.maximum(low - hit[:, k], hit[:, k] - high) for k, (low, high) in enumerate(SIDES)]
    assert np.max(beyond, axis=0).max() < 0.35, "two cells at most behind a wall"
    assert (np.abs(np.max(beyond, axis=0)) < 0.25).mean() > 0.6


def test_the_same_log_gives_the_same_bits(log: SimulatedLidarLog, built: LidarMappingResult) -> None:
    assert fingerprint(build_lidar_map(log, COARSE)) == fingerprint(built)


def test_floors_are_level_however_the_sensor_is_held() -> None:
    tilted = replace(QUICK, mount=Pose(exponential(np.array([0.05, 0.15, 0.0])), [0.0, 0.0, 1.0]))
    log = SimulatedLidarLog(hall(), lidar=tilted, scans=20)
    settings = replace(COARSE, free_space=False)
    level, bare = build_lidar_map(log, settings), build_lidar_map(log, replace(settings, level_floor=False))
    assert bare.levelled is None and level.levelled == pytest.approx(np.hypot(0.05, 0.15), abs=0.01)
    heights = [np.ptp(result.poses.positions[:, 2]) for result in (level, bare)]
    assert heights[0] < 0.03 < 0.3 < heights[1]
    for pose, true in zip(level.poses, log.truth, strict=True):
        # Up is up; where north is nobody knows.
        np.testing.assert_allclose(pose.rotation[2], true.rotation[2], atol=0.012)
    assert rmse(log, level) < 0.03 and rmse(log, bare) < 0.03


def test_the_poses_are_the_robots_where_the_mount_is_known() -> None:
    # Hanging upside down from a boom, and looking aside: what no floor could tell.
    mount = Pose(exponential(np.array([math.pi, 0.0, 0.0])) @ exponential(np.array([0.1, 0.0, 1.0])), [0.5, 0.2, 1.2])
    log = SimulatedLidarLog(hall(), lidar=replace(QUICK, mount=mount), scans=16, mounted=True)
    seen: list[Pose] = []
    result = build_lidar_map(log, COARSE, on_pose=lambda stamp, pose, scan: seen.append(pose))
    true = [pose @ mount.inverse() for pose in log.truth]
    # The map begins at the robot and not at the sensor, level as the floor is.
    back = result.poses[0].inverse()
    np.testing.assert_allclose(result.poses[0].translation, 0.0, atol=0.05)
    metres, radians = off([back @ pose for pose in result.poses], [true[0].inverse() @ pose for pose in true])
    assert metres.max() < 0.05 and radians.max() < 0.02
    assert all(a.is_close(b) for a, b in zip(seen, result.poses, strict=True))
    hit = (true[0] @ back).apply(result.map.state(StateRule()).occupied.centres())
    assert hit[:, 2].min() > -0.35 and hit[:, 2].max() < 4.35, "floor and ceiling are where the robot has them"
    assert result.slam is not None and result.slam.pose(5).is_close(result.poses[5], 1e-9, 1e-9)
    given = fuse_lidar_log(log, Trajectory.from_poses([s.stamp for s in log], true), COARSE)
    assert given.poses[3].is_close(true[3], 1e-9, 1e-9)
    hit = given.map.state(StateRule()).occupied.centres()
    assert all(hit[:, k].min() > low - 0.35 and hit[:, k].max() < high + 0.35 for k, (low, high) in enumerate(SIDES))
    localiser = LidarLocaliser(given.map.state(), mount=mount)
    estimate = localiser.add(next(iter(log)))
    assert estimate.pose is not None and estimate.pose.is_close(true[0], 0.1, 0.03)


def test_a_graph_of_the_robot_says_what_that_of_its_sensor_does() -> None:
    rng = np.random.default_rng(0)
    mount = Pose(exponential(rng.normal(size=3)), rng.normal(size=3))
    rows = spatial.motion(rng.normal(size=(4, 6)))
    graph = PoseGraph(spatial.SPACE)
    for row in rows:
        graph.add_node(row)
    for i, j in ((0, 1), (1, 2), (2, 3), (0, 3)):
        noise = rng.normal(size=(6, 6))
        pose = spatial.compose(spatial.between(rows[i], rows[j]), spatial.motion(rng.normal(size=6) * 1e-5))
        graph.add_edge(Edge(i, j, pose, noise @ noise.T + 0.1 * np.eye(6), loop=j == 3))
    result = LidarSlamResult(np.arange(4.0), rows, np.tile(np.eye(6), (4, 1, 1)), [], graph, [0, 1, 2, 3])
    robot = result.of_robot(mount)
    assert all((robot.pose(k) @ mount).is_close(result.pose(k), 1e-9, 1e-9) for k in range(4))
    assert np.array_equal(robot.poses, robot.graph.poses)
    # Normalised by their covariances, what edges and poses say does not depend on where it is seen from.
    np.testing.assert_allclose(robot.graph.residuals(), graph.residuals(), rtol=1e-4)
    moved = spatial.motion(np.full(6, 1e-4))
    off = spatial.small(spatial.compose(spatial.compose(spatial.of_pose(mount), moved), spatial.invert(
        spatial.of_pose(mount))))  # fmt: skip
    known = np.linalg.solve(result.covariances[2], np.full(6, 1e-4)) @ np.full(6, 1e-4)
    assert off @ np.linalg.solve(robot.covariances[2], off) == pytest.approx(known, rel=1e-3)


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_every_lattice_of_space_makes_the_map(case: Case) -> None:
    log = SimulatedLidarLog(hall(), scans=14)
    basis = case.lattice.scaled(0.2 / case.lattice.resolution).basis.tolist()
    named = case.lattice.name in ("Z3", "D3", "D3*", "A2xZ")
    settings = replace(COARSE, lattice=case.lattice.name if named else basis, levels=1)
    result = build_lidar_map(log, settings)
    assert result.missed == 0 and rmse(log, result) < 0.03
    np.testing.assert_allclose(result.map.lattice.basis, basis, atol=1e-12)
    assert LidarSettings.from_dict(settings.to_dict()) == settings


def test_without_free_space_there_are_hits_alone(log: SimulatedLidarLog, built: LidarMappingResult) -> None:
    bare = build_lidar_map(log, replace(COARSE, free_space=False))
    for level, with_passes in zip(bare.map.levels, built.map.levels, strict=True):
        assert len(level.passes) == 0
        np.testing.assert_array_equal(level.hits.index, with_passes.hits.index)
    assert np.array_equal(bare.poses.positions, built.poses.positions)


def test_a_garbage_scan_is_left_out_and_said() -> None:
    def garbage(k: int, scan: Scan) -> Scan:
        points = np.random.default_rng(k).uniform(-8.0, 8.0, (4000, 3))
        return Scan(scan.stamp, points, times=np.zeros(4000)) if k == 12 else scan

    log = SimulatedLidarLog(hall(), scans=22, change=garbage)
    result = build_lidar_map(log, replace(COARSE, free_space=False))
    assert (result.scans, result.missed) == (21, 1) and len(result.poses) == 21
    assert 12 not in np.searchsorted([s.stamp for s in log], result.poses.stamps)
    assert rmse(log, result) < 0.15, "a scan or two until it is found again"


def test_points_at_the_end_of_the_world_cost_themselves_alone() -> None:
    """Drivers write them now and then: with a limit they are out of range, without one their scan is left out."""

    def wild(k: int, scan: Scan) -> Scan:
        points = scan.points.copy()
        points[5] = [1e7, -1e7, 3.0]
        return replace(scan, points=points) if k in (0, 6) else scan

    log = SimulatedLidarLog(hall(), scans=12, change=wild)
    for free_space in (False, True):
        result = build_lidar_map(log, replace(COARSE, free_space=free_space, levels=1))
        assert (result.scans, result.missed) == (12, 0) and rmse(log, result) < 0.03
    result = build_lidar_map(log, replace(COARSE, max_range=None))
    assert result.scans == 10 and rmse(log, result) < 0.04
    assert any("2 scans" in warning for warning in result.warnings)


@pytest.mark.parametrize(
    "stamp", [lambda k, t: 1.0, lambda k, t: 10.0 - t, lambda k, t: t - (k == 5)], ids=["same", "backwards", "one back"]
)
def test_stamps_that_do_not_tell_cost_the_deskewing_alone(stamp: Callable[[int, float], float]) -> None:
    log = SimulatedLidarLog(hall(), scans=12, change=lambda k, scan: replace(scan, stamp=stamp(k, scan.stamp)))
    result = build_lidar_map(log, replace(COARSE, free_space=False))
    true = Trajectory.from_poses([scan.stamp for scan in log], log.truth)
    assert absolute_error(true, result.poses, "order").translation.rmse < 0.06


# --- loops ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def around() -> SimulatedLidarLog:
    return SimulatedLidarLog(block())


def slam_of(log: SimulatedLidarLog, close: bool) -> LidarSlamResult:
    slam = LidarSlam(LidarSettings(), close=close)
    for scan in log:
        slam.register(scan)
    return slam.finish()


def errors(log: SimulatedLidarLog, result: LidarSlamResult) -> np.ndarray:
    return off([result.pose(k) for k in range(len(result.poses))], log.from_first())[0]


def test_loops_are_closed_and_none_is_false(around: SimulatedLidarLog) -> None:
    closed = slam_of(around, True)
    accepted = [record for record in closed.records if record.accepted]
    assert accepted
    for record in accepted:
        i, j = (around.truth[closed.node_scans[n]] for n in (record.i, record.j))
        found = spatial.to_pose(np.array(record.pose))
        assert found.is_close(i.inverse() @ j, 0.15, 0.03), "a loop that is closed is true"
    assert errors(around, closed).mean() < 0.05
    assert closed.covariances[0].max() < 1e-9
    assert len(closed.graph) == len(closed.node_scans) and closed.node_scans[0] == 0


@pytest.mark.long
def test_a_drive_that_drifts_is_mended_by_its_loops(around: SimulatedLidarLog, monkeypatch: pytest.MonkeyPatch) -> None:
    class Drifting(LidarOdometry):
        """Turns a little with every scan, as no log tells."""

        def register(self, scan: Scan) -> RegisteredSweep:
            first = self.surfaces is None
            sweep = super().register(scan)
            if first:
                return sweep
            pose = sweep.pose @ Pose(exponential(np.array([0.0, 0.0, -6e-4])), np.zeros(3))
            self.move_to(pose)
            return replace(sweep, pose=pose)

    monkeypatch.setattr("localisation.slam.lidar_slam.LidarOdometry", Drifting)
    closed, bare = slam_of(around, True), slam_of(around, False)
    assert bare.records == [] and not any(edge.loop for edge in bare.graph.edges)
    assert any(record.accepted for record in closed.records)
    assert errors(around, closed).mean() < errors(around, bare).mean()
    # What loops tell, the covariances know.
    assert np.trace(closed.covariances[-1][:3, :3]) < np.trace(bare.covariances[-1][:3, :3])


# --- given poses ----------------------------------------------------------------------------------------------------


def test_given_poses_go_by_order_or_by_time(log: SimulatedLidarLog) -> None:
    stamps = [scan.stamp for scan in log]
    given = Trajectory.from_poses(stamps, log.truth)
    by_order = fuse_lidar_log(log, given, COARSE)
    assert (by_order.scans, by_order.skipped, by_order.matched) == (30, 0, 0)
    assert by_order.slam is None and by_order.levelled is None and math.isnan(by_order.mean_share)
    assert fingerprint(fuse_lidar_log(log, given, COARSE, associate="time")) == fingerprint(by_order)
    # Stamps of another clock do not matter where there is a pose for every scan.
    other = Trajectory.from_poses([s + 1000.0 for s in stamps], log.truth)
    assert fingerprint(fuse_lidar_log(log, other, COARSE))[:-2] == fingerprint(by_order)[:-2]
    hit = by_order.map.state(StateRule()).occupied.centres()
    for k, (low, high) in enumerate(SIDES):
        assert hit[:, k].min() > low - 0.35 and hit[:, k].max() < high + 0.35


def test_poses_between_are_found_by_time(log: SimulatedLidarLog) -> None:
    stamps = [scan.stamp for scan in log]
    # Every second pose, and one scan before the first of them.
    some = Trajectory.from_poses(stamps[1::2], log.truth[1::2])
    result = fuse_lidar_log(log, some, COARSE, tolerance=0.25)
    assert (result.scans, result.skipped) == (30, 0)
    metres, radians = off(list(result.poses)[1:-1], log.truth[1:-1])
    assert metres.max() < 0.05 and radians.max() < 0.03
    alone = fuse_lidar_log(log, some, COARSE, tolerance=0.05)
    assert (alone.scans, alone.skipped) == (15, 15)
    np.testing.assert_array_equal(alone.poses.stamps, stamps[1::2])


def test_poses_that_go_with_no_scan_are_refused(log: SimulatedLidarLog) -> None:
    far = Trajectory.from_poses([1e6, 1e6 + 1], log.truth[:2])
    with pytest.raises(TrajectoryError, match=r"none of the 2 poses is within 0\.1 s of one of the 30 scans of hall"):
        fuse_lidar_log(log, far, COARSE)
    with pytest.raises(TrajectoryError, match="2 poses do not go by order with the 30 scans of hall"):
        fuse_lidar_log(log, far, COARSE, associate="order")
    with pytest.raises(ArgumentError, match="by 'order' or 'time', not 'name'"):
        fuse_lidar_log(log, far, COARSE, associate="name")


# --- settings -------------------------------------------------------------------------------------------------------


def test_settings_that_make_no_map_are_refused() -> None:
    with pytest.raises(ArgumentError, match="cannot be mapped on A2, a lattice of the plane; take D3"):
        LidarSettings(lattice="A2")
    with pytest.raises(ArgumentError, match="a map has 1 to 16 levels, not 0"):
        LidarSettings(levels=0)
    with pytest.raises(ArgumentError, match="no setting of a map in space is called 'odometry'"):
        LidarSettings.from_dict({"odometry": True})
    with pytest.raises(ArgumentError, match="not a configuration of a map in space"):
        LidarSettings.from_dict({"rule": {"no": 1}})
    assert LidarSettings(max_range=None).make_lattice().basis.tolist() == Lattice.named("D3", 0.1).basis.tolist()


@pytest.mark.long
def test_floors_above_floors_are_kept_apart() -> None:
    from hexmap.simulator.space import make_building_3d

    building = make_building_3d("warehouse3d", seed=4, floors=2)
    log = SimulatedLidarLog(building, lidar=RingLidar(rings=16, azimuths=360))
    result = slam_of(log, True)
    assert errors(log, result).max() < 0.3
    for record in result.records:
        if record.accepted:
            i, j = (log.truth[result.node_scans[n]] for n in (record.i, record.j))
            assert spatial.to_pose(np.array(record.pose)).is_close(i.inverse() @ j, 0.3, 0.05)
