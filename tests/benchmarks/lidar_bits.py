"""The same bits: maps of LiDAR logs built several times, in one worker and in two, beside other processes."""

from __future__ import annotations

import hashlib
import itertools
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from hexmap.io.lidar.open_lidar import open_lidar
from tests.benchmarks._common import table
from tests.benchmarks.slam import build


def short(log: Path, scans: int, folder: Path) -> Path:
    """Write the first scans of a log as a folder of arrays."""
    folder.mkdir()
    for k, scan in enumerate(itertools.islice(open_lidar(log), scans)):
        np.save(folder / f"{k:06d}.npy", scan.points)
    return folder


def digest_of(work: Path) -> str:
    """Return a digest of a map and all that was written beside it."""
    digest = hashlib.sha256()
    for part in ("m.parquet", "t.tum", "l.csv"):
        digest.update((work / part).read_bytes())
    return digest.hexdigest()


def built(log: Path, options: Sequence[str]) -> str:
    """Build in a folder of its own and return the digest; what a worker does."""
    with tempfile.TemporaryDirectory() as work:
        build(log, Path(work), *options)
        return digest_of(Path(work))


def bits(folder: Path, runs: int = 3, logs: Sequence[str] = ("vlp16", "hall"), scans: int = 6) -> None:
    """Say whether runs give the same map, trajectory and loops: alone, in 1 and 2 workers, beside other processes.

    The first scans of each log only, with free space and without.
    """
    busy = [sys.executable, "-c", "while True: sum(range(1000))"]
    rows: list[list[object]] = [[f"first {scans} scans", "free space", "builds", "different results", "digest"]]
    with tempfile.TemporaryDirectory() as name:
        for log in logs:
            some = short(folder / log, scans, Path(name) / log)
            for options in ((), ("--no-free-space",)):
                found = [built(some, options) for _ in range(runs)]
                for workers in (1, 2):
                    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
                        found += pool.map(built, [some] * 2, [options] * 2)
                with ExitStack() as stack:
                    for _ in range(2):
                        process = stack.enter_context(subprocess.Popen(busy))
                        stack.callback(process.kill)
                    found.append(built(some, options))
                rows.append([log, "no" if options else "yes", len(found), len(set(found)), found[0][:12]])
    table(rows)
    print(f"{runs} builds alone, 2 in one worker, 2 in two workers at once, 1 beside 2 busy processes\n")
