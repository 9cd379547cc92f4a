"""Merging maps larger than memory, fleets of logs, and being killed in the middle of it.

    python -m tests.benchmarks.scale merge FOLDER --rows 1e7 1e8 [--duckdb PYTHON]
    python -m tests.benchmarks.scale fleet FOLDER --logs 8 --duration 60
    python -m tests.benchmarks.scale kill FOLDER --times 10

FOLDER takes the made maps and logs and is left as it is. Each merge runs in a process of its own, whose peak memory is
its largest resident set. DuckDB is run by the Python that is named, on the same files, with two threads, writing one
sorted Parquet file of the sums.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from hexmap.io.map_file import MapWriter, describe
from hexmap.io.map_folder import MapFolder
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList

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
    """Run a command; returns its seconds, those of the processor (and of its children), and the peak memory, GB."""
    before = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(command[:4])} ended with {status}")
    return time.perf_counter() - before, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1e6


def merge(options: argparse.Namespace) -> None:
    """Time merging at several sizes."""
    for text in options.rows:
        rows = int(float(text))
        folder = options.folder / f"rows-{text}"
        paths = make_maps(folder, rows)
        size = sum(path.stat().st_size for path in paths) / 1e6
        out = folder / "all"
        command = [sys.executable, "-m", "hexmap", "merge", *map(str, paths), "-o", str(out), "--tiles", str(TILE)]
        seconds, cpu, memory = measured(command)
        made = MapFolder.open(out)
        total = sum(read_rows(path) for path in paths)
        print(
            f"hexmap: {total:,} rows ({size:,.0f} MB) into {made.rows:,} in {len(made.tiles)} tiles: {seconds:.1f} s, "
            f"{1e9 * seconds / total:.0f} ns a row; {cpu:.1f} s of a processor; {memory:.2f} GB"
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
    """Time a fleet of simulated logs with one worker and with two."""
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
    contents = {}
    for workers in (1, 2):
        out = options.folder / f"maps-{workers}"
        for old in out.glob("*.parquet"):
            old.unlink()
        seconds, cpu, _ = measured(
            [*hexmap, "build", "--fleet", *map(str, paths), "-o", str(out), "--workers", str(workers)]
        )
        contents[workers] = [path.read_bytes() for path in sorted(out.glob("*.parquet"))]
        what = f"{len(paths)} logs of {options.duration:g} s, {workers} workers"
        print(f"{what}: {seconds:.1f} s, {cpu:.1f} s of a processor")
    print("the same bits" if contents[1] == contents[2] else "DIFFERENT BITS")


def kill(options: argparse.Namespace) -> None:
    """Kill merges at random instants: the folder is the old map or the new one, byte for byte."""
    paths = make_maps(options.folder / "rows-1e7", 10**7)
    out = options.folder / "killed"
    hexmap = [sys.executable, "-m", "hexmap", "merge"]
    new = [*hexmap, *map(str, paths), "-o", str(out), "--tiles", str(TILE)]
    old = [*hexmap, str(paths[0]), "-o", str(out), "--tiles", str(TILE)]

    def state() -> str:
        folder = MapFolder.open(out)
        return str([(t.file, (out / t.file).stat().st_size == t.size) for t in folder.tiles])

    whole = measured(new)[0]
    after = state()
    measured(old)
    before = state()
    rng = np.random.default_rng(1)
    found = {before: 0, after: 0}
    for _ in range(options.times):
        process = subprocess.Popen(new, stdout=subprocess.DEVNULL)
        time.sleep(rng.uniform(0.0, 1.05 * whole))
        process.send_signal(signal.SIGKILL)
        process.wait()
        found[state()] += 1  # anything else is an error
        if state() == after:
            measured(old)
    measured(new)
    again = "the same files after resuming" if state() == after else "OTHER FILES AFTER RESUMING"
    print(f"{options.times} kills: {found[before]} times the old map, {found[after]} the new one; {again}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("merge", "fleet", "kill"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--rows", nargs="+", default=["1e7", "1e8"])
    parser.add_argument("--duckdb", default="")
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--times", type=int, default=10)
    options = parser.parse_args()
    {"merge": merge, "fleet": fleet, "kill": kill}[options.what](options)


if __name__ == "__main__":
    main()
