"""Bags with sensor_msgs/PointCloud2: ROS 1, ROS 2 and MCAP.

How the LiDAR is mounted comes from tf (see :mod:`hexmap.io.logs.bag_mount`), as that of a planar laser does. Where a
joint of the mount moves, the points of each scan are carried into the LiDAR's frame as it was first mounted, so that
one mount holds for all.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.errors import FileAccessError, LogError
from hexmap.base.text import plural, reason, shown
from hexmap.io.lidar.lidar_log import LidarLog, LidarLogSettings, returned
from hexmap.io.lidar.point_cloud2 import column, coordinates
from hexmap.io.lidar.point_times import PointTimes
from hexmap.io.logs.bag_frames import Joints, frame_name, transforms
from hexmap.io.logs.bag_messages import message_stamp
from hexmap.io.logs.bag_mount import ODOMETRY, TF, BagFrames, find_frames, first_reading, is_static
from hexmap.io.logs.bag_sources import BagSource
from hexmap.io.logs.log import file_size
from hexmap.io.logs.log_account import Tally
from hexmap.io.logs.open_bag import ADVICE, open_sound_bag, topic_list, topic_name
from hexmap.io.logs.waiting import Waiting
from hexmap.io.read_file import cannot_read
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan

__all__ = ["CLOUD", "LidarBag"]

CLOUD = "sensor_msgs/msg/PointCloud2"
# Packets that only the maker's driver can decode.
_PACKETS = ("velodyne_msgs/msg/VelodyneScan", "ouster_ros/msg/PacketMsg", "livox_ros_driver2/msg/CustomMsg",
            "livox_ros_driver/msg/CustomMsg", "hesai_ros_driver/msg/UdpFrame")  # fmt: skip
# Metres that a LiDAR may move on its robot before where its beams begin is worth a word.
_SHIFT = 0.01


class LidarBag(LidarLog):
    """A bag; see :class:`hexmap.io.lidar.LidarLog`.

    Attributes:
        topic: of the clouds.
        times: how the points' times are read.
    """

    _unit = "message"

    def __init__(self, path: Path, settings: LidarLogSettings, kind: str, parts: list[Path] | None = None) -> None:
        """Choose the topic.

        Args:
            path: the file or the folder.
            settings: how it is read.
            kind: "rosbag1", "rosbag2" or "mcap".
            parts: the files of a folder without metadata, in order.

        Raises:
            FileAccessError: the file cannot be read.
            LogError: the bag is damaged beyond reading, or has no cloud, or several topics of them.
        """
        self.format = kind
        try:
            size = file_size(path)
        except OSError as error:
            raise cannot_read(path, error) from error
        super().__init__(path, settings, size)
        self._parts = parts
        source = self._open()
        if source.trouble:
            self._notes.append(
                f"the bag has no sound index ({source.trouble}); read up to its last whole record; {ADVICE[kind]}"
            )
        try:
            self.topic = self._choose(source.topics)
            self._tf_topics = [topic for topic, kind in source.topics.items() if kind in TF]
            self._frames = self._find_frames(source)
        except LogError:
            raise
        except Exception as error:  # a damaged bag surfaces as any error of the parsers below
            raise LogError(f"{path}: the bag cannot be read: {reason(error)}; {ADVICE[kind]}") from error
        finally:
            source.close()
        self.times = PointTimes()
        self.frame = settings.frame

    def _reset(self) -> None:
        super()._reset()
        self._bad_transforms = Tally()
        self._shifted = 0.0

    def _open(self) -> BagSource:
        return open_sound_bag(self.path, self.format, self._parts)

    def _choose(self, topics: dict[str, str]) -> str:
        found = sorted(topic for topic, kind in topics.items() if kind == CLOUD)
        wanted = self.settings.topic
        if wanted is not None:
            for topic in found:
                if topic.strip("/") == wanted.strip("/"):
                    return topic
            known = topic_list(topics)
            raise LogError(f"{self.path}: no sensor_msgs/PointCloud2 on topic {topic_name(wanted)}; topics are {known}")
        if not found:
            packets = [topic for topic, kind in topics.items() if kind in _PACKETS]
            advice = ""
            if packets:
                advice = f"; {topic_name(packets[0])} holds packets, which the maker's driver turns into clouds"
            raise LogError(f"{self.path}: no sensor_msgs/PointCloud2; topics are {topic_list(topics)}{advice}")
        if len(found) > 1:
            names = ", ".join(map(topic_name, found))
            raise LogError(f"{self.path}: several sensor_msgs/PointCloud2: {names}; choose one with --scan-topic")
        return found[0]

    def _first_frame(self, source: BagSource) -> str | None:
        """Return the frame of the scans that are read; None where there is none."""
        wanted = self.settings.frame
        for _, _, raw in source.messages([self.topic]):
            with contextlib.suppress(Exception):  # counted when the log is read
                frame = frame_name(source.deserialize(raw, self.topic).header.frame_id)
                if wanted is None or frame == frame_name(wanted):
                    return frame
        return None

    def _find_frames(self, source: BagSource) -> BagFrames | None:
        """Find how the LiDAR is mounted, and what odometry there is."""
        readings = sorted(topic for topic, kind in source.topics.items() if kind == ODOMETRY)
        if readings:
            self.unused = f"odometry on {', '.join(map(topic_name, readings))}"
        if not self._tf_topics:
            return None
        sensor = self._first_frame(source)
        if sensor is None:
            return None
        named = [topic for topic in readings if topic.rsplit("/", 1)[-1] == "odom"]
        chosen = readings if len(readings) == 1 else named
        reading = first_reading(source, chosen[0]) if len(chosen) == 1 else None
        found = find_frames(source, self._tf_topics, sensor, reading)
        if not readings and found.chain:
            self.unused = f"odometry of tf ('{shown(found.chain[0])}' to '{shown(found.chain[-1])}')"
        if found.path is None:
            self._notes.append(
                f"tf does not say how the LiDAR ('{shown(sensor)}') is mounted on the robot "
                f"('{shown(found.robot or 'base_link')}'); the poses are the LiDAR's"
            )
        elif found.mount is not None:
            self.mount, self.robot = found.mount, found.robot
        self._notes += found.bad_notes(self._followed(found))
        return found

    def _followed(self, frames: BagFrames | None) -> list[str]:
        """Return the topics of tf that are read along with the scans: those of a mount that moves."""
        if frames is None or not frames.moves:
            return []
        return [topic for topic in self._tf_topics if not is_static(topic)]

    def _read(self) -> Iterator[Scan]:
        self.times, self.frame = PointTimes(), self.settings.frame
        frames = self._frames
        joints = None
        if frames is not None and frames.path is not None and frames.moves:
            joints = Joints(frames.tree, *frames.path)
        source = self._open()
        try:
            for scan in Waiting(False, joints).events(self._messages(source, joints)):
                assert isinstance(scan, Scan)
                yield scan if joints is None else self._carried(scan, joints)
        finally:
            source.close()
        if self.scans and self.times.unit is None:
            self._late_notes.append("no time a point: scans are not corrected for the motion within a sweep")
        if self._shifted > _SHIFT:
            self._late_notes.append(
                f"the LiDAR moves on its robot by up to {self._shifted:.2f} m; where nothing is in its way is counted "
                "from where it was mounted first"
            )

    def _carried(self, scan: Scan, joints: Joints) -> Scan:
        """Return a scan as the LiDAR would have seen it where it was mounted first."""
        assert self.mount is not None
        moved = self.mount.inverse() @ joints.mount(scan.stamp)
        if moved.is_close(Pose.identity(3), 1e-9, 1e-9):
            return scan
        self._shifted = max(self._shifted, float(np.linalg.norm(moved.translation)))
        return replace(scan, points=moved.apply(scan.points))

    def _messages(self, source: BagSource, joints: Joints | None) -> Iterator[Scan]:
        """Decode the messages; joints take what is theirs."""
        number = 0
        messages = iter(source.messages([self.topic, *(() if joints is None else self._followed(self._frames))]))
        while True:
            try:
                topic, nanoseconds, raw = next(messages)
            except StopIteration:
                return
            except Exception as error:  # damage within the file: what came before is good
                if number == 0:
                    raise LogError(f"{self.path}: the bag cannot be read: {reason(error)}") from error
                self._late_notes.append(f"the bag is damaged after message {number}: {reason(error)}")
                return
            number += 1
            self.position = int(self.size * min(max(source.fraction(nanoseconds), 0.0), 1.0))
            scan = None
            try:
                message = source.deserialize(raw, topic)
                if topic == self.topic:
                    scan = self._scan(message, nanoseconds, number)
                elif joints is not None:
                    self._follow(message, nanoseconds, f"{number} ({topic_name(topic)})", joints)
            except (LogError, FileAccessError):
                raise
            except Exception as error:  # one bad message, of any kind, is skipped and counted
                self._skipped.add(f"message {number} ({topic_name(topic)}): {reason(error)}")
                continue
            if scan is not None:
                yield scan

    def _follow(self, message: Any, nanoseconds: int, where: str, joints: Joints) -> None:
        """Take the transforms of a tf message."""
        for parent, child, header, T in transforms(message):
            if isinstance(T, str):
                self._bad_transforms.add(f"at message {where}: {T}")
            else:
                joints.take(parent, child, message_stamp(header, nanoseconds), T)

    def _told(self) -> list[str]:
        texts = super()._told()
        if self._bad_transforms.count:
            count = plural(self._bad_transforms.count, "transform")
            texts.append(f"{count} of tf ignored, the first {self._bad_transforms.first}")
        return texts

    def _scan(self, message: Any, nanoseconds: int, number: int) -> Scan | None:
        where = f"message {number}"
        frame = frame_name(message.header.frame_id)
        if self.frame is None:
            self.frame = frame
        if frame != frame_name(self.frame):
            self._elsewhere.add(f"{where} ('{shown(frame)}' and not '{shown(self.frame)}')")
            return None
        stamp = message_stamp(message.header, nanoseconds)
        points = coordinates(message)
        intensity = column(message, "intensity")
        return self._clean(
            stamp, points, self.times.of(partial(column, message), stamp, returned(points)),
            None if intensity is None else intensity.astype(float), number, where,
        )  # fmt: skip

    def _no_scan(self) -> str:
        return f"{self.path}: no cloud that can be used on topic {self.topic}"
