"""Figures of the paper's experiments: the whole rotation experiment, cost by lattice, drawing of cells."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from hexmap.experiments.timing import median_seconds
from hexmap.lattice.lattice import Lattice
from hexmap.maps.metrics import distortion
from hexmap.maps.voxel_list import VoxelList
from hexmap.paper.cases import about_axis
from tests.benchmarks._common import table, versions
from tests.benchmarks.voxels import hall, stairs


def obvious(points: np.ndarray, name: str, resolution: float) -> tuple[int, float]:
    """Count cells and distortion as one would write it in numpy: the paper's quantisers and unique rows."""
    if name == "Z3":
        cells = np.rint(points / resolution)
        centres = cells * resolution
    elif name == "D3":
        unit = resolution / 2 ** (1 / 3)
        x = points / unit
        cells = np.rint(x)
        error = x - cells
        worst = np.argmax(np.abs(error), axis=1)
        odd = np.flatnonzero(cells.sum(axis=1) % 2 != 0)
        cells[odd, worst[odd]] += np.where(error[odd, worst[odd]] >= 0, 1, -1)
        centres = cells * unit
    else:
        unit = resolution * 2 ** (1 / 3)
        x = points / unit
        whole, half = np.rint(x), np.floor(x) + 0.5
        nearer = ((x - half) ** 2).sum(axis=1) < ((x - whole) ** 2).sum(axis=1)
        cells = np.where(nearer[:, None], half, whole)
        centres = cells * unit
    return len(np.unique(cells, axis=0)), float(np.linalg.norm(points - centres, axis=1).mean())


def rotation(points: np.ndarray, resolution: float = 0.1) -> None:
    """Time 36 rotations on three lattices, ours against the obvious numpy."""
    lattices = {name: Lattice.named(name, resolution) for name in ("Z3", "D3", "D3*")}

    def ours() -> list[tuple[int, float]]:
        found = []
        for degrees in range(0, 180, 5):
            rotated = about_axis("z", degrees, 3).apply(points)
            found += [(len(VoxelList.from_points(rotated, v)), distortion(rotated, v)) for v in lattices.values()]
        return found

    def plain() -> list[tuple[int, float]]:
        found = []
        for degrees in range(0, 180, 5):
            rotated = about_axis("z", degrees, 3).apply(points)
            found += [obvious(rotated, name, resolution) for name in lattices]
        return found

    same = sum(abs(a[0] - b[0]) <= 2 for a, b in zip(ours(), plain(), strict=True))
    fast, slow = median_seconds(ours, 3), median_seconds(plain, 1)
    table([
        [f"rotation, {len(points):,} points, 36 angles, 3 lattices", "s", "times"],
        ["hexmap", fast, 1.0],
        ["the obvious numpy", slow, slow / fast],
        [f"counts equal to within 2 (ties): {same} of 108", "", ""],
    ])  # fmt: skip


def cost(points: np.ndarray, resolution: float = 0.1) -> None:
    """Time quantising and listing by lattice on the paper's own size of problem."""
    lattices = {k: Lattice.named(k, resolution) for k in ("Z3", "D3", "D3*", "A2xZ")}
    times = {k: median_seconds(lambda v=v: VoxelList.from_points(points, v), 21) for k, v in lattices.items()}
    rows: list[list[object]] = [[f"quantise and list, {len(points):,} points, 0.1 m", "ms", "times Z3", "paper"]]
    paper = {"Z3": 1, "D3": 5, "D3*": 10}
    rows += [[k, 1000 * t, t / times["Z3"], paper.get(k, "")] for k, t in times.items()]
    table(rows)


_DRAW = """
import resource, sys, time
import numpy as np
from hexmap.lattice import Lattice
from hexmap.drawing.solids import draw_solids
from hexmap.maps import VoxelList
points = np.load(sys.argv[1])
cells = VoxelList.from_points(points, Lattice.named(sys.argv[2], 0.1))
draw_solids(VoxelList.from_points(points[:50], cells.lattice), sys.argv[3])
begin = time.perf_counter()
draw_solids(cells, sys.argv[3])
print(len(cells), time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def drawing(points: np.ndarray) -> None:
    """Time and memory of drawing some 25,000 and 250,000 cells of each lattice, each in its own process."""
    rows: list[list[object]] = [["drawing cells", "cells", "s (warm)", "peak MB"]]
    with tempfile.TemporaryDirectory() as work:
        cloud, picture = Path(work) / "p.npy", Path(work) / "p.png"
        # The larger scene is the scan side by side, eleven times: one scan has no 250,000 cells.
        tiled = np.concatenate([points + np.array([40.0 * (k % 4), 40.0 * (k // 4), 0.0]) for k in range(11)])
        for scene in (points, tiled):
            np.save(cloud, scene)
            for name in ("Z3", "D3", "D3*"):
                done = subprocess.run(
                    [sys.executable, "-c", _DRAW, str(cloud), name, str(picture)],
                    check=True, capture_output=True, text=True,
                )  # fmt: skip
                count, seconds, peak = done.stdout.split()
                rows.append([name, int(count), float(seconds), float(peak)])
    table(rows)


def main() -> None:
    """Print all tables."""
    print(versions("hexmap", "numpy", "numba", "matplotlib"), "\n")
    scan = stairs()
    points = scan if scan is not None else hall(88_206)
    begin = time.perf_counter()
    rotation(points)
    cost(points[:80_000])
    drawing(points)
    print(f"{time.perf_counter() - begin:.0f} s, {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024} MB")


if __name__ == "__main__":
    main()
