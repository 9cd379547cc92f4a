"""The time at which each point of a sweep was measured, by the names and units of the drivers of many LiDARs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray

__all__ = ["TIME_NAMES", "PointTimes"]

Fields: TypeAlias = Callable[[str], NDArray[Any] | None]

# Names of the time a point: Ouster (t), Velodyne (time), Hesai and Robosense (timestamp), Livox (offset_time,
# timestamp), and spellings of other drivers. In this order where there are several.
TIME_NAMES = ("t", "time", "timestamp", "offset_time", "time_stamp", "timeoffset", "time_offset", "stamp")
_UNITS = (1.0, 1e-3, 1e-6, 1e-9)
# A sweep takes so many seconds: the units are a thousand apart, so that one of them fits.
_SHORTEST, _LONGEST = 3e-3, 3.0
# Seconds since 1970 are larger than this, offsets within a sweep never.
_ABSOLUTE = 1e6
_FAR = 10.0


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

    def of(self, fields: Fields, stamp: float, used: NDArray[np.bool_] | None = None) -> FloatArray | None:
        """Return seconds (N,) from ``stamp``, or None where the scan has no time a point.

        Args:
            fields: returns the values (N,) of a field of the scan by its name in small letters, None where it has none.
            stamp: of the scan, seconds.
            used: (N,) the points that count: of beams that did not return some drivers write any time.

        Raises:
            ValueError: the times are no sweep in seconds, milliseconds, microseconds or nanoseconds.
        """
        for name in TIME_NAMES if self.name is None else (self.name,):
            values = fields(name)
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
        elif span * self.unit > _FAR:
            raise ValueError(f"times of points in {name!r} that span {span * self.unit:g} s")
        begin = float(first) * self.unit
        if begin > _ABSOLUTE:
            begin -= stamp
            # The sensor's clock may have another zero than the stamp's.
            if abs(begin) > _FAR:
                begin = 0.0
        return np.asarray(begin + offsets * self.unit)
