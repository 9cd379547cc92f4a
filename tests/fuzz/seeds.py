"""Small files of every kind that is read: those that the tests make, and those of the folder HEXMAP_CASES."""

from __future__ import annotations

import gzip
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

from hexmap.io.map_file import save_map
from hexmap.io.trajectories import write_tum
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from hexmap.poses.trajectory import Trajectory
from tests.io.clouds.test_clouds import SAMPLES
from tests.io.clouds.test_points_of_others import ptx
from tests.io.grids.test_grids import YAML, octomap_bytes, small_octree
from tests.io.logs.test_bag_frames import Frames, at, mcap, ranges, raw_messages
from tests.io.logs.test_logs import flaser, odom, rawlaser, robotlaser

# The largest file of the cases that is mutated: larger ones take long to read and tell no more.
_MOST_BYTES = 100_000
_KINDS = {"bags": "log", "carmen": "log", "maps": "grid", "points": "points", "trajectories": "trajectory"}


def write_seeds(folder: Path) -> list[tuple[str, Path]]:
    """Write the seeds; returns (what reads it, file) of each."""
    seeds = [(kind, path) for kind, path in _made(folder)]
    named = os.environ.get("HEXMAP_CASES")
    for name, kind in _KINDS.items() if named else ():
        for path in sorted((Path(named or "") / name).iterdir()):
            if path.is_file() and path.stat().st_size <= _MOST_BYTES:
                copy = folder / path.name
                copy.write_bytes(path.read_bytes())
                seeds.append((kind, copy))
    return seeds


def _made(folder: Path) -> Iterator[tuple[str, Path]]:
    yield from _bags(folder)
    readings = [odom(), flaser(), odom(), robotlaser(["2.5"] * 180), rawlaser(9.0)]
    lines = "\n".join(["PARAM robot_frontlaser_offset 0.2", *readings])
    texts: dict[str, tuple[str, bytes]] = {
        "a.clf": ("log", lines.encode() + b"\n"),
        "b.clf.gz": ("log", gzip.compress(lines.encode())),
        "a.map": ("grid", b"type octile\nheight 3\nwidth 4\nmap\n..@.\n.T.G\n@@..\n"),
        "a.3dmap": ("grid", b"voxel 4 3 5\n0 1 2\n3 2 4\n"),
        "a.bt": ("grid", small_octree()),
        "b.bt": ("grid", octomap_bytes(b"\x03\x00" * 15 + b"\x09\x00", 18)),
        "a.dat": ("grid", b"robot_specifications->resolution 10\nglobal_map[0]: 3 2\n-1 0.5 1\n0 0.2 0.9\n"),
        "a.scen": ("scenario", b"version 1\n0\ta.map\t4\t3\t0\t0\t3\t2\t3.5\n"),
        "a.3dscen": ("scenario", b"version 1\na.3dmap\n0 0 0 3 1 1 3.5 1.0\n"),
        "a.relations": ("relations", b"1 2 0.5 0 0 0 0 0.1\n2 3 0.5 0 0 0 0 0.1\n"),
        "a.ptx": ("points", ptx(np.ones((6, 3)), np.eye(4), 2)),
    }
    texts |= {name: ("points", data) for name, (data, _) in SAMPLES.items()}
    for name, (kind, data) in texts.items():
        path = folder / name
        path.write_bytes(data)
        yield kind, path
    grey = Image.fromarray(np.array([[0, 254, 205], [254, 90, 0]], np.uint8))
    for suffix, image in ((".png", grey), (".bmp", grey), (".pgm", grey), (".ppm", grey.convert("RGB"))):
        image.save(folder / f"m{suffix}")
        (folder / f"m{suffix}.yaml").write_text(YAML.replace("m.pgm", f"m{suffix}"))
        yield "picture", folder / f"m{suffix}"
        yield "grid", folder / f"m{suffix}.yaml"
    write_tum(folder / "a.tum", Trajectory.from_poses([1.0, 2.0], [Pose.planar(0, 0, 0), Pose.planar(1, 0, 0.5)]))
    yield "trajectory", folder / "a.tum"
    builder = MapBuilder(Lattice.named("A2", 0.5), 2)
    builder.fuse(Scan(0.0, np.random.default_rng(1).normal(0.0, 2.0, (40, 2))), Pose.planar(0.0, 0.0, 0.0))
    save_map(folder / "a.parquet", builder.build())
    yield "map", folder / "a.parquet"


def _bags(folder: Path) -> Iterator[tuple[str, Path]]:
    for kind in ("rosbag1", "rosbag1-bz2", "rosbag2", "mcap", "mcap-zstd"):
        (folder / kind).mkdir()
        with Frames(folder / kind, kind) as bag:
            bag.many(99.0, ("base_link", "laser", Pose.planar(0.2, 0.0, 0.0)), topic="/tf_static")
            for i in range(4):
                bag.many(100.0 + i, ("odom", "base_link", at(i)), ("map", "odom", at(2 * i)))
                if kind != "rosbag2":
                    bag.reading(100.0 + i, at(i))
                bag.scan(100.0 + i, ranges(at(i)))
        if bag.path.is_file():
            yield "log", bag.path.rename(folder / f"{kind}.bag")
            continue
        storage = next(path for path in bag.path.iterdir() if path.suffix in (".db3", ".mcap"))
        yield "log", storage.rename(folder / f"{kind}{storage.suffix}")
        yield "metadata", bag.path / "metadata.yaml"
    for ros1 in (True, False):
        messages, texts = raw_messages(ros1)
        encoding = ("ros1msg", "ros1") if ros1 else ("ros2msg", "cdr")
        yield "log", mcap(folder / f"plain{ros1}.mcap", messages, *encoding, texts)
