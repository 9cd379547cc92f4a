"""Figures of localisation: a scan found in a map, proved, and how sure the match is.

Maps are built without the scans that are looked for. Times are CPU seconds (``time.process_time``) of one thread and
wall seconds beside them; medians and 95th percentiles. ``python -m tests.benchmarks.localisation [figure ...]``:

- ``find``: single scans in whole maps, over all real angles and over a stated set of them;
- ``risk``: errors among answered scans as the least margin of an answer moves;
- ``compare``: nodes and time of lattices at equal size of the cell and at equal covering radius, paired;
- ``others``: scans of other buildings, and what is left of the right ones when none of those is accepted;
- ``calibration``: errors in simulated buildings against the covariance that was reported;
- ``space``: LiDAR scans in a hall, all yaws and a tilt of up to 5 degrees;
- ``repeat``: the same bits over three runs, in one process and in two.

Trajectory and maps are kept in the folder given with ``--cache``, so that a second run need not build them again.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import math
import multiprocessing
import pickle
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.experiments.statistics import bootstrap_ratio, mean
from hexmap.io.lidar.open_lidar import open_lidar
from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import TumWriter, read_tum
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Map
from hexmap.poses.pose import Pose, wrap_angle
from hexmap.poses.rotations import exponential
from hexmap.poses.scan import Scan
from hexmap.simulator.buildings import Building, make_building
from hexmap.simulator.events import OdometryNoise, simulate
from hexmap.simulator.laser import Laser
from localisation.lidar_settings import LidarSettings
from localisation.mapping.build_map import build_map
from localisation.mapping.fuse_log import readings_at_poses
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.match import Match
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion
from tests.benchmarks._common import data_folder, run_figures, table

# Every so many scans one is held out of the map and looked for.
HELD_OUT = 20
# Degrees about each horizontal axis by which a levelled scan still leans, and points of it that are searched with.
LEAN = 2.0
SPACE_POINTS = 300
# Outlines of a match that is right: of the cells, and in degrees.
RIGHT_CELLS, RIGHT_DEGREES = 2.0, 1.0


# Metres beyond which points of the LiDAR are left out.
FARTHEST = 60.0


@dataclass(frozen=True)
class Sizes:
    """How much of everything is done.

    Attributes:
        scans: of a map that are looked for.
        foreign: of each other building, to choose thresholds on.
        unseen: further ones of each, to count false accepts on.
        space: of the hall, a lattice.
        simulated: of each simulated building.
        margin: below it a match is called ambiguous.
        limit: seconds after which a search gives up; most never need it.
    """

    scans: int
    foreign: int
    unseen: int
    space: int
    simulated: int
    margin: float
    limit: float


# A scan (N, n) and its pose T_map_laser.
Sight: TypeAlias = tuple[NDArray[np.float64], Pose]


@dataclass(frozen=True)
class World:
    """A map, and scans that took no part in it with their poses T_map_laser."""

    map: Map
    scans: list[Sight]

    def some(self, count: int) -> list[Sight]:
        """Return at most ``count`` scans, spread over all."""
        every = np.unique(np.linspace(0, len(self.scans) - 1, min(count, len(self.scans))).astype(int))
        return [self.scans[k] for k in every]


@dataclass(frozen=True)
class Trial:
    """One scan that was looked for: what was found, and how long it took."""

    match: Match | None
    cpu: float
    wall: float
    metres: float
    degrees: float


# ---------------------------------------------------------------------- worlds


def kept(path: Path, make: Callable[[], Any]) -> Any:
    """Return what is kept at ``path``, made first where it is not there."""
    if not path.exists():
        value = make()
        path.write_bytes(pickle.dumps(value))
        return value
    return pickle.loads(path.read_bytes())  # our own file


def own_trajectory(log: Path, cache: Path) -> Path:
    """Return the file of the poses that ``hexmap build`` finds for a log, built once."""
    path = cache / f"{log.name.split('.')[0]}.tum"
    if not path.exists():
        with TumWriter(path) as out:
            build_map(open_log(log), on_pose=lambda stamp, pose, scan: out.append(stamp, pose))
    return path


def planar_world(cache: Path, name: str, lattice: Lattice) -> World:
    """Return a map of a log of ``laser2d`` and the scans held out of it."""

    def make() -> tuple[Map, list[Any]]:
        log = next((data_folder() / "laser2d").glob(f"{name}.clf.gz"))
        given = log.with_name(f"{name}.rbpf.tum")
        poses = read_tum(given if given.exists() else own_trajectory(log, cache))
        builder, scans, seen = MapBuilder(lattice, levels=1), [], 0
        for event, pose in readings_at_poses(open_log(log), poses, associate="order"):
            if not isinstance(event, Scan) or pose is None:
                continue
            seen += 1
            if seen % HELD_OUT == HELD_OUT // 2:
                if len(event.points) >= 20:
                    scans.append((np.array(event.points), pose))
            else:
                builder.fuse(event, pose)
        return builder.build(), scans

    return World(*kept(cache / f"{name}-{lattice.name}-{lattice.resolution:.6g}.pickle", make))


def hall_scans() -> list[tuple[float, NDArray[np.float64]]]:
    """Return stamps and points (N, 3) of the LiDAR scans of the hall."""
    # A handful of strays lies hundreds of metres away; the hall is 62 m long.
    settings = LidarSettings(max_range=FARTHEST)
    return [(scan.stamp, settings.in_range(scan.points)) for scan in open_lidar(data_folder() / "lidar3d" / "hall")]


def hall_world(cache: Path, lattice: Lattice) -> World:
    """Return a map of every second scan of the hall, and the other scans."""

    def make() -> tuple[Map, list[Any]]:
        poses = read_tum(data_folder() / "lidar3d" / "hall.reference.tum")
        builder, scans = MapBuilder(lattice, levels=1), []
        for number, (stamp, points) in enumerate(kept(cache / "hall.pickle", hall_scans)):
            k, off = poses.nearest([stamp])
            if off[0] > 0.05:
                continue
            if number % 2:
                scans.append((points, poses[int(k[0])]))
            else:
                builder.fuse(Scan(stamp, points), poses[int(k[0])])
        return builder.build(), scans

    return World(*kept(cache / f"hall-{lattice.name}-{lattice.resolution:.6g}.pickle", make))


# ---------------------------------------------------------------------- looking for scans


def look(matcher: GlobalMatcher, points: NDArray[np.float64], true: Pose, **how: Any) -> Trial:
    """Look for one scan."""
    wall, cpu = time.perf_counter(), time.process_time()
    match = matcher.match(points, **how)
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    if match is None:
        return Trial(None, cpu, wall, math.inf, math.inf)
    off = match.pose.inverse() @ true
    return Trial(match, cpu, wall, float(np.linalg.norm(off.translation)), math.degrees(abs(off.angle)))


def share(values: Sequence[bool] | NDArray[np.bool_]) -> str:
    """Return a share in per cent, with how many that are."""
    return f"{100.0 * float(np.mean(values)):.1f} %" if len(values) else "none"


def spread(seconds: Sequence[float]) -> str:
    """Return median and 95th percentile in milliseconds."""
    return f"{1e3 * float(np.median(seconds)):.0f} / {1e3 * float(np.percentile(seconds, 95)):.0f}"


def warm_up(matcher: GlobalMatcher, points: NDArray[np.float64], **how: Any) -> None:
    """Compile, and fill the tables, before anything is timed."""
    matcher.match(points, **how)


def find(cache: Path, sizes: Sizes) -> None:
    """Print how fast, how surely and how rightly single scans are found in whole maps (figure 1)."""
    print("search: the best pose and its proof alone; all: with runner-up, refinement, beams and information")
    print(
        f"found: within {RIGHT_CELLS:g} cells and {RIGHT_DEGREES:g} degree of the trajectory; near: 0.5 m and 3 degrees"
    )
    print(f"unambiguous: a margin of {sizes.margin:g} or more; ms: median / 95th percentile; limit {sizes.limit:g} s\n")
    built: list[list[object]] = [["pyramid", "cells", "levels", "MB", "build s"]]
    for name, resolution, lattices, part in (
        ("intel", 0.05, ("A2", "Z2"), 1), ("belgioioso", 0.1, ("A2", "Z2"), 2), ("freiburg-campus", 0.1, ("A2",), 5),
    ):  # fmt: skip
        # The larger the map the fewer scans, so that all maps take about as long.
        count = max(4, sizes.scans // part)
        rows: list[list[object]] = [[
            f"{name}, {resolution:g} m", "angles", "scans", "certified", "gap 0", "found", "near", "unambiguous",
            "found of those", "search CPU ms", "wall ms", "all CPU ms", "wall ms", "nodes",
        ]]  # fmt: skip
        for named in lattices:
            world = planar_world(cache, name, Lattice.named(named, resolution))
            occupied = coincidence(world.map.state().occupied)
            seconds = []
            for _ in range(3):
                begin = time.process_time()
                pyramid = OccupancyPyramid(occupied)
                seconds.append(time.process_time() - begin)
            built.append([f"{name} {named}", len(occupied), pyramid.levels, pyramid.nbytes / 1e6, sorted(seconds)[1]])
            matcher = GlobalMatcher.of_map(world.map)
            for angles in ("continuous", "stated"):
                rows.append([named, angles, *_find_row(matcher, world.some(count), angles, resolution, sizes)])
        table(rows)
    table(built)


def _find_row(
    matcher: GlobalMatcher, chosen: list[Sight], angles: str, resolution: float, sizes: Sizes
) -> list[object]:
    alone: dict[str, Any] = {"runner_up": None, "refine": False, "beams": False, "information": False}

    def step(points: NDArray[np.float64]) -> float | str:
        return "continuous" if angles == "continuous" else resolution / float(np.linalg.norm(points, axis=1).max())

    warm_up(matcher, chosen[0][0], angles=step(chosen[0][0]), time_limit=sizes.limit)
    only = [look(matcher, p, t, angles=step(p), time_limit=sizes.limit, **alone) for p, t in chosen]
    full = [look(matcher, p, t, angles=step(p), time_limit=sizes.limit) for p, t in chosen]
    right = np.array([t.metres <= RIGHT_CELLS * resolution and t.degrees <= RIGHT_DEGREES for t in full])
    near = np.array([t.metres <= 0.5 and t.degrees <= 3.0 for t in full])
    clear = np.array([t.match is not None and t.match.margin >= sizes.margin for t in full])
    matches = [t.match for t in full if t.match is not None]
    return [
        len(full), share([m.certified for m in matches]), share([m.gap == 0 for m in matches]), share(right),
        share(near), share(clear), share(right[clear]), spread([t.cpu for t in only]), spread([t.wall for t in only]),
        spread([t.cpu for t in full]), spread([t.wall for t in full]),
        int(np.median([t.match.nodes for t in only if t.match is not None])),
    ]  # fmt: skip


# ---------------------------------------------------------------------- risk against coverage


def risk(cache: Path, sizes: Sizes) -> None:
    """Print the errors among answered poses as the margin moves from which a scan is answered (part of figure 5)."""
    rows: list[list[object]] = [[
        "A2", "margin at least", "scans", "answered", "found", "near", "error m, median", "95 %", "worst m",
    ]]  # fmt: skip
    for name, resolution in (("intel", 0.05), ("belgioioso", 0.1)):
        world = planar_world(cache, name, Lattice.named("A2", resolution))
        matcher = GlobalMatcher.of_map(world.map)
        how: dict[str, Any] = {"beams": False, "information": False, "time_limit": sizes.limit}
        warm_up(matcher, world.scans[0][0], **how)
        trials = [look(matcher, p, t, **how) for p, t in world.some(sizes.scans)]
        margins = np.array([t.match.margin if t.match else -1.0 for t in trials])
        metres, degrees = np.array([t.metres for t in trials]), np.array([t.degrees for t in trials])
        found = (metres <= RIGHT_CELLS * resolution) & (degrees <= RIGHT_DEGREES)
        near = (metres <= 0.5) & (degrees <= 3.0)
        for margin in (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3):
            chosen = margins >= margin
            errors = metres[chosen]
            far = [float(np.percentile(errors, q)) for q in (50, 95, 100)] if len(errors) else [math.nan] * 3
            rows.append([
                name, margin, len(trials), share(chosen), share(found[chosen]), share(near[chosen]), *far,
            ])  # fmt: skip
    print(f"maps without these scans; limit {sizes.limit:g} s; found, near: of those answered\n")
    table(rows)


# ---------------------------------------------------------------------- lattices against one another


def compare(cache: Path, sizes: Sizes) -> None:
    """Print nodes and time of A2 to Z2, and of D3 and D3* to Z3, over the same scans (figure 3)."""
    print("ratios of means, BCa intervals, over scans whose search both lattices finished; search alone, all angles\n")
    for base, rivals, resolution, make, count, region in (
        ("Z2", ("A2",), 0.05, lambda lattice: planar_world(cache, "intel", lattice), sizes.scans, None),
        ("Z3", ("D3", "D3*"), 0.5, lambda lattice: hall_world(cache, lattice), sizes.space, tilted()),
    ):
        rows: list[list[object]] = [
            ["to one", "equal", "m", "scans", "nodes", "95 %", "CPU", "95 %", "found", "of one"]
        ]
        reference = Lattice.named(base, resolution)
        trials = _alone(make(reference), count, region, sizes.limit)
        for name in rivals:
            same_cell = Lattice.named(name, resolution)
            same_radius = same_cell.scaled(reference.covering_radius / same_cell.covering_radius)
            for equal, lattice in (("cell", same_cell), ("covering radius", same_radius)):
                there = _alone(make(lattice), count, region, sizes.limit)
                rows.append(_ratio_row(f"{name} to {base}", equal, lattice, there, trials))
        table(rows)


def _alone(world: World, count: int, region: SearchRegion | None, limit: float) -> list[Trial]:
    matcher = GlobalMatcher.of_map(world.map)
    how: dict[str, Any] = {"runner_up": None, "beams": False, "information": False, "time_limit": limit}
    chosen = world.some(count)
    if world.map.lattice.dim == 3:
        rng = np.random.default_rng(0)
        chosen = [levelled(points, true, rng) for points, true in chosen]
        how["most_points"] = SPACE_POINTS
    for points, _ in chosen:
        warm_up(matcher, points, region=region, **how)
    return [look(matcher, p, t, region=region, **how) for p, t in chosen]


def _ratio_row(label: str, equal: str, lattice: Lattice, a: list[Trial], b: list[Trial]) -> list[object]:
    both = [
        (x, y, x.match, y.match)
        for x, y in zip(a, b, strict=True)
        if x.match and y.match and x.match.certified and y.match.certified
    ]
    right = [share([t.metres <= 0.5 and t.degrees <= 3.0 for t in trials]) for trials in (a, b)]
    if len(both) < 3:
        return [label, equal, lattice.resolution, len(both), "-", "-", "-", "-", *right]
    rng = np.random.default_rng(0)
    nodes = bootstrap_ratio([float(m.nodes) for _, _, m, _ in both], [float(m.nodes) for *_, m in both], mean, rng=rng)
    cpu = bootstrap_ratio([x.cpu for x, *_ in both], [y.cpu for _, y, *_ in both], mean, rng=rng)
    return [
        label, equal, lattice.resolution, len(both), nodes.value, f"{nodes.low:.3f} to {nodes.high:.3f}",
        cpu.value, f"{cpu.low:.3f} to {cpu.high:.3f}", *right,
    ]  # fmt: skip


# ---------------------------------------------------------------------- other buildings


def others(cache: Path, sizes: Sizes) -> None:
    """Print the share of right answers when no scan of another building is accepted (part of figure 5)."""
    lattice = Lattice.named("A2", 0.05)
    world = planar_world(cache, "intel", lattice)
    matcher = GlobalMatcher.of_map(world.map)
    warm_up(matcher, world.scans[0][0])
    own = [look(matcher, p, t, time_limit=sizes.limit) for p, t in world.some(sizes.scans)]
    right = np.array([t.metres <= RIGHT_CELLS * lattice.resolution and t.degrees <= RIGHT_DEGREES for t in own])
    rows: list[list[object]] = [
        ["scans in the map of intel", "scans", "fraction, median", "most", "contradicted, median", "CPU ms"]
    ]
    foreign: list[Trial] = []
    fresh: list[NDArray[np.float64]] = []
    for name in ("belgioioso", "aces", "mit-csail"):
        scans = _points_of(f"{name}.clf.gz")
        seen = np.unique(np.linspace(0, len(scans) - 1, sizes.foreign).astype(int))
        unseen = np.setdiff1d(np.arange(len(scans)), seen)
        some = np.unique(np.linspace(0, len(unseen) - 1, min(sizes.unseen, len(unseen))).astype(int))
        fresh += [scans[k] for k in unseen[some]]
        trials = [look(matcher, scans[k], Pose.identity(2), time_limit=sizes.limit) for k in seen]
        foreign += trials
        rows.append(_feature_row(name, trials))
    rows.append(_feature_row("intel, held out", own))
    table(rows)
    answers, strangers = _features(own), _features(foreign)
    # Every rule looks at the fraction, so that a search may stop where no pose can reach the lowest limit on it: that
    # refusal is proved without the best score.
    rules = {
        label: (used, _thresholds(answers[right], strangers, used))
        for label, used in (
            ("fraction", (0,)), ("fraction, contradicted", (0, 1)), ("fraction, margin", (0, 2)),
            ("fraction, contradicted, margin", (0, 1, 2)),
        )
    }  # fmt: skip
    # A limit below the fraction of every right answer accepts nothing more that is right.
    for _, limits in rules.values():
        limits[0] = max(float(limits[0]), float(answers[right][:, 0].min()))
    least = min(float(limits[0]) for _, limits in rules.values())
    # Some more of places that nothing was chosen on, and Intel's scans in another building's map.
    for name in ("freiburg-campus.clf.gz", "wean/robotdata1.log.gz", "wean/robotdata2.log.gz"):
        fresh += _some(_points_of(name), sizes.unseen)
    later = [look(matcher, p, Pose.identity(2), time_limit=sizes.limit, least=least) for p in fresh]
    second = GlobalMatcher.of_map(planar_world(cache, "belgioioso", lattice).map)
    strange = _some(_points_of("intel.clf.gz"), sizes.unseen)
    later += [look(second, p, Pose.identity(2), time_limit=sizes.limit, least=least) for p in strange]
    unproved = sum(t.cpu >= sizes.limit for t in later)
    out: list[list[object]] = [
        ["accepted where", "thresholds", "recall", "right of accepted", "chosen on", "false accepts of others"]
    ]
    for label, (used, limits) in rules.items():
        accepted, false = _accept(answers, limits), _accept(_features(later), limits)
        out.append([
            label, ", ".join(f"{abs(limits[k]):.3f}" for k in used), share(accepted & right), share(right[accepted]),
            len(foreign), f"{int(false.sum())} of {len(false)}",
        ])  # fmt: skip
    print("fraction and margin at least, contradicted at most; recall: right and accepted, of all scans held out\n")
    table(out)
    print(
        f"those others searched from a fraction of {least:.3f} on, CPU ms: {spread([t.cpu for t in later])}, in all "
        f"{sum(t.cpu for t in later):.0f} s; stopped by the limit: {unproved}\n"
    )
    every = np.concatenate([strangers, _features(later)])
    least_false: list[list[object]] = [["none of all others accepted where", "thresholds", "recall", "others"]]
    for label, (used, _) in rules.items():
        limits = _thresholds(answers[right], every, used)
        accepted = _accept(answers, limits)
        least_false.append([
            label, ", ".join("-" if np.isinf(limits[k]) else f"{abs(limits[k]):.3f}" for k in used),
            share(accepted & right), len(every),
        ])  # fmt: skip
    table(least_false)


def _points_of(name: str) -> list[NDArray[np.float64]]:
    """Return the scans of a log of ``laser2d`` that see enough."""
    log = open_log(data_folder() / "laser2d" / name)
    return [np.array(e.points) for e in log if isinstance(e, Scan) and len(e.points) >= 20]


def _some(scans: list[NDArray[np.float64]], count: int) -> list[NDArray[np.float64]]:
    return [scans[k] for k in np.unique(np.linspace(0, len(scans) - 1, min(count, len(scans))).astype(int))]


def _features(trials: list[Trial]) -> NDArray[np.float64]:
    """Return what speaks for each match, (M, 3): fraction, contradicted with its sign turned, margin."""
    return np.array([
        (t.match.fraction, -float(t.match.contradicted or 0.0), t.match.margin) if t.match else (0.0, -1.0, 0.0)
        for t in trials
    ])  # fmt: skip


def _feature_row(name: str, trials: list[Trial]) -> list[Any]:
    f = _features(trials)
    return [
        name, len(trials), float(np.median(f[:, 0])), float(f[:, 0].max()), -float(np.median(f[:, 1])),
        spread([t.cpu for t in trials]),
    ]  # fmt: skip


def _accept(features: NDArray[np.float64], limits: NDArray[np.float64]) -> NDArray[np.bool_]:
    return np.asarray((features >= limits).all(axis=1))


def _thresholds(good: NDArray[np.float64], bad: NDArray[np.float64], used: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the limits on the features in ``used`` that accept most of ``good`` and none of ``bad``."""
    best, most = np.full(3, np.inf), -1
    grids = [np.unique(np.quantile(good[:, k], np.linspace(0.0, 1.0, 26))) for k in used[1:]]
    for corner in itertools.product(*grids):
        limits = np.full(3, -np.inf)
        limits[list(used[1:])] = corner
        # The first feature takes the lowest limit that still keeps all others out.
        left = bad[_accept(bad, limits)][:, used[0]]
        limits[used[0]] = np.nextafter(left.max(), np.inf) if len(left) else -np.inf
        count = int(_accept(good, limits).sum())
        if count > most:
            best, most = limits, count
    return best


# ---------------------------------------------------------------------- calibration


def simulated_building(name: str, seed: int) -> Building:
    """Return a building of the simulator, stretched and turned by a seed, or a corridor with niches."""
    rng = np.random.default_rng(seed)
    made = _corridor(rng) if name == "corridor" else make_building(name)
    stretch, angle = rng.uniform(0.9, 1.25, 2), rng.uniform(0.0, 2.0 * math.pi)
    A = Pose.planar(0.0, 0.0, angle).rotation @ np.diag(stretch)
    return Building(f"{name} {seed}", made.walls @ A.T, made.waypoints @ A.T)


def _corridor(rng: np.random.Generator) -> Building:
    """Return a corridor of 40 x 2.4 m with five niches on either side."""
    length, width = 40.0, 2.4
    corners = [[(0.0, 0.0), (0.0, width)], [(length, 0.0), (length, width)]]
    for y, depth in ((0.0, -0.3), (width, 0.3)):
        line = [(0.0, y)]
        for x in np.sort(rng.choice(np.arange(3, 37, 3), 5, replace=False)) + rng.uniform(-0.5, 0.5, 5):
            line += [(x - 0.45, y), (x - 0.45, y + depth), (x + 0.45, y + depth), (x + 0.45, y)]
        corners.append([*line, (length, y)])
    walls = [pair for line in corners for pair in itertools.pairwise(line)]
    return Building("corridor", np.array(walls), np.array([(1.5, 1.2), (20, 1.0), (38, 1.4), (20, 1.3), (2, 1.2)]))


def calibration(cache: Path, sizes: Sizes) -> None:
    """Print errors against the covariance, over ten simulated buildings (figure 4)."""
    kinds = ("office", "office", "office", "castle", "castle", "room", "room", "corridor", "corridor", "corridor")
    out: list[list[object]] = [
        ["refined poses", "scans", "error mm", "NES, 3", "50 %", "90 %", "95 %", "NES, 2", "50 %", "90 %", "95 %"]
    ]
    axes: list[list[object]] = [
        ["where one sigma is 3 times the other", "scans", "sigma mm", "NES, 1", "50 %", "90 %", "95 %"]
    ]
    for name in ("A2", "Z2"):
        found = [(kind, *row) for k, kind in enumerate(kinds) for row in _errors(name, kind, 11 + k, sizes.simulated)]
        for kind in ("office", "castle", "room", "corridor", "all"):
            chosen = [(e, C) for made, e, C in found if kind in (made, "all")]
            e, C = np.array([c[0] for c in chosen]), np.array([c[1] for c in chosen])
            whole = np.einsum("ki,kij,kj->k", e, np.linalg.inv(C), e)
            plane = np.einsum("ki,kij,kj->k", e[:, :2], np.linalg.inv(C[:, :2, :2]), e[:, :2])
            median = 1e3 * float(np.median(np.linalg.norm(e[:, :2], axis=1)))
            out.append([f"{name} {kind}", len(e), median, *_coverage(whole, 3), *_coverage(plane, 2)])
            if kind not in ("corridor", "all"):
                continue
            squared, V = np.linalg.eigh(C[:, :2, :2])
            along = np.einsum("kij,ki->kj", V, e[:, :2]) ** 2 / squared
            long = squared[:, 1] > 9.0 * squared[:, 0]
            for axis, label in ((1, "along"), (0, "across")):
                sigma = 1e3 * float(np.sqrt(np.median(squared[long, axis]))) if long.any() else math.nan
                axes.append([f"{name} {kind}, {label}", int(long.sum()), sigma, *_coverage(along[long, axis], 1)])
    print("NES: error squared and normalised, mean, and its degrees of freedom; share of errors inside the ellipses\n")
    table(out)
    table(axes)


# Squared radii of the ellipses that hold 50, 90 and 95 % of a normal error, by degrees of freedom.
_RADII = {1: (0.4549, 2.7055, 3.8415), 2: (1.3863, 4.6052, 5.9915), 3: (2.3660, 6.2514, 7.8147)}


def _coverage(nes: NDArray[np.float64], freedom: int) -> list[object]:
    if not len(nes):
        return [math.nan, "none", "none", "none"]
    return [float(nes.mean()), *(share(nes <= r) for r in _RADII[freedom])]


def _errors(name: str, kind: str, seed: int, count: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Return errors (3,) and reported covariances (3, 3): scans of one run in a map of another at its true poses."""
    building = simulated_building(kind, seed)
    laser = Laser(beams=180, rate=2.0, max_range=10.0 if kind == "corridor" else 30.0)
    builder = MapBuilder(Lattice.named(name, 0.05), levels=1)
    for e in simulate(building, laser, OdometryNoise(rate=0.0), seed=seed):
        assert isinstance(e.event, Scan)
        builder.fuse(e.event, e.T_map_robot)
    matcher = GlobalMatcher.of_map(builder.build())
    events = list(simulate(building, laser, OdometryNoise(rate=0.0), seed=seed + 100, speed=0.37))
    rng = np.random.default_rng(seed)
    out = []
    for k in np.linspace(3, len(events) - 1, count).astype(int):
        true = events[k].T_map_robot
        centre = true.translation + rng.uniform(-0.1, 0.1, 2)
        region = SearchRegion(
            centre - 0.5, centre + 0.5, yaw=true.theta + rng.uniform(-0.05, 0.05), yaw_range=math.radians(20.0)
        )
        event = events[k].event
        assert isinstance(event, Scan)
        match = matcher.match(event.points, region, runner_up=None, beams=False)
        if match is not None and match.information is not None:
            off = [*(match.pose.translation - true.translation), wrap_angle(match.pose.theta - true.theta)]
            out.append((np.array(off), np.linalg.inv(match.information)))
    return out


# ---------------------------------------------------------------------- space, and the same bits


def levelled(points: NDArray[np.float64], true: Pose, rng: np.random.Generator) -> tuple[NDArray[np.float64], Pose]:
    """Turn a scan upright as an accelerometer would, but for some degrees, and its pose with it.

    The sensor in the hall is carried, and leans by up to 37 degrees; a search near gravity needs to be told of that.
    """
    up = true.rotation.T @ np.array([0.0, 0.0, 1.0])
    axis = np.cross(up, [0.0, 0.0, 1.0])
    sine = float(np.linalg.norm(axis))
    upright = exponential(axis / max(sine, 1e-12) * math.atan2(sine, float(up[2])))
    lean = rng.uniform(-1.0, 1.0, 2) * math.radians(LEAN)
    turn = exponential(np.array([*lean, 0.0])) @ upright
    return points @ turn.T, Pose(true.rotation @ turn.T, true.translation)


def tilted() -> SearchRegion:
    """Return the whole map, all yaws and tilts of up to 5 degrees."""
    return SearchRegion(tilt=math.radians(5.0))


def space(cache: Path, sizes: Sizes) -> None:
    """Print how LiDAR scans are found in the hall (figure 6)."""
    print(f"yaw all, tilt up to 5 degrees, limit {sizes.limit:g} s; ms: median / 95th percentile\n")
    for name in ("Z3", "D3", "D3*"):
        rows: list[list[object]] = [[
            "hall, 0.5 m", "cells", "points", "scans", "certified", "gap, median", "most", "in 0.5 m, 3 deg", "error m",
            "deg", "search CPU ms", "all CPU ms", "nodes", "MB", "build s",
        ]]  # fmt: skip
        world = hall_world(cache, Lattice.named(name, 0.5))
        begin = time.process_time()
        matcher = GlobalMatcher.of_map(world.map)
        build = time.process_time() - begin
        rng = np.random.default_rng(0)
        chosen = [levelled(points, true, rng) for points, true in world.some(sizes.space)]
        how: dict[str, Any] = {"region": tilted(), "time_limit": sizes.limit, "most_points": SPACE_POINTS}
        for points, _ in chosen:
            warm_up(matcher, points, **how)
        only = [look(matcher, p, t, runner_up=None, beams=False, information=False, **how) for p, t in chosen]
        full = [look(matcher, p, t, **how) for p, t in chosen]
        matches = [t.match for t in only if t.match is not None]
        gaps = [m.gap for m in matches]
        rows.append([
            name, len(world.map.state().occupied), int(np.median([len(p) for p, _ in chosen])), len(chosen),
            share([m.certified for m in matches]), float(np.median(gaps)), max(gaps),
            share([t.metres <= 0.5 and t.degrees <= 3.0 for t in only]), float(np.median([t.metres for t in only])),
            float(np.median([t.degrees for t in only])), spread([t.cpu for t in only]), spread([t.cpu for t in full]),
            int(np.median([m.nodes for m in matches])), matcher.pyramid.nbytes / 1e6, build,
        ])  # fmt: skip
        table(rows)


def _digests(cache: Path, numbers: Sequence[int]) -> list[str]:
    """Return what was found for some scans, to the last bit, as texts."""
    world = planar_world(cache, "intel", Lattice.named("A2", 0.05))
    matcher = GlobalMatcher.of_map(world.map)
    out = []
    for k in numbers:
        m = matcher.match(world.scans[k][0])
        found: list[object] = [None]
        if m is not None:
            second = m.runner_up
            found = [
                m.pose.matrix().tobytes(),
                m.searched.matrix().tobytes(),
                m.score,
                m.bound,
                m.nodes,
                m.overlap,
                m.contradicted,
            ]
            found += [None if m.information is None else m.information.tobytes(), m.runner_up_bound]
            found += [second and second.pose.matrix().tobytes(), second and second.score]
        out.append(repr(found))
    return out


def repeat(cache: Path, sizes: Sizes) -> None:
    """Print hashes of the results of three runs, in one process and in two (figure 7)."""
    count = len(planar_world(cache, "intel", Lattice.named("A2", 0.05)).scans)
    numbers = list(range(0, count, max(1, count // max(2, sizes.scans // 2))))
    rows: list[list[object]] = [["intel A2 0.05 m", "scans", "SHA-256 of all results"]]
    hashes = []
    for workers in (1, 2):
        for run in range(3):
            if workers == 1:
                found = _digests(cache, numbers)
            else:
                # Turn about, so that each process sees other scans before each of its own.
                parts = [numbers[k::workers] for k in range(workers)]
                with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
                    shares = list(pool.map(_digests, [cache] * workers, parts))
                found = [shares[i % workers][i // workers] for i in range(len(numbers))]
            hashes.append(hashlib.sha256("\n".join(found).encode()).hexdigest())
            rows.append([f"{workers} process{'es' if workers > 1 else ''}, run {run + 1}", len(found), hashes[-1][:32]])
    table(rows)
    print("the same bits\n" if len(set(hashes)) == 1 else "NOT the same bits\n")


FIGURES: dict[str, Callable[[Path, Sizes], None]] = {
    "find": find, "risk": risk, "compare": compare, "others": others, "calibration": calibration, "space": space,
    "repeat": repeat,
}  # fmt: skip


def main(arguments: list[str] | None = None) -> None:
    """Print the figures asked for."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.localisation", description="Figures of localisation."
    )
    parser.add_argument("--scans", type=int, default=40, help="of each map that are looked for")
    parser.add_argument("--foreign", type=int, default=60, help="scans of each other building, to choose on")
    parser.add_argument("--unseen", type=int, default=300, help="further ones of each, to count false accepts on")
    parser.add_argument("--space", type=int, default=6, help="scans of the hall, a lattice")
    parser.add_argument("--simulated", type=int, default=40, help="scans of each simulated building")
    parser.add_argument("--margin", type=float, default=0.05, help="below it a match is ambiguous")
    parser.add_argument("--limit", type=float, default=4.0, help="seconds after which a search gives up")

    def sizes(chosen: argparse.Namespace) -> Sizes:
        c = chosen
        return Sizes(c.scans, c.foreign, c.unseen, c.space, c.simulated, c.margin, c.limit)

    run_figures(parser, arguments, FIGURES, sizes, simulated=["calibration"])


if __name__ == "__main__":
    main()
