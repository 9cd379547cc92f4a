"""Figures of maps from LiDAR logs: a real hall, a sparse real log, simulated buildings with exact truth, the same bits.

    python -m tests.benchmarks.lidar [NAME ...] [--seeds N] [--first SEED] [--no-bare]

Names are hall, vlp16, places, question, simulated, bits; all without a name. One thread; seconds are the processor's.
What needs the shared data is left out where it is absent.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import wraps
from pathlib import Path
from typing import Any
from unittest.mock import patch

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_NUM_THREADS", "1")

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.io.lidar.lidar_log import LidarLog, LidarLogSettings
from hexmap.io.lidar.open_lidar import open_lidar
from hexmap.io.trajectories import read_tum
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import angles
from hexmap.poses.scan import Scan
from hexmap.poses.trajectory import Trajectory
from hexmap.simulator.space import RingLidar, make_building_3d, simulate_lidar
from localisation.evaluation import absolute_error
from localisation.lidar_settings import LidarSettings
from localisation.mapping.lidar_map import LidarMappingResult, build_lidar_map
from localisation.matching.surfaces import first_of_each_cell
from localisation.odometry.kiss import import_kiss_icp
from localisation.odometry.lidar_odometry import surface_lattice
from localisation.slam import spatial
from localisation.slam.lidar_slam import LidarSlam, LidarSlamResult
from tests.benchmarks._common import data_folder, table, versions
from tests.benchmarks.lidar_bits import bits
from tests.benchmarks.lidar_places import places
from tests.benchmarks.lidar_question import question
from tests.benchmarks.slam import build, reasons

# A point a cell of this size, metres, and scan: walls near the sensor must not outweigh the others.
_FINE = 0.05
_PATCH = 1.0
_PATCH_POINTS = 200
# A loop is false that is off by more than this, metres.
_FALSE = 0.5


# ---------------------------------------------------------------------- where the time goes


class Stages:
    """Seconds of the processor by stage, each without those of the stages that it calls."""

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self._inner: list[float] = []

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def call(*args: Any, **kwargs: Any) -> Any:
            self._inner.append(0.0)
            begin = time.process_time()
            try:
                return function(*args, **kwargs)
            finally:
                took = time.process_time() - begin
                self.seconds[name] += took - self._inner.pop()
                if self._inner:
                    self._inner[-1] += took

        return call

    @contextmanager
    def watching(self) -> Iterator[None]:
        """Time the parts of a build."""
        from hexmap.io.lidar.bag import LidarBag
        from hexmap.maps.builder import MapBuilder
        from localisation.mapping.lidar_map import _Drawing
        from localisation.matching.surfaces import SurfaceMap
        from localisation.slam.lidar_loops import LidarLoopCloser
        from localisation.slam.pose_graph import PoseGraph

        KissICP, _ = import_kiss_icp()
        parts = [
            ("reading", LidarBag, "_scan"), ("KISS-ICP", KissICP, "register_frame"), ("drawing", SurfaceMap, "draw"),
            ("surfaces", SurfaceMap, "_change"), ("last drawing", _Drawing, "touch"),
            ("loops", LidarLoopCloser, "look"),
            ("graph", PoseGraph, "optimise"), ("graph", PoseGraph, "optimise_robustly"),
            ("graph", PoseGraph, "relative_covariances"), ("fusing", MapBuilder, "fuse"),
            ("fusing", MapBuilder, "add_hits"), ("rest of registering", LidarSlam, "register"),
        ]  # fmt: skip
        with ExitStack() as stack:
            for name, kind, method in parts:
                stack.enter_context(patch.object(kind, method, self.timed(name, getattr(kind, method))))
            yield


# ---------------------------------------------------------------------- thickness of walls and floors


class Patches1m:
    """The same points under several sets of poses, in patches of a metre by where they are at the reference's."""

    def __init__(self, scans: Sequence[FloatArray], reference: Sequence[Pose]) -> None:
        lattice = Lattice.named("Z3", _FINE)
        self._points = [first_of_each_cell(points, lattice) for points in scans]
        placed = self._place(reference)
        cell = np.floor(placed / _PATCH).astype(np.int64)
        self._order = np.lexsort(cell.T)
        cell = cell[self._order]
        cut = np.flatnonzero(np.r_[True, (cell[1:] != cell[:-1]).any(axis=1)])
        self._patches = []
        for a, b in zip(cut.tolist(), np.r_[cut[1:], len(cell)].tolist(), strict=True):
            if b - a >= _PATCH_POINTS:
                values, axes = self._axes(placed[self._order[a:b]])
                # Flat, and wide in both directions.
                if values[0] < 0.05 * values[1] and values[1] > 0.03:
                    self._patches.append((a, b, abs(axes[2, 0])))

    def _place(self, poses: Sequence[Pose]) -> FloatArray:
        return np.concatenate([pose.apply(p) for pose, p in zip(poses, self._points, strict=True)])

    @staticmethod
    def _axes(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        values, axes = np.linalg.eigh(np.cov(points.T, bias=True))
        return values, axes

    @property
    def upright(self) -> np.ndarray:
        """(P,) 1 floor or ceiling, -1 wall, 0 neither."""
        up = np.array([p[2] for p in self._patches])
        return np.where(up > 0.9, 1, np.where(up < 0.3, -1, 0))

    def thickness(self, poses: Sequence[Pose]) -> FloatArray:
        """Return the median distance (P,) of each patch's points from the plane through them, metres."""
        placed = self._place(poses)[self._order]
        out = []
        for a, b, _ in self._patches:
            points = placed[a:b]
            _, axes = self._axes(points)
            out.append(float(np.median(np.abs((points - points.mean(axis=0)) @ axes[:, 0]))))
        return np.array(out)


def thickness_rows(patches: Patches1m, sets: dict[str, Sequence[Pose]], beside: Sequence[str]) -> list[list[object]]:
    """Return a table: median thickness in millimetres, of walls and floors, and the median ratio to other sets."""
    found = {name: patches.thickness(poses) for name, poses in sets.items()}
    upright = patches.upright
    rows: list[list[object]] = [
        ["thickness, mm", "all", "walls", "floors", *[f"x {name}" for name in beside]],
        ["patches", len(upright), int((upright < 0).sum()), int((upright > 0).sum()), *["" for _ in beside]],
    ]
    for name, values in found.items():
        parts = [
            1000.0 * float(np.median(part)) if len(part) else math.nan
            for part in (values, values[upright < 0], values[upright > 0])
        ]
        rows.append([name, *parts, *[float(np.median(values / found[other])) for other in beside]])
    return rows


# ---------------------------------------------------------------------- poses of others


def kiss_icp_alone(scans: Sequence[Scan], voxel: float | None) -> list[Pose]:
    """Return KISS-ICP's poses with its defaults (one thread, as it deskews), at its own voxels or others."""
    KissICP, KISSConfig = import_kiss_icp()
    config = KISSConfig()
    config.data.max_range = 100.0
    # What it takes itself where none is given.
    config.mapping.voxel_size = voxel or config.data.max_range / 100.0
    config.registration.max_num_threads = 1
    config.data.deskew = scans[0].times is not None
    kiss = KissICP(config)
    out = []
    for scan in scans:
        times = np.empty(0)
        if scan.times is not None:
            span = float(np.ptp(scan.times)) or 1.0
            times = (scan.times - scan.times.min()) / span
        kiss.register_frame(np.array(scan.points), times)
        out.append(Pose.from_matrix(kiss.last_pose))
    return out


def poses_of(result: LidarMappingResult) -> list[Pose]:
    return [result.poses[k] for k in range(len(result.poses))]


# ---------------------------------------------------------------------- the figures


def hall(folder: Path) -> None:
    """Print time, memory, distance to the reference and thickness of the hall."""
    log, reference = folder / "hall", read_tum(folder / "hall.reference.tum")
    rows: list[list[object]] = [["hall, whole commands", "CPU s", "scans/CPU s", "peak MB"]]
    with tempfile.TemporaryDirectory() as name:
        for options in ((), ("--no-free-space",), ("--no-loop-closure",)):
            best = min(build(log, Path(name), *options)[:2] for _ in range(2))
            rows.append([" ".join(["D3 0.1 m", *options]), best[0], len(reference) / best[0], best[1]])
            if not options:
                note = reasons(Path(name))
    table(rows)
    print(note, "\n")

    results, rows = {}, [["hall, by stage, CPU s a scan"]]
    for free in (True, False):
        stages = Stages()
        build_lidar_map(open_lidar(log), LidarSettings(free_space=free))
        with stages.watching():
            begin = time.process_time()
            results[free] = build_lidar_map(open_lidar(log), LidarSettings(free_space=free))
            total = time.process_time() - begin
        n = results[free].scans
        stages.seconds["other"] = total - sum(stages.seconds.values())
        if free:
            rows[0] += [*stages.seconds, "all", "scans/CPU s"]
            names = list(stages.seconds)
        seconds = [stages.seconds[k] / n for k in names]
        rows.append(["with free space" if free else "hits alone", *seconds, total / n, n / total])
    table(rows)

    scans = list(open_lidar(log))
    whole = results[True]
    bare = build_lidar_map(open_lidar(log), LidarSettings(free_space=False), close=False)
    _, voxel = surface_lattice(Lattice.named("D3", 0.1), scans[0].points)
    ours, mine, plain = "ours", "KISS-ICP, 1.0 m (default)", f"KISS-ICP, {voxel:g} m (our voxel)"
    sets: dict[str, Sequence[Pose]] = {
        "reference": [reference[k] for k in range(len(reference))],
        mine: kiss_icp_alone(scans, None),
        "KISS-ICP, 0.5 m": kiss_icp_alone(scans, 0.5),
        plain: kiss_icp_alone(scans, voxel),
        "ours without loop closure": poses_of(bare),
        ours: poses_of(whole),
    }
    rows = [["hall, to the reference", "rmse m", "mean m", "max m", "mean deg"]]
    for label, poses in sets.items():
        if label != "reference":
            error = absolute_error(reference, Trajectory.from_poses(reference.stamps.tolist(), poses), "order")
            t = error.translation
            rows.append([label, t.rmse, t.mean, t.max, error.rotation_deg.mean])
    table(rows)
    patches = Patches1m([scan.points for scan in scans], sets["reference"])
    table(thickness_rows(patches, sets, ("reference", mine, "KISS-ICP, 0.5 m")))
    print(f"matched {whole.matched}, unmatched {whole.unmatched}, missed {whole.missed}, "
          f"mean share {whole.mean_share:.3f}, {whole.metres:.1f} m\n")  # fmt: skip


def vlp16(folder: Path) -> None:
    """Print how far the sparse log's scans are apart, how many surfaces hold, and how thick its walls are."""
    log = folder / "vlp16"
    result = build_lidar_map(open_lidar(log), LidarSettings(free_space=False))
    scans = list(open_lidar(log))
    sets: dict[str, Sequence[Pose]] = {
        "KISS-ICP, 1.0 m (default)": kiss_icp_alone(scans, None),
        "KISS-ICP, 0.5 m": kiss_icp_alone(scans, 0.5),
    }
    rows: list[list[object]] = [
        ["vlp16, steps between scans", "median m", "max m", "median deg", "max deg", "length m"]
    ]
    for label, poses in {**sets, "ours": poses_of(result)}.items():
        steps = [a.inverse() @ b for a, b in itertools.pairwise(poses)]
        metres = np.array([float(np.linalg.norm(s.translation)) for s in steps])
        degrees = np.degrees(angles(np.array([s.rotation for s in steps])))
        rows.append(
            [label, *[float(f(v)) for v in (metres, degrees) for f in (np.median, np.max)], float(metres.sum())]
        )
    table(rows)
    total = result.matched + result.unmatched + result.missed
    print(f"{len(scans)} scans: {result.matched} of {total} held, {result.unmatched} unmatched, "
          f"{result.missed} missed; mean share on surfaces {result.mean_share:.3f}\n")  # fmt: skip
    used = np.isin([s.stamp for s in scans], result.poses.stamps)
    kept = [scan.points for scan, use in zip(scans, used, strict=True) if use]
    sets = {k: [p for p, use in zip(v, used, strict=True) if use] for k, v in sets.items()}
    sets["ours"] = poses_of(result)
    rows = []
    # There is no reference: each set of poses takes its turn at saying which points are a patch.
    for label in sets:
        found = thickness_rows(Patches1m(kept, sets[label]), sets, ("KISS-ICP, 1.0 m (default)",))
        found[0][0] = f"thickness, mm; patches of {label}"
        table(found)


class SimulatedLog(LidarLog):
    """A simulated drive through a building of several floors, as a log."""

    format = "simulated"

    def __init__(self, seed: int, lidar: RingLidar | None = None, scans: int | None = None) -> None:
        super().__init__(Path(f"warehouse3d-{seed}"), LidarLogSettings(), 1)
        self._seed, self._lidar, self._scans = seed, lidar, scans
        self.truth: list[Pose] = []

    def _read(self) -> Iterator[Scan]:
        self.truth = []
        building = make_building_3d("warehouse3d", seed=self._seed)
        for simulated in simulate_lidar(building, lidar=self._lidar, seed=self._seed, scans=self._scans):
            self.truth.append(simulated.T_map_lidar)
            yield simulated.scan

    def _no_scan(self) -> str:
        return f"{self.path}: no scan"


def _errors(truth: FloatArray, result: LidarSlamResult) -> FloatArray:
    """Return the small motions (N, 6) from the true poses, seen from the first, to those found."""
    first = np.broadcast_to(truth[0], truth.shape)
    return spatial.small(spatial.between(spatial.between(first, truth), result.poses))


def _coverage(errors: FloatArray, covariances: FloatArray) -> tuple[float, float]:
    """Return the share of poses within their 95 % ellipsoid, and the mean normalised squared error a degree of freedom.

    Poses that a node without any uncertainty holds, those of the first submap, say nothing.
    """
    from scipy.stats import chi2

    known = covariances[:, 0, 0] > 1e-9
    if not known.any():
        return math.nan, math.nan
    off = errors[known]
    squares = np.einsum("ni,ni->n", off, np.linalg.solve(covariances[known], off[..., None])[..., 0])
    return float((squares < chi2.ppf(0.95, 6)).mean()), float(squares.mean() / 6.0)


def _floors(truth: FloatArray, poses: FloatArray) -> float:
    """Return by how much the height between places of two floors, one above the other, is off at most, metres."""
    place = truth[:, 9:]
    level = spatial.compose(np.broadcast_to(truth[0], poses.shape), poses)[:, 9:]
    some = np.linspace(0, len(place) - 1, min(len(place), 400)).astype(np.int64)
    a, b = np.triu_indices(len(some), 1)
    a, b = some[a], some[b]
    above = (np.hypot(*(place[a, :2] - place[b, :2]).T) < 1.0) & (np.abs(place[a, 2] - place[b, 2]) > 2.0)
    if not above.any():
        return math.nan
    off = (level[a, 2] - level[b, 2]) - (place[a, 2] - place[b, 2])
    return float(np.abs(off[above]).max())


def _false_loops(truth: FloatArray, result: LidarSlamResult) -> tuple[int, int]:
    """Return how many loops were accepted, and how many of those are false."""
    accepted = false = 0
    for record in result.records:
        if record.accepted:
            i, j = result.node_scans[record.i], result.node_scans[record.j]
            off = spatial.small(spatial.between(spatial.between(truth[i], truth[j]), np.array(record.pose)))
            accepted += 1
            false += int(np.linalg.norm(off[:3]) > _FALSE)
    return accepted, false


def simulated(seeds: Sequence[int], bare: bool = True) -> None:
    """Print the error of simulated drives with and without loop closure, a line a drive as soon as it is done."""
    print("simulated: warehouse3d, 32 rings, 1024 azimuths, 5 Hz\n")
    print("seed  loops  scans  metres   mean m    max m  mean deg  tried  accepted  false  in 95 %  nees/6  "
          "floors m  held  unheld  missed   CPU s")  # fmt: skip
    for seed in seeds:
        for close in (True, False) if bare else (True,):
            begin = time.process_time()
            slam, log = LidarSlam(LidarSettings(), close=close), SimulatedLog(seed)
            used = []
            for number, scan in enumerate(log):
                if not slam.register(scan).missed:
                    used.append(number)
            result = slam.finish()
            seconds = time.process_time() - begin
            truth = np.array([spatial.of_pose(pose) for pose in log.truth])[used]
            errors = _errors(truth, result)
            metres = np.linalg.norm(errors[:, :3], axis=1)
            degrees = np.degrees(np.linalg.norm(errors[:, 3:], axis=1))
            length = float(np.linalg.norm(np.diff(truth[:, 9:], axis=0), axis=1).sum())
            accepted, false = _false_loops(truth, result)
            inside, nees = _coverage(errors, result.covariances)
            floors = _floors(truth, result.poses)
            print(f"{seed:4d}  {'yes' if close else 'no':>5}  {len(truth):5d}  {length:6.1f}  {metres.mean():7.4f}  "
                  f"{metres.max():7.4f}  {degrees.mean():8.4f}  {len(result.records):5d}  {accepted:8d}  {false:5d}  "
                  f"{inside:7.3f}  {nees:6.2f}  {floors:8.4f}  {slam.matched:4d}  {slam.unmatched:6d}  "
                  f"{slam.missed:6d}  {seconds:6.0f}", flush=True)  # fmt: skip
            if close:
                print(
                    "      " + ", ".join(f"{c} {r}" for r, c in Counter(r.reason for r in result.records).most_common())
                )
    print()


def main(arguments: list[str]) -> None:
    """Print the tables that are asked for, or all."""
    parser = argparse.ArgumentParser(description="figures of maps from LiDAR logs")
    parser.add_argument("names", nargs="*", help="tables; all without a name")
    parser.add_argument("--seeds", type=int, default=10, help="simulated buildings")
    parser.add_argument("--first", type=int, default=0, help="the first one's seed")
    parser.add_argument("--no-bare", action="store_true", help="simulated drives with loop closure only")
    chosen = parser.parse_args(arguments)
    print(versions("hexmap", "numpy", "numba", "gtsam", "kiss-icp"), "\n")
    folder = data_folder() / "lidar3d"
    of_logs: dict[str, Callable[[Path], None]] = {
        "hall": hall, "vlp16": vlp16, "places": places, "question": question, "bits": bits,
    }  # fmt: skip
    for name in chosen.names or [*of_logs, "simulated"]:
        if name == "simulated":
            simulated(range(chosen.first, chosen.first + chosen.seeds), not chosen.no_bare)
        elif name not in of_logs:
            parser.error(f"no table is called {name}: {', '.join([*of_logs, 'simulated'])}")
        elif not folder.is_dir():
            print(f"{name} is left out: no shared data (set HEXMAP_DATA)")
        else:
            of_logs[name](folder)


if __name__ == "__main__":
    main(sys.argv[1:])
