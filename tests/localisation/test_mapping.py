"""From a log to a map: what a user gets of simulated and of real logs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, LogError, TrajectoryError
from hexmap.io.logs.log import LogSettings
from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import read_relations, read_tum
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.state_rule import StateRule
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from hexmap.poses.trajectory import Trajectory
from hexmap.simulator.buildings import make_building
from hexmap.simulator.events import OdometryNoise
from hexmap.simulator.laser import Laser
from hexmap.simulator.writer import write_log
from localisation.evaluation import absolute_error, evaluate_relations
from localisation.mapping.build_map import build_map
from localisation.mapping.fuse_log import fuse_log
from localisation.odometry.motion import FARTHEST_JUMP, MotionPredictor
from localisation.odometry.odometry import RegisteredScan
from localisation.odometry.scan_odometry import ScanOdometry
from localisation.settings import MappingSettings, make_builder


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A log of a drive through the room, and its true poses."""
    folder = tmp_path_factory.mktemp("drive")
    log, truth = folder / "room.clf", folder / "room.tum"
    write_log(log, make_building("room"), truth, seed=3)
    return log, truth


def run(log: Path, **settings) -> tuple:
    stamps, poses, scans = [], [], []

    def on_pose(stamp: float, pose: Pose, is_scan: bool) -> None:
        stamps.append(stamp)
        poses.append(pose)
        scans.append(is_scan)

    result = build_map(open_log(log), MappingSettings(**settings), on_pose=on_pose)
    return result, Trajectory.from_poses(stamps, poses), np.array(scans)


class Mapper:
    """Registers scans and fuses each, as :func:`build_map` does."""

    def __init__(self, **settings) -> None:
        chosen = MappingSettings(**settings)
        self.builder = make_builder(chosen)
        self.odometry = ScanOdometry(chosen, self.builder)

    def add(self, scan: Scan) -> RegisteredScan:
        registered = self.odometry.register(scan)
        self.builder.fuse(scan, registered.T_map_scan)
        return registered


@pytest.mark.parametrize("lattice", ["A2", "Z2", [[0.05, 0.02], [0.0, 0.05]]], ids=["A2", "Z2", "own basis"])
def test_a_simulated_drive_is_mapped_to_centimetres(drive: tuple[Path, Path], lattice) -> None:
    log, truth = drive
    result, trajectory, scans = run(log, lattice=lattice)
    error = absolute_error(read_tum(truth), trajectory, "order")
    assert error.translation.mean < 0.03 and error.rotation_deg.mean < 0.5
    assert scans.sum() == result.scans == result.matched + 1
    assert len(trajectory) == result.scans + result.odometry


def test_the_same_log_gives_the_same_map_bit_for_bit(drive: tuple[Path, Path]) -> None:
    first, way1, _ = run(drive[0])
    second, way2, _ = run(drive[0])
    assert first.map == second.map
    assert np.array_equal(way1.positions, way2.positions) and np.array_equal(way1.quaternions, way2.quaternions)


def test_it_works_without_odometry(drive: tuple[Path, Path]) -> None:
    log, truth = drive
    _, trajectory, scans = run(log, use_odometry=False)
    picked = np.flatnonzero(scans)
    error = absolute_error(read_tum(truth)[picked], trajectory[picked], "order")
    assert error.translation.mean < 0.05


def test_a_log_without_odometry_lines_uses_the_laser_lines_own_fields(tmp_path: Path) -> None:
    log, truth = tmp_path / "a.clf", tmp_path / "a.tum"
    write_log(log, make_building("room"), truth, odometry=OdometryNoise(rate=0), seed=1, duration=20.0)
    result, trajectory, _ = run(log)
    assert result.odometry == 0
    assert absolute_error(read_tum(truth), trajectory, "order").translation.mean < 0.03


def test_stamps_that_repeat_or_step_back_change_nothing(drive: tuple[Path, Path], tmp_path: Path) -> None:
    lines = drive[0].read_text().splitlines()
    stuck = []
    for line in lines:
        fields = line.split()
        if fields and fields[0] in ("ODOM", "FLASER"):
            fields[-3] = fields[-1] = "1018930000.000000"
        stuck.append(" ".join(fields))
    other = tmp_path / "room.clf"
    other.write_text("\n".join(stuck) + "\n")
    # Of another file: where it came from is told apart.
    assert run(drive[0])[0].map.levels == run(other)[0].map.levels


def test_fusing_at_the_true_poses_is_what_the_builder_does(drive: tuple[Path, Path]) -> None:
    log, truth = drive
    poses = read_tum(truth)
    result = fuse_log(open_log(log), poses)
    builder = MapBuilder(Lattice.named("A2", 0.05), 3)
    for k, event in enumerate(open_log(log)):
        if isinstance(event, Scan):
            builder.fuse(event, poses[k])
    assert result.map.levels == builder.build().levels and result.skipped == 0


def test_given_poses_go_by_order_or_by_time(drive: tuple[Path, Path]) -> None:
    log, truth = drive
    poses = read_tum(truth)
    of_scans = poses[np.array([k for k, e in enumerate(open_log(log)) if isinstance(e, Scan)])]
    everything = fuse_log(open_log(log), poses)
    assert fuse_log(open_log(log), of_scans).map.levels == everything.map.levels
    assert fuse_log(open_log(log), poses, associate="time").map.levels == everything.map.levels
    half = fuse_log(open_log(log), of_scans[: len(of_scans) // 2])
    assert 0 < half.skipped < len(of_scans)
    with pytest.raises(TrajectoryError, match="order"):
        fuse_log(open_log(log), poses[:7], associate="order")
    late = Trajectory(poses.stamps + 1e6, poses.positions, poses.quaternions)[:5]
    with pytest.raises(TrajectoryError, match="none of the 5 poses"):
        fuse_log(open_log(log), late)


def test_the_mount_of_the_laser_is_taken_off(tmp_path: Path) -> None:
    # The true walls come out in the same place, wherever on the robot the laser sits.
    mount = Pose.planar(0.25, 0.1, math.pi / 2)
    maps = []
    for laser, settings in ((Laser(), {}), (Laser(mount=mount), {"mount": (0.25, 0.1, math.pi / 2)})):
        log, truth = tmp_path / "m.clf", tmp_path / "m.tum"
        write_log(log, make_building("room"), truth, laser=laser, seed=2, duration=30.0)
        maps.append(fuse_log(open_log(log), read_tum(truth), MappingSettings(**settings)).map)
    a, b = (m.state(level=1).occupied for m in maps)
    assert a.count_coincident(b) > 0.6 * min(len(a), len(b))


def test_a_wrong_turn_of_the_wheels_is_found_again() -> None:
    """Odometry that jumps by 60 degrees between two scans is outside the window, and found by widening it."""
    rng = np.random.default_rng(0)
    walls = np.concatenate([
        np.stack([rng.uniform(-3, 4, 900), np.where(rng.random(900) < 0.5, -2.0, 2.5)], axis=1),
        np.stack([np.where(rng.random(900) < 0.5, -3.0, 4.0), rng.uniform(-2, 2.5, 900)], axis=1),
    ])  # fmt: skip
    mapper = Mapper()
    mapper.add(Scan(0.0, walls, odometry=Pose.identity(2)))
    truth = Pose.planar(0.3, 0.1, 0.2)
    wrong = Pose.planar(0.3, 0.1, 0.2 + math.radians(60.0))
    found = mapper.add(Scan(1.0, truth.inverse().apply(walls), odometry=wrong))
    assert found.matched and found.T_map_robot.is_close(truth, metres=0.03, radians=0.02)


@pytest.mark.parametrize(("better", "moves"), [(20, False), (120, True)], ids=["a little", "clearly"])
def test_a_wider_search_must_beat_the_narrower_one_clearly(better: int, moves: bool) -> None:
    """Most of a scan is new, the rest agrees with the map at the prediction, and better still a metre away."""
    rng = np.random.default_rng(4)

    def ring(count: int, nearest: float, farthest: float) -> np.ndarray:
        """Points far enough away that few beams pass through the cells of others."""
        bearing, distance = rng.uniform(0.0, 2.0 * math.pi, count), rng.uniform(nearest, farthest, count)
        return np.stack([distance * np.cos(bearing), distance * np.sin(bearing)], axis=1)

    here, only_away, new = ring(200, 8.0, 10.0), ring(better, 8.0, 10.0), ring(320, 20.0, 24.0)
    away = Lattice.named("A2", 0.1).centres([[8, -10]])[0]  # of the level that is searched
    mapper = Mapper(search_radians=0.0)
    mapper.add(Scan(0.0, np.concatenate([here, here + away, only_away + away]), odometry=Pose.identity(2)))
    scan = np.concatenate([here, only_away, new])
    found = mapper.add(Scan(1.0, scan, odometry=Pose.identity(2)))
    expected = Pose.planar(*away, 0.0) if moves else Pose.identity(2)
    assert found.T_map_robot.is_close(expected, metres=0.05, radians=0.01)


def test_readings_between_scans_share_the_correction() -> None:
    mapper = Mapper()
    rng = np.random.default_rng(1)
    walls = np.concatenate([np.stack([rng.uniform(-3, 4, 900), np.full(900, 2.0)], axis=1),
                            np.stack([np.full(900, -3.0), rng.uniform(-2, 2, 900)], axis=1)])  # fmt: skip
    mapper.add(Scan(0.0, walls, odometry=Pose.identity(2)))
    truth = Pose.planar(0.4, 0.0, 0.0)
    for x in (0.1, 0.2):  # wheels that report half of the way
        assert mapper.odometry.observe(Odometry(0.5, Pose.planar(x / 2, 0.0, 0.0))) == ()
    found = mapper.add(Scan(1.0, truth.inverse().apply(walls), odometry=Pose.planar(0.2, 0.0, 0.0)))
    xs = [pose.x for _, pose in found.readings]
    assert xs == sorted(xs) and found.T_map_robot.x == pytest.approx(0.4, abs=0.03)
    assert xs[0] == pytest.approx(0.05 + 0.2 / 3, abs=0.03) and xs[1] == pytest.approx(0.1 + 0.4 / 3, abs=0.03)


def test_registering_leaves_the_map_alone() -> None:
    rng = np.random.default_rng(1)
    walls = np.stack([rng.uniform(-3, 4, 900), np.full(900, 2.0)], axis=1)
    mapper = Mapper()
    mapper.add(Scan(0.0, walls))
    before = mapper.builder.build()
    first = mapper.odometry.register(Scan(1.0, walls + 0.05))
    assert first.matched and first.match is not None
    assert mapper.builder.build() == before


def test_wheels_alone_are_an_odometry() -> None:
    mount = Pose.planar(0.2, 0.0, 0.1)
    odometry = MotionPredictor(mount=mount)
    wheels = [Pose.planar(5.0, 1.0, 0.3), Pose.planar(5.5, 1.0, 0.4), Pose.planar(5.6, 1.1, 0.4)]
    scans = [odometry.register(Scan(float(k), np.empty((0, 2)), odometry=pose)) for k, pose in enumerate(wheels)]
    for registered, pose in zip(scans, wheels, strict=True):
        assert registered.T_map_robot.is_close(wheels[0].inverse() @ pose, 1e-12, 1e-12)
        assert registered.T_map_scan.is_close(registered.T_map_robot @ mount, 1e-12, 1e-12)
        assert not registered.matched


def test_a_jump_of_the_wheels_is_replaced_by_the_last_motion() -> None:
    odometry = MotionPredictor()
    nothing = np.empty((0, 2))
    for k, x in enumerate((0.0, 0.3)):
        odometry.register(Scan(float(k), nothing, odometry=Pose.planar(x, 0.0, 0.0)))
    jumped = odometry.register(Scan(2.0, nothing, odometry=Pose.planar(0.6 + 2.0 * FARTHEST_JUMP, 0.0, 0.0)))
    assert jumped.T_map_robot.x == pytest.approx(0.6) and odometry.jumps == 1
    after = odometry.register(Scan(3.0, nothing, odometry=Pose.planar(0.9 + 2.0 * FARTHEST_JUMP, 0.0, 0.0)))
    assert after.T_map_robot.x == pytest.approx(0.9) and odometry.jumps == 1


def test_readings_without_a_scan_do_not_pile_up() -> None:
    odometry = MotionPredictor()
    poses = [Pose.planar(0.001 * k, 0.0, 0.0) for k in range(10_001)]
    out = [reading for k, pose in enumerate(poses) for reading in odometry.observe(Odometry(float(k), pose))]
    out += odometry.finish()
    assert [stamp for stamp, _ in out] == [float(k) for k in range(len(poses))]
    assert out[-1][1].x == pytest.approx(10.0)


def test_settings_survive_a_round_trip_and_refuse_nonsense() -> None:
    settings = MappingSettings(
        lattice="Z2", resolution=0.1, mount=(0.1, 0.0, 0.2), rule=StateRule(2, 0.3), log=LogSettings(no_return=50.0)
    )
    assert MappingSettings.from_dict(settings.to_dict()) == settings
    with pytest.raises(ArgumentError, match="resolutoin"):
        MappingSettings.from_dict({"resolutoin": 0.1})
    with pytest.raises(ArgumentError, match="planar log"):
        MappingSettings(lattice="D3")
    with pytest.raises(ArgumentError, match="search level"):
        MappingSettings(levels=1)
    with pytest.raises(ArgumentError):
        MappingSettings.from_dict({"levels": "three"})
    with pytest.raises(ArgumentError):
        MappingSettings.from_dict({"rule": {"min_hits": 0}})


def test_a_log_without_a_laser_is_an_error(tmp_path: Path) -> None:
    log = tmp_path / "wheels.clf"
    log.write_text("ODOM 0 0 0 0 0 0 0.0 host 0.0\n" * 3)
    with pytest.raises(LogError, match=r"wheels\.clf"):
        build_map(open_log(log))


@pytest.mark.data
def test_intel_beats_the_published_scan_matching(data_dir: Path) -> None:
    relations = read_relations(data_dir / "laser2d" / "intel.relations")
    _, trajectory, _ = run(data_dir / "laser2d" / "intel.clf.gz")
    score = evaluate_relations(trajectory, relations)
    assert score.skipped == 0 and score.translation.mean < 0.06  # published: 0.220


@pytest.mark.data
def test_belgioioso_agrees_with_the_particle_filter(data_dir: Path) -> None:
    _, trajectory, scans = run(data_dir / "laser2d" / "belgioioso.clf.gz")
    reference = read_tum(data_dir / "laser2d" / "belgioioso.rbpf.tum")
    error = absolute_error(reference, trajectory[np.flatnonzero(scans)], "order")
    assert error.translation.mean < 0.15  # the reference itself is good to about a decimetre


def test_without_odometry_readings_lie_between_the_scans(drive: tuple[Path, Path]) -> None:
    log, truth = drive
    _, trajectory, scans = run(log, use_odometry=False)
    between = np.flatnonzero(~scans)
    error = absolute_error(read_tum(truth)[between], trajectory[between], "order")
    assert error.translation.mean < 0.05
