"""What makes an object a value: its attributes cannot be assigned and its arrays cannot be written to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["Immutable", "integers", "kept", "lossless", "one_line", "read_only", "remade"]

_LONGEST = 60  # characters of one attribute in a line that tells of all of them
_EXACT = 2**53  # whole numbers up to here are float64, too


class Immutable:
    """A class whose attributes are set once, by its own functions with ``object.__setattr__``."""

    __slots__ = ()

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse: it is a value."""
        raise AttributeError(f"a {type(self).__name__} is immutable")

    def __delattr__(self, name: str) -> None:
        """Refuse: it is a value."""
        raise AttributeError(f"a {type(self).__name__} is immutable")


def remade(value: Any) -> tuple[Any, ...]:
    """Return what a dataclass returns as ``__reduce__``: its constructor freezes the arrays that pickle does not."""
    return type(value), tuple(getattr(value, each.name) for each in fields(value))


def one_line(value: Any) -> str:
    """Return what a dataclass returns as ``__repr__``: its fields in one line, of an array no more than shape and type.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Scan
        >>> Scan(stamp=0.5, points=np.zeros((181, 2)))
        Scan(stamp=0.5, points=<(181, 2) float64>, no_return=<(0, 2) float64>)
    """
    told = ((each.name, getattr(value, each.name)) for each in fields(value) if not each.name.startswith("_"))
    said = ", ".join(f"{name}={_short(v)}" for name, v in told if v is not None)
    return f"{type(value).__name__}({said})"


def _short(value: Any) -> str:
    """Return an attribute as it can stand in a line with others."""
    if isinstance(value, np.ndarray):
        return f"<{value.shape} {value.dtype}>"
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, (Sequence, Mapping)) and not isinstance(value, (str, bytes)) and len(value) > 4:
        return f"<{type(value).__name__} of {len(value)}>"
    text = repr(value)
    if len(text) <= _LONGEST and "\n" not in text:
        return text
    return text[: _LONGEST - 4] + "...'" if isinstance(value, str) else f"<{type(value).__name__}>"


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array that this program has made, from now on read-only."""
    array.setflags(write=False)
    return array


def kept(values: Any, dtype: DTypeLike) -> NDArray[Any]:
    """Return ``values`` as a contiguous read-only array that nobody else can write to: a copy where somebody could."""
    array = np.ascontiguousarray(values, dtype=dtype)
    below: Any = array
    while isinstance(below, np.ndarray):
        if below.flags.writeable:
            return read_only(np.array(array, order="C"))
        below = below.base
    return array


def integers(values: Any) -> NDArray[np.int64] | None:
    """Return ``values`` as int64, those beyond it as its last, out of any range; None where they are no integers."""
    if np.ma.isMaskedArray(values):
        return None
    try:
        array = np.asarray(values)
    except ValueError:  # rows of different lengths
        return None
    if array.dtype.kind == "O":  # what Python's own whole numbers become that int64 does not hold
        if not all(isinstance(v, Integral) and not isinstance(v, bool) for v in array.flat):
            return None
        return np.clip(array, -(2**63), 2**63 - 1).astype(np.int64)
    if array.dtype.kind not in "iu":
        return None
    return np.minimum(array, 2**63 - 1).astype(np.int64) if array.dtype == np.uint64 else array.astype(np.int64)


def lossless(values: Any) -> NDArray[Any] | None:
    """Return ``values`` as an array, None where numbers made of them would say less than they do.

    These are arrays with a mask, complex numbers, dates, texts, objects other than numbers, and whole numbers or long
    ones that float64 does not hold.
    """
    if np.ma.isMaskedArray(values):
        return None
    try:
        array = np.asarray(values)
        if array.dtype.kind == "O":
            if not all(isinstance(v, Real) for v in array.flat):
                return None
            array = np.array(array.tolist(), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):  # rows of different lengths, what is no number
        return None
    kind = array.dtype.kind
    if array.size == 0:
        return array
    if kind in "iu":
        return array if int(array.min()) >= -_EXACT and int(array.max()) <= _EXACT else None
    if kind == "f" and array.dtype.itemsize > 8:
        return array if np.array_equal(array.astype(np.float64), array, equal_nan=True) else None
    return array if kind in "fb" else None
