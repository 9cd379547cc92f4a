"""Where a sensor sits on its robot, by what tf and the odometry of a bag say: for planar lasers and for LiDARs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

from hexmap.base.text import plural
from hexmap.io.logs.bag_frames import FrameTree, frame_name, transforms
from hexmap.io.logs.bag_sources import BagSource
from hexmap.io.logs.log_account import Tally
from hexmap.io.logs.open_bag import topic_name
from hexmap.poses.pose import Pose

__all__ = ["ODOMETRY", "TF", "BagFrames", "find_frames", "first_reading", "is_static"]

ODOMETRY = "nav_msgs/msg/Odometry"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
# How many tf messages are looked through for the frames between sensor and odometry.
_LOOK_AHEAD = 5000


@dataclass(frozen=True, eq=False)
class BagFrames:
    """The frames of a bag.

    Attributes:
        tree: the transforms that were met.
        chain: frames from the odometry's down to the robot's, where the odometry comes from tf; else empty.
        robot: the robot's frame, "" where nothing names it.
        path: the frames to go up from the robot's, and those from the sensor's, to where both meet; None where tf does
            not say.
        bad: topic -> transforms on it that were ignored, and why the first was.
    """

    tree: FrameTree
    chain: list[str]
    robot: str
    path: tuple[list[str], list[str]] | None
    bad: dict[str, Tally]

    @property
    def mount(self) -> Pose | None:
        """T_robot_sensor in space; None where it is not known, or the sensor's frame is the robot's."""
        if self.path is None or not any(self.path):
            return None
        return self.tree.between(*self.path)

    @property
    def moves(self) -> bool:
        """Whether a joint between robot and sensor may move."""
        return self.path is not None and bool(self.tree.moving([*self.path[0], *self.path[1]]))

    def bad_notes(self, counted_later: list[str]) -> list[str]:
        """Return what to say of transforms that were ignored, but for those on topics that are read once more."""
        return [
            f"{plural(tally.count, 'transform')} of {topic_name(topic)} ignored, the first {tally.first}"
            for topic, tally in self.bad.items()
            if topic not in counted_later
        ]


def is_static(topic: str) -> bool:
    """Tell whether the transforms on a topic of tf stand still by its name."""
    return topic.rsplit("/", 1)[-1] == "tf_static"


def first_reading(source: BagSource, topic: str | None) -> tuple[str, str]:
    """Return the frames of the first odometry message: that of its poses, and the robot's; "" where there is none."""
    if topic is not None:
        for _, _, raw in source.messages([topic]):
            with contextlib.suppress(Exception):
                message = source.deserialize(raw, topic)
                return frame_name(message.header.frame_id), frame_name(message.child_frame_id)
    return "", ""


def find_frames(
    source: BagSource, tf_topics: list[str], sensor: str, reading: tuple[str, str] | None
) -> BagFrames:
    """Find the frames between a sensor and its robot, and above that the odometry's.

    Args:
        source: the bag.
        tf_topics: its topics of tf.
        sensor: the frame of the scans.
        reading: what :func:`first_reading` says; None where the bag has no odometry but tf's.
    """
    tree = FrameTree()
    odometry, robot = reading or ("", "")

    def is_known() -> bool:
        if reading is not None:
            return bool(robot) and robot in tree.chain(sensor)
        return tree.odometry(sensor)[1]

    bad = _look_ahead(source, tf_topics, tree, is_known)
    chain: list[str] = []
    if reading is None:
        chain, _ = tree.odometry(sensor)
        if chain:
            odometry, robot = chain[0], chain[-1]
    found = tree.mount(sensor, odometry, robot) if sensor != robot else (robot, [], [])
    if found is None:
        return BagFrames(tree, chain, robot, None, bad)
    return BagFrames(tree, chain, found[0], (found[1], found[2]), bad)


def _look_ahead(
    source: BagSource, tf_topics: list[str], tree: FrameTree, is_known: Callable[[], bool]
) -> dict[str, Tally]:
    """Take all transforms of tf that stand still, and those that move until the frames are known.

    Frames on a topic called ``tf_static`` stand still; on ``tf`` they may move.

    Returns:
        Topic -> how many transforms on it were ignored, and why the first was.
    """
    bad: dict[str, Tally] = {}
    static = [topic for topic in tf_topics if is_static(topic)]
    moving = [topic for topic in tf_topics if topic not in static]
    for topics in (static, moving):
        for count, (topic, _, raw) in enumerate(source.messages(topics)):
            with contextlib.suppress(Exception):
                for parent, child, _, T in transforms(source.deserialize(raw, topic)):
                    if isinstance(T, str):
                        bad.setdefault(topic, Tally()).add(T)
                    else:
                        tree.take(parent, child, T, topics is moving)
            if topics is moving and (count >= _LOOK_AHEAD or is_known()):
                break
    return bad
