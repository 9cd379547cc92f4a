"""Merging maps larger than memory, and fleets of logs; being killed in the middle of it is in :mod:`.kills`.

    python -m tests.benchmarks.scale merge FOLDER --rows 1e7 1e8 --workers 1 2 [--duckdb PYTHON]
    python -m tests.benchmarks.scale fleet FOLDER --logs 100 --duration 60 --repeats 2

FOLDER takes the made maps and logs and is left as it is. The memory of a merge is the largest sum that was seen of the
resident sets of the command and its workers. DuckDB is run by the Python that is named, on the same files, with two
threads, writing one sorted Parquet file of the sums.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from hexmap.io.map_file import MapWriter, describe
from hexmap.io.map_folder import MapFolder
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from tests.observing import children

ONE_THREAD = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
MAPS = 10
KEPT = 0.96  # of the cells of the area that each map has
TILE = 25.6
DUCKDB = """
import sys, time, resource, duckdb
c = duckdb.connect(); c.execute("set threads=2"); c.execute("set enable_progress_bar=false")
c.execute("set memory_limit='2GB'")
c.execute(f"set temp_directory='{sys.argv[2]}.tmp'")
t = time.perf_counter()
c.execute(f"copy (select level,a,b,sum(hits)::bigint hits,sum(passes)::bigint passes from '{sys.argv[1]}' "
          f"group by level,a,b order by level,a,b) to '{sys.argv[2]}' (format parquet, compression zstd)")
u = resource.getrusage(resource.RUSAGE_SELF)
print(time.perf_counter() - t, u.ru_utime + u.ru_stime, u.ru_maxrss)
"""


def make_maps(folder: Path, rows: int) -> list[Path]:
    """Write ten maps of one square area, ``rows`` in all, a strip of the area at a time."""
    folder.mkdir(parents=True, exist_ok=True)
    lattice = Lattice.named("A2", 0.05)
    side = int(np.sqrt(rows / MAPS / KEPT))
    nothing = VoxelList.empty(lattice)
    paths = []
    for k in range(MAPS):
        path = folder / f"made-{k}.parquet"
        paths.append(path)
        if path.exists():
            continue
        header = describe(Map([Level(nothing, nothing)], "map", [f"made {k}"]))
        rng = np.random.default_rng([rows, k])
        wide = max(1, (1 << 20) // side)
        with open(path.with_suffix(".part"), "wb") as handle, MapWriter(handle, header, 2) as writer:
            for a in range(0, side, wide):
                high = min(wide, side - a)
                flat = np.flatnonzero(rng.random(high * side) < KEPT)
                i, j = np.divmod(flat, side)
                hits = rng.integers(0, 4, len(flat)) * (rng.random(len(flat)) < 0.2)
                passes = rng.integers(1, 30, len(flat))
                zero = np.zeros(len(flat), np.int32)
                writer.write_columns([zero, (i + a).astype(np.int32), j.astype(np.int32), hits, passes])
        path.with_suffix(".part").rename(path)
    return paths


def measured(command: list[str]) -> tuple[float, float, float]:
    """Run a command; returns its seconds, those of the processor, and the memory, GB, both with its workers."""
    before = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    most, over = [0], threading.Event()

    def watch() -> None:
        while not over.wait(0.1):
            most[0] = max(most[0], sum(resident(pid) for pid in (process.pid, *children(process.pid))))

    watcher = threading.Thread(target=watch)
    watcher.start()
    _, status, usage = os.wait4(process.pid, 0)
    took = time.perf_counter() - before
    over.set()
    watcher.join()
    if status:
        raise SystemExit(f"{' '.join(command[:4])} ended with {status}")
    return took, usage.ru_utime + usage.ru_stime, most[0] / 1e9


def resident(pid: int) -> int:
    """Return the bytes that a process has in memory, 0 where it is gone."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, IndexError):
        return 0


def merge(options: argparse.Namespace) -> None:
    """Time merging at several sizes."""
    for text in options.rows:
        rows = int(float(text))
        folder = options.folder / f"rows-{text}"
        paths = make_maps(folder, rows)
        size = sum(path.stat().st_size for path in paths) / 1e6
        total = sum(read_rows(path) for path in paths)
        for workers in options.workers:
            out = folder / f"all-{workers}"
            command = [sys.executable, "-m", "hexmap", "merge", *map(str, paths), "-o", str(out), "--tiles", str(TILE)]
            seconds, cpu, memory = measured([*command, "--workers", workers])
            made = MapFolder.open(out)
            print(
                f"hexmap, {workers} workers: {total:,} rows ({size:,.0f} MB) into {made.rows:,} in {len(made.tiles)} "
                f"tiles: {seconds:.1f} s, {1e9 * seconds / total:.0f} ns a row; {cpu:.1f} s of a processor; "
                f"{memory:.2f} GB"
            )
        if options.duckdb:
            pattern, one = str(folder / "made-*.parquet"), str(folder / "duckdb.parquet")
            done = subprocess.run(
                [options.duckdb, "-c", DUCKDB, pattern, one], capture_output=True, text=True, check=False
            )
            if done.returncode:
                print(f"DuckDB: {done.stderr.strip().splitlines()[-1]}")
                continue
            took, cpu, peak = map(float, done.stdout.split()[-3:])
            print(
                f"DuckDB: the same: {took:.1f} s, {1e9 * took / total:.0f} ns a row; {cpu:.1f} s of a processor; "
                f"{peak / 1e6:.2f} GB"
            )


def read_rows(path: Path) -> int:
    import pyarrow.parquet as pq

    return int(pq.read_metadata(path).num_rows)


def fleet(options: argparse.Namespace) -> None:
    """Time a fleet of simulated logs with one worker and with two, in turn, each of one thread."""
    logs = options.folder / "logs"
    logs.mkdir(parents=True, exist_ok=True)
    paths = [logs / f"office-{k:03d}.clf.gz" for k in range(options.logs)]
    hexmap = [sys.executable, "-m", "hexmap"]
    for k, path in enumerate(paths):
        if not path.exists():
            duration = ["--duration", str(options.duration)]
            subprocess.run(
                [*hexmap, "simulate", "office", "-o", str(path), "--seed", str(k), *duration], check=True,
                stdout=subprocess.DEVNULL,
            )  # fmt: skip
    # As the workers have by themselves: one worker maps in the process of the command, whose threads it would use.
    os.environ.update(dict.fromkeys(ONE_THREAD, "1"))
    # The first process of all compiles the kernels.
    measured([*hexmap, "build", str(paths[0]), "-o", str(options.folder / "first.parquet")])
    seconds: dict[int, list[float]] = {1: [], 2: []}
    contents = {}
    for number in range(2 * options.repeats):
        workers = 1 + number % 2
        out = options.folder / f"maps-{workers}"
        shutil.rmtree(out, ignore_errors=True)
        took, cpu, _ = measured(
            [*hexmap, "build", "--fleet", *map(str, paths), "-o", str(out), "--workers", str(workers)]
        )
        seconds[workers].append(took)
        contents[workers] = [path.read_bytes() for path in sorted(out.glob("*.parquet"))]
        what = f"{len(paths)} logs of {options.duration:g} s, {workers} workers"
        print(f"{what}: {took:.1f} s, {cpu:.1f} s of a processor")
    print(f"two workers: {min(seconds[1]) / min(seconds[2]):.2f} times as fast as one, by the least times")
    print("the same bits" if contents[1] == contents[2] and len(contents[1]) == len(paths) else "DIFFERENT BITS")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("merge", "fleet"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rows", nargs="+", default=["1e7", "1e8"])
    parser.add_argument("--workers", nargs="+", default=["1", "2"])
    parser.add_argument("--duckdb", default="")
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    {"merge": merge, "fleet": fleet}[options.what](options)


if __name__ == "__main__":
    main()
