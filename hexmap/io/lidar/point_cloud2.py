"""The points of a sensor_msgs/PointCloud2, with a time a point where the driver writes one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray

__all__ = ["PointTimes", "column", "coordinates"]

# sensor_msgs/PointField: what the numbers of data types mean.
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
# Names of the time a point: Ouster (t), Velodyne (time), Hesai and Robosense (timestamp), Livox (offset_time,
# timestamp), and spellings of other drivers. In this order where there are several.
_TIME_NAMES = ("t", "time", "timestamp", "offset_time", "time_stamp", "timeoffset", "time_offset", "stamp")
_UNITS = (1.0, 1e-3, 1e-6, 1e-9)
# A sweep takes so many seconds: the units are a thousand apart, so that one of them fits.
_SHORTEST, _LONGEST = 3e-3, 3.0
# Seconds since 1970 are larger than this, offsets within a sweep never.
_ABSOLUTE = 1e6
_FAR = 10.0


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


class PointTimes:
    """Turns the times of points into seconds from the scan's stamp; the unit is that of the first scan that tells.

    Attributes:
        unit: seconds that the field counts; None as long as no scan has told.
        name: of the field.
    """

    def __init__(self) -> None:
        """Begin without a unit."""
        self.unit: float | None = None
        self.name: str | None = None

    def of(self, message: Any, stamp: float, used: NDArray[np.bool_] | None = None) -> FloatArray | None:
        """Return seconds (N,) from ``stamp``, or None where the message has no time a point.

        ``used`` (N,) marks the points that count: of beams that did not return some drivers write any time.

        Raises:
            ValueError: the times are no sweep in seconds, milliseconds, microseconds or nanoseconds.
        """
        for name in _TIME_NAMES if self.name is None else (self.name,):
            values = column(message, name)
            if values is not None and len(values):
                break
        else:
            return None
        if used is not None and not used.all():
            if not used.any():
                return None
            values = np.where(used, values, values[int(np.argmax(used))])
        # Subtracted before anything is rounded: nanoseconds since 1970 have no room in a float64.
        first = values[0]
        offsets = values.astype(np.float64) if values.dtype.kind == "f" else values.astype(np.int64)
        offsets = (offsets - offsets[0]).astype(np.float64)
        if not np.isfinite(offsets).all():
            raise ValueError(f"times of points in {name!r} that are not finite")
        span = float(offsets.max() - offsets.min())
        if self.unit is None:
            if span == 0.0:
                return None
            fits = [unit for unit in _UNITS if _SHORTEST <= span * unit < _LONGEST]
            if not fits:
                raise ValueError(f"times of points in {name!r} that span {span:g}: no sweep in s, ms, us or ns")
            self.unit, self.name = fits[0], name
        begin = float(first) * self.unit
        if begin > _ABSOLUTE:
            begin -= stamp
            # The sensor's clock may have another zero than the stamp's.
            if abs(begin) > _FAR:
                begin = 0.0
        return np.asarray(begin + offsets * self.unit)
