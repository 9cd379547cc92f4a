"""The maps of an experiment: of the scans that are not looked for, on any lattice, whole or in part, or changed since.

A worker keeps the maps that it used last, since cases that need the same map follow each other.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.values import one_line
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.scan import Scan
from localisation.experiments.baselines.particle_filter import FilterSettings, LikelihoodField
from localisation.experiments.world import World
from localisation.localiser.lidar_localiser import map_surface_lattice
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.occupancy import Occupancy
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from localisation.matching.surfaces import SurfaceMap

__all__ = ["MapKind", "Prepared", "change_walls", "nearer_than", "prepare", "some_of"]

# Things move by the block of a metre: a cupboard, a row of desks; not cell by cell.
_BLOCK = 1.0
# By how much they are moved, metres.
_MOVED = (0.3, 1.0)
_KEPT = 3
# Of a map, as the map maker does by default where the whole of it is searched on the coarsest.
_LEVELS = {2: 1, 3: 3}


@dataclass(frozen=True)
class MapKind:
    """Which map.

    Attributes:
        grid: number of the lattice and size.
        turn: number of the angle at which the lattice lies.
        scans: share of the scans that are in it.
        farthest: metres beyond which points are left out.
        changed: share of the walls that have been taken away or moved since.
    """

    grid: int
    turn: int = 0
    scans: float = 1.0
    farthest: float = math.inf
    changed: float = 0.0


@dataclass(frozen=True, eq=False)
class Prepared:
    """A map, ready to be looked in.

    Attributes:
        lattice: its lattice.
        states: its occupied and free cells.
        searched: those of the level on which the whole map is searched: in space a coarser one.
        scan: (P, n) the first scan in it, for what a method wants to know of the sensor.
    """

    lattice: Lattice
    states: States
    searched: States
    scan: FloatArray

    __repr__ = one_line

    def matcher(self) -> GlobalMatcher:
        """Return a new matcher over the whole map.

        A case takes one of its own: how many nodes a search takes depends on how far the scans before it saw, for which
        the tables have grown, and what comes before a case depends on the number of workers.
        """
        pyramid = OccupancyPyramid(coincidence(self.searched.occupied))
        return GlobalMatcher(pyramid, self.searched.occupied.merge(self.searched.free))

    @cached_property
    def pyramid(self) -> OccupancyPyramid:
        """The weights of the map, for what looks around one pose only."""
        return OccupancyPyramid(coincidence(self.states.occupied))

    @cached_property
    def occupancy(self) -> Occupancy:
        """The occupied cells of the finest level."""
        return Occupancy.of_list(self.states.occupied)

    @cached_property
    def surfaces(self) -> SurfaceMap:
        """The surfaces of a map of space, as those who follow a sensor in a known map take them from its cells."""
        surfaces = SurfaceMap(map_surface_lattice(self.lattice, self.scan))
        surfaces.add(self.states.occupied.centres())
        return surfaces

    @cached_property
    def field(self) -> LikelihoodField:
        """The likelihood field of the particle filter."""
        return LikelihoodField(self.states, FilterSettings())


class _Kept:
    """The maps that this process used last, of one experiment."""

    points: FloatArray | None = None
    maps: ClassVar[OrderedDict[MapKind, Prepared]] = OrderedDict()


def prepare(kind: MapKind, shared: Mapping[str, Any]) -> Prepared:
    """Return a map of the held-in scans, made now or kept from before."""
    if _Kept.points is not shared["points"]:
        _Kept.points, _Kept.maps = shared["points"], OrderedDict()
    if kind in _Kept.maps:
        _Kept.maps.move_to_end(kind)
        return _Kept.maps[kind]
    world = World.of_shared(shared)
    lattice = Lattice(np.array(shared["bases"][kind.grid][kind.turn]))
    levels = _LEVELS[lattice.dim]
    builder = MapBuilder(lattice, levels, max_range=kind.farthest, spare_hits=lattice.dim == 3)
    numbers = some_of(world.map_scans(), kind.scans).tolist()
    for k in numbers:
        builder.fuse(Scan(0.0, world.scan(k)), world.pose(k))
    map = builder.build(finish=True)
    states = [map.state(level=level) for level in range(levels)]
    if kind.changed > 0.0:
        states = [change_walls(state, kind.changed, int(shared["seed"])) for state in states]
    made = Prepared(lattice, states[0], states[-1], world.scan(numbers[0]))
    _Kept.maps[kind] = made
    while len(_Kept.maps) > _KEPT:
        _Kept.maps.popitem(last=False)
    return made


def some_of(numbers: IntArray, share: float) -> IntArray:
    """Return a share of the numbers (K,), evenly spread, at least one."""
    count = max(1, round(share * len(numbers)))
    if count >= len(numbers):
        return numbers
    return np.asarray(numbers[(np.arange(count) * len(numbers)) // count])


def nearer_than(points: FloatArray, metres: float) -> FloatArray:
    """Return the points (P, n) that are at most so far from the sensor."""
    return np.asarray(points[np.sqrt((points**2).sum(axis=1)) <= metres])


def change_walls(states: States, share: float, seed: int) -> States:
    """Return the map after a share of its walls has changed: half of that is gone, half stands elsewhere.

    The plane is cut into squares, space into cubes, of a metre; what becomes of one, and where in the plane its walls
    go, follows from the seed and the square alone, so that the same things change on every lattice. What was under
    moved walls is free.
    """
    lattice = states.occupied.lattice
    centres = states.occupied.centres()
    block = np.floor(centres / _BLOCK).astype(np.int64)
    fate, far, where = (_drawn(block, seed, number) for number in range(3))
    gone, moved = fate < 0.5 * share, (fate >= 0.5 * share) & (fate < share)
    way = _MOVED[0] + (_MOVED[1] - _MOVED[0]) * far
    angle = 2.0 * math.pi * where
    shift = np.zeros_like(centres)
    shift[:, 0], shift[:, 1] = way * np.cos(angle), way * np.sin(angle)
    there = VoxelList.from_points(centres[moved] + shift[moved], lattice)
    occupied = states.occupied.select(~(gone | moved)).merge(there)
    left = states.occupied.select((gone | moved) & ~there.contains(states.occupied.index))
    free = states.free.select(~occupied.contains(states.free.index)).merge(left)
    return States(occupied, free)


def _drawn(block: IntArray, seed: int, number: int) -> FloatArray:
    """Return a number in [0, 1) for each square (M, 2) or cube (M, 3): SplitMix64 of its indices and the seed."""
    with np.errstate(over="ignore"):
        state: NDArray[np.uint64] = np.full(len(block), 4 * seed + number, np.uint64)
        for column in block.T:
            state = _mixed(state + column.astype(np.uint64))
    return np.asarray((state >> np.uint64(11)).astype(np.float64) * 2.0**-53)


def _mixed(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return the output function of SplitMix64 (Steele, Lea and Flood 2014) of each number."""
    z = z + np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
