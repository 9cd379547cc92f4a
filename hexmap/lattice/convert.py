"""What may stand where a lattice is asked for: a :class:`Lattice`, the name of one, or a basis."""

from __future__ import annotations

from numbers import Real
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.errors import LatticeError
from hexmap.base.text import quoted
from hexmap.lattice.lattice import NAMES, Lattice

__all__ = ["LatticeLike", "as_lattice", "plain_basis", "plain_lattice"]

# "A2", or a basis (n, n) whose columns are the generators in metres.
LatticeLike: TypeAlias = Lattice | str | ArrayLike


def as_lattice(given: LatticeLike, resolution: float | None = None) -> Lattice:
    """Return the lattice that is meant by a :class:`Lattice`, a name or a basis.

    Args:
        given: a lattice, one of its names (``hexmap.lattice.NAMES`` and their other spellings), or a basis
            (2, 2) or (3, 3) whose columns are the generators, metres.
        resolution: side, metres, of the square or cube as large as a cell. None: 1 m for a name; a lattice and a
            basis stay as they are.

    Raises:
        LatticeError: no lattice of that name, no basis, or the resolution is not a positive number.

    Examples:
        >>> from hexmap.lattice import Lattice, as_lattice
        >>> as_lattice("hex", 0.1)
        Lattice.named('A2', resolution=0.1)
        >>> as_lattice([[0.2, 0.0], [0.0, 0.1]])
        Lattice([[0.2, 0.0], [0.0, 0.1]], name='custom')
        >>> as_lattice(as_lattice("D3"), 0.5).resolution
        0.5
    """
    if isinstance(given, str):
        return Lattice.named(given, 1.0 if resolution is None else resolution)
    if not isinstance(given, Lattice):
        if given is None or np.ndim(given) == 0:
            raise LatticeError(f"a lattice is a Lattice, a name ({', '.join(NAMES)}) or a basis, not {quoted(given)}")
        given = Lattice(given)
    if resolution is None:
        return given
    if not isinstance(resolution, Real) or isinstance(resolution, bool) or not 0.0 < resolution < float("inf"):
        raise LatticeError(f"a resolution must be a positive number of metres, not {quoted(resolution)}")
    if resolution == given.resolution:
        return given
    if _is_named(given):
        return Lattice.named(given.name, resolution)  # to the last bit
    return given.scaled(float(resolution) / given.resolution)


def _is_named(lattice: Lattice) -> bool:
    """Tell whether a lattice is the one of its name, at whatever resolution."""
    if lattice.name not in NAMES:
        return False
    usual = Lattice.named(lattice.name, lattice.resolution).basis
    return usual.shape == lattice.basis.shape and np.allclose(usual, lattice.basis, rtol=1e-12, atol=0.0)


def plain_basis(given: LatticeLike) -> str | tuple[tuple[float, ...], ...]:
    """Return a lattice whose size does not count as settings keep it: its name, or a basis as plain numbers.

    A :class:`Lattice` that has one of the names, whatever its resolution, becomes that name.
    """
    if isinstance(given, str):
        return given
    lattice = as_lattice(given)
    if _is_named(lattice):
        return lattice.name
    return tuple(tuple(row) for row in lattice.basis.tolist())


def plain_lattice(given: LatticeLike, resolution: float) -> tuple[str | list[list[float]], float]:
    """Return lattice and resolution as settings keep them: a name with its resolution, or a basis with its own.

    A :class:`Lattice` becomes a name only where that makes the same lattice to the last bit; the ``resolution`` is
    that of a name.
    """
    if isinstance(given, str):
        return given, resolution
    lattice = as_lattice(given)
    if lattice.name in NAMES:
        for side in (lattice.resolution, float(f"{lattice.resolution:.12g}")):
            if Lattice.named(lattice.name, side) == lattice:
                return lattice.name, side
    return lattice.basis.tolist(), lattice.resolution
