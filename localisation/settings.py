"""All settings of a map, as plain numbers and texts that its file keeps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, TypeVar

from hexmap.base.errors import ArgumentError, HexmapError
from hexmap.io.logs.log import LogSettings
from hexmap.lattice.convert import LatticeLike, as_lattice, plain_lattice
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.state_rule import StateRule
from hexmap.poses.pose import Pose
from localisation.matching.search_region import SearchWindow


@dataclass(frozen=True)
class MappingSettings:
    """All settings of a map, as plain numbers and texts: what is stored in the map file.

    Attributes:
        lattice: a lattice, the name of one, or a basis (columns are generators, metres); kept as a name or as nested
            lists.
        resolution: side, metres, of the square of the same area as a cell; where a lattice or a basis is
            given, that of its cells.
        levels: levels of the map, each at twice the resolution of the one before.
        min_range: points nearer than this, metres, are left out.
        max_range: points farther than this, metres, are left out; None for no limit.
        clear_no_return: metres that a beam without return clears.
        mount: x, y (m) and heading (rad) of the laser on the robot; None: as the log says, else 0.
        search_metres: radius of the search around the prediction.
        search_radians: angle of the search to both sides of the prediction.
        search_level: the level to search on. Level 1 (0.1 m by default) is about as wide as the
            gap between neighbouring beams across a room, so that a wall seen once has no holes.
        use_odometry: whether odometry predicts the motion; if not, the last motion does.
        rule: what an occupied cell is.
        log: how the log is read.
    """

    lattice: LatticeLike = "A2"
    resolution: float = 0.05
    levels: int = 3
    min_range: float = 0.0
    max_range: float | None = None
    clear_no_return: float = 0.0
    mount: tuple[float, float, float] | None = None
    search_metres: float = 0.5
    search_radians: float = math.radians(20.0)
    search_level: int = 1
    use_odometry: bool = True
    rule: StateRule = field(default_factory=StateRule)
    log: LogSettings = field(default_factory=LogSettings)

    def __post_init__(self) -> None:
        """Check what the parts do not check themselves."""
        lattice, resolution = plain_lattice(self.lattice, self.resolution)
        object.__setattr__(self, "lattice", lattice)
        object.__setattr__(self, "resolution", resolution)
        if not 0 <= self.search_level < self.levels:
            raise ArgumentError(f"the search level must be 0 to {self.levels - 1}, not {self.search_level}")
        SearchWindow(self.search_metres, self.search_radians)
        if self.mount is not None:
            object.__setattr__(self, "mount", tuple(float(v) for v in self.mount))
            if len(self.mount) != 3 or not all(math.isfinite(v) for v in self.mount):
                raise ArgumentError(f"the mount of the laser takes x, y and a heading, not {self.mount}")
        if self.make_lattice().dim != 2:
            raise ArgumentError(
                f"a planar log cannot be mapped on {self.make_lattice().name}, a lattice of space; take Z2 or A2"
            )

    def make_lattice(self) -> Lattice:
        """Return the lattice of the finest level."""
        return as_lattice(self.lattice, self.resolution if isinstance(self.lattice, str) else None)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> MappingSettings:
        """Make settings of what :meth:`to_dict` returned; settings that are left out keep their defaults.

        Raises:
            ArgumentError: a setting is not known or has a wrong value.
        """
        for name, kinds in _KINDS.items():
            if name in value and (
                not isinstance(value[name], kinds) or isinstance(value[name], bool) != (kinds is bool)
            ):
                raise ArgumentError(f"the setting {name} has a wrong value: {value[name]!r}")
        return settings_of(cls, value, {"rule": StateRule, "log": LogSettings})


_KINDS: dict[str, Any] = {
    "lattice": (str, list),
    "resolution": (int, float),
    "levels": int,
    "min_range": (int, float),
    "max_range": (int, float, type(None)),
    "clear_no_return": (int, float),
    "mount": (list, tuple, type(None)),
    "search_metres": (int, float),
    "search_radians": (int, float),
    "search_level": int,
    "use_odometry": bool,
}


def limit_of(max_range: float | None) -> float:
    """Return the maximum range in metres, infinite where there is none."""
    return math.inf if max_range is None else max_range


def make_builder(settings: MappingSettings) -> MapBuilder:
    """Return the empty builder that the settings describe."""
    return MapBuilder(
        settings.make_lattice(),
        settings.levels,
        min_range=settings.min_range,
        max_range=limit_of(settings.max_range),
        clear_no_return=settings.clear_no_return,
    )


def make_mount(settings: MappingSettings, from_log: Pose | None) -> Pose:
    """Return T_robot_laser: as set, else as the log has it, else the identity."""
    if settings.mount is not None:
        return Pose.planar(*settings.mount)
    return from_log if from_log is not None else Pose.identity(2)


Settings = TypeVar("Settings")


def settings_of(
    kind: type[Settings], value: Mapping[str, Any], parts: Mapping[str, type], of: str = "a map"
) -> Settings:
    """Return settings of plain JSON values; those that are left out keep their defaults.

    Args:
        kind: a dataclass.
        value: its fields by name.
        parts: fields that are dataclasses of their own, and which.
        of: what they are settings of, for messages.

    Raises:
        ArgumentError: a setting is not known or has a wrong value.
    """
    known = {f.name for f in fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(value) - known)
    if unknown:
        raise ArgumentError(f"no setting of {of} is called {unknown[0]!r}; known are {', '.join(sorted(known))}")
    values = dict(value)
    for name in parts:
        if name in values and not isinstance(values[name], Mapping):
            raise ArgumentError(f"the setting {name} has a wrong value: {values[name]!r}")
    try:
        return kind(**{n: parts[n](**v) if n in parts else v for n, v in values.items()})
    except HexmapError:
        raise
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"not a configuration of {of}: {error}") from error
