"""Figures 1 to 5 and 7 of closing loops: real logs, simulated truth, poor odometry, the optimiser, the same bits.

    python -m tests.benchmarks.slam [NAME ...] [--seeds N]

Names are intel, aces, csail, belgioioso, campus, agreement (of overlapping passes, see agreement.py), poor, bits,
simulated (ten buildings by so many seeds), large (one of 230 x 200 m), optimiser; all without a name.

Whole commands in processes of their own, on one thread; seconds are the processor's. What needs the shared data is left
out where it is absent.
"""

from __future__ import annotations

import argparse
import csv
import gzip
import math
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import read_relations, read_tum
from hexmap.poses.scan import Scan
from hexmap.poses.trajectory import Trajectory
from localisation.evaluation import absolute_error, evaluate_relations
from localisation.settings import MappingSettings, make_mount
from localisation.slam import planar
from localisation.slam.pose_graph import Edge, PoseGraph
from tests.benchmarks._common import data_folder, table, versions
from tests.benchmarks.agreement import agreement
from tests.benchmarks.buildings import KINDS
from tests.benchmarks.simulated_slam import large_building, simulated

LOGS = {
    "intel": "intel",
    "aces": "aces",
    "csail": "mit-csail",
    "belgioioso": "belgioioso",
    "campus": "freiburg-campus",
}
SECONDS_OF_INTEL = 2691.0
_POOR = {
    "intel": "relations by nearest stamps, m",
    "aces": "rmse to the particle filter, m",
    "csail": "rmse to the map of the whole log, m",
}


def build(log: Path, work: Path, *options: str) -> tuple[float, float, str]:
    """Map a log as a user does; returns the processor's seconds, the peak in MB, and what was said."""
    environment = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", NUMBA_NUM_THREADS="1")
    program = (
        "import resource, subprocess, sys; r = subprocess.run(sys.argv[1:]); u = resource.getrusage("
        "resource.RUSAGE_CHILDREN); print('measured', u.ru_utime + u.ru_stime, u.ru_maxrss / 1024); "
        "sys.exit(r.returncode)"
    )
    arguments = [
        *("build", str(log), "-o", str(work / "m.parquet"), "--trajectory", str(work / "t.tum")),
        *(("--loops", str(work / "l.csv")) if "--no-loop-closure" not in options else ()),
        *options,
    ]
    command = [sys.executable, "-c", program, sys.executable, "-m", "hexmap", *arguments]
    said = subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout
    _, seconds, peak = said.strip().splitlines()[-1].split()
    return float(seconds), float(peak), said


def reasons(work: Path) -> str:
    """Return how many loops were accepted and rejected, by the reason."""
    with (work / "l.csv").open() as handle:
        counts = Counter(row["reason"] for row in csv.DictReader(handle))
    return ", ".join(f"{count} {reason}" for reason, count in counts.most_common())


def frozen_relations(folder: Path, poses: FloatArray) -> FloatArray:
    """Return the errors (N, 3) of Intel's relations by its frozen association: metres, degrees, seconds apart."""
    rows, i, j = np.loadtxt(folder / "intel.association.csv", delimiter=",", dtype=np.int64).T
    relations = read_relations(folder / "intel.relations")
    found = planar.between(poses[i], poses[j])
    turn = np.arctan2(relations.rotations[rows, 1, 0], relations.rotations[rows, 0, 0])
    off = np.hypot(*(found[:, :2] - relations.translations[rows, :2]).T)
    turned = np.degrees(np.abs((found[:, 2] - turn + math.pi) % (2.0 * math.pi) - math.pi))
    return np.column_stack([off, turned, np.abs(relations.to_stamps[rows] - relations.from_stamps[rows])])


def intel(folder: Path) -> None:
    """Print relations, time and memory of the Intel log, with and without loops, on A2 and Z2."""
    rows: list[list[object]] = [
        ["Intel", "m", "deg", "m >60 s", "deg >60 s", "nearest m", "deg", "CPU s", "x real time", "peak MB"],
    ]
    notes = []
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        for lattice in ("A2", "Z2"):
            for options in ((), ("--no-loop-closure",)):
                best = min(build(folder / "intel.clf.gz", work, "--lattice", lattice, *options)[:2] for _ in range(2))
                way = read_tum(work / "t.tum")
                errors = frozen_relations(folder, np.array([planar.of_pose(pose) for pose in way]))
                far = errors[errors[:, 2] > 60.0]
                score = evaluate_relations(way, read_relations(folder / "intel.relations"))
                means = [*errors[:, :2].mean(axis=0).tolist(), *far[:, :2].mean(axis=0).tolist()]
                rows.append([
                    " ".join([lattice, *options]), *means,
                    score.translation.mean, score.rotation_deg.mean, best[0], SECONDS_OF_INTEL / best[0], best[1],
                ])  # fmt: skip
                if not options:
                    notes.append(f"{lattice}: {reasons(work)}")
    table(rows)
    print("\n".join(notes), "\n")


def other_log(name: str, folder: Path) -> None:
    """Print a log's distance to the particle filter's poses, with and without loops, and its loops."""
    rows: list[list[object]] = [[name, "rmse m", "mean m", "max m", "mean deg", "CPU s", "peak MB"]]
    log, reference = folder / f"{LOGS[name]}.clf.gz", folder / f"{LOGS[name]}.rbpf.tum"
    with tempfile.TemporaryDirectory() as work_name:
        work = Path(work_name)
        for options in ((), ("--no-loop-closure",)):
            seconds, peak, _ = build(log, work, "--trajectory-of", "scans", *options)
            row: list[object] = ["without loops" if options else "loops", "-", "-", "-", "-", seconds, peak]
            if reference.is_file():
                error = absolute_error(read_tum(reference), read_tum(work / "t.tum"), "order")
                t = error.translation
                row[1:5] = [t.rmse, t.mean, t.max, error.rotation_deg.mean]
            rows.append(row)
            if not options:
                note = reasons(work)
    table(rows)
    print(note, "\n")


def passes(folder: Path) -> None:
    """Print how well overlapping passes agree, with and without loops and at the particle filter's poses."""
    rows: list[list[object]] = [["mean distance of a pass to the others, m (share that overlaps)", "loops",
                                 "without loops", "particle filter"]]  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        for log in LOGS:
            source, reference = folder / f"{LOGS[log]}.clf.gz", folder / f"{LOGS[log]}.rbpf.tum"
            row: list[object] = [log]
            for options in ((), ("--no-loop-closure",)):
                build(source, work, "--trajectory-of", "scans", *options)
                row.append(_agreement(source, read_tum(work / "t.tum")))
            row.append(_agreement(source, read_tum(reference)) if reference.is_file() else "-")
            rows.append(row)
    table(rows)


def _agreement(source: Path, way: Trajectory) -> str:
    """Return how well overlapping passes of a log agree where the robot was at these poses, one a scan."""
    log, settings = open_log(source), MappingSettings()
    scans = [event.points for event in log if isinstance(event, Scan)]
    mount = make_mount(settings, log.mount)
    off, share = agreement(scans, [pose @ mount for pose in way])
    return f"{off:.4f} ({share:.0%})"


def poor(folder: Path, logs: tuple[str, ...] = ("intel", "aces", "csail")) -> None:
    """Print how far logs come with odometry thrown away, ten times worse, and with every second scan missing."""
    rows: list[list[object]] = [["poor input", "odometry", "none", "ten times worse", "every second scan"]]
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        for log in logs:
            source = folder / f"{LOGS[log]}.clf.gz"
            worse, fewer = work / "worse.clf", work / "fewer.clf"
            _spoil(source, worse, 10.0, 1)
            _spoil(source, fewer, 1.0, 2)
            row: list[object] = [f"{log}: {_POOR[log]}"]
            agrees: list[object] = [f"{log}: passes agree, m"]
            # Nobody knows where the robot was in CSAIL: there the log as it is must do.
            whole = read_tum(folder / "aces.rbpf.tum") if log == "aces" else None
            for path, options in ((source, ()), (source, ("--no-odometry",)), (worse, ()), (fewer, ())):
                build(path, work, "--trajectory-of", "all" if log == "intel" else "scans", *options)
                way = read_tum(work / "t.tum")
                if log == "intel":
                    relations = read_relations(folder / "intel.relations")
                    row.append(evaluate_relations(way, relations).translation.mean)
                    continue
                whole = whole or way
                reference = whole[1::2] if path == fewer else whole
                row.append(absolute_error(reference, way, "order").translation.rmse)
                agrees.append(_agreement(path, way))
            rows += [row] if log == "intel" else [row, agrees]
    table(rows)


def _spoil(source: Path, target: Path, worse: float, every: int) -> None:
    """Write a CARMEN log again with more noise on the odometry's increments, and only every so many scans."""
    rng = np.random.default_rng(0)

    last: FloatArray | None = None
    at = np.zeros(3)
    scans = 0
    with gzip.open(source, "rt") as lines, target.open("w") as out:
        for line in lines:
            words = line.split()
            if not words or words[0] not in ("FLASER", "ODOM"):
                continue
            first = 1 if words[0] == "ODOM" else 5 + int(words[1])
            now = np.array([float(v) for v in words[first : first + 3]])
            if last is not None:
                step = planar.between(last, now)
                # The noise of a wheel is some hundredths of what it turns: so many times as much of it.
                size = 0.02 * (worse - 1.0) * np.array([math.hypot(step[0], step[1])] * 2 + [abs(step[2])])
                at = planar.compose(at, step + size * rng.standard_normal(3))
            last = now
            words[first : first + 3] = [f"{v:.6f}" for v in at]
            if words[0] == "FLASER":
                words[first - 3 : first] = words[first : first + 3]
                scans += 1
                if scans % every:
                    continue
            out.write(" ".join(words) + "\n")


def optimiser(sizes: tuple[int, ...] = (100, 300, 1000, 3000, 10000)) -> None:
    """Print seconds and memory of the optimiser on a drive around a square: a loop every lap, one in ten false."""
    rows: list[list[object]] = [["nodes", "loops", "false", "kept false", "lost true", "LM s", "GNC s", "marginals s",
                                 "peak MB"]]  # fmt: skip
    sigmas = np.array([0.02, 0.02, 0.004])
    for count in sizes:
        rng = np.random.default_rng(count)
        graph, true = PoseGraph(), [np.zeros(3)]
        graph.add_node(true[0])
        step = np.array([4.0, 0.0, 2.0 * math.pi / 50.0])
        for k in range(count - 1):
            true.append(planar.compose(true[-1], step))
            motion = planar.compose(step, sigmas * rng.standard_normal(3))
            graph.add_node(planar.compose(graph.pose(k), motion))
            graph.add_edge(Edge(k, k + 1, motion, np.diag(sigmas**2)))
        false = set()
        for k in range(50, count, 5):
            seen = planar.compose(planar.between(true[k - 50], true[k]), 0.5 * sigmas * rng.standard_normal(3))
            if k % 50 == 45:
                seen = planar.compose(seen, np.array([2.0, 1.0, 0.3]))
            number = graph.add_edge(Edge(k - 50, k, seen, np.diag((0.5 * sigmas) ** 2), loop=True))
            if k % 50 == 45:
                false.add(number)
        loops = {e for e, edge in enumerate(graph.edges) if edge.loop}
        begin = time.process_time()
        graph.optimise()
        middle = time.process_time()
        out = set(graph.optimise_robustly())
        end = time.process_time()
        graph.relative_covariances(count - 1, list(range(0, count, max(1, count // 24))))
        last = time.process_time()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append([count, len(loops), len(false), len(false - out), len(out - false), middle - begin, end - middle,
                     last - end, peak])  # fmt: skip
    table(rows)


def bits(folder: Path, runs: int = 3) -> None:
    """Say whether three runs give the same trajectory and the same map, bit for bit."""
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        contents = set()
        for _ in range(runs):
            build(folder / "belgioioso.clf.gz", work)
            contents.add(((work / "t.tum").read_bytes(), (work / "m.parquet").read_bytes()))
    print(f"{runs} runs of Belgioioso: {len(contents)} different results\n")


def main(arguments: list[str]) -> None:
    """Print the tables that are asked for, or all."""
    parser = argparse.ArgumentParser(description="figures of maps whose loops are closed")
    parser.add_argument("names", nargs="*", help="tables; all without a name")
    parser.add_argument("--seeds", type=int, default=20, help="of each simulated building")
    parser.add_argument("--kinds", nargs="*", default=KINDS, help="simulated buildings")
    chosen = parser.parse_args(arguments)
    print(versions("hexmap", "numpy", "numba", "gtsam"), "\n")
    folder = data_folder() / "laser2d"
    free: dict[str, Callable[[], None]] = {
        "simulated": lambda: simulated(chosen.seeds, tuple(chosen.kinds)),
        "large": large_building,
        "optimiser": optimiser,
    }
    of_logs: dict[str, Callable[[Path], None]] = {
        "intel": intel,
        **{name: partial(other_log, name) for name in LOGS if name != "intel"},
        "agreement": passes,
        "poor": poor,
        "bits": bits,
    }
    for name in chosen.names or [*of_logs, *free]:
        if name in free:
            free[name]()
        elif name not in of_logs:
            parser.error(f"no table is called {name}: {', '.join([*of_logs, *free])}")
        elif not folder.is_dir():
            print(f"{name} is left out: no shared data (set HEXMAP_DATA)")
        else:
            of_logs[name](folder)


if __name__ == "__main__":
    main(sys.argv[1:])
