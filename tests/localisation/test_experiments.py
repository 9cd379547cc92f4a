"""The localisation experiment: nothing that is looked for is in a map, honest comparisons, the same bits always."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from hexmap.base.errors import AlignmentError, ArgumentError, LogError
from hexmap.cli import main
from hexmap.cli.localisation_experiment import command
from hexmap.experiments.statistics import Interval
from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import read_tum
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from hexmap.simulator.buildings import make_building
from hexmap.simulator.events import SimulatedEvent, simulate
from hexmap.simulator.laser import Laser
from hexmap.simulator.writer import write_log
from localisation.experiments.baselines.angle_set import angular_step
from localisation.experiments.baselines.particle_filter import (
    FilterSettings,
    LikelihoodField,
    ParticleFilter,
    kld_limit,
)
from localisation.experiments.comparison import (
    MEASURES,
    Comparison,
    compare,
    local_measures,
    permutation_test,
    risk_area,
    sign_test,
)
from localisation.experiments.maps import change_walls
from localisation.experiments.reading import read_world
from localisation.experiments.run import ExperimentOutcome, localisation_experiment
from localisation.experiments.settings import ExperimentSettings
from localisation.experiments.verdicts import verdict
from localisation.experiments.world import NEAR, World
from tests.lattices import JIT, PLANAR, Case

pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")

SKEW = ((0.131, 0.047), (-0.022, 0.088))
SMALL = ExperimentSettings(
    lattices=("Z2", SKEW), resolutions=(0.2,), scans=8, starts=2, length=4, learning_scans=3, shares=(0.5,),
    ranges=(4.0,), changes=(0.3,), perturbations=((0.3, 8.0), (1.0, 30.0)), turns=(0.0, 17.0), rotations=6,
    node_limit=100_000, runs=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the room with its true poses, and another one."""
    here = tmp_path_factory.mktemp("experiment")
    for name, seed in (("a", 1), ("b", 2)):
        write_log(
            here / f"{name}.clf",
            make_building("room"),
            here / f"{name}.tum",
            laser=Laser(beams=91, rate=1.0),
            seed=seed,
        )
    return here


def experiment(logs: Path, settings: ExperimentSettings = SMALL, **how: object) -> ExperimentOutcome:
    return localisation_experiment(open_log(logs / "a.clf"), settings, poses=read_tum(logs / "a.tum"), **how)


@pytest.fixture(scope="module")
def outcome(folder: Path) -> ExperimentOutcome:
    return experiment(folder)


def read(path: Path, settings: ExperimentSettings, **how: object) -> World:
    return read_world(open_log(path / "a.clf"), settings, _no_cases, poses=read_tum(path / "a.tum"), **how)


def _no_cases(*_: object) -> list[dict[str, object]]:
    raise AssertionError("poses were given")


# ---------------------------------------------------------------------- the split


def test_no_scan_that_is_looked_for_is_in_a_map(folder: Path, outcome: ExperimentOutcome) -> None:
    for settings in (SMALL, replace(SMALL, split="half"), replace(SMALL, hold_out=2)):
        world = read(folder, settings)
        assert not set(world.map_scans()) & set(world.test_scans())
        assert len(world.map_scans()) + len(world.test_scans()) <= len(world)
        # What the map does not show is not looked for.
        for k in world.test_scans():
            assert np.linalg.norm(world.poses[world.map_scans(), :2] - world.poses[k, :2], axis=1).min() <= NEAR
    half = read(folder, replace(SMALL, split="half"))
    assert half.map_scans().max() < half.test_scans().min()
    looked_for = {row["scan"] for row in outcome.results.rows}
    assert looked_for <= set(outcome.results.world.test_scans().tolist())


def test_another_run_is_looked_for_in_the_map_of_the_first(folder: Path) -> None:
    world = read(folder, SMALL, test=open_log(folder / "b.clf"), test_poses=read_tum(folder / "b.tum"))
    assert (world.run[world.map_scans()] == 0).all() and (world.run[world.test_scans()] == 1).all()
    tasks = replace(SMALL, tasks=("global", "mapping"), lattices=("Z2", "A2"), turns=(0.0,))
    # The poses of the other run are found by its map alone, and come out as the true ones.
    found = experiment(folder, tasks, test=open_log(folder / "b.clf"))
    assert "found as a whole in the first one" in found.results.world.reference
    poses = found.results.world
    truth = read_tum(folder / "b.tum")
    scans = [e for e in simulate(make_building("room"), Laser(beams=91, rate=1.0), seed=2) if isinstance(e.event, Scan)]
    errors = [
        math.dist(poses.pose(k).translation, e.T_map_robot.translation)
        for k, e in zip(np.flatnonzero(poses.run == 1), scans, strict=True)
    ]
    assert len(truth) > len(scans) and max(errors) < 0.1
    assert all(row["metres"] < 0.2 for row in found.results.select(task="global"))


# ---------------------------------------------------------------------- the whole


def test_every_task_is_done_on_every_lattice_and_most_of_a_room_is_found(outcome: ExperimentOutcome) -> None:
    results = outcome.results
    assert [grid.label for grid in results.grids] == ["Z2", "own 1", "own 1 (radius)"]
    base = results.grids[0]
    for grid in results.grids:
        if grid.equal == "cell":
            assert grid.lattice.resolution == pytest.approx(0.2)
        else:
            assert grid.lattice.covering_radius == pytest.approx(base.lattice.covering_radius)
        for task in SMALL.tasks:
            there, here = (results.select(task=task, grid=g.number) for g in (grid, base))
            # The same scans, starts and draws on every grid.
            keys = ("method", "scan", "size", "step", "start", "axis", "value", "turn", "run")
            assert [[row.get(k) for k in keys] for row in there] == [[row.get(k) for k in keys] for row in here]
        found = results.select(task="global", grid=grid.number, method="all angles")
        assert len(found) == SMALL.scans
        assert np.mean([row["metres"] < 0.2 and row["degrees"] < 2.0 for row in found]) >= 0.75
        near = results.select(task="local", grid=grid.number, size=0)
        assert np.mean([row["metres"] < 0.2 for row in near]) >= 0.75
        assert all(row["overlap"] > 0.8 for row in results.select(task="mapping", grid=grid.number))
        ends = results.select(task="localise", grid=grid.number, step=SMALL.length - 1, method="localiser")
        assert all(row["answered"] and row["metres"] < 0.2 for row in ends)


def test_the_report_says_first_what_holds_and_then_why(outcome: ExperimentOutcome, tmp_path: Path) -> None:
    written = {path.name for path in outcome.write(tmp_path)}
    assert {
        "report.html",
        "outcomes.csv",
        "success.png",
        "risk.png",
        "runs.png",
        "learning.png",
        "times.csv",
    } <= written
    report = (tmp_path / "report.md").read_text()
    first = next(line for line in report.splitlines()[1:] if line and not line.startswith("`"))
    assert first == "## Verdicts"
    sections = ["Verdicts", "Win, even, lose", "What was done", "Anywhere", "Near a start", "Runs", "Maps", "Rotation",
                "Learning", "Calibration", "What was set"]  # fmt: skip
    places = [report.index(f"## {name}") for name in sections]
    assert places == sorted(places)
    # Claims are judged for the rival, and baselines and covariances beside it.
    for claim in ("own 1 finds more scans", "own 1 has a score that varies less", "Cartographer's", "particle filter",
                  "ellipses of the localiser"):  # fmt: skip
        assert claim in report[places[0] : places[1]]


def test_the_numbers_do_not_depend_on_workers_nor_on_an_interruption(
    folder: Path, outcome: ExperimentOutcome, tmp_path: Path
) -> None:
    def stop(done: int, total: int) -> None:
        if done == total // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        experiment(folder, folder=tmp_path, progress=stop)
    again = experiment(folder, folder=tmp_path, workers=2)
    for one, other in zip(outcome.results.rows, again.results.rows, strict=True):
        assert {**one, "cpu": None} == {**other, "cpu": None}


# ---------------------------------------------------------------------- comparing


def rows(metres: np.ndarray, **more: object) -> list[dict[str, object]]:
    return [{"metres": float(m), "degrees": 0.0, "scan": k, **more} for k, m in enumerate(metres)]


def test_a_difference_is_decided_only_where_the_pairs_decide_it() -> None:
    rng = np.random.default_rng(0)
    measures = {m.key: m for m in MEASURES}
    here = rng.uniform(0.02, 0.3, 60)
    for key, there, expected in (
        ("error", here * 0.8, "win"), ("error", here * 1.2, "lose"), ("error", here, "tie"),
        ("error", rng.permutation(here), "tie"), ("found 0.1 m", here * 0.3, "win"),
        ("found 0.1 m", here * 4.0, "lose"),
    ):  # fmt: skip
        found = compare(measures[key], rows(there), rows(here), 0)
        assert found is not None and found[-1] == expected, key
    # Five scans of sixty differ, all one way: the bootstrap is sure of it, the test of the pairs is not.
    there = here.copy()
    there[np.flatnonzero(here > 0.1)[:5]] = 0.01
    *_, interval, pairs, decided = compare(measures["found 0.1 m"], rows(there), rows(here), 0)
    assert interval.low > 0.0 and pairs == 60 and decided == "tie"
    assert compare(measures["error"], rows(here[:3]), rows(here[:3]), 0) is None
    assert len(local_measures(SMALL.perturbations)) == 2 * len(SMALL.perturbations)


def test_chance_alone_decides_few_comparisons() -> None:
    measure = next(m for m in MEASURES if m.key == "found 0.1 m")
    rng = np.random.default_rng(1)
    decided = [
        compare(measure, rows(rng.uniform(0.0, 0.2, 40)), rows(rng.uniform(0.0, 0.2, 40)), 0)[-1] != "tie"
        for _ in range(100)
    ]
    assert sum(decided) <= 10


def test_the_sign_test_is_the_binomial_one() -> None:
    from scipy.stats import binomtest

    for more, less in ((0, 0), (5, 0), (6, 0), (9, 2), (3, 3), (1, 12)):
        a = np.array([1.0] * more + [0.0] * less + [1.0] * 4)
        b = np.array([0.0] * more + [1.0] * less + [1.0] * 4)
        expected = binomtest(more, more + less).pvalue if more + less else 1.0
        assert sign_test(a, b) == pytest.approx(expected)


def test_the_permutation_test_is_the_sign_test_for_shares_and_needs_six_runs() -> None:
    for more, less in ((6, 0), (9, 2), (3, 3), (1, 12), (8, 1)):
        a = np.array([1.0] * more + [0.0] * less + [1.0] * 8)[:, None]
        b = np.array([0.0] * more + [1.0] * less + [1.0] * 8)[:, None]
        found = permutation_test(a, b, lambda values: values[..., 0].mean(axis=-1), False)
        assert found == pytest.approx(sign_test(a[:, 0], b[:, 0]), abs=0.04)
    runs = np.arange(1.0, 7.0)[:, None]
    for count, expected in ((6, 2 / 64), (5, 2 / 32)):
        less = runs[:count] * 0.9
        assert permutation_test(less, runs[:count], lambda v: v[..., 0].mean(axis=-1), True) == pytest.approx(expected)


def test_risk_area_averages_the_risk_over_all_coverages() -> None:
    rng = np.random.default_rng(2)
    right, sure = (rng.random(30) < 0.7).astype(float), rng.permutation(30).astype(float)
    order = sorted(range(30), key=lambda k: -sure[k])
    expected = np.mean([np.mean([1.0 - right[k] for k in order[:n]]) for n in range(1, 31)])
    assert risk_area(np.stack([right, sure], axis=1)) == pytest.approx(expected)
    assert risk_area(np.stack([np.ones(5), np.arange(5.0)], axis=1)) == 0.0


# ---------------------------------------------------------------------- changed maps


def test_the_same_walls_change_on_every_lattice() -> None:
    rng = np.random.default_rng(3)
    walls = rng.uniform(-20.0, 20.0, (20_000, 2))
    changed = {}
    for name in ("Z2", "A2"):
        lattice = Lattice.named(name, 0.05)
        states = States(VoxelList.from_points(walls, lattice), VoxelList.empty(lattice))
        after = change_walls(states, 0.4, 7)
        again = change_walls(states, 0.4, 7)
        assert after.occupied == again.occupied and after.free == again.free
        kept = after.occupied.contains(states.occupied.index)
        assert 0.5 < kept.mean() < 0.75 and 0.15 < 1.0 - len(after.occupied) / len(states.occupied) < 0.3
        assert not after.free.contains(after.occupied.index).any()
        # A square has changed where hardly a cell of it is left.
        square = np.floor(states.occupied.centres()).astype(int)
        changed[name] = {key for key in set(map(tuple, square)) if kept[(square == key).all(axis=1)].mean() < 0.3}
        assert change_walls(states, 0.4, 8).occupied != after.occupied
    assert len(changed["Z2"] ^ changed["A2"]) <= 0.02 * len(changed["Z2"])


# ---------------------------------------------------------------------- baselines


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_what_a_scan_says_of_a_particle_is_the_sum_over_its_beams(case: Case) -> None:
    rng = np.random.default_rng(4)
    walls = VoxelList.from_points(rng.uniform(-3.0, 3.0, (60, 2)), case.lattice)
    free = VoxelList.from_points(rng.uniform(-3.0, 3.0, (60, 2)), case.lattice)
    s = FilterSettings(farthest=0.7)
    field = LikelihoodField(States(walls, free), s)
    particles = np.column_stack([rng.uniform(-4.0, 4.0, (40, 2)), rng.uniform(-3.0, 3.0, 40)])
    beams = rng.uniform(-2.0, 2.0, (17, 2))
    centres = walls.centres()
    for particle, found in zip(particles, field.weigh(particles, beams), strict=True):
        expected = 0.0
        for end in Pose.planar(*particle).apply(beams):
            cell = case.lattice.centres(case.lattice.quantise(end[None]))[0]
            d = min(0.7, float(np.sqrt(((centres - cell) ** 2).sum(axis=1)).min()))
            expected += math.log(s.z_hit * math.exp(-0.5 * (d / s.sigma_hit) ** 2) + s.z_rand / s.range)
        assert found == pytest.approx(expected, rel=1e-9)


@cache
def room() -> tuple[LikelihoodField, tuple[SimulatedEvent, ...]]:
    """The field of one drive through the room, and another drive."""
    laser = Laser(rate=1.0)
    builder = MapBuilder(Lattice.named("A2", 0.1), levels=1)
    for e in simulate(make_building("room"), laser, seed=1):
        if isinstance(e.event, Scan):
            builder.fuse(e.event, e.T_map_robot)
    drive = [e for e in simulate(make_building("room"), laser, seed=2) if isinstance(e.event, Scan)]
    return LikelihoodField(builder.build().state(), FilterSettings()), tuple(drive)


def run(particles: ParticleFilter, drive: tuple[SimulatedEvent, ...]) -> list[tuple[float, float]]:
    out = []
    for e in drive:
        estimate = particles.add(e.event.points, e.event.odometry)
        out.append((math.dist(estimate.pose.translation, e.T_map_robot.translation), estimate.weight))
    return out


def test_the_particle_filter_finds_and_tracks_a_robot_and_gives_the_same_bits() -> None:
    field, drive = room()
    for start in (0, 20):
        first, second = (run(ParticleFilter(field, np.random.default_rng(start)), drive[start:]) for _ in range(2))
        assert first == second
        assert all(metres < 0.3 for metres, _ in first[12:])
        assert first[-1][1] > 0.95


def test_few_particles_are_enough_once_the_robot_is_found() -> None:
    field, drive = room()
    particles = ParticleFilter(field, np.random.default_rng(5))
    assert particles.estimate().particles == FilterSettings().most
    run(particles, drive[:20])
    assert particles.estimate().particles < 0.2 * FilterSettings().most


def test_a_robot_that_was_carried_away_is_found_again_by_the_recovery_alone() -> None:
    field, drive = room()
    elsewhere = Pose.planar(drive[25].T_map_robot.x, drive[25].T_map_robot.y, 0.0) @ Pose.planar(1.5, 1.0, 2.0)
    ends = {}
    for slow, fast in ((0.05, 0.5), (0.0, 0.0)):
        settings = FilterSettings(slow=slow, fast=fast)
        particles = ParticleFilter(field, np.random.default_rng(6), settings, start=(drive[0].T_map_robot, 0.1, 0.05))
        run(particles, drive[:6])
        # The wheels notice nothing: the odometry goes on from where it was.
        particles.particles = particles.particles * 0.0 + [elsewhere.x, elsewhere.y, elsewhere.theta]
        ends[slow] = run(particles, drive[6:])[-1][0]
    assert ends[0.05] < 0.3


def test_a_start_that_is_known_is_tracked_from_the_first_scan() -> None:
    field, drive = room()
    start = (drive[10].T_map_robot @ Pose.planar(0.2, -0.1, 0.1), 0.2, 0.1)
    found = run(ParticleFilter(field, np.random.default_rng(7), start=start), drive[10:25])
    assert all(metres < 0.3 for metres, _ in found)


def test_kld_sampling_wants_as_many_particles_as_its_formula() -> None:
    limit = kld_limit(np.array([0, 1, 2, 10, 1000]), 0.05, 0.99)
    assert limit[:2].tolist() == [1.0, 1.0]
    for bins, found in ((2, limit[2]), (10, limit[3]), (1000, limit[4])):
        b = 2.0 / (9.0 * (bins - 1))
        assert found == math.ceil((bins - 1) / 0.1 * (1.0 - b + math.sqrt(b) * 0.99) ** 3)
    # Twice the error, half the particles.
    assert kld_limit(np.array([500]), 0.1, 0.99)[0] == pytest.approx(
        0.5 * kld_limit(np.array([500]), 0.05, 0.99)[0], rel=0.01
    )


def test_the_angle_set_moves_the_farthest_point_by_a_resolution_at_most() -> None:
    lattice = Lattice.named("A2", 0.1)
    for points in (np.array([[3.0, 4.0], [1.0, 0.0]]), np.array([[0.05, 0.0]])):
        farthest = max(0.3, float(np.linalg.norm(points, axis=1).max()))
        moved = 2.0 * farthest * math.sin(0.5 * angular_step(points, lattice))
        assert 0.995 * 0.1 < moved <= 0.1


# ---------------------------------------------------------------------- what is refused


def test_settings_that_make_no_experiment_are_refused() -> None:
    for wrong in (
        {"lattices": ("Z2",)}, {"lattices": ("Z2", "Z2")}, {"lattices": ("Z2", "D3")}, {"resolutions": ()},
        {"resolutions": (0.1, 0.1)}, {"resolutions": (-0.1,)}, {"split": "odd"}, {"hold_out": 1}, {"tasks": ("all",)},
        {"tasks": ()}, {"scans": 3}, {"shares": (1.5,)}, {"changes": (0.0,)}, {"turns": ()}, {"seed": -1},
    ):  # fmt: skip
        with pytest.raises(ArgumentError):
            ExperimentSettings(**wrong)


def call(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> str:
    capsys.readouterr()
    assert main(["experiment", "localisation", *(str(a) for a in arguments)]) == code
    out, err = capsys.readouterr()
    if code:
        assert out == "" and err.startswith("hexmap: ") and err.count("\n") == 1
    return err if code else out


def test_an_error_is_one_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = folder / "a.clf", tmp_path / "out"
    assert "no lattice is called 'hexagon2'" in call(capsys, 2, log, "-o", out, "--lattices", "Z2,hexagon2")
    assert "lattice of space" in call(capsys, 2, log, "-o", out, "--lattices", "Z2,D3")
    assert "--resolutions takes numbers" in call(capsys, 2, log, "-o", out, "--resolutions", "0.1,fine")
    assert "no such file" in call(capsys, 1, tmp_path / "none.clf", "-o", out)
    few = tmp_path / "few.clf"
    few.write_text("".join(itertools.islice((line for line in log.open() if line.startswith("FLASER")), 9)))
    assert "9 scans are too few" in call(capsys, 1, few, "-o", out)
    assert "--test-poses needs" in call(capsys, 2, log, "-o", out, "--test-poses", folder / "b.tum")
    assert "none.tum" in call(capsys, 1, log, "-o", out, "--poses", tmp_path / "none.tum")


def test_a_run_of_another_building_is_refused(folder: Path, tmp_path: Path) -> None:
    write_log(tmp_path / "castle.clf", make_building("castle"), laser=Laser(beams=91, rate=1.0), duration=60.0)
    with pytest.raises((AlignmentError, LogError)):
        experiment(folder, test=open_log(tmp_path / "castle.clf"))


def test_the_command_writes_a_report_and_says_where_the_rows_are(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    basis = "0.131,-0.022;0.047,0.088"
    outs = [
        call(
            capsys, 0, folder / "a.clf", "-o", tmp_path / name, "--poses", folder / "a.tum", "--resolutions", 0.2,
            "--quick",
            "--tasks", "rotation", "--scans", 8, "--lattices", "Z2", "--basis", basis, "--workers", workers,
        )
        for name, workers in (("one", 1), ("two", 2))
    ]  # fmt: skip
    lines = outs[0].splitlines()
    assert "rows.parquet" in lines[-2] and "rows" in lines[-2] and "times" in lines[-1]
    for line in lines:
        assert Path(line.split()[1]).is_file()
    names = sorted(p.name for p in (tmp_path / "one").iterdir() if p.is_file() and p.suffix != ".jsonl")
    assert {"report.html", "report.md", "verdicts.csv", "outcomes.csv", "rows.parquet"} <= set(names)
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name
    # What does differ from run to run stands apart.
    assert "cpu" not in pq.read_table(tmp_path / "one" / "rows.parquet").column_names
    assert "cpu" in pq.read_table(tmp_path / "one" / "times" / "rows.parquet").column_names
    assert "own 1" in (tmp_path / "one" / "report.md").read_text()


def test_the_command_of_the_report_is_the_one_that_was_typed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["hexmap", "experiment", "localisation", "a.clf", "-o", "reploc", "--workers", "2"])
    assert command() == "hexmap experiment localisation a.clf -o reploc"


@pytest.mark.parametrize(
    ("standings", "outcome"),
    [
        (("tie", "tie"), "undecided"), (("win", "lose"), "undecided"), (("win", "win"), "holds"),
        (("win", "tie"), "holds in part"), (("lose", "tie"), "does not hold"),
    ],
)  # fmt: skip
def test_a_claim_that_the_data_do_not_decide_is_undecided(standings: tuple[Any, ...], outcome: str) -> None:
    measure = next(m for m in MEASURES if m.key == "nodes")
    interval = Interval(1.0, 0.9, 1.1)
    about = [
        Comparison(measure, 0.1 * (k + 1), "cell", "A2", "Z2", 1.0, 1.0, interval, 9, standing)
        for k, standing in enumerate(standings)
    ]
    assert verdict("A2 searches fewer nodes", about).outcome == outcome


@pytest.mark.data
@pytest.mark.long
def test_belgioioso_is_found_and_a_map_of_it_holds_no_scan_that_is_looked_for(data_dir: Path) -> None:
    log = open_log(data_dir / "laser2d" / "belgioioso.clf.gz")
    poses = read_tum(data_dir / "laser2d" / "belgioioso.rbpf.tum")
    settings = ExperimentSettings(resolutions=(0.1,), scans=12, tasks=("global", "local"), turns=(0.0,))
    results = localisation_experiment(log, settings, poses=poses, associate="order").results
    for grid in results.grids:
        found = results.select(task="global", grid=grid.number, method="all angles")
        assert np.mean([row["metres"] < 1.0 and row["degrees"] < 5.0 for row in found]) >= 0.6
