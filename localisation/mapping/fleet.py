"""Many logs, a map of each: on any number of workers, through any interruption, to the same bits.

A log is a task. Its map is written whole or not at all and says itself which log and which settings it is of, so that a
run that was stopped goes on where it was: what is there and fits is kept. A log that cannot be mapped is named at the
end, and costs no other.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hexmap.base.errors import ArgumentError, FileAccessError, FormatError, HexmapError
from hexmap.base.local_workers import LocalWorkers
from hexmap.base.text import reason
from hexmap.base.version import __version__
from hexmap.io.fingerprint import fingerprint
from hexmap.io.lidar.open_lidar import is_lidar_log, open_lidar
from hexmap.io.logs.open_log import open_log
from hexmap.io.map_file import read_metadata
from hexmap.io.map_store import FileStore
from localisation.lidar_settings import LidarSettings
from localisation.mapping.build_map import build_map
from localisation.mapping.lidar_map import build_lidar_map
from localisation.mapping.loop_closed_map import build_loop_closed_map
from localisation.settings import MappingSettings

__all__ = ["Fleet", "build_fleet", "map_log", "map_names"]


@dataclass
class Fleet:
    """What became of the logs.

    Attributes:
        built: maps that were made, in the order of the logs.
        kept: maps that were there already.
        failed: logs without a map, and why.
        warnings: what was odd about logs that were mapped.
    """

    built: list[Path] = field(default_factory=list)
    kept: list[Path] = field(default_factory=list)
    failed: dict[Path, str] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)


def map_names(logs: Sequence[Path]) -> list[str]:
    """Return what the map of each log is called: as the log, without its suffixes.

    Raises:
        ArgumentError: two would have one name.
    """
    names: dict[str, Path] = {}
    for log in logs:
        name = log.name
        for suffix in (".gz", log.with_suffix("").suffix if log.suffix == ".gz" else log.suffix):
            name = name.removesuffix(suffix) if suffix else name
        name = f"{name or log.name}.parquet"
        if name in names:
            raise ArgumentError(f"{names[name]} and {log} would have maps of one name, {name}")
        names[name] = log
    return list(names)


def build_fleet(
    logs: Sequence[str | os.PathLike[str]],
    folder: str | os.PathLike[str],
    settings: MappingSettings | LidarSettings | None = None,
    *,
    loop_closure: bool = True,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fleet:
    """Map every log into a folder, a file a log.

    Args:
        logs: all of planar lasers or, with LidarSettings, all of LiDARs.
        folder: where the maps are written; made where it is missing.
        settings: of all maps.
        loop_closure: whether loops are found and closed.
        workers: processes of this machine; one maps in this process.
        executor: maps the logs instead of ``workers``: any whose workers see the files under the same paths.
        progress: called as ``progress(done, total)`` at the beginning and after every log.

    Raises:
        ArgumentError: two logs whose maps would have one name, or ``workers`` is out of range.
        FileAccessError: the folder cannot be made.
        KeyboardInterrupt: after Ctrl-C, with the workers stopped and every map whole.
    """
    paths, target = [Path(log) for log in logs], Path(folder)
    if isinstance(workers, bool) or workers < 1:
        raise ArgumentError(f"the number of workers must be 1 or larger, not {workers!r}")
    chosen = settings or MappingSettings()
    common = {"settings": chosen.to_dict(), "space": isinstance(chosen, LidarSettings), "close": loop_closure}
    tasks = [
        json.dumps({"log": os.path.abspath(log), "map": os.path.abspath(target / name), **common}, sort_keys=True)
        for log, name in zip(paths, map_names(paths), strict=True)
    ]
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileAccessError(f"{target}: cannot be made: {reason(error)}") from error
    found: dict[int, dict[str, Any]] = {}
    if progress is not None:
        progress(0, len(tasks))
    for number, result in _results(tasks, workers, executor):
        found[number] = result
        if progress is not None:
            progress(len(found), len(tasks))
    fleet = Fleet()
    for number, (log, task) in enumerate(zip(paths, tasks, strict=True)):
        result, path = found[number], target / Path(json.loads(task)["map"]).name
        if "error" in result:
            fleet.failed[log] = result["error"]
        else:
            (fleet.kept if result["kept"] else fleet.built).append(path)
            fleet.warnings += result["warnings"]
    return fleet


def _results(tasks: list[str], workers: int, executor: Executor | None) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the number and the result of each task as it is finished."""
    if executor is None and (workers == 1 or len(tasks) < 2):
        for number, task in enumerate(tasks):
            yield number, map_log(task)
        return
    if executor is not None:
        yield from _computed(tasks, executor)
        return
    with LocalWorkers(min(workers, len(tasks))) as pool:
        yield from _computed(tasks, pool)


def _computed(tasks: list[str], executor: Executor) -> Iterator[tuple[int, dict[str, Any]]]:
    pending: dict[Future[dict[str, Any]], int] = {}
    try:
        for number, task in enumerate(tasks):
            pending[executor.submit(map_log, task)] = number
        for future in as_completed(pending):
            try:
                result = future.result()
            except Exception as error:  # the end of a worker: the log's task alone is lost
                result = {"error": " ".join(f"{error}".split()) or type(error).__name__}
            yield pending[future], result
    finally:
        for future in pending:
            future.cancel()


def map_log(task: str) -> dict[str, Any]:
    """Map one log, in any process.

    Args:
        task: JSON of ``log`` and ``map`` (paths), ``settings``, ``space`` (of a LiDAR), ``close`` (loops).

    Returns:
        ``kept``, whether the map was there already, and ``warnings``; or ``error``, one line.
    """
    what = json.loads(task)
    log, path = Path(what["log"]), Path(what["map"])
    try:
        if _fits(path, log, what["settings"], what["close"]):
            return {"kept": True, "warnings": []}
        if is_lidar_log(log) != what["space"]:
            kind, other = ("a LiDAR", "planar lasers") if not what["space"] else ("a planar laser", "LiDARs")
            return {"error": f"{log.name}: the log of {kind}, in a fleet of {other}"}
        warnings = _map_into(path, log, what)
    except HexmapError as error:
        return {"error": " ".join(str(error).split())}
    except Exception as error:
        return {"error": f"{log.name}: {type(error).__name__}: {' '.join(str(error).split())}"}
    return {"kept": False, "warnings": list(warnings)}


def _map_into(path: Path, log: Path, what: dict[str, Any]) -> list[str]:
    """Write the map of a log; returns what was odd about it."""
    with FileStore(path) as store:
        if what["space"]:
            space = LidarSettings.from_dict(what["settings"])
            return build_lidar_map(open_lidar(log, space.log), space, close=what["close"], store=store).warnings
        settings = MappingSettings.from_dict(what["settings"])
        build = build_loop_closed_map if what["close"] else build_map
        return build(open_log(log, settings.log), settings, store=store).warnings


def _fits(path: Path, log: Path, settings: dict[str, Any], close: bool) -> bool:
    """Tell whether a map is there that this version made of this log, by its content, with these settings."""
    try:
        sources = read_metadata(path)["provenance"]
    except (FileAccessError, FormatError):
        return False
    if len(sources) != 1 or not isinstance(sources[0], dict):
        return False
    said = sources[0]
    checksum = fingerprint(log)
    return bool(
        checksum is not None
        and str(said.get("log_id")).partition(":")[0] == checksum
        and said.get("log") == log.name
        and said.get("settings") == settings
        and ("loop closure" in str(said.get("poses"))) == close
        and isinstance(said.get("versions"), dict)
        and said["versions"].get("hexmap") == __version__
    )
