"""The frames of a bag: which transforms tf gives, which of them is the odometry, and where the laser sits.

tf is a tree: each frame has one parent. Above the robot's base the lowest transform that moves is the odometry;
what is above that (``map``, corrections of a SLAM program) is left alone. Below it the transforms are the joints
between robot and laser, some of which may move as well.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexmap.base.text import reason, shown
from hexmap.poses.pose import Pose

__all__ = ["FrameTree", "Joints", "frame_name", "transforms"]

# The names of the robot's base, as REP 105 and REP 120 have them, the robot's own frame first.
_BASES = ("base_link", "base_footprint", "base_stabilized")
# How many readings of a moving joint are kept: two seconds at more than a hundred hertz.
_KEPT = 512


def frame_name(name: str) -> str:
    """Return a frame's name without the slashes that ROS 1 allowed around it."""
    return name.strip("/")


def transforms(message: Any) -> Iterator[tuple[str, str, Any, Pose | str]]:
    """Yield (parent, child, header, T_parent_child) of a tf message; the reason in place of one that is not sound."""
    for item in message.transforms:
        parent, child = frame_name(item.header.frame_id), frame_name(item.child_frame_id)
        t, q = item.transform.translation, item.transform.rotation
        T: Pose | str
        try:
            T = Pose.from_quaternion((t.x, t.y, t.z), (q.x, q.y, q.z, q.w))
        except Exception as error:  # a bad transform costs itself, not those beside it
            T = f"{shown(parent)} -> {shown(child)}: {reason(error)}"
        yield parent, child, item.header, T


@dataclass
class _Edge:
    """The transform from a frame to its parent.

    Attributes:
        parent: the frame above.
        T: T_parent_child; of one that stands still the last that was given, else the first.
        moving: it came on a topic of transforms that may move.
        changed: it came with different values.
    """

    parent: str
    T: Pose
    moving: bool
    changed: bool = False


class FrameTree:
    """The transforms that tf has given so far."""

    def __init__(self) -> None:
        """Begin with none."""
        self._edges: dict[str, _Edge] = {}

    def __contains__(self, frame: str) -> bool:
        """Tell whether a frame has a parent."""
        return frame in self._edges

    def take(self, parent: str, child: str, T: Pose, moving: bool) -> None:
        """Take a transform; a frame keeps its first parent among those that move."""
        edge = self._edges.get(child)
        if edge is None or (not moving and not edge.moving):
            self._edges[child] = _Edge(parent, T, moving)
        elif moving and not edge.moving:
            changed = edge.parent == parent and not T.is_close(edge.T, 1e-6, 1e-6)
            self._edges[child] = _Edge(parent, T, True, changed)
        elif moving and edge.parent == parent and not edge.changed:
            edge.changed = not T.is_close(edge.T, 1e-6, 1e-6)

    def chain(self, frame: str) -> list[str]:
        """Return a frame and all above it, up to the root; stops where damaged tf runs in a circle."""
        chain = [frame]
        seen = {frame}
        while chain[-1] in self._edges and (parent := self._edges[chain[-1]].parent) not in seen:
            chain.append(parent)
            seen.add(parent)
        return chain

    def odometry(self, laser: str) -> tuple[list[str], bool]:
        """Return the frames from the odometry's down to the robot's, and whether more of tf could change them.

        The odometry's frame is the parent of the lowest moving transform above the robot's base.

        Returns:
            The frames, none where nothing above the laser moves; and True where the transform is seen to move
            above a base that is known by its name.
        """
        chain = self.chain(laser)
        found = self._odometry_place(chain)
        if found is None:
            return [], False
        robot = _base(chain[: found + 1])
        at = chain.index(robot) if robot is not None else found
        sure = _highest_base(chain[: found + 1]) is not None and self._edges[chain[found]].changed
        return chain[at : found + 2][::-1], sure

    def _odometry_place(self, chain: list[str]) -> int | None:
        """Return the place in a chain of the frame right below the odometry's."""
        base = _highest_base(chain)
        moving = [k for k in range(base or 0, len(chain) - 1) if self._edges[chain[k]].moving]
        if not moving:
            return None
        # A first program on /tf may send what never changes, and a robot may stand still for long. Without a base by
        # name the lowest joint may be one between robot and laser.
        changed = [k for k in moving if self._edges[chain[k]].changed]
        named = [k for k in moving if "odom" in _last(chain[k + 1]).lower()]
        if base is not None and moving[0] in changed:
            return moving[0]
        return (named or changed or moving)[0]

    def mount(self, laser: str, odometry: str, robot: str) -> tuple[str, list[str], list[str]] | None:
        """Find the path between a robot and its laser, beside odometry of a topic of its own.

        The frames that the odometry's messages name, and what moves the robot's base, are never joints of the mount.

        Args:
            laser: the frame of the scans.
            odometry: the frame that the odometry's poses are in.
            robot: the frame that they are of, as the messages say.

        Returns:
            The robot's frame, the frames to go up from it, and those to go up from the laser, to where both meet;
            None where tf does not say.
        """
        chain = self.chain(laser)
        limit = len(chain)
        if odometry in chain[1:]:
            limit = chain.index(odometry)
        base = _highest_base(chain[:limit])
        if base is not None:
            found = self._odometry_place(chain[:limit])
            limit = limit if found is None else found + 1
        allowed = chain[:limit]
        if robot and robot != odometry:
            up = self.chain(robot)
            common = next((frame for frame in up if frame in allowed), None)
            if common is not None:
                return robot, up[: up.index(common)], allowed[: allowed.index(common)]
        found_base = _base(allowed)
        if found_base is None and limit < len(chain):
            found_base = allowed[-1]
        if found_base is None:
            return None
        return found_base, [], allowed[: allowed.index(found_base)]

    def between(self, up: Iterable[str], down: Iterable[str], at: dict[str, Pose] | None = None) -> Pose:
        """Return T_robot_laser of the frames to go up from each.

        Args:
            up: the frames from the robot's to below the one where both paths meet.
            down: those from the laser's.
            at: transforms to take instead of those of the tree.
        """
        known = at or {}

        def composed(frames: Iterable[str]) -> Pose:
            T = Pose.identity(3)
            for frame in frames:
                T = known.get(frame, self._edges[frame].T) @ T
            return T

        return composed(up).inverse() @ composed(down)

    def parent(self, frame: str) -> str:
        """Return the parent of a frame."""
        return self._edges[frame].parent

    def transform(self, frame: str) -> Pose:
        """Return T_parent_frame."""
        return self._edges[frame].T

    def moving(self, frames: Iterable[str]) -> list[str]:
        """Return those of some frames that may move against their parent."""
        return [frame for frame in frames if self._edges[frame].moving]


class Joints:
    """What the moving joints between robot and laser did lately."""

    def __init__(self, tree: FrameTree, up: list[str], down: list[str]) -> None:
        """Take the path that :meth:`FrameTree.mount` found."""
        self._tree, self._up, self._down = tree, up, down
        self.moving = tree.moving([*up, *down])
        self._readings: dict[str, deque[tuple[float, Pose]]] = {frame: deque(maxlen=_KEPT) for frame in self.moving}

    def take(self, parent: str, child: str, stamp: float, T: Pose) -> None:
        """Take a transform if it is one of the joints'."""
        readings = self._readings.get(child)
        if readings is not None and parent == self._tree.parent(child):
            if readings and stamp < readings[-1][0]:
                # Of several programs that send one joint the newest reading counts; a clock set back begins anew.
                if readings[-1][0] - stamp < 1.0:
                    return
                readings.clear()
            readings.append((stamp, T))

    def known(self, stamp: float) -> bool:
        """Tell whether every joint has a reading at or after a time."""
        return all(readings and readings[-1][0] >= stamp for readings in self._readings.values())

    def mount(self, stamp: float) -> Pose:
        """Return T_robot_laser in space at a time, joints interpolated between their readings around it."""
        at = {frame: _at(readings, stamp) for frame, readings in self._readings.items() if readings}
        return self._tree.between(self._up, self._down, at)


def _at(readings: deque[tuple[float, Pose]], stamp: float) -> Pose:
    """Return a joint at a time; before its first reading and after its last these count."""
    after = readings[-1]
    if stamp >= after[0]:
        return after[1]
    for before in reversed(readings):
        if before[0] <= stamp:
            if after[0] <= before[0]:
                return before[1]
            return _interpolated(before[1], after[1], (stamp - before[0]) / (after[0] - before[0]))
        after = before
    return after[1]


def _interpolated(a: Pose, b: Pose, part: float) -> Pose:
    """Return the pose between two, turning at one speed (slerp)."""
    qa, qb = a.quaternion(), b.quaternion()
    cosine = float(np.dot(qa, qb))
    if cosine < 0.0:
        qb, cosine = -qb, -cosine
    angle = math.acos(min(cosine, 1.0))
    if angle < 1e-6:
        q = (1.0 - part) * qa + part * qb
    else:
        q = (math.sin((1.0 - part) * angle) * qa + math.sin(part * angle) * qb) / math.sin(angle)
    return Pose.from_quaternion((1.0 - part) * a.translation + part * b.translation, q)


def _last(frame: str) -> str:
    return frame.rsplit("/", 1)[-1]


def _bases(chain: list[str]) -> list[tuple[int, int]]:
    """Return (rank, place) of the frames of a chain that are a robot's base by name, the best name first."""
    found = []
    for place, frame in enumerate(chain):
        name = _last(frame)
        if name in _BASES:
            found.append((_BASES.index(name), place))
        elif place > 0 and "base" in name.lower() and not any(w in name.lower() for w in ("laser", "scan", "lidar")):
            found.append((len(_BASES), place))
    best = min((rank for rank, _ in found), default=0)
    # Other words with "base" in them count only where none of the usual names is there.
    return sorted(pair for pair in found if pair[0] < len(_BASES) or best == len(_BASES))


def _base(chain: list[str]) -> str | None:
    """Return the frame of a chain that is the robot's by name."""
    bases = _bases(chain)
    return chain[bases[0][1]] if bases else None


def _highest_base(chain: list[str]) -> int | None:
    """Return the place of the highest frame of a chain that is a robot's base by name."""
    return max((place for _, place in _bases(chain)), default=None)
