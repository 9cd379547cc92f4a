"""Points as bare arrays: KITTI's velodyne files and numpy's NPY."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from hexmap.base.errors import FormatError
from hexmap.base.text import reason, shown
from hexmap.io.clouds.columns import Columns, Raw, choose_columns, gather

__all__ = ["read_kitti", "read_npy"]

_KITTI = ("x", "y", "z", "intensity")
# Nothing on Earth is farther from an origin on it, in metres or millimetres alike.
_FARTHEST = 1e11


def read_kitti(path: Path, data: bytes, columns: Columns | None = None) -> Raw:
    """Read a KITTI scan held in ``data``: little endian float32 x y z intensity, and nothing else.

    Raises:
        FormatError: the size is no multiple of 16 bytes, or the numbers cannot be coordinates.
    """
    if len(data) % 16:
        raise FormatError(
            f"{path}, byte {len(data) - len(data) % 16}: {len(data)} bytes are no multiple of 16; "
            "a KITTI scan is float32 x y z intensity, point after point"
        )
    chosen = choose_columns(path, _KITTI, columns, "columns")
    table = np.frombuffer(data, dtype="<f4").reshape(-1, 4)
    with np.errstate(invalid="ignore"):
        values = np.ascontiguousarray(table[:, chosen], dtype=np.float64)
        # The format has no mark of its own; bytes of another kind make numbers that no coordinate has.
        wild = np.isfinite(values) & (np.abs(values) > _FARTHEST)
    if wild.any():
        row, k = (int(v) for v in np.argwhere(wild)[0])
        raise FormatError(
            f"{path}, byte {row * 16 + chosen[k] * 4}: {values[row, k]:.6g} is not a coordinate; "
            "a KITTI scan is float32 x y z intensity, point after point"
        )
    return Raw(values)


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
