"""What goes into a page: the levels of maps with their lattices' numbers, as plain values and compressed bytes.

A page knows no lattice by name. What it draws with and plans with is written out here: the basis, the candidates of its
quantiser, the corners and faces of a cell, the moves of each neighbourhood with their lengths and the cells they sweep.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.graph.moves import lengths_of, swept_by_moves
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.keys import pack, unpack
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule
from hexmap.poses.trajectory import Trajectory
from hexmap.web.tiles import Tiles, compress, encode

__all__ = ["PageLevel", "PageMap", "level_numbers", "on_lattice", "page_map", "trajectory_runs"]

_STEP = 0.25  # of a cell, which a trajectory must have moved for another point
_GRAIN = 1e-3  # metres, of a trajectory's points


@dataclass(frozen=True, eq=False)
class PageLevel:
    """Cells of one resolution, those that are known only.

    Attributes:
        lattice: of the plane.
        origin: (2,) metres, where the cell 0 has its centre.
        index: (M, 2) int32, lexicographically.
        hits, passes: (M,) int64 counts; None in a map that knows states only.
        states: (M,) uint8 states; None where they follow from the counts.
    """

    lattice: Lattice
    origin: tuple[float, float]
    index: NDArray[np.int32]
    hits: NDArray[np.int64] | None = None
    passes: NDArray[np.int64] | None = None
    states: NDArray[np.uint8] | None = None

    def states_by(self, rule: StateRule) -> NDArray[np.uint8]:
        """Return the state (M,) of each cell."""
        if self.states is not None:
            return self.states
        assert self.hits is not None and self.passes is not None
        known = np.where(self.passes >= rule.min_passes, CellState.FREE.value, CellState.UNKNOWN.value)
        return np.where(rule.occupied(self.hits, self.passes), CellState.OCCUPIED.value, known).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class PageMap:
    """A map as a page carries it.

    Attributes:
        title: what its lattice is called.
        levels: the finest first.
        rule: what a cell is, from its counts.
        y_down: whether low y is at the top.
    """

    title: str
    levels: tuple[PageLevel, ...]
    rule: StateRule
    y_down: bool = False


def page_map(source: Map | GridMap, rule: StateRule | None = None) -> PageMap:
    """Return a map in the plane for a page: one of hexmap with its counts, one of others on its own squares.

    Raises:
        ArgumentError: it is in space, or no cell of it is known.
    """
    dim = source.lattice.dim if isinstance(source, Map) else source.dim
    if dim != 2:
        raise ArgumentError("a page shows maps in the plane, and this one is in space")
    if isinstance(source, GridMap):
        levels = [_level_of_grid(source)]
    else:
        columns = [(level.lattice, *level.columns()) for level in source.levels]
        levels = [PageLevel(on, (0.0, 0.0), unpack(keys, 2), hits, passes) for on, keys, hits, passes in columns]
    if len(levels[0].index) == 0:
        raise ArgumentError("no cell of the map is free or occupied, which leaves nothing to show")
    y_down = isinstance(source, GridMap) and source.y_down
    return PageMap(levels[0].lattice.title, tuple(levels), rule or StateRule(), y_down)


def _level_of_grid(grid: GridMap) -> PageLevel:
    """Return the known squares of a map of others."""
    ends = grid.centre(np.array([[0, 0], [1, 0], [0, 1]]))
    # The name decides nothing; the squares of a turned map are another lattice than those along the axes.
    squares = Lattice(np.array([ends[1] - ends[0], ends[2] - ends[0]]).T, "squares of its own")
    index = np.argwhere(grid.states != CellState.UNKNOWN.value).astype(np.int32)
    states = grid.states[index[:, 0], index[:, 1]].astype(np.uint8)
    x, y = ends[0].tolist()
    return PageLevel(squares, (x, y), index, states=states)


def on_lattice(source: Map | GridMap, world: PageMap, lattice: str | Lattice) -> PageMap:
    """Return the same world on another lattice, at the resolution of each level.

    A cell of it is what a map of hexmap has at its centre, as ``hexmap plan --lattice`` has it. A map of others is put
    on the lattice as :meth:`~hexmap.io.grids.GridMap.to_states` does it, so that walls of one square have no gaps.

    Args:
        source: the map.
        world: what :func:`page_map` returned of it.
        lattice: a name, taken at each level's resolution, or the lattice of the finest level, which the others double.

    Raises:
        LatticeError: there is no lattice of that name.
        ArgumentError: it is one of space.
    """
    levels = []
    for k, level in enumerate(world.levels):
        on = Lattice.named(lattice, level.lattice.resolution) if isinstance(lattice, str) else lattice.scaled(2.0**k)
        if on.dim != 2:
            raise ArgumentError(f"the map is in the plane, and {on.name} is a lattice of space")
        levels.append(_rasterised(source, on) if isinstance(source, GridMap) else _resampled(level, on))
    return PageMap(levels[0].lattice.title, tuple(levels), world.rule, world.y_down)


def _rasterised(grid: GridMap, on: Lattice) -> PageLevel:
    """Return the known cells of a map of others on a lattice."""
    states = grid.to_states(on)
    keys = np.concatenate([states.occupied.keys, states.free.keys])
    values = np.repeat([CellState.OCCUPIED.value, CellState.FREE.value], [len(states.occupied), len(states.free)])
    order = np.argsort(keys)
    return PageLevel(on, (0.0, 0.0), unpack(keys[order], 2), states=values[order].astype(np.uint8))


def _resampled(level: PageLevel, on: Lattice) -> PageLevel:
    """Return the cells of a lattice whose centre lies in a known cell, with that cell's counts or state."""
    own, origin = level.lattice, np.array(level.origin)
    reach = own.covering_radius + on.covering_radius
    most = np.floor(np.linalg.norm(np.linalg.inv(on.basis), axis=1) * reach).astype(np.int64)
    around = IndexBox.of_corners(-most, most).cells()
    around = around[np.linalg.norm(on.centres(around), axis=1) <= reach * (1.0 + 1e-9)]
    near = on.quantise(own.centres(level.index) + origin)
    keys = np.unique(pack(near))
    for offset in around:
        keys = np.union1d(keys, np.unique(pack(near + offset.astype(np.int32))))
    index = unpack(keys, 2)
    at = pack(own.quantise(on.centres(index) - origin))
    known = pack(level.index)
    position = np.minimum(np.searchsorted(known, at), len(known) - 1)
    found = known[position] == at
    taken = position[found]
    hits, passes, states = (None if v is None else v[taken] for v in (level.hits, level.passes, level.states))
    return PageLevel(on, (0.0, 0.0), index[found], hits, passes, states)


# ---------------------------------------------------------------------- numbers for the page


def level_numbers(level: PageLevel, rule: StateRule) -> tuple[dict[str, Any], str]:
    """Return a level as plain numbers, and its cells as compressed text."""
    lattice = level.lattice
    tiles = Tiles(level.index)
    states = level.states_by(rule)
    if level.states is not None:
        data, planes = encode(tiles, level.states, predicted=False)[0], {"states": 1}
    else:
        assert level.hits is not None and level.passes is not None
        passes, of_passes = encode(tiles, level.passes, predicted=True)
        hits, of_hits = encode(tiles, level.hits, predicted=False)
        data, planes = passes + hits, {"passes": of_passes, "hits": of_hits}
    numbers = {
        **lattice_numbers(lattice),
        "origin": list(level.origin),
        "low": level.index.min(axis=0).tolist() if len(level.index) else [0, 0],
        "high": level.index.max(axis=0).tolist() if len(level.index) else [0, 0],
        "side": tiles.side,
        "tiles": tiles.corners.ravel().tolist(),
        "planes": planes,
        "known": len(level.index),
        "occupied": int(np.count_nonzero(states == CellState.OCCUPIED.value)),
        "free": int(np.count_nonzero(states == CellState.FREE.value)),
    }
    return numbers, compress(data)


def lattice_numbers(lattice: Lattice) -> dict[str, Any]:
    """Return what a page draws and plans with of a lattice of the plane."""
    return {
        "title": lattice.title,
        "basis": lattice.basis.tolist(),
        "resolution": lattice.resolution,
        "inradius": lattice.inradius,
        "covering": lattice.covering_radius,
        "candidates": candidates(lattice).tolist(),
        "drawn": candidates(lattice, touching=False).tolist(),
        "vertices": lattice.cell.vertices.tolist(),
        "faces": lattice.faces.tolist(),
        "neighbourhoods": [neighbourhood_numbers(lattice, name) for name in _neighbourhoods(lattice)],
    }


def candidates(lattice: Lattice, touching: bool = True) -> NDArray[np.int64]:
    """Return the offsets (K, 2), lexicographically, whose closed cell meets the unit parallelogram of the basis.

    The nearest lattice point to a point x is floor(B^-1 x) plus one of them, whether the basis is reduced or not.
    Without those that are only ``touching`` it the nearest is still among them, but not every one of several.
    """
    # A cell reaches as far along the indices as its corners do.
    corners = lattice.cell.vertices @ np.linalg.inv(lattice.basis).T
    low, high = corners.min(axis=0), corners.max(axis=0)
    box = IndexBox.of_corners(np.floor(-high - 1e-9).astype(np.int64), np.ceil(1.0 - low + 1e-9).astype(np.int64))
    # Convex areas are apart where an edge of one of them separates them (the separating axis theorem).
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    edges = np.concatenate([np.roll(corners, -1, axis=0) - corners, np.eye(2)])
    axes = np.stack([-edges[:, 1], edges[:, 0]], axis=1)
    kept = []
    for offset in box.cells():
        mine, theirs = (corners + offset) @ axes.T, unit @ axes.T
        gap = np.maximum(mine.min(axis=0) - theirs.max(axis=0), theirs.min(axis=0) - mine.max(axis=0))
        if gap.max() <= (1e-9 if touching else -1e-9):
            kept.append(offset)
    return np.array(kept)


def _neighbourhoods(lattice: Lattice) -> Iterator[str]:
    """Yield the names of the neighbourhoods that differ, the lattice's own first."""
    seen: list[NDArray[np.int64]] = []
    for name in ("neighbours", "faces", "extended"):
        moves = getattr(lattice, name)
        if not any(np.array_equal(moves, other) for other in seen):
            seen.append(moves)
            yield name


def neighbourhood_numbers(lattice: Lattice, name: str) -> dict[str, Any]:
    """Return the moves of a neighbourhood, their lengths, metres, and what each sweeps."""
    moves = np.array(getattr(lattice, name), dtype=np.int64)
    swept = swept_by_moves(lattice, moves)
    return {
        "name": name,
        "moves": moves.tolist(),
        "lengths": lengths_of(lattice, moves).tolist(),
        "swept": [cells.tolist() for cells in swept],
    }


def trajectory_runs(trajectory: Trajectory | ArrayLike | None, resolution: float) -> list[list[int]]:
    """Return a trajectory as runs of whole millimetres: x and y of the first point, then of each step.

    A row that is not finite interrupts the line. Points a fraction of a cell apart are left out.

    Raises:
        ArgumentError: it is neither a trajectory nor positions (N, 2) or (N, 3).
    """
    if trajectory is None:
        return []
    given = trajectory.positions if isinstance(trajectory, Trajectory) else np.asarray(trajectory, dtype=np.float64)
    if given.ndim != 2 or given.shape[1] not in (2, 3):
        raise ArgumentError(f"a trajectory is positions (N, 2) or (N, 3), not {given.shape}")
    runs: list[list[int]] = []
    last: tuple[int, int] | None = None
    rows = given[:, :2].tolist()
    for k, (x, y) in enumerate(rows):
        if not (math.isfinite(x) and math.isfinite(y)):
            last = None
            continue
        point = round(x / _GRAIN), round(y / _GRAIN)
        if last is None:
            runs.append([])
        elif k + 1 < len(rows) and math.dist(last, point) * _GRAIN < _STEP * resolution:
            continue
        start = last or (0, 0)
        runs[-1] += [point[0] - start[0], point[1] - start[1]]
        last = point
    return runs
