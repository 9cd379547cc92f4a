"""The points of a sensor_msgs/PointCloud2, field by field."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray

__all__ = ["column", "coordinates"]

# sensor_msgs/PointField: what the numbers of data types mean.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def column(message: Any, name: str) -> NDArray[Any] | None:
    """Return a field (N,) of all points in the message's order, or None where there is none of that name.

    Raises:
        ValueError: the message contradicts itself.
    """
    field = next((f for f in message.fields if f.name.lower() == name), None)
    if field is None:
        return None
    if field.datatype not in _TYPES:
        raise ValueError(f"the field {field.name!r} has data of the unknown type {field.datatype}")
    kind = np.dtype((">" if message.is_bigendian else "<") + _TYPES[field.datatype])
    height, width, step = int(message.height), int(message.width), int(message.point_step)
    if field.offset + kind.itemsize > step:
        raise ValueError(f"the field {field.name!r} ends at byte {field.offset + kind.itemsize} of points of {step}")
    row = int(message.row_step) if height > 1 else width * step
    data = np.ascontiguousarray(message.data, np.uint8)
    if row < width * step or len(data) < row * (height - 1) + width * step:
        raise ValueError(f"{width} x {height} points of {step} bytes do not fit into {len(data)} bytes")
    if not width or not height:
        return np.zeros(0, kind.newbyteorder("="))
    view = np.ndarray((height, width), kind, data.data, int(field.offset), (row, step))
    return np.ascontiguousarray(view).ravel().astype(kind.newbyteorder("="))


def coordinates(message: Any) -> FloatArray:
    """Return x, y and z (N, 3) of all points, metres.

    Raises:
        ValueError: one of them is missing, or the message contradicts itself.
    """
    columns = [column(message, name) for name in "xyz"]
    if any(c is None for c in columns):
        names = ", ".join(f.name for f in message.fields) or "none"
        raise ValueError(f"a cloud without x, y and z; its fields are {names}")
    return np.stack([np.asarray(c, np.float64) for c in columns], axis=1)
