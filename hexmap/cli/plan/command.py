"""The command that looks for a path."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli import clouds
from hexmap.cli.console import check_outputs, compiling_note, first_run_note, say, wrote
from hexmap.cli.lattice_options import Basis, own_lattice
from hexmap.cli.plan.map_source import PlanningMap, foreign_map, found, inputs_of, own_map
from hexmap.cli.plan.query import (
    Planner,
    Query,
    Unknown,
    check_numbers,
    check_usage,
    counted,
    in_metres,
    parse_neighbourhood,
    parse_position,
    planner_words,
    with_planner,
)
from hexmap.cli.plan.search import compiled_aside, find_path, kernels_of
from hexmap.cli.viewing import MinHits, MinRatio, cropped, rule_of

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph
    from planners import Path as PlannedPath

_REACH = 0.5  # metres, of the clearance where none is given, and no less than two cells
# hexmap.lattice.NAMES, whose module is slow to load for a help text.
_LATTICES = "Z2", "A2", "Z3", "D3", "D3*", "A2xZ"
_JAGGED = 360.0, 5.0  # degrees of turning beyond which a path is: of all, and a cell
_POSITION: dict[str, Any] = {"parser": parse_position, "metavar": "X Y [Z]"}


def plan(
    map: Annotated[
        Path,
        typer.Argument(
            help="A map of hexmap, a ROS map (.yaml), MovingAI .map, Warframe .3dmap, OctoMap .bt, Wean Hall .dat."
        ),
    ],
    start: Annotated[
        Any,
        typer.Option(
            "--from",
            help="Where to start, m. In maps of games a cell's centre is at its (column, row) or voxel times --cell.",
            **_POSITION,
        ),
    ],
    goal: Annotated[Any, typer.Option("--to", help="Where to go, m.", **_POSITION)],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Where to write the path (.csv, .json, .geojson): headings in radians; length is the distance along "
            "the path from its start, m.",
        ),
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="Where to draw it (.png, .svg, .pdf).")] = None,
    whole: Annotated[bool, typer.Option("--whole", help="Draw the whole map, not just around the path.")] = False,
    radius: Annotated[
        float, typer.Option(help="Radius of the robot, m: at each cell of the path its disc touches no occupied cell.")
    ] = 0.0,
    clearance_weight: Annotated[
        float | None, typer.Option(help="How much more a cell next to an occupied one costs.", show_default="0")
    ] = None,
    clearance_reach: Annotated[
        float | None,
        typer.Option(
            help="Distance within which cells cost more, m.", show_default="0.5 or two cells, whichever is more"
        ),
    ] = None,
    unknown: Annotated[Unknown, typer.Option(help="What to take unknown cells for.")] = Unknown.blocked,
    planner: Annotated[
        Planner | None,
        typer.Option(
            help="What looks for the path; astar's leads from cell to cell.",
            show_default="any-angle in the plane; A*, straightened by line of sight, in space, with costs and with "
            "A*'s options",
        ),
    ] = None,
    weight: Annotated[
        float | None, typer.Option(help="Weight of A*'s heuristic; above 1 is faster.", show_default="1")
    ] = None,
    bidirectional: Annotated[bool, typer.Option("--bidirectional", help="A* from both ends.")] = False,
    shortcut: Annotated[bool, typer.Option("--shortcut", help="Straighten the path by line of sight.")] = False,
    nearest: Annotated[
        bool,
        typer.Option(
            "--nearest",
            help="Stop as near as possible to a goal that cannot be reached; the first line says how far off, and the "
            "exit code is 0. With A* only.",
        ),
    ] = False,
    neighbourhood: Annotated[
        Any,
        typer.Option(
            parser=parse_neighbourhood,
            metavar="MOVES",
            help="nearest, faces, extended or a number.",
            show_default="the lattice's own",
        ),
    ] = None,
    lattice: Annotated[
        str | None,
        typer.Option(help=f"Lattice: {', '.join(_LATTICES)}.", show_default="A2 or D3; of hexmap's maps their own"),
    ] = None,
    basis: Basis = None,
    resolution: Annotated[
        float | None,
        typer.Option(
            help="Resolution of that lattice, m. A cell that reaches into an occupied one of the source is blocked: "
            "the finer, the narrower the passages that stay open.",
            show_default="half the source's cell in the plane, the source's cell in space; of hexmap's maps their own",
        ),
    ] = None,
    cell: Annotated[float | None, typer.Option(help="Size of a game map's cells, m.", show_default="1")] = None,
    level: Annotated[int | None, typer.Option(help="Level of a map of hexmap.", show_default="0")] = None,
    min_hits: MinHits = None,
    min_ratio: MinRatio = None,
    crop: clouds.Crop = None,
) -> None:
    """Look for a path between two positions in a map: straight lines, or with --planner astar moves of the lattice.

    The path begins in --from and ends in --to; between them it turns at centres of cells. No piece of it runs through
    an occupied cell of the source: a cell of the lattice that reaches into one is blocked.
    """
    from hexmap.io.file_kinds import is_own_map

    map = found(map)
    query = Query(
        start, goal, planner, weight, bidirectional, shortcut, nearest,
        radius, clearance_weight, clearance_reach, unknown, neighbourhood,
    )  # fmt: skip
    check_usage(query)
    query = with_planner(query)
    if whole and picture is None:
        raise typer.BadParameter("--whole needs a --picture")
    check_numbers(query, {"--resolution": resolution, "--cell": cell}, min_hits, min_ratio)
    check_outputs({"--output": output, "--picture": picture}, inputs_of(map))
    if output is not None:
        from planners.path_files import check_path_file

        check_path_file(output)
    if picture is not None:
        from hexmap.drawing.map_drawing import check_picture

        check_picture(picture)
    on = own_lattice(lattice, basis, resolution) or lattice
    own = is_own_map(map)
    _check_kind(
        map,
        own,
        {"--cell": cell},
        {"--level": level, "--min-hits": min_hits, "--min-ratio": min_ratio, "--crop": crop},
    )
    first_run_note(5)
    begin = time.perf_counter()
    with compiled_aside(query):
        if own:
            loaded = cropped(map, crop)
            rule = rule_of(min_hits, min_ratio, loaded.sources())
            planning_map = own_map(map, loaded, query, level or 0, rule, on, resolution)
        else:
            planning_map = foreign_map(map, query, on, resolution, cell)
        graph = _with_clearance(planning_map.graph, query)
        seconds = time.perf_counter() - begin
    compiling_note(*kernels_of(graph, query))
    path = find_path(planning_map, graph, query)
    from planners.between_points import between_points

    if query.shortcut:
        from planners import shortcut as straighten

        path = straighten(graph, path, across_terrain=True, taut=True)
    path = between_points(graph, path, query.start, query.goal)
    if not path.goal_reached:
        say(
            f"the goal was not reached: the path stops at {in_metres(path.points[-1].tolist())}, "
            f"{math.dist(path.points[-1], query.goal):.2f} m away from it"
        )
    inner = " x ".join(f"{int(s):,}" for s in graph.inner_shape)
    say(
        f"{map}: {graph.lattice.title} lattice at {graph.lattice.resolution:g} m{planning_map.source}, "
        f"{len(graph.moves)} moves, "
        f"window of {inner} cells, {int(graph.free.sum(dtype='int64')):,} free, built in {seconds:.1f} s"
    )
    _report(path, planning_map, query)
    if output is not None:
        from hexmap.graph.queries import least_clearance
        from planners.path_files import write_path

        room = least_clearance(planning_map.graph, path.cells, path.points)
        write_path(output, replace(path, clearance=room))
        wrote(output, f"{counted(len(path), 'point')}, metres")
    if picture is not None:
        _draw(path, graph, planning_map, query, picture, whole)


def _check_kind(map: Path, own: bool, for_grids: dict[str, Any], for_own: dict[str, Any]) -> None:
    """Reject options that are about the other kind of map: the values of options, None where they are not given."""
    from hexmap.base.errors import ArgumentError

    given = [name for name, value in (for_grids if own else for_own).items() if value is not None]
    if given:
        what = "a map of hexmap has its lattice and cells" if own else "only maps of hexmap have that"
        raise ArgumentError(f"{map}: {what}; leave out {' and '.join(given)}")


def _with_clearance(graph: LatticeGraph, query: Query) -> LatticeGraph:
    """Return the graph for the robot's radius, with costs that keep it off walls where they are asked for."""
    if query.radius != 0.0:
        graph = graph.with_clearance(query.radius, to="cell")
    if query.clearance_weight is not None:
        usual = max(_REACH, 2.0 * graph.lattice.resolution)
        reach = usual if query.clearance_reach is None else query.clearance_reach
        graph = graph.with_soft_clearance(reach, query.clearance_weight, to="cell")
    return graph


def _draw(
    path: PlannedPath, graph: LatticeGraph, planning_map: PlanningMap, query: Query, picture: Path, whole: bool
) -> None:
    """Draw the path and say so."""
    from hexmap.drawing.path_drawing import draw_path

    ends = f"from {in_metres(query.start)} to {in_metres(query.goal)}".replace("-", "\N{MINUS SIGN}")
    name = planning_map.path.name
    name = name if len(name) <= 40 else name[:39] + "\N{HORIZONTAL ELLIPSIS}"
    draw_path(
        path.points, picture, graph, planning_map.state_at,
        goal=None if path.goal_reached else query.goal, extent=(planning_map.low, planning_map.high), whole=whole,
        y_down=planning_map.y_down, title=f"{name}: {path.length:.2f} m {ends}",
        words=f"robot of radius {query.radius:g} m" if query.radius else "",
    )  # fmt: skip
    wrote(picture, "the whole map" if whole else "the path and its surroundings")


def _report(path: PlannedPath, planning_map: PlanningMap, query: Query) -> None:
    """Say what was found and what that took."""
    import numpy as np

    from hexmap.graph.queries import least_clearance, share_of_line
    from hexmap.maps.cell_state import CellState

    lattice = planning_map.graph.lattice
    clearance = least_clearance(planning_map.graph, path.cells, path.points)
    room = (
        "no occupied cell anywhere"
        if math.isinf(clearance)
        else f"least clearance {clearance:.2f} m from occupied cells"
    )
    straight = query.shortcut or query.planner is Planner.any_angle
    met = 1 + int(np.diff(path.cells, axis=0).any(axis=1).sum())
    cost = f"{path.cost:.3f}" if path.cost < 1e6 else f"{path.cost:g}"
    say(
        f"{planner_words(query)} from {in_metres(query.start)} to {in_metres(query.goal)}: "
        f"length {path.length:.3f} m, cost {cost}, turning {math.degrees(path.turning):.0f} deg, {room}, "
        f"{counted(len(path), 'point') if straight else counted(met, 'cell')}"
    )
    # Of any angle, nothing but the straight line bounds the cost from below.
    times = (
        f"{path.bound:.4g} times the straight line"
        if query.planner is Planner.any_angle
        else f"at most {path.bound:.4g} times the least cost"
    )
    bound = f", {times}" if 1.0 < path.bound < math.inf else ""
    effort = f"{counted(path.expansions, 'expansion')}, {counted(path.pushes, 'push', 'pushes')}"
    say(f"{effort}, {1000.0 * path.seconds:.1f} ms{bound}")
    if not straight and math.degrees(path.turning) > max(_JAGGED[0], _JAGGED[1] * len(path)):
        more = len(planning_map.graph.moves) < len(lattice.extended)
        less = ", --neighbourhood extended turns less" if more else ""
        say(f"jagged: --shortcut straightens it, as does leaving out --planner{less}")
    if query.radius > 0.0 and planning_map.has_unknown and query.unknown is Unknown.blocked:
        unknown = int(CellState.UNKNOWN)
        share = share_of_line(lattice, path.points, query.radius, lambda at: planning_map.state_at(at) == unknown)
        if share > 0.0:
            say(
                f"the robot's disc meets unknown cells along {max(1, round(100.0 * share))}% of the path; "
                "--radius keeps it off occupied cells only"
            )
