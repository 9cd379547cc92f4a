"""ROS 1 bags, ROS 2 bags and MCAP files: a planar laser with odometry or tf.

The scans are sensor_msgs/LaserScan, or of sensor_msgs/MultiEchoLaserScan the first echo of each beam. Those of one
frame are read, the first scan's where no other is asked for; scans of other frames on the topic are counted.

The odometry is nav_msgs/Odometry where there is one, else it comes from tf: the parent of the lowest transform that
moves above the robot's base. How the laser is mounted comes from tf, too (see :mod:`hexmap.io.logs.bag_frames`). Where
a joint of the mount moves, the points of each scan are carried into the laser's frame as it was first mounted, so that
one mount holds for all.

Scans carry the odometry at their own stamp, interpolated between the readings around it; a scan
therefore waits for the next reading, and the order of the file is kept. Scans before the first reading have none.

Everything is planar: of poses x, y and yaw are used. A laser mounted upside down has its points
mirrored, so that the mount is a pose of the plane again.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from hexmap.base.errors import ArgumentError, FileAccessError, LogError, TooLargeError
from hexmap.base.text import plural, reason, shown
from hexmap.io.logs.bag_frames import FrameTree, Joints, frame_name, transforms
from hexmap.io.logs.bag_messages import contradiction, message_stamp, odometry_reading, scan_ranges
from hexmap.io.logs.bag_mount import ODOMETRY, TF, find_frames, first_reading, is_static
from hexmap.io.logs.bag_sources import BagSource
from hexmap.io.logs.log import Log, LogSettings, file_size
from hexmap.io.logs.log_account import Tally
from hexmap.io.logs.open_bag import ADVICE, open_sound_bag, topic_list, topic_name
from hexmap.io.logs.waiting import Waiting
from hexmap.io.read_file import cannot_read
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Odometry, Scan

__all__ = ["BagLog"]

_LASER = "sensor_msgs/msg/LaserScan"
_ECHOES = "sensor_msgs/msg/MultiEchoLaserScan"
# Below this cosine (25 degrees) between the axes a laser is not planar any more.
_TILT = 0.9
# Metres that a laser may move on its robot before where its beams begin is worth a word.
_SHIFT = 0.01


class BagLog(Log):
    """A bag; see :class:`hexmap.io.logs.Log`.

    Attributes:
        scan_topic: the topic of the scans.
        scan_frame: the frame of the scans that are read.
        odometry_topic: the topic of the odometry, or None where it comes from tf or not at all.
    """

    _unit = "message"

    def __init__(self, path: Path, settings: LogSettings, kind: str, parts: list[Path] | None = None) -> None:
        """Choose the topics and find the frames.

        Args:
            path: the file or the folder.
            settings: how it is read.
            kind: "rosbag1", "rosbag2" or "mcap".
            parts: the files of a folder without metadata, in order.

        Raises:
            FileAccessError: the file cannot be read.
            LogError: the bag is damaged beyond reading, or has no laser, or several.
            TooLargeError: a chunk of it inflates to more than may be.
        """
        self.format = kind
        try:
            size = file_size(path)
        except OSError as error:
            raise cannot_read(path, error) from error
        super().__init__(path, settings, size)
        self._parts = parts
        self._mirrored = False
        self._shifted = 0.0
        # Frames from the odometry's down to the robot's, where the odometry comes from tf.
        self._tf_chain: list[str] = []
        self._frames = FrameTree()
        # The frames up from the robot's and from the laser's to where both meet, where the mount moves.
        self._path: tuple[list[str], list[str]] | None = None
        source = self._open()
        if source.trouble:
            self._notes.append(
                f"the bag has no sound index ({source.trouble}); read up to its last whole record; {self._advice()}"
            )
        try:
            self._tf_topics = [topic for topic, kind in source.topics.items() if kind in TF]
            self._refuse_foreign(source)
            self.scan_topic = self._choose_scan(source.topics)
            self.odometry_topic = self._find_odometry(source.topics)
            self.scan_frame = self._find_frames(source)
        except (ArgumentError, LogError, FileAccessError):
            raise
        except TooLargeError as error:
            raise TooLargeError(f"{path}: {error}") from error
        except Exception as error:  # a damaged bag surfaces as any error of the parsers below
            raise LogError(f"{path}: the bag cannot be read: {reason(error)}") from error
        finally:
            source.close()

    def _reset(self) -> None:
        super()._reset()
        self._other_frames = Tally()
        self._bad_transforms = Tally()
        self._contradictions = Tally()

    @property
    def warnings(self) -> list[str]:
        """What was not as it should be, one line each, each naming the file."""
        texts = []
        if self._other_frames.count:
            count = plural(self._other_frames.count, "scan")
            texts.append(
                f"{count} of other frames on {topic_name(self.scan_topic)} left out, the first "
                f"of {self._other_frames.first}; those of '{shown(self.scan_frame)}' are read; choose with scan_frame"
            )
        if self._bad_transforms.count:
            count = plural(self._bad_transforms.count, "transform")
            texts.append(f"{count} of tf ignored, the first {self._bad_transforms.first}")
        if self._contradictions.count:
            texts.append(
                f"{plural(self._contradictions.count, 'scan')} whose angles contradict each other, "
                f"the first at {self._contradictions.first}; see angle_min and angle_step"
            )
        return [*super().warnings, *(f"{self.path.name}: {text}" for text in texts)]

    def _open(self) -> BagSource:
        return open_sound_bag(self.path, self.format, self._parts)

    def _advice(self) -> str:
        return ADVICE[self.format]

    def _refuse_foreign(self, source: BagSource) -> None:
        """Say so where the laser's messages are of an encoding that is none of ROS."""
        foreign: dict[str, str] = getattr(source, "foreign", {})
        lasers = [topic for topic, kind in source.topics.items() if kind in (_LASER, _ECHOES)]
        if lasers and all(topic in foreign for topic in lasers):
            raise LogError(
                f"{self.path}: the messages on {topic_name(lasers[0])} are in the encoding "
                f"{shown(foreign[lasers[0]])!r}; those of ROS 1 and ROS 2 (cdr) are read"
            )

    def _choose_scan(self, topics: dict[str, str]) -> str:
        """Return the topic of the scans; with several echoes only where there is none of a plain laser."""
        wanted = self.settings.scan_topic
        echoes = {topic for topic, kind in topics.items() if kind == _ECHOES}
        named = wanted is not None and any(topic.strip("/") == wanted.strip("/") for topic in echoes)
        kind = _ECHOES if echoes and (named or _LASER not in topics.values()) else _LASER
        return self._choose(topics, kind, wanted, "scan", "scan_topic")

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
            raise LogError(f"{self.path}: no {short} on topic {topic_name(wanted)}; topics are {topic_list(topics)}")
        if not found:
            raise LogError(f"{self.path}: no {short}; topics are {topic_list(topics)}")
        named = [topic for topic in found if topic.rsplit("/", 1)[-1] == last_name]
        if len(found) == 1 or len(named) == 1:
            return found[0] if len(found) == 1 else named[0]
        raise LogError(f"{self.path}: several {short}: {', '.join(map(topic_name, found))}; choose one with {setting}")

    def _find_odometry(self, topics: dict[str, str]) -> str | None:
        wanted = self.settings.odometry_topic
        if wanted is None and ODOMETRY not in topics.values():
            return None
        return self._choose(topics, ODOMETRY, wanted, "odom", "odometry_topic")

    def _first_scan(self, source: BagSource) -> str | None:
        """Return the frame of the scans that are read; None where no scan can be decoded.

        Raises:
            LogError: no scan is of the frame that was asked for.
        """
        wanted = self.settings.scan_frame
        frames: list[str] = []
        for _, _, raw in source.messages([self.scan_topic]):
            try:
                frame = frame_name(source.deserialize(raw, self.scan_topic).header.frame_id)
            except Exception:  # counted when the log is read
                continue
            if wanted is None or frame == frame_name(wanted):
                return frame
            if frame not in frames:
                frames.append(frame)
        if frames:
            names = ", ".join(f"'{shown(frame)}'" for frame in frames[:8])
            topic = topic_name(self.scan_topic)
            raise LogError(f"{self.path}: no scan of frame {wanted!r} on {topic}; frames are {names}")
        return None

    def _find_frames(self, source: BagSource) -> str:
        """Find the mount of the laser and, without an odometry topic, the chain of frames to follow.

        Returns:
            The frame of the scans.
        """
        laser = self._first_scan(source)
        if laser is None:
            return ""  # iterating ends with the error about it
        if not self._tf_topics and self.odometry_topic is None:
            self._notes.append("no odometry: neither nav_msgs/Odometry nor tf")
            return laser
        reading = None if self.odometry_topic is None else first_reading(source, self.odometry_topic)
        found = find_frames(source, self._tf_topics, laser, reading)
        self._frames, self._tf_chain = found.tree, found.chain
        if self.odometry_topic is None and not found.chain:
            self._notes.append(f"no odometry: tf has no moving frame above the laser's ('{shown(laser)}')")
        if found.path is None:
            self._notes.append(
                f"tf does not say how the laser ('{shown(laser)}') is mounted on the robot "
                f"('{shown(found.robot or 'base_link')}')"
            )
        elif found.mount is not None:
            self._take_mount(found.mount)
            self._path = found.path if found.moves else None
        # Transforms that are followed while the log is read are counted then.
        self._notes += found.bad_notes(self._followed())
        return laser

    def _take_mount(self, T: Pose) -> None:
        """Take the mount in space as one of the plane."""
        tilt = float(T.rotation[2, 2])
        self._mirrored = tilt < 0.0
        if abs(tilt) < _TILT:
            self._notes.append(
                f"the laser is tilted by {math.degrees(math.acos(min(abs(tilt), 1.0))):.0f} degrees; taken as if level"
            )
        # Upside down, R is Rz(yaw) Rx(pi): its first column still is the heading.
        self.mount = Pose.planar(T.x, T.y, T.theta)

    def _followed(self) -> list[str]:
        """Return the topics of tf that are read along with the scans."""
        if not self._tf_chain and self._path is None:
            return []
        return [topic for topic in self._tf_topics if not is_static(topic)]

    def _events(self) -> Iterator[Event]:
        source = self._open()
        joints = None if self._path is None else Joints(self._frames, *self._path)
        try:
            waiting = Waiting(self.odometry_topic is not None or bool(self._tf_chain), joints)
            for event in waiting.events(self._messages(source, joints)):
                if isinstance(event, Odometry):
                    self.odometry += 1
                    yield event
                else:
                    self.scans += 1
                    yield event if joints is None else self._carried(event, joints)
        finally:
            source.close()
        if self._shifted > _SHIFT:
            self._late_notes.append(
                f"the laser moves on its robot by up to {self._shifted:.2f} m; where nothing is in its way is counted "
                "from where it was mounted first"
            )

    def _carried(self, scan: Scan, joints: Joints) -> Scan:
        """Return a scan as the laser would have seen it where it was mounted first."""
        T = joints.mount(scan.stamp)
        assert self.mount is not None
        moved = self.mount.inverse() @ Pose.planar(T.x, T.y, T.theta)
        if moved.is_close(Pose.identity(2), 1e-9, 1e-9):
            return scan
        self._shifted = max(self._shifted, math.hypot(moved.x, moved.y))
        return replace(scan, points=moved.apply(scan.points), no_return=scan.no_return @ moved.rotation.T)

    def _messages(self, source: BagSource, joints: Joints | None) -> Iterator[Event]:
        """Decode the messages; scans are yielded without odometry, and joints take what is theirs."""
        self._shifted = 0.0
        topics = [self.scan_topic, *self._followed()]
        if self.odometry_topic is not None:
            topics.append(self.odometry_topic)
        edges = {
            child: self._frames.transform(child) for child in self._tf_chain[1:] if not self._frames.moving([child])
        }
        messages = iter(source.messages(topics))
        number = 0
        while True:
            try:
                topic, nanoseconds, raw = next(messages)
            except StopIteration:
                return
            except Exception as error:  # damage within the file: what came before is good
                if number == 0:
                    kind = TooLargeError if isinstance(error, TooLargeError) else LogError
                    raise kind(f"{self.path}: the bag cannot be read: {reason(error)}; {self._advice()}") from error
                self._late_notes.append(f"the bag is damaged after message {number}: {reason(error)}")
                return
            number += 1
            self.position = int(self.size * min(max(source.fraction(nanoseconds), 0.0), 1.0))
            events: list[Event] = []
            try:
                message = source.deserialize(raw, topic)
                if topic == self.scan_topic:
                    if frame_name(message.header.frame_id) == self.scan_frame:
                        events = [self._scan(message, nanoseconds, number)]
                    else:
                        frame = shown(frame_name(message.header.frame_id))
                        self._other_frames.add(f"'{frame}' at message {number}")
                elif topic == self.odometry_topic:
                    events = [odometry_reading(message, nanoseconds, number)]
                else:
                    where = f"{number} ({topic_name(topic)})"
                    events = self._follow(message, nanoseconds, where, number, edges, joints)
            except Exception as error:  # one bad message, of any kind, is skipped and counted
                self._skipped.add(f"message {number} ({topic_name(topic)}): {reason(error)}")
            yield from events

    def _scan(self, message: Any, nanoseconds: int, number: int) -> Scan:
        ranges = scan_ranges(message)
        first, step = float(message.angle_min), float(message.angle_increment)
        if not len(ranges):
            raise ValueError("a scan of 0 beams")
        if not (math.isfinite(first) and math.isfinite(step)) or (step == 0.0 and len(ranges) > 1):
            if self.settings.angle_min is None or self.settings.angle_step is None:
                raise ValueError(f"beams from {first} by {step}")
        elif self.settings.angle_step is None:
            found = contradiction(first, float(message.angle_max), step, len(ranges))
            if found:
                self._contradictions.add(f"message {number}: {found}")
        limit, maximum = self.settings.no_return, float(message.range_max)
        if 0.0 < maximum < limit:
            limit = maximum
        directions = self._beams.directions(len(ranges), first, step, self._mirrored)
        points, rays, dropped = self._beams.split(ranges, directions, limit, float(message.range_min))
        if dropped:
            self._dropped.add(f"message {number}", dropped)
        return Scan(message_stamp(message.header, nanoseconds), points, rays, None, number)

    def _follow(
        self, message: Any, nanoseconds: int, where: str, number: int, edges: dict[str, Pose], joints: Joints | None
    ) -> list[Event]:
        """Take the transforms of a tf message; a reading is made when the frame below the odometry's moves."""
        chain = self._tf_chain
        events: list[Event] = []
        for parent, child, header, T in transforms(message):
            if isinstance(T, str):
                self._bad_transforms.add(f"at message {where}: {T}")
                continue
            stamp = message_stamp(header, nanoseconds)
            if joints is not None:
                joints.take(parent, child, stamp, T)
            if child not in chain[1:] or parent != chain[chain.index(child) - 1]:
                continue
            edges[child] = T
            if child == chain[1] and all(frame in edges for frame in chain[1:]):
                pose = Pose.identity(3)
                for frame in chain[1:]:
                    pose = pose @ edges[frame]
                events.append(Odometry(stamp, Pose.planar(pose.x, pose.y, pose.theta), number))
        return events

    def _no_laser(self) -> str:
        return f"{self.path}: no laser reading on topic {topic_name(self.scan_topic)}"
