"""All settings of a map that is made of a LiDAR's scans, as plain numbers and texts that its file keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.io.lidar.lidar_log import LidarLogSettings
from hexmap.lattice.convert import LatticeLike, as_lattice, plain_lattice
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.state_rule import StateRule
from localisation.settings import limit_of, settings_of

__all__ = ["LidarSettings"]


@dataclass(frozen=True)
class LidarSettings:
    """All settings of a map in space.

    Attributes:
        lattice: a lattice, the name of one, or a basis (columns are generators, metres); kept as a name or as nested
            lists.
        resolution: side, metres, of the cube of the same volume as a cell; where a lattice or a basis is
            given, that of its cells.
        levels: levels of the map, each at twice the resolution of the one before.
        min_range: points nearer than this, metres, are left out: whoever carries the sensor.
        max_range: points farther than this, metres, are left out; None for no limit.
        free_space: whether the cells that beams went through are counted.
        level_floor: whether the map is turned so that floors are level; the sensor need not begin upright.
        rule: what an occupied cell is.
        log: how the log is read.
    """

    lattice: LatticeLike = "D3"
    resolution: float = 0.1
    levels: int = 3
    min_range: float = 0.5
    max_range: float | None = 100.0
    free_space: bool = True
    level_floor: bool = True
    rule: StateRule = field(default_factory=StateRule)
    log: LidarLogSettings = field(default_factory=LidarLogSettings)

    def __post_init__(self) -> None:
        """Check what the parts do not check themselves.

        Raises:
            ArgumentError: a lattice of the plane, or a number out of its range.
        """
        lattice, resolution = plain_lattice(self.lattice, self.resolution)
        object.__setattr__(self, "lattice", lattice)
        object.__setattr__(self, "resolution", resolution)
        if self.make_lattice().dim != 3:
            raise ArgumentError(
                f"a LiDAR's log cannot be mapped on {self.make_lattice().name}, a lattice of the plane; take D3"
            )
        self.make_builder()

    def make_lattice(self) -> Lattice:
        """Return the lattice of the finest level."""
        return as_lattice(self.lattice, self.resolution if isinstance(self.lattice, str) else None)

    def in_range(self, points: FloatArray) -> FloatArray:
        """Return the points (N, 3) of the sensor's frame in the range that is mapped."""
        squared = (points**2).sum(axis=1)
        return points[(squared >= self.min_range**2) & (squared <= limit_of(self.max_range) ** 2)]

    def make_builder(self) -> MapBuilder:
        """Return the empty builder that the settings describe."""
        limit = limit_of(self.max_range)
        return MapBuilder(
            self.make_lattice(), self.levels, min_range=self.min_range, max_range=limit, spare_hits=True
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> LidarSettings:
        """Make settings of what :meth:`to_dict` returned; settings that are left out keep their defaults.

        Raises:
            ArgumentError: a setting is not known or has a wrong value.
        """
        return settings_of(cls, value, {"rule": StateRule, "log": LidarLogSettings}, "a map in space")
