"""Building the maps of many logs, and the options of work that several workers or a cluster share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hexmap.cli.console import first_run_note, progress_line, say, warn

if TYPE_CHECKING:
    from localisation.lidar_settings import LidarSettings
    from localisation.settings import MappingSettings

__all__ = ["Cluster", "build_fleet_maps"]

Cluster = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Work on the Dask cluster of this scheduler, tcp://HOST:PORT."),
]


def build_fleet_maps(
    logs: list[Path],
    folder: Path,
    settings: MappingSettings | LidarSettings,
    loop_closure: bool,
    workers: int,
    cluster: str | None,
) -> None:
    """Map every log into a folder and say what became of them.

    Raises:
        LogError: at the end, where a log has no map.
    """
    from hexmap.base.errors import LogError
    from hexmap.base.text import plural
    from hexmap.experiments.cluster import cluster_executor
    from localisation.mapping.fleet import build_fleet

    first_run_note()
    fraction = [0.0]
    with cluster_executor(cluster) as executor, progress_line("building", lambda: fraction[0], "logs") as update:

        def progress(done: int, total: int) -> None:
            fraction[0] = done / total
            update(done)

        fleet = build_fleet(
            logs, folder, settings, loop_closure=loop_closure, workers=workers, executor=executor, progress=progress
        )
    for text in fleet.warnings:
        warn(text)
    kept = f"; {plural(len(fleet.kept), 'map')} of an earlier run kept" if fleet.kept else ""
    say(f"wrote {plural(len(fleet.built), 'map')} to {folder}{kept}")
    for log, text in fleet.failed.items():
        warn(text if str(log.name) in text else f"{log}: {text}")
    if fleet.failed:
        names = ", ".join(str(log) for log in fleet.failed)
        raise LogError(f"{len(fleet.failed)} of {len(logs)} logs could not be mapped: {names}")
