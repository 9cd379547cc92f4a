"""The command that builds a map from the logs of a planar laser or of a LiDAR."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli.build_lidar import LidarOutputs, build_lidar, lidar_settings
from hexmap.cli.console import (
    first_run_note,
    progress_line,
    say,
    warn,
    warn_of_size,
    wrote,
)
from hexmap.cli.fleet import Cluster, FleetOutputs, build_fleet_maps, check_fleet
from hexmap.cli.lattice_options import Basis, own_lattice
from hexmap.cli.log_options import (
    AngleMin,
    AngleStep,
    LaserName,
    Mount,
    NoReturn,
    OdometryTopic,
    ScanFrame,
    ScanTopic,
    log_values,
)
from hexmap.cli.stores import check_map_outputs, check_tiled, map_store, phase, stored_words, written

if TYPE_CHECKING:
    from hexmap.maps.map import Map
    from localisation.mapping.result import MappingResult
    from localisation.settings import MappingSettings


class Associate(StrEnum):
    """How two lists of poses go together."""

    time = "time"
    order = "order"


class Readings(StrEnum):
    """Which readings get a pose in a trajectory file."""

    all = "all"
    scans = "scans"


def build(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="CARMEN log (plain or .gz), ROS 1 bag, ROS 2 bag or MCAP, or a folder of a LiDAR's scans (PCD, PLY, "
            ".bin, NPY); several of one place are mapped together.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The map file to write (.parquet); with --tiles, a folder.")
    ],
    lattice: Annotated[
        str | None, typer.Option(help="Z2 or A2; for a LiDAR Z3, D3 or D3*.", show_default="A2, D3")
    ] = None,
    basis: Basis = None,
    resolution: Annotated[
        float | None, typer.Option(help="Side, m, of the square (cube) as large as a cell.", show_default="0.05, 0.1")
    ] = None,
    levels: Annotated[int | None, typer.Option(help="Levels at doubling resolution.", show_default="3")] = None,
    trajectory: Annotated[Path | None, typer.Option(help="Where to write the poses (TUM).")] = None,
    trajectory_of: Annotated[Readings, typer.Option(help="Poses of all readings or of the scans.")] = Readings.all,
    picture: Annotated[Path | None, typer.Option(help="Where to draw the map (.png, .svg, .pdf).")] = None,
    loop_closure: Annotated[bool, typer.Option(help="Find loops and close them.")] = True,
    loops: Annotated[Path | None, typer.Option(help="Where to write every loop that was tried (CSV).")] = None,
    loops_picture: Annotated[Path | None, typer.Option(help="Where to draw graph and loops.")] = None,
    graph: Annotated[Path | None, typer.Option(help="Where to write the graph of poses (g2o).")] = None,
    covariance: Annotated[Path | None, typer.Option(help="Where to write how sure each pose is (CSV).")] = None,
    continue_map: Annotated[
        Path | None, typer.Option("--continue", help="A map in which the log is found, and to which it is added.")
    ] = None,
    checkpoint: Annotated[
        Path | None, typer.Option(help="Folder in which a run that is killed is found again and goes on.")
    ] = None,
    poses: Annotated[
        Path | None, typer.Option(help="Poses (TUM, KITTI or EuRoC) to fuse at, instead of matching.")
    ] = None,
    associate: Annotated[
        Associate | None, typer.Option(help="How --poses go with scans.", show_default="order where the numbers agree")
    ] = None,
    config: Annotated[Path | None, typer.Option(help="Settings: JSON of `hexmap info --config`, or a map.")] = None,
    min_range: Annotated[float | None, typer.Option(help="Leave out points nearer than this, m.")] = None,
    max_range: Annotated[float | None, typer.Option(help="Leave out points farther than this, m.")] = None,
    clear_no_return: Annotated[float | None, typer.Option(help="Metres that a beam without return clears.")] = None,
    mount: Mount = None,
    search_metres: Annotated[float | None, typer.Option(help="Search radius of the matcher.")] = None,
    search_degrees: Annotated[float | None, typer.Option(help="Search angle of the matcher, to both sides.")] = None,
    search_level: Annotated[int | None, typer.Option(help="Level that the matcher searches on.")] = None,
    odometry: Annotated[bool | None, typer.Option(help="Predict the motion by odometry.", show_default="on")] = None,
    min_hits: Annotated[int | None, typer.Option(help="Hits that make a cell occupied.")] = None,
    min_ratio: Annotated[float | None, typer.Option(help="Share of hits that makes a cell occupied.")] = None,
    angle_min: AngleMin = None,
    angle_step: AngleStep = None,
    no_return: NoReturn = None,
    laser: LaserName = None,
    scan_topic: ScanTopic = None,
    odometry_topic: OdometryTopic = None,
    scan_frame: ScanFrame = None,
    rate: Annotated[float | None, typer.Option(help="Scans a second of a folder without stamps.")] = None,
    free_space: Annotated[
        bool | None, typer.Option(help="Count what a LiDAR's beams went through.", show_default="on")
    ] = None,
    tiles: Annotated[
        float | None,
        typer.Option(help="Write a folder of tiles about so many metres wide; the map may be larger than memory."),
    ] = None,
    level: Annotated[bool | None, typer.Option(help="Turn a LiDAR's map so that floors are level.")] = None,
    fleet: Annotated[
        bool, typer.Option("--fleet", help="A map of each log, in the folder --output; those that are there are kept.")
    ] = False,
    workers: Annotated[int, typer.Option(help="Processes of a fleet; the maps do not depend on it.")] = 1,
    cluster: Cluster = None,
) -> None:
    """Build a map from a log: match every scan, or take given poses, and fuse. With --fleet, a map of each log."""
    with progress_line("loading", lambda: 0.0):
        from hexmap.base.errors import ArgumentError, TrajectoryError
        from hexmap.drawing.map_drawing import check_picture
        from hexmap.io.lidar.open_lidar import is_lidar_log
        from hexmap.io.logs.open_log import open_log
        from hexmap.io.trajectories import read_trajectory

    check_fleet(fleet, dict(locals()))
    of_loops = {"--loops": loops, "--loops-picture": loops_picture, "--graph": graph, "--covariance": covariance}
    if not fleet:
        check_map_outputs(
            output, tiles, {"--trajectory": trajectory, "--picture": picture, **of_loops},
            [p for p in (*logs, continue_map, poses, config) if p is not None],
        )  # fmt: skip
    warn_of_size(resolution)
    for path in (picture, loops_picture):
        if path is not None:
            check_picture(path)
    in_space = is_lidar_log(logs[0])
    _check_kind(logs[0], in_space, dict(locals()))
    check_tiled(
        tiles, len(logs) > 1, continue_map is not None, poses is None and not loop_closure and not in_space
    )
    own = own_lattice(lattice, basis, resolution)
    on: Any = lattice if own is None else own.basis.tolist()
    for option, path in of_loops.items():
        if path is not None and (poses is not None or not loop_closure):
            how = "--poses" if poses is not None else "--no-loop-closure"
            raise ArgumentError(f"{option} says what closing loops found, and {how} closes none")
        if path is not None and len(logs) > 1:
            raise ArgumentError(f"{option} tells of one log, and there are {len(logs)}")
    if not fleet:
        _check_twice(logs, continue_map)
    asked = {"several logs": len(logs) > 1 and not fleet, "--continue": continue_map, "--checkpoint": checkpoint}
    for option in (name for name, value in asked.items() if value):
        if poses is not None or not loop_closure:
            how = "--poses" if poses is not None else "--no-loop-closure"
            raise ArgumentError(f"{option} and {how} do not go together: it takes runs whose loops are closed")
    if in_space:
        _build_in_space(
            logs,
            FleetOutputs(output, workers, cluster) if fleet
            else LidarOutputs(output, trajectory, picture, loops, graph, covariance, tiles), config, poses,
            None if associate is None else associate.value, loop_closure, continue_map, checkpoint,
            lattice=on, resolution=resolution, levels=levels, min_range=min_range, max_range=max_range,
            free_space=free_space, level_floor=level, rule={"min_hits": min_hits, "min_ratio": min_ratio},
            log={"topic": scan_topic, "frame": scan_frame, "rate": rate},
        )  # fmt: skip
        return
    old = None
    if continue_map is not None:
        from hexmap.io.open_map import open_map

        old = open_map(continue_map)
    settings = _settings(
        config if old is None or config is not None else continue_map,
        lattice=on,
        resolution=resolution,
        levels=levels,
        min_range=min_range,
        max_range=max_range,
        clear_no_return=clear_no_return,
        mount=None if mount is None else (mount[0], mount[1], math.radians(mount[2])),
        search_metres=search_metres,
        search_radians=None if search_degrees is None else math.radians(search_degrees),
        search_level=search_level,
        use_odometry=odometry,
        rule={"min_hits": min_hits, "min_ratio": min_ratio},
        log=log_values(angle_min, angle_step, no_return, laser, scan_topic, odometry_topic, scan_frame),
    )
    if fleet:
        build_fleet_maps(logs, output, settings, loop_closure, workers, cluster)
        return
    sources = [open_log(log, settings.log) for log in logs]
    given = read_trajectory(poses) if poses is not None else None
    if given is not None and not given.planar:
        raise TrajectoryError(f"{poses}: poses in space cannot place a planar log: z, roll and pitch must be 0")
    first_run_note(45)
    result = build_and_report(
        sources, settings, output, trajectory, trajectory_of, picture, given, associate, loop_closure, old, checkpoint,
        tiles,
    )  # fmt: skip
    if result.slam is not None:
        _write_loops(result, settings, loops, loops_picture, graph, covariance)


def _check_twice(logs: list[Path], continue_map: Path | None) -> None:
    """Refuse logs of the same content, and those that are in the map that goes on.

    Raises:
        ArgumentError: naming the log.
    """
    from hexmap.base.errors import ArgumentError
    from hexmap.io.fingerprint import fingerprint
    from hexmap.io.open_map import map_metadata

    if len(logs) < 2 and continue_map is None:
        return
    prints = [fingerprint(log) for log in logs]
    sources = [] if continue_map is None else map_metadata(continue_map)["provenance"]
    known = {str(s.get("log_id")).partition(":")[0] for s in sources if isinstance(s, dict)}
    for k, log in enumerate(logs):
        if prints[k] is not None and prints[k] in prints[:k]:
            raise ArgumentError(f"{log}: named twice, and would count twice")
        if prints[k] in known:
            raise ArgumentError(f"{log}: it is in {continue_map} already, and would count twice")


# Options that are for the logs of a planar laser alone, and for those of a LiDAR alone.
_OF_THE_PLANE = (
    "loops_picture", "clear_no_return", "mount", "search_metres", "search_degrees",
    "search_level", "odometry", "angle_min", "angle_step", "no_return", "laser", "odometry_topic",
)  # fmt: skip
_OF_SPACE = ("rate", "free_space", "level")


def _check_kind(log: Path, in_space: bool, options: dict[str, Any]) -> None:
    """Refuse options that say nothing of this kind of log."""
    from hexmap.base.errors import ArgumentError

    for name in _OF_THE_PLANE if in_space else _OF_SPACE:
        if options[name] is not None:
            option = f"--{name.replace('_', '-')}"
            kind, other = ("a LiDAR", "a planar laser") if in_space else ("a planar laser", "a LiDAR")
            raise ArgumentError(f"{log} is the log of {kind}, and {option} is for that of {other}")


def _build_in_space(
    logs: list[Path],
    outputs: LidarOutputs | FleetOutputs,
    config: Path | None,
    poses: Path | None,
    associate: str | None,
    close: bool,
    continue_map: Path | None,
    checkpoint: Path | None,
    **options: Any,
) -> None:
    """Build the map of a LiDAR's logs."""
    from hexmap.base.errors import ArgumentError, HexmapError
    from hexmap.io.open_map import open_map

    old = None
    if continue_map is not None:
        old = open_map(continue_map)
        if old.lattice.dim != 3:
            raise ArgumentError(f"{continue_map} is a map of the plane, and {logs[0]} the log of a LiDAR")
        config = config or continue_map
    values = _read_config(config) if config is not None else {}
    try:
        settings = lidar_settings(values, options)
    except HexmapError as error:
        raise type(error)(f"{config}: {error}" if config is not None else str(error)) from error
    if isinstance(outputs, FleetOutputs):
        build_fleet_maps(logs, outputs.folder, settings, close, outputs.workers, outputs.cluster)
        return
    build_lidar(logs, settings, outputs, poses, associate, close, old, checkpoint)


def _write_loops(
    result: MappingResult,
    settings: MappingSettings,
    loops: Path | None,
    picture: Path | None,
    graph: Path | None,
    covariance: Path | None,
) -> None:
    """Say what was found of loops, and write what is asked for of them."""
    from localisation.slam.loop_files import write_covariances, write_loops

    slam = result.slam
    assert slam is not None
    accepted = [(r.i, r.j) for r in slam.records if r.accepted]
    rejected = [(r.i, r.j) for r in slam.records if not r.accepted]
    say(f"{len(slam.graph)} nodes; {len(slam.records)} loops tried: {len(accepted)} closed, {len(rejected)} rejected")
    if loops is not None:
        write_loops(loops, slam)
        wrote(loops, "every loop that was tried")
    if graph is not None:
        slam.graph.write_g2o(graph)
        wrote(graph, "graph of poses, g2o")
    if covariance is not None:
        write_covariances(covariance, slam)
        wrote(covariance, "how sure each pose is")
    if picture is not None:
        from hexmap.drawing.graph_drawing import draw_graph

        draw_graph(
            result.map, picture, slam.poses[slam.is_scan, :2], slam.graph.poses[:, :2], accepted, rejected,
            settings.rule,
        )  # fmt: skip
        wrote(picture, "graph and loops")


def _settings(config: Path | None, **options: Any) -> MappingSettings:
    """Return the settings of a configuration file, or the defaults, with the options that were given."""
    from hexmap.base.errors import ArgumentError, HexmapError
    from localisation.settings import MappingSettings

    values = _read_config(config) if config is not None else {}
    if config is not None:
        try:
            MappingSettings.from_dict(values)
        except HexmapError as error:
            raise type(error)(f"{config}: {error}") from error
        if options.get("levels") is not None and "search_level" in values:
            values["search_level"] = max(0, min(int(values["search_level"]), options["levels"] - 1))
    for name, value in options.items():
        if isinstance(value, dict):
            given = {k: v for k, v in value.items() if v is not None}
            if given:
                values[name] = {**values.get(name, {}), **given}
        elif value is not None:
            values[name] = value
    if "levels" in values and "search_level" not in values:
        if int(values["levels"]) < 1:
            raise ArgumentError(f"a map has 1 to 16 levels, not {values['levels']}")
        # A map of one level is searched on that one.
        values["search_level"] = min(1, int(values["levels"]) - 1)
    return MappingSettings.from_dict(values)


def _read_config(path: Path) -> dict[str, Any]:
    """Return the settings in a JSON file (what ``info --config`` prints) or in a map.

    Raises:
        FormatError: it is neither, or the map came from more than one log.
    """
    import json

    from hexmap.base.errors import FileAccessError, FormatError
    from hexmap.io.file_kinds import is_own_map
    from hexmap.io.open_map import map_metadata

    try:
        if is_own_map(path):
            sources = [s for s in map_metadata(path)["provenance"] if isinstance(s, dict)]
            settings = [s["settings"] for s in sources if isinstance(s.get("settings"), dict)]
            if len(settings) != 1 and any(s != settings[0] for s in settings):
                raise FormatError(f"{path}: the map came from {len(settings)} configurations; take one as JSON")
            if not settings:
                raise FormatError(f"{path}: the map does not say how it was made")
            value = settings[0]
        else:
            value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileAccessError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise FormatError(f"{path}: neither JSON nor a map of hexmap") from error
    except RecursionError as error:
        raise FormatError(f"{path}: not a configuration: nested too deeply") from error
    except json.JSONDecodeError as error:
        raise FormatError(f"{path}: line {error.lineno}: not JSON: {error.msg}") from error
    if not isinstance(value, dict):
        raise FormatError(f"{path}: a configuration is a JSON object")
    return value


def _map_logs(
    sources: list[Any], settings: MappingSettings, old: Map | None, checkpoint: Path | None, on_pose: Any, store: Any
) -> MappingResult:
    """Map one log after the other, each found in the map of those before; ``store`` takes the map of a single one."""
    from hexmap.base.memory import return_freed_arrays
    from localisation.mapping.add_run import add_run
    from localisation.mapping.align import pose_words
    from localisation.mapping.checkpoint import checkpoints_of
    from localisation.mapping.loop_closed_map import build_loop_closed_map

    return_freed_arrays()
    kept = checkpoints_of(checkpoint, len(sources))
    result: MappingResult | None = None
    world = old
    for source, checkpoints in zip(sources, kept, strict=True):
        begun = None if checkpoints is None else checkpoints.readings()
        if checkpoints is not None and begun is not None:
            say(f"{source.path}: goes on after {begun:,} readings, which {checkpoints.path} holds")
        how: dict[str, Any] = {"on_pose": on_pose, "phase": phase, "checkpoints": checkpoints}
        if world is None:
            new = build_loop_closed_map(source, settings, **how, store=store if len(sources) == 1 else None)
        else:
            new, found = add_run(world, source, settings, **how)
            say(f"{source.path}: begins at {pose_words(found.pose)} in the map; {found.met} cells of walls meet")
        if len(sources) > 1:
            world = new.map
        result = new if result is None else replace(
            new, scans=result.scans + new.scans, odometry=result.odometry + new.odometry,
            matched=result.matched + new.matched, unmatched=result.unmatched + new.unmatched,
            mean_part=(result.mean_part * result.matched + new.mean_part * new.matched)
            / max(1, result.matched + new.matched),
            metres=result.metres + new.metres, warnings=[*result.warnings, *new.warnings],
        )  # fmt: skip
    assert result is not None
    return result


def build_and_report(
    sources: list[Any],
    settings: MappingSettings,
    output: Path,
    trajectory: Path | None,
    trajectory_of: Readings,
    picture: Path | None,
    given: Any,
    associate: Associate | None,
    loop_closure: bool = True,
    old: Map | None = None,
    checkpoint: Path | None = None,
    tiles: float | None = None,
) -> MappingResult:
    """Build, write and report; returns the result."""
    from contextlib import ExitStack

    from hexmap.io.trajectories import TumWriter
    from localisation.mapping.build_map import build_map
    from localisation.mapping.checkpoint import forget
    from localisation.mapping.fuse_log import fuse_log

    source = sources[0]
    begin = time.monotonic()
    drawn: list[tuple[float, float]] = []
    with ExitStack() as stack:
        store = stack.enter_context(map_store(output, tiles))
        writer = stack.enter_context(TumWriter(trajectory)) if trajectory is not None else None

        def on_pose(stamp: float, pose: Any, is_scan: bool) -> None:
            if writer is not None and (is_scan or trajectory_of is Readings.all):
                writer.append(stamp, pose)
            if picture is not None and is_scan:
                drawn.append((pose.x, pose.y))

        if given is None and loop_closure:
            result = _map_logs(sources, settings, old, checkpoint, on_pose, store)
        else:
            with progress_line("mapping", source.fraction) as progress:
                if given is None:
                    result = build_map(source, settings, on_pose=on_pose, progress=progress, store=store)
                else:
                    how = None if associate is None else associate.value
                    result = fuse_log(
                        source, given, settings, associate=how, on_pose=on_pose, progress=progress, store=store
                    )
        seconds = time.monotonic() - begin - store.seconds
        stored = written(result.made, output)
    if checkpoint is not None:
        forget(checkpoint, len(sources))
    for text in result.warnings:
        warn(text)
    if stored.hit_cells == 0:
        warn(f"{source.path}: no point of it is in the map; see --min-range, --max-range and --no-return")
    how = f"{result.mean_part:.0%} of a scan's cells coincide on average" if result.matched else "nothing to match"
    how = "given poses" if given is not None else how
    say(
        f"{result.scans} scans, {result.odometry} odometry readings, {result.metres:.1f} m, "
        f"in {seconds:.1f} s ({1000 * seconds / max(result.scans, 1):.1f} ms a scan); {how}"
    )
    if result.skipped:
        warn(f"{source.path}: {result.skipped} scans have no pose and were left out")
    if result.unmatched:
        warn(f"{source.path}: {result.unmatched} scans coincide with nothing and kept their predicted pose")
    wrote(output, stored_words(stored))
    if trajectory is not None:
        wrote(trajectory, f"poses of {'all readings' if trajectory_of is Readings.all else 'the scans'}, TUM")
    if picture is not None:
        from hexmap.drawing.map_drawing import draw_map

        draw_map(result.map, picture, trajectory=drawn, rule=settings.rule)
        wrote(picture, "picture")
    return result
