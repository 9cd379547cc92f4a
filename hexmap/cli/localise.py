"""The command that finds and follows a robot in a known map."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli.clouds import Crop
from hexmap.cli.console import check_outputs, first_run_note, progress_line, say, warn, wrote
from hexmap.cli.localise_in_space import LocaliseOutputs, localise_in_space
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
from hexmap.cli.plan.map_source import inputs_of
from hexmap.cli.viewing import MinHits, MinRatio, cropped, rule_of

if TYPE_CHECKING:
    from hexmap.maps.state_rule import States

__all__ = ["localise"]

_NEEDS = {2: "a laser log needs one of the plane", 3: "a LiDAR's log needs one of space"}


def localise(
    map: Annotated[
        Path, typer.Argument(help="A map of hexmap (.parquet, or a folder of tiles), or a grid map of others.")
    ],
    log: Annotated[Path, typer.Argument(help="CARMEN log (plain or .gz), ROS bag, MCAP, or a LiDAR's.")],
    output: Annotated[Path, typer.Option("--output", "-o", help="The poses to write (TUM).")],
    start: Annotated[
        tuple[float, float, float] | None, typer.Option(help="Where the robot starts, if known: x m, y m, degrees.")
    ] = None,
    csv: Annotated[Path | None, typer.Option(help="Where to write what is known after each scan (.csv).")] = None,
    picture: Annotated[Path | None, typer.Option(help="Where to draw map and track (.png, .svg, .pdf).")] = None,
    level: Annotated[int | None, typer.Option(help="Level of a map of hexmap.", show_default="0")] = None,
    lattice: Annotated[str | None, typer.Option(help="Lattice of foreign maps: Z2 or A2.", show_default="A2")] = None,
    resolution: Annotated[
        float | None, typer.Option(help="Resolution of that lattice, m.", show_default="the source's cell")
    ] = None,
    odometry: Annotated[bool, typer.Option(help="Predict the motion by odometry.")] = True,
    mount: Mount = None,
    time_limit: Annotated[
        float | None, typer.Option(help="Seconds that a search over the whole map may take.", show_default="none")
    ] = None,
    search_metres: Annotated[float | None, typer.Option(help="Search around a prediction, m.")] = None,
    search_degrees: Annotated[float | None, typer.Option(help="Search around a prediction, degrees.")] = None,
    min_range: Annotated[float, typer.Option(help="Leave out points nearer than this, m.")] = 0.0,
    max_range: Annotated[float | None, typer.Option(help="Leave out points farther than this, m.")] = None,
    min_hits: MinHits = None,
    min_ratio: MinRatio = None,
    angle_min: AngleMin = None,
    angle_step: AngleStep = None,
    no_return: NoReturn = None,
    laser: LaserName = None,
    scan_topic: ScanTopic = None,
    odometry_topic: OdometryTopic = None,
    scan_frame: ScanFrame = None,
    crop: Crop = None,
) -> None:
    """Find a robot in a map and follow it along a log; no start pose is needed.

    Poses are written for the scans at which one place stands out; until then, and where the robot is lost, none.
    """
    with progress_line("loading", lambda: 0.0):
        from hexmap.base.errors import ArgumentError
        from hexmap.drawing.map_drawing import check_picture
        from hexmap.io.lidar.open_lidar import is_lidar_log
        from hexmap.io.logs.log import LogSettings
        from hexmap.io.logs.open_log import open_log
        from localisation.localiser.settings import LocaliserSettings

    _check_numbers({"--start": start, "--mount": mount, "--resolution": resolution, "--level": level})
    check_outputs({"--output": output, "--csv": csv, "--picture": picture}, (*inputs_of(map), log))
    if picture is not None:
        check_picture(picture)
    if is_lidar_log(log):
        planar = {
            "--mount": mount, "--no-odometry": None if odometry else True, "--search-metres": search_metres,
            "--search-degrees": search_degrees, "--angle-min": angle_min, "--angle-step": angle_step,
            "--no-return": no_return, "--laser": laser, "--odometry-topic": odometry_topic,
        }  # fmt: skip
        for option in (name for name, value in planar.items() if value is not None):
            raise ArgumentError(f"{log} is the log of a LiDAR, and {option} is for that of a planar laser")
        states = _states(map, level, lattice, resolution, min_hits, min_ratio, crop, dim=3)
        ranges = {"min_range": min_range or None, "max_range": max_range, "log": {"topic": scan_topic}}
        localise_in_space(log, map, states, ranges, start, time_limit, LocaliseOutputs(output, csv, picture))
        return
    given = {
        "search_metres": search_metres,
        "search_radians": None if search_degrees is None else math.radians(search_degrees),
        "time_limit": time_limit,
        "max_range": max_range,
        "min_range": min_range,
        "use_odometry": odometry,
    }
    read = log_values(angle_min, angle_step, no_return, laser, scan_topic, odometry_topic, scan_frame)
    try:
        settings = LocaliserSettings(**{k: v for k, v in given.items() if v is not None})  # type: ignore[arg-type]
        reading = LogSettings(**{k: v for k, v in read.items() if v is not None})  # type: ignore[arg-type]
    except ArgumentError as error:
        raise typer.BadParameter(str(error)) from error
    source = open_log(log, reading)
    states = _states(map, level, lattice, resolution, min_hits, min_ratio, crop)
    first_run_note(45)
    placing = {"mount": _pose(mount), "start": _pose(start)}
    _localise(source, map, states, settings, placing, output, csv, picture)


def _check_numbers(options: dict[str, Any]) -> None:
    """Check numbers that no settings check.

    Raises:
        BadParameter: naming the option and what is wrong with it.
    """
    for name in ("--start", "--mount"):
        if options[name] is not None and not all(math.isfinite(v) for v in options[name]):
            raise typer.BadParameter(f"{name} takes finite numbers, not {' '.join(f'{v:g}' for v in options[name])}")
    metres, level = options["--resolution"], options["--level"]
    if metres is not None and not 0.0 < metres < math.inf:
        raise typer.BadParameter(f"--resolution is a positive number of metres, not {metres:g}")
    if level is not None and level < 0:
        raise typer.BadParameter(f"--level is zero or more, not {level}")


def _pose(numbers: tuple[float, float, float] | None) -> Any:
    """Return the pose of x, y in metres and a heading in degrees."""
    from hexmap.poses.pose import Pose

    return None if numbers is None else Pose.planar(numbers[0], numbers[1], math.radians(numbers[2]))


def _states(
    path: Path,
    level: int | None,
    lattice: str | None,
    resolution: float | None,
    min_hits: int | None,
    min_ratio: float | None,
    crop: str | None,
    dim: int = 2,
) -> States:
    """Return the occupied and free cells of a map of hexmap or of others.

    Raises:
        ArgumentError: the map is not of the log's dimension, or an option is about the other kind of map.
    """
    from hexmap.base.errors import ArgumentError, FormatError
    from hexmap.io.file_kinds import is_own_map
    from hexmap.io.grids.open_grid import open_grid
    from hexmap.lattice.lattice import Lattice

    own = is_own_map(path)
    wrong = {"--lattice": lattice, "--resolution": resolution} if own else {
        "--level": level, "--min-hits": min_hits, "--min-ratio": min_ratio, "--crop": crop
    }  # fmt: skip
    extra = [option for option, value in wrong.items() if value is not None]
    if extra:
        what = "a map of hexmap has its lattice and cells" if own else "only maps of hexmap have that"
        raise ArgumentError(f"{path}: {what}; leave out {' and '.join(extra)}")
    if own:
        loaded = cropped(path, crop)
        states = loaded.state(rule_of(min_hits, min_ratio, loaded.sources()), level or 0)
    else:
        grid = open_grid(path)
        if grid.dim != dim:
            raise ArgumentError(f"{path}: the map is of dimension {grid.dim}; {_NEEDS[dim]}")
        on = Lattice.named(lattice or ("A2" if dim == 2 else "D3"), resolution or grid.cell)
        if on.dim != dim:
            raise ArgumentError(f"{path}: the map is of dimension {dim}, the lattice {on.name} is not")
        states = grid.to_states(on)
    if states.occupied.lattice.dim != dim:
        raise ArgumentError(f"{path}: the map is of dimension {states.occupied.lattice.dim}; {_NEEDS[dim]}")
    if len(states.occupied) == 0:
        raise FormatError(f"{path}: no cell of the map is occupied, nothing can be found in it")
    return states


def _localise(
    source: Any,
    map: Path,
    states: States,
    settings: Any,
    placing: dict[str, Any],
    output: Path,
    csv: Path | None,
    picture: Path | None,
) -> None:
    """Localise, write and report."""
    from contextlib import ExitStack

    from hexmap.base.atomic_files import atomic_write
    from hexmap.base.errors import LogError
    from hexmap.io.trajectories import write_tum
    from hexmap.poses.trajectory import Trajectory
    from localisation.localiser.localise_log import CSV_HEADER, csv_line, localise_log

    begin = time.monotonic()
    stamps: list[float] = []
    poses: list[Any] = []
    line: list[tuple[float, float]] = []
    with ExitStack() as stack:
        table = stack.enter_context(atomic_write(csv, "w")) if csv is not None else None
        if table is not None:
            table.write(CSV_HEADER + "\n")

        def on_estimate(estimate: Any) -> None:
            if table is not None:
                table.write(csv_line(estimate) + "\n")
            if estimate.pose is None:
                line.append((math.nan, math.nan))
                return
            stamps.append(estimate.stamp)
            poses.append(estimate.pose)
            line.append((estimate.pose.x, estimate.pose.y))

        with progress_line("localising", source.fraction) as progress:
            track = localise_log(source, states, settings, **placing, on_estimate=on_estimate, progress=progress)
    seconds = time.monotonic() - begin
    for text in track.warnings:
        warn(text)
    if not poses:
        raise LogError(
            f"{source.path}: not in this map ({map}), or nowhere without doubt: none of {track.scans} scans has a pose"
        )
    write_tum(output, Trajectory.from_poses(stamps, poses))
    rate = 1000 * seconds / max(track.scans, 1)
    say(
        f"{track.scans} scans in {seconds:.1f} s ({rate:.1f} ms a scan); localised after {track.scans_until} scans and "
        f"{track.metres_until:.1f} m"
    )
    share = track.placed / track.scans
    say(f"{share:.1%} of the scans have a pose, {track.metres:.1f} m; lost {track.times_lost} times")
    wrote(output, f"{track.placed} poses, TUM")
    if csv is not None:
        wrote(csv, f"{track.scans} scans")
    if picture is not None:
        from hexmap.drawing.map_drawing import draw_states

        draw_states(states, picture, line)
        wrote(picture, "picture")
