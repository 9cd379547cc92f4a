"""What the readers of point files share: what they hand over, and the choice of columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import FormatError
from hexmap.base.text import shown
from hexmap.base.values import one_line

Columns: TypeAlias = Sequence[str | int]


@dataclass
class Raw:
    """What a reader hands over.

    Attributes:
        values: (N, 2) or (N, 3) as stored.
        warnings: what was not as it should be.
        further: further columns (N,) by their names, those of them that the file has.
    """

    values: FloatArray
    warnings: list[str] = field(default_factory=list)
    further: dict[str, FloatArray] = field(default_factory=dict)

    @classmethod
    def of(cls, values: FloatArray, further: Sequence[str], warnings: Sequence[str] = ()) -> Raw:
        """Make one of a table whose last columns are ``further`` ones."""
        n = values.shape[1] - len(further)
        columns = {name: np.ascontiguousarray(values[:, n + k]) for k, name in enumerate(further)}
        return cls(values[:, :n], list(warnings), columns)

    __repr__ = one_line


def choose_columns(path: Path, names: Sequence[str], columns: Columns | None, what: str) -> list[int]:
    """Return the places of x, y (and z, if there) among ``names``, or of the columns asked for.

    Args:
        path: the file, for the message.
        names: what the file calls its columns, in order.
        columns: names, or numbers from 0, of two or three of them; None: x, y and z by name.
        what: what the format calls its columns ("fields", "properties").

    Raises:
        FormatError: one of them is not in the file.
    """
    listed = [name.lower() for name in names]
    if columns is None:
        wanted: Columns = ("x", "y", "z") if "z" in listed else ("x", "y")
    else:
        wanted = columns
    found = []
    for column in wanted:
        key = str(column).strip().lower()
        # A name wins over a number, so that a column called "0" can be had.
        if isinstance(column, str) and key in listed:
            found.append(listed.index(key))
        elif key.isdecimal() and int(key) < len(names):
            found.append(int(key))
        else:
            have = " ".join(shown(name) for name in names[:12]) + (" ..." if len(names) > 12 else "")
            raise FormatError(f"{path}: no {shown(str(column))!r} among the {what} of the file: {have or 'none'}")
    return found


def further_columns(names: Sequence[str], is_number: Sequence[bool], wanted: Sequence[str]) -> dict[str, int]:
    """Return the places of those of the columns ``wanted``, in small letters, that a file has and that hold numbers."""
    listed = [name.lower() for name in names]
    places = {name: listed.index(name) for name in wanted if name in listed}
    return {name: place for name, place in places.items() if is_number[place]}


def gather(records: NDArray[np.void], names: Sequence[str]) -> FloatArray:
    """Return the fields ``names`` of a structured array as the columns of an (N, n) float64 array."""
    out = np.empty((len(records), len(names)), dtype=np.float64)
    # A signalling NaN among float32 makes the conversion warn; such points are dropped later.
    with np.errstate(invalid="ignore", over="ignore"):
        for k, name in enumerate(names):
            out[:, k] = records[name]
    return out
