"""Figures 3 and 4 of mapping: the Intel log as a user maps it, relations on A2 and Z2, start-up.

Whole processes, so that what a user waits for is what is measured: imports, reading, matching,
fusing, writing. Skips what needs the shared data where it is absent.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hexmap.io.trajectories import read_relations, read_tum
from localisation.evaluation import evaluate_relations
from tests.benchmarks._common import data_folder, table, versions

SECONDS_OF_INTEL = 2691.0


def run(*arguments: object) -> float:
    """Run the program in a process of its own, on one thread; return the seconds it took."""
    environment = dict(os.environ, OMP_NUM_THREADS="1", NUMBA_NUM_THREADS="1")
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "hexmap", *map(str, arguments)], check=True, capture_output=True, env=environment
    )
    return time.perf_counter() - begin


def intel(folder: Path, repeats: int = 3) -> None:
    """Print time, memory and relations of the Intel log on A2 and on Z2 with the same settings."""
    rows: list[list[object]] = [
        ["intel.clf.gz", "m", "deg", "s", "times real time", "ms/scan", "peak MB"],
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
    """Print all tables."""
    print(versions("hexmap", "numpy", "numba", "pyarrow"), "\n")
    start()
    folder = data_folder() / "laser2d"
    if not folder.is_dir():
        print("the Intel log is left out: no shared data (set HEXMAP_DATA)")
        return
    intel(folder)


if __name__ == "__main__":
    main()
