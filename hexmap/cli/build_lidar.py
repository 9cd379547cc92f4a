"""Building a map in space from a LiDAR's log: a bag with clouds, or a folder of point files."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexmap.cli.console import first_run_note, mount_words, progress_line, say, warn, wrote
from hexmap.cli.stores import map_store, phase, stored_words, written

if TYPE_CHECKING:
    from hexmap.io.lidar.lidar_log import LidarLog
    from hexmap.maps.map import Map
    from hexmap.poses.pose import Pose
    from localisation.lidar_settings import LidarSettings
    from localisation.mapping.lidar_map import LidarMappingResult
    from localisation.mapping.result import OnPose

__all__ = ["LidarOutputs", "build_lidar", "lidar_settings"]


@dataclass(frozen=True)
class LidarOutputs:
    """What is written; None for what is not."""

    map: Path
    trajectory: Path | None = None
    picture: Path | None = None
    loops: Path | None = None
    graph: Path | None = None
    covariance: Path | None = None
    tiles: float | None = None


def lidar_settings(values: dict[str, Any], options: dict[str, Any]) -> LidarSettings:
    """Return the settings of a configuration with the options that were given; None where they were not."""
    from localisation.lidar_settings import LidarSettings

    merged = dict(values)
    for name, value in options.items():
        if isinstance(value, dict):
            given = {k: v for k, v in value.items() if v is not None}
            if given:
                merged[name] = {**merged.get(name, {}), **given}
        elif value is not None:
            merged[name] = value
    return LidarSettings.from_dict(merged)


def build_lidar(
    logs: list[Path],
    settings: LidarSettings,
    outputs: LidarOutputs,
    poses: Path | None,
    associate: str | None,
    close: bool,
    old: Map | None = None,
    checkpoint: Path | None = None,
) -> None:
    """Build, write and report.

    Args:
        logs: bags or folders; several are mapped one after the other, each found in the map of those before it.
        settings: of the map.
        outputs: what is written.
        poses: a file of poses to fuse the only log at, instead of matching.
        associate: how these go with scans.
        close: whether loops are closed.
        old: a map in which the logs are found, and to which they are added.
        checkpoint: a folder in which a run that was killed is found again and goes on.
    """
    from contextlib import ExitStack

    from hexmap.io.lidar.open_lidar import open_lidar
    from hexmap.io.trajectories import TumWriter, read_trajectory
    from localisation.mapping.checkpoint import forget
    from localisation.mapping.lidar_map import fuse_lidar_log
    from localisation.odometry.kiss import import_kiss_icp

    sources = [open_lidar(log, settings.log) for log in logs]
    given = None if poses is None else read_trajectory(poses)
    if given is None:
        import_kiss_icp()
    first_run_note(45)
    places: list[list[float]] = []
    with ExitStack() as stack:
        store = stack.enter_context(map_store(outputs.map, outputs.tiles))
        writer = None if outputs.trajectory is None else stack.enter_context(TumWriter(outputs.trajectory))

        def on_pose(stamp: float, pose: Pose, is_scan: bool) -> None:
            places.append(pose.translation.tolist())
            if writer is not None:
                writer.append(stamp, pose)

        if given is None:
            result = _map_logs(sources, settings, close, old, checkpoint, on_pose, places, store)
        else:
            begin = time.monotonic()
            result = fuse_lidar_log(
                sources[0], given, settings, associate=associate, on_pose=on_pose, phase=progress_line, store=store
            )
            _report(sources[0], result, time.monotonic() - begin - store.seconds)
        stored = written(result.made, outputs.map)
    if checkpoint is not None:
        forget(checkpoint, len(sources))
    wrote(outputs.map, stored_words(stored))
    if outputs.trajectory is not None:
        whose = " and ".join(dict.fromkeys(source.poses_of for source in sources))
        wrote(outputs.trajectory, f"poses of {whose} at the scans' stamps, TUM")
    if result.slam is not None:
        _write_loops(result, outputs)
    if outputs.picture is not None:
        import numpy as np

        from hexmap.drawing.solids.draw_solids import draw_solids

        draw_solids(result.map.state(settings.rule).occupied, outputs.picture, trajectory=np.array(places))
        wrote(outputs.picture, "picture")


def _map_logs(
    sources: list[LidarLog],
    settings: LidarSettings,
    close: bool,
    old: Map | None,
    checkpoint: Path | None,
    on_pose: OnPose,
    places: list[list[float]],
    store: Any,
) -> LidarMappingResult:
    """Map one log after the other, each found in the map of those before it; returns the last result.

    ``places``, where the poses are, get a gap between two runs; ``store`` takes the map of a single one.
    """
    from localisation.mapping.add_lidar_run import add_lidar_run
    from localisation.mapping.align import pose_words
    from localisation.mapping.checkpoint import checkpoints_of
    from localisation.mapping.lidar_map import build_lidar_map

    result: LidarMappingResult | None = None
    world = old
    kept = checkpoints_of(checkpoint, len(sources))
    for source, checkpoints in zip(sources, kept, strict=True):
        begin = time.monotonic()
        if checkpoints is not None and checkpoints.path.exists():
            say(f"{source.path}: goes on from {checkpoints.path}")
        how: dict[str, Any] = {"on_pose": on_pose, "phase": phase, "checkpoints": checkpoints}
        if places:
            places.append([math.nan] * 3)
        if world is None:
            result = build_lidar_map(source, settings, close=close, **how, store=store if len(sources) == 1 else None)
        else:
            result, found = add_lidar_run(world, source, settings, **how)
            say(
                f"{source.path}: begins at {pose_words(found.pose)} in the map; {found.held} of its {found.submaps} "
                "parts lie on it"
            )
        if len(sources) > 1:
            world = result.map
        _report(source, result, time.monotonic() - begin - store.seconds)
    assert result is not None
    return result


def _report(source: Any, result: LidarMappingResult, seconds: float) -> None:
    from hexmap.base.text import plural

    for text in result.warnings:
        warn(text)
    if source.mount is not None:
        say(f"the LiDAR on {source.poses_of}: {mount_words(source.mount)}")
    how = "given poses"
    if result.slam is not None:
        how = "nothing to match"
        if result.matched:
            how = f"{result.mean_share:.0%} of a scan's points lie on surfaces on average"
    say(
        f"{result.scans} scans, {result.metres:.1f} m, in {seconds:.1f} s "
        f"({result.scans / max(seconds, 1e-9):.1f} scans a second); {how}"
    )
    if result.skipped:
        warn(f"{source.path}: {plural(result.skipped, 'scan')} without a pose left out")
    if result.missed:
        warn(f"{source.path}: {plural(result.missed, 'scan')} left out, nowhere near the ones before")
    if result.unmatched:
        warn(f"{source.path}: {plural(result.unmatched, 'scan')} on no surface, where the motion predicted was kept")
    if result.levelled is not None and result.levelled > math.radians(0.1):
        say(f"turned by {math.degrees(result.levelled):.1f} degrees so that floors are level (--no-level leaves it)")


def _write_loops(result: LidarMappingResult, outputs: LidarOutputs) -> None:
    """Say what was found of loops, and write what is asked for of them."""
    from localisation.slam.loop_files import write_covariances, write_loops

    slam = result.slam
    assert slam is not None
    accepted = sum(record.accepted for record in slam.records)
    tried = len(slam.records)
    say(f"{len(slam.graph)} nodes; {tried} loops tried: {accepted} closed, {tried - accepted} rejected")
    if outputs.loops is not None:
        write_loops(outputs.loops, slam)
        wrote(outputs.loops, "every loop that was tried")
    if outputs.graph is not None:
        slam.graph.write_g2o(outputs.graph)
        wrote(outputs.graph, "graph of poses, g2o")
    if outputs.covariance is not None:
        write_covariances(outputs.covariance, slam)
        wrote(outputs.covariance, "how sure each pose is")
