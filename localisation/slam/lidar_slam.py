"""Simultaneous localisation and mapping in space: predict, draw onto surfaces, look for loops, optimise.

Built as :mod:`localisation.slam.slam` is in the plane. Sweeps are drawn onto the surfaces of the submaps whose place
the graph knows; every few metres a node begins; each finished submap is looked for in the old ones. Poses are kept
relative to nodes, so that whatever moves a node moves what was seen from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import angles
from hexmap.poses.scan import Scan
from localisation.lidar_settings import LidarSettings
from localisation.matching.surfaces import SurfaceMap, first_of_each_cell
from localisation.odometry.lidar_odometry import LidarOdometry, RegisteredSweep
from localisation.odometry.sweep import Velocity
from localisation.slam import spatial
from localisation.slam.lidar_loops import LidarLoopCloser, drawn_covariance
from localisation.slam.lidar_submap import LidarSubmap, Rays, SubmapShelf
from localisation.slam.loop_search import LoopRecord
from localisation.slam.pose_graph import Edge, PoseGraph, import_gtsam
from localisation.slam.settings import LoopSettings

__all__ = ["LidarSlam", "LidarSlamResult"]

# A submap's points, one a cell of this many resolutions of the map: planes want more than one point a cell.
_THIN = 0.5
# Sweeps whose beams say what is free in a submap, and how many beams of each.
_FREE_SWEEPS, _FREE_BEAMS = 4, 1000
# In cells of the surfaces: the surfaces are made anew where a submap in them has moved by more.
_MOVED = 0.05
# Part of a surface's cell up to which an old submap's place must be known before sweeps are drawn onto it.
_TRUSTED = 0.1
# The variance that a stretch without a plane to hold it has, metres and radians along an axis.
_LOST = (0.5, 0.05)


@dataclass(frozen=True, eq=False)
class LidarSlamResult:
    """The poses of all sweeps.

    Attributes:
        stamps: (N,) seconds.
        poses: (N, 12) T_map_sensor as rows, see :mod:`localisation.slam.spatial`; T_map_robot after :meth:`of_robot`.
        covariances: (N, 6, 6) of a small motion in the frame of the sensor (robot), relative to the first pose.
        records: every loop that was tried.
        graph: nodes and edges.
        node_scans: which sweep each node is.
    """

    stamps: FloatArray
    poses: FloatArray
    covariances: FloatArray
    records: list[LoopRecord]
    graph: PoseGraph
    node_scans: list[int]

    __repr__ = one_line

    def pose(self, number: int) -> Pose:
        """Return T_map_sensor of a sweep."""
        return spatial.to_pose(self.poses[number])

    def of_robot(self, T_robot_sensor: Pose) -> LidarSlamResult:
        """Return the same for the robot that the sensor is mounted on: T_map_robot, and motions in its frame."""
        mount = spatial.of_pose(T_robot_sensor)
        back, A = spatial.invert(mount), spatial.adjoint(mount)

        def seen(row: FloatArray) -> FloatArray:
            return spatial.compose(spatial.compose(mount, row), back)

        graph = PoseGraph(spatial.SPACE)
        for pose in spatial.compose(self.graph.poses, back):
            graph.add_node(pose)
        for edge in self.graph.edges:
            graph.add_edge(replace(edge, pose=seen(edge.pose), covariance=A @ edge.covariance @ A.T))
        graph.weights = list(self.graph.weights)
        records = [
            record if record.pose is None else replace(record, pose=tuple(seen(np.array(record.pose)).tolist()))
            for record in self.records
        ]
        records = [
            record if record.covariance is None
            else replace(record, covariance=tuple(map(tuple, (A @ np.array(record.covariance) @ A.T).tolist())))
            for record in records
        ]  # fmt: skip
        return replace(
            self, poses=spatial.compose(self.poses, back), covariances=A @ self.covariances @ A.T, records=records,
            graph=graph,
        )  # fmt: skip


class LidarSlam:
    """Maps a LiDAR's log sweep by sweep.

    Attributes:
        graph: nodes and edges so far.
        submaps: the finished submaps.
        closer: what looks for loops, with its records; None before the first sweep.
        matched: sweeps that surfaces held, and
        unmatched: those that kept KISS-ICP's motion;
        missed: those that lay nowhere near and are left out.
        shares: sum of the shares of points that lay on surfaces.
    """

    def __init__(
        self,
        settings: LidarSettings,
        loops: LoopSettings | None = None,
        *,
        close: bool = True,
        velocity: Velocity | None = None,
        begin: Pose | None = None,
    ) -> None:
        """Begin with an empty map.

        Args:
            settings: of the map.
            loops: how loops are looked for.
            close: whether they are.
            velocity: of the sensor in the first sweep, where it is known.
            begin: T_map_sensor of the first sweep; None: the origin of the map.

        Raises:
            MissingDependencyError: gtsam or kiss-icp cannot be loaded.
        """
        import_gtsam()
        self.settings, self.loops, self._close = settings, loops or LoopSettings(), close
        self._odometry = LidarOdometry(settings, velocity, begin)
        self._fine = settings.make_lattice()
        self._thin = self._fine.scaled(_THIN)
        self.graph = PoseGraph(spatial.SPACE)
        self.submaps: list[LidarSubmap] = []
        self.closer: LidarLoopCloser | None = None
        self.matched = self.unmatched = self.missed = 0
        self.shares = 0.0
        self._stamps: list[float] = []
        # Of each sweep the node before it and its pose as seen from there.
        self._nodes: list[int] = []
        self._seen: list[Pose] = []
        self._node_scans: list[int] = []
        self._node = Pose.identity(3)
        self._last = Pose.identity(3)
        self._metres = self._radians = 0.0
        self._covariance = np.zeros((6, 6))
        self._parts: list[FloatArray] = []
        self._rays: list[Rays] = []
        # What the surfaces are made of: nodes, and where they were.
        self._members: dict[int, Pose] = {}

    @property
    def scans(self) -> int:
        """How many sweeps have been registered."""
        return len(self._stamps)

    # ------------------------------------------------------------------ sweep by sweep

    def register(self, scan: Scan) -> RegisteredSweep:
        """Take the next scan.

        Raises:
            BoundsError: a point is out of range.
        """
        sweep = self._odometry.register(scan)
        if sweep.missed:
            self.missed += 1
            self._covariance += np.diag(np.repeat(np.square(_LOST), 3))
            return sweep
        number = len(self._stamps)
        if number == 0:
            self._node, self._last = sweep.pose, sweep.pose
            self.graph.add_node(spatial.of_pose(sweep.pose))
            self._node_scans.append(0)
        else:
            self._count(sweep)
            self._walk(sweep)
            if self._is_due(number):
                self._new_node(number, sweep)
        self._stamps.append(scan.stamp)
        self._nodes.append(len(self._node_scans) - 1)
        pose = self._node if self._node_scans[-1] == number else sweep.pose
        self._seen.append(self._node.inverse() @ pose)
        self._last = pose
        self._keep(sweep, pose)
        return sweep

    def _count(self, sweep: RegisteredSweep) -> None:
        if sweep.held and sweep.drawn is not None:
            self.matched += 1
            self.shares += sweep.drawn.share
        else:
            self.unmatched += 1

    def _walk(self, sweep: RegisteredSweep) -> None:
        step = self._last.inverse() @ sweep.pose
        self._metres += float(np.linalg.norm(step.translation))
        self._radians += float(angles(step.rotation[None])[0])
        if not sweep.held:
            # KISS-ICP's word alone.
            self._covariance += np.diag(np.repeat(np.square(_LOST), 3))

    def _is_due(self, number: int) -> bool:
        loops = self.loops
        enough = self._metres >= loops.node_metres or self._radians >= loops.node_radians
        return enough and number - self._node_scans[-1] >= loops.node_scans

    def _keep(self, sweep: RegisteredSweep, pose: Pose) -> None:
        """Add a sweep to the surfaces and to the submap that is being made."""
        points = first_of_each_cell(self.settings.in_range(sweep.scan.points), self._thin)
        surfaces = self._odometry.surfaces
        assert surfaces is not None
        surfaces.add(pose.apply(points))
        seen = self._seen[-1]
        self._parts.append(seen.apply(points).astype(np.float32).astype(np.float64))
        if len(self._rays) < _FREE_SWEEPS or len(self._stamps) % 8 == 0:
            chosen = np.linspace(0, len(points) - 1, min(_FREE_BEAMS, len(points))).astype(np.int64)
            self._rays.append(Rays(seen.translation, seen.apply(points[chosen]).astype(np.float32)))

    # ------------------------------------------------------------------ node by node

    def _new_node(self, number: int, sweep: RegisteredSweep) -> None:
        """Make a node of a sweep: finish the submap before it, look for loops."""
        before = len(self.graph) - 1
        self._finish_submap(number)
        motion = spatial.of_pose(self._node.inverse() @ sweep.pose)
        covariance = self._covariance
        if sweep.drawn is not None and sweep.held:
            covariance = covariance + drawn_covariance(sweep.drawn)
        self._covariance = np.zeros((6, 6))
        node = spatial.compose(self.graph.pose(before), motion)
        self.graph.add_node(node)
        self.graph.add_edge(Edge(before, before + 1, motion, covariance))
        self._node_scans.append(number)
        self._metres = self._radians = 0.0
        if self.closer is None:
            assert self._odometry.surfaces is not None
            shelf = SubmapShelf(self._odometry.surfaces.lattice)
            self.closer = LidarLoopCloser(self.graph, self.submaps, shelf, self._fine, self.loops)
        self._members[before] = self._node
        if self._close and self.closer.look(before):
            self.graph.optimise()
        self._follow(sweep.pose)

    def _finish_submap(self, last: int) -> None:
        points = first_of_each_cell(np.concatenate(self._parts), self._thin)
        chosen = np.linspace(0, len(self._rays) - 1, min(_FREE_SWEEPS, len(self._rays))).astype(np.int64)
        rays = tuple(self._rays[k] for k in dict.fromkeys(chosen.tolist()))
        number = len(self.submaps)
        self.submaps.append(LidarSubmap.of(number, self._node_scans[-1], last, points, rays))
        self._parts, self._rays = [], []

    def _follow(self, pose: Pose) -> None:
        """Go on from the new node where the graph has it; make the surfaces anew where they have moved."""
        self._node = spatial.to_pose(self.graph.pose(len(self.graph) - 1))
        wanted = self._wanted()
        lattice = self._odometry.surfaces.lattice if self._odometry.surfaces is not None else None
        assert lattice is not None
        limit = _MOVED * lattice.resolution
        moved = any(
            float(np.linalg.norm(self._members[k].translation - self.graph.pose(k)[9:])) > limit
            for k in self._members
            if k in wanted
        )
        jumped = float(np.linalg.norm(pose.translation - self._node.translation)) > 1e-9
        if moved or jumped or not set(wanted) <= set(self._members) or len(self._members) > 2 * len(wanted):
            surfaces = SurfaceMap(lattice)
            self._members = {}
            for k in wanted:
                T_map_node = spatial.to_pose(self.graph.pose(k))
                surfaces.add(T_map_node.apply(self.submaps[k].points.astype(np.float64)))
                self._members[k] = T_map_node
            self._odometry.surfaces = surfaces
        self._odometry.move_to(self._node)

    def _wanted(self) -> list[int]:
        """Return the nodes whose submaps sweeps are drawn onto, ascending: the nearest ones of those well known."""
        here = len(self.graph) - 1
        poses = self.graph.poses
        apart = np.linalg.norm(poses[:here, 9:] - poses[here, 9:], axis=1)
        reach = np.array([s.reach for s in self.submaps[:here]])
        near = np.flatnonzero(apart < 2.0 * reach + self.loops.node_metres)
        near = near[np.argsort(apart[near], kind="stable")][: 2 * self.loops.most_local]
        assert self._odometry.surfaces is not None
        limit = _TRUSTED * self._odometry.surfaces.lattice.resolution
        covariances = self.graph.relative_covariances(here, near.tolist())
        sigma = np.sqrt(np.linalg.eigvalsh(covariances[:, :3, :3])[:, -1]) if len(near) else np.zeros(0)
        recent = near >= here - 2
        return sorted(near[(sigma < limit) | recent][: self.loops.most_local].tolist())

    # ------------------------------------------------------------------ the end

    def finish(self) -> LidarSlamResult:
        """Finish the last submap, throw out false loops and return all poses."""
        self._finish_submap(len(self._stamps))
        if self.closer is not None and self._close:
            self.closer.look(len(self.submaps) - 1)
            self.closer.finish()
            self.closer.throw_out(self.graph.optimise_robustly())
        nodes = np.array(self._nodes)
        seen = np.array([spatial.of_pose(p) for p in self._seen])
        poses = spatial.compose(self.graph.poses[nodes], seen)
        # What is known of a node is known of the sweeps from there on, seen from theirs.
        count = len(self.graph)
        of_nodes = self.graph.relative_covariances(0, range(count)) if count > 1 else np.zeros((1, 6, 6))
        A = spatial.adjoint(spatial.invert(seen))
        covariances = A @ of_nodes[nodes] @ np.swapaxes(A, 1, 2)
        records = [] if self.closer is None else self.closer.records
        return LidarSlamResult(np.array(self._stamps), poses, covariances, records, self.graph, self._node_scans)

    def surfaces(self, poses: FloatArray) -> SurfaceMap:
        """Return the surfaces of all submaps whose nodes are at ``poses`` (K, 12)."""
        assert self._odometry.surfaces is not None
        surfaces = SurfaceMap(self._odometry.surfaces.lattice)
        for submap in self.submaps:
            pose = spatial.to_pose(poses[submap.number])
            surfaces.add(pose.apply(submap.points.astype(np.float64)))
        return surfaces

    @property
    def unknown_share(self) -> float:
        """Share of the sweeps that surfaces did not hold."""
        total = self.matched + self.unmatched
        return self.unmatched / total if total else 0.0

    @property
    def mean_share(self) -> float:
        """Mean share of a matched sweep's points that lay on surfaces."""
        return self.shares / self.matched if self.matched else math.nan
