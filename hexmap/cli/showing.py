"""The command that draws: maps in the plane, and maps and points in space as solids or as a slice."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli import clouds
from hexmap.cli.console import check_applies, check_outputs, say, warn, wrote
from hexmap.cli.viewing import LevelOption, MinHits, MinRatio, cropped, rule_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hexmap.maps.state_rule import States

_NO_OFFSET = (0.0, 0.0, 0.0)
_VIEW = -120.0, 35.0  # degrees, of the eye
_DRAWINGS = (".svg", ".pdf")  # that hold shapes, not pixels: they show a map in space from above


@dataclass(frozen=True)
class _Scene:
    """What is to be drawn.

    Attributes:
        states: the cells of a map, or those of points, which are all occupied.
        words: what to say of it.
        offset: (n,) metres, where the cell 0 of the lattice has its centre.
    """

    states: States
    words: str
    offset: tuple[float, ...] = _NO_OFFSET


def parse_height(text: str) -> float:
    """Return the height, metres, of a slice such as ``z=1.2``."""
    import math

    axis, equals, number = text.rpartition("=")
    try:
        height = float(number)
    except ValueError:
        height = math.nan
    if axis.strip().lower() not in ("", "z") or (equals and not axis.strip()) or not math.isfinite(height):
        raise typer.BadParameter(f"a slice is at a height such as z=1.2, not {text!r}")
    return height


def show(
    source: Annotated[
        Path, typer.Argument(help="A map, of hexmap or of others, or points: PCD, PLY, text, KITTI .bin, NPY.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Picture (.png, .svg, .pdf); in space the mesh: .ply, .glb."),
    ] = None,
    level: LevelOption = 0,
    whole: Annotated[bool, typer.Option("--whole", help="Show strays, too, far from all other cells.")] = False,
    trajectory: Annotated[
        list[Path] | None,
        typer.Option(help="Poses to draw (TUM, KITTI, EuRoC), or a path that hexmap plan wrote; one."),
    ] = None,
    min_hits: MinHits = None,
    min_ratio: MinRatio = None,
    lattice: Annotated[
        str | None, typer.Option(help="Lattice of points: Z3, D3, D3*; or of a map of others.", show_default="D3, Z3")
    ] = None,
    volume: clouds.Volume = None,
    resolution: clouds.Resolution = None,
    view: Annotated[tuple[float, float], typer.Option(help="Azimuth and elevation of the eye, degrees.")] = _VIEW,
    cut_above: Annotated[float | None, typer.Option(help="Take off cells above this height, m.")] = None,
    slice: Annotated[
        Any, typer.Option("--slice", parser=parse_height, metavar="z=M", help="Draw a horizontal slice at this height.")
    ] = None,
    viewer: Annotated[bool, typer.Option(help="Open a window (needs the open3d extra).")] = False,
    format: clouds.Format = None,
    units: clouds.Units = "m",
    axes: clouds.Axes = "xyz",
    columns: clouds.ColumnNames = None,
    offset: clouds.Offset = "auto",
    min_range: clouds.MinRange = 0.0,
    max_range: clouds.MaxRange = None,
    crop: clouds.Crop = None,
    unique: clouds.Unique = False,
    sample: clouds.Sample = None,
    seed: clouds.Seed = 0,
) -> None:
    """Draw a map with its true cells: flat, or in space as shaded polyhedra or a slice of them."""
    from hexmap.base.errors import FileAccessError
    from hexmap.io.file_kinds import is_own_map
    from hexmap.io.grids.open_grid import is_grid

    if output is None and not viewer:
        raise typer.BadParameter("say where to draw it (--output), or open a window (--viewer)")
    lines = trajectory or []
    check_outputs({"--output": output}, (source, *lines))
    if len(lines) > 1:
        raise typer.BadParameter(
            f"--trajectory is given {len(lines)} times, and one is drawn; hexmap evaluate --picture draws several"
        )
    if not source.exists():
        raise FileAccessError(f"{source}: no such file")
    poses = _line(lines[0]) if lines else None
    size = clouds.cell_size(resolution, volume, None, 3)
    own = is_own_map(source)
    foreign = not own and is_grid(source)
    of_points = {
        "--format": format is not None, "--units": units != "m", "--axes": axes != "xyz",
        "--columns": columns is not None, "--offset": offset != "auto", "--min-range": min_range != 0.0,
        "--max-range": max_range is not None, "--unique": unique,
        "--sample": sample is not None, "--seed": seed != 0,
    }  # fmt: skip
    of_maps = {"--level": level != 0, "--min-hits": min_hits is not None, "--min-ratio": min_ratio is not None}
    if own or foreign:
        check_applies(source, "these say how points are read, and this is a map", of_points)
    if not own:
        what = "only maps of hexmap have levels and hits" if foreign else "points have no levels, hits or poses"
        check_applies(source, what, of_maps if foreign else {**of_maps, "--trajectory": bool(lines)})
    if own:
        scene = _own_map(source, level, min_hits, min_ratio, lattice is not None or size is not None, crop)
    elif foreign:
        scene = _inside(source, _map_of_others(source, lattice, size), crop)
    else:
        _check_points(source)
        scene = _points(
            source, lattice, size, reading=clouds.Reading(format, units, axes, columns, offset),
            min_range=min_range, max_range=max_range, crop=crop, unique=unique, sample=sample, seed=seed,
        )  # fmt: skip
    if scene.states.occupied.lattice.dim == 2:
        check_applies(source, "the map is flat", {"--view": view != _VIEW, "--cut-above": cut_above is not None})
    if crop is not None and (own or foreign):
        # What is asked for is the box, strays and all, and of the trajectory what lies in it.
        whole, poses = True, _line_inside(poses, crop)
    drawn = output is not None and output.suffix.lower() in _DRAWINGS and scene.offset == _NO_OFFSET
    if scene.states.occupied.lattice.dim == 2 or (drawn and slice is None and not viewer):
        _show_flat(source, scene, output, poses, slice, viewer, whole)
    elif slice is not None:
        _show_slice(scene, slice, output, poses, viewer, whole)
    else:
        _show_solids(scene, output, view, cut_above, poses, viewer, whole)


def _line(path: Path) -> NDArray[np.float64]:
    """Return the positions (N, n), metres, of a trajectory or of a path that ``hexmap plan`` wrote."""
    from hexmap.io.trajectories import read_trajectory
    from planners.path_files import is_path_file, read_path

    return read_path(path).points if is_path_file(path) else read_trajectory(path).positions


def _line_inside(line: NDArray[np.float64] | None, crop: str) -> NDArray[np.float64] | None:
    """Return a line with gaps where it leaves the box, None where it never enters it."""
    import numpy as np

    low, high = (np.asarray(corner)[:2] for corner in clouds.corners(crop))
    if line is None:
        return None
    inside = np.all((line[:, :2] >= low) & (line[:, :2] <= high), axis=1)
    return np.where(inside[:, None], line, np.nan) if inside.any() else None


def _check_points(source: Path) -> None:
    """Refuse files that are no points but something else that hexmap knows, and say what to do with them.

    Raises:
        FormatError: it is such a file.
    """
    from hexmap.base.errors import FormatError
    from hexmap.io.logs.open_log import is_log
    from planners.path_files import is_path_file

    if is_log(source):
        raise FormatError(f"{source}: a log, not a map: make a map of it first (hexmap build)")
    if is_path_file(source):
        raise FormatError(f"{source}: a path, not a map: name its map, and --trajectory {source.name} draws it there")
    if source.suffix.lower() == ".tum":
        raise FormatError(
            f"{source}: a trajectory, not a map: name its map, and --trajectory {source.name} draws it there"
        )


def _inside(source: Path, scene: _Scene, crop: str | None) -> _Scene:
    """Return the part of a map of others whose centres lie in the box that ``--crop`` names.

    Raises:
        ArgumentError: it is no box of the map's dimension, or no cell lies in it.
    """
    import numpy as np

    from hexmap.base.errors import ArgumentError
    from hexmap.maps.state_rule import States

    low, high = clouds.corners(crop)
    if low is None or high is None:
        return scene
    n = scene.states.occupied.lattice.dim
    if len(low) != n:
        raise ArgumentError(f"--crop takes {2 * n} numbers: {source} is a map of dimension {n}")
    parts = []
    for cells in (scene.states.occupied, scene.states.free):
        centres = cells.centres() + np.array(scene.offset[:n])
        parts.append(cells.select(((centres >= low) & (centres <= high)).all(axis=1)))
    if not any(map(len, parts)):
        raise ArgumentError(f"{source}: no cell of the map lies in the box {crop}")
    return replace(scene, states=States(*parts))


def _own_map(
    map: Path, level: int, min_hits: int | None, min_ratio: float | None, about_points: bool, crop: str | None
) -> _Scene:
    """Return a level of a map of hexmap, or the part of it in a box."""
    from hexmap.base.errors import ArgumentError

    if about_points:
        raise ArgumentError(f"{map}: a map has its lattice; --lattice, --volume and --resolution are for points")
    loaded = cropped(map, crop)
    states = loaded.state(rule_of(min_hits, min_ratio, loaded.sources()), level)
    return _Scene(states, f"level {level}, {states.occupied.lattice.resolution:g} m")


def _map_of_others(path: Path, lattice: str | None, size: float | None) -> _Scene:
    """Return a map of others on its own squares or cubes, or on the lattice asked for."""
    import numpy as np

    from hexmap.io.grids.open_grid import open_grid
    from hexmap.lattice.lattice import Lattice
    from hexmap.maps.cell_state import CellState
    from hexmap.maps.state_rule import States
    from hexmap.maps.voxel_list import VoxelList

    grid = open_grid(path)
    own = f"Z{grid.dim}"
    if lattice is not None or size is not None:
        on = Lattice.named(lattice or own, size or grid.cell)
        return _Scene(grid.to_states(on), f"{on.title} cells of {on.resolution:g} m, over cells of {grid.cell:g} m")
    on = Lattice.named(own, grid.cell)
    corner = grid.centre(np.zeros((1, grid.dim)))
    if grid.yaw != 0.0:
        # The squares as they are turned.
        on = Lattice((grid.centre(np.eye(grid.dim)) - corner).T, f"{on.title}, turned,")
    occupied, free = (
        VoxelList.from_cells(np.argwhere(grid.states == state.value), on)
        for state in (CellState.OCCUPIED, CellState.FREE)
    )
    offset = tuple(corner[0].tolist())
    return _Scene(States(occupied, free), f"its own cells of {grid.cell:g} m", offset)


def _points(source: Path, lattice: str | None, size: float | None, **reading: Any) -> _Scene:
    """Return the cells of the points of a file."""
    from hexmap.base.errors import ArgumentError
    from hexmap.lattice.lattice import Lattice, default_name
    from hexmap.maps.state_rule import States
    from hexmap.maps.voxel_list import VoxelList

    if size is None:
        raise ArgumentError(f"{source}: say how large the cells of points are: --volume or --resolution")
    points, _, warnings = clouds.read_cloud(source, None, cells=size, **reading)
    for text in warnings:
        warn(text)
    on = Lattice.named(lattice or default_name(points.shape[1]), size)
    if on.dim != points.shape[1]:
        raise ArgumentError(
            f"{source}: the points are of dimension {points.shape[1]}, the lattice {on.name} of {on.dim}"
        )
    cells = VoxelList.from_points(points, on)
    return _Scene(States(cells, VoxelList.empty(on)), f"{len(points):,} points in cells of {size:g} m")


def _show_flat(
    source: Path,
    scene: _Scene,
    output: Path | None,
    poses: NDArray[np.float64] | None,
    height: float | None,
    viewer: bool,
    whole: bool,
) -> None:
    """Draw a map in the plane, or one in space from above."""
    from hexmap.base.errors import ArgumentError
    from hexmap.drawing.map_drawing import draw_states

    if viewer or height is not None or output is None:
        what = "--slice" if height is not None else "--viewer"
        raise ArgumentError(f"{source}: {what} is for maps in space, and this one is in the plane")
    draw_states(scene.states, output, poses, whole=whole, offset=scene.offset[:2])
    wrote(output, scene.words)


def _show_slice(
    scene: _Scene, height: float, output: Path | None, poses: NDArray[np.float64] | None, viewer: bool, whole: bool
) -> None:
    """Draw a horizontal slice of a map in space."""
    from hexmap.drawing.extent import FIT
    from hexmap.drawing.slice_drawing import draw_slice

    if viewer or output is None:
        raise typer.BadParameter("a slice is a picture: --slice goes with --output and without --viewer")
    draw_slice(scene.states, height, output, trajectory=poses, offset=scene.offset, fit=1.0 if whole else FIT)
    wrote(output, f"{scene.words}, slice at z = {height:g} m")


def _show_solids(
    scene: _Scene,
    output: Path | None,
    view: tuple[float, float],
    cut_above: float | None,
    poses: NDArray[np.float64] | None,
    viewer: bool,
    whole: bool,
) -> None:
    """Draw the occupied cells of a map in space, save them as a mesh, or open a window."""
    import numpy as np

    from hexmap.drawing.extent import FIT
    from hexmap.drawing.solids.draw_solids import Cut, draw_solids, view_solids
    from hexmap.drawing.solids.mesh import mesh_of_cells
    from hexmap.drawing.solids.mesh_files import MESH_SUFFIXES, save_mesh

    cells = scene.states.occupied
    line = poses
    mesh = None
    if output is not None and output.suffix.lower() in MESH_SUFFIXES:
        mesh = mesh_of_cells(cells).moved(np.array(scene.offset))
        wrote(save_mesh(output, mesh, line), f"{scene.words}, mesh of {len(cells):,} cells")
    elif output is not None:
        cut: Any = "auto" if cut_above is None else Cut(above=cut_above)
        fit = 1.0 if whole else FIT
        draw_solids(cells, output, view=view, cut=cut, trajectory=line, offset=scene.offset, fit=fit)
        wrote(output, f"{scene.words}, {len(cells):,} cells, {cells.lattice.title}")
    if viewer:
        if line is not None:
            say("the window shows no trajectory; --output does")
        view_solids(mesh or mesh_of_cells(cells).moved(np.array(scene.offset)))
