"""The maps that ``hexmap plan`` plans in: maps of hexmap, and grid maps that others made."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hexmap.cli.plan.query import Query, Unknown

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hexmap.graph.lattice_graph import LatticeGraph
    from hexmap.lattice.lattice import Lattice
    from hexmap.maps.map import Map
    from hexmap.maps.state_rule import StateRule


_STRAYS = 0.001  # fraction of the cells beyond which they stray, on each side
_SEARCH_BYTES = 20  # a cell of the window while a search runs: state, terrain, cost, parent and some of the queue


def inputs_of(path: Path) -> tuple[Path, ...]:
    """Return all files that are read for a map: itself and what it names."""
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() != ".gz"]
    if suffixes[-1:] not in ([".yaml"], [".yml"]):
        return (path,)
    from hexmap.base.errors import FormatError
    from hexmap.io.grids.ros import image_of

    try:
        return path, image_of(path)
    except FormatError:  # of another kind in spite of its name, or damaged, which reading it will say
        return (path,)


@dataclass(frozen=True, eq=False)
class PlanningMap:
    """A map ready for planning.

    Attributes:
        path: the file.
        graph: its cells, before any radius.
        state_at: returns the :class:`~hexmap.maps.CellState` (N,) of points (N, n), metres.
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


def found(path: Path) -> Path:
    """Return a map's path, or its packed form (.gz) where only that is there."""
    packed = path.with_name(path.name + ".gz")
    return packed if not path.exists() and packed.exists() else path


def own_map(
    path: Path,
    loaded: Map,
    query: Query,
    level: int,
    rule: StateRule,
    lattice: Lattice | str | None = None,
    resolution: float | None = None,
) -> PlanningMap:
    """Return a level of a map of hexmap read from ``path``, on its own lattice or another."""
    import numpy as np

    from hexmap.base.errors import ArgumentError
    from hexmap.graph.lattice_graph import LatticeGraph
    from hexmap.graph.meeting import block_met
    from hexmap.lattice.convert import as_lattice
    from hexmap.maps.cell_state import CellState

    _check_dimensions(path, query, loaded.lattice.dim)
    states = loaded.state(rule, level)
    own = states.occupied.lattice
    centres = np.concatenate([states.occupied.centres(), states.free.centres()])
    if len(centres) == 0:
        raise ArgumentError(f"{path}: level {level} of the map has no cell that is free or occupied")
    low, high = centres.min(axis=0) - own.covering_radius, centres.max(axis=0) + own.covering_radius

    def state_at(points: NDArray[np.float64]) -> NDArray[np.uint8]:
        return states.of(own.quantise(points))

    if lattice is None and resolution is None:
        _check_window(path, loaded, level)
        graph = LatticeGraph.from_map(
            loaded, level=level, rule=rule, unknown=query.unknown.value, neighbourhood=query.neighbourhood
        )
        return PlanningMap(path, graph, state_at, low, high)
    named = isinstance(lattice, str) and resolution is None
    on = as_lattice(own if lattice is None else lattice, own.resolution if named else resolution)
    if on.dim != own.dim:
        raise ArgumentError(f"{path}: the map is of dimension {own.dim}, the lattice {on.name} of {on.dim}")
    _check_size(path, on, low, high)
    passable = (CellState.FREE, CellState.UNKNOWN) if query.unknown is Unknown.free else (CellState.FREE,)
    graph = LatticeGraph.rasterise(
        lambda points: np.isin(state_at(points), passable), on, low, high, neighbourhood=query.neighbourhood,
        occupied_at=lambda points: state_at(points) == CellState.OCCUPIED,
    )  # fmt: skip
    # By their whole area, so that no line between centres runs through what is occupied.
    graph = block_met(graph, states.occupied.centres(), own.cell.vertices)
    return PlanningMap(path, graph, state_at, low, high, f" on {own.title} cells of {own.resolution:g} m")


def foreign_map(
    path: Path, query: Query, lattice: Lattice | str | None, resolution: float | None, cell: float | None
) -> PlanningMap:
    """Return a map of others, rasterised onto a lattice."""
    import numpy as np

    from hexmap.base.errors import ArgumentError
    from hexmap.io.grids.open_grid import open_grid
    from hexmap.lattice.convert import as_lattice
    from hexmap.lattice.lattice import Lattice, default_name

    try:
        grid = open_grid(path, cell=cell)
    except ArgumentError as error:  # of its arguments only the cell can be wrong
        raise ArgumentError(f"{error}; leave out --cell") from error
    _check_dimensions(path, query, grid.dim)
    # Half a cell in space is eight times the memory, and the walls of an OctoMap are thick.
    usual = 0.5 * grid.cell if grid.dim == 2 else grid.cell
    if not isinstance(lattice, Lattice):
        lattice = Lattice.named(lattice or default_name(grid.dim), resolution or usual)
    on = as_lattice(lattice, resolution)
    if on.dim != grid.dim:
        raise ArgumentError(f"{path}: the map is of dimension {grid.dim}, the lattice {on.name} of {on.dim}")
    low, high = np.asarray(grid.low), np.asarray(grid.high)
    _check_size(path, on, low, high)
    graph = grid.to_graph(on, unknown=query.unknown.value, neighbourhood=query.neighbourhood, rule="area")
    source = f" on cells of {grid.cell:g} m"
    return PlanningMap(path, graph, grid.state_at, low, high, source, grid.has_unknown, grid.y_down)


def _check_dimensions(path: Path, query: Query, dim: int) -> None:
    """Check that the positions are of the map's dimension.

    Raises:
        ArgumentError: one is not.
    """
    from hexmap.base.errors import ArgumentError

    for option, position in (("--from", query.start), ("--to", query.goal)):
        if len(position) != dim:
            raise ArgumentError(
                f"{path}: the map is of dimension {dim}; {option} takes {dim} numbers, not {len(position)}"
            )


def _check_window(path: Path, loaded: Map, level: int) -> None:
    """Reject a map whose box is too large for a window, naming the box that most of its cells lie in.

    Raises:
        TooLargeError: it is. A few beams through a window or off a mirror are enough for that.
    """
    import numpy as np

    from hexmap.base.errors import TooLargeError
    from hexmap.graph.lattice_graph import MAX_CELLS
    from hexmap.lattice.keys import unpack

    keys, _, _ = loaded.level(level).columns()
    if len(keys) == 0:
        return
    index = unpack(keys, loaded.lattice.dim)
    cells = float(np.prod(np.ptp(index, axis=0).astype(np.float64) + 3.0))
    if cells > MAX_CELLS:
        centres = loaded.level(level).lattice.centres(index)
        low, high = np.quantile(centres, (_STRAYS, 1.0 - _STRAYS), axis=0)
        box = ",".join(f"{v:.0f}" for v in (*np.floor(low), *np.ceil(high)))
        raise TooLargeError(
            f"{path}: the box of its cells is {cells:,.0f} cells, more than {MAX_CELLS:,}; most of them lie in "
            f"--crop={box}, or take a coarser --level"
        )


def _check_size(path: Path, lattice: Lattice, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    """Reject a window that the machine has no memory for, before anything is allocated.

    Raises:
        TooLargeError: there is not enough.
    """
    import numpy as np

    from hexmap.base.errors import TooLargeError
    from hexmap.lattice.window import box_coordinates

    cells = float(np.prod(np.ptp(box_coordinates(lattice.basis, low, high), axis=0) + 3.0))
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
    """Return the bytes that can be allocated without swapping; where the system does not say, most of what there is."""
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
