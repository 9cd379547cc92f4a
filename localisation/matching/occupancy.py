"""What a matcher asks of a map: which cells are occupied."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import IntArray
from hexmap.lattice.lattice import Lattice
from hexmap.maps.counter import HITS, PASSES, CellCounter
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList


class Occupancy(Protocol):
    """What the matcher asks of a map: which cells of a box are occupied."""

    @property
    def lattice(self) -> Lattice:
        """The lattice of the cells."""
        ...

    def occupied(self, low: IntArray, shape: IntArray) -> NDArray[np.bool_]:
        """Return whether each cell is occupied in the box of ``shape`` (n,) cells from the index ``low`` (n,) on."""
        ...


@dataclass(frozen=True, eq=False)
class CounterOccupancy:
    """The occupied cells of a map that is being built, by the rule that finished maps use."""

    counter: CellCounter
    rule: StateRule = field(default_factory=StateRule)

    @property
    def lattice(self) -> Lattice:
        """The lattice of the cells."""
        return self.counter.lattice

    def occupied(self, low: IntArray, shape: IntArray) -> NDArray[np.bool_]:
        """Return whether each cell of the box is occupied."""
        return self.rule.occupied(self.counter.window(low, shape, HITS), self.counter.window(low, shape, PASSES))


@dataclass(frozen=True, eq=False)
class ListOccupancy:
    """The cells of a list."""

    cells: VoxelList

    @classmethod
    def of_map(cls, world: Map, rule: StateRule | None = None, level: int = 0) -> ListOccupancy:
        """Return the occupied cells of a finished map."""
        return cls(world.state(rule, level).occupied)

    @property
    def lattice(self) -> Lattice:
        """The lattice of the cells."""
        return self.cells.lattice

    @cached_property
    def _by_first(self) -> IntArray:
        return self.cells.index[:, 0].astype(np.int64)

    def occupied(self, low: IntArray, shape: IntArray) -> NDArray[np.bool_]:
        """Return whether each cell of the box is in the list."""
        out = np.zeros(tuple(int(s) for s in shape), dtype=bool)
        # The list is sorted by its first index: only the rows of the box are looked at.
        begin, end = np.searchsorted(self._by_first, [low[0], low[0] + shape[0]])
        at = self.cells.index[begin:end].astype(np.int64) - low
        at = at[((at >= 0) & (at < shape)).all(axis=1)]
        out[tuple(at.T)] = True
        return out
