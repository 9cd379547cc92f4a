"""Voxel lists against the peers, quantising by lattice, and the free space of one scan against OctoMap.

One thread, the same input in the same process, medians; of free space the least of several runs. Peers: Open3D's
``voxel_down_sample`` and small_gicp's ``voxelgrid_sampling`` (they also average the points of a cell, we also count
and sort), and pyoctomap's ``insertPointCloud``.
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


def ring_scan(rings: int = 64, columns: int = 1024, size: tuple[float, float, float] = (30.0, 20.0, 5.0)) -> np.ndarray:
    """What a ring LiDAR in a hall sees from 1.5 m above its floor, a third along it, ring by ring; 1 cm of noise."""
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(-22.5, 22.5, rings)),
        np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False),
        indexing="ij",
    )
    directions = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    at = np.array([size[0] / 3.0, size[1] / 3.0, 1.5])
    with np.errstate(divide="ignore"):
        walls = np.where(directions > 0.0, np.array(size) - at, -at) / directions
    reach = np.where(directions == 0.0, np.inf, walls).min(axis=1)
    return directions * (reach + np.random.default_rng(0).normal(0.0, 0.01, len(reach)))[:, None]


def lidar_scan(number: int = 20, rays: int = 65_536) -> np.ndarray | None:
    """A scan of the hall's log, thinned or repeated evenly to so many rays, where the shared data is."""
    from rosbags.highlevel import AnyReader

    folder = data_folder() / "lidar3d" / "hall"
    if not folder.exists():
        print("the hall is left out: no shared data (set HEXMAP_DATA)")
        return None
    with AnyReader([folder]) as reader:
        for k, (connection, _, raw) in enumerate(reader.messages()):
            if k == number:
                cloud = reader.deserialize(raw, connection.msgtype)
                break
    points = np.frombuffer(cloud.data.tobytes(), np.uint8).reshape(-1, cloud.point_step)[:, :12].copy().view("<f4")
    points = points[np.isfinite(points).all(axis=1) & ((points**2).sum(axis=1) > 0.25)].astype(np.float64)
    return np.ascontiguousarray(points[np.linspace(0, len(points) - 1, rays).astype(int)])


def free_space(points: np.ndarray, resolution: float, title: str, repeats: int = 7) -> None:
    """Print the time of fusing one scan with its beams into an empty map of one level, and the size of the map.

    Bytes are those of the map file (hits and passes) and of the ``.bt`` of the same states, a known cell.
    """
    import tempfile
    import time
    from pathlib import Path

    from hexmap.io.map_file import save_map
    from hexmap.io.octomap_export import export_octomap
    from hexmap.maps.builder import MapBuilder
    from hexmap.poses.pose import Pose
    from hexmap.poses.scan import Scan

    scan, here = Scan(stamp=0.0, points=points), Pose.identity(3)
    try:
        import pyoctomap
    except ImportError as error:
        pyoctomap = None
        print(f"OctoMap is left out: {error}")
    times: dict[str, float] = dict.fromkeys((*SPATIAL, "OctoMap"), np.inf)
    builders: dict[str, MapBuilder] = {}
    for _ in range(repeats):
        for name in SPATIAL:
            builders[name] = MapBuilder(Lattice.named(name, resolution), levels=1)
            begin = time.process_time()
            builders[name].fuse(scan, here)
            times[name] = min(times[name], time.process_time() - begin)
        if pyoctomap is not None:
            tree = pyoctomap.OcTree(resolution)
            begin = time.process_time()
            tree.insertPointCloud(points, np.zeros(3), -1.0, False, False)
            times["OctoMap"] = min(times["OctoMap"], time.process_time() - begin)
    rows: list[list[object]] = [
        [
            f"{title}, {len(points):,} rays, {resolution} m",
            "ms",
            "times Z3",
            "OctoMap / ours",
            "hit",
            "passed",
            "bytes",
            ".bt",
        ]
    ]
    for name, builder in builders.items():
        made = builder.build()
        level = made.levels[0]
        assert level.hits == VoxelList.from_points(points, level.lattice)
        states = made.state()
        known = len(states.occupied) + len(states.free)
        with tempfile.TemporaryDirectory() as folder:
            save_map(Path(folder) / "a.parquet", made)
            cubes = export_octomap(states, Path(folder) / "a.bt")
            sizes = [(Path(folder) / file).stat().st_size for file in ("a.parquet", "a.bt")]
        row: list[object] = [
            f"hexmap {name}",
            1e3 * times[name],
            times[name] / times["Z3"],
            times["OctoMap"] / times[name],
        ]
        row += [
            len(level.hits),
            len(level.passes),
            sizes[0] / known,
            sizes[1] / (len(cubes.occupied) + len(cubes.free)),
        ]
        rows.append(row)
    rows.append(
        ["OctoMap insertPointCloud", 1e3 * times["OctoMap"], times["OctoMap"] / times["Z3"], 1.0, "", "", "", ""]
    )
    table(rows)


def main() -> None:
    """Print all tables."""
    print(versions("hexmap", "numpy", "numba", "open3d", "small_gicp", "pyoctomap"), "\n")
    points = hall()
    from_points(points, 0.1, "hall 30 x 20 x 5 m")
    from_points(hall(size=(100.0, 80.0, 12.0)), 0.1, "hall 100 x 80 x 12 m")
    scan = stairs()
    if scan is not None:
        from_points(scan, 0.1, "stairs hall")
    quantise(points, 0.1)
    free_space(ring_scan(), 0.1, "free space, a simulated hall")
    lidar = lidar_scan()
    if lidar is not None:
        free_space(lidar, 0.1, "free space, the hall")


if __name__ == "__main__":
    main()
