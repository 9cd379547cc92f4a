"""Figures 1 and 2 of mapping: voxel lists against the peers, quantising by lattice.

One thread, the same input in the same process, medians. Peers: Open3D's ``voxel_down_sample`` and
small_gicp's ``voxelgrid_sampling`` (they also average the points of a cell, we also count and sort).
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")


import numpy as np

from hexmap.experiments.timing import median_seconds
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from tests.benchmarks._common import data_folder, table, versions

SPATIAL = ("Z3", "D3", "D3*", "A2xZ")


def hall(count: int = 1_000_000, size: tuple[float, float, float] = (30.0, 20.0, 5.0), seed: int = 0) -> np.ndarray:
    """Points on the walls, floor and ceiling of a hall, uniform by area, with 1 cm of noise."""
    rng = np.random.default_rng(seed)
    sides = np.array(size)
    areas = np.array([sides[1] * sides[2], sides[0] * sides[2], sides[0] * sides[1]])
    axis = rng.choice(3, count, p=areas / areas.sum())
    points = rng.uniform(0.0, 1.0, (count, 3)) * sides
    points[np.arange(count), axis] = rng.integers(0, 2, count) * sides[axis]
    return points + rng.normal(0.0, 0.01, points.shape)


def numpy_cubic(points: np.ndarray, resolution: float) -> tuple[np.ndarray, np.ndarray]:
    """The obvious numpy version: packed keys and unique."""
    index = np.rint(points / resolution).astype(np.int64) + (1 << 20)
    return np.unique((index[:, 0] << 42) | (index[:, 1] << 21) | index[:, 2], return_counts=True)


def from_points(points: np.ndarray, resolution: float, title: str) -> None:
    """Print nanoseconds a point of making a list."""
    n = len(points)
    lattices = {name: Lattice.named(name, resolution) for name in SPATIAL}
    ours = {name: median_seconds(lambda on=on: VoxelList.from_points(points, on)) for name, on in lattices.items()}
    peers: dict[str, float] = {"numpy keys and unique": median_seconds(lambda: numpy_cubic(points, resolution))}
    try:
        import open3d

        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        peers["Open3D voxel_down_sample"] = median_seconds(lambda: cloud.voxel_down_sample(resolution))
    except ImportError as error:
        print(f"Open3D is left out: {error}")
    try:
        import small_gicp

        peers["small_gicp voxelgrid_sampling"] = median_seconds(
            lambda: small_gicp.voxelgrid_sampling(points, resolution, 1)
        )
    except ImportError as error:
        print(f"small_gicp is left out: {error}")
    cells = {name: len(VoxelList.from_points(points, on)) for name, on in lattices.items()}
    rows: list[list[object]] = [[f"{title}, {n:,} points, {resolution} m", "ns/point", "times Z3", "cells"]]
    rows += [[f"hexmap {k}", t / n * 1e9, t / ours["Z3"], cells[k]] for k, t in ours.items()]
    rows += [[k, t / n * 1e9, t / ours["Z3"], ""] for k, t in peers.items()]
    table(rows)


def quantise(points: np.ndarray, resolution: float) -> None:
    """Print nanoseconds a point of quantising alone."""
    n = len(points)
    flat = np.ascontiguousarray(points[:, :2])
    lattices = {k: Lattice.named(k, resolution) for k in ("Z2", "A2", *SPATIAL)}
    base = median_seconds(lambda: np.rint(points / resolution).astype(np.int32))
    base2 = median_seconds(lambda: np.rint(flat / resolution).astype(np.int32))
    rows: list[list[object]] = [["quantising alone", "ns/point", "times numpy", "times Z3"]]
    times = {k: median_seconds(lambda k=k: lattices[k].quantise(points)) for k in SPATIAL}
    rows += [[f"hexmap {k}", t / n * 1e9, t / base, t / times["Z3"]] for k, t in times.items()]
    skewed = Lattice(np.array([[1.0, 0.3, 0.2], [0.0, 0.9, 0.4], [0.1, 0.0, 1.2]]) * resolution, "skewed")
    t = median_seconds(lambda: skewed.quantise(points))
    rows.append(["hexmap, a skewed basis", t / n * 1e9, t / base, t / times["Z3"]])
    rows.append(["numpy rint, cubic", base / n * 1e9, 1.0, base / times["Z3"]])
    for k in ("Z2", "A2"):
        t = median_seconds(lambda k=k: lattices[k].quantise(flat))
        rows.append([f"hexmap {k}", t / n * 1e9, t / base2, ""])
    rows.append(["numpy rint, square", base2 / n * 1e9, 1.0, ""])
    table(rows)


def stairs() -> np.ndarray | None:
    """Points of the stairs hall (binary PCD of float32 x y z), where the shared data is."""
    folder = data_folder()
    path = folder / "scans3d" / "stairs_hall.pcd"
    if not path.exists():
        print(f"{path.name} is left out: no shared data (set HEXMAP_DATA)")
        return None
    raw = path.read_bytes()
    end = raw.index(b"\n", raw.index(b"DATA binary")) + 1
    return np.frombuffer(raw[end:], np.float32).reshape(-1, 3).astype(np.float64)


def main() -> None:
    """Print all tables."""
    print(versions("hexmap", "numpy", "numba", "open3d", "small_gicp"), "\n")
    points = hall()
    from_points(points, 0.1, "hall 30 x 20 x 5 m")
    from_points(hall(size=(100.0, 80.0, 12.0)), 0.1, "hall 100 x 80 x 12 m")
    scan = stairs()
    if scan is not None:
        from_points(scan, 0.1, "stairs hall")
    quantise(points, 0.1)


if __name__ == "__main__":
    main()
