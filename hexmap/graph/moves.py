"""The moves of the graph layer: which a neighbourhood has, how long they are, and which cells they sweep."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.values import integers
from hexmap.lattice.convert import LatticeLike, as_lattice
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.window import IndexBox

__all__ = ["SAME_LENGTH", "Neighbourhood", "lengths_of", "moves_of", "swept_by_moves", "swept_cells"]

Neighbourhood: TypeAlias = Literal["nearest", "faces", "extended"] | int | None
SAME_LENGTH = 1e-12  # lengths that agree to this fraction are the same
_TOUCH = 1e-9  # a cell is swept if the line comes this near to it, as a fraction of its width


def swept_cells(lattice: LatticeLike, move: ArrayLike) -> NDArray[np.int64]:
    """Return the cells (S, n) that the straight line from the cell 0 to the cell ``move`` (n,) touches between.

    All cells whose closed Voronoi cell meets the line between the two centres, to 1e-9 of a cell,
    but for the two ends; lexicographically ascending, none for a move across a face.

    Examples:
        >>> from hexmap import Lattice
        >>> from hexmap.graph import swept_cells
        >>> swept_cells(Lattice.named("Z2"), [1, 1]).tolist()
        [[0, 1], [1, 0]]
    """
    lattice = as_lattice(lattice)
    v = integers(move)
    if v is None or v.shape != (lattice.dim,):
        raise ArgumentError(f"a move on {lattice.name} takes {lattice.dim} integers, not {move!r}")
    none = np.empty((0, lattice.dim), np.int64)
    if not v.any() or (lattice.faces == v).all(axis=1).any():
        return none
    # In the reduced basis no cell reaches far, and Gram matrices are as exact as they can be.
    tables = lattice.ray_tables
    towards = lattice.reduced_index(v[None])[0]
    margin = np.ceil(np.abs(lattice.coordinates(lattice.cell.vertices)).max(axis=0)).astype(np.int64) + 1
    low, high = np.minimum(towards, 0) - margin, np.maximum(towards, 0) + margin
    to_reduced = lattice.reduced_index(np.eye(lattice.dim, dtype=np.int64)).T
    to_public = np.rint(np.linalg.inv(to_reduced)).astype(np.int64)
    cells = IndexBox.of_corners(low, high).cells()
    # The point t v is in the closed cell around c where t (v G f) <= f G f / 2 + c G f for all faces f.
    rate = tables.planes @ towards
    room = tables.half * (1.0 + 2.0 * _TOUCH) + cells @ tables.planes.T
    steady = np.abs(rate) <= 1e-12 * np.abs(tables.half)
    safe = np.where(steady, 1.0, rate)
    leave = np.where(rate > 0, room / safe, np.inf)[:, ~steady].min(axis=1)
    enter = np.where(rate < 0, room / safe, -np.inf)[:, ~steady].max(axis=1)
    touched = (np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)) & (room[:, steady] >= 0.0).all(axis=1)
    found = cells[touched] @ to_public.T
    found = found[(found != 0).any(axis=1) & (found != v).any(axis=1)]
    return np.ascontiguousarray(found[np.lexsort(found.T[::-1])])


def swept_by_moves(lattice: Lattice, moves: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return what each move sweeps; opposite moves from opposite ends sweep the same, to the last cell."""
    found: dict[tuple[int, ...], NDArray[np.int64]] = {}
    for move in moves:
        key = tuple(int(v) for v in move)
        opposite = tuple(-v for v in key)
        found[key] = -found[opposite] if opposite in found else swept_cells(lattice, move)
    return [found[tuple(int(v) for v in move)] for move in moves]


def moves_of(lattice: Lattice, neighbourhood: Neighbourhood) -> NDArray[np.int64]:
    """Return the offsets (K, n) of a neighbourhood by its name or size."""
    named: dict[Any, str] = {None: "neighbours", "nearest": "nearest", "faces": "faces", "extended": "extended"}
    if isinstance(neighbourhood, (int, np.integer)) and not isinstance(neighbourhood, bool):
        moves = lattice.shell(int(neighbourhood))
    elif neighbourhood is None or (isinstance(neighbourhood, str) and neighbourhood in named):
        moves = getattr(lattice, named[neighbourhood])
    else:
        raise ArgumentError(f"a neighbourhood is nearest, faces, extended or a size, not {neighbourhood!r}")
    return np.array(moves, dtype=np.int64, order="C")


def lengths_of(lattice: Lattice, moves: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the lengths (K,) of moves, metres, with those that are equal made equal to the last bit."""
    lengths = np.sqrt((lattice.centres(moves) ** 2).sum(axis=1))
    order = np.argsort(lengths, kind="stable")
    reference = 0.0
    for k in order:
        if lengths[k] > reference * (1.0 + SAME_LENGTH):
            reference = lengths[k]
        lengths[k] = reference
    return lengths
