"""Figures 3 and 4 of mapping: logs as a user maps them, relations on A2 and Z2, stages of a scan, start-up.

Whole processes, so that what a user waits for is what is measured: imports, reading, matching,
fusing, writing; the stages of a scan in a process of their own, without what the timers miss.
Seconds are those of the processor. Skips what needs the shared data where it is absent.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import read_relations, read_tum
from hexmap.maps.builder import MapBuilder
from hexmap.poses.scan import Scan
from localisation.evaluation import evaluate_relations
from localisation.mapping.build_map import build_map
from localisation.matching import local_matcher
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.occupancy import Occupancy
from localisation.odometry.motion import MotionPredictor
from tests.benchmarks._common import data_folder, table, versions

SECONDS_OF_INTEL = 2691.0


def run(*arguments: object) -> float:
    """Run the program in a process of its own, on one thread; return the seconds it took."""
    environment = dict(os.environ, OMP_NUM_THREADS="1", NUMBA_NUM_THREADS="1")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, "-m", "hexmap", *map(str, arguments)], check=True, capture_output=True, env=environment
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class Stopwatch:
    """Adds up the processor's seconds of some functions, which it puts itself around."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    def around(self, stage: str, owner: object, name: str) -> None:
        function = getattr(owner, name)
        self.seconds[stage] = 0.0

        def timed(*arguments, **options):
            begin = time.process_time()
            try:
                return function(*arguments, **options)
            finally:
                self.seconds[stage] += time.process_time() - begin

        setattr(owner, name, timed)


def stages(log: Path) -> None:
    """Print the milliseconds a scan of each stage, and the peak of this process."""
    watch = Stopwatch()
    watch.around("predict", MotionPredictor, "predict")
    watch.around("predict (wheels)", MotionPredictor, "observe")
    watch.around("search", LocalMatcher, "_search")
    watch.around("refine", local_matcher, "refine_on")
    watch.around("fuse", MapBuilder, "fuse")
    watch.around("follow", Occupancy, "change")
    watch.around("build", MapBuilder, "build")
    begin = time.process_time()
    scans = sum(isinstance(event, Scan) for event in open_log(log))
    watch.seconds["read"] = time.process_time() - begin
    begin = time.process_time()
    build_map(open_log(log))
    watch.seconds["all"] = time.process_time() - begin
    watch.seconds["fuse"] -= watch.seconds["follow"]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    names = list(watch.seconds)
    table([
        ["ms/scan", *names, "peak MB"],
        [log.name, *[1000 * watch.seconds[name] / scans for name in names], peak],
    ])  # fmt: skip


def intel(folder: Path, repeats: int = 3) -> None:
    """Print time, memory and relations of the Intel log on A2 and on Z2 with the same settings."""
    rows: list[list[object]] = [
        ["intel.clf.gz", "m", "deg", "processor s", "times real time", "ms/scan", "peak MB so far"],
    ]
    relations = read_relations(folder / "intel.relations")
    with tempfile.TemporaryDirectory() as work:
        for lattice in ("A2", "Z2"):
            out, way = Path(work) / "m.parquet", Path(work) / "t.tum"
            arguments = ("build", folder / "intel.clf.gz", "-o", out, "--lattice", lattice, "--trajectory", way)
            run(*arguments)
            seconds = sorted(run(*arguments) for _ in range(repeats))[repeats // 2]
            peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
            score = evaluate_relations(read_tum(way), relations)
            rows.append([
                lattice, score.translation.mean, score.rotation_deg.mean, seconds, SECONDS_OF_INTEL / seconds,
                1000 * seconds / 2726, peak,
            ])  # fmt: skip
    table(rows)


def start(repeats: int = 9) -> None:
    """Print the time of ``hexmap --help`` once warm."""
    run("--help")
    times = sorted(run("--help") for _ in range(repeats))
    table([["hexmap --help", "median s", "max s"], ["", times[repeats // 2], times[-1]]])


def main() -> None:
    """Print all tables; with a log as argument the stages of that one."""
    if len(sys.argv) > 1:
        stages(Path(sys.argv[1]))
        return
    print(versions("hexmap", "numpy", "numba", "pyarrow"), "\n")
    start()
    folder = data_folder() / "laser2d"
    if not folder.is_dir():
        print("the Intel log is left out: no shared data (set HEXMAP_DATA)")
        return
    intel(folder)
    for name in ("intel.clf.gz", "freiburg-campus.clf.gz"):
        # The second run: the first one may compile.
        for _ in range(2):
            subprocess.run([sys.executable, "-m", "tests.benchmarks.mapping", str(folder / name)], check=True)


if __name__ == "__main__":
    main()
