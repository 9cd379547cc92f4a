"""The command that looks for a path."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli.console import check_outputs, compiling_note, first_run_note, say, wrote
from hexmap.cli.plan.map_source import Ground, foreign_ground, inputs_of, own_ground
from hexmap.cli.plan.query import (
    Planner,
    Query,
    Unknown,
    check_numbers,
    check_usage,
    counted,
    in_metres,
    parse_neighbourhood,
    parse_place,
)
from hexmap.cli.plan.search import find_way, kernels_of
from hexmap.cli.viewing import MinHits, MinRatio, rule_of

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph
    from planners import Path as Way

_REACH = 0.5  # metres, of the clearance where none is given, and no less than two cells
_FINEST = 24, 12  # steps to a radius at most, in the plane and in space, of the places of a disc that are looked at
# hexmap.lattice.NAMES, whose module is slow to load for a help text.
_LATTICES = "Z2", "A2", "Z3", "D3", "D3*", "A2xZ"
_JAGGED = 360.0, 5.0  # degrees of turning beyond which a path is: of all, and a cell
_PLACE: dict[str, Any] = {"parser": parse_place, "metavar": "X Y [Z]"}


def plan(
    world: Annotated[
        Path,
        typer.Argument(help="A map of hexmap, a ROS map (.yaml), MovingAI .map, Warframe .3dmap, OctoMap .bt."),
    ],
    start: Annotated[
        Any,
        typer.Option(
            "--from",
            help="Where to start, m. In maps of games a cell's centre is at its (column, row) or voxel times --cell.",
            **_PLACE,
        ),
    ],
    goal: Annotated[Any, typer.Option("--to", help="Where to go, m.", **_PLACE)],
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Where to write the path (.csv).")] = None,
    picture: Annotated[Path | None, typer.Option(help="Where to draw it (.png, .svg, .pdf).")] = None,
    whole: Annotated[bool, typer.Option("--whole", help="Draw the whole map, not the path's part of it.")] = False,
    radius: Annotated[
        float, typer.Option(help="Radius of the robot, m: at each cell of the path its disc touches no occupied cell.")
    ] = 0.0,
    clearance_weight: Annotated[
        float | None, typer.Option(help="How much more a cell right at an occupied one costs.", show_default="0")
    ] = None,
    clearance_reach: Annotated[
        float | None,
        typer.Option(help="Within what distance it does, m.", show_default="0.5 or two cells, whichever is more"),
    ] = None,
    unknown: Annotated[Unknown, typer.Option(help="What unknown cells are.")] = Unknown.blocked,
    planner: Annotated[Planner, typer.Option(help="What looks for the path.")] = Planner.astar,
    weight: Annotated[float | None, typer.Option(help="Of A*'s heuristic: faster above 1.", show_default="1")] = None,
    bidirectional: Annotated[bool, typer.Option("--bidirectional", help="A* from both ends.")] = False,
    shortcut: Annotated[bool, typer.Option("--shortcut", help="Straighten the path by line of sight.")] = False,
    nearest: Annotated[
        bool, typer.Option("--nearest", help="Stop next to a goal that cannot be reached; with A* only.")
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
        str | None, typer.Option(help=f"Lattice of foreign maps: {', '.join(_LATTICES)}.", show_default="A2 or D3")
    ] = None,
    resolution: Annotated[
        float | None,
        typer.Option(
            help="Its resolution, m. At the size of the source's own cells paths leak through thin walls.",
            show_default="half the source's cell in the plane, the source's cell in space",
        ),
    ] = None,
    cell: Annotated[float | None, typer.Option(help="Size of a game map's cells, m.", show_default="1")] = None,
    level: Annotated[int | None, typer.Option(help="Level of a map of hexmap.", show_default="0")] = None,
    min_hits: MinHits = None,
    min_ratio: MinRatio = None,
) -> None:
    """Look for the cheapest path between two places of a map.

    The path leads from cell centre to cell centre, from the cell of --from to that of --to.
    """
    from hexmap.base.errors import ArgumentError
    from hexmap.io.file_kinds import is_parquet

    query = Query(
        start, goal, planner, weight, bidirectional, shortcut, nearest,
        radius, clearance_weight, clearance_reach, unknown, neighbourhood,
    )  # fmt: skip
    check_usage(query)
    if whole and picture is None:
        raise typer.BadParameter("--whole is about the --picture")
    check_numbers(query, {"--resolution": resolution, "--cell": cell}, min_hits, min_ratio)
    check_outputs({"--output": output, "--picture": picture}, inputs_of(world))
    if output is not None and output.suffix.lower() != ".csv":
        raise ArgumentError(f"{output}: a path is written as .csv, not {output.suffix or 'a file without a suffix'}")
    if picture is not None:
        from hexmap.drawing.map_drawing import check_picture

        check_picture(picture)
    own = is_parquet(world)
    for wrong, options in (
        (own, {"--lattice": lattice, "--resolution": resolution, "--cell": cell}),
        (not own, {"--level": level, "--min-hits": min_hits, "--min-ratio": min_ratio}),
    ):
        given = [name for name, value in options.items() if value is not None]
        if wrong and given:
            what = "a map of hexmap has its lattice and cells" if own else "only maps of hexmap have that"
            raise ArgumentError(f"{world}: {what}; leave out {' and '.join(given)}")
    first_run_note()
    begin = time.perf_counter()
    if own:
        ground = own_ground(world, query, level or 0, lambda sources: rule_of(min_hits, min_ratio, sources))
    else:
        ground = foreign_ground(world, query, lattice, resolution, cell)
    graph = ground.graph
    if radius != 0.0:
        graph = graph.with_clearance(radius, to="cell")
    if clearance_weight is not None:
        reach = max(_REACH, 2.0 * graph.lattice.resolution) if clearance_reach is None else clearance_reach
        graph = graph.with_soft_clearance(reach, clearance_weight, to="cell")
    seconds = time.perf_counter() - begin
    compiling_note(*kernels_of(graph, query))
    way = find_way(ground, graph, query)
    if shortcut:
        from planners import shortcut as straighten

        way = straighten(graph, way)
    inner = " x ".join(f"{int(s):,}" for s in graph.inner_shape)
    say(
        f"{world}: {graph.lattice.title} lattice at {graph.lattice.resolution:g} m{ground.source}, "
        f"{len(graph.moves)} moves, "
        f"window of {inner} cells, {int(graph.free.sum(dtype='int64')):,} free, built in {seconds:.1f} s"
    )
    _report(way, ground, query)
    if output is not None:
        from planners.path_files import write_path

        write_path(output, way)
        wrote(output, f"{counted(len(way), 'point')}, metres")
    if picture is not None:
        from hexmap.drawing.path_drawing import draw_path

        ends = f"from {in_metres(start)} to {in_metres(goal)}".replace("-", "\N{MINUS SIGN}")
        name = world.name if len(world.name) <= 40 else world.name[:39] + "\N{HORIZONTAL ELLIPSIS}"
        draw_path(
            way.points, picture, graph, ground.state_at, goal=None if way.goal_reached else goal,
            extent=(ground.low, ground.high), whole=whole,
            y_down=ground.y_down, title=f"{name}: {way.length:.2f} m {ends}",
            words=f"robot of radius {radius:g} m" if radius else "",
        )  # fmt: skip
        wrote(picture, "the whole map" if whole else "the path and what surrounds it")


def _share_at_unknown(way: Way, ground: Ground, radius: float) -> float:
    """Return the share of the path along which a disc, in space a ball, of a radius (m) meets unknown cells.

    The places that are looked at are those of a fine grid within the disc and on its rim.
    """
    import numpy as np

    from hexmap.maps.cell_state import CellState

    lattice = ground.graph.lattice
    n = lattice.dim
    count = max(1, min(math.ceil(2.0 * radius / lattice.resolution), _FINEST[n - 2]))
    steps = np.arange(-count - 1, count + 2) / count
    disc = np.stack(np.meshgrid(*[steps] * n, indexing="ij"), axis=-1).reshape(-1, n)
    away = np.linalg.norm(disc, axis=1)
    disc = disc[away < 1.0 + 1.0 / count]
    # Those just beyond are drawn in to the rim. What the disc only touches it does not meet.
    disc *= radius * (1.0 - 1e-9) / np.maximum(np.linalg.norm(disc, axis=1), 1.0)[:, None]
    points = [way.points[:1]]
    for a, b in zip(way.points[:-1], way.points[1:], strict=True):
        parts = max(1, round(math.dist(a, b) / lattice.resolution))
        points.append(a + (b - a) * (np.arange(1, parts + 1) / parts)[:, None])
    line = np.concatenate(points)
    met = 0
    for k in range(0, len(line), 256):
        part = line[k : k + 256]
        states = ground.state_at((part[:, None] + disc).reshape(-1, n))
        met += int((states.reshape(len(part), -1) == CellState.UNKNOWN).any(axis=1).sum())
    return met / len(line)


def _report(way: Way, ground: Ground, query: Query) -> None:
    """Say what was found and what that took."""
    clearance = _least_clearance(ground.graph, way)
    room = (
        "no occupied cell anywhere"
        if math.isinf(clearance)
        else f"least clearance {clearance:.2f} m from occupied cells"
    )
    straight = query.shortcut or query.planner is Planner.any_angle
    cost = f"{way.cost:.3f}" if way.cost < 1e6 else f"{way.cost:g}"
    say(
        f"{query.planner.value} from {in_metres(query.start)} to {in_metres(query.goal)}: "
        f"length {way.length:.3f} m, cost {cost}, turning {math.degrees(way.turning):.0f} deg, {room}, "
        f"{counted(len(way), 'point' if straight else 'cell')}"
    )
    if not way.goal_reached:
        say(
            f"the goal was not reached: the path stops at {in_metres(way.points[-1].tolist())}, "
            f"{math.dist(way.points[-1], query.goal):.2f} m away from it"
        )
    # Of any angle, nothing but the straight line bounds the cost from below.
    times = (
        f"{way.bound:.4g} times the straight line"
        if query.planner is Planner.any_angle
        else f"at most {way.bound:.4g} times the least cost"
    )
    bound = f", {times}" if 1.0 < way.bound < math.inf else ""
    effort = f"{counted(way.expansions, 'expansion')}, {counted(way.pushes, 'push', 'pushes')}"
    say(f"{effort}, {1000.0 * way.seconds:.1f} ms{bound}")
    if not straight and math.degrees(way.turning) > max(_JAGGED[0], _JAGGED[1] * len(way)):
        either = "--shortcut" if query.clearance_weight is not None else "--shortcut or --planner any-angle"
        more = len(ground.graph.moves) < len(ground.graph.lattice.extended)
        say(f"jagged: {either} straightens it{', --neighbourhood extended turns less' if more else ''}")
    if query.radius > 0.0 and ground.has_unknown and query.unknown is Unknown.blocked:
        share = _share_at_unknown(way, ground, query.radius)
        if share > 0.0:
            say(
                f"the robot's disc meets unknown cells along {max(1, round(100.0 * share))}% of the path; "
                "--radius keeps it off occupied cells only"
            )


def _least_clearance(graph: LatticeGraph, way: Way) -> float:
    """Return the least distance (m) to occupied cells from all that the path meets, between its corners too."""
    import numpy as np

    from hexmap.lattice.rays import traverse

    cells = way.cells
    if len(way) > 1:
        cells = np.concatenate([cells, traverse(graph.lattice, way.points[:-1], way.points[1:]).index])
    flat = graph.index_to_flat(np.unique(cells, axis=0))
    return float(np.min(graph.clearance_at(flat[flat >= 0], to="cell")))
