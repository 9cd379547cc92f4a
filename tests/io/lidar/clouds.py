"""Messages of sensor_msgs/PointCloud2, made of arrays as drivers make them, and bags that hold them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("rosbag1", "rosbag2", "mcap")
CLOUD, FIELD = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/PointField"
# sensor_msgs/PointField numbers the types.
DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
STORE = get_typestore(Stores.ROS2_HUMBLE)
_STORE1 = get_typestore(Stores.ROS1_NOETIC)
TF, ODOMETRY = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
_STORE1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))


def cloud(
    columns: dict[str, np.ndarray],
    *,
    stamp: float = 100.0,
    frame: str = "lidar",
    height: int = 1,
    big: bool = False,
    point_padding: int = 0,
    row_padding: int = 0,
    store: Any = STORE,
) -> Any:
    """A cloud whose fields are these arrays (N,), byte by byte."""
    order = ">" if big else "<"
    n = len(next(iter(columns.values()))) if columns else 0
    step = sum(a.dtype.itemsize for a in columns.values()) + point_padding
    width = n // height
    row = width * step + row_padding
    data = np.full(row * height, 0xAB, np.uint8)
    fields, offset = [], 0
    for name, values in columns.items():
        kind = values.dtype.newbyteorder("=").str[1:]
        fields.append(store.types[FIELD](name, offset, DATATYPES[kind], 1))
        raw = values.astype(order + kind).view(np.uint8).reshape(n, values.dtype.itemsize)
        for k in range(n):
            at = (k // width) * row + (k % width) * step + offset
            data[at : at + raw.shape[1]] = raw[k]
        offset += values.dtype.itemsize
    # Whole nanoseconds of the stamp, as a driver has them.
    seconds, nanoseconds = divmod(round(stamp * 1e9), 10**9)
    time = store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    extra = {"seq": 0} if store is _STORE1 else {}
    return store.types[CLOUD](
        header=store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **extra), height=height, width=width,
        fields=fields, is_bigendian=big, point_step=step, row_step=row, data=data, is_dense=False,
    )  # fmt: skip


def xyz(points: np.ndarray) -> dict[str, np.ndarray]:
    return {axis: np.asarray(points, np.float32)[:, k] for k, axis in enumerate("xyz")}


def room(n: int = 60, seed: int = 0) -> np.ndarray:
    """Points (n, 3) that a float32 holds exactly."""
    return np.random.default_rng(seed).uniform(1.0, 9.0, (n, 3)).astype(np.float32).astype(np.float64)


class CloudBag:
    """Writes a small bag of any kind."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.ros1 = kind == "rosbag1"
        self.store = _STORE1 if self.ros1 else STORE
        self.path = folder / ("run.bag" if self.ros1 else "run")
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer: Any = Writer1(self.path) if self.ros1 else Writer2(self.path, version=9, storage_plugin=plugin)
        self.connections: dict[str, Any] = {}

    def __enter__(self) -> CloudBag:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def write(self, columns: dict[str, np.ndarray], received: float, *, topic: str = "/points", **how: Any) -> None:
        how.setdefault("stamp", received)
        self.message(topic, CLOUD, cloud(columns, store=self.store, **how), received)

    def message(self, topic: str, kind: str, message: Any, received: float) -> None:
        raw = self.store.serialize_ros1(message, kind) if self.ros1 else self.store.serialize_cdr(message, kind)
        self.raw(topic, kind, bytes(raw), received)

    def raw(self, topic: str, kind: str, data: bytes, received: float) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        self.writer.write(self.connections[topic], round(received * 1e9), data)

    def register(self, name: str, text: str) -> None:
        """Make a type of message known that is not among ROS's own."""
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        self.store.register(get_types_from_msg(text, name))

    def transforms(self, received: float, *items: tuple[str, str, Any], topic: str = "/tf_static") -> None:
        """Write a tf message of several (parent, child, T_parent_child or a quaternion that may be none)."""
        g, types = "geometry_msgs/msg/", self.store.types
        found = []
        for parent, child, T in items:
            t, q = (T.translation.tolist(), T.quaternion().tolist()) if hasattr(T, "quaternion") else ([0.0] * 3, T)
            transform = types[g + "Transform"](types[g + "Vector3"](*t), types[g + "Quaternion"](*q))
            found.append(types[g + "TransformStamped"](self._header(received, parent), child, transform))
        self.message(topic, TF, types[TF](found), received)

    def reading(self, received: float, T: Any, frame: str = "odom", child: str = "base_link") -> None:
        """Write a reading of the odometry."""
        g, types = "geometry_msgs/msg/", self.store.types
        zero = types[g + "Vector3"](0.0, 0.0, 0.0)
        pose = types[g + "Pose"](types[g + "Point"](*T.translation.tolist()),
                                 types[g + "Quaternion"](*T.quaternion().tolist()))  # fmt: skip
        message = types[ODOMETRY](
            header=self._header(received, frame), child_frame_id=child,
            pose=types[g + "PoseWithCovariance"](pose, np.zeros(36)),
            twist=types[g + "TwistWithCovariance"](types[g + "Twist"](zero, zero), np.zeros(36)),
        )  # fmt: skip
        self.message("/odom", ODOMETRY, message, received)

    def _header(self, stamp: float, frame: str) -> Any:
        seconds, nanoseconds = divmod(round(stamp * 1e9), 10**9)
        time = self.store.types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
        extra = {"seq": 0} if self.ros1 else {}
        return self.store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **extra)
