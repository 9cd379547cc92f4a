"""How ``hexmap plan`` looks for a path, and what it says where there is none."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from hexmap.cli.plan.map_source import PlanningMap
from hexmap.cli.plan.query import Planner, Position, Query, Unknown, cell_text, in_metres

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph
    from planners import NoPath
    from planners import Path as PlannedPath


def find_path(planning_map: PlanningMap, graph: LatticeGraph, query: Query) -> PlannedPath:
    """Return the path.

    Raises:
        NoPath: there is none; the text says why, in metres, and what may help.
    """
    from hexmap.base.errors import BoundsError
    from planners import NoPath, to_cell

    cells = []
    for option, position in (("--from", query.start), ("--to", query.goal)):
        try:
            cells.append(to_cell(graph, position).tolist())
        except BoundsError as error:
            raise BoundsError(f"{option}: {in_metres(position)} m is farther away than cells can be counted") from error
    run = _planner(query)
    try:
        _warm_up(run, graph)
        return run(graph, *cells)
    except NoPath as error:
        text, helps = _why(error, planning_map, graph, query, cells)
        other = query.planner is not Planner.astar and not query.is_default
        if query.nearest or other or error.reason.startswith("start"):
            helps = [help for help in helps if help != "--nearest"]
        advice = f"; {' or '.join(helps)} may help" if helps else ""
        raise NoPath(error.reason, text + advice) from error


def _planner(query: Query) -> Callable[[LatticeGraph, Any, Any], PlannedPath]:
    """Return what answers a query of two cells."""
    import planners

    if query.planner is Planner.dijkstra:
        return lambda graph, start, goal: planners.dijkstra(graph, start, goals=goal).path_to(goal)
    if query.planner is Planner.astar:
        factor = 1.0 if query.weight is None else query.weight
        return lambda graph, start, goal: planners.astar(
            graph, start, goal, bidirectional=query.bidirectional, weight=factor, nearest=query.nearest
        )
    found: Callable[[LatticeGraph, Any, Any], PlannedPath]
    found = planners.any_angle if query.planner is Planner.any_angle else planners.canonical
    return found


@contextlib.contextmanager
def compiled_aside(query: Query) -> Iterator[None]:
    """Compile half of a planner in another process, where it has never been, while this one reads the map.

    The other half is compiled here when it is called. What is compiled goes from one process to the other through the
    cache of kernels; where a process fails nothing is lost but time. It is over at the end of the block.
    """
    import subprocess
    import sys

    from hexmap.cli.console import compiling_note, is_compiled
    from planners.any_angle import _kernels, _theta_kernels

    free = query.planner is Planner.any_angle
    kernel = _theta_kernels.search if free else _kernels.tighten
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if processors < 2 or not (free or query.shortcut) or is_compiled(kernel):
        yield
        return
    compiling_note(kernel, seconds=10)
    half = f"from hexmap.cli.plan.search import compile_half; compile_half({len(query.start)}, {free})"
    process = subprocess.Popen(
        [sys.executable, "-c", half], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        yield
        if free:
            compile_half(len(query.start), False)
        process.wait()
    finally:
        process.kill()
        process.wait()


def compile_half(dim: int, search: bool) -> None:
    """Compile the searches of the any-angle planner, or else what makes paths taut, on a handful of cells."""
    import numpy as np

    from hexmap.graph.lattice_graph import LatticeGraph
    from hexmap.lattice.lattice import Lattice
    from planners import astar
    from planners.any_angle.theta_star import Effort, make_view, search_path, tightened

    graph = LatticeGraph.from_states(Lattice.named(f"Z{dim}"), [0] * dim, np.ones((3,) * dim, np.uint8))
    a, b = graph.index_to_flat(np.array([[0] * dim, [2] * dim])).tolist()
    if search:
        search_path(graph, a, b, tighten=False)
        astar(graph, [0] * dim, [2] * dim)
    else:
        tightened(graph, make_view(graph), np.array([a, b]), np.zeros(len(Effort._fields), np.int64))


def _warm_up(run: Callable[[LatticeGraph, Any, Any], PlannedPath], graph: LatticeGraph) -> None:
    """Load or compile the kernels on a handful of cells, so that the search's time is its own."""
    import numpy as np

    from hexmap.graph.lattice_graph import LatticeGraph

    some = np.ones(tuple((2 * graph.pad + 1).tolist()), np.uint8)
    small = LatticeGraph.from_states(graph.lattice, -graph.pad, some, neighbourhood=len(graph.moves))
    if graph.terrain is not None:
        small = small.with_terrain(np.ones(small.size))
    run(small, [0] * graph.lattice.dim, graph.moves[0].tolist())


def kernels_of(graph: LatticeGraph, query: Query) -> list[Any]:
    """Return the kernels whose compilation the search would wait for longest."""
    from planners.any_angle import _kernels as _anyangle_kernels
    from planners.any_angle import _theta_kernels
    from planners.search import _astar_kernels, _bidirectional_kernels, _canonical_kernels
    from planners.search.dijkstra import field_kernel

    heuristic = _bidirectional_kernels.search_both if query.bidirectional else _astar_kernels.run_astar
    own = {
        Planner.astar: heuristic,
        Planner.dijkstra: field_kernel(graph),
        Planner.any_angle: _theta_kernels.search,
        Planner.canonical: _canonical_kernels.search,
    }
    assert query.planner is not None
    straightens = _anyangle_kernels.tighten if graph.terrain is None else _anyangle_kernels.sights
    return [own[query.planner], *([straightens] if query.shortcut else [])]


def _why(
    error: NoPath, planning_map: PlanningMap, graph: LatticeGraph, query: Query, cells: list[list[int]]
) -> tuple[str, list[str]]:
    """Return why there is no path, with positions in metres, and which options may help."""
    import numpy as np

    from hexmap.maps.cell_state import CellState

    start, goal = query.start, query.goal
    smaller = ["a smaller --radius"] if query.radius > 0.0 else []
    open_up = ["--unknown free"] if planning_map.has_unknown and query.unknown is Unknown.blocked else []
    at = 0 if error.reason.startswith("start") else 1
    where = f"{in_metres((start, goal)[at])} m, cell {cell_text(cells[at])},"
    if "outside" in error.reason:
        extent = ", ".join(
            f"{axis} from {low:.2f} to {high:.2f} m"
            for axis, low, high in zip("xyz", planning_map.low, planning_map.high, strict=False)
        )
        return f"{where} and the map has {extent}", []
    if "blocked" in error.reason:
        cell = np.array([cells[at]])
        flat = planning_map.graph.index_to_flat(cell)
        helps = ["--nearest"]
        if planning_map.graph.free[flat[0]]:
            room = float(planning_map.graph.clearance_at(flat, to="cell")[0])
            text = f"{where} is {room:.3g} m from an occupied cell, nearer than the radius of {query.radius:g} m"
            helps += smaller
        elif planning_map.state_at(planning_map.graph.lattice.centres(cell))[0] == CellState.UNKNOWN:
            text = f"{where} is unknown"
            helps += open_up
        elif planning_map.state_at(planning_map.graph.lattice.centres(cell))[0] == CellState.FREE:
            size = planning_map.graph.lattice.resolution
            text = f"{where} of {size:g} m reaches into an occupied cell of the map"
            helps.append("a finer --resolution")
        else:
            text = f"{where} is occupied"
        return text + _nearest_free(graph, (start, goal)[at], cells[1 - at], ("--to", "--from")[at]), helps
    ends = [f"{in_metres(p)} m, cell {cell_text(c)}" for p, c in zip((start, goal), cells, strict=True)]
    text = f"nothing leads from {ends[0]}, to {ends[1]}"
    return text, ["--nearest", *smaller, *open_up]


def _nearest_free(graph: LatticeGraph, position: Position, other: list[int], option: str) -> str:
    """Return where the nearest cell is that will do for a position, connected with the other end if possible."""
    from hexmap.graph.queries import nearest_free_centre
    from planners import NoPath, nearest_reachable

    try:
        centre = graph.lattice.centres(nearest_reachable(graph, other, position)[None])[0]
        what = f"the nearest free cell that {option} is connected with"
    except NoPath:  # the other end is no better
        found = nearest_free_centre(graph, position)
        if found is None:
            return ""
        centre = found
        what = "the nearest free cell"
    # As many digits as lead back to that cell.
    digits = max(2, 1 + math.ceil(-math.log10(graph.lattice.resolution)))
    return f"; {what} is at ({', '.join(f'{round(float(v), digits) + 0.0:.12g}' for v in centre)}) m"
