"""What the rotation experiment is to do."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hexmap.base.errors import ArgumentError
from hexmap.lattice.convert import LatticeLike, as_lattice, plain_basis
from hexmap.lattice.lattice import Lattice

__all__ = ["RotationSettings"]


@dataclass(frozen=True)
class RotationSettings:
    """What the experiment does, as plain numbers and texts.

    Attributes:
        resolution: side, metres, of the square or cube as large as a cell.
        axis: "x", "y" or "z" (in the plane always z).
        start, stop, step: degrees; ``stop`` is left out, as 180 is 0 again for the cubic lattice.
        random: how many uniformly random rigid transforms.
        lattices: names, lattices or bases, all scaled; the square or cubic one is put first. None: all named ones of
            the points' dimension. What has no name is kept among ``own``.
        own: bases of further lattices, columns are generators in any unit: they are scaled.
        seed: of the random transforms and of the bootstrap.
    """

    resolution: float
    axis: str = "z"
    start: float = 0.0
    stop: float = 180.0
    step: float = 5.0
    random: int = 200
    lattices: tuple[LatticeLike, ...] | None = None
    own: tuple[list[list[float]], ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers."""
        if self.lattices is not None:
            given = [plain_basis(lattice) for lattice in self.lattices]
            own = tuple([list(row) for row in basis] for basis in given if not isinstance(basis, str))
            object.__setattr__(self, "lattices", tuple(name for name in given if isinstance(name, str)))
            object.__setattr__(self, "own", (*self.own, *own))
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise ArgumentError(f"a resolution must be a positive number of metres, not {self.resolution}")
        if self.axis not in ("x", "y", "z"):
            raise ArgumentError(f"the axis must be x, y or z, not {self.axis!r}")
        if not (self.step > 0 and self.stop > self.start and math.isfinite(self.stop - self.start)):
            raise ArgumentError(f"angles from {self.start} to {self.stop} by {self.step} degrees make no curve")
        if self.random < 8 or len(self.degrees) < 8:
            raise ArgumentError("an interval needs 8 angles and 8 random transforms at the least")

    @property
    def degrees(self) -> list[float]:
        """The angles about the axis, degrees."""
        count = math.ceil((self.stop - self.start) / self.step - 1e-9)
        return [self.start + k * self.step for k in range(count)]

    def make_lattices(self, dim: int) -> list[Lattice]:
        """Return the lattices, the square or cubic one first, all at the resolution.

        Raises:
            LatticeError: a name is not known.
            ArgumentError: a lattice is of another dimension than the points.
        """
        base = "Z2" if dim == 2 else "Z3"
        usual = ("Z2", "A2") if dim == 2 else ("Z3", "D3", "D3*", "A2xZ")
        names = usual if self.lattices is None else self.lattices
        made = [as_lattice(given, self.resolution) for given in names]
        twice = next((v.name for k, v in enumerate(made) if v in made[:k]), None)
        if twice is not None:
            raise ArgumentError(f"the lattice {twice} is named twice")
        made = [Lattice.named(base, self.resolution), *(v for v in made if v.name != base)]
        for k, basis in enumerate(self.own):
            own = Lattice(np.array(basis), "own" if len(self.own) == 1 else f"own {k + 1}")
            made.append(own.scaled(self.resolution / own.resolution))
        for lattice in made:
            if lattice.dim != dim:
                raise ArgumentError(f"{lattice.name} is a lattice of dimension {lattice.dim}, the points of {dim}")
        return made
