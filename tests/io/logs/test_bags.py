"""ROS 1 bags, ROS 2 bags and MCAP files, written here with rosbags."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hexmap.base.errors import LogError
from hexmap.io.logs.log import LogSettings
from hexmap.io.logs.open_log import open_log
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan

KINDS = ["rosbag1", "rosbag1-bz2", "rosbag2", "mcap", "mcap-zstd"]
LASER, ODOMETRY, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"


class Bag:
    """Writes a small bag of any kind."""

    def __init__(self, folder: Path, kind: str) -> None:
        self.ros1 = kind.startswith("rosbag1")
        self.kind = kind.split("-")[0]
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        if self.ros1:  # the store of ROS 1 has no tf
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
        self.path = folder / ("run.bag" if self.ros1 else "run")
        if self.ros1:
            self.writer = Writer1(self.path)
            if kind.endswith("bz2"):
                self.writer.set_compression(Writer1.CompressionFormat.BZ2)
        else:
            plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
            self.writer = Writer2(self.path, version=9, storage_plugin=plugin)
            if kind.endswith("zstd"):
                self.writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self.connections: dict[str, object] = {}

    def __enter__(self) -> Bag:
        self.writer.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.writer.close()

    def type(self, name: str):
        return self.store.types[name]

    def header(self, stamp: float, frame: str):
        seconds = int(stamp)
        time = self.type("builtin_interfaces/msg/Time")(sec=seconds, nanosec=round((stamp - seconds) * 1e9))
        extra = {"seq": 0} if self.ros1 else {}
        return self.type("std_msgs/msg/Header")(stamp=time, frame_id=frame, **extra)

    def write(self, topic: str, kind: str, message: object, stamp: float) -> None:
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        raw = self.store.serialize_ros1(message, kind) if self.ros1 else self.store.serialize_cdr(message, kind)
        self.writer.write(self.connections[topic], round(stamp * 1e9), raw)

    def scan(self, stamp: float, ranges=(1.0, 2.0, 3.0), topic="/scan", frame="laser", minimum=0.1, maximum=30.0):
        message = self.type(LASER)(
            header=self.header(stamp, frame), angle_min=-0.5, angle_max=0.5, angle_increment=0.5, time_increment=0.0,
            scan_time=0.0, range_min=minimum, range_max=maximum, ranges=np.array(ranges, dtype=np.float32),
            intensities=np.zeros(0, dtype=np.float32),
        )  # fmt: skip
        self.write(topic, LASER, message, stamp)

    def _quaternion(self, roll: float, yaw: float, length: float = 1.0):
        cr, sr, cy, sy = math.cos(roll / 2), math.sin(roll / 2), math.cos(yaw / 2), math.sin(yaw / 2)
        q = [length * v for v in (sr * cy, sr * sy, cr * sy, cr * cy)]
        return self.type("geometry_msgs/msg/Quaternion")(*q)

    def odom(self, stamp: float, x: float, y: float, yaw: float, topic="/odom", length: float = 1.0):
        g = "geometry_msgs/msg/"
        zero = self.type(g + "Vector3")(0.0, 0.0, 0.0)
        pose = self.type(g + "Pose")(self.type(g + "Point")(x, y, 0.0), self._quaternion(0.0, yaw, length))
        message = self.type(ODOMETRY)(
            header=self.header(stamp, "odom"), child_frame_id="base_link",
            pose=self.type(g + "PoseWithCovariance")(pose, np.zeros(36)),
            twist=self.type(g + "TwistWithCovariance")(self.type(g + "Twist")(zero, zero), np.zeros(36)),
        )  # fmt: skip
        self.write(topic, ODOMETRY, message, stamp)

    def tf(self, stamp: float, parent: str, child: str, x=0.0, y=0.0, yaw=0.0, roll=0.0, topic="/tf"):
        g = "geometry_msgs/msg/"
        transform = self.type(g + "Transform")(self.type(g + "Vector3")(x, y, 0.0), self._quaternion(roll, yaw))
        item = self.type(g + "TransformStamped")(self.header(stamp, parent), child, transform)
        self.write(topic, TF, self.type(TF)([item]), stamp)


def read(path: Path, **settings):
    log = open_log(path, LogSettings(**settings))
    return log, list(log)


def drive(folder: Path, kind: str, n: int = 5) -> Path:
    with Bag(folder, kind) as bag:
        for i in range(n):
            bag.scan(100.0 + i, frame="base_link")
            bag.odom(100.0 + i, 0.5 * i, 0.0, 0.1 * i)
    return bag.path


@pytest.mark.parametrize("kind", KINDS)
def test_scan_and_odometry_topics(tmp_path: Path, kind: str) -> None:
    log, events = read(drive(tmp_path, kind))
    assert log.format == kind.split("-")[0]
    assert [type(e) for e in events] == [Scan, Odometry] * 5
    assert (log.scans, log.odometry, log.skipped) == (5, 5, 0) and log.warnings == []
    assert log.fraction() == 1.0 and log.mount is None
    scan, reading = events[4], events[5]
    assert reading.pose.is_close(Pose.planar(1.0, 0.0, 0.2)) and reading.stamp == 102.0
    assert scan.odometry.is_close(reading.pose), "a scan carries the odometry at its stamp"
    np.testing.assert_allclose(np.arctan2(scan.points[:, 1], scan.points[:, 0]), [-0.5, 0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(scan.points, axis=1), [1, 2, 3])
    assert len(list(log)) == 10, "a bag can be read again"


@pytest.mark.parametrize("kind", KINDS)
def test_tf_alone_gives_odometry_and_mount(tmp_path: Path, kind: str) -> None:
    with Bag(tmp_path, kind) as bag:
        bag.tf(99.0, "base_link", "laser", 0.2, 0.1, 0.3, topic="/tf_static")
        bag.tf(99.0, "base_footprint", "base_link", 0.0, 0.0, 0.0, topic="/tf_static")
        for i in range(5):
            bag.tf(100.0 + i, "map", "odom", 50.0 + i)
            bag.tf(100.0 + i, "odom", "base_footprint", 0.5 * i, 0.0, 0.1 * i)
            bag.scan(100.5 + i)
    log, events = read(bag.path)
    assert log.mount is not None and log.mount.is_close(Pose.planar(0.2, 0.1, 0.3), 1e-9, 1e-9)
    scans = [e for e in events if isinstance(e, Scan)]
    readings = [e for e in events if isinstance(e, Odometry)]
    assert len(scans) == len(readings) == 5 and log.warnings == []
    assert readings[3].pose.is_close(Pose.planar(1.5, 0.0, 0.3), 1e-9, 1e-9), "odom, not map"
    assert scans[0].odometry.is_close(Pose.planar(0.25, 0.0, 0.05), 1e-6, 1e-6), "half way between two readings"
    assert scans[-1].odometry.is_close(readings[-1].pose, 1e-9, 1e-9), "the last one known"


def test_mount_beside_an_odometry_topic(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag2") as bag:
        bag.tf(99.0, "base_link", "mast", 0.2, 0.0, math.pi / 2, topic="/tf_static")
        bag.tf(99.0, "mast", "laser", 0.1, 0.0, 0.0, topic="/tf_static")
        bag.scan(100.0)
        bag.odom(100.0, 1.0, 0.0, 0.0)
    log, events = read(bag.path)
    assert log.mount.is_close(Pose.planar(0.2, 0.1, math.pi / 2), 1e-9, 1e-9) and log.warnings == []
    assert len(events) == 2


def test_laser_upside_down_is_mirrored(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag1") as bag:
        bag.tf(99.0, "base_link", "laser", 0.2, 0.0, 0.3, roll=math.pi, topic="/tf_static")
        bag.scan(100.0)
        bag.odom(100.0, 0.0, 0.0, 0.0)
    log, (scan, _) = read(bag.path)
    assert log.mount.is_close(Pose.planar(0.2, 0.0, 0.3), 1e-9, 1e-9)
    # What the full rotation in space makes of the beams, seen from above.
    T = Pose.from_quaternion([0.2, 0, 0], [math.cos(0.15), math.sin(0.15), 0, 0])
    angles = np.array([-0.5, 0.0, 0.5])
    beams = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1) * [[1], [2], [3]]
    np.testing.assert_allclose(log.mount.apply(scan.points), T.apply(beams)[:, :2], atol=1e-7)


def test_tilted_laser_is_warned_of(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag1") as bag:
        bag.tf(99.0, "base_link", "laser", roll=math.radians(40), topic="/tf_static")
        bag.scan(100.0)
        bag.odom(100.0, 0.0, 0.0, 0.0)
    assert "tilted by 40 degrees" in " ".join(open_log(bag.path).warnings)


def test_ranges_follow_the_messages_limits(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag2") as bag:
        bag.scan(100.0, ranges=(1.0, math.nan, 0.05, 0.0, -1.0, math.inf, 30.0, 29.5, 90.0))
        bag.scan(101.0, ranges=(1.0, 90.0), maximum=100.0)
    log, (scan, far) = read(bag.path)
    assert len(scan.points) == 2 and len(scan.no_return) == 3 and len(far.no_return) == 1
    assert any("4 beams dropped" in w and "message 1" in w for w in log.warnings)
    assert any("no odometry" in w for w in log.warnings)


def test_several_lasers_have_to_be_chosen(tmp_path: Path) -> None:
    with Bag(tmp_path, "mcap") as bag:
        for i in range(3):
            bag.scan(100.0 + i, topic="/front/laser")
            bag.scan(100.0 + i, ranges=(1.0,) * 4, topic="/rear/laser")
    with pytest.raises(LogError, match=r"several .*/front/laser, /rear/laser; choose one with scan_topic"):
        open_log(bag.path)
    _, events = read(bag.path, scan_topic="/rear/laser")
    assert [len(e.points) for e in events] == [4, 4, 4]
    with pytest.raises(LogError, match=r"on topic /nowhere; topics are /front/laser \(sensor_msgs/LaserScan\)"):
        open_log(bag.path, LogSettings(scan_topic="/nowhere"))


def test_topic_called_scan_is_preferred(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag1") as bag:
        bag.scan(100.0, topic="/scan_filtered", ranges=(1.0,))
        bag.scan(100.0, topic="/scan")
        bag.odom(100.0, 1.0, 0.0, 0.0, topic="/odom")
        bag.odom(100.0, 2.0, 0.0, 0.0, topic="/odom_filtered")
    _, events = read(bag.path)
    assert [len(e.points) for e in events if isinstance(e, Scan)] == [3]
    _, events = read(bag.path, odometry_topic="/odom_filtered")
    assert [e.pose.x for e in events if isinstance(e, Odometry)] == [2.0]


def test_bag_without_a_laser_lists_its_topics(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag2") as bag:
        bag.odom(100.0, 1.0, 0.0, 0.0)
    with pytest.raises(LogError, match=r"no sensor_msgs/LaserScan; topics are /odom \(nav_msgs/Odometry\)"):
        open_log(bag.path)


def test_format_is_found_by_content(tmp_path: Path) -> None:
    for kind, suffix in (("rosbag1", ".bag"), ("rosbag2", ".db3"), ("mcap", ".mcap")):
        folder = tmp_path / kind
        folder.mkdir()
        path = drive(folder, kind)
        storage = path if path.is_file() else next(path.glob(f"*{suffix}"))
        log, events = read(storage)
        assert log.format == kind and len(events) == 10
        renamed = folder / "recording.dat"
        renamed.write_bytes(storage.read_bytes())
        log, events = read(renamed)
        assert log.format == kind and len(events) == 10


@pytest.mark.parametrize("kind", ["rosbag1", "rosbag1-bz2", "mcap", "mcap-zstd"])
def test_bag_without_its_index_is_read_up_to_its_end(tmp_path: Path, kind: str) -> None:
    path = drive(tmp_path, kind, 400)
    if path.is_dir():
        path = next(path.glob("*.mcap"))
    data = path.read_bytes()
    cut = tmp_path / f"cut{path.suffix}"
    # Without the last bytes the index is unsound; the messages are all there.
    cut.write_bytes(data[:-100])
    log, events = read(cut)
    assert len(events) == 800
    (warning,) = log.warnings
    assert warning.startswith(f"cut{path.suffix}: the bag has no sound index") and "reindex" in warning
    assert len(list(log)) == 800 and len(log.warnings) == 1
    whole, _ = read(path)
    assert whole.warnings == []
    if kind in ("rosbag1", "mcap"):
        cut.write_bytes(data[: len(data) // 3])
        log, events = read(cut)
        assert 100 < len(events) < 500 and "reindex" in log.warnings[0]


def test_unclosed_ros1_bag(tmp_path: Path) -> None:
    path = drive(tmp_path, "rosbag1")
    data = path.read_bytes()
    place = data.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(data[:place] + bytes(8) + data[place + 8 :])
    log, events = read(path)
    assert len(events) == 10 and "no sound index" in log.warnings[0]


def test_truncated_sqlite_bag_is_one_clear_line(tmp_path: Path) -> None:
    path = next(drive(tmp_path, "rosbag2", 400).glob("*.db3"))
    path.write_bytes(path.read_bytes()[:6000])
    with pytest.raises(LogError, match=r"run\.db3.*ros2 bag reindex") as caught:
        list(open_log(path))
    assert "\n" not in str(caught.value)


def test_bad_message_is_skipped_and_counted(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag1") as bag:
        for i in range(3):
            bag.scan(100.0 + i, ranges=() if i == 1 else (1.0, 1.0, 2.0), frame="base_link")
            bag.odom(100.0 + i, 0.0, 0.0, 0.0, length=0.0 if i == 1 else 1.0)
    log, events = read(bag.path)
    assert len(events) == 4 and log.skipped == 2
    assert log.warnings == ["run.bag: 2 messages skipped, the first at message 3 (/scan): a scan of 0 beams"]


def test_scans_do_not_wait_for_ever_for_odometry(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag1") as bag:
        bag.odom(100.0, 1.0, 0.0, 0.0)
        for i in range(50):
            bag.scan(100.0 + 0.2 * i)
    log = open_log(bag.path)
    _, events = read(bag.path)
    assert len(events) == 51 and all(e.odometry.x == 1.0 for e in events[1:])
    reading = iter(log)
    for _ in range(10):
        next(reading)
    assert log.fraction() < 0.9


def test_empty_laser_topic_is_an_error(tmp_path: Path) -> None:
    with Bag(tmp_path, "rosbag2") as bag:
        bag.connections["/scan"] = bag.writer.add_connection("/scan", LASER, typestore=bag.store)
        bag.odom(100.0, 1.0, 0.0, 0.0)
    with pytest.raises(LogError, match="no laser reading on topic /scan"):
        list(open_log(bag.path))


@pytest.mark.data
def test_real_bag_agrees_with_the_same_log_as_text(data_dir: Path) -> None:
    bag, events = read(data_dir / "laser2d" / "csail_first120s.bag")
    assert (bag.scans, bag.odometry) == (563, 563)
    assert [text.partition(": ")[2][:38] for text in bag.warnings] == ["tf does not say how the laser ('laser'"]
    text = iter(open_log(data_dir / "laser2d" / "mit-csail.clf.gz"))
    for scan in (e for e in events if isinstance(e, Scan)):
        same = next(text)
        np.testing.assert_allclose(scan.points, same.points, atol=1e-4)
        assert scan.odometry.is_close(same.odometry, 1e-5, 1e-5)
        assert len(scan.no_return) == len(same.no_return)


@pytest.mark.data
def test_real_lidar_bag_is_refused(data_dir: Path) -> None:
    with pytest.raises(LogError, match=r"no sensor_msgs/LaserScan; topics are /points \(sensor_msgs/PointCloud2\)"):
        open_log(data_dir / "lidar3d" / "hall")
