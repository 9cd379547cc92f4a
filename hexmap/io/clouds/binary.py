"""Points as bare arrays: KITTI's velodyne files, with four numbers a point or others, and numpy's NPY."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import FormatError
from hexmap.base.text import reason, shown
from hexmap.io.clouds.columns import Columns, Raw, choose_columns, gather

__all__ = ["read_kitti", "read_npy"]

# How many numbers a point may have, and their names: KITTI's four come first, nuScenes' five have the ring.
_NAMES = ("x", "y", "z", "intensity", "ring", "time")
_WIDTHS = (4, 3, 5, 6)
# Nothing on Earth is farther from an origin on it, in metres or millimetres alike.
_FARTHEST = 1e11
# How many numbers are looked at, and how much better another width must be than the usual one.
_LOOKED_AT = 1 << 18
_FEWEST = 24  # points below which numbers tell nothing
_MANY = 256  # points from which on it is worth a word that they tell nothing
_CLEARLY = 0.95
_CLEARLY_SIX = 0.8


def read_kitti(path: Path, data: bytes, columns: Columns | None = None, usual: int = 4) -> Raw:
    """Read a KITTI scan held in ``data``: little endian float32, four a point, or three, five or six.

    The file does not say how many. The usual number is taken unless another makes clearly more of it: columns that
    differ from each other, and neighbours that are alike.

    Args:
        path: the file, for messages.
        data: its content.
        columns: x, y (and z) among the names or the numbers of the columns; or all names of a point's numbers, in order
            and with x, y and z among them; or one number, how many there are.
        usual: how many numbers a point has in files of this name.

    Raises:
        FormatError: the size is no multiple of a point's, or the numbers cannot be coordinates.
    """
    notes: list[str] = []
    named = _layout_asked_for(path, columns)
    values = np.frombuffer(data[: len(data) - len(data) % 4], dtype="<f4")
    if named is not None:
        width, names = len(named), named
        columns = None
    else:
        width, told = _width(values, usual)
        names = list(_NAMES[:width])
        if not told:
            notes.append(
                f"nothing in the file tells how many numbers a point has; read as {width}, {' '.join(names)}; "
                "say another number with columns"
            )
        elif width != usual:
            notes.append(f"read as {width} numbers a point, {' '.join(names)}; say another number with columns")
    if len(data) % (4 * width):
        raise FormatError(
            f"{path}, byte {len(data) - len(data) % (4 * width)}: {len(data)} bytes are no multiple of {4 * width}; "
            "a KITTI scan is float32 x y z intensity, point after point; say another number a point with columns"
        )
    chosen = choose_columns(path, names, columns, "columns")
    table = values.reshape(-1, width)
    with np.errstate(invalid="ignore"):
        points = np.ascontiguousarray(table[:, chosen], dtype=np.float64)
        # The format has no mark of its own; bytes of another kind make numbers that no coordinate has.
        wild = np.isfinite(points) & (np.abs(points) > _FARTHEST)
    if wild.any():
        row, k = (int(v) for v in np.argwhere(wild)[0])
        raise FormatError(
            f"{path}, byte {(row * width + chosen[k]) * 4}: {points[row, k]:.6g} is not a coordinate; "
            "a KITTI scan is float32 x y z intensity, point after point"
        )
    return Raw(points, notes)


def _layout_asked_for(path: Path, columns: Columns | None) -> list[str] | None:
    """Return the names of a point's numbers where the columns say all of them, else None."""
    if columns is None:
        return None
    words = [str(column).strip().lower() for column in columns]
    if len(words) == 1 and words[0].isdecimal():
        width = int(words[0])
        if not 2 <= width <= 64:
            raise FormatError(f"{path}: {width} numbers a point; 2 to 64 are read")
        return [*_NAMES, *(f"column{k}" for k in range(len(_NAMES), width))][:width]
    if len(words) > 3 or (len(words) == 3 and {"x", "y", "z"} == set(words)):
        return words
    return None


def _width(values: NDArray[np.float32], usual: int) -> tuple[int, bool]:
    """Return how many numbers a point has, as far as the numbers tell, and whether they do.

    A wrong number mixes what belongs to different columns: all columns then look alike, and a point is not like the
    next. Of 3 and 6, which both keep columns apart, the smaller is taken unless it is much worse.
    """
    fitting = [width for width in sorted(_WIDTHS) if len(values) % width == 0]
    rows = len(values) // usual
    if rows < _FEWEST:
        return usual, True
    with np.errstate(invalid="ignore"):
        v = values[:_LOOKED_AT].astype(np.float64)
    v[~np.isfinite(v)] = 0.0
    if float(np.ptp(v)) == 0.0:
        return usual, True
    ranks = [np.argsort(np.argsort(w, kind="stable"), kind="stable") / len(v) for w in (v, np.abs(v))]
    scores = {width: _mixing(ranks, width) for width in _WIDTHS}
    best = min((width for width in _WIDTHS if width != 6), key=scores.__getitem__)
    if scores[6] < _CLEARLY_SIX * scores[best]:
        best = 6
    clearly = min(_CLEARLY, 1.0 - 2.0 / math.sqrt(rows))
    if best != usual and scores[best] < clearly * min(scores[usual], 1.0):
        return best, True
    if rows >= _MANY and usual not in fitting and fitting and scores[usual] > clearly:
        return fitting[0], False
    return usual, scores[usual] < clearly or len(fitting) < 2 or rows < _MANY


def _mixing(ranks: list[NDArray[np.float64]], width: int) -> float:
    """Return how much a width mixes columns: 1 where all are alike and no point is like the next, less elsewhere."""
    parts = []
    for rank in ranks:
        table = rank[: len(rank) // width * width].reshape(-1, width)
        parts.append(float(table.var(axis=0).mean() / rank.var()))
    table = ranks[0][: len(ranks[0]) // width * width].reshape(-1, width)
    parts.append(3.0 * float(np.abs(np.diff(table, axis=0)).mean()))
    return sum(parts) / len(parts)


def read_npy(path: Path, data: bytes, columns: Columns | None = None) -> Raw:
    """Read a numpy array held in ``data``: (N, 2 or more) numbers, or records with fields x, y (and z).

    The first three of four or more columns are taken. Nothing is ever unpickled.

    Raises:
        FormatError: the file is damaged, or the array is of another shape or type.
    """
    try:
        array = np.load(io.BytesIO(data), allow_pickle=False)
    except Exception as error:
        # numpy parses the header as a Python literal: damage shows as nearly any exception.
        raise FormatError(f"{path}: not a sound NPY file of numbers: {reason(error)}") from error
    if not isinstance(array, np.ndarray):
        raise FormatError(f"{path}: not one NPY array but an archive of several; save the points as .npy")
    if array.dtype.names:
        names = [str(name) for name in array.dtype.names]
        chosen = choose_columns(path, names, columns, "fields")
        taken = [names[place] for place in chosen]
        for name in taken:
            if array.dtype[name].kind not in "fiu":
                raise FormatError(f"{path}: the field {shown(name)!r} is of type {array.dtype[name]}, not a number")
        return Raw(gather(array.reshape(-1), taken))
    if array.dtype.kind not in "fiu":
        raise FormatError(f"{path}: an array of type {array.dtype}; points are real numbers")
    if array.ndim != 2 or array.shape[1] < 2:
        raise FormatError(f"{path}: an array of shape {array.shape}; points are (N, 2) or (N, 3)")
    if columns is None:
        chosen = list(range(min(array.shape[1], 3)))
    else:
        chosen = choose_columns(path, [str(k) for k in range(array.shape[1])], columns, "columns")
    with np.errstate(over="ignore", invalid="ignore"):
        return Raw(np.ascontiguousarray(array[:, chosen], dtype=np.float64))
