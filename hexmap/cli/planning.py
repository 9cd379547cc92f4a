"""The command that looks for a path."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from hexmap.cli import clouds
from hexmap.cli.console import check_outputs, compiling_note, first_run_note, say, wrote
from hexmap.cli.viewing import MinHits, MinRatio, rule_of

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hexmap.graph import LatticeGraph
    from hexmap.lattice import Lattice
    from planners import NoPath
    from planners import Path as Way

Place = tuple[float, ...]

# Such as nan are matched too: they shall be refused as places, not taken for the name of a file.
_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE)
_SEARCH_BYTES = 20  # a cell of the window while a search runs: state, terrain, cost, parent and some of the queue
_SIZES = 1e-6, 1e6  # metres that options may ask for
_MOST_WEIGHT = 1e6  # beyond it costs drown the lengths of the paths
_REACH = 0.5  # metres, of the clearance where none is given, and no less than two cells
_FINEST = 24, 12  # steps to a radius at most, in the plane and in space, of the places of a disc that are looked at
# hexmap.lattice.NAMES, whose module is slow to load for a help text.
_LATTICES = "Z2", "A2", "Z3", "D3", "D3*", "A2xZ"
_JAGGED = 360.0, 5.0  # degrees of turning beyond which a path is: of all, and a cell


class Planner(StrEnum):
    """What looks for the path."""

    astar = "astar"
    dijkstra = "dijkstra"
    any_angle = "any-angle"
    canonical = "canonical"


class Unknown(StrEnum):
    """What cells are that nobody has seen."""

    blocked = "blocked"
    free = "free"


class PlanCommand(TyperCommand):
    """A command whose --from and --to take all numbers that follow, negative ones too."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the numbers after --from and --to by commas before the parser takes -8 for an option."""
        joined: list[str] = []
        seen: set[str] = set()
        rest = list(args)
        while rest:
            word = rest.pop(0)
            if word == "--":
                joined += [word, *rest]
                break
            name = word.partition("=")[0]
            if name in ("--from", "--to"):
                if name in seen:
                    raise typer.BadParameter(f"{name} is given twice", ctx=ctx)
                seen.add(name)
            if word in ("--from", "--to"):
                numbers = []
                while rest and all(_NUMBER.fullmatch(part) for part in rest[0].rstrip(",").split(",")):
                    numbers.append(rest.pop(0).rstrip(","))
                if numbers:
                    word = f"{word}={','.join(numbers)}"
            joined.append(word)
        return super().parse_args(ctx, joined)


def _place(text: str) -> Place:
    """Return the numbers of a place."""
    try:
        numbers = tuple(float(part) for part in text.replace(",", " ").split())
    except ValueError:
        numbers = ()
    if len(numbers) not in (2, 3):
        raise typer.BadParameter(f"a place takes two or three finite numbers of metres, not {text!r}")
    for word, number in zip(text.replace(",", " ").split(), numbers, strict=True):
        if not math.isfinite(number):
            raise typer.BadParameter(f"a place takes finite numbers of metres, not {word}")
    return numbers


def _neighbourhood(text: str) -> str | int:
    """Return a neighbourhood's name or size."""
    if text in ("nearest", "faces", "extended"):
        return text
    if not text.isdecimal():
        raise typer.BadParameter(f"a neighbourhood is nearest, faces, extended or a number of moves, not {text!r}")
    return int(text)


_PLACE: dict[str, Any] = {"parser": _place, "metavar": "X Y [Z]"}


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
            parser=_neighbourhood,
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
    from hexmap.errors import ArgumentError

    query = _Query(
        start, goal, planner, weight, bidirectional, shortcut, nearest,
        radius, clearance_weight, clearance_reach, unknown, neighbourhood,
    )  # fmt: skip
    _check_usage(query)
    if whole and picture is None:
        raise typer.BadParameter("--whole is about the --picture")
    _check_numbers(query, {"--resolution": resolution, "--cell": cell}, min_hits, min_ratio)
    check_outputs({"--output": output, "--picture": picture}, _inputs(world))
    if output is not None and output.suffix.lower() != ".csv":
        raise ArgumentError(f"{output}: a path is written as .csv, not {output.suffix or 'a file without a suffix'}")
    if picture is not None:
        from hexmap.drawing import check_picture

        check_picture(picture)
    own = clouds.is_parquet(world)
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
        ground = _own_ground(world, query, level or 0, lambda sources: rule_of(min_hits, min_ratio, sources))
    else:
        ground = _foreign_ground(world, query, lattice, resolution, cell)
    graph = ground.graph
    if radius != 0.0:
        graph = graph.with_clearance(radius, to="cell")
    if clearance_weight is not None:
        reach = max(_REACH, 2.0 * graph.lattice.resolution) if clearance_reach is None else clearance_reach
        graph = graph.with_soft_clearance(reach, clearance_weight, to="cell")
    seconds = time.perf_counter() - begin
    compiling_note(*_kernels_of(graph, query))
    way = _search(ground, graph, query)
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
        wrote(output, f"{_count(len(way), 'point')}, metres")
    if picture is not None:
        from hexmap.path_drawing import draw_path

        ends = f"from {_metres(start)} to {_metres(goal)}".replace("-", "\N{MINUS SIGN}")
        name = world.name if len(world.name) <= 40 else world.name[:39] + "\N{HORIZONTAL ELLIPSIS}"
        draw_path(
            way.points, picture, graph, ground.state_at, goal=None if way.goal_reached else goal,
            extent=(ground.low, ground.high), whole=whole,
            y_down=ground.y_down, title=f"{name}: {way.length:.2f} m {ends}",
            words=f"robot of radius {radius:g} m" if radius else "",
        )  # fmt: skip
        wrote(picture, "the whole map" if whole else "the path and what surrounds it")


@dataclass(frozen=True)
class _Query:
    """What is asked of a map, as the options say it.

    Attributes:
        start, goal: places, metres.
        planner, weight, bidirectional, shortcut, nearest: how the path is looked for.
        radius, clearance_weight, clearance_reach: how it keeps off occupied cells.
        unknown, neighbourhood: what cells and what moves it may take.
    """

    start: Place
    goal: Place
    planner: Planner
    weight: float | None
    bidirectional: bool
    shortcut: bool
    nearest: bool
    radius: float
    clearance_weight: float | None
    clearance_reach: float | None
    unknown: Unknown
    neighbourhood: Any


def _check_usage(query: _Query) -> None:
    """Turn down options that do not go together."""
    planner = query.planner
    asked = {
        "--weight": query.weight is not None, "--bidirectional": query.bidirectional, "--nearest": query.nearest,
    }  # fmt: skip
    named = [name for name, given in asked.items() if given]
    if named and planner is not Planner.astar:
        instead = "; in Python planners.nearest_reachable gives the cell to search to" if query.nearest else ""
        raise typer.BadParameter(f"{' and '.join(named)}: only with --planner astar, not with {planner.value}{instead}")
    if query.clearance_weight is not None and planner not in (Planner.astar, Planner.dijkstra):
        raise typer.BadParameter(f"--clearance-weight: only with --planner astar or dijkstra, not with {planner.value}")
    if query.bidirectional and query.weight is not None:
        raise typer.BadParameter("--bidirectional takes no --weight")
    if query.shortcut and planner is Planner.any_angle:
        raise typer.BadParameter("--shortcut: a path of any angle is straightened already")
    if query.clearance_reach is not None and query.clearance_weight is None:
        raise typer.BadParameter("--clearance-reach needs a --clearance-weight")


def _check_numbers(
    query: _Query, sizes: dict[str, float | None], min_hits: int | None, min_ratio: float | None
) -> None:
    """Turn down numbers out of their range.

    Raises:
        ArgumentError: naming the option and the value.
    """
    from hexmap.errors import ArgumentError

    low, high = _SIZES
    limits: list[tuple[str, float | None, float, float, str]] = [
        *((option, size, low, high, " m") for option, size in sizes.items()),
        ("--radius", query.radius, 0.0, high, " m"),
        ("--clearance-reach", query.clearance_reach, low, high, " m"),
        ("--weight", query.weight, 1.0, _MOST_WEIGHT, ""),
        ("--clearance-weight", query.clearance_weight, 0.0, _MOST_WEIGHT, ""),
        ("--min-hits", min_hits, 1, 2**31 - 1, ""),
        ("--min-ratio", min_ratio, 0.0, 1.0, ""),
    ]
    for option, value, least, most, unit in limits:
        if value is not None and not least <= value <= most:
            raise ArgumentError(f"{option} must be {least:.10g} to {most:.10g}{unit}, not {value:.10g}")


def _inputs(world: Path) -> tuple[Path, ...]:
    """Return all files that are read for a map: itself and what it names."""
    suffixes = [suffix.lower() for suffix in world.suffixes if suffix.lower() != ".gz"]
    if suffixes[-1:] not in ([".yaml"], [".yml"]):
        return (world,)
    from hexmap.errors import FormatError
    from hexmap.worlds.ros import image_of

    try:
        return world, image_of(world)
    except FormatError:  # of another kind in spite of its name, or damaged, which reading it will say
        return (world,)


# ---------------------------------------------------------------------- what is searched


@dataclass(frozen=True, eq=False)
class _Ground:
    """A map ready for planning.

    Attributes:
        path: the file.
        graph: its cells, before any radius.
        state_at: tells for points (N, n), metres, whether they are UNKNOWN, FREE or OCCUPIED (of hexmap.maps).
        low, high: corners of what is known, metres.
        source: what to say of the file's own cells.
        has_unknown: whether any cell is unknown.
        y_down: whether low y is at the top.
    """

    path: Path
    graph: LatticeGraph
    state_at: Callable[[NDArray[np.float64]], NDArray[np.uint8]]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    source: str = ""
    has_unknown: bool = True
    y_down: bool = False


def _own_ground(path: Path, query: _Query, level: int, rule_for: Callable[[Any], Any]) -> _Ground:
    """Return a level of a map of hexmap."""
    import numpy as np

    from hexmap.files import load_map
    from hexmap.graph import LatticeGraph

    world = load_map(path)
    _check_places(path, query, world.lattice.dim)
    rule = rule_for(world.sources())
    graph = LatticeGraph.from_map(
        world, level=level, rule=rule, unknown=query.unknown.value, neighbourhood=query.neighbourhood
    )
    states = world.state(rule, level)
    centres = np.concatenate([states.occupied.centres(), states.free.centres()])

    def state_at(points: NDArray[np.float64]) -> NDArray[np.uint8]:
        return states.of(graph.lattice.quantise(points))

    room = graph.lattice.covering_radius
    return _Ground(path, graph, state_at, centres.min(axis=0) - room, centres.max(axis=0) + room)


def _foreign_ground(
    path: Path, query: _Query, lattice: str | None, resolution: float | None, cell: float | None
) -> _Ground:
    """Return a map of others, rasterised onto a lattice."""
    import numpy as np

    from hexmap import worlds
    from hexmap.errors import ArgumentError
    from hexmap.lattice import Lattice, default_name
    from hexmap.maps import FREE, OCCUPIED, UNKNOWN

    try:
        world = worlds.open_world(path, cell=cell)
    except ArgumentError as error:  # of its arguments only the cell can be wrong
        raise ArgumentError(f"{error}; leave out --cell") from error
    _check_places(path, query, world.dim)
    # Half a cell in space is eight times the memory, and the walls of an OctoMap are thick.
    usual = 0.5 * world.cell if world.dim == 2 else world.cell
    on = Lattice.named(lattice or default_name(world.dim), resolution or usual)
    if on.dim != world.dim:
        raise ArgumentError(f"{path}: the map is of dimension {world.dim}, the lattice {on.name} of {on.dim}")
    low, high = np.asarray(world.low), np.asarray(world.high)
    _check_size(path, on, low, high)
    graph = world.to_graph(on, unknown=query.unknown.value, neighbourhood=query.neighbourhood)
    codes = np.zeros(3, np.uint8)
    codes[[worlds.BLOCKED, worlds.FREE, worlds.UNKNOWN]] = OCCUPIED, FREE, UNKNOWN

    def state_at(points: NDArray[np.float64]) -> NDArray[np.uint8]:
        return codes[world.state_at(points)]

    source = f" on cells of {world.cell:g} m"
    return _Ground(path, graph, state_at, low, high, source, world.has_unknown, world.y_down)


def _check_places(path: Path, query: _Query, dim: int) -> None:
    """Turn down places of another dimension than the map's.

    Raises:
        ArgumentError: one is.
    """
    from hexmap.errors import ArgumentError

    for option, place in (("--from", query.start), ("--to", query.goal)):
        if len(place) != dim:
            raise ArgumentError(
                f"{path}: the map is of dimension {dim}; {option} takes {dim} numbers, not {len(place)}"
            )


def _check_size(path: Path, lattice: Lattice, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    """Turn down a window that the machine has no memory for, before anything is allocated.

    Raises:
        TooLargeError: there is not enough.
    """
    import numpy as np

    from hexmap.errors import TooLargeError

    corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, lattice.dim)
    cells = float(np.prod(np.ptp(corners @ np.linalg.inv(lattice.basis).T, axis=0) + 3.0))
    memory = _available_memory()
    most = min(memory / _SEARCH_BYTES, 2.0**31)
    if cells > most:
        enough = lattice.resolution * (cells / most) ** (1.0 / lattice.dim) * 1.05
        there = f" of {memory / 2**30:.1f} that are available" if math.isfinite(memory) else ""
        raise TooLargeError(
            f"{path}: {cells:,.0f} cells of {lattice.resolution:g} m are too many to search "
            f"({cells * _SEARCH_BYTES / 2**30:.1f} GiB{there}); take a coarser --resolution, {enough:.2g} m or more"
        )


def _available_memory() -> float:
    """Return the bytes that can be allocated without swapping; where nobody says, most of what there is."""
    try:
        text = Path("/proc/meminfo").read_text()
    except OSError:
        text = ""
    found = re.search(r"^MemAvailable:\s*(\d+) kB", text, re.MULTILINE)
    if found is not None:
        return 1024.0 * int(found[1])
    try:
        return 0.9 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return math.inf


# ---------------------------------------------------------------------- the search


def _search(ground: _Ground, graph: LatticeGraph, query: _Query) -> Way:
    """Return the path.

    Raises:
        NoPath: there is none; the text says why, in metres, and what may help.
    """
    from hexmap.errors import BoundsError
    from planners import NoPath, to_cell

    cells = []
    for option, place in (("--from", query.start), ("--to", query.goal)):
        try:
            cells.append(to_cell(graph, place).tolist())
        except BoundsError as error:
            raise BoundsError(f"{option}: {_metres(place)} m is farther away than cells can be counted") from error
    run = _planner(query)
    try:
        _warm_up(run, graph)
        return run(graph, *cells)
    except NoPath as error:
        text, helps = _why(error, ground, graph, query, cells)
        if query.nearest or query.planner is not Planner.astar or error.reason.startswith("start"):
            helps.remove("--nearest")
        advice = f"; {' or '.join(helps)} may help" if helps else ""
        raise NoPath(error.reason, text + advice) from error


def _planner(query: _Query) -> Callable[[LatticeGraph, Any, Any], Way]:
    """Return what answers a query of two cells."""
    import planners

    if query.planner is Planner.dijkstra:
        return lambda graph, start, goal: planners.dijkstra(graph, start, goals=goal).path_to(goal)
    if query.planner is Planner.astar:
        factor = 1.0 if query.weight is None else query.weight
        return lambda graph, start, goal: planners.astar(
            graph, start, goal, bidirectional=query.bidirectional, weight=factor, nearest=query.nearest
        )
    found: Callable[[LatticeGraph, Any, Any], Way]
    found = planners.any_angle if query.planner is Planner.any_angle else planners.canonical
    return found


def _warm_up(run: Callable[[LatticeGraph, Any, Any], Way], graph: LatticeGraph) -> None:
    """Load or compile the kernels on a handful of cells, so that the search's time is its own."""
    import numpy as np

    from hexmap.graph import LatticeGraph

    some = np.ones(tuple((2 * graph.pad + 1).tolist()), np.uint8)
    small = LatticeGraph.from_states(graph.lattice, -graph.pad, some, neighbourhood=len(graph.moves))
    if graph.terrain is not None:
        small = small.with_terrain(np.ones(small.size))
    run(small, [0] * graph.lattice.dim, graph.moves[0].tolist())


def _kernels_of(graph: LatticeGraph, query: _Query) -> list[Any]:
    """Return the kernels whose compilation the search would wait for longest."""
    from planners import _anyangle_kernels, _canonical_kernels, _field_kernels, _search_kernels

    heuristic = _search_kernels.search_both if query.bidirectional else _search_kernels.advance
    alike = graph.equal_edges and graph.terrain is None and len(graph.swept) == 0
    own = {
        Planner.astar: heuristic,
        Planner.dijkstra: _field_kernels.wavefront if alike else _field_kernels.buckets,
        Planner.any_angle: _anyangle_kernels.search,
        Planner.canonical: _canonical_kernels.search,
    }
    return [own[query.planner], *([_anyangle_kernels.farthest] if query.shortcut else [])]


def _why(
    error: NoPath, ground: _Ground, graph: LatticeGraph, query: _Query, cells: list[list[int]]
) -> tuple[str, list[str]]:
    """Return why there is no path, with places in metres, and which options may help."""
    import numpy as np

    from hexmap.maps import UNKNOWN

    start, goal = query.start, query.goal
    smaller = ["a smaller --radius"] if query.radius > 0.0 else []
    open_up = ["--unknown free"] if ground.has_unknown and query.unknown is Unknown.blocked else []
    at = 0 if error.reason.startswith("start") else 1
    where = f"{_metres((start, goal)[at])} m, cell {_cell(cells[at])},"
    if "outside" in error.reason:
        extent = ", ".join(
            f"{axis} from {low:.2f} to {high:.2f} m"
            for axis, low, high in zip("xyz", ground.low, ground.high, strict=False)
        )
        return f"{where} and the map has {extent}", ["--nearest"]
    if "blocked" in error.reason:
        cell = np.array([cells[at]])
        flat = ground.graph.index_to_flat(cell)
        helps = ["--nearest"]
        if ground.graph.free[flat[0]]:
            room = float(ground.graph.clearance_at(flat, to="cell")[0])
            text = f"{where} is {room:.3g} m from an occupied cell, nearer than the radius of {query.radius:g} m"
            helps += smaller
        elif ground.state_at(ground.graph.lattice.centres(cell))[0] == UNKNOWN:
            text = f"{where} is unknown"
            helps += open_up
        else:
            text = f"{where} is occupied"
        return text + _nearest_free(graph, (start, goal)[at], cells[1 - at], ("--to", "--from")[at]), helps
    text = (
        f"nothing leads from {_metres(start)} m, cell {_cell(cells[0])}, to {_metres(goal)} m, cell {_cell(cells[1])}"
    )
    return text, ["--nearest", *smaller, *open_up]


def _nearest_free(graph: LatticeGraph, place: Place, other: list[int], option: str) -> str:
    """Return where the nearest cell is that can be taken instead of a place, connected with the other end if it can."""
    import numpy as np

    from planners import NoPath, nearest_reachable

    try:
        centre = graph.lattice.centres(nearest_reachable(graph, other, place)[None])[0]
        what = f"the nearest free cell that {option} is connected with"
    except NoPath:  # the other end is no better
        free = np.flatnonzero(graph.free)
        if len(free) == 0:
            return ""
        best = math.inf
        for k in range(0, len(free), 1 << 20):
            centres = graph.centres(free[k : k + (1 << 20)])
            away = ((centres - np.asarray(place)) ** 2).sum(axis=1)
            if away.min() < best:
                best, centre = away.min(), centres[away.argmin()]
        what = "the nearest free cell"
    # As many digits as lead back to that cell.
    digits = max(2, 1 + math.ceil(-math.log10(graph.lattice.resolution)))
    return f"; {what} is at ({', '.join(f'{round(float(v), digits) + 0.0:.12g}' for v in centre)}) m"


def _share_at_unknown(way: Way, ground: _Ground, radius: float) -> float:
    """Return the share of the path along which a disc, in space a ball, of a radius (m) meets unknown cells.

    The places that are looked at are those of a fine grid within the disc and on its rim.
    """
    import numpy as np

    from hexmap.maps import UNKNOWN

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
        met += int((states.reshape(len(part), -1) == UNKNOWN).any(axis=1).sum())
    return met / len(line)


def _report(way: Way, ground: _Ground, query: _Query) -> None:
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
        f"{query.planner.value} from {_metres(query.start)} to {_metres(query.goal)}: "
        f"length {way.length:.3f} m, cost {cost}, turning {math.degrees(way.turning):.0f} deg, {room}, "
        f"{_count(len(way), 'point' if straight else 'cell')}"
    )
    if not way.goal_reached:
        say(
            f"the goal was not reached: the path stops at {_metres(way.points[-1].tolist())}, "
            f"{math.dist(way.points[-1], query.goal):.2f} m away from it"
        )
    # Of any angle, nothing but the straight line bounds the cost from below.
    times = (
        f"{way.bound:.4g} times the straight line"
        if query.planner is Planner.any_angle
        else f"at most {way.bound:.4g} times the least cost"
    )
    bound = f", {times}" if 1.0 < way.bound < math.inf else ""
    effort = f"{_count(way.expansions, 'expansion')}, {_count(way.pushes, 'push', 'pushes')}"
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

    from hexmap.rays import traverse

    cells = way.cells
    if len(way) > 1:
        cells = np.concatenate([cells, traverse(graph.lattice, way.points[:-1], way.points[1:]).index])
    flat = graph.index_to_flat(np.unique(cells, axis=0))
    return float(np.min(graph.clearance_at(flat[flat >= 0], to="cell")))


def _metres(place: Any) -> str:
    return f"({', '.join(f'{round(float(v), 3):g}' for v in place)})"


def _count(number: int, one: str, many: str = "") -> str:
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def _cell(cell: Any) -> str:
    return f"({', '.join(str(int(v)) for v in cell)})"
