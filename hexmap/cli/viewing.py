"""Commands that look at things: info, lattices, export."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli import clouds
from hexmap.cli.console import check_map_output, check_outputs, mount_words, say, warn, wrote
from hexmap.cli.lattice_options import Bases, own_lattice

if TYPE_CHECKING:
    from hexmap.maps.map import Map
    from hexmap.maps.state_rule import StateRule

MapFile = Annotated[Path, typer.Argument(help="A map that hexmap wrote (.parquet, or a folder of tiles).")]
LevelOption = Annotated[int, typer.Option(help="Level of the map, 0 is the finest.")]
MinHits = Annotated[int | None, typer.Option(help="Hits that make a cell occupied.", show_default="as mapped")]
MinRatio = Annotated[
    float | None, typer.Option(help="Share of hits that makes a cell occupied.", show_default="as mapped")
]


def info(
    source: Annotated[
        Path, typer.Argument(metavar="map", help="A map, of hexmap or of others, a log, a trajectory or a path.")
    ],
    config: Annotated[bool, typer.Option("--config", help="Print only its settings, as JSON.")] = False,
) -> None:
    """Say what a map, a log, a trajectory (.tum) or a path holds and where it came from."""
    from hexmap.io.file_kinds import is_map_folder, is_own_map
    from hexmap.io.grids.open_grid import is_grid
    from hexmap.io.lidar.open_lidar import is_lidar_log
    from hexmap.io.logs.open_log import is_log

    if is_map_folder(source) and not config:
        _folder_info(source)
        return
    if not config and not is_own_map(source):
        if is_grid(source):
            _grid_info(source)
            return
        if is_lidar_log(source):
            _lidar_info(source)
            return
        if is_log(source):
            _log_info(source)
            return
        if _line_info(source):
            return
    _map_info(source, config)


def _line_info(path: Path) -> bool:
    """Say what a trajectory or a path holds; False where the file is neither."""
    import numpy as np

    from hexmap.io.trajectories import read_tum
    from planners.path_files import is_path_file, read_path

    if is_path_file(path):
        points = read_path(path).points
        say(f"{path}: a path of {len(points):,} points in {'the plane' if points.shape[1] == 2 else 'space'}")
    elif path.suffix.lower() == ".tum":
        poses = read_tum(path)
        points = poses.positions
        first, last = float(poses.stamps[0]), float(poses.stamps[-1])
        say(f"{path}: a trajectory (TUM) of {len(poses):,} poses")
        say(f"stamps {first:.3f} to {last:.3f} s: {last - first:.1f} s")
    else:
        return False
    length = float(np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1)).sum())
    ends = ["(" + ", ".join(f"{v:.2f}" for v in points[k]) + ")" for k in (0, -1)]
    say(f"length {length:.2f} m, from {ends[0]} to {ends[1]} m")
    return True


def _map_info(map: Path, config: bool) -> None:
    """Say what a map of hexmap holds, or print its settings."""
    import json

    from hexmap.base.errors import ArgumentError
    from hexmap.io.map_file import load_map
    from hexmap.io.map_folder import MapFolder

    loaded: Any = MapFolder.open(map) if map.is_dir() else load_map(map)
    sources = loaded.sources()
    if config:
        settings = [s["settings"] for s in sources if isinstance(s.get("settings"), dict)]
        if not settings or any(s != settings[0] for s in settings):
            raise ArgumentError(f"{map}: made with {len(settings)} configurations, not with one")
        say(json.dumps(settings[0], indent=2))
        return
    lattice = loaded.lattice
    say(f"{map}: a map on the {lattice.title} lattice ({lattice.name}), frame {loaded.frame!r}")
    say("level  resolution    hit cells       hits  passed cells      occupied          free")
    for k, level in enumerate(loaded.levels):
        states = loaded.state(rule_of(None, None, loaded.sources()), level=k)
        say(
            f"{k:5d}  {level.lattice.resolution:8.4g} m {len(level.hits):12,d} {level.hits.total:10,d} "
            f"{len(level.passes):13,d} {len(states.occupied):13,d} {len(states.free):13,d}"
        )
    _say_extent(loaded.bounds())
    _say_sources(sources)


def _folder_info(path: Path) -> None:
    """Say what a map of tiles holds, by its manifest."""
    from hexmap.io.map_folder import MapFolder

    folder = MapFolder.open(path)
    lattice = folder.lattice
    wide = " x ".join(str(c) for c in folder.cells)
    say(f"{path}: a map on the {lattice.title} lattice ({lattice.name}), frame {folder.header['frame']!r}")
    say(
        f"{len(folder.tiles):,} tiles of {wide} cells, {folder.rows:,} rows, "
        f"{sum(tile.size for tile in folder.tiles) / 1e6:,.1f} MB"
    )
    say("level  resolution    hit cells       hits  passed cells")
    for k, total in enumerate(folder.totals()):
        say(
            f"{k:5d}  {lattice.resolution * 2**k:8.4g} m {total['hit_cells']:12,d} {total['hits']:10,d} "
            f"{total['passed_cells']:13,d}"
        )
    _say_extent(folder.bounds())
    _say_sources(folder.sources())


def _say_extent(corners: tuple[Any, Any] | None) -> None:
    """Say where the cells lie, low and high corner by axis."""
    if corners is not None:
        say("extent " + "  ".join(f"{a:.2f} to {b:.2f} m" for a, b in zip(*corners, strict=True)))


def _say_sources(sources: list[dict[str, Any]]) -> None:
    """Say where a map came from."""
    for source in sources:
        say(f"from {source.get('log', 'unknown')} ({source.get('format', 'unknown')}), poses: {source.get('poses')}")
    _say_once("versions", [source.get("versions") for source in sources], sources, _versions_in_words)
    _say_once("configuration", [source.get("settings") for source in sources], sources, _settings_in_words)


def _say_once(
    what: str, values: list[Any], sources: list[dict[str, Any]], in_words: Callable[[Any, bool], str | None]
) -> None:
    """Say each different value that the sources of a map have, and of which logs it is where they differ."""
    different: list[tuple[Any, list[str]]] = []
    for value, source in zip(values, sources, strict=True):
        logs = next((logs for other, logs in different if other == value), None)
        if logs is None:
            different.append((value, logs := []))
        logs.append(str(source.get("log", "unknown")))
    for value, logs in different:
        words = in_words(value, len(different) == 1)
        if words is not None:
            of = f" of {', '.join(dict.fromkeys(logs))}" if len(different) > 1 else ""
            say(f"{what}{of}{words}")


def _versions_in_words(versions: Any, only: bool) -> str | None:
    if not isinstance(versions, dict):
        return None
    return ": " + ", ".join(f"{k} {v}" for k, v in versions.items())


def _settings_in_words(settings: Any, only: bool) -> str:
    import json

    return f"{' (for --config)' if only else ''}:\n{json.dumps(settings, indent=2)}"


def _grid_info(path: Path) -> None:
    """Say what a map of others holds."""
    import numpy as np

    from hexmap.io.grids.open_grid import open_grid
    from hexmap.maps.cell_state import CellState

    grid = open_grid(path)
    size = " x ".join(str(s) for s in grid.states.shape)
    say(f"{path}: a map of others ({grid.kind}), {size} cells of {grid.cell:g} m, yaw {np.degrees(grid.yaw):g} degrees")
    counts = {state: np.count_nonzero(grid.states == state.value) for state in CellState}
    say(", ".join(f"{counts[s]:,d} {s.name.lower()}" for s in (CellState.OCCUPIED, CellState.FREE, CellState.UNKNOWN)))
    _say_extent((grid.low, grid.high))


def _log_info(path: Path) -> None:
    """Say what a log holds; it is read to its end."""
    import math

    from hexmap.io.logs.open_log import open_log
    from hexmap.poses.scan import Scan

    log = open_log(path)
    points = rays = 0
    farthest = metres = 0.0
    stamps, last = [math.inf, -math.inf], None
    for event in log:
        stamps = [min(stamps[0], event.stamp), max(stamps[1], event.stamp)]
        if isinstance(event, Scan):
            points, rays = points + len(event.points), rays + len(event.no_return)
            farthest = max(farthest, float((event.points**2).sum(axis=1).max(initial=0.0)))
        pose = event.odometry if isinstance(event, Scan) else event.pose
        if pose is not None:
            metres += 0.0 if last is None else math.dist(last.translation, pose.translation)
            last = pose
    say(f"{path}: a log ({log.format}), {log.scans} scans, {log.odometry} odometry readings")
    say(
        f"{points / log.scans:.1f} points a scan up to {math.sqrt(farthest):.2f} m, "
        f"{rays / log.scans:.1f} beams a scan without return"
    )
    say(f"stamps {stamps[0]:.3f} to {stamps[1]:.3f} s, {metres:.1f} m by odometry")
    if log.mount is not None:
        say(f"the laser on the robot: {log.mount.x:g} m, {log.mount.y:g} m, {math.degrees(log.mount.theta):g} degrees")
    for text in log.warnings:
        warn(text)


def _lidar_info(path: Path) -> None:
    """Say what the log of a LiDAR holds; it is read to its end."""
    import math

    import numpy as np

    from hexmap.io.lidar.open_lidar import open_lidar

    log = open_lidar(path)
    points, farthest, sweep = 0, 0.0, 0.0
    stamps = [math.inf, -math.inf]
    for scan in log:
        stamps = [min(stamps[0], scan.stamp), max(stamps[1], scan.stamp)]
        points += len(scan.points)
        farthest = max(farthest, float((scan.points**2).sum(axis=1).max(initial=0.0)))
        if scan.times is not None:
            sweep = max(sweep, float(np.ptp(scan.times)))
    say(f"{path}: the log of a LiDAR ({log.format}), {log.scans} scans")
    timed = f"a time a point, sweeps of {sweep:.3f} s" if sweep else "no time a point"
    say(f"{points / log.scans:.0f} points a scan up to {math.sqrt(farthest):.2f} m; {timed}")
    say(f"stamps {stamps[0]:.3f} to {stamps[1]:.3f} s")
    if log.mount is None:
        say("the mount is not known: poses are those of the sensor")
    else:
        say(f"the LiDAR on {log.poses_of}: {mount_words(log.mount)}")
    if log.unused:
        say(f"{log.unused}: there, and not used")
    for text in log.warnings:
        warn(text)


def lattices(basis: Bases = None) -> None:
    """Print the paper's Table I and what each lattice is worth, computed from its cell."""
    from hexmap.lattice.lattice import NAMES, Lattice

    own = [own_lattice(None, text, 1.0) for text in basis or ()]
    say(
        f"{'':6}{'lattice':<21}{'near':>5}{'faces':>6}{'symm.':>6}{'moment':>10}{'error':>9}"
        f"{'packing':>9}{'covering':>10}{'in':>8}{'out':>8}"
    )
    rows = [(name, Lattice.named(name)) for name in NAMES]
    rows += [(f"own {k}", cells) for k, cells in enumerate(own, 1) if cells is not None]
    for name, cells in rows:
        title = cells.title if name in NAMES else f"--basis, {cells.dim}D"
        say(
            f"{name:<6}{title:<21}{len(cells.nearest):5d}{len(cells.faces):6d}{len(cells.point_group):6d}"
            f"{cells.cell.second_moment:10.6f}{cells.cell.mean_error:9.4f}{cells.packing_density:9.4f}"
            f"{cells.covering_thickness:10.4f}{cells.inradius:8.4f}{cells.covering_radius:8.4f}"
        )
    say("")
    say("All at equal cell area or volume (resolution 1). near: nearest neighbours, all equally far;")
    say("faces: cells that share a face; symm.: order of the point group; moment: dimensionless second")
    say("moment; error: mean distance to the centre; packing, covering: density of the balls in and")
    say("around the cells; in, out: their radii.")


def export(
    map: MapFile,
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help=".yaml (ROS map_server, with .pgm), .bt (OctoMap), .csv, .ply or .pcd (points)."
        ),
    ],
    level: LevelOption = 0,
    min_hits: MinHits = None,
    min_ratio: MinRatio = None,
    height: Annotated[
        tuple[float, float] | None,
        typer.Option(help="Of a map in space: the heights, m, whose cells go into a ROS map.", metavar="LOW HIGH"),
    ] = None,
    crop: clouds.Crop = None,
) -> None:
    """Write a map in a format that other programs read."""
    from hexmap.io.exports import export as export_map

    image = output.with_suffix(".pgm") if output.suffix.lower() in (".yaml", ".yml") else None
    check_outputs({"--output": output, "the image of --output": image}, (map,))
    loaded = cropped(map, crop)
    rule = rule_of(min_hits, min_ratio, loaded.sources())
    for path in export_map(loaded, output, level=level, rule=rule, heights=height, report=say):
        wrote(path, f"level {level}, {loaded.level(level).lattice.resolution:g} m")


def crop(
    map: MapFile,
    output: Annotated[Path, typer.Option("--output", "-o", help="Where to write the part (.parquet).")],
    box: Annotated[
        str, typer.Option(help="Low corner, then high corner, m: x,y,x,y; in space x,y,z,x,y,z.", metavar="X,Y,X,Y")
    ],
) -> None:
    """Cut a part out of a map; of a map of tiles only those are read that the box meets."""
    from hexmap.base.text import plural
    from hexmap.io.map_file import save_map

    check_map_output(output)
    check_outputs({"--output": output}, (map,))
    part = cropped(map, box, "--box")
    save_map(output, part)
    cells = len(part.levels[0].hits)
    wrote(output, f"{plural(len(part.levels), 'level')}, {cells:,} cells hit, {part.lattice.title}")


def cropped(path: Path, crop: str | None, option: str = "--crop") -> Map:
    """Return the part of a map of hexmap in the box that an option names, all of it where it names none.

    Of a map of tiles only those are read that the box meets.

    Raises:
        ArgumentError: it is no box of the map's dimension, or no cell lies in it.
    """
    from hexmap.base.errors import ArgumentError
    from hexmap.io.open_map import map_metadata, open_map

    low, high = clouds.corners(crop)
    if low is None or high is None:
        return open_map(path)
    n = len(map_metadata(path)["lattice"]["basis"])
    if len(low) != n:
        raise ArgumentError(f"{option} takes {2 * n} numbers: {path} is a map of dimension {n}")
    part = open_map(path, low, high)
    if part.bounds() is None:
        raise ArgumentError(f"{path}: no cell of the map lies in the box {crop}")
    return part


def rule_of(min_hits: int | None, min_ratio: float | None, sources: list[dict[str, object]]) -> StateRule:
    """Return the rule the map was made with where all its sources agree, with what is set here instead."""
    from dataclasses import replace

    from hexmap.base.errors import HexmapError
    from hexmap.maps.state_rule import StateRule

    rules = [s["settings"].get("rule") for s in sources if isinstance(s.get("settings"), dict)]  # type: ignore[attr-defined]
    rule = StateRule()
    if rules and isinstance(rules[0], dict) and all(r == rules[0] for r in rules):
        # A map that somebody else has made may say anything: then the default serves.
        with contextlib.suppress(TypeError, HexmapError):
            rule = StateRule(**rules[0])
    changes = {k: v for k, v in (("min_hits", min_hits), ("min_ratio", min_ratio)) if v is not None}
    return replace(rule, **changes)  # type: ignore[arg-type]
