"""Frames and mounts in bags: every point, placed by odometry and mount, must lie on the wall that the beams met."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from hexmap.base.errors import FileAccessError, HexmapError, LogError, TooLargeError
from hexmap.io.logs.open_log import is_log, open_log
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from tests.io.logs.test_bags import LASER, ODOMETRY, TF, Bag, drive, read

WALL = 10.0
BEAMS = np.array([-0.5, 0.0, 0.5])
G = "geometry_msgs/msg/"


def ranges(T_odom_laser: Pose) -> tuple[float, ...]:
    """What three beams read of the wall x = 10."""
    return tuple((WALL - T_odom_laser.x) / math.cos(T_odom_laser.theta + angle) for angle in BEAMS)


def at(i: int) -> Pose:
    """Where the robot is at the i-th reading."""
    return Pose.planar(0.1 * i, 0.05 * i, 0.02 * i)


def assert_on_the_wall(log, events, without: int = 0) -> None:
    scans = [event for event in events if isinstance(event, Scan)]
    placed = [scan for scan in scans if scan.odometry is not None]
    assert len(scans) - len(placed) == without
    for scan in placed:
        points = (scan.odometry @ (log.mount or Pose.identity(2))).apply(scan.points)
        np.testing.assert_allclose(points[:, 0], WALL, atol=1e-5)


class Frames(Bag):
    """A bag with messages of more freedom."""

    def many(self, stamp: float, *items: tuple, topic: str = "/tf") -> None:
        """Write a tf message of several (parent, child, Pose or quaternion)."""
        found = []
        for parent, child, T in items:
            x, y, q = (T.x, T.y, (0.0, 0.0, math.sin(T.theta / 2), math.cos(T.theta / 2))) if isinstance(T, Pose) else (
                0.0, 0.0, T)  # fmt: skip
            transform = self.type(G + "Transform")(self.type(G + "Vector3")(x, y, 0.0), self.type(G + "Quaternion")(*q))
            found.append(self.type(G + "TransformStamped")(self.header(stamp, parent), child, transform))
        self.write(topic, TF, self.type(TF)(found), stamp)

    def reading(self, stamp: float, T: Pose, frame: str = "odom", child: str = "base_link") -> None:
        zero = self.type(G + "Vector3")(0.0, 0.0, 0.0)
        pose = self.type(G + "Pose")(self.type(G + "Point")(T.x, T.y, 0.0), self._quaternion(0.0, T.theta))
        message = self.type(ODOMETRY)(
            header=self.header(stamp, frame), child_frame_id=child,
            pose=self.type(G + "PoseWithCovariance")(pose, np.zeros(36)),
            twist=self.type(G + "TwistWithCovariance")(self.type(G + "Twist")(zero, zero), np.zeros(36)),
        )  # fmt: skip
        self.write("/odom", ODOMETRY, message, stamp)


FRONT, REAR = Pose.planar(0.3, 0.1, 0.2), Pose.planar(-0.4, 0.0, -0.3)


def test_scans_of_another_frame_on_the_topic_are_left_out_unless_chosen(tmp_path: Path) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        bag.many(99.0, ("base_link", "front", FRONT), ("base_link", "rear", REAR), topic="/tf_static")
        for i in range(5):
            bag.reading(100.0 + i, at(i))
            bag.scan(100.0 + i, ranges(at(i) @ FRONT), frame="front")
            bag.scan(100.0 + i, ranges(at(i) @ REAR), frame="/rear")
    log, events = read(bag.path)
    assert_on_the_wall(log, events)
    assert (log.scans, log.mount.is_close(FRONT)) == (5, True)
    (text,) = log.warnings
    assert "5 scans of other frames on /scan left out" in text and "'rear'" in text and "scan_frame" in text
    log, events = read(bag.path, scan_frame="rear")
    assert_on_the_wall(log, events)
    assert (log.scans, log.mount.is_close(REAR, 1e-9, 1e-9)) == (5, True)
    with pytest.raises(LogError, match=r"no scan of frame 'side' on /scan; frames are 'front', 'rear'"):
        read(bag.path, scan_frame="side")


@pytest.mark.parametrize("names", [("odom_comb", "map"), ("odom", "world"), ("map", ""), ("robot1/odom_wheel", "map")])
@pytest.mark.parametrize("jumping", [True, False])
def test_the_odometry_is_the_parent_of_the_lowest_moving_transform(
    tmp_path: Path, names: tuple[str, str], jumping: bool
) -> None:
    odometry, above = names
    with Frames(tmp_path, "rosbag1") as bag:
        bag.many(99.0, ("base_footprint", "base_link", Pose.planar(0.0, 0.1, 0.0)), ("base_link", "laser", FRONT),
                 topic="/tf_static")  # fmt: skip
        if above and not jumping:
            bag.many(99.0, (above, odometry, Pose.planar(5.0, 6.0, 1.0)), topic="/tf_static")
        for i in range(20):
            if above and jumping:  # a SLAM program corrects
                bag.many(100.0 + 0.1 * i, (above, odometry, Pose.planar(3.0 * (i % 2), 1.0, 0.0)))
            bag.many(100.0 + 0.1 * i, (odometry, "base_footprint", at(i)))
            bag.scan(100.0 + 0.1 * i, ranges(at(i) @ Pose.planar(0.0, 0.1, 0.0) @ FRONT))
    log, events = read(bag.path)
    assert log.odometry == 20 and log.warnings == []
    assert_on_the_wall(log, events)


def test_a_robot_that_stands_still_at_first_is_followed_all_the_same(tmp_path: Path) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        for i in range(40):
            T = at(max(i - 20, 0))
            # Without tf_static: what stands still comes on /tf, again and again, as does a correction.
            bag.many(100.0 + 0.1 * i, ("base_link", "laser", FRONT), ("map", "odom", Pose.planar(0.1 * i, 0.0, 0.0)))
            bag.many(100.0 + 0.1 * i, ("odom", "base_link", T))
            bag.scan(100.0 + 0.1 * i, ranges(T @ FRONT))
    log, events = read(bag.path)
    assert log.odometry == 40 and log.mount.is_close(FRONT, 1e-9, 1e-9)
    assert_on_the_wall(log, events)


@pytest.mark.parametrize("frame", ["map", "odom_link"])
def test_what_an_odometry_message_names_is_no_joint_of_the_mount(tmp_path: Path, frame: str) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        bag.many(99.0, ("base_link", "laser", FRONT), topic="/tf_static")
        for i in range(5):
            bag.many(100.0 + i, ("odom_link", "base_link", at(i + 3)))
            bag.reading(100.0 + i, at(i + 3), frame, "odom_link")
            bag.scan(100.0 + i, ranges(at(i + 3) @ FRONT))
    log, events = read(bag.path)
    assert log.mount.is_close(FRONT, 1e-9, 1e-9) and log.warnings == []
    assert_on_the_wall(log, events)


@pytest.mark.parametrize("bad", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0)])
def test_a_bad_transform_costs_itself_only(tmp_path: Path, bad: tuple) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        bag.many(99.0, ("base_link", "imu", bad), ("base_link", "laser", FRONT), topic="/tf_static")
        for i in range(5):
            bag.many(100.0 + i, ("base_link", "wheel", bad), ("odom", "base_link", at(i)))
            bag.scan(100.0 + i, ranges(at(i) @ FRONT))
    log, events = read(bag.path)
    assert log.odometry == 5
    assert_on_the_wall(log, events)
    still, moving = log.warnings
    assert "1 transform of /tf_static ignored, the first base_link -> imu" in still
    assert "5 transforms of tf ignored" in moving and "base_link -> wheel" in moving
    assert len(list(log)) == 10 and len(log.warnings) == 2


def test_the_last_static_transform_of_a_frame_counts(tmp_path: Path) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        bag.many(99.0, ("base_link", "laser", REAR), topic="/tf_static")
        bag.many(99.5, ("base_link", "laser", FRONT), topic="/tf_static")
        for i in range(5):
            bag.reading(100.0 + i, at(i))
            bag.scan(100.0 + i, ranges(at(i) @ FRONT))
    log, events = read(bag.path)
    assert log.mount.is_close(FRONT, 1e-9, 1e-9)
    assert_on_the_wall(log, events)


@pytest.mark.parametrize("topic", [True, False])
def test_the_mount_of_a_scan_is_that_at_its_time(tmp_path: Path, topic: bool) -> None:
    """A mast stands on the robot, on it a joint turns, on that the laser sits."""
    mast, arm = Pose.planar(0.2, 0.0, 0.1), Pose.planar(0.0, 0.0, 0.0)

    def joint(stamp: float) -> Pose:
        return Pose.planar(0.0, 0.0, 0.4 * math.sin(stamp - 100.0))

    with Frames(tmp_path, "rosbag1") as bag:
        bag.many(99.0, ("base_link", "mast", mast), ("pan", "laser", arm), topic="/tf_static")
        for i in range(40):
            stamp = 100.0 + 0.1 * i
            bag.many(stamp, ("mast", "pan", joint(stamp)))
            if topic:
                bag.reading(stamp, at(i))
            else:
                bag.many(stamp, ("odom", "base_link", at(i)))
            # Between two readings of joint and odometry, both of which are on their way there.
            between = Pose.planar(0, 0, 0.5 * (joint(stamp).theta + joint(stamp + 0.1).theta))
            there = Pose.planar(0.1 * (i + 0.5), 0.05 * (i + 0.5), 0.02 * (i + 0.5))
            if i < 39:
                bag.scan(stamp + 0.05, (*ranges(there @ mast @ between @ arm)[:2], 90.0))
    log, events = read(bag.path)
    assert log.mount.is_close(mast, 1e-9, 1e-9) and log.warnings == []
    assert_on_the_wall(log, events)
    scan = [event for event in events if isinstance(event, Scan)][10]
    turned = 0.5 * (joint(101.0).theta + joint(101.1).theta)
    ray = scan.no_return[0]
    assert math.isclose(math.atan2(ray[1], ray[0]), 0.5 + turned, abs_tol=1e-6)


def test_a_laser_that_is_moved_sideways_is_told_of(tmp_path: Path) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        for i in range(10):
            lift = Pose.planar(0.1 * i, 0.0, 0.0)
            bag.many(100.0 + i, ("base_link", "laser", lift))
            bag.reading(100.0 + i, at(i))
            bag.scan(100.0 + i, ranges(at(i) @ lift))
    log, events = read(bag.path)
    assert_on_the_wall(log, events)
    assert len(log.warnings) == 1 and "moves on its robot by up to 0.90 m" in log.warnings[0]


@pytest.mark.parametrize("tf", [True, False])
def test_no_tf_is_told_as_tf_without_the_frame_is(tmp_path: Path, tf: bool) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        if tf:
            bag.many(99.0, ("base_link", "camera", FRONT), topic="/tf_static")
        bag.reading(100.0, at(0))
        bag.scan(100.0)
    log, _ = read(bag.path)
    assert log.mount is None
    assert log.warnings == ["run.bag: tf does not say how the laser ('laser') is mounted on the robot ('base_link')"]


def test_scans_before_the_first_reading_have_no_odometry(tmp_path: Path) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        for i in range(20):
            if i >= 8:
                bag.reading(100.0 + 0.1 * i, at(i))
            bag.scan(100.0 + 0.1 * i, ranges(at(i)), frame="base_link")
    log, events = read(bag.path)
    assert_on_the_wall(log, events, without=8)
    assert log.warnings == []


def test_a_scan_that_comes_late_has_the_odometry_of_its_own_time(tmp_path: Path) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        for i in range(100):
            bag.reading(100.0 + 0.01 * i, at(i))
            if i >= 30:  # stamped 0.3 s ago, thirty readings before
                message = bag.type(LASER)(
                    header=bag.header(100.0 + 0.01 * (i - 30), "base_link"), angle_min=-0.5, angle_max=0.5,
                    angle_increment=0.5, time_increment=0.0, scan_time=0.0, range_min=0.1, range_max=30.0,
                    ranges=np.array(ranges(at(i - 30)), np.float32), intensities=np.zeros(0, np.float32),
                )  # fmt: skip
                bag.write("/scan", LASER, message, 100.0 + 0.01 * i)
    log, events = read(bag.path)
    assert log.scans == 70
    assert_on_the_wall(log, events)


def laser(bag: Bag, stamp: float, first: float, last: float, step: float, beams: int) -> None:
    message = bag.type(LASER)(
        header=bag.header(stamp, "base_link"), angle_min=first, angle_max=last, angle_increment=step,
        time_increment=0.0, scan_time=0.0, range_min=0.1, range_max=30.0, ranges=np.ones(beams, np.float32),
        intensities=np.zeros(0, np.float32),
    )  # fmt: skip
    bag.write("/scan", LASER, message, stamp)


@pytest.mark.parametrize(
    ("first", "last", "step", "numbers"),
    [
        (-2.0, 2.0, -0.02, ("-0.02", "span -4 rad", "are 4")),
        (-2.0, 2.0, 0.04, ("0.04", "span 8 rad", "are 4")),
        (-2.0, 2.0, math.degrees(0.02), ("1.14592", "are 4")),
        (-115.0, 115.0, 1.15, ("span 230 rad", "more than a turn; degrees, perhaps")),
        (-2.0, math.nan, 0.02, ("angle_max nan",)),
    ],
)
def test_a_scan_that_contradicts_itself_is_warned_of_with_the_numbers(
    tmp_path: Path, first: float, last: float, step: float, numbers: tuple[str, ...]
) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        bag.reading(100.0, at(0))
        for i in range(3):
            laser(bag, 100.0 + i, first, last, step, 201)
    log, _ = read(bag.path)
    (text,) = log.warnings
    assert "3 scans whose angles contradict each other" in text and all(number in text for number in numbers)
    log, _ = read(bag.path, angle_min=-2.0, angle_step=0.02)
    assert log.warnings == [], "who sets the angles has been heard"


@pytest.mark.parametrize("extra", [-1, 0, 1])
def test_drivers_that_count_one_beam_more_or_less_contradict_nothing(tmp_path: Path, extra: int) -> None:
    with Frames(tmp_path, "rosbag1") as bag:
        bag.reading(100.0, at(0))
        laser(bag, 100.0, -math.pi, -math.pi + math.radians(359 + extra), math.radians(1.0), 360)
    log, _ = read(bag.path)
    assert log.warnings == []


def test_the_first_echo_of_each_beam_is_read(tmp_path: Path) -> None:
    kind = "sensor_msgs/msg/MultiEchoLaserScan"
    with Frames(tmp_path, "rosbag1") as bag:
        echo = bag.type("sensor_msgs/msg/LaserEcho")
        beams = [echo(np.array(values, np.float32)) for values in ((2.0, 5.0), (), (3.0,))]
        message = bag.type(kind)(
            header=bag.header(100.0, "base_link"), angle_min=-0.5, angle_max=0.5, angle_increment=0.5,
            time_increment=0.0, scan_time=0.0, range_min=0.1, range_max=30.0, ranges=beams, intensities=[],
        )  # fmt: skip
        bag.write("/echoes", kind, message, 100.0)
        bag.reading(100.0, at(0))
    log, events = read(bag.path)
    (scan,) = (event for event in events if isinstance(event, Scan))
    np.testing.assert_allclose(np.linalg.norm(scan.points, axis=1), [2.0, 3.0])
    assert "1 beam dropped" in log.warnings[0]


def mcap(path: Path, messages, schema: str, encoding: str, definition: dict[str, str], chunk: bytes = b"") -> Path:
    """Write an MCAP file by hand: (topic, type, nanoseconds, raw message)."""

    def text(value: str) -> bytes:
        return struct.pack("<I", len(value.encode())) + value.encode()

    def record(op: int, body: bytes) -> bytes:
        return struct.pack("<BQ", op, len(body)) + body

    out = b"\x89MCAP0\r\n" + record(1, text("") + text("test"))
    numbers: dict[str, int] = {}
    for topic, kind, time, raw in messages:
        if topic not in numbers:
            number = numbers[topic] = len(numbers) + 1
            out += record(3, struct.pack("<H", number) + text(kind) + text(schema) + text(definition.get(kind, "")))
            out += record(4, struct.pack("<HH", number, number) + text(topic) + text(encoding) + struct.pack("<I", 0))
        out += record(5, struct.pack("<HIQQ", numbers[topic], 0, time, time) + raw)
    path.write_bytes(out + chunk + record(15, bytes(4)) + record(2, bytes(20)) + b"\x89MCAP0\r\n")
    return path


def raw_messages(ros1: bool, order: str = "time") -> tuple[list, dict[str, str]]:
    """Return messages of a drive as raw bytes, and the definitions of their types."""
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    found = []

    class Collector(Frames):
        def __init__(self) -> None:
            self.ros1, self.store = ros1, store

        def write(self, topic, kind, message, stamp) -> None:
            raw = store.serialize_ros1(message, kind) if ros1 else store.serialize_cdr(message, kind)
            name = kind.replace("/msg/", "/") if ros1 else kind
            found.append((topic, name, round(stamp * 1e9), bytes(raw)))

    bag = Collector()
    for i in range(10):
        bag.reading(100.0 + i, at(i))
        bag.scan(100.0 + i, ranges(at(i)), frame="base_link")
    if order == "topic":
        found.sort(key=lambda message: message[0])
    texts = {}
    for kind in (LASER, ODOMETRY):
        texts[kind.replace("/msg/", "/") if ros1 else kind] = store.generate_msgdef(kind, ros_version=1 if ros1 else 2)[
            0
        ]
    return found, texts


@pytest.mark.parametrize("order", ["time", "topic"])
@pytest.mark.parametrize("ros1", [True, False])
def test_messages_of_both_ros_in_mcap(tmp_path: Path, ros1: bool, order: str) -> None:
    messages, texts = raw_messages(ros1, order)
    path = mcap(tmp_path / "a.mcap", messages, "ros1msg" if ros1 else "ros2msg", "ros1" if ros1 else "cdr", texts)
    log, events = read(path)
    assert (log.scans, log.odometry) == (10, 10) and log.warnings == []
    assert_on_the_wall(log, events)
    assert isinstance(events[0], Odometry), "by time, as the robot saw it"


def test_idl_schemas_and_definitions_of_no_interest(tmp_path: Path) -> None:
    messages, _ = raw_messages(False)
    idl = """module builtin_interfaces { module msg { struct Time { int32 sec; uint32 nanosec; }; }; };
        module std_msgs { module msg { struct Header { builtin_interfaces::msg::Time stamp; string frame_id; }; }; };
        module sensor_msgs { module msg { struct LaserScan { std_msgs::msg::Header header; float angle_min;
        float angle_max; float angle_increment; float time_increment; float scan_time; float range_min;
        float range_max; sequence<float> ranges; sequence<float> intensities; }; }; };"""
    messages.append(("/odd", "odd_msgs/msg/Odd", 10**11, b"\0\1\0\0"))
    path = mcap(tmp_path / "a.mcap", messages, "ros2idl", "cdr", {LASER: idl, "odd_msgs/msg/Odd": "float99 x ("})
    log, events = read(path)
    assert log.scans == 10 and log.warnings == []
    assert_on_the_wall(log, events)


def test_another_encoding_is_said_in_words(tmp_path: Path) -> None:
    path = mcap(tmp_path / "a.mcap", [("/scan", LASER, 1, b"{}")], "jsonschema", "json", {})
    with pytest.raises(LogError, match=r"on /scan are in the encoding 'json'; those of ROS 1 and ROS 2 \(cdr\)"):
        open_log(path)


def test_a_definition_of_no_interest_that_cannot_be_parsed_costs_no_word(tmp_path: Path) -> None:
    path = drive(tmp_path, "rosbag1")
    with Bag(tmp_path / "b" if (tmp_path / "b").mkdir() is None else tmp_path, "rosbag1") as bag:
        connection = bag.writer.add_connection("/odd", "my_msgs/msg/Odd", msgdef="float99 x", md5sum="0" * 32)
        bag.writer.write(connection, 1, b"")
        bag.scan(100.0, frame="base_link")
        bag.odom(100.0, 0.0, 0.0, 0.0)
    for file in (path, bag.path):
        assert read(file)[0].warnings == []


@pytest.mark.parametrize("kind", ["rosbag1", "rosbag2", "mcap"])
def test_the_parts_of_a_recording_are_read_in_order(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / "split"
    folder.mkdir()
    suffix = {"rosbag1": ".bag", "rosbag2": ".db3", "mcap": ".mcap"}[kind]
    for part in range(11):
        (tmp_path / str(part)).mkdir()
        with Frames(tmp_path / str(part), kind) as bag:
            if part == 0:
                bag.many(99.0, ("base_link", "laser", FRONT), topic="/tf_static")
            bag.reading(100.0 + part, at(part))
            bag.scan(100.0 + part, ranges(at(part) @ FRONT))
        storage = bag.path if bag.path.is_file() else next(bag.path.glob(f"*{suffix}"))
        (folder / f"run_{part}{suffix}").write_bytes(storage.read_bytes())
    assert is_log(folder)
    log, events = read(folder)
    assert log.format == kind and log.warnings == []
    assert [event.stamp for event in events if isinstance(event, Scan)] == [100.0 + part for part in range(11)]
    assert_on_the_wall(log, events)
    assert log.fraction() == 1.0
    (folder / f"other{suffix}").write_bytes(b"")
    with pytest.raises(LogError, match="not the parts of one recording; name the file to read"):
        open_log(folder)


def test_a_missing_part_is_named(tmp_path: Path) -> None:
    path = drive(tmp_path, "mcap")
    next(path.glob("*.mcap")).unlink()
    with pytest.raises(FileAccessError, match=r"run.*\.mcap: no such file, a part of the recording"):
        open_log(path)


def bomb1(path: Path, compression: str, packed: bytes) -> Path:
    """Write a ROS 1 bag without index whose one chunk inflates to a gigabyte."""

    def fields(**values: bytes) -> bytes:
        body = b"".join(
            struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
            for name, value in values.items()
        )
        return struct.pack("<I", len(body)) + body

    chunk = fields(op=b"\x05", compression=compression.encode(), size=struct.pack("<I", 1 << 30))
    path.write_bytes(b"#ROSBAG V2.0\n" + chunk + struct.pack("<I", len(packed)) + packed)
    return path


def test_chunks_inflate_to_no_more_than_is_stated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import bz2
    import tracemalloc

    packer = bz2.BZ2Compressor()
    packed = b"".join(packer.compress(bytes(1 << 24)) for _ in range(20)) + packer.flush()
    path = bomb1(tmp_path / "bomb.bag", "bz2", packed)
    assert path.stat().st_size < 10_000
    tracemalloc.start()
    with pytest.raises(
        TooLargeError, match=r"bomb\.bag: a chunk of [0-9]+ bytes \(bz2\) inflates to more than 67108864"
    ):
        open_log(path)
    assert tracemalloc.get_traced_memory()[1] < 300e6
    tracemalloc.stop()
    monkeypatch.setenv("HEXMAP_MAX_INFLATION", "none")
    with pytest.raises(HexmapError, match="HEXMAP_MAX_INFLATION is a whole number of times, not 'none'"):
        open_log(path)


def test_lengths_that_no_file_has_are_not_allocated(tmp_path: Path) -> None:
    messages, texts = raw_messages(False)
    chunk = struct.pack("<BQQQQII", 6, 1 << 62, 0, 1, 1 << 62, 0, 4) + b"zstd" + struct.pack("<Q", 1 << 62)
    path = mcap(tmp_path / "a.mcap", messages, "ros2msg", "cdr", texts, chunk)
    log, events = read(path)
    assert len(events) == 20 and "no sound index" in log.warnings[0]


def test_the_name_of_a_part_stands_in_messages_as_printable_text(tmp_path: Path) -> None:
    path = drive(tmp_path, "mcap")
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace(".mcap", "\u2028.mcap"))
    with pytest.raises(HexmapError) as caught:
        open_log(path)
    assert str(caught.value).isprintable()
