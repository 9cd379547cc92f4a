"""Which points of a file to use: by range, by box, without duplicates, a random sample.

Each filter is a function of points (N, n), in metres, that returns the rows it keeps as a new
array, in their old order. :class:`PointFilter` does all of them in one fixed order.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError

__all__ = ["FilterReport", "PointFilter", "random_sample", "unique_points", "within_box", "within_range"]


def within_range(points: ArrayLike, min_range: float = 0.0, max_range: float | None = None) -> FloatArray:
    """Keep the points from ``min_range`` to ``max_range`` metres from the origin, both included.

    Raises:
        ArgumentError: points that are not finite (N, 2) or (N, 3), or ranges that are not
            0 <= min_range <= max_range.
    """
    p = _checked(points)
    least, most = _checked_range(min_range, max_range)
    # Coordinates beyond 1e154 overflow when squared: infinitely far is what they are.
    with np.errstate(over="ignore"):
        distance = np.sqrt(np.square(p).sum(axis=1))
    keep = distance >= least
    if most is not None:
        keep &= distance <= most
    return p[keep]


def within_box(points: ArrayLike, low: Sequence[float] | None, high: Sequence[float] | None) -> FloatArray:
    """Keep the points of the box from corner ``low`` to corner ``high`` (n,), faces included.

    Infinite coordinates leave a side open, and so does None for a whole corner.

    Raises:
        ArgumentError: points that are not finite (N, 2) or (N, 3), corners of another dimension,
            or a low coordinate above its high one.
    """
    p = _checked(points)
    lowest, highest = _checked_box(low, high)
    keep = np.ones(len(p), dtype=bool)
    for corner, name in ((lowest, "low"), (highest, "high")):
        if corner is None:
            continue
        if len(corner) != p.shape[1]:
            raise ArgumentError(f"the corner {name} of a box for these points takes {p.shape[1]} numbers, not {corner}")
        for k, value in enumerate(corner):
            keep &= p[:, k] >= value if name == "low" else p[:, k] <= value
    return p[keep]


def unique_points(points: ArrayLike) -> FloatArray:
    """Keep the first of all points whose coordinates are exactly the same (0.0 and -0.0 are).

    Raises:
        ArgumentError: points that are not finite (N, 2) or (N, 3).
    """
    p = _checked(points)
    if len(p) < 2:
        return p.copy()
    order = np.lexsort(p.T)
    ordered = p[order]
    first = np.ones(len(p), dtype=bool)
    first[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    # The sort is stable, so the first of a run of equals is the first of them in the file.
    return p[np.sort(order[first])]


def random_sample(points: ArrayLike, count: int, seed: int = 0) -> FloatArray:
    """Keep ``count`` points at random, each set as likely as another; all where there are no more.

    The same points, count and seed always give the same sample.

    Raises:
        ArgumentError: points that are not finite (N, 2) or (N, 3), a count below 1, or a
            negative seed.
    """
    p = _checked(points)
    count, seed = _checked_sample(count, seed)
    if count >= len(p):
        return p.copy()
    chosen = np.random.default_rng(seed).choice(len(p), size=count, replace=False, shuffle=False)
    return p[np.sort(chosen)]


@dataclass(frozen=True)
class FilterReport:
    """How many points a :class:`PointFilter` was given and what each of its filters dropped.

    Attributes:
        given: points before the filter.
        out_of_range: dropped because too near or too far.
        out_of_box: dropped because outside the crop box.
        duplicates: dropped because another point is exactly the same.
        not_sampled: dropped by the random sample.
    """

    given: int
    out_of_range: int = 0
    out_of_box: int = 0
    duplicates: int = 0
    not_sampled: int = 0

    @property
    def kept(self) -> int:
        """Points that were kept."""
        return self.given - self.out_of_range - self.out_of_box - self.duplicates - self.not_sampled

    def __str__(self) -> str:
        """Say it in one line."""
        parts = [
            f"{count} {what}"
            for count, what in (
                (self.out_of_range, "out of range"),
                (self.out_of_box, "out of the box"),
                (self.duplicates, "duplicates"),
                (self.not_sampled, "not sampled"),
            )
            if count
        ]
        return f"{self.kept} of {self.given} points kept" + (f" (dropped: {', '.join(parts)})" if parts else "")


@dataclass(frozen=True)
class PointFilter:
    """Which points to use; the defaults keep all. Plain JSON, like all settings.

    The order is fixed: range, box, duplicates, sample, so that a sample of k points holds k
    different points of the range and the box asked for, if there are as many.

    Attributes:
        min_range: metres from the origin of the points; nearer ones are dropped (the robot itself).
        max_range: metres from the origin; farther ones are dropped. None: no limit.
        low: low corner of a crop box, one number (metres) a coordinate; None: no low sides.
        high: high corner of the crop box; None: no high sides.
        unique: drop all but the first of points that are exactly the same.
        sample: keep at most so many points, drawn at random. None: all.
        seed: seed of the draw.

    Examples:
        >>> from hexmap.io.clouds import PointFilter
        >>> kept, report = PointFilter(max_range=2.0, unique=True).apply_counted([[1, 0], [1, 0], [3, 0]])
        >>> kept.tolist(), str(report)
        ([[1.0, 0.0]], '1 of 3 points kept (dropped: 1 out of range, 1 duplicates)')
    """

    min_range: float = 0.0
    max_range: float | None = None
    low: tuple[float, ...] | None = None
    high: tuple[float, ...] | None = None
    unique: bool = False
    sample: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            ArgumentError: a value that makes no sense; see the functions of this module.
        """
        least, most = _checked_range(self.min_range, self.max_range)
        low, high = _checked_box(self.low, self.high)
        object.__setattr__(self, "min_range", least)
        object.__setattr__(self, "max_range", most)
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        sample, seed = _checked_sample(1 if self.sample is None else self.sample, self.seed)
        object.__setattr__(self, "sample", None if self.sample is None else sample)
        object.__setattr__(self, "seed", seed)

    def apply(self, points: ArrayLike) -> FloatArray:
        """Return the points kept, a new array (M, n) in their old order.

        Raises:
            ArgumentError: points that are not finite (N, 2) or (N, 3), or of another dimension
                than the box.
        """
        return self.apply_counted(points)[0]

    def apply_counted(self, points: ArrayLike) -> tuple[FloatArray, FilterReport]:
        """Return the points kept, as :meth:`apply` does, and how many each filter dropped.

        Raises:
            ArgumentError: as for :meth:`apply`.
        """
        given = _checked(points)
        ranged = given
        if self.min_range > 0.0 or self.max_range is not None:
            ranged = within_range(given, self.min_range, self.max_range)
        boxed = ranged if self.low is None and self.high is None else within_box(ranged, self.low, self.high)
        distinct = unique_points(boxed) if self.unique else boxed
        sampled = distinct if self.sample is None else random_sample(distinct, self.sample, self.seed)
        report = FilterReport(
            given=len(given),
            out_of_range=len(given) - len(ranged),
            out_of_box=len(ranged) - len(boxed),
            duplicates=len(boxed) - len(distinct),
            not_sampled=len(distinct) - len(sampled),
        )
        return (sampled.copy() if sampled is given else sampled), report


def _checked(points: ArrayLike) -> FloatArray:
    p = np.asarray(points, dtype=np.float64)
    if p.ndim != 2 or p.shape[1] not in (2, 3):
        raise ArgumentError(f"points are (N, 2) or (N, 3), not {p.shape}")
    finite = np.isfinite(p).all(axis=1)
    if not finite.all():
        row = int(np.argmin(finite))
        raise ArgumentError(f"point {row} is not finite: {p[row].tolist()}")
    return p


def _checked_range(min_range: float, max_range: float | None) -> tuple[float, float | None]:
    if not (math.isfinite(min_range) and min_range >= 0.0):
        raise ArgumentError(f"min_range must be a number of metres from 0, not {min_range}")
    # Written so that NaN fails, and so that infinity is no limit.
    if max_range is not None and not (max_range > 0.0 and max_range >= min_range):
        raise ArgumentError(f"max_range must be positive and not below min_range ({min_range:g}), not {max_range}")
    return float(min_range), None if max_range is None or math.isinf(max_range) else float(max_range)


def _checked_box(
    low: Sequence[float] | None, high: Sequence[float] | None
) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    corners: list[tuple[float, ...] | None] = []
    for name, corner in (("low", low), ("high", high)):
        if corner is None:
            corners.append(None)
            continue
        values = tuple(float(v) for v in corner)
        if len(values) not in (2, 3) or any(math.isnan(v) for v in values):
            raise ArgumentError(f"the corner {name} of a box takes two or three numbers, not {values}")
        corners.append(values)
    a, b = corners
    if a is not None and b is not None:
        if len(a) != len(b):
            raise ArgumentError(f"the corners of a box must have the same dimension, not {len(a)} and {len(b)}")
        for k, (lowest, highest) in enumerate(zip(a, b, strict=True)):
            if lowest > highest:
                raise ArgumentError(f"the box is empty: {'xyz'[k]} from {lowest:g} to {highest:g}")
    return a, b


def _checked_sample(count: int, seed: int) -> tuple[int, int]:
    if int(count) != count or count < 1:
        raise ArgumentError(f"sample must be a number of points from 1, not {count}")
    if int(seed) != seed or seed < 0:
        raise ArgumentError(f"seed must be a whole number from 0, not {seed}")
    return int(count), int(seed)
