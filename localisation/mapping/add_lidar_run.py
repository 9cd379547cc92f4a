"""Another run of a LiDAR in a place that is mapped already: found in the map, held to it, and added.

The run is mapped by itself first, with its loops closed. Its submaps are looked for in the old map as scans are, all
over it; most of those that are found must agree on where the run lies. From there on submap after submap is drawn onto
the surfaces of the old map, and a graph of the run's own edges and of these bends the run to the old map, whose poses
are fixed. A run of several submaps belongs there only if two of them lie on the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import AlignmentError, ArgumentError
from hexmap.io.lidar.lidar_log import LidarLog
from hexmap.maps.map import Map
from hexmap.maps.origin import frames_of, sources_in_frame
from hexmap.poses.pose import Pose
from localisation.lidar_settings import LidarSettings
from localisation.localiser.lidar_localiser import LidarLocaliser
from localisation.mapping.align import pose_words
from localisation.mapping.checkpoint import Checkpoints
from localisation.mapping.lidar_map import LidarMappingResult, LidarRun, fuse_lidar_run, map_lidar_run
from localisation.mapping.loop_closed_map import Phase
from localisation.mapping.result import OnPose
from localisation.slam import spatial
from localisation.slam.lidar_loops import drawn_covariance
from localisation.slam.pose_graph import Edge, PoseGraph
from localisation.slam.settings import LoopSettings

__all__ = ["FoundRun", "add_lidar_run", "lidar_settings_of"]

# Submaps that are looked for all over the map, spread evenly over the run: each takes seconds where it is not in it.
_LOOKED_FOR = 12
# Submaps agree on where the run lies to this, metres and radians: a run bends by as much from one end to the other.
_AGREE = (1.0, math.radians(5.0))
# So many more of them than anywhere else are enough: the others need not be looked for.
_LEAD = 2
# What ties the run to the map where no submap is held, standard deviations: where the first was found, give or take.
_TIE = (0.25, math.radians(2.5))


@dataclass(frozen=True)
class FoundRun:
    """Where a run was found in a map.

    Attributes:
        pose: T_map_run: where its own map's origin came to lie.
        looked_for: submaps that were looked for all over the map, and
        found: those of them that agree.
        held: submaps that lie on surfaces of the map, of
        submaps: so many.
    """

    pose: Pose
    looked_for: int
    found: int
    held: int
    submaps: int


def lidar_settings_of(map: Map) -> LidarSettings:
    """Return the settings with which a map in space was made, as far as it says; else the defaults on its lattice."""
    for source in reversed(map.sources()):
        if isinstance(source.get("settings"), dict):
            return LidarSettings.from_dict(source["settings"])
    return LidarSettings(lattice=map.lattice.basis.tolist(), levels=len(map.levels))


def add_lidar_run(
    map: Map,
    log: LidarLog,
    settings: LidarSettings | None = None,
    loops: LoopSettings | None = None,
    *,
    on_pose: OnPose | None = None,
    phase: Phase | None = None,
    checkpoints: Checkpoints | None = None,
) -> tuple[LidarMappingResult, FoundRun]:
    """Map a LiDAR's log, find it in a map, and add it.

    Args:
        map: whose frame counts, with level floors, and which is not changed.
        log: an open log of the same place, or of one that overlaps it.
        settings: of the map; None: those of ``map``.
        loops: how loops of the log itself are looked for.
        on_pose: called at the end with the poses in the frame of ``map``.
        phase: shows what is being done.
        checkpoints: where the run keeps what it knows.

    Returns:
        The result, whose map holds both, and where the run was found.

    Raises:
        ArgumentError: the settings are not those of the map's lattice and levels.
        AlignmentError: the run cannot be found in the map beyond doubt; the text says how much of it was.
        LogError: the log cannot be read or has no scan.
        MissingDependencyError: kiss-icp or gtsam cannot be loaded.
    """
    settings = settings or lidar_settings_of(map)
    lattice = settings.make_lattice()
    if lattice != map.lattice or settings.levels != len(map.levels):
        raise ArgumentError(
            f"a map on {map.lattice.name} at {map.lattice.resolution:g} m of {len(map.levels)} levels goes on with "
            f"these, not with {lattice.name} at {lattice.resolution:g} m of {settings.levels}"
        )
    run = map_lidar_run(log, settings, loops, phase=phase, checkpoints=checkpoints)
    localiser = LidarLocaliser(map.state(settings.rule), settings)
    held, about = _find(localiser, run, map.lattice.resolution)
    result = fuse_lidar_run(held, None, on_pose=on_pose, phase=phase)
    moved = Map(result.map.levels, map.frame, sources_in_frame(result.map.sources(), frames_of(map.sources())))
    return replace(result, made=map.merge(moved, same_frame=True)), about


def _find(localiser: LidarLocaliser, run: LidarRun, resolution: float) -> tuple[LidarRun, FoundRun]:
    """Return a run with its poses in the frame of a map, bent to it.

    Raises:
        AlignmentError: none of its submaps is found, or none beside the one that is.
    """
    submaps, nodes = run.slam.submaps, run.result.graph.poses
    chosen = np.linspace(0, len(submaps) - 1, min(_LOOKED_FOR, len(submaps))).round().astype(np.int64)
    # Places on which submaps agree: T_map_run, and the submaps.
    groups: list[tuple[Pose, list[int]]] = []
    count = 0
    for k in chosen.tolist():
        count += 1
        T_run_node = spatial.to_pose(nodes[k])
        points = submaps[k].points.astype(np.float64)
        # In axes parallel to the run's own, so that little is left to level.
        level = Pose(T_run_node.rotation, np.zeros(3))
        places = localiser.look_for(level.apply(points))
        place = localiser.draw(points, places[0].pose @ level) if len(places) == 1 else None
        if place is None or not place.holds:
            continue
        T_map_run = place.pose @ T_run_node.inverse()
        agreeing = next((found for T, found in groups if T.is_close(T_map_run, *_AGREE)), None)
        if agreeing is None:
            groups.append((T_map_run, [k]))
        else:
            agreeing.append(k)
        groups.sort(key=lambda group: -len(group[1]))
        if len(groups[0][1]) >= _LEAD + (len(groups[1][1]) if len(groups) > 1 else 0):
            break
    where = f"{run.log.path}: not found in the map beyond doubt:"
    if not groups:
        raise AlignmentError(f"{where} none of the {len(chosen)} parts of it that were looked for is in it")
    T_map_run, found = groups[0]
    if len(groups) > 1 and len(groups[1][1]) == len(found):
        raise AlignmentError(
            f"{where} of the {len(chosen)} parts of it that were looked for {len(found)} lie at "
            f"{pose_words(T_map_run)}, and as many at {pose_words(groups[1][0])}"
        )
    bent, held = _hold(localiser, run, T_map_run, found[0], resolution)
    if held < min(2, len(submaps)):
        raise AlignmentError(
            f"{where} {len(found)} of the {len(chosen)} parts of it that were looked for might be in it, the others "
            "not beside it"
        )
    return bent, FoundRun(T_map_run, count, len(found), held, len(submaps))


def _hold(
    localiser: LidarLocaliser, run: LidarRun, T_map_run: Pose, first: int, resolution: float
) -> tuple[LidarRun, int]:
    """Return a run with its poses in the frame of a map, bent to it, and how many of its submaps lie on the map."""
    own, submaps = run.result.graph, run.slam.submaps
    graph = PoseGraph(spatial.SPACE)
    graph.add_node(spatial.of_pose(Pose.identity(3)))
    for pose in own.poses:
        graph.add_node(spatial.compose(spatial.of_pose(T_map_run), pose))
    tie = np.diag(np.repeat(np.square(_TIE), 3))
    graph.add_edge(Edge(0, first + 1, graph.pose(first + 1), tie))
    for edge, weight in zip(own.edges, own.weights, strict=True):
        if weight > 0.5:
            graph.add_edge(replace(edge, i=edge.i + 1, j=edge.j + 1))
    # A wall lies somewhere within its cells, along each axis.
    cell = np.diag([resolution**2 / 12.0] * 3 + [0.0] * 3)
    count = 0
    # From the one that was found to both sides: where the graph has the next one is known best then.
    for k in sorted(range(len(submaps)), key=lambda k: (abs(k - first), k)):
        place = localiser.draw(submaps[k].points.astype(np.float64), spatial.to_pose(graph.pose(k + 1)))
        if not place.holds:
            continue
        graph.add_edge(Edge(0, k + 1, spatial.of_pose(place.pose), drawn_covariance(place.drawn) + cell, loop=True))
        graph.optimise()
        count += 1
    count -= len(graph.optimise_robustly())
    return _bent(run, graph), count


def _bent(run: LidarRun, graph: PoseGraph) -> LidarRun:
    """Return a run whose nodes are at the poses of a graph, in which the map is the first node."""
    result = run.result
    after = graph.poses[1:]
    nodes = np.searchsorted(result.node_scans, np.arange(len(result.poses)), side="right") - 1
    seen = spatial.between(result.graph.poses[nodes], result.poses)
    covariances: FloatArray = graph.relative_covariances(0, range(1, len(graph)))[nodes]
    A = spatial.adjoint(spatial.invert(seen))
    bent = replace(
        result, poses=spatial.compose(after[nodes], seen), covariances=A @ covariances @ np.swapaxes(A, 1, 2),
        graph=result.graph.moved(after),
    )  # fmt: skip
    return replace(run, result=bent)
