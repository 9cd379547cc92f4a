"""Building the maps of many logs, and the options of work that several workers or a cluster share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli.console import first_run_note, progress_line, say, warn

if TYPE_CHECKING:
    from localisation.lidar_settings import LidarSettings
    from localisation.settings import MappingSettings

__all__ = ["Cluster", "FleetOutputs", "build_fleet_maps", "check_fleet"]

Cluster = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Work on the Dask cluster of this scheduler, tcp://HOST:PORT."),
]


@dataclass(frozen=True)
class FleetOutputs:
    """Where the maps of many logs go, and who makes them."""

    folder: Path
    workers: int
    cluster: str | None


# Options that are of one map alone.
_OF_ONE_MAP = (
    "trajectory", "picture", "loops", "loops_picture", "graph", "covariance", "continue_map", "checkpoint", "poses",
    "associate", "tiles",
)  # fmt: skip


def check_fleet(fleet: bool, options: dict[str, Any]) -> None:
    """Refuse options that are for many logs alone, and those that are for one map.

    Raises:
        BadParameter: naming the option.
    """
    if not fleet:
        for name, is_set in (("--workers", options["workers"] != 1), ("--cluster", options["cluster"] is not None)):
            if is_set:
                raise typer.BadParameter(f"{name} is for many logs, a map of each, with --fleet")
        return
    for name in _OF_ONE_MAP:
        if options[name] is not None:
            option = "--continue" if name == "continue_map" else f"--{name.replace('_', '-')}"
            raise typer.BadParameter(f"{option} is of one map, and --fleet makes one of each log")
    if options["output"].suffix.lower() == ".parquet":
        raise typer.BadParameter(f"--output: {options['output']}: the maps of a fleet go into a folder")


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

    first_run_note(45)
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
