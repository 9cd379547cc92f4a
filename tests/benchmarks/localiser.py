"""Figures of the localiser along logs: found without a start pose, kidnapped, and how often it is wrong (figure 5).

``python -m tests.benchmarks.localiser [figure ...]``:

- ``wean``: Wean Hall's own map and logs, from random instants without a start pose;
- ``kidnap``: the robot put elsewhere at random instants of real logs;
- ``risk``: errors among what is answered as the least odds move, and answers in other buildings (of single scans:
  ``python -m tests.benchmarks.localisation risk``).

Of Wean Hall there is no truth. Its reference is made without the localiser: ``hexmap build`` maps each log by itself,
loops closed, and one rigid motion puts that map into the hall's own. Where its walls lie beside those of the hall's map
is printed with the figures: the hall's is coarse and bends, so that an answer agrees within 1.5 m and 10 degrees.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from hexmap.base.arrays import FloatArray
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.logs.log import Log
from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import read_tum
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Map
from hexmap.maps.state_rule import States
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.localiser.estimate import TrackState
from localisation.localiser.localiser import Localiser
from localisation.localiser.settings import LocaliserSettings
from localisation.mapping.fuse_log import readings_at_poses
from localisation.mapping.loop_closed_map import build_loop_closed_map
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.hypotheses import is_same_place
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import likelihood
from tests.benchmarks._common import data_folder, run_figures, table
from tests.benchmarks.localisation import kept, own_trajectory, planar_world, share

# Metres and radians within which an answer is right.
_RIGHT = {
    "wean": (1.5, math.radians(10.0)), "intel": (0.5, math.radians(10.0)), "mit-csail": (0.5, math.radians(10.0))
}  # fmt: skip


@dataclass(frozen=True)
class Sizes:
    """How much is done: instants of each log, scans and metres from each at the most, scans of each other building."""

    instants: int
    length: int
    metres: float
    foreign: int
    logs: tuple[int, ...] = (1, 2)


@dataclass(frozen=True)
class Run:
    """A map, a log's scans in their order with the reference T_map_robot (None where unknown), and the mount."""

    name: str
    world: Map | States
    scans: list[Scan]
    poses: list[Pose | None]
    mount: Pose | None = None

    def localiser(self, settings: LocaliserSettings | None = None, start: Pose | None = None) -> Localiser:
        """Return a localiser in this map."""
        return Localiser(self.world, settings, mount=self.mount, start=start)

    def is_right(self, pose: Pose, k: int) -> bool | None:
        """Tell whether a pose of scan ``k`` agrees with the reference; None where there is none."""
        true = self.poses[k]
        return None if true is None else is_same_place(pose, true, _RIGHT[self.name])


def scans_of(log: Log) -> list[Scan]:
    """Return the scans of a log that can be used."""
    return [e for e in log if isinstance(e, Scan) and is_usable(e)]


def is_usable(scan: Scan) -> bool:
    """Tell whether a scan sees enough and says where the wheels were."""
    return len(scan.points) >= 20 and scan.odometry is not None


def wean_run(cache: Path, number: int) -> Run:
    """Return Wean Hall's map and one of its logs."""
    folder = data_folder() / "laser2d" / "wean"
    states = open_grid(folder / "wean.dat.gz").to_states(Lattice.named("A2", 0.1))
    log = open_log(folder / f"robotdata{number}.log.gz")
    mount, scans = log.mount, scans_of(log)

    def reference() -> tuple[list[Pose | None], FloatArray]:
        poses: list[Pose | None] = []

        def note(stamp: float, pose: Pose, scan: bool) -> None:
            if scan:
                poses.append(pose)

        built = build_loop_closed_map(open_log(log.path), on_pose=note)
        walls = built.map.state().occupied.centres()
        T_hall_run = into_hall(states, walls)
        residual, _ = cKDTree(states.occupied.centres()).query(T_hall_run.apply(walls))
        every = [e for e in open_log(log.path) if isinstance(e, Scan)]
        assert len(every) == len(poses)
        usable = [k for k, scan in enumerate(every) if is_usable(scan)]
        return [T_hall_run @ pose for k in usable if (pose := poses[k]) is not None], residual

    poses, residual = kept(cache / f"wean{number}-built.pickle", reference)
    quartiles = ", ".join(f"{v:.2f}" for v in np.percentile(residual, (50, 75)))
    near = f"{100.0 * float((residual < 0.5).mean()):.0f} %"
    print(f"Wean Hall, log {number}: walls from those of the hall's map {quartiles} m (50, 75 %), {near} within 0.5 m")
    return Run("wean", states, scans, poses, mount)


def into_hall(states: States, walls: FloatArray) -> Pose:
    """Return T_hall_run: where a run's map, whose walls' cells (P, 2) are given, lies in the hall's, certified."""
    lattice = states.occupied.lattice
    matcher = GlobalMatcher(OccupancyPyramid(likelihood(states.occupied, 3.0 * lattice.resolution)))
    points, _ = thin(walls, lattice.scaled(2.0))
    middle = points.mean(axis=0)
    match = matcher.match(points - middle, runner_up=None, refine=False, beams=False, information=False)
    assert match is not None and match.certified
    return match.searched @ Pose.planar(-middle[0], -middle[1], 0.0)


def half_run(cache: Path, name: str) -> Run:
    """Return a map of every second scan of a log, and the others as a run."""

    def make() -> tuple[Map, list[Scan], list[Pose | None]]:
        log = next((data_folder() / "laser2d").glob(f"{name}.clf.gz"))
        poses = read_tum(own_trajectory(log, cache))
        builder, scans, true = MapBuilder(Lattice.named("A2", 0.05), levels=1), [], []
        readings = readings_at_poses(open_log(log), poses, associate="order")
        for number, (event, pose) in enumerate((e, p) for e, p in readings if isinstance(e, Scan) and p is not None):
            if number % 2:
                scans.append(event)
                true.append(pose)
            else:
                builder.fuse(event, pose)
        return builder.build(), scans, true

    return Run(name, *kept(cache / f"{name}-half.pickle", make))


def _instants(run: Run, count: int, room: int, seed: int) -> list[int]:
    """Return random instants with a reference and ``room`` scans after them, in their order."""
    good = [k for k in range(len(run.scans) - room) if run.poses[k] is not None]
    rng = np.random.default_rng(seed)
    return sorted(int(k) for k in rng.choice(good, min(count, len(good)), replace=False))


def _metres(scans: Sequence[Scan]) -> float:
    at = [s.odometry.translation for s in scans if s.odometry is not None]
    return sum(math.dist(a, b) for a, b in itertools.pairwise(at))


def _quantiles(values: Sequence[float]) -> str:
    return f"{np.median(values):.1f} / {np.percentile(values, 90):.1f}" if len(values) else "-"


# ---------------------------------------------------------------------- without a start pose


# Metres of the log after an instant: where it ends sooner, there may be nothing to tell the corridor's places apart.
_LEFT = 25.0


@dataclass(frozen=True)
class Found:
    """What came of one instant: scans until the first answer (None: none), and of those placed the right and wrong."""

    until: int | None
    metres: float
    seconds: float
    first_right: bool
    right: int
    wrong: int
    scans: int
    overlap: float
    lost: int
    left: float  # metres of the log from there on


def _length(run: Run, first: int, metres: float) -> int:
    """Return how many scans the robot takes from scan ``first`` on for so many metres, or until the log ends."""
    driven, k = 0.0, first
    while k + 1 < len(run.scans) and driven < metres:
        driven, k = driven + _metres(run.scans[k : k + 2]), k + 1
    return k + 1 - first


def _from_instant(run: Run, first: int, length: int, settings: LocaliserSettings | None = None) -> Found:
    localiser = run.localiser(settings)
    until, verdicts, overlaps, seconds = None, [], [], 0.0
    for k in range(first, min(first + length, len(run.scans))):
        begin = time.process_time()
        estimate = localiser.add(run.scans[k])
        seconds += time.process_time() - begin if until is None else 0.0
        if estimate is None or estimate.pose is None:
            continue
        until = k - first + 1 if until is None else until
        overlaps.append(estimate.overlap)
        verdicts.append(run.is_right(estimate.pose, k))
    judged = [v for v in verdicts if v is not None]
    return Found(
        until, _metres(run.scans[first : first + (until or 0)]), seconds, bool(judged and judged[0]), sum(judged),
        len(judged) - sum(judged), min(length, len(run.scans) - first), float(np.mean(overlaps or [0.0])),
        localiser.times_lost, _metres(run.scans[first : first + length]),
    )  # fmt: skip


def wean(cache: Path, sizes: Sizes) -> None:
    """Print how soon and how rightly the robot is found in Wean Hall."""
    rows: list[list[object]] = [[
        "Wean Hall", "instants", "right", "wrong", "never", f"right with {_LEFT:g} m to go", "m, median / 90 %",
        "s of the drive", "CPU s",
        "scans placed", "right of placed", "points explained", "times lost",
    ]]  # fmt: skip
    for number in sizes.logs:
        run = wean_run(cache, number)
        found, seconds = [], []
        for first in _instants(run, sizes.instants, 60, number):
            f = _from_instant(run, first, _length(run, first, sizes.metres))
            found.append(f)
            if f.until is not None:
                seconds.append(run.scans[first + f.until - 1].stamp - run.scans[first].stamp)
        done = [f for f in found if f.until is not None]
        placed, right = sum(f.right + f.wrong for f in done), sum(f.right for f in done)
        first_right = sum(f.first_right for f in done)
        rows.append([
            f"log {number}", len(found), first_right, len(done) - first_right, len(found) - len(done),
            f"{sum(f.first_right for f in found if f.left >= _LEFT)} of {sum(f.left >= _LEFT for f in found)}",
            _quantiles([f.metres for f in done]), _quantiles(seconds), _quantiles([f.seconds for f in found]),
            f"{100.0 * placed / max(1, sum(f.scans for f in found)):.1f} %", f"{100.0 * right / max(1, placed):.1f} %",
            float(np.mean([f.overlap for f in done] or [0.0])), sum(f.lost for f in done),
        ])  # fmt: skip
    print(
        f"at most {sizes.metres:g} m from each instant, fewer where the log ends; right, wrong: the first answer, by "
        f"{_RIGHT['wean'][0]:g} m of the reference; CPU s: until then, or of all where there is none\n"
    )
    table(rows)


# ---------------------------------------------------------------------- kidnapped


def kidnap(cache: Path, sizes: Sizes) -> None:
    """Print how soon a jump to another place is noticed and mended."""
    rows: list[list[object]] = [[
        "log", "jumps", "noticed", "after scans, median / 90 %", "m", "recovered", "after scans", "m",
        "wrong of placed after", "false alarms, of scans before",
    ]]  # fmt: skip
    for name, run in (
        ("intel, every second scan", half_run(cache, "intel")), ("Wean Hall 1", wean_run(cache, 1)),
        ("Wean Hall 2", wean_run(cache, 2)),
    ):  # fmt: skip
        before = 15
        rng = np.random.default_rng(1)
        starts = _instants(run, sizes.instants, before + 1, 1)
        targets = [int(k) for k in rng.permutation(_instants(run, sizes.instants, sizes.length // 2, 2))]
        trials = [
            _jump(run, first, target, before, sizes.length)
            for first, target in zip(starts, targets, strict=False)
            if math.dist(_at(run, first + before).translation, _at(run, target).translation) > 2.0
        ]
        noticed, mended = [t for t in trials if t[0] is not None], [t for t in trials if t[1] is not None]
        rows.append([
            name, len(trials), share([t[0] is not None for t in trials]), _quantiles([t[0] or 0 for t in noticed]),
            _quantiles([t[2] for t in noticed]), share([t[1] is not None for t in trials]),
            _quantiles([t[1] or 0 for t in mended]), _quantiles([t[3] for t in mended]),
            f"{sum(t[4] for t in trials)} of {sum(t[5] for t in trials)}",
            f"{sum(t[6] for t in trials)} of {before * len(trials)}",
        ])  # fmt: skip
    print(f"at most {sizes.length} scans after the jump; the wheels do not notice it\n")
    table(rows)


def _at(run: Run, k: int) -> Pose:
    """Return the reference of scan ``k`` or of the next that has one."""
    return next(p for p in [*run.poses[k:], *reversed(run.poses[:k])] if p is not None)


def _jump(
    run: Run, first: int, target: int, before: int, length: int
) -> tuple[int | None, int | None, float, float, int, int, int]:
    """Return scans until noticed and until mended, metres of both, wrong and all answers after the first, alarms."""
    localiser = run.localiser(start=_at(run, first))
    for k in range(first, first + before):
        localiser.add(run.scans[k])
    alarms = localiser.times_lost
    last, next_ = run.scans[first + before - 1].odometry, run.scans[target].odometry
    assert last is not None and next_ is not None
    shift = last @ next_.inverse()
    noticed = mended = None
    wrong = placed = 0
    for k in range(target, min(target + length, len(run.scans))):
        scan = run.scans[k]
        assert scan.odometry is not None
        estimate = localiser.add(replace(scan, odometry=shift @ scan.odometry))
        assert estimate is not None
        right = None if estimate.pose is None else run.is_right(estimate.pose, k)
        if noticed is None and (estimate.state is not TrackState.tracking or right):
            noticed = k - target + 1
        if noticed is not None and right is not None:
            placed += 1
            wrong += not right
        if mended is None and right:
            mended = k - target + 1
            break
    ways = [_metres(run.scans[target : target + (count or 0)]) for count in (noticed, mended)]
    return noticed, mended, ways[0], ways[1], wrong, placed, alarms


# ---------------------------------------------------------------------- risk against coverage


def risk(cache: Path, sizes: Sizes) -> None:
    """Print wrong answers as the odds move from which a place is answered, and answers in other buildings."""
    rows: list[list[object]] = [
        ["odds at least", "log", "instants", "localised", "m, median / 90 %", "first answer wrong", "wrong of placed"]
    ]
    for odds in (10.0, 1000.0, 1e5):
        for name, run in (("intel", half_run(cache, "intel")), ("Wean Hall 2", wean_run(cache, 2))):
            settings = LocaliserSettings(odds=odds)
            found = [
                _from_instant(run, k, sizes.length // 2, settings)
                for k in _instants(run, max(2, sizes.instants // 2), 40, 3)
            ]
            done = [f for f in found if f.until is not None]
            rows.append([
                f"{odds:g}", name, len(found), share([f.until is not None for f in found]),
                _quantiles([f.metres for f in done]), f"{sum(not f.first_right for f in done)} of {len(done)}",
                f"{sum(f.wrong for f in done)} of {sum(f.wrong + f.right for f in done)}",
            ])  # fmt: skip
    table(rows)
    _strangers(cache, sizes)


def _strangers(cache: Path, sizes: Sizes) -> None:
    """Print how many scans of other buildings are given a pose."""
    logs = {
        n: scans_of(open_log(data_folder() / "laser2d" / f"{n}.clf.gz")) for n in ("belgioioso", "aces", "mit-csail")
    }
    logs["intel"] = half_run(cache, "intel").scans
    hall = wean_run(cache, 2)
    logs["Wean Hall"] = hall.scans
    maps: dict[str, Map | States] = {
        n: planar_world(cache, n, Lattice.named("A2", 0.05)).map for n in ("intel", "belgioioso", "aces")
    }
    maps["Wean Hall"] = hall.world
    rows: list[list[object]] = [["map", "log", "scans", "answered", "doubtful", "CPU s"]]
    total = answered = 0
    for name, world in maps.items():
        for log, scans in logs.items():
            if log == name:
                continue
            localiser = Localiser(world, LocaliserSettings(node_limit=1_000_000))
            begin, count, ambiguous = time.process_time(), 0, 0
            chosen = scans[: sizes.foreign]
            for scan in chosen:
                estimate = localiser.add(scan)
                count += estimate is not None and estimate.pose is not None
                ambiguous += estimate is not None and estimate.state is TrackState.ambiguous
            rows.append([name, log, len(chosen), count, ambiguous, time.process_time() - begin])
            total, answered = total + len(chosen), answered + count
    rows.append(["all", "", total, answered, "", ""])
    print("consecutive scans of other buildings; nodes of a search at most 1,000,000; doubtful: none answered\n")
    table(rows)


FIGURES: dict[str, Callable[[Path, Sizes], None]] = {"wean": wean, "kidnap": kidnap, "risk": risk}


def main(arguments: list[str] | None = None) -> None:
    """Print the figures asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.localiser", description="Figures of the localiser."
    )
    parser.add_argument("--instants", type=int, default=50, help="random instants of each log")
    parser.add_argument("--length", type=int, default=300, help="scans from each at the most")
    parser.add_argument("--metres", type=float, default=40.0, help="of Wean Hall, from each instant at the most")
    parser.add_argument("--logs", type=int, nargs="+", default=[1, 2], choices=[1, 2], help="of Wean Hall")
    parser.add_argument("--foreign", type=int, default=700, help="scans of each log in each map of another building")

    def sizes(chosen: argparse.Namespace) -> Sizes:
        return Sizes(chosen.instants, chosen.length, chosen.metres, chosen.foreign, tuple(chosen.logs))

    run_figures(parser, arguments, FIGURES, sizes)


if __name__ == "__main__":
    main()
