"""The command that writes a map as a page to look and plan in."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli import clouds
from hexmap.cli.console import check_applies, check_outputs, first_run_note, wrote
from hexmap.cli.plan.map_source import found, inputs_of
from hexmap.cli.showing import parse_height
from hexmap.cli.viewing import MinHits, MinRatio, cropped, rule_of

if TYPE_CHECKING:
    from hexmap.io.grids.grid_map import GridMap
    from hexmap.maps.map import Map
    from hexmap.maps.state_rule import StateRule


def page(
    map: Annotated[
        Path,
        typer.Argument(
            help="A map of hexmap, a ROS map (.yaml), MovingAI .map, Warframe .3dmap, OctoMap .bt, Wean Hall .dat."
        ),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Where to write the page (.html).")],
    trajectory: Annotated[Path | None, typer.Option(help="Poses to draw (TUM, KITTI, EuRoC).")] = None,
    compare: Annotated[
        str | None,
        typer.Option(metavar="LATTICE", help="Show the same world on another lattice beside it, such as Z2."),
    ] = None,
    slice: Annotated[
        Any,
        typer.Option("--slice", parser=parse_height, metavar="z=M", help="Where to cut a map in space first."),
    ] = None,
    title: Annotated[str | None, typer.Option(help="What it is called.", show_default="the map's file name")] = None,
    min_hits: MinHits = None,
    min_ratio: MinRatio = None,
    cell: Annotated[float | None, typer.Option(help="Size of a game map's cells, m.", show_default="1")] = None,
    crop: clouds.Crop = None,
) -> None:
    """Write a map as one HTML file to look and plan in, in any browser and without a network."""
    from hexmap.io.grids.grid_map import GridMap
    from hexmap.web.page import check_suffix, write_page

    map = found(map)
    inputs = inputs_of(map) if trajectory is None else (*inputs_of(map), trajectory)
    check_outputs({"--output": output}, inputs)
    check_suffix(output)
    first_run_note()
    source, rule = _read(map, cell, min_hits, min_ratio, crop)
    in_space = (source.dim if isinstance(source, GridMap) else source.lattice.dim) == 3
    if in_space and slice is None:
        raise typer.BadParameter(f"{map}: a map in space is shown in slices; say where to begin, with --slice z=M")
    if slice is not None and not in_space:
        raise typer.BadParameter(f"{map}: --slice is for maps in space, and this one is in the plane")
    poses: Any = None
    if trajectory is not None:
        from hexmap.io.trajectories import read_trajectory

        poses = read_trajectory(trajectory)
    path = write_page(
        source, output, trajectory=poses, compare=compare, rule=rule, title=title or map.name, height=slice
    )
    wrote(path, f"{path.stat().st_size / 1e6:.2f} MB, open it in a browser")


def _read(
    map: Path, cell: float | None, min_hits: int | None, min_ratio: float | None, crop: str | None
) -> tuple[Map | GridMap, StateRule]:
    """Return the map, and what its cells are."""
    from hexmap.io.file_kinds import is_own_map
    from hexmap.io.grids.open_grid import open_grid
    from hexmap.maps.state_rule import StateRule

    if not is_own_map(map):
        of_own = {"--min-hits": min_hits, "--min-ratio": min_ratio, "--crop": crop}
        given = {name: value is not None for name, value in of_own.items()}
        check_applies(map, "only maps of hexmap have hits and can be cropped", given)
        return open_grid(map, cell=cell), StateRule()
    check_applies(map, "a map of hexmap has its lattice and cells", {"--cell": cell is not None})
    loaded = cropped(map, crop)
    return loaded, rule_of(min_hits, min_ratio, loaded.sources())
