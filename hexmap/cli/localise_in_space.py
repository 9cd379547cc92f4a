"""Finding and following a LiDAR in a known map of space."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexmap.cli.build_lidar import lidar_settings
from hexmap.cli.console import first_run_note, progress_line, say, warn, wrote

if TYPE_CHECKING:
    from hexmap.maps.state_rule import States

__all__ = ["LocaliseOutputs", "localise_in_space"]


@dataclass(frozen=True)
class LocaliseOutputs:
    """What is written; None for what is not."""

    poses: Path
    csv: Path | None = None
    picture: Path | None = None


def localise_in_space(
    log: Path,
    map: Path,
    states: States,
    options: dict[str, Any],
    start: tuple[float, float, float] | None,
    time_limit: float | None,
    outputs: LocaliseOutputs,
) -> None:
    """Localise, write and report; ``options`` are those of the LiDAR's settings, None where not given."""
    from contextlib import ExitStack

    from hexmap.base.atomic_files import atomic_write
    from hexmap.base.errors import LogError
    from hexmap.io.lidar.open_lidar import open_lidar
    from hexmap.io.trajectories import write_tum
    from hexmap.poses.trajectory import Trajectory
    from localisation.localiser.lidar_localiser import localise_lidar_log, space_csv_header, space_csv_line

    settings = lidar_settings({}, options)
    source = open_lidar(log, settings.log)
    first_run_note(45)
    begin = time.monotonic()
    stamps: list[float] = []
    poses: list[Any] = []
    with ExitStack() as stack:
        table = stack.enter_context(atomic_write(outputs.csv, "w")) if outputs.csv is not None else None
        if table is not None:
            table.write(space_csv_header() + "\n")

        def on_estimate(estimate: Any) -> None:
            if table is not None:
                table.write(space_csv_line(estimate) + "\n")
            if estimate.pose is not None:
                stamps.append(estimate.stamp)
                poses.append(estimate.pose)

        at = None if start is None else (start[0], start[1], math.radians(start[2]))
        with progress_line("localising", source.fraction) as progress:
            track = localise_lidar_log(
                source, states, settings, start=at, time_limit=time_limit, on_estimate=on_estimate, progress=progress
            )
    seconds = time.monotonic() - begin
    for text in track.warnings:
        warn(text)
    if not poses:
        raise LogError(
            f"{source.path}: not in this map ({map}), or nowhere without doubt: none of {track.scans} scans has a pose"
        )
    write_tum(outputs.poses, Trajectory.from_poses(stamps, poses))
    rate = 1000 * seconds / max(track.scans, 1)
    say(f"{track.scans} scans in {seconds:.1f} s ({rate:.1f} ms a scan); localised after {track.scans_until} scans")
    share = track.placed / track.scans
    say(f"{share:.1%} of the scans have a pose, {track.metres:.1f} m; lost {track.times_lost} times")
    wrote(outputs.poses, f"{track.placed} poses of {source.poses_of}, TUM")
    if outputs.csv is not None:
        wrote(outputs.csv, f"{track.scans} scans")
    if outputs.picture is not None:
        _draw(states, outputs.picture, poses)
        wrote(outputs.picture, "picture")


def _draw(states: States, picture: Path, poses: list[Any]) -> None:
    import numpy as np

    from hexmap.drawing.solids.draw_solids import draw_solids

    draw_solids(states.occupied, picture, trajectory=np.array([pose.translation for pose in poses]))
