"""What the planning benchmark is asked to do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from hexmap.base.errors import ArgumentError
from hexmap.lattice.convert import LatticeLike, as_lattice, plain_basis
from hexmap.lattice.lattice import Lattice


@dataclass(frozen=True)
class Grid:
    """A lattice with a neighbourhood, and the planners to run on it.

    Attributes:
        lattice: a lattice, the name of one, or a basis (columns are generators, in any unit); kept as a name or as
            nested tuples.
        moves: size of the neighbourhood.
        any_angle: whether any-angle paths are sought on it too.
        own: what to call a basis that has no name.
    """

    lattice: LatticeLike
    moves: int
    any_angle: bool = False
    own: str = "own"

    def __post_init__(self) -> None:
        """Keep the lattice as plain values, which can be compared and written."""
        object.__setattr__(self, "lattice", plain_basis(self.lattice))

    def make(self) -> Lattice:
        """Return the lattice, scaled to cells of size 1."""
        made = as_lattice(self.lattice)
        if not isinstance(self.lattice, str):
            made = Lattice(made.basis, self.own)
        return made.scaled(1.0 / made.resolution)

    @property
    def label(self) -> str:
        """Such as A2-6."""
        return f"{self.lattice if isinstance(self.lattice, str) else self.own}-{self.moves}"


GRIDS = {
    2: (Grid("Z2", 4), Grid("Z2", 8, True), Grid("A2", 6, True), Grid("A2", 12)),
    3: (
        Grid("Z3", 6),
        Grid("Z3", 26, True),
        Grid("D3", 12),
        Grid("D3", 18, True),
        Grid("D3*", 8),
        Grid("D3*", 14, True),
    ),
}


@dataclass(frozen=True)
class BenchmarkSettings:
    """What the benchmark does.

    Attributes:
        queries: per map; drawn from its problems, or all of them if it has fewer.
        angles: degrees by which the maps are turned.
        fractions: 2 for grids whose resolution is a half of the source cell's edge, and so on.
        max_cells: of a window; what would be larger is left out, and said.
        seed: chooses queries and resamples.
        planners: on every grid; ``any_angle`` is added where a grid asks for it.
        planar: the grids in the plane.
        spatial: the grids in space.
    """

    queries: int = 200
    angles: tuple[float, ...] = (0.0, 17.0, 31.0)
    fractions: tuple[int, ...] = (2, 4)
    max_cells: int = 300_000_000
    seed: int = 0
    planners: tuple[str, ...] = ("astar", "canonical")
    planar: tuple[Grid, ...] = GRIDS[2]
    spatial: tuple[Grid, ...] = GRIDS[3]

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.queries < LEAST_QUERIES:
            raise ArgumentError(f"an interval needs at least {LEAST_QUERIES} queries per map, not {self.queries}")
        if not self.angles or not all(math.isfinite(a) for a in self.angles):
            raise ArgumentError(f"angles must be numbers of degrees, not {self.angles}")
        if len(set(self.angles)) < len(self.angles):
            raise ArgumentError(f"an angle is given twice: {self.angles}")
        if not self.fractions or any(isinstance(f, bool) or f < 2 for f in self.fractions):
            raise ArgumentError(
                f"cells must measure a half of the source cell's edge or less, not 1/{min(self.fractions, default=0)}"
            )
        if len(set(self.fractions)) < len(self.fractions):
            raise ArgumentError(f"a fraction is given twice: {self.fractions}")
        for grids in (self.planar, self.spatial):
            if len({grid.label for grid in grids}) < len(grids):
                raise ArgumentError(f"a grid is given twice: {', '.join(grid.label for grid in grids)}")
        if self.seed < 0:
            raise ArgumentError(f"the seed must be 0 or larger, not {self.seed}")
        if self.max_cells < 1:
            raise ArgumentError(f"a window needs room for a cell, not for {self.max_cells}")

    def with_own(self, lattices: Sequence[LatticeLike]) -> BenchmarkSettings:
        """Return the settings with grids on further lattices: of each its usual neighbourhood, and the next larger one.

        Any-angle paths are sought on the usual one. What has no name is called own, or own1, own2, ... of several.

        Raises:
            ArgumentError: the cells of one are so flat that no neighbourhood holds all neighbours across faces.
            LatticeError: one is no lattice.
        """
        settings = self
        for k, given in enumerate(lattices, 1):
            lattice = as_lattice(given)
            name = f"own{k}" if len(lattices) > 1 else "own"
            sizes = _connecting_sizes(lattice)[:2]
            if not sizes:
                raise ArgumentError(f"no neighbourhood of {lattice!r} connects its cells; they are too flat")
            grids = [Grid(given, size, i == 0, name) for i, size in enumerate(sizes)]
            if lattice.dim == 2:
                settings = replace(settings, planar=(*settings.planar, *grids))
            else:
                settings = replace(settings, spatial=(*settings.spatial, *grids))
        return settings

    def grids(self, dim: int) -> tuple[Grid, ...]:
        """Return the grids of a dimension."""
        return self.planar if dim == 2 else self.spatial


def _connecting_sizes(lattice: Lattice) -> list[int]:
    """Return the sizes of the neighbourhoods that hold all usual neighbours, so that no graph falls apart."""
    usual = {tuple(v) for v in lattice.neighbours.tolist()}
    return [size for size in lattice.shell_sizes if usual <= {tuple(v) for v in lattice.shell(size).tolist()}]


LEAST_QUERIES = 8  # an interval over fewer says nothing


MOST_DROPPED = 0.02  # of the queries; more says that the grids are too coarse for the map


def settings_table(settings: BenchmarkSettings) -> dict[str, Any]:
    """Return the settings as plain values."""
    plain = asdict(settings)
    for key in ("planar", "spatial"):
        plain[key] = [grid.label for grid in getattr(settings, key)]
    return plain
