"""Another run of a place that is mapped already: found in the map, held to it, and added.

The run is mapped by itself first, with its loops closed. Its map is found in the old one as one whole, beyond doubt or
not at all (``align``). Then each of its submaps is matched in the old map near where that puts it, and a graph of the
run's own edges and these matches bends the run to the old map: the poses of that are fixed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.io.logs.log import Log
from hexmap.maps.map import Map
from hexmap.maps.origin import frames_of, sources_in_frame
from localisation.mapping.align import Alignment, AlignSettings, align_maps
from localisation.mapping.checkpoint import Checkpoints
from localisation.mapping.loop_closed_map import MappedRun, Phase, fuse_run, map_run, silent
from localisation.mapping.result import MappingResult, OnPose
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.search_region import SearchRegion
from localisation.settings import MappingSettings
from localisation.slam import planar
from localisation.slam.loop_closer import local_covariance
from localisation.slam.pose_graph import Edge, PoseGraph
from localisation.slam.rematch import carry_along
from localisation.slam.settings import LoopSettings

__all__ = ["add_run", "settings_of"]

# Metres and radians around the place where the whole map was found: runs that were mapped apart bend by as much.
_METRES, _RADIANS = 0.5, np.radians(5.0)
# Points of a submap that are matched.
_POINTS = 400


def settings_of(map: Map) -> MappingSettings:
    """Return the settings with which a map was made, as far as it says; else the defaults on its lattice."""
    for source in reversed(map.sources()):
        if isinstance(source.get("settings"), dict):
            return MappingSettings.from_dict(source["settings"])
    levels = len(map.levels)
    return MappingSettings(lattice=map.lattice.basis.tolist(), levels=levels, search_level=min(1, levels - 1))


def add_run(
    map: Map,
    log: Log,
    settings: MappingSettings | None = None,
    loops: LoopSettings | None = None,
    *,
    align: AlignSettings | None = None,
    on_pose: OnPose | None = None,
    phase: Phase | None = None,
    checkpoints: Checkpoints | None = None,
) -> tuple[MappingResult, Alignment]:
    """Map a log, find it in a map, and add it.

    Args:
        map: whose frame counts, and which is not changed.
        log: an open log of the same place, or of one that overlaps it.
        settings: of the map; None: those of ``map``.
        loops: how loops of the log itself are looked for.
        align: what speaks for the place where it is found.
        on_pose: called at the end with the poses in the frame of ``map``.
        phase: shows what is being done.
        checkpoints: where the run keeps what it knows.

    Returns:
        The result, whose map holds both, and where the run was found as a whole.

    Raises:
        ArgumentError: the settings are not those of the map's lattice and levels.
        AlignmentError: the run cannot be found in the map beyond doubt; the text says why.
        LogError: the log cannot be read or has no laser reading.
    """
    settings = settings or settings_of(map)
    lattice = settings.make_lattice()
    if lattice != map.lattice or settings.levels != len(map.levels):
        raise ArgumentError(
            f"a map on {map.lattice.name} at {map.lattice.resolution:g} m of {len(map.levels)} levels goes on with "
            f"these, not with {lattice.name} at {lattice.resolution:g} m of {settings.levels}"
        )
    run = map_run(log, settings, loops, phase=phase, checkpoints=checkpoints)
    alone = fuse_run(run, settings, phase=phase)
    shown = phase or silent
    with shown("looking for it in the map", lambda: 0.0):
        found = align_maps(map, alone.map, align, rules=(settings.rule, settings.rule))
    with shown("bending it to the map", lambda: 0.0):
        held = _hold(map, run, settings, planar.of_pose(found.pose))
    result = fuse_run(held, settings, on_pose=on_pose, phase=phase)
    moved = Map(result.map.levels, map.frame, sources_in_frame(result.map.sources(), frames_of(map.sources())))
    return replace(result, made=map.merge(moved, same_frame=True)), found


def _hold(map: Map, run: MappedRun, settings: MappingSettings, T_map_run: FloatArray) -> MappedRun:
    """Return a run with its poses in the frame of a map, bent to it."""
    own = run.result.graph
    before = own.poses
    graph = PoseGraph()
    graph.add_node(np.zeros(3))
    for pose in before:
        graph.add_node(planar.compose(T_map_run, pose))
    # What ties the two together where no submap is held: the place where the whole was found, give or take the window.
    sigmas = np.array([_METRES, _METRES, _RADIANS]) / 2.0
    graph.add_edge(Edge(0, 1, graph.pose(1), np.diag(sigmas**2)))
    for edge, weight in zip(own.edges, own.weights, strict=True):
        if weight > 0.5:
            graph.add_edge(replace(edge, i=edge.i + 1, j=edge.j + 1))
    matcher = GlobalMatcher.of_map(map, settings.rule, settings.search_level, anywhere=True)
    for submap in run.slam.submaps:
        anchor = _anchor(matcher, submap.points()[0], graph.pose(submap.number + 1), submap.number + 1)
        if anchor is not None:
            graph.add_edge(anchor)
    graph.optimise_robustly()
    after = graph.poses[1:]
    covariances = graph.relative_covariances(0, range(1, len(graph)))
    rows = run.result.poses[run.result.is_scan]
    scans = _with_nodes(rows, np.array(run.result.node_scans), before, after)
    poses = carry_along(run.result, scans)
    node_of = np.searchsorted(np.flatnonzero(run.result.is_scan)[run.result.node_scans], np.arange(len(poses)), "right")
    sure = covariances[np.maximum(node_of - 1, 0)]
    return replace(run, result=replace(run.result, poses=poses, covariances=sure, graph=own.moved(after)))


def _anchor(matcher: GlobalMatcher, points: FloatArray, pose: FloatArray, node: int) -> Edge | None:
    """Match a submap in the old map near ``pose`` (3,); None where it lies in no part that the map knows."""
    kept, _ = thin(points, matcher.lattice) if len(points) else (points, None)
    if len(kept) == 0:
        return None
    region = SearchRegion(pose[:2] - _METRES, pose[:2] + _METRES, float(pose[2]), float(_RADIANS))
    match = matcher.match(kept, region, runner_up=None, most_points=_POINTS, beams=False)
    if match is None or not match.certified or match.overlap < 0.5 or match.information is None:
        return None
    covariance = local_covariance(np.asarray(np.linalg.inv(match.information), np.float64), match.pose)
    return Edge(0, node, planar.of_pose(match.pose), covariance, loop=True)


def _with_nodes(rows: FloatArray, nodes: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the poses (S, 3) of scans when the nodes, scans ``nodes`` (K,), go from ``before`` to ``after`` (K, 3)."""
    number = np.arange(len(rows))
    a = np.clip(np.searchsorted(nodes, number, side="right") - 1, 0, len(nodes) - 1)
    b = np.minimum(a + 1, len(nodes) - 1)
    by_a = planar.compose(after[a], planar.between(before[a], rows))
    by_b = planar.compose(after[b], planar.between(before[b], rows))
    share = np.where(b > a, (number - nodes[a]) / np.maximum(nodes[b] - nodes[a], 1), 0.0)
    return planar.blend(by_a, by_b, np.clip(share, 0.0, 1.0))
