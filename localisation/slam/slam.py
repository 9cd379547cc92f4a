"""Simultaneous localisation and mapping: predict, match, fuse into the submap, look for loops, optimise.

A scan is matched against the scans just before it and those old submaps whose place the graph knows well enough; it
becomes a node of the graph where enough path has come together since the last one. Each finished submap is looked for
in the old ones. All poses are kept relative to nodes, so that whatever moves a node moves what was seen from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from localisation.matching.global_matcher import thin
from localisation.matching.information import score_covariance
from localisation.matching.match import Match
from localisation.odometry.odometry import RegisteredScan
from localisation.odometry.scan_odometry import ENOUGH, ScanOdometry
from localisation.settings import MappingSettings, limit_of
from localisation.slam import planar
from localisation.slam.local_map import LocalMap
from localisation.slam.loop_closer import LoopCloser, local_covariance, some_points
from localisation.slam.loop_search import LoopRecord
from localisation.slam.pose_graph import Edge, PoseGraph, import_gtsam
from localisation.slam.settings import LoopSettings
from localisation.slam.submap import CompactScan, Stretch, Submap, SubmapCells, compact, make_stretch

__all__ = ["Slam", "SlamResult"]

# In cells of the finest level: the local map is made anew where a submap in it has moved by more.
_MOVED = 0.5
# A scan goes into the local map where the robot has moved by so much since the last one that did: half of a searched
# cell, and what turns new walls into view. A robot that stands adds the same cells again and again.
_NEWS_METRES = 0.05
_NEWS_RADIANS = math.radians(2.0)
# Of nodes that follow one another, the covariance of every so many is looked at.
_EVERY = 4
# Variance of the edge between two nodes, in what the surface of scores says of one match: scans of a stretch hand on
# their errors. Fitted on simulated drives (``python -m tests.benchmarks.slam simulated``), where ellipses of 95 % held
# 92 % of the poses with 1.
_CHAIN = 1.5
# Points whose surface of scores is looked at.
_CHAIN_POINTS = 150
# Variance of the wheels' error over a stretch, in what it is on average: it is alike from one stretch to the next, and
# so many along a corridor add up before the wheels turn or something is in view again.
_WHEELS = 4.0


@dataclass(frozen=True, eq=False)
class SlamResult:
    """All poses of a log.

    Attributes:
        stamps: (N,) seconds, of all laser and odometry readings in the log's order.
        poses: (N, 3) T_map_robot: x, y in metres, heading in radians.
        is_scan: (N,) which of them are scans.
        covariances: (N, 3, 3) of a small motion in the robot's frame, relative to the first pose.
        scans: the scans, as they are kept.
        records: every loop that was tried.
        graph: nodes and edges.
        node_scans: which scan each node is.
    """

    stamps: FloatArray
    poses: FloatArray
    is_scan: IntArray
    covariances: FloatArray
    scans: list[CompactScan]
    records: list[LoopRecord]
    graph: PoseGraph
    node_scans: list[int]

    __repr__ = one_line


class Slam:
    """Maps a log reading by reading.

    Attributes:
        graph: nodes and edges so far.
        submaps: the finished submaps.
        scans: the scans so far, as they are kept.
        closer: what looks for loops, with its records.
        matched: scans that were matched, and
        unmatched: those that met nothing.
        fractions: sum of the shares of the matched scans' cells that coincided.
    """

    def __init__(self, settings: MappingSettings, loops: LoopSettings | None = None, mount: Pose | None = None) -> None:
        """Begin with an empty map; ``mount`` is T_robot_laser where the settings do not say.

        Raises:
            MissingDependencyError: gtsam cannot be loaded.
        """
        import_gtsam()
        self.settings, self.loops = settings, loops or LoopSettings()
        self._local = LocalMap(settings)
        self._odometry = ScanOdometry(settings, self._local.builder, mount, learn=True)
        self.mount = self._odometry.mount
        self.graph = PoseGraph()
        self.submaps: list[Submap] = []
        self.scans: list[CompactScan] = []
        lattice = settings.make_lattice()
        self._cells = SubmapCells(
            lattice, lattice.scaled(2.0**settings.search_level), settings.rule, self._scan_in_node
        )
        self.closer = LoopCloser(self.graph, self.submaps, self._cells, self.loops)
        self.matched = self.unmatched = 0
        self.fractions = 0.0
        self._stretches: list[Stretch] = []
        self._node_scans: list[int] = []
        # One entry a reading: stamp, scan or not, node before it, pose seen from that, and way gone since it. Since the
        # last node there are poses in the local map instead.
        self._stamps: list[float] = []
        self._is_scan: list[bool] = []
        self._entry_node: list[int] = []
        self._entry_pose: list[FloatArray] = []
        self._entry_way: list[float] = []
        self._settled = 0
        self._fused: Pose | None = None
        self._scan_entry: list[int] = []
        self._ways: list[float] = []
        self._chain: list[int] = []
        self._metres = self._radians = 0.0
        self._last: FloatArray | None = None
        # The motion since the last node as it was predicted, and the sum of its squared errors over all stretches; it
        # begins with one stretch that was as wrong as the window allows.
        self._predicted = np.zeros(3)
        self._doubt = np.zeros((3, 3))
        self._lost = False
        self._errors = np.array([settings.search_metres**2] * 2 + [settings.search_radians**2])

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Give the submaps their scans again."""
        self.__dict__.update(state)
        self._cells.scan_of = self._scan_in_node

    @property
    def jumps(self) -> int:
        """Odometry readings that could not be true."""
        return self._odometry.jumps

    # ------------------------------------------------------------------ reading by reading

    def observe(self, reading: Odometry) -> None:
        """Take an odometry reading."""
        self._take_readings(self._odometry.observe(reading))

    def register(self, scan: Scan) -> RegisteredScan:
        """Take the next scan.

        Raises:
            BoundsError: a point is out of range; the scan is as if it had not been.
            TooLargeError: it sees so far that there are too many angles or cells; the same.
        """
        registered = self._odometry.register(scan)
        if self._is_news(registered.T_map_robot):
            self._local.fuse(scan, registered.T_map_scan)
            self._fused = registered.T_map_robot
        self._take_readings(registered.readings)
        if registered.match is not None:
            self.matched += 1
            self.fractions += registered.match.fraction
        elif registered.matched:
            self.unmatched += 1
        number = len(self.scans)
        self.scans.append(compact(scan, no_return=self.settings.clear_no_return > 0.0))
        self._lost = self._lost or self._is_lost(registered)
        local = planar.of_pose(registered.T_map_robot)
        pose = self._local.in_map(local)
        self._walk(self._local.in_map(planar.of_pose(registered.predicted or registered.T_map_robot)), pose)
        if number == 0:
            self.graph.add_node(pose)
            self._node_scans.append(0)
        elif self._is_due(number):
            self._new_node(number, pose, registered.match)
        self._scan_entry.append(len(self._stamps))
        self._enter(scan.stamp, True, local if number == 0 or not self._is_node(number) else self._local_node())
        return registered

    def _is_lost(self, registered: RegisteredScan) -> bool:
        """Tell whether a scan met little of the map, and that far from where it was expected: by chance, perhaps."""
        match, predicted = registered.match, registered.predicted
        if match is None or predicted is None:
            return registered.matched
        window = self._odometry.likely_window()
        off = predicted.inverse() @ registered.T_map_robot
        far = math.hypot(off.x, off.y) > window.metres or off.angle > window.radians
        return far and match.fraction < ENOUGH

    def _is_news(self, T_local_robot: Pose) -> bool:
        """Tell whether a scan sees anything that the last one in the local map did not, but for who walks by."""
        if self._fused is None:
            return True
        moved = self._fused.inverse() @ T_local_robot
        return math.hypot(moved.x, moved.y) > _NEWS_METRES or moved.angle > _NEWS_RADIANS

    def _is_node(self, number: int) -> bool:
        return self._node_scans[-1] == number

    def _local_node(self) -> FloatArray:
        """Return where the last node lies in the local map."""
        return self._local.in_local(self.graph.pose(len(self.graph) - 1))

    def _walk(self, predicted: FloatArray, pose: FloatArray) -> None:
        if self._last is not None:
            self._predicted = planar.compose(self._predicted, planar.between(self._last, predicted))
            step = planar.between(self._last, pose)
            self._metres += float(np.hypot(step[0], step[1]))
            self._radians += abs(float(step[2]))
        self._last = pose

    def _is_due(self, number: int) -> bool:
        loops = self.loops
        enough = self._metres >= loops.node_metres or self._radians >= loops.node_radians
        return enough and number - self._node_scans[-1] >= loops.node_scans

    def _take_readings(self, readings: tuple[tuple[float, Pose], ...]) -> None:
        for stamp, pose in readings:
            self._enter(stamp, False, planar.of_pose(pose))

    def _enter(self, stamp: float, is_scan: bool, local: FloatArray) -> None:
        """Take the pose (3,) of the next reading in the local map."""
        self._stamps.append(stamp)
        self._is_scan.append(is_scan)
        self._entry_node.append(max(0, len(self.graph) - 1))
        self._entry_pose.append(local)
        self._entry_way.append(self._metres + self._radians)

    def _settle(self) -> None:
        """Turn the poses since the last node, which are in the local map, into what they are as seen from that."""
        since = np.array(self._entry_pose[self._settled :]).reshape(-1, 3)
        node = np.broadcast_to(self._local_node(), since.shape)
        self._entry_pose[self._settled :] = list(planar.between(node, since))
        self._settled = len(self._entry_pose)

    # ------------------------------------------------------------------ node by node

    def _new_node(self, number: int, pose: FloatArray, match: Match | None) -> None:
        """Make a node of a scan: finish the stretch before it and the submap before that, look for loops."""
        self._settle()
        before = len(self.graph) - 1
        motion = planar.between(self.graph.pose(before), pose)
        first = self._node_scans[-1]
        self._stretches.append(self._stretch(first, number, motion))
        self.graph.add_node(pose)
        local = self._local.in_local(pose)
        self._node_scans.append(number)
        self._ways.append(self._metres + self._radians)
        self._metres = self._radians = 0.0
        stretch = self._stretches[-1]
        submap = Submap.of(before, self._stretches[-2] if before else None, stretch)
        self.submaps.append(submap)
        self._local.members[before] = self._local.in_local(self.graph.pose(before))
        self._link(submap, number, motion, match is not None)
        if self.closer.look(before):
            self.graph.optimise()
        self._cells.scratch.give_back()
        self._follow(local)

    def _stretch(self, first: int, last: int, motion: FloatArray) -> Stretch:
        """Return what the scans from ``first`` on saw that is occupied now, seen from their node."""
        T_local_node = planar.to_pose(self._local.in_local(self.graph.pose(len(self.graph) - 1)))
        lattice = self._local.finest
        points = []
        for number in range(first, last):
            _, in_robot = self._usable(number)
            T_node_robot = planar.to_pose(self._entry_pose[self._scan_entry[number]])
            points.append(T_node_robot.apply(in_robot))
        every = np.concatenate(points)
        occupied = self._odometry.occupied.contains(lattice.quantise(T_local_node.apply(every)))
        return make_stretch(first, last, motion, every[occupied], lattice)

    def _usable(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Return the points of a scan that lie in the range that is mapped, in the sensor's and the robot's frame."""
        points = self.scans[number].usable(self.settings.min_range, limit_of(self.settings.max_range))
        return points, self.mount.apply(points)

    def _scan_in_node(self, number: int) -> tuple[Scan, Pose]:
        """Return a scan and T_node_sensor, seen from the node before it."""
        points, _ = self._usable(number)
        T_node_robot = planar.to_pose(self._entry_pose[self._scan_entry[number]])
        return Scan(self.scans[number].stamp, points), T_node_robot @ self.mount

    def _link(self, submap: Submap, number: int, motion: FloatArray, matched: bool) -> None:
        """Put the motion to a new node into the graph; how sure that before it was is known now.

        A stretch is held to the submap before it by all that both see. Of the new node's stretch there is one scan yet,
        which must do until the next node.
        """
        graph = self.graph
        error = planar.between(self._predicted, motion)
        expected = self._errors / len(graph)
        expected[:2] = expected[:2].sum()
        # Where the wheels disagree as they never did, one of the two is wrong, and either may be.
        doubt = np.zeros((3, 3))
        if float((error**2 / expected).sum()) > self.closer.limit:
            doubt += np.outer(error, error)
        # A scan that met little of the map where nobody expected it may have been put anywhere in the window.
        if self._lost:
            doubt += np.diag([self.settings.search_metres**2] * 2 + [self.settings.search_radians**2])
        self._lost = False
        if matched:
            self._errors += error**2
        self._predicted = np.zeros(3)
        if self._chain:
            before = self.submaps[submap.number - 1]
            edge = self._chain[-1]
            points = self._stretches[submap.number].points.astype(np.float64)
            covariance = self._chain_covariance(before, points, graph.edges[edge].pose) + self._doubt
            graph.set_covariance(edge, covariance)
        self._doubt = doubt
        points = self._usable(number)[1] if matched else np.zeros((0, 2))
        covariance = self._chain_covariance(submap, points, motion) + doubt
        self._chain.append(graph.add_edge(Edge(submap.number, submap.number + 1, motion, covariance)))

    def _chain_covariance(self, submap: Submap, points: FloatArray, motion: FloatArray) -> FloatArray:
        """Return how sure it is that points (P, n) seen ``motion`` (3,) further on lie in a submap as they do."""
        errors = self._errors / len(self.graph)
        # Wheels err in every direction: what a corridor hides of it is what counts.
        errors[:2] = errors[:2].sum()
        by_wheels = np.diag(_WHEELS * errors)
        cells = self._cells.of(submap)
        if len(points) == 0 or len(cells.occupied) == 0:
            return by_wheels
        kept = some_points(thin(points, self._cells.lattice)[0], _CHAIN_POINTS)
        pose = planar.to_pose(motion)
        by_match = score_covariance(cells.pyramid, kept, np.ones(len(kept), np.int64), pose)
        by_match = _CHAIN * local_covariance(by_match, pose)
        return np.asarray(np.linalg.inv(np.linalg.inv(by_match) + np.linalg.inv(by_wheels)))

    def _follow(self, local: FloatArray) -> None:
        """Go on from the last node as it is now, with a local map that knows where the submaps are now.

        ``local`` (3,) is where the node lies in the local map.
        """
        last = len(self.graph) - 1
        self._last = self.graph.pose(last)
        self._local.T_map_local = planar.compose(self._last, planar.invert(local))
        wanted, near = self._trusted(last)
        members = self._local.members
        limit = _MOVED * self._local.finest.resolution
        gone = any(k in near and k not in wanted for k in members)
        moved = self._have_moved([k for k in wanted if k in members], limit)
        if gone or moved or len(members) > 2 * self.loops.most_local:
            self._renew(wanted)
            return
        for k in wanted:
            if k not in members:
                self._add_to_local(k)

    def _have_moved(self, nodes: list[int], limit: float) -> bool:
        """Tell whether a stretch in the local map lies elsewhere than where it was put."""
        if not nodes:
            return False
        put = np.array([self._local.members[k] for k in nodes])
        now = planar.between(np.broadcast_to(self._local.T_map_local, put.shape), self.graph.poses[nodes])
        off = planar.between(put, now)
        reach = np.array([self.submaps[k].reach for k in nodes])
        # As far as a point halfway out moves.
        return bool((np.hypot(off[:, 0], off[:, 1]) + 0.5 * reach * np.abs(off[:, 2]) > limit).any())

    def _trusted(self, last: int) -> tuple[list[int], set[int]]:
        """Return the nodes near the last one whose place is known well enough to match scans against, and all near."""
        near = self.closer.near(last - 1, self.loops.node_metres).tolist()
        poses = self.graph.poses
        distance = np.hypot(*(poses[near, :2] - poses[last, :2]).T) if near else np.zeros(0)
        # The nearest first; of equally near ones the later one.
        order = sorted(range(len(near)), key=lambda n: (float(distance[n]), -near[n]))
        near = sorted(near[n] for n in order[: self.loops.most_local])
        # Nodes that follow one another are known about as well: every so many will do.
        asked = [k for n, k in enumerate(near) if n % _EVERY == 0 or near[n - 1] != k - 1]
        covariances = dict(zip(asked, self.graph.relative_covariances(last, asked), strict=True))
        metres = self.loops.trusted * self.settings.search_metres
        radians = self.loops.trusted * self.settings.search_radians
        known, trusted = False, []
        for k in near:
            if k in covariances:
                C = covariances[k]
                known = bool(C[0, 0] + C[1, 1] <= metres**2 and C[2, 2] <= radians**2)
            if known and k < last - 2:
                trusted.append(k)
        # What the last scans were matched against stays in any case.
        return trusted + [k for k in (last - 2, last - 1) if k >= 0], set(near)

    def _renew(self, wanted: list[int]) -> None:
        """Make the local map anew: the scans of the last two stretches as they are, the points of the older ones."""
        last = len(self.graph) - 1
        recent = [k for k in (last - 2, last - 1) if k >= 0]
        scans = []
        for k in recent:
            for number in range(self._stretches[k].first, self._stretches[k].last):
                T_node_robot = planar.to_pose(self._entry_pose[self._scan_entry[number]])
                scans.append(
                    (self.scans[number].scan(), planar.to_pose(self.graph.pose(k)) @ T_node_robot @ self.mount)
                )
        # The old one is let go of first: two of them would be the most that a run needs.
        self._odometry.match_against(LocalMap(self.settings).builder)
        number = self._node_scans[-1]
        scans.append((self.scans[number].scan(), planar.to_pose(self.graph.pose(last)) @ self.mount))
        self._local.renew(scans)
        for k in recent:
            self._local.members[k] = self.graph.pose(k)
        for k in wanted:
            if k not in self._local.members:
                self._add_to_local(k)
        self._odometry.match_against(self._local.builder)
        self._odometry.move_to(planar.to_pose(self.graph.pose(last)))
        self._fused = None

    def _add_to_local(self, k: int) -> None:
        stretch, pose = self._stretches[k], self._local.in_local(self.graph.pose(k))
        points = planar.to_pose(pose).apply(stretch.points)
        self._local.add(k, pose, points, stretch.weights.astype(np.int64))

    # ------------------------------------------------------------------ the end

    def finish(self) -> SlamResult:
        """Close what loops are left, and return all poses; no scan can be taken after that."""
        self._take_readings(self._odometry.finish())
        if len(self.graph):
            self._settle()
        self.closer.finish()
        # The final map needs the memory of what scans and submaps were matched against.
        self._cells.forget()
        self._local = LocalMap(self.settings)
        self._odometry.match_against(self._local.builder)
        if len(self.graph) > 1:
            self.closer.throw_out(self.graph.optimise_robustly(self.loops.probability))
        poses, covariances = self._poses()
        return SlamResult(
            np.array(self._stamps), poses, np.array(self._is_scan), covariances, self.scans, self.closer.records,
            self.graph, self._node_scans,
        )  # fmt: skip

    def _poses(self) -> tuple[FloatArray, FloatArray]:
        """Return the poses (N, 3) of all readings, and their covariances (N, 3, 3)."""
        rows = np.array(self._entry_pose).reshape(-1, 3)
        if not len(self.graph):
            return rows, np.zeros((len(rows), 3, 3))
        nodes = self.graph.poses
        at = np.array(self._entry_node, np.int64)
        seen = planar.compose(nodes[at], rows)
        covariances = self.graph.relative_covariances(0, range(len(self.graph)))
        inside = at < len(self._ways)
        a = at[inside]
        ways = np.array(self._ways)
        if len(a):
            motions = np.array([stretch.motion for stretch in self._stretches])
            from_next = planar.compose(nodes[a + 1], planar.between(motions[a], rows[inside]))
            share = np.clip(np.array(self._entry_way)[inside] / np.maximum(ways[a], 1e-12), 0.0, 1.0)
            seen[inside] = planar.blend(seen[inside], from_next, share)
        return seen, covariances[at]
