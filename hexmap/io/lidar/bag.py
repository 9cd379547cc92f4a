"""Bags with sensor_msgs/PointCloud2: ROS 1, ROS 2 and MCAP."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hexmap.base.errors import FileAccessError, LogError
from hexmap.base.text import reason, shown
from hexmap.io.lidar.lidar_log import LidarLog, LidarLogSettings, returned
from hexmap.io.lidar.point_cloud2 import PointTimes, column, coordinates
from hexmap.io.logs.bag_sources import BagSource
from hexmap.io.logs.log import file_size
from hexmap.io.logs.open_bag import ADVICE, open_sound_bag, topic_list, topic_name
from hexmap.io.read_file import cannot_read
from hexmap.poses.scan import Scan

__all__ = ["CLOUD", "LidarBag"]

CLOUD = "sensor_msgs/msg/PointCloud2"
# Packets that only the maker's driver can decode.
_PACKETS = ("velodyne_msgs/msg/VelodyneScan", "ouster_ros/msg/PacketMsg", "livox_ros_driver2/msg/CustomMsg",
            "livox_ros_driver/msg/CustomMsg", "hesai_ros_driver/msg/UdpFrame")  # fmt: skip


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
        finally:
            source.close()
        self.times = PointTimes()
        self.frame = settings.frame

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

    def _read(self) -> Iterator[Scan]:
        self.times, self.frame = PointTimes(), self.settings.frame
        source = self._open()
        try:
            number = 0
            messages = iter(source.messages([self.topic]))
            while True:
                try:
                    _, nanoseconds, raw = next(messages)
                except StopIteration:
                    break
                except Exception as error:  # damage within the file: what came before is good
                    if number == 0:
                        raise LogError(f"{self.path}: the bag cannot be read: {reason(error)}") from error
                    self._late_notes.append(f"the bag is damaged after message {number}: {reason(error)}")
                    break
                number += 1
                self.position = int(self.size * min(max(source.fraction(nanoseconds), 0.0), 1.0))
                try:
                    scan = self._scan(source.deserialize(raw, self.topic), nanoseconds, number)
                except (LogError, FileAccessError):
                    raise
                except Exception as error:  # one bad message, of any kind, is skipped and counted
                    self._skipped.add(f"message {number} ({self.topic}): {reason(error)}")
                    continue
                if scan is not None:
                    yield scan
            if self.scans and self.times.unit is None:
                self._late_notes.append("no time a point: scans are not corrected for the motion within a sweep")
        finally:
            source.close()

    def _scan(self, message: Any, nanoseconds: int, number: int) -> Scan | None:
        where = f"message {number}"
        frame = message.header.frame_id.strip("/")
        if self.frame is None:
            self.frame = frame
        if frame != self.frame.strip("/"):
            self._elsewhere.add(f"{where} ('{shown(frame)}' and not '{shown(self.frame)}')")
            return None
        seconds = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        stamp = float(seconds if seconds != 0 else nanoseconds * 1e-9)
        points = coordinates(message)
        intensity = column(message, "intensity")
        return self._clean(
            stamp, points, self.times.of(message, stamp, returned(points)),
            None if intensity is None else intensity.astype(float), number, where,
        )  # fmt: skip

    def _no_scan(self) -> str:
        return f"{self.path}: no cloud that can be used on topic {self.topic}"
