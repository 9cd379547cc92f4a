"""ROS 1 bags, ROS 2 bags and MCAP files: a planar laser with odometry or tf.

The scans are sensor_msgs/LaserScan. The odometry is nav_msgs/Odometry where there is one, else
it comes from tf: the chain of frames from the laser upwards, to the frame called ``odom`` or
else to the root (so ``map`` only where there is no ``odom``); the robot is ``base_link``, else
``base_footprint``, else the frame right below the odometry's. How the laser is mounted comes
from tf, too.

Scans carry the odometry at their own stamp, interpolated between the readings around it; a scan
therefore waits for the next reading, and the order of the file is kept.

Everything is planar: of poses x, y and yaw are used. A laser mounted upside down has its points
mirrored, so that the mount is a pose of the plane again.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections import deque
from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hexmap.base.errors import FileAccessError, LogError, MissingDependencyError
from hexmap.base.text import reason, shown
from hexmap.io.logs.log import Log, LogSettings, file_size
from hexmap.io.read_file import cannot_read
from hexmap.poses.pose import Pose, wrap_angle
from hexmap.poses.scan import Event, Odometry, Scan

__all__ = ["BagLog"]

_LASER = "sensor_msgs/msg/LaserScan"
_ODOMETRY = "nav_msgs/msg/Odometry"
_TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
# How many tf messages are looked through for the frames between laser and odometry.
_TF_LOOK_AHEAD = 5000
# How many events a scan waits for the odometry reading after it, and how long in seconds.
_WAIT_EVENTS = 200
_WAIT_SECONDS = 2.0
# Below this cosine (25 degrees) between the axes a laser is not planar any more.
_TILT = 0.9

_ADVICE = {
    "rosbag1": "`rosbag reindex` may repair it",
    "mcap": "`mcap recover` or `ros2 bag reindex` may repair it",
    "rosbag2": "`ros2 bag reindex` may repair it",
}

Edges = dict[str, tuple[str, Pose]]


class _Source(Protocol):
    """A bag, whatever its format; times are in nanoseconds."""

    topics: dict[str, str]

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]: ...
    def deserialize(self, raw: bytes, kind: str) -> Any: ...
    def fraction(self, nanoseconds: int) -> float: ...
    def close(self) -> None: ...


class _Indexed:
    """A bag through rosbags' AnyReader."""

    def __init__(self, path: Path, kind: str) -> None:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self._stack = contextlib.ExitStack()
        try:
            named = self._well_named(path, kind)
            # Old ROS 2 bags do not say what their messages look like; laser, odometry and tf never changed.
            reader = AnyReader([named], default_typestore=get_typestore(Stores.LATEST))
            self._reader = self._stack.enter_context(reader)
        except BaseException:
            self._stack.close()
            raise
        self.topics = {c.topic: c.msgtype for c in self._reader.connections}

    def _well_named(self, path: Path, kind: str) -> Path:
        """Return a path with the suffix by which rosbags tells the formats, a link if need be."""
        suffix = {"rosbag1": ".bag", "rosbag2": ".db3", "mcap": ".mcap"}[kind]
        if path.is_dir() or path.suffix == suffix:
            return path
        folder = self._stack.enter_context(tempfile.TemporaryDirectory())
        link = Path(folder) / f"log{suffix}"
        link.symlink_to(path.resolve())
        return link

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, bytes]]:
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return  # rosbags takes none for all
        for connection, nanoseconds, raw in self._reader.messages(connections=chosen):
            yield connection.topic, nanoseconds, raw

    def deserialize(self, raw: bytes, kind: str) -> Any:
        return self._reader.deserialize(raw, kind)

    def fraction(self, nanoseconds: int) -> float:
        duration = self._reader.duration
        return (nanoseconds - self._reader.start_time) / duration if duration > 0 else 1.0

    def close(self) -> None:
        self._stack.close()


class BagLog(Log):
    """A bag; see :class:`hexmap.io.logs.Log`.

    Attributes:
        scan_topic: the topic of the scans.
        odometry_topic: the topic of the odometry, or None where it comes from tf or not at all.
    """

    _unit = "message"

    def __init__(self, path: Path, settings: LogSettings, kind: str) -> None:
        """Choose the topics and find the frames.

        Raises:
            FileAccessError: the file cannot be read.
            LogError: the bag is damaged beyond reading, or has no laser, or several.
        """
        self.format = kind
        try:
            size = file_size(path)
        except OSError as error:
            raise cannot_read(path, error) from error
        super().__init__(path, settings, size)
        self._without_index = False
        self._mirrored = False
        # Frames from the odometry's down to the robot's, where the odometry comes from tf.
        self._tf_chain: list[str] = []
        source = self._open()
        try:
            self._tf_topics = [topic for topic, kind in source.topics.items() if kind in _TF]
            self.scan_topic = self._choose(source.topics, _LASER, settings.scan_topic, "scan", "scan_topic")
            self.odometry_topic = self._find_odometry(source.topics)
            self._find_frames(source)
        except (LogError, FileAccessError):
            raise
        except Exception as error:  # a damaged bag surfaces as any error of the parsers below
            raise LogError(f"{path}: the bag cannot be read: {reason(error)}") from error
        finally:
            source.close()

    def _open(self) -> _Source:
        source, note = open_source(self.path, self.format, self._without_index)
        if note is not None:
            self._without_index = True
            self._notes.append(note)
        return source

    def _advice(self) -> str:
        return _ADVICE[self.format]

    def _choose(self, topics: dict[str, str], kind: str, wanted: str | None, last_name: str, setting: str) -> str:
        """Return the topic of a message type: the one wanted, the only one, or the one of that last name.

        Raises:
            LogError: there is none, or no telling which.
        """
        short = kind.replace("/msg/", "/")
        found = sorted(topic for topic, its_kind in topics.items() if its_kind == kind)
        if wanted is not None:
            for topic in found:
                if topic.strip("/") == wanted.strip("/"):
                    return topic
            raise LogError(f"{self.path}: no {short} on topic {wanted}; topics are {_list(topics)}")
        if not found:
            raise LogError(f"{self.path}: no {short}; topics are {_list(topics)}")
        named = [topic for topic in found if topic.rsplit("/", 1)[-1] == last_name]
        if len(found) == 1 or len(named) == 1:
            return found[0] if len(found) == 1 else named[0]
        raise LogError(f"{self.path}: several {short}: {', '.join(found)}; choose one with {setting}")

    def _find_odometry(self, topics: dict[str, str]) -> str | None:
        wanted = self.settings.odometry_topic
        if wanted is None and _ODOMETRY not in topics.values():
            return None
        return self._choose(topics, _ODOMETRY, wanted, "odom", "odometry_topic")

    def _first(self, source: _Source, topic: str) -> Any:
        """Return the first message of a topic that can be decoded, or None."""
        for _, _, raw in source.messages([topic]):
            with contextlib.suppress(Exception):
                return source.deserialize(raw, source.topics[topic])
        return None

    def _find_frames(self, source: _Source) -> None:
        """Find the mount of the laser and, without an odometry topic, the chain of frames to follow."""
        scan = self._first(source, self.scan_topic)
        if scan is None:
            return  # iterating ends with the error about it
        laser = _frame(scan.header.frame_id)
        reading = self._first(source, self.odometry_topic) if self.odometry_topic else None
        robot = _frame(reading.child_frame_id) if reading is not None else ""
        if not self._tf_topics:
            if self.odometry_topic is None:
                self._notes.append("no odometry: neither nav_msgs/Odometry nor tf")
            return
        edges, moving = self._edges(source, laser, robot)
        chain = _chain(edges, laser)
        if self.odometry_topic is None:
            top = next((f for f in chain if _last(f) == "odom"), chain[-1])
            below = chain[: chain.index(top)]
            if below and below[-1] in moving:
                robot = _base(below) or below[-1]
                self._tf_chain = chain[chain.index(robot) : chain.index(top) + 1][::-1]
            else:
                self._notes.append(f"no odometry: tf has no moving frame above the laser's ('{shown(laser)}')")
        if not robot or (robot not in edges and robot not in chain):
            robot = _base(chain) or robot
        T = _between(edges, moving, robot, laser) if robot else None
        if T is None:
            self._notes.append(
                f"tf does not say how the laser ('{shown(laser)}') is mounted on the robot ('{shown(robot)}')"
            )
            return
        up = float(T.rotation[2, 2])
        self._mirrored = up < 0.0
        if abs(up) < _TILT:
            self._notes.append(
                f"the laser is tilted by {math.degrees(math.acos(min(abs(up), 1.0))):.0f} degrees; taken as if level"
            )
        # Upside down, R is Rz(yaw) Rx(pi): its first column still is the heading.
        self.mount = Pose.planar(T.x, T.y, T.theta)

    def _edges(self, source: _Source, laser: str, robot: str) -> tuple[Edges, set[str]]:
        """Return the first transform of each frame (child: parent, T_parent_child), and which move.

        Frames on a topic called ``tf_static`` stand still; on ``tf`` they may move.
        """
        edges: Edges = {}
        moving: set[str] = set()
        static = [topic for topic in self._tf_topics if topic.rsplit("/", 1)[-1] == "tf_static"]
        for topics in (static, [topic for topic in self._tf_topics if topic not in static]):
            for count, (topic, _, raw) in enumerate(source.messages(topics) if topics else ()):
                with contextlib.suppress(Exception):
                    for parent, child, _, T in _transforms(source.deserialize(raw, source.topics[topic])):
                        if topics is not static:
                            moving.add(child)
                        edges.setdefault(child, (parent, T))
                if topics is static:
                    continue
                chain = _chain(edges, laser)
                if any(_last(f) == "odom" for f in chain) or count >= _TF_LOOK_AHEAD:
                    break
                if robot and robot in chain:
                    break
        return edges, moving

    def _events(self) -> Iterator[Event]:
        source = self._open()
        try:
            yield from self._waiting(self._messages(source))
        finally:
            source.close()

    def _messages(self, source: _Source) -> Iterator[Event]:
        """Decode the messages; scans are yielded without odometry."""
        topics = [self.scan_topic]
        if self.odometry_topic is not None:
            topics.append(self.odometry_topic)
        elif self._tf_chain:
            topics.extend(self._tf_topics)
        edges: dict[str, Pose] = {}
        messages = iter(source.messages(topics))
        number = 0
        while True:
            try:
                topic, nanoseconds, raw = next(messages)
            except StopIteration:
                return
            except Exception as error:  # damage within the file: what came before is good
                if number == 0:
                    raise LogError(f"{self.path}: the bag cannot be read: {reason(error)}; {self._advice()}") from error
                self._late_notes.append(f"the bag is damaged after message {number}: {reason(error)}")
                return
            number += 1
            self.position = int(self.size * min(max(source.fraction(nanoseconds), 0.0), 1.0))
            events: list[Event] = []
            try:
                message = source.deserialize(raw, source.topics[topic])
                if topic == self.scan_topic:
                    events = [self._scan(message, nanoseconds, number)]
                elif topic == self.odometry_topic:
                    pose = _pose3(message.pose.pose.position, message.pose.pose.orientation)
                    stamp = _stamp(message.header, nanoseconds)
                    events = [Odometry(stamp, Pose.planar(pose.x, pose.y, pose.theta), number)]
                else:
                    events = self._follow(message, nanoseconds, number, edges)
            except Exception as error:  # one bad message, of any kind, is skipped and counted
                self._skipped.add(f"message {number} ({topic}): {reason(error)}")
            yield from events

    def _scan(self, message: Any, nanoseconds: int, number: int) -> Scan:
        ranges = np.asarray(message.ranges, dtype=np.float64)
        first, step = float(message.angle_min), float(message.angle_increment)
        if not len(ranges):
            raise ValueError("a scan of 0 beams")
        if not (math.isfinite(first) and math.isfinite(step)) or (step == 0.0 and len(ranges) > 1):
            raise ValueError(f"beams from {first} by {step}")
        limit, maximum = self.settings.no_return, float(message.range_max)
        if 0.0 < maximum < limit:
            limit = maximum
        directions = self._beams.directions(len(ranges), first, step, self._mirrored)
        points, rays, dropped = self._beams.split(ranges, directions, limit, float(message.range_min))
        if dropped:
            self._dropped.add(f"message {number}", dropped)
        return Scan(_stamp(message.header, nanoseconds), points, rays, None, number)

    def _follow(self, message: Any, nanoseconds: int, number: int, edges: dict[str, Pose]) -> list[Event]:
        """Take the transforms of a tf message; a reading is made when the frame below the odometry's moves."""
        chain = self._tf_chain
        events: list[Event] = []
        for parent, child, header, T in _transforms(message):
            if child not in chain[1:] or parent != chain[chain.index(child) - 1]:
                continue
            edges[child] = T
            if child == chain[1] and all(frame in edges for frame in chain[1:]):
                pose = Pose.identity(3)
                for frame in chain[1:]:
                    pose = pose @ edges[frame]
                events.append(Odometry(_stamp(header, nanoseconds), Pose.planar(pose.x, pose.y, pose.theta), number))
        return events

    def _waiting(self, events: Iterable[Event]) -> Iterator[Event]:
        """Give each scan the odometry at its stamp; it waits for the reading after it, but not for long."""
        if self.odometry_topic is None and not self._tf_chain:
            for event in events:
                yield self._count(event)
            return
        held: deque[Event] = deque()
        before: Odometry | None = None  # the last reading but one
        last: Odometry | None = None
        for event in events:
            if isinstance(event, Odometry):
                before, last = last, event
                for i, waiting in enumerate(held):
                    if isinstance(waiting, Scan) and waiting.odometry is None and waiting.stamp <= event.stamp:
                        held[i] = replace(waiting, odometry=_at(waiting.stamp, before, event))
            elif isinstance(event, Scan) and last is not None and event.stamp <= last.stamp:
                event = replace(event, odometry=_at(event.stamp, before, last))
            held.append(event)
            while held:
                front = held[0]
                if isinstance(front, Scan) and front.odometry is None:
                    if len(held) < _WAIT_EVENTS and abs(event.stamp - front.stamp) < _WAIT_SECONDS:
                        break
                    front = replace(front, odometry=_newest(held, last, before))
                held.popleft()
                yield self._count(front)
        for event in held:
            if isinstance(event, Scan) and event.odometry is None and last is not None:
                event = replace(event, odometry=last.pose)
            yield self._count(event)

    def _count(self, event: Event) -> Event:
        if isinstance(event, Scan):
            self.scans += 1
        else:
            self.odometry += 1
        return event

    def _no_laser(self) -> str:
        return f"{self.path}: no laser reading on topic {self.scan_topic}"


def open_source(path: Path, kind: str, without_index: bool = False) -> tuple[_Source, str | None]:
    """Open a bag of a format, through its index where that is sound; else a note says that it is not.

    Raises:
        FileAccessError: the file cannot be read.
        LogError: the bag is damaged beyond reading.
    """
    if without_index:
        return _unindexed(path, kind), None
    try:
        return _Indexed(path, kind), None
    except ModuleNotFoundError as error:
        raise MissingDependencyError(f"{path}: reading bags takes the package rosbags: {error}") from error
    except PermissionError as error:
        raise cannot_read(path, error) from error
    except Exception as error:  # a damaged bag surfaces as any error of the parsers below
        why = reason(error)
    if path.is_file() and kind in ("rosbag1", "mcap"):
        with contextlib.suppress(Exception):
            source = _unindexed(path, kind)
            if source.topics:
                return source, f"the bag has no sound index ({why}); read up to its last whole record; {_ADVICE[kind]}"
    raise LogError(f"{path}: the bag cannot be read: {why}; {_ADVICE[kind]}")


def _unindexed(path: Path, kind: str) -> _Source:
    from hexmap.io.logs.bag_recovery import UnindexedMcap, UnindexedRosbag1

    return UnindexedRosbag1(path) if kind == "rosbag1" else UnindexedMcap(path)


def topic_list(topics: dict[str, str]) -> str:
    """Return topics and their types in one line."""
    return _list(topics)


def _list(topics: dict[str, str]) -> str:
    if not topics:
        return "none"
    return ", ".join(f"{topic} ({kind.replace('/msg/', '/')})" for topic, kind in sorted(topics.items()))


def _frame(name: str) -> str:
    return name.strip("/")


def _last(frame: str) -> str:
    return frame.rsplit("/", 1)[-1]


def _stamp(header: Any, nanoseconds: int) -> float:
    """Return the stamp in seconds: the header's, or the time of recording where that was never filled in."""
    seconds = header.stamp.sec + header.stamp.nanosec * 1e-9
    return float(seconds if seconds != 0 else nanoseconds * 1e-9)


def _pose3(position: Any, orientation: Any) -> Pose:
    return Pose.from_quaternion(
        (position.x, position.y, position.z), (orientation.x, orientation.y, orientation.z, orientation.w)
    )


def _transforms(message: Any) -> Iterator[tuple[str, str, Any, Pose]]:
    """Yield (parent, child, header, T_parent_child) of a tf message."""
    for item in message.transforms:
        T = _pose3(item.transform.translation, item.transform.rotation)
        yield _frame(item.header.frame_id), _frame(item.child_frame_id), item.header, T


def _chain(edges: Edges, frame: str) -> list[str]:
    """Return a frame and all above it, up to the root; stops where damaged tf runs in a circle."""
    chain = [frame]
    while chain[-1] in edges and edges[chain[-1]][0] not in chain:
        chain.append(edges[chain[-1]][0])
    return chain


def _base(chain: list[str]) -> str | None:
    for name in ("base_link", "base_footprint"):
        for frame in chain:
            if _last(frame) == name:
                return frame
    return None


def _between(edges: Edges, moving: set[str], robot: str, laser: str) -> Pose | None:
    """Return T_robot_laser by their common frame, or None where there is none.

    Below the robot a joint may come on tf as well as on tf_static; above it only joints that
    stand still count, or the robot's own motion would get into the mount.
    """
    up, down = _chain(edges, robot), _chain(edges, laser)
    common = next((frame for frame in up if frame in down), None)
    if common is None:
        return None
    if common != robot and any(f in moving for f in up[: up.index(common)] + down[: down.index(common)]):
        return None

    def to_common(chain: list[str]) -> Pose:
        T = Pose.identity(3)
        for frame in chain[: chain.index(common)]:
            T = edges[frame][1] @ T
        return T

    return to_common(up).inverse() @ to_common(down)


def _newest(held: Iterable[Event], last: Odometry | None, before: Odometry | None) -> Pose | None:
    """Return the newest pose that is known, for a scan that no reading followed in time."""
    reading = last or before
    return None if reading is None else reading.pose


def _at(stamp: float, before: Odometry | None, after: Odometry) -> Pose:
    """Return the odometry at ``stamp``, which is not after ``after``."""
    if before is None or not before.stamp <= stamp < after.stamp:
        return after.pose
    part = (stamp - before.stamp) / (after.stamp - before.stamp)
    a, b = before.pose, after.pose
    turn = float(wrap_angle(b.theta - a.theta))
    return Pose.planar(a.x + part * (b.x - a.x), a.y + part * (b.y - a.y), a.theta + part * turn)
