"""Every published problem of the maps given, on the source cells: equal to the published length or listed.

    python -m tests.benchmarks.published [--folder build/published] [--workers 2] [map ...]

Without maps: all MovingAI and Warframe maps of the shared data. Finished problems are kept in the folder,
and a run that was interrupted goes on from there.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from pathlib import Path

import numpy as np

from hexmap.experiments.run_cases import run_cases
from planners.benchmark.cases import baseline_case
from planners.benchmark.problem_set import open_problem_set, publishers_roots
from planners.benchmark.settings import BenchmarkSettings
from tests.benchmarks._common import data_folder, table, versions

_CHUNK = 100


def published(path: Path, folder: Path, workers: int) -> tuple[list[object], list[tuple[int, str, float]]]:
    """Return a row of the table, and the problems that differ: number, published, ours."""
    problems = open_problem_set(path, BenchmarkSettings(queries=10**9))
    grid_map, count = problems.grid_map, len(problems.texts)
    shared = {
        "states": grid_map.states, "cell": 1.0, "origin": np.full(grid_map.dim, -0.5), "yaw": 0.0,
        "starts": problems.starts, "goals": problems.goals,
    }  # fmt: skip
    cases = [{"first": a, "last": min(a + _CHUNK, count)} for a in range(0, count, _CHUNK)]
    begin = time.monotonic()

    def progress(done: int, total: int) -> None:
        if sys.stderr.isatty():
            left = (time.monotonic() - begin) / max(done, 1) * (total - done)
            print(f"\r{path.name}: {done} of {total} chunks, {left:.0f} s left ", end="", file=sys.stderr)

    found = run_cases(baseline_case, cases, shared=shared, folder=folder, workers=workers, progress=progress)
    seconds = time.monotonic() - begin
    costs = [math.nan if c is None else c for chunk in found for c in chunk["cost"]]
    roots, equal = publishers_roots([s for chunk in found for s in chunk["steps"]], problems.texts, problems.style)
    off = [(int(problems.problem[k]), problems.texts[k], costs[k]) for k in np.flatnonzero(~equal)]
    return [path.name, count, count - len(off), len(off), roots, seconds], off


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maps", nargs="*", type=Path)
    parser.add_argument("--folder", type=Path, default=Path("build/published"))
    parser.add_argument("--workers", type=int, default=2)
    arguments = parser.parse_args()
    maps = arguments.maps
    if not maps:
        data = data_folder()
        maps = sorted(data.glob("planning/movingai/*.map")) + sorted(data.glob("planning/warframe/*.3dmap.gz"))
    print(versions("hexmap", "numpy", "numba"), "\n")
    rows: list[list[object]] = [["map", "problems", "equal to the digits", "differ", "published with", "seconds"]]
    listed = []
    for path in maps:
        row, off = published(path, arguments.folder, arguments.workers)
        rows.append(row)
        listed += [(path.name, *one) for one in off]
    table(rows)
    for name, number, text, ours in listed:
        print(f"{name} problem {number}: published {text}, ours {ours:.9f}")


if __name__ == "__main__":
    main()
