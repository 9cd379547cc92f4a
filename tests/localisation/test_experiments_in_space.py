"""The localisation experiment on a LiDAR's log: the same report as in the plane, on lattices of space."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, LogError
from hexmap.cli import main
from hexmap.cli.clouds import Reading, read_cloud
from hexmap.io.trajectories import write_tum
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from hexmap.poses.trajectory import Trajectory
from hexmap.simulator.buildings import make_building
from hexmap.simulator.laser import Laser
from hexmap.simulator.space import Building3D, Drive3D, RingLidar, SolidList, write_bag
from hexmap.simulator.writer import write_log
from localisation.experiments.geometry import geometry_of
from localisation.experiments.maps import MapKind, prepare
from localisation.experiments.reading import read_world
from localisation.experiments.run import ExperimentOutcome, localisation_experiment
from localisation.experiments.settings import SPACE_TASKS, ExperimentSettings, in_space_settings
from localisation.experiments.space import drawn_in_space, found_in_space
from localisation.experiments.world import NEAR
from tests.lattices import JIT
from tests.localisation.slam.lidar_drives import SimulatedLidarLog

pytest.importorskip("kiss_icp")
pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")

SKEW = ((1.0, 0.15, 0.0), (0.0, 1.0, 0.2), (0.0, 0.0, 1.0))
SMALL = in_space_settings(
    lattices=("Z3", SKEW), resolutions=(0.2,), hold_out=2, scans=8, starts=2, length=3, learning_scans=2,
    shares=(0.5,), ranges=(6.0,), changes=(0.2,), perturbations=((0.1, 2.0), (3.0, 90.0)), turns=(17.0,), rotations=6,
    node_limit=100_000, points=4000,
)  # fmt: skip
LIDAR = RingLidar(rings=24, azimuths=256, rate=4.0, sweep=0.05)


def room() -> Building3D:
    """A room that is not the same from either end, and a drive along it."""
    solids = SolidList()
    solids.box((-1, -1, -0.3), (12, 8, 0))
    solids.box((-1, -1, 3.0), (12, 8, 3.3))
    for start, end in (((-1, -1), (12, -1)), ((-1, 8), (12, 8)), ((-1, -1), (-1, 8)), ((12, -1), (12, 8))):
        solids.wall(start, end, (0, 3), 0.2)
    # A closet in one corner, and a pillar.
    solids.box((6.0, 4.5, 0.0), (12.0, 8.0, 3.0))
    solids.cylinder(3.0, 5.0, 0.4, 0.0, 3.0)
    return solids.building("room", [(0.0, 1.0, 0.0), (10.5, 2.0, 0.0), (2.0, 3.0, 0.0)])


@cache
def log() -> SimulatedLidarLog:
    return SimulatedLidarLog(room(), lidar=LIDAR, scans=20)


def truth() -> Trajectory:
    return Trajectory.from_poses([scan.stamp for scan in log()], log().truth)


@pytest.fixture(scope="module")
def outcome() -> ExperimentOutcome:
    return localisation_experiment(log(), SMALL, poses=truth())


@pytest.mark.long
def test_every_task_of_space_is_done_on_every_lattice_and_a_hall_is_found(outcome: ExperimentOutcome) -> None:
    results = outcome.results
    assert [grid.label for grid in results.grids] == ["Z3", "own 1", "own 1 (radius)"]
    base = results.grids[0]
    world = results.world
    assert not set(world.map_scans()) & set(world.test_scans())
    for k in world.test_scans():
        assert np.linalg.norm(world.positions[world.map_scans()] - world.positions[k], axis=1).min() <= NEAR
    for grid in results.grids:
        if grid.equal == "cell":
            assert grid.lattice.cell.volume == pytest.approx(0.2**3)
        else:
            assert grid.lattice.covering_radius == pytest.approx(base.lattice.covering_radius)
        for task in SPACE_TASKS:
            there, here = (results.select(task=task, grid=g.number) for g in (grid, base))
            keys = ("method", "scan", "size", "step", "start", "axis", "value", "turn")
            assert there
            # The same scans and starts on every grid.
            assert [[row.get(k) for k in keys] for row in there] == [[row.get(k) for k in keys] for row in here]
        found = results.select(task="global", grid=grid.number, method="all angles")
        assert len(found) == SMALL.scans
        assert np.mean([row["metres"] < 0.2 and row["degrees"] < 2.0 for row in found]) >= 0.75
        near, far = (results.select(task="local", grid=grid.number, size=k) for k in (0, 1))
        assert np.mean([row["metres"] is not None and row["metres"] < 0.1 for row in near]) >= 0.75
        # A start three metres off and turned by a quarter is beyond what is near.
        assert np.mean([row["metres"] is not None and row["metres"] < 0.1 for row in far]) <= 0.25
        ends = results.select(task="localise", grid=grid.number, step=SMALL.length - 1, method="localiser")
        assert ends and all(row["answered"] and row["metres"] < 0.2 for row in ends)
        assert all(row["variability"] < 0.2 for row in results.select(task="rotation", grid=grid.number))


@pytest.mark.long
def test_the_report_is_that_of_the_plane_and_says_what_is_left_out(outcome: ExperimentOutcome, tmp_path: Path) -> None:
    written = {path.name for path in outcome.write(tmp_path)}
    assert {"report.html", "outcomes.csv", "success.png", "risk.png", "runs.png", "learning.png"} <= written
    report = (tmp_path / "report.md").read_text()
    sections = ["Verdicts", "Win, even, lose", "Anywhere", "Near a start", "Runs", "Rotation", "Learning",
                "Calibration", "What was set"]  # fmt: skip
    places = [report.index(f"## {name}") for name in sections]
    assert places == sorted(places) and "## Maps" not in report
    for claim in ("own 1 finds more scans", "at equal cell volume", "at equal covering radius",
                  "has a score that varies less", "Cartographer's", "ellipses of the localiser"):  # fmt: skip
        assert claim in report[places[0] : places[1]]
    assert report.count("particle filter") == 1 and "Left out is what is compared in the plane only" in report
    assert "cell area" not in report and "of 6 degrees of freedom, 6 on average and 5.35 in the median" in report


@pytest.mark.parametrize("lattice", ["Z3", "D3", "D3*", SKEW], ids=str)
def test_a_scan_is_found_anywhere_and_from_nearby_in_the_map_of_the_others(lattice: str | tuple[object, ...]) -> None:
    settings = replace(SMALL, lattices=(lattice, "A2xZ"))
    world = read_world(log(), settings, lambda *_: [], poses=truth())
    shared = {**world.shared(), "bases": settings.bases(), "seed": 0}
    prepared = prepare(MapKind(0), shared)
    k = int(world.test_scans()[4])
    match = found_in_space(world.scan(k), prepared, prepared.matcher(), "all angles", 100_000)
    assert match is not None
    start = world.geometry.perturbed(world.pose(k), 0.1, math.radians(2.0), np.random.default_rng(1))
    pose, covariance, share = drawn_in_space(world.scan(k), start, prepared)
    assert pose is not None and covariance is not None and share > 0.3
    for found in (match.pose, pose):
        _, metres, degrees = world.geometry.error(found, world.pose(k))
        assert metres < 0.1 and degrees < 1.0


@pytest.mark.long
def test_the_numbers_do_not_depend_on_workers(outcome: ExperimentOutcome, tmp_path: Path) -> None:
    some = replace(SMALL, tasks=("local", "localise"))
    again = localisation_experiment(log(), some, poses=truth(), folder=tmp_path, workers=2)
    before = [row for row in outcome.results.rows if row["task"] in some.tasks]
    for one, other in zip(before, again.results.rows, strict=True):
        assert {**one, "cpu": None} == {**other, "cpu": None}


def test_without_poses_the_reference_is_what_the_map_maker_finds() -> None:
    pytest.importorskip("gtsam")

    def no_cases(*_: object) -> list[dict[str, object]]:
        raise AssertionError("the poses of a LiDAR's log are no cases")

    world = read_world(log(), SMALL, no_cases)
    assert not world.given and "No poses were given" in world.reference
    back = world.pose(0)
    true = log().from_first()
    for k in np.flatnonzero(world.known).tolist():
        # The map is levelled, and begins where the sensor was.
        assert math.dist((back.inverse() @ world.pose(k)).translation, true[k].translation) < 0.1
    assert world.known.sum() >= 18


def test_another_run_is_looked_for_in_the_map_of_the_first() -> None:
    building = room()
    beside = Drive3D(building.waypoints + np.array([0.3, 0.2, 0.0]))
    other = SimulatedLidarLog(building, beside, LIDAR, scans=16)
    poses = Trajectory.from_poses([scan.stamp for scan in other], other.truth)
    world = read_world(log(), SMALL, lambda *_: [], poses=truth(), test=other, test_poses=poses)
    assert (world.run[world.map_scans()] == 0).all() and (world.run[world.test_scans()] == 1).all()
    assert len(world.map_scans()) == 20 and len(world.test_scans()) == 16
    for k in world.test_scans():
        assert world.pose(int(k)).is_close(other.truth[k - 20], metres=1e-6, radians=1e-6)


def test_points_with_times_are_moved_to_the_stamp_by_the_reference() -> None:
    from localisation.odometry.sweep import Velocity, deskewed

    world = read_world(log(), replace(SMALL, points=None), lambda *_: [], poses=truth())
    scans = list(log())
    motion = log().truth[6].inverse() @ log().truth[7]
    velocity = Velocity.between(motion, scans[7].stamp - scans[6].stamp)
    moved = deskewed(scans[7], velocity)
    ranges = np.linalg.norm(moved, axis=1)
    assert np.allclose(world.scan(7), moved[(ranges >= 0.5) & (ranges <= 100.0)])
    few = read_world(log(), SMALL, lambda *_: [], poses=truth())
    assert len(few.scan(7)) == 4000 and set(map(tuple, few.scan(7))) <= set(map(tuple, world.scan(7)))


# ---------------------------------------------------------------------- geometry


@pytest.mark.parametrize("dim", [2, 3])
def test_a_perturbed_pose_is_as_far_off_as_it_should_be_and_comes_back_from_its_row(dim: int) -> None:
    geometry, rng = geometry_of(dim), np.random.default_rng(2)
    true = Pose.planar(1.0, -2.0, 3.0) if dim == 2 else Pose(exponential(np.array([0.3, -1.0, 2.0])), [1.0, 2.0, 3.0])
    assert geometry.to_pose(geometry.to_row(true)).is_close(true)
    assert len(geometry.to_row(true)) == geometry.row
    for metres, radians in ((0.3, 0.2), (1.0, 3.0)):
        off, far, turned = geometry.error(geometry.perturbed(true, metres, radians, rng), true)
        assert len(off) == geometry.freedom
        assert far == pytest.approx(metres) and turned == pytest.approx(math.degrees(radians))
        assert np.linalg.norm(off[:dim]) == pytest.approx(metres)
        assert np.linalg.norm(off[dim:]) == pytest.approx(radians)


@pytest.mark.parametrize("dim", [2, 3])
def test_ellipsoids_hold_as_many_normal_errors_as_they_should(dim: int) -> None:
    geometry = geometry_of(dim)
    draws = np.random.default_rng(3).standard_normal((20_000, geometry.freedom))
    squares = (draws**2).sum(axis=1)
    within = np.array([geometry.inside(v) for v in squares.tolist()])
    for share in (0.5, 0.95):
        assert (within <= share).mean() == pytest.approx(share, abs=0.01)
    assert np.median(squares) == pytest.approx(geometry.median_squared, rel=0.02)


# ---------------------------------------------------------------------- the command, and what is refused


def test_what_does_not_fit_together_is_refused() -> None:
    with pytest.raises(ArgumentError, match="a LiDAR's log cannot be mapped on Z2, a lattice of the plane"):
        localisation_experiment(log(), ExperimentSettings())
    with pytest.raises(ArgumentError, match="the task mapping is one of the plane"):
        localisation_experiment(log(), replace(SMALL, tasks=("mapping",)), poses=truth())
    with pytest.raises(ArgumentError, match="points is at least"):
        replace(SMALL, points=10)
    with pytest.raises(LogError, match="too few"):
        few = SimulatedLidarLog(room(), lidar=LIDAR, scans=9)
        localisation_experiment(few, SMALL, poses=Trajectory.from_poses([s.stamp for s in few], few.truth))


def test_the_command_takes_a_bag_with_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, out = tmp_path / "run", tmp_path / "report"
    building = room()
    write_bag(bag, building, drive=Drive3D(building.waypoints), lidar=LIDAR, scans=17, seed=1)
    poses = tmp_path / "poses.tum"
    stamps = [scan.stamp for scan in log()][:17]
    write_tum(poses, Trajectory.from_poses(stamps, log().truth[:17]))
    arguments = ["experiment", "localisation", bag, "-o", out, "--poses", poses, "--lattices", "Z3,D3*"]
    arguments += ["--resolutions", "0.3", "--tasks", "local,rotation", "--hold-out", "2", "--scans", "8", "--quick"]
    assert main([str(a) for a in arguments]) == 0
    report = (out / "report.md").read_text().replace("\\", "")
    assert "D3* matches more scans from perturbed starts than Z3 at equal cell volume" in report
    assert "D3* has a score that varies less under rotation than Z3 at equal covering radius" in report
    assert "0.1 m, 2° | 100 %" in report
    capsys.readouterr()

    def refused(*more: str) -> str:
        assert main([str(a) for a in arguments[:2]] + [str(bag), "-o", str(tmp_path / "no"), *more]) == 2
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and not (tmp_path / "no").exists()
        return err

    assert "lattice of the plane" in refused("--lattices", "Z2,A2")
    assert "cannot be compared" in refused("--lattices", "Z2,D3")
    assert "the task mapping" in refused("--tasks", "mapping")
    planar = tmp_path / "a.clf"
    write_log(planar, make_building("room"), laser=Laser(beams=11, rate=1.0), duration=20.0)
    assert "planar" in refused("--test", str(planar))
    assert main(["experiment", "localisation", str(planar), "-o", str(tmp_path / "no"), "--points", "5000"]) == 2
    assert "--points is for a LiDAR's log" in capsys.readouterr().err


def test_the_rotation_experiment_takes_the_scans_of_a_map(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, poses = tmp_path / "run", tmp_path / "poses.tum"
    building = room()
    write_bag(bag, building, drive=Drive3D(building.waypoints), lidar=LIDAR, scans=6, seed=1)
    write_tum(poses, Trajectory.from_poses([scan.stamp for scan in log()][:6], log().truth[:6]))
    # It is read as points of space, whether there are poses or not.
    arguments = ["experiment", "rotation", str(bag), "-o", str(tmp_path / "no"), "--resolution", "0.5"]
    for more in ([], ["--poses", str(poses)]):
        assert main([*arguments, "--lattice", "A2", *more]) == 2
        assert "A2 is a lattice of dimension 2, the points of 3" in capsys.readouterr().err
    reading = Reading(None, "m", "xyz", None, "auto")
    points, notes, _ = read_cloud(
        bag, poses, reading=reading, min_range=0.0, max_range=None, crop=None, unique=False, sample=3000, seed=0,
        cells=0.5,
    )  # fmt: skip
    assert len(points) == 3000 and "from half a metre on, at the poses of poses.tum" in notes[0]
    # They lie where the room is, which is some ten metres wide.
    assert (points.min(axis=0) > [-1.4, -1.4, -0.4]).all() and (points.max(axis=0) < [12.4, 8.4, 3.4]).all()
