"""Commands that look at things: info, lattices, show, export."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli import clouds
from hexmap.cli.console import check_applies, check_outputs, say, warn, wrote

if TYPE_CHECKING:
    from hexmap.maps.state_rule import StateRule
    from hexmap.maps.voxel_list import VoxelList

_VIEW = -120.0, 35.0  # degrees, of the eye
MapFile = Annotated[Path, typer.Argument(help="A map that hexmap wrote (.parquet).")]
LevelOption = Annotated[int, typer.Option(help="Level of the map, 0 is the finest.")]
MinHits = Annotated[int | None, typer.Option(help="Hits that make a cell occupied.", show_default="as mapped")]
MinRatio = Annotated[
    float | None, typer.Option(help="Share of hits that makes a cell occupied.", show_default="as mapped")
]


def info(
    source: Annotated[Path, typer.Argument(metavar="map", help="A map, of hexmap or of others, or a laser log.")],
    config: Annotated[bool, typer.Option("--config", help="Print only its settings, as JSON.")] = False,
) -> None:
    """Say what a map or a log holds and where it came from."""
    from hexmap.io.file_kinds import is_parquet
    from hexmap.io.grids.open_grid import is_grid
    from hexmap.io.logs.open_log import is_log

    if not config and not is_parquet(source):
        if is_grid(source):
            _grid_info(source)
            return
        if is_log(source):
            _log_info(source)
            return
    _map_info(source, config)


def _map_info(map: Path, config: bool) -> None:
    """Say what a map of hexmap holds, or print its settings."""
    import json

    from hexmap.base.errors import ArgumentError
    from hexmap.io.map_file import load_map

    loaded = load_map(map)
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
    corners = loaded.bounds()
    if corners is not None:
        say("extent " + "  ".join(f"{a:.2f} to {b:.2f} m" for a, b in zip(*corners, strict=True)))
    for source in sources:
        say(f"from {source.get('log', 'unknown')} ({source.get('format', 'unknown')}), poses: {source.get('poses')}")
        versions = source.get("versions")
        if isinstance(versions, dict):
            say("versions: " + ", ".join(f"{k} {v}" for k, v in versions.items()))
        say("configuration (for --config):")
        say(json.dumps(source.get("settings"), indent=2))


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
    say("extent " + "  ".join(f"{a:.2f} to {b:.2f} m" for a, b in zip(grid.low, grid.high, strict=True)))


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


def lattices() -> None:
    """Print the paper's Table I and what each lattice is worth, computed from its cell."""
    from hexmap.lattice.lattice import NAMES, Lattice

    say(
        f"{'':6}{'lattice':<21}{'near':>5}{'faces':>6}{'symm.':>6}{'moment':>10}{'error':>9}"
        f"{'packing':>9}{'covering':>10}{'in':>8}{'out':>8}"
    )
    for name in NAMES:
        cells = Lattice.named(name)
        say(
            f"{name:<6}{cells.title:<21}{len(cells.nearest):5d}{len(cells.faces):6d}{len(cells.point_group):6d}"
            f"{cells.cell.second_moment:10.6f}{cells.cell.mean_error:9.4f}{cells.packing_density:9.4f}"
            f"{cells.covering_thickness:10.4f}{cells.inradius:8.4f}{cells.covering_radius:8.4f}"
        )
    say("")
    say("All at equal cell area or volume (resolution 1). near: nearest neighbours, all equally far;")
    say("faces: cells that share a face; symm.: order of the point group; moment: dimensionless second")
    say("moment; error: mean distance to the centre; packing, covering: density of the balls in and")
    say("around the cells; in, out: their radii.")


def show(
    source: Annotated[Path, typer.Argument(help="A map of hexmap, or points: PCD, PLY, text, KITTI .bin, NPY.")],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Picture (.png, .svg, .pdf); of points .png, or the mesh: .ply, .glb."),
    ] = None,
    level: LevelOption = 0,
    trajectory: Annotated[Path | None, typer.Option(help="Poses to draw (TUM).")] = None,
    min_hits: MinHits = None,
    min_ratio: MinRatio = None,
    lattice: Annotated[str | None, typer.Option(help="Lattice of points: Z3, D3, D3*.", show_default="D3")] = None,
    volume: clouds.Volume = None,
    resolution: clouds.Resolution = None,
    view: Annotated[tuple[float, float], typer.Option(help="Azimuth and elevation of the eye, degrees.")] = _VIEW,
    cut_above: Annotated[float | None, typer.Option(help="Take off cells above this height, m.")] = None,
    viewer: Annotated[bool, typer.Option(help="Open a window (needs the open3d extra).")] = False,
    format: clouds.Format = None,
    units: clouds.Units = "m",
    axes: clouds.Axes = "xyz",
    min_range: clouds.MinRange = 0.0,
    max_range: clouds.MaxRange = None,
    crop: clouds.Crop = None,
    unique: clouds.Unique = False,
    sample: clouds.Sample = None,
    seed: clouds.Seed = 0,
) -> None:
    """Draw a map with its true cells, or points in space as shaded polyhedra."""
    from hexmap.base.errors import ArgumentError
    from hexmap.io.file_kinds import is_parquet

    if output is None and not viewer:
        raise typer.BadParameter("say where to draw it (--output), or open a window (--viewer)")
    check_outputs({"--output": output}, (source,) if trajectory is None else (source, trajectory))
    if is_parquet(source):
        of_points = {
            "--format": format is not None, "--units": units != "m", "--axes": axes != "xyz",
            "--min-range": min_range != 0.0, "--max-range": max_range is not None, "--crop": crop is not None,
            "--unique": unique, "--sample": sample is not None, "--seed": seed != 0,
        }  # fmt: skip
        check_applies(source, "these say how points are read, and this is a map", of_points)
    about_points = lattice is not None or volume is not None or resolution is not None
    if not about_points and is_parquet(source) and not viewer:
        assert output is not None
        _show_map(source, output, level, trajectory, min_hits, min_ratio, view, cut_above)
        return
    size = clouds.cell_size(resolution, volume, None, 3)
    if not is_parquet(source):
        of_maps = {
            "--level": level != 0, "--trajectory": trajectory is not None, "--min-hits": min_hits is not None,
            "--min-ratio": min_ratio is not None,
        }  # fmt: skip
        check_applies(source, "points have no levels, hits or poses", of_maps)
    if is_parquet(source):
        if about_points:
            raise ArgumentError(f"{source}: a map has its lattice; --lattice, --volume and --resolution are for points")
        from hexmap.io.map_file import load_map

        loaded = load_map(source)
        cells = loaded.state(rule_of(min_hits, min_ratio, loaded.sources()), level=level).occupied
    else:
        if size is None:
            raise ArgumentError(f"{source}: say how large the cells of points are: --volume or --resolution")
        cells = _cells_of_points(
            source, lattice, size, format=format, units=units, axes=axes, min_range=min_range, max_range=max_range,
            crop=crop, unique=unique, sample=sample, seed=seed,
        )  # fmt: skip
    _show_solids(cells, output, view, cut_above, viewer)


def _show_map(
    map: Path,
    output: Path,
    level: int,
    trajectory: Path | None,
    min_hits: int | None,
    min_ratio: float | None,
    view: tuple[float, float],
    cut_above: float | None,
) -> None:
    from hexmap.drawing.map_drawing import check_picture, draw_map
    from hexmap.io.map_file import load_map
    from hexmap.io.trajectories import read_tum

    check_picture(output)
    loaded = load_map(map)
    if loaded.lattice.dim == 2:
        check_applies(map, "the map is flat", {"--view": view != _VIEW, "--cut-above": cut_above is not None})
    poses = read_tum(trajectory) if trajectory is not None else None
    draw_map(loaded, output, level=level, trajectory=poses, rule=rule_of(min_hits, min_ratio, loaded.sources()))
    wrote(output, f"level {level}, {loaded.level(level).lattice.resolution:g} m")


def _cells_of_points(source: Path, lattice: str | None, size: float, **reading: Any) -> VoxelList:
    from hexmap.base.errors import ArgumentError
    from hexmap.lattice.lattice import Lattice, default_name
    from hexmap.maps.voxel_list import VoxelList

    points, _, warnings = clouds.read_cloud(source, None, cells=size, **reading)
    for text in warnings:
        warn(text)
    on = Lattice.named(lattice or default_name(points.shape[1]), size)
    if on.dim != points.shape[1]:
        raise ArgumentError(
            f"{source}: the points are of dimension {points.shape[1]}, the lattice {on.name} of {on.dim}"
        )
    return VoxelList.from_points(points, on)


def _show_solids(
    cells: VoxelList, output: Path | None, view: tuple[float, float], cut_above: float | None, viewer: bool
) -> None:
    from hexmap.drawing.solids.draw_solids import Cut, draw_solids, view_solids
    from hexmap.drawing.solids.mesh import mesh_of_cells
    from hexmap.drawing.solids.mesh_files import MESH_SUFFIXES, save_mesh

    if output is not None and output.suffix.lower() in MESH_SUFFIXES:
        wrote(save_mesh(output, mesh_of_cells(cells)), f"mesh of {len(cells):,} cells")
    elif output is not None:
        draw_solids(cells, output, view=view, cut="auto" if cut_above is None else Cut(above=cut_above))
        wrote(output, f"{len(cells):,} cells, {cells.lattice.title}")
    if viewer:
        view_solids(mesh_of_cells(cells))


def export(
    map: MapFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", help=".yaml (ROS map_server, with .pgm), .csv or .ply (points).")
    ],
    level: LevelOption = 0,
    min_hits: MinHits = None,
    min_ratio: MinRatio = None,
) -> None:
    """Write a map in a format that other programs read."""
    from hexmap.io.exports import export as export_map
    from hexmap.io.map_file import load_map

    image = output.with_suffix(".pgm") if output.suffix.lower() in (".yaml", ".yml") else None
    check_outputs({"--output": output, "the image of --output": image}, (map,))
    loaded = load_map(map)
    for path in export_map(loaded, output, level=level, rule=rule_of(min_hits, min_ratio, loaded.sources())):
        wrote(path, f"level {level}, {loaded.level(level).lattice.resolution:g} m")


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
