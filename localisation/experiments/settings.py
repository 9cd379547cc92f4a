"""What the localisation experiment is asked to do."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

from hexmap.base.errors import ArgumentError
from hexmap.lattice.convert import LatticeLike, as_lattice, plain_basis
from hexmap.lattice.lattice import Lattice
from localisation.experiments.geometry import geometry_of

__all__ = [
    "LEARNING_AXES", "SPACE_TASKS", "TASKS", "THRESHOLDS", "ExperimentSettings", "Grid", "in_space_settings", "quick",
]  # fmt: skip

THRESHOLDS = ((0.1, 1.0), (0.25, 2.0), (1.0, 5.0))
"""Metres and degrees within which a pose counts as right."""

TASKS = ("global", "local", "localise", "mapping", "rotation", "learning")
SPACE_TASKS = tuple(task for task in TASKS if task != "mapping")
"""What is compared in space."""
LEARNING_AXES = ("scans", "beams", "range", "changed")
# An interval over fewer scans says nothing.
LEAST_SCANS = 8
_OWN = "own"
# Degrees between mapping runs: multiples of it lie well apart on squares, alike after 90 degrees, and on hexagons.
_RUN_STEP = 17.0
# Points of a scan with which something can be found.
_LEAST_POINTS = 1000
_IN_SPACE: dict[str, Any] = {
    "lattices": ("Z3", "D3", "D3*"), "resolutions": (0.1, 0.2), "tasks": SPACE_TASKS, "scans": 24, "starts": 6,
    "length": 4, "learning_scans": 12, "ranges": (20.0, 10.0, 5.0), "turns": (0.0, 17.0), "rotations": 18,
    "points": 20_000,
}  # fmt: skip


@dataclass(frozen=True)
class Grid:
    """A lattice at a size.

    Attributes:
        number: its place in the list of the experiment's grids.
        lattice: the lattice.
        name: of the lattice.
        resolution: what was asked for, metres: that of the first lattice at equal cells.
        equal: to the first lattice in this: "cell" (area or volume) or "radius" (of covering).
    """

    number: int
    lattice: Lattice
    name: str
    resolution: float
    equal: str

    @property
    def label(self) -> str:
        """Such as A2, or A2 (radius) at equal covering radius."""
        return self.name if self.equal == "cell" else f"{self.name} (radius)"


@dataclass(frozen=True)
class ExperimentSettings:
    """All settings; plain numbers and texts, which the report prints. The defaults are those of a planar log.

    Attributes:
        lattices: lattices, names, or bases (columns are generators, in any unit), kept as names and nested tuples; the
            others are compared with the first.
        resolutions: metres; in space those of the maps' finest level.
        split: "every" holds out every ``hold_out``-th scan, "half" the second half of the log.
        hold_out: see there; where whole stretches are held out, robots without a start see one scan in so many of them.
        tasks: which of :data:`TASKS` to do.
        scans: that are looked for in each task.
        starts: instants at which a robot without a start pose wakes up.
        length: held-out scans that it then sees at the most.
        learning_scans: that are looked for at each point of a learning curve.
        perturbations: metres and degrees of the starts of local matching.
        window: metres and degrees of its search, to all sides.
        node_limit: nodes after which a search of a whole map stops, uncertified.
        shares: of the scans in the map and of the beams kept, for learning curves; 1 is added.
        ranges: metres beyond which points are left out, for learning curves; no limit is added.
        changes: shares of the map that change, for learning curves; 0 is added.
        turns: degrees by which the lattices are turned about z against the map's frame. Walls along the axes of a
            lattice are a case of their own, and frames often lie along walls: every scan is looked for at one of these
            turns, the same on every lattice, one after the other.
        runs: whole mapping runs a grid, with the lattice at an angle of its own for each, :attr:`all_turns`.
        rotations: of map and scan together, for the variability of the score.
        max_range: metres beyond which points are left out everywhere; None: none.
        points: of each scan at the most, drawn at random, for maps and searches alike; None: all. For LiDARs only.
        seed: of everything that is drawn.
    """

    lattices: tuple[LatticeLike, ...] = ("Z2", "A2")
    resolutions: tuple[float, ...] = (0.05, 0.1, 0.2)
    split: str = "every"
    hold_out: int = 4
    tasks: tuple[str, ...] = TASKS
    scans: int = 40
    starts: int = 12
    length: int = 20
    learning_scans: int = 16
    perturbations: tuple[tuple[float, float], ...] = ((0.1, 2.0), (0.3, 8.0), (0.5, 15.0), (1.0, 30.0))
    window: tuple[float, float] = (0.5, 20.0)
    node_limit: int = 1_000_000
    shares: tuple[float, ...] = (0.5, 0.25, 0.1)
    ranges: tuple[float, ...] = (8.0, 4.0, 2.0)
    changes: tuple[float, ...] = (0.1, 0.25, 0.5)
    turns: tuple[float, ...] = (0.0, 17.0, 31.0)
    runs: int = 6
    rotations: int = 36
    max_range: float | None = None
    points: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ArgumentError: one is out of its range, or lattices are of the plane and of space.
            LatticeError: a lattice is not known.
        """
        object.__setattr__(self, "lattices", tuple(plain_basis(lattice) for lattice in self.lattices))
        if len(self.lattices) < 2:
            raise ArgumentError("the experiment compares at least two lattices; give --lattices Z2,A2")
        if not self.resolutions or not all(0.0 < r < math.inf for r in self.resolutions):
            raise ArgumentError(f"resolutions must be positive numbers of metres, not {self.resolutions}")
        if len(set(self.resolutions)) < len(self.resolutions):
            raise ArgumentError(f"a resolution is given twice: {self.resolutions}")
        unknown = [task for task in self.tasks if task not in TASKS]
        if unknown or not self.tasks:
            raise ArgumentError(f"tasks are {', '.join(TASKS)}, not {(unknown or [''])[0]!r}")
        if self.split not in ("every", "half"):
            raise ArgumentError(f"a log is split by 'every' or 'half', not {self.split!r}")
        if self.hold_out < 2:
            raise ArgumentError(f"every second scan at the most can be held out, not every {self.hold_out}")
        for name, least in (("scans", LEAST_SCANS), ("learning_scans", 2), ("starts", 2), ("length", 3),
                            ("node_limit", 1), ("rotations", 4), ("runs", 1)):  # fmt: skip
            if getattr(self, name) < least:
                raise ArgumentError(f"the setting {name} is at least {least}, not {getattr(self, name)}")
        for name in ("shares", "changes"):
            if not all(0.0 < v < 1.0 for v in getattr(self, name)):
                raise ArgumentError(f"the setting {name} takes shares between 0 and 1, not {getattr(self, name)}")
        if not all(r > 0.0 for r in (*self.ranges, self.max_range or 1.0)):
            raise ArgumentError(f"ranges must be positive numbers of metres, not {self.ranges} and {self.max_range}")
        if not self.turns or not all(math.isfinite(t) for t in self.turns):
            raise ArgumentError(f"turns must be numbers of degrees, not {self.turns}")
        if self.points is not None and self.points < _LEAST_POINTS:
            raise ArgumentError(f"the setting points is at least {_LEAST_POINTS}, not {self.points}")
        if self.seed < 0:
            raise ArgumentError(f"the seed must be 0 or larger, not {self.seed}")
        names = [grid.label for grid in self.grids() if grid.resolution == self.resolutions[0]]
        if len(set(names)) < len(names):
            raise ArgumentError(f"a lattice is given twice: {', '.join(names)}")

    @property
    def dim(self) -> int:
        """2 for lattices of the plane, 3 for those of space."""
        return _unit(self.lattices[0]).dim

    def check_dim(self, dim: int) -> None:
        """Check that the lattices are those of a log.

        Raises:
            ArgumentError: they are of another dimension than ``dim``, or a task is.
        """
        if self.dim != dim:
            name, where = self.grids()[0].name, {2: "the plane", 3: "space"}[self.dim]
            log, take = {2: ("a planar log", "Z2 or A2"), 3: ("a LiDAR's log", "Z3, D3 or D3*")}[dim]
            raise ArgumentError(f"{log} cannot be mapped on {name}, a lattice of {where}; take {take}")
        if dim == 3 and "mapping" in self.tasks:
            raise ArgumentError(f"the task mapping is one of the plane; in space there are {', '.join(SPACE_TASKS)}")

    def grids(self) -> list[Grid]:
        """Return every lattice at every size: the first as asked for, the others at equal cell and covering radius.

        Raises:
            ArgumentError: lattices of the plane and of space.
            LatticeError: a lattice is not known.
        """
        unit = [(_name(v, k), _unit(v)) for k, v in enumerate(self.lattices)]
        first, dim = unit[0][0], unit[0][1].dim
        for name, lattice in unit:
            if lattice.dim != dim:
                plane, space = (first, name) if dim == 2 else (name, first)
                raise ArgumentError(
                    f"{plane}, a lattice of the plane, cannot be compared with {space}, a lattice of space"
                )
        out: list[Grid] = []
        for r in self.resolutions:
            base = unit[0][1].scaled(r)
            for k, (name, lattice) in enumerate(unit):
                same_cell = lattice.scaled(r)
                out.append(Grid(len(out), same_cell, name, r, "cell"))
                if k:
                    factor = base.covering_radius / same_cell.covering_radius
                    out.append(Grid(len(out), same_cell.scaled(factor), name, r, "radius"))
        return out

    @property
    def all_turns(self) -> tuple[float, ...]:
        """Degrees of the lattices: :attr:`turns`, and then those of the mapping runs."""
        return (*self.turns, *(_RUN_STEP * k for k in range(self.runs)))

    def bases(self) -> list[list[list[list[float]]]]:
        """Return the basis of every grid at every turn."""
        turned = [geometry_of(self.dim).about_z(math.radians(t)).rotation for t in self.all_turns]
        return [[(R @ grid.lattice.basis).tolist() for R in turned] for grid in self.grids()]

    @property
    def learning_resolution(self) -> float:
        """The resolution of the learning curves: the middle one."""
        return sorted(self.resolutions)[len(self.resolutions) // 2]

    def table(self) -> dict[str, Any]:
        """Return the settings as plain values, for the report."""
        return {**asdict(self), "lattices": [_name(v, k) for k, v in enumerate(self.lattices)]}


def in_space_settings(**values: Any) -> ExperimentSettings:
    """Return the settings of a LiDAR's log: the defaults of space, and the values that are given.

    A LiDAR sees some hundred times as many points as a planar laser and far more of a building at once: fewer scans are
    looked for, with a part of the points, and a sensor that wakes up sees fewer scans before it must know.
    """
    return ExperimentSettings(**{**_IN_SPACE, **values})


def quick(settings: ExperimentSettings) -> ExperimentSettings:
    """Return the settings with smaller numbers of everything: for a first look, with wide intervals.

    Of several resolutions the finest, which costs the most, is left out, and of several tasks mapping: so few runs of
    it as there is time for decide nothing.
    """
    tasks = tuple(task for task in settings.tasks if task != "mapping") or settings.tasks
    coarser = tuple(r for r in settings.resolutions if r > min(settings.resolutions))
    return replace(
        settings, tasks=tasks, resolutions=coarser or settings.resolutions, scans=10, starts=4,
        length=min(8, settings.length), learning_scans=6, shares=settings.shares[1:2],
        ranges=settings.ranges[1:2], changes=settings.changes[1:2], runs=4, rotations=12, node_limit=100_000,
    )  # fmt: skip


def _unit(lattice: LatticeLike) -> Lattice:
    made = as_lattice(lattice) if isinstance(lattice, str) else Lattice(as_lattice(lattice).basis, _OWN)
    return made.scaled(1.0 / made.resolution)


def _name(lattice: LatticeLike, number: int) -> str:
    return _unit(lattice).name if isinstance(lattice, str) else f"{_OWN} {number}"
