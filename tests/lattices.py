"""The lattices under test, one list for all test modules.

Every lattice of :data:`hexmap.lattice.NAMES` is here (the hexagonal prism included), and some that
hexmap has never heard of: one skewed basis of the plane and one of space with nothing special
about them, and the square and cubic lattices given by sheared bases, in which degenerate cells
(four cells at a corner in the plane) meet a basis that does not show it.

Each case brings its own Gram matrix in exact integers, written down here and not computed by the
library, where the lattice has one; the slow reference decides with that.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from hexmap.lattice.lattice import Lattice

JIT = os.environ.get("NUMBA_DISABLE_JIT", "0") in ("", "0")
# Set by ``pytest --long`` (tests/conftest.py): more of everything, the same assertions.
LONG = os.environ.get("HEXMAP_LONG", "0") not in ("", "0")
# Random points a lattice. Without the compiler the same kernels run a thousand times slower.
BULK = 100_000 if JIT else 1_000
# How much of a slow test is worth doing: multiply a count by this.
PART = (4.0 if LONG else 1.0) if JIT else (0.2 if LONG else 0.1)
# Examples a property test tries.
EXAMPLES = (300 if LONG else 50) if JIT else (20 if LONG else 10)

# Gram matrices of the documented bases (A2 axial, D3 (1,0,1) (0,1,1) (0,0,2), D3* (-1,1,1) ...), in
# units in which they are integers; a resolution only scales them.
GRAMS: dict[str, list[list[int]]] = {
    "Z2": [[1, 0], [0, 1]],
    "A2": [[2, 1], [1, 2]],
    "Z3": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "D3": [[2, 1, 2], [1, 2, 2], [2, 2, 4]],
    "D3*": [[3, -1, -1], [-1, 3, -1], [-1, -1, 3]],
    "A2xZ": [[2, 1, 0], [1, 2, 0], [0, 0, 2]],
}
RESOLUTIONS = (1.0, 0.1, 0.37)


@dataclass(frozen=True)
class Case:
    """A lattice and its exact Gram matrix in integers, if it has one (else that of its floats counts)."""

    label: str
    lattice: Lattice
    integer_gram: list[list[int]] | None = None

    @property
    def gram(self) -> NDArray[np.object_]:
        """The Gram matrix of the public basis in exact numbers: integers, or fractions of the floats."""
        if self.integer_gram is not None:
            return np.array(self.integer_gram, dtype=object)
        B = np.array([[Fraction(float(v)) for v in row] for row in self.lattice.basis], dtype=object)
        return B.T @ B

    @property
    def dim(self) -> int:
        return self.lattice.dim

    def __str__(self) -> str:
        return self.label


def named(name: str, resolution: float) -> Case:
    return Case(f"{name}@{resolution:g}", Lattice.named(name, resolution=resolution), GRAMS[name])


def _integer(label: str, basis: list[list[int]]) -> Case:
    """Make a case of a basis of integers (columns), whose centres, corners and midpoints are exact."""
    B = np.array(basis)
    return Case(label, Lattice(B.astype(float), label), (B.T @ B).tolist())


SKEW2 = Case("skew2", Lattice([[0.131, 0.047], [-0.022, 0.088]], "skew2"))
SKEW3 = Case("skew3", Lattice([[0.13, 0.04, -0.06], [0.01, 0.12, 0.05], [-0.03, 0.02, 0.09]], "skew3"))
# Squares and cubes, and a brick, in bases that hide it.
SHEARED = [
    _integer("sheared squares", [[-1, 0], [-3, 2]]),
    _integer("sheared rectangles", [[1, 2], [0, 3]]),
    _integer("sheared cubes", [[1, 1, 1], [0, 1, 1], [0, 0, 1]]),
    _integer("sheared bricks", [[6, -3, -3], [1, -1, 1], [-1, 1, -5]]),
]
# The cubic ones in a size at which every corner, edge midpoint and centre is a dyadic number.
DYADIC = [
    _integer("Z2 dyadic", [[1, 0], [0, 1]]),
    _integer("Z3 dyadic", [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    _integer("D3 dyadic", [[1, 0, 0], [0, 1, 0], [1, 1, 2]]),
    _integer("D3* dyadic", [[-1, 1, 1], [1, -1, 1], [1, 1, -1]]),
]

# One of each: what most tests go through.
CASES = [named(name, 0.1) for name in GRAMS] + [SKEW2, SKEW3]
# For what rounding could spoil: every resolution, and the awkward ones.
ALL = [named(name, r) for name in GRAMS for r in RESOLUTIONS] + [SKEW2, SKEW3] + SHEARED
PLANAR = [case for case in CASES if case.dim == 2]
SPATIAL = [case for case in CASES if case.dim == 3]
