"""Figures of the any-angle optimum: preparing a map, queries, memory, and how much longer octile paths are.

Seeded problems of the MovingAI maps, all of the smallest. "cold" is what the first query costs, the
preparation included, with compiled kernels; the queries after it are in milliseconds of one thread's
own time, so that a busy machine shows less. "octile" is the mean ratio of the published lengths to the
optimum; skips what needs the shared data where it is absent.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from hexmap.io.grids.open_grid import open_grid
from hexmap.io.grids.scenarios import read_scenario
from hexmap.maps.cell_state import CellState
from planners.any_angle.optimum import AnyAngleOptimum
from tests.benchmarks._common import data_folder, table, versions

MAPS = ("arena", "brc202d", "Berlin_0_512", "random512-25-0", "maze512-8-0", "AR0011SR", "den520d")


def measure(folder: Path, name: str, problems: int) -> list[object]:
    """Return a row of the table."""
    free = open_grid(folder / f"{name}.map").states == CellState.FREE
    scenario = read_scenario(folder / f"{name}.map.scen")
    count = len(scenario.lengths)
    chosen = np.sort(np.random.default_rng(0).permutation(count)[: count if name == "arena" else problems])
    starts, goals, published = scenario.starts[chosen], scenario.goals[chosen], scenario.lengths[chosen]
    begin = time.perf_counter()
    optimum = AnyAngleOptimum(free)
    optimum.path(starts[0], goals[0])
    cold = time.perf_counter() - begin
    times, paths = [], []
    for start, goal in zip(starts, goals, strict=True):
        begin = time.thread_time()
        paths.append(optimum.path(start, goal))
        times.append(1e3 * (time.thread_time() - begin))
    lengths = np.array([path.length for path in paths])
    far = lengths > 0
    return [
        name,
        optimum.corners,
        optimum.legs,
        optimum.nbytes / 1e6,
        1e3 * cold,
        float(np.mean(times)),
        float(np.median(times)),
        max(times),
        float(np.mean([path.expansions for path in paths])),
        f"{(published[far] / lengths[far]).mean():.4f}",
    ]


def main(arguments: list[str] | None = None) -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.optimum", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--problems", type=int, default=500, help="of each map but the smallest")
    chosen = parser.parse_args(arguments)
    data = data_folder()
    folder = data / "planning" / "movingai"
    print(versions("hexmap", "numpy", "numba", "scipy"), "\n")
    if not folder.is_dir():
        print("the any-angle optimum is left out: no shared data (set HEXMAP_DATA)")
        return
    bars = np.ones((5, 5), bool)
    bars[2, 1:4] = False
    AnyAngleOptimum(bars).path([0, 2], [4, 2])  # compiles
    rows: list[list[object]] = [
        ["any-angle optimum", "corners", "legs", "MB", "cold ms", "mean ms", "median", "most", "expansions", "octile"]
    ]
    table([*rows, *(measure(folder, name, chosen.problems) for name in MAPS)])


if __name__ == "__main__":
    main()
