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
from hexmap.base.values import one_line
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

__all__ = [
    "PageLevel",
    "PageMap",
    "candidates",
    "heights_of",
    "lattice_numbers",
    "level_numbers",
    "on_lattice",
    "page_map",
    "trajectory_runs",
]

_STEP = 0.25  # of a cell, which a trajectory must have moved for another point
_MOST_HEIGHTS = 1000  # steps of a slider
_GRAIN = 1e-3  # metres, of a trajectory's points


@dataclass(frozen=True, eq=False)
class PageLevel:
    """Cells of one resolution, those that are known only.

    Attributes:
        lattice: of the plane or of space.
        origin: (n,) metres, where the cell 0 has its centre.
        index: (M, n) int32, lexicographically.
        hits, passes: (M,) int64 counts; None in a map that knows states only.
        states: (M,) uint8 states; None where they follow from the counts.
    """

    lattice: Lattice
    origin: tuple[float, ...]
    index: NDArray[np.int32]
    hits: NDArray[np.int64] | None = None
    passes: NDArray[np.int64] | None = None
    states: NDArray[np.uint8] | None = None

    __repr__ = one_line

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
    """Return a map for a page: one of hexmap with its counts, one of others on its own squares or cubes.

    Raises:
        ArgumentError: no cell of it is known.
    """
    dim = source.lattice.dim if isinstance(source, Map) else source.dim
    if isinstance(source, GridMap):
        levels = [_level_of_grid(source)]
    else:
        columns = [(level.lattice, *level.columns()) for level in source.levels]
        levels = [PageLevel(on, (0.0,) * dim, unpack(keys, dim), hits, passes) for on, keys, hits, passes in columns]
    levels = [level for level in levels if len(level.index)]
    if not levels:
        raise ArgumentError("no cell of the map is free or occupied, which leaves nothing to show")
    y_down = isinstance(source, GridMap) and source.y_down
    return PageMap(levels[0].lattice.title, tuple(levels), rule or StateRule(), y_down)


def _level_of_grid(grid: GridMap) -> PageLevel:
    """Return the known squares or cubes of a map of others."""
    n = grid.dim
    first, *ends = grid.centre(np.vstack([np.zeros((1, n), np.int64), np.eye(n, dtype=np.int64)]))
    # The name decides nothing; the squares of a turned map are another lattice than those along the axes.
    own = Lattice(np.array([end - first for end in ends]).T, "own squares" if n == 2 else "own cubes")
    index = np.argwhere(grid.states != CellState.UNKNOWN.value).astype(np.int32)
    states = grid.states[tuple(index.T)].astype(np.uint8)
    return PageLevel(own, tuple(first.tolist()), index, states=states)


def on_lattice(source: Map | GridMap, world: PageMap, lattice: str | Lattice) -> PageMap:
    """Return the same world on another lattice, at the resolution of each level.

    A cell of it is what a map of hexmap has at its centre; where centres of occupied cells fall into it, it is the one
    of these with the most hits, so that walls of one cell keep together. A map of others is put on the lattice as
    :meth:`~hexmap.io.grids.GridMap.to_states` does it, so that walls of one square have no gaps.

    Args:
        source: the map.
        world: what :func:`page_map` returned of it.
        lattice: a name, taken at each level's resolution, or the lattice of the finest level, which the others double.

    Raises:
        LatticeError: there is no lattice of that name.
        ArgumentError: it is of another dimension, or none of its cells is known.
    """
    levels = []
    for k, level in enumerate(world.levels):
        on = Lattice.named(lattice, level.lattice.resolution) if isinstance(lattice, str) else lattice.scaled(2.0**k)
        if on.dim != level.lattice.dim:
            raise ArgumentError(f"the map is of dimension {level.lattice.dim}, the lattice {on.name} of {on.dim}")
        levels.append(_rasterised(source, on) if isinstance(source, GridMap) else _resampled(level, on, world.rule))
        if len(levels[-1].index) == 0:
            raise ArgumentError(f"no known cell of the map holds the centre of a cell of {on!r}")
    return PageMap(levels[0].lattice.title, tuple(levels), world.rule, world.y_down)


def _rasterised(grid: GridMap, on: Lattice) -> PageLevel:
    """Return the known cells of a map of others on a lattice."""
    states = grid.to_states(on)
    keys = np.concatenate([states.occupied.keys, states.free.keys])
    values = np.repeat([CellState.OCCUPIED.value, CellState.FREE.value], [len(states.occupied), len(states.free)])
    order = np.argsort(keys)
    return PageLevel(on, (0.0,) * on.dim, unpack(keys[order], on.dim), states=values[order].astype(np.uint8))


def _resampled(level: PageLevel, on: Lattice, rule: StateRule) -> PageLevel:
    """Return the cells of a lattice whose centre lies in a known cell, with that cell's counts or state.

    Where centres of occupied cells fall into a cell, it has the counts of the one of these with the most hits.
    """
    own, origin = level.lattice, np.array(level.origin)
    reach = own.covering_radius + on.covering_radius
    most = np.floor(np.linalg.norm(np.linalg.inv(on.basis), axis=1) * reach).astype(np.int64)
    around = IndexBox.of_corners(-most, most).cells()
    around = around[np.linalg.norm(on.centres(around), axis=1) <= reach * (1.0 + 1e-9)]
    near = on.quantise(own.centres(level.index) + origin)
    keys = np.unique(pack(near))
    for offset in around:
        keys = np.union1d(keys, np.unique(pack(near + offset.astype(np.int32))))
    index = unpack(keys, on.dim)
    at = pack(own.quantise(on.centres(index) - origin))
    known = pack(level.index)
    position = np.minimum(np.searchsorted(known, at), len(known) - 1)
    found = known[position] == at
    # Walls that the centres miss: the last of a cell's claimants has the most hits, and the first of these comes last.
    occupied = np.flatnonzero(level.states_by(rule) == CellState.OCCUPIED.value)[::-1]
    if level.hits is not None:
        occupied = occupied[np.argsort(level.hits[occupied], kind="stable")]
    claimed = np.searchsorted(keys, pack(near[occupied]))
    position[claimed], found[claimed] = occupied, True
    taken = position[found]
    hits, passes, states = (None if v is None else v[taken] for v in (level.hits, level.passes, level.states))
    return PageLevel(on, (0.0,) * on.dim, index[found], hits, passes, states)


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
        "low": level.index.min(axis=0).tolist(),
        "high": level.index.max(axis=0).tolist(),
        "side": tiles.side,
        "tiles": tiles.corners.ravel().tolist(),
        "planes": planes,
        "known": len(level.index),
        "occupied": int(np.count_nonzero(states == CellState.OCCUPIED.value)),
        "free": int(np.count_nonzero(states == CellState.FREE.value)),
    }
    return numbers, compress(data, level.states is None)


def lattice_numbers(lattice: Lattice) -> dict[str, Any]:
    """Return what a page draws and, in the plane, plans with of a lattice."""
    numbers = {
        "title": lattice.title,
        "basis": lattice.basis.tolist(),
        "resolution": lattice.resolution,
        "candidates": candidates(lattice).tolist(),
        "drawn": candidates(lattice, touching=False).tolist(),
        "faces": lattice.faces.tolist(),
    }
    if lattice.dim == 2:
        numbers |= {
            "inradius": lattice.inradius,
            "covering": lattice.covering_radius,
            "vertices": lattice.cell.vertices.tolist(),
            "neighbourhoods": [neighbourhood_numbers(lattice, name) for name in _neighbourhoods(lattice)],
        }
    return numbers


def candidates(lattice: Lattice, touching: bool = True) -> NDArray[np.int64]:
    """Return the offsets (K, n), lexicographically, whose closed cell meets the unit parallelepiped of the basis.

    The nearest lattice point to a point x is floor(B^-1 x) plus one of them, whether the basis is reduced or not.
    Without those that are only ``touching`` it the nearest is still among them, but not every one of several.
    """
    cell, n = lattice.cell, lattice.dim
    # All in index coordinates, where the parallelepiped is the unit cube. A cell reaches as far as its corners do.
    to_index = np.linalg.inv(lattice.basis).T
    corners = cell.vertices @ to_index
    low, high = corners.min(axis=0), corners.max(axis=0)
    box = IndexBox.of_corners(np.floor(-high - 1e-9).astype(np.int64), np.ceil(1.0 - low + 1e-9).astype(np.int64))
    # Convex bodies are apart where a face of one of them separates them or, in space, a plane along an edge of each
    # (the separating axis theorem).
    axes = [cell.normals @ lattice.basis, np.eye(n)]
    if n == 3:
        edges = np.concatenate([corners[ring] - np.roll(corners[ring], 1, axis=0) for ring in cell.rings])
        axes.append(np.cross(edges[:, None], np.eye(n)).reshape(-1, n))
    across = np.concatenate(axes)
    lengths = np.linalg.norm(across, axis=1)
    across = (across[lengths > 1e-9] / lengths[lengths > 1e-9, None]).T
    cube = np.array(list(np.ndindex(*(2,) * n)), dtype=np.float64) @ across
    mine = corners @ across
    offsets = box.cells()
    at = offsets @ across
    gaps = np.maximum(mine.min(axis=0) + at - cube.max(axis=0), cube.min(axis=0) - mine.max(axis=0) - at).max(axis=1)
    return offsets[gaps <= (1e-9 if touching else -1e-9)]


def heights_of(level: PageLevel) -> list[float]:
    """Return the heights, metres, at which a map in space may be cut: those of its cells' centres."""
    z = level.lattice.centres(level.index)[:, 2] + level.origin[2]
    grain = 1e-6 * level.lattice.resolution
    found = np.unique(np.rint(z / grain)) * grain
    if len(found) > _MOST_HEIGHTS:  # of a basis whose cells all lie at heights of their own
        found = np.linspace(found[0], found[-1], _MOST_HEIGHTS)
    return [float(v) for v in np.round(found, 9)]


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
