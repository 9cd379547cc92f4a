"""The run in space as a ROS 2 bag, and the true poses beside it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.atomic_files import PathLike, atomic_folder, atomic_write
from hexmap.base.errors import ArgumentError
from hexmap.poses.pose import Pose
from hexmap.simulator.space.building import Building3D
from hexmap.simulator.space.drive import Drive3D
from hexmap.simulator.space.ring_lidar import RingLidar
from hexmap.simulator.space.run import People, SimulatedScan, scan_stamps, simulate_lidar

__all__ = ["BagSummary", "bag_content", "write_bag"]

_TOPIC, _FRAME = "/points", "lidar"
_CLOUD, _FIELD = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointField"
# The layout of the Velodyne driver for ROS 2, which most readers know: names, types, and how PointField numbers these.
_FLOAT32, _UINT16 = ("<f4", 7), ("<u2", 4)
_LAYOUT = {"x": _FLOAT32, "y": _FLOAT32, "z": _FLOAT32, "intensity": _FLOAT32, "ring": _UINT16, "time": _FLOAT32}


@dataclass(frozen=True)
class BagSummary:
    """What was written.

    Attributes:
        scans: number of sweeps.
        points: number of points in all of them.
        metres: distance driven until the last one, in the plan.
        seconds: stamp of the last one.
        path: the folder of the bag.
        truth_path: the true poses, if they were asked for.
    """

    scans: int
    points: int
    metres: float
    seconds: float
    path: Path
    truth_path: Path | None


def bag_content(path: PathLike) -> frozenset[str]:
    """Return the names of the files of a bag that :func:`write_bag` writes to the folder ``path``."""
    return frozenset({"metadata.yaml", f"{Path(path).resolve().name}.mcap"})


def write_bag(
    path: PathLike,
    building: Building3D,
    truth_path: PathLike | None = None,
    *,
    drive: Drive3D | None = None,
    lidar: RingLidar | None = None,
    seed: int = 0,
    people: People | None = None,
    duration: float | None = None,
    scans: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> BagSummary:
    """Simulate a run and write it as a ROS 2 bag, with the true poses as a TUM file.

    The bag is a folder with ``metadata.yaml`` and an MCAP file, compressed with zstd. Its one topic is ``/points``,
    sensor_msgs/PointCloud2 in the frame ``lidar``: x, y, z (metres), intensity (0 to 100) and time (seconds after the
    header's stamp, never positive) as float32, ring as uint16. The header's stamp is the end of the sweep. The TUM file
    holds the true pose at each stamp, T_map_lidar, as a line ``stamp x y z qx qy qz qw``. Points are in the LiDAR's
    frame at their own time. Rays without return are left out. There is no tf, so that a map made of the bag has the
    poses of the LiDAR, as the TUM file does.

    The same arguments give the same bytes (with the same versions of rosbags and zstd). Bag and truth appear complete
    or not at all, an older bag of the same name is replaced, and memory does not grow with the length of the run.

    Args:
        path: the folder of the bag.
        building: the solids and the path.
        truth_path: the true poses; None writes none.
        drive: how the path is driven; at 1.2 m/s by default, swaying as the seed says.
        lidar: settings of the LiDAR.
        seed: of noise, missing returns and people.
        people: who walks about; nobody by default.
        duration: seconds after which to stop, if that is before the end of the drive.
        scans: how many scans at most.
        progress: called after each scan with the number of scans so far and of all.

    Raises:
        ArgumentError: a setting out of its range, or a truth that would lie in the bag.
        FileAccessError: a file or folder that cannot be written, or a folder there that is no such bag.
    """
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    bag_path, tum_path = Path(path), None if truth_path is None else Path(truth_path)
    if tum_path is not None and bag_path.resolve() in (tum_path.resolve(), *tum_path.resolve().parents):
        raise ArgumentError(f"the true poses {tum_path} cannot lie in the bag {bag_path}")
    drive = drive or Drive3D(building.waypoints, seed=seed)
    lidar = lidar or RingLidar()
    run = simulate_lidar(building, drive, lidar, seed, people=people, duration=duration, scans=scans)
    total = len(scan_stamps(drive, lidar, duration, scans))
    store: Any = get_typestore(Stores.ROS2_HUMBLE)
    count = points = 0
    stamp = 0.0
    with ExitStack() as files:
        # Entered first, so left last: the bag takes its name only when the true poses have theirs.
        folder = files.enter_context(atomic_folder(bag_path, bag_content(bag_path)))
        truth = None if tum_path is None else files.enter_context(atomic_write(tum_path, "w"))
        writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            connection = writer.add_connection(_TOPIC, _CLOUD, typestore=store)
            for simulated in run:
                count += 1
                points += len(simulated.scan.points)
                stamp = simulated.scan.stamp
                message = _cloud_message(simulated, store.types)
                writer.write(connection, _nanoseconds(stamp), store.serialize_cdr(message, _CLOUD))
                if truth is not None:
                    truth.write(_tum(stamp, simulated.T_map_lidar))
                if progress is not None:
                    progress(count, total)
    return BagSummary(count, points, drive.length_until(stamp), stamp, bag_path, tum_path)


def _nanoseconds(stamp: float) -> int:
    return round(stamp * 1e9)


def _cloud_message(simulated: SimulatedScan, types: Any) -> Any:
    """Return a sweep as a sensor_msgs/PointCloud2 of the types of a store."""
    scan = simulated.scan
    rows = np.empty(len(scan.points), dtype=[(name, kind) for name, (kind, _) in _LAYOUT.items()])
    for axis, name in enumerate("xyz"):
        rows[name] = scan.points[:, axis]
    rows["intensity"], rows["time"], rows["ring"] = scan.intensity, scan.times, simulated.rings
    fields, offset = [], 0
    for name, (kind, datatype) in _LAYOUT.items():
        fields.append(types[_FIELD](name, offset, datatype, 1))
        offset += np.dtype(kind).itemsize
    seconds, nanoseconds = divmod(_nanoseconds(scan.stamp), 10**9)
    time = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return types[_CLOUD](
        header=types["std_msgs/msg/Header"](stamp=time, frame_id=_FRAME),
        height=1,
        width=len(rows),
        fields=fields,
        is_bigendian=False,
        point_step=offset,
        row_step=rows.nbytes,
        data=rows.view(np.uint8),
        is_dense=True,
    )


def _tum(stamp: float, pose: Pose) -> str:
    numbers = " ".join(f"{value:.9f}" for value in (*pose.translation, *pose.quaternion()))
    return f"{stamp:.9f} {numbers}\n"
