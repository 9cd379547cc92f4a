"""The localisation experiment: does another lattice than the square one localise better, and where does it not?"""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.arrays import IntArray
from hexmap.base.atomic_files import atomic_write
from hexmap.experiments.report.report import Report
from hexmap.experiments.run_cases import run_cases
from hexmap.io.lidar.lidar_log import LidarLog
from hexmap.io.logs.log import Log
from hexmap.poses.trajectory import Trajectory
from localisation.experiments.cases import experiment_case
from localisation.experiments.reading import read_world
from localisation.experiments.results import Results, parquet_bytes
from localisation.experiments.settings import ExperimentSettings, Grid, in_space_settings
from localisation.experiments.world import World

__all__ = ["SURE", "ExperimentOutcome", "localisation_experiment", "plan_cases"]

Progress = Callable[[int, int], None]
Case = dict[str, Any]

SURE = 0.95
"""Share of its particles in one cluster from which on the particle filter counts as having answered."""

# Scans a case: what an interruption can cost.
_CHUNKS = {"global": 7, "local": 14, "rotation": 10, "learning": 6}
# What comes after the cases: a change there leaves finished cases as they are.
_AFTERWARDS = ("report", "figures", "verdicts", "comparison", "results", "run", "times")


@dataclass(frozen=True, eq=False)
class ExperimentOutcome:
    """What was found.

    Attributes:
        results: all rows.
        command: the command line, for the reports.
    """

    results: Results
    command: str = ""

    @cached_property
    def report(self) -> Report:
        """The report, without times: the same on every run."""
        from localisation.experiments.report import make_report

        return make_report(self.results, self.command)

    @cached_property
    def times(self) -> Report:
        """The report of what it cost, which is not."""
        from localisation.experiments.times import make_times

        return make_times(self.results, self.command)

    def write(self, folder: Path) -> list[Path]:
        """Write both reports, that of the times into ``times/``, and all rows; return the files, the rows last.

        Raises:
            FileAccessError: a file or the folder cannot be written.
        """
        written = self.report.write(folder) + self.times.write(folder / "times")
        names = list(dict.fromkeys(key for row in self.results.rows for key in row))
        plain = [name for name in names if name != "cpu"]
        by = ["task", "method", "lattice", "resolution", "equal", "scan", "size", "axis", "value", "step", "cpu"]
        for path, columns in ((folder / "rows.parquet", plain), (folder / "times" / "rows.parquet", by)):
            with atomic_write(path) as handle:
                handle.write(parquet_bytes(self.results.rows, [name for name in columns if name in names]))
            written.append(path)
        return written


def localisation_experiment(
    log: Log | LidarLog,
    settings: ExperimentSettings | None = None,
    *,
    poses: Trajectory | None = None,
    test: Log | LidarLog | None = None,
    test_poses: Trajectory | None = None,
    associate: str | None = None,
    command: str = "",
    folder: Path | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> ExperimentOutcome:
    """Run the experiment on a log and return what was found.

    Args:
        log: an open log of a planar laser or a LiDAR.
        settings: what to do; None: the defaults of the plane, or of space.
        poses: T_map_robot of its scans, the reference; None: what the map maker finds.
        test: another run of the same place, whose scans are looked for; None: the log itself is split.
        test_poses: its T_map_robot in the same frame.
        associate: how poses go with scans: "order", "time", or None: as fits.
        command: the command line, for the report.
        folder: where finished cases are kept; an interrupted run goes on from there.
        workers: processes; nothing but times depends on it.
        executor: computes the cases instead of ``workers``, see :func:`~hexmap.experiments.run_cases`.
        progress: called with the cases done and their number.

    Raises:
        LogError: a log cannot be read or has too few scans.
        TrajectoryError: poses do not go with the scans.
        ArgumentError: a setting, or poses that are missing.
        AlignmentError: the other run is not found in the map of the first.
    """
    settings = settings or (in_space_settings() if isinstance(log, LidarLog) else ExperimentSettings())
    code = _fingerprint()

    def run(function: Any, cases: list[Case], shared: Mapping[str, Any]) -> list[dict[str, Any]]:
        return run_cases(function, cases, shared=shared, folder=folder, seed=settings.seed, fingerprint=code)

    world = read_world(log, settings, run, poses=poses, test=test, test_poses=test_poses, associate=associate)
    grids = settings.grids()
    cases = plan_cases(world, settings, grids)
    shared = {
        **world.shared(),
        "bases": settings.bases(),
        "sizes": [grid.resolution for grid in grids],
        "node_limit": settings.node_limit,
        "perturbations": [list(v) for v in settings.perturbations],
        "window": list(settings.window),
        "rotations": settings.rotations,
        "seed": settings.seed,
        "sure": SURE,
    }
    found = run_cases(
        experiment_case, cases, shared=shared, folder=folder, workers=workers, executor=executor, seed=settings.seed,
        progress=progress, fingerprint=code,
    )  # fmt: skip
    rows = []
    for case, result in zip(cases, found, strict=True):
        grid = grids[case["grid"]]
        about = {"task": case["task"], "grid": grid.number, "lattice": grid.name, "resolution": grid.resolution,
                 "equal": grid.equal, "turn": settings.all_turns[case["turn"]]}  # fmt: skip
        rows += [{**about, **row} for row in result["rows"]]
    # In the order of the log again, on every grid, whatever the turns: neighbours are alike.
    order = {task: k for k, task in enumerate(settings.tasks)}
    rows.sort(key=lambda row: (order[row["task"]], row["grid"], row.get("start", 0), row.get("run", 0), row["scan"]))
    return ExperimentOutcome(Results(settings, world, grids, rows), command)


def plan_cases(world: World, settings: ExperimentSettings, grids: list[Grid]) -> list[Case]:
    """Return all cases, those of one map one after the other."""
    tests = world.test_scans()
    many, few = _spread(tests, settings.scans).tolist(), _spread(tests, settings.learning_scans).tolist()
    # Where all scans of a stretch are held out, runs see one in so many, as where only those are: they come as far.
    driven = tests if settings.split == "every" and not world.run.any() else tests[:: settings.hold_out]
    length = min(settings.length, len(driven))
    starts = np.unique(np.linspace(0, len(driven) - length, settings.starts).astype(np.int64)).tolist()
    turns = range(len(settings.turns))
    out: list[Case] = []
    for grid, turn in itertools.product(grids, turns):
        about = {"grid": grid.number, "turn": turn}
        mine = many[turn :: len(turns)]
        for task in settings.tasks:
            if task == "localise":
                out += [
                    {**about, "task": task, "scans": driven[s : s + length].tolist()}
                    for s in starts[turn :: len(turns)]
                ]
            elif task not in ("mapping", "learning"):
                out += [{**about, "task": task, "scans": part} for part in _parts(mine, _CHUNKS[task])]
    for grid, number in itertools.product(grids if "mapping" in settings.tasks else [], range(settings.runs)):
        out.append({"task": "mapping", "grid": grid.number, "turn": len(turns) + number, "scans": many})
    for grid, turn in itertools.product(grids if "learning" in settings.tasks else [], turns):
        if grid.resolution == settings.learning_resolution:
            for axis, value in _learning_points(settings):
                point = {"task": "learning", "grid": grid.number, "turn": turn, "axis": axis, "value": value}
                out += [{**point, "scans": part} for part in _parts(few[turn :: len(turns)], _CHUNKS["learning"])]
    return out


def _learning_points(settings: ExperimentSettings) -> list[tuple[str, float]]:
    """Return the points of the learning curves: the axis and the value on it; the whole of everything first."""
    # What needs the same map first.
    points = [("whole", 1.0), *(("beams", v) for v in settings.shares)]
    points += [("scans", v) for v in settings.shares]
    points += [("range", v) for v in settings.ranges] + [("changed", v) for v in settings.changes]
    return points


def _spread(numbers: IntArray, count: int) -> IntArray:
    """Return at most ``count`` of the numbers, evenly spread."""
    at = np.unique(np.linspace(0, len(numbers) - 1, min(count, len(numbers))).astype(np.int64))
    return np.asarray(numbers[at])


def _parts(numbers: list[int], size: int) -> list[list[int]]:
    return [numbers[k : k + size] for k in range(0, len(numbers), size)]


def _fingerprint() -> str:
    """Return a digest of the code that finished cases depend on: an edited matcher must not meet old results."""
    digest = hashlib.blake2b(digest_size=20)
    package = Path(__file__).parents[1]
    for path in sorted(package.rglob("*.py")):
        if not (path.parent == Path(__file__).parent and path.stem.partition("_")[0] in _AFTERWARDS):
            digest.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()
