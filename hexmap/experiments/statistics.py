"""How sure a number is: bootstrap intervals of statistics, and of ratios of statistics.

All intervals are BCa (bias-corrected and accelerated; Efron 1987). The plain percentile interval is simpler,
but what the paper reports are variabilities of a few dozen values: they are biased low in a resample, and
skewed, and BCa corrects for both to first order, while it keeps what makes percentiles good (it respects
the range of the statistic and any monotone change of scale, and a ratio needs no further theory). Where
there is nothing to correct it is the percentile interval. Measured on sigma / mu of 36 normal values, a
95 % interval holds the truth 88 % of the time, the percentile interval 84 %; of 100 values, 93 % and 91 %.

Neighbours on a smooth curve, such as the cells a map needs over the angle it was rotated by, are correlated.
Resampling single values would take them for independent and promise too much. ``block`` resamples runs
of neighbours instead (moving blocks: Künsch 1989), by default around the end to the beginning (circular
blocks: Politis & Romano 1992), which gives every value the same weight and is right for angles, where the
curve does close. :func:`block_length` chooses a length. Blocks help; they do not make few correlated values
many: where the correlation reaches over a tenth of the curve, intervals are still too short.

A statistic is a function of an array that works along its last axis, so that all resamples are computed at
once. Every interval is determined by its arguments and the state of the generator.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.errors import ArgumentError

__all__ = [
    "Interval",
    "Statistic",
    "block_length",
    "bootstrap",
    "bootstrap_ratio",
    "cv",
    "interquartile_factor",
    "mean",
]

Statistic = Callable[[NDArray[np.float64]], NDArray[np.float64]]

_NORMAL = NormalDist()
_CHUNK = 1 << 21  # values gathered at a time: 16 MB
_GROUPS = 200  # of the jackknife: more make the acceleration no better


@dataclass(frozen=True, slots=True)
class Interval:
    """A value and its confidence interval, in the units of the statistic.

    Attributes:
        value: of the sample itself.
        low: the lower end.
        high: the upper end.
        level: the confidence, 0.95 for 95 %.
    """

    value: float
    low: float
    high: float
    level: float = 0.95

    def __contains__(self, value: float) -> bool:
        """Return whether ``value`` lies in the interval, ends included."""
        return self.low <= value <= self.high

    def scaled(self, factor: float) -> Interval:
        """Return the interval in another unit: everything times ``factor``, which is positive."""
        return Interval(self.value * factor, self.low * factor, self.high * factor, self.level)


# ---------------------------------------------------------------------- statistics along the last axis


def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the mean of ``values`` (..., K) along the last axis."""
    return np.asarray(np.mean(values, axis=-1))


def cv(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sigma / mu along the last axis, as :func:`hexmap.maps.coefficient_of_variation` does."""
    return np.asarray(np.std(values, axis=-1) / np.abs(np.mean(values, axis=-1)))


def interquartile_factor(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (Q3 - Q1) / (Q3 + Q1) along the last axis, as :func:`hexmap.maps.interquartile_variability`."""
    q1, q3 = np.percentile(values, [25.0, 75.0], axis=-1)
    return np.asarray((q3 - q1) / (q3 + q1))


# ---------------------------------------------------------------------- intervals


def bootstrap(
    values: ArrayLike,
    statistic: Statistic,
    *,
    rng: np.random.Generator,
    resamples: int = 2000,
    level: float = 0.95,
    block: int = 1,
    circular: bool = True,
) -> Interval:
    """Return a statistic of a sample with its interval.

    Args:
        values: the sample (K,), in the order of the curve where ``block`` is larger than 1.
        statistic: along the last axis, such as :func:`mean`, :func:`cv`, :func:`interquartile_factor`.
        rng: chooses the resamples.
        resamples: how many.
        level: the confidence.
        block: how many neighbours are drawn together; 1 for independent values.
        circular: whether the first value is the neighbour of the last one, as on a full circle.

    Returns:
        The interval, in the units of the statistic.

    Raises:
        ArgumentError: fewer than two values, one that is not finite, a statistic that is not defined on
            them, or another argument out of range.

    Examples:
        >>> import numpy as np
        >>> from hexmap.experiments import bootstrap
        >>> from hexmap.experiments.statistics import mean
        >>> interval = bootstrap(np.arange(100.0), mean, rng=np.random.default_rng(0))
        >>> interval.value
        49.5
        >>> 49.5 - 7 < interval.low < 49.5 < interval.high < 49.5 + 7
        True
    """
    sample = _sample(values)
    return _interval([sample], [statistic], True, rng, resamples, level, block, circular)


def bootstrap_ratio(
    a: ArrayLike,
    b: ArrayLike,
    statistic: Statistic,
    *,
    rng: np.random.Generator,
    paired: bool = True,
    resamples: int = 2000,
    level: float = 0.95,
    block: int = 1,
    circular: bool = True,
) -> Interval:
    """Return the ratio of a statistic of ``a`` to that of ``b``, with its interval.

    Args:
        a: a sample (K,).
        b: a sample; (K,) where paired.
        statistic: along the last axis.
        rng: chooses the resamples.
        paired: whether ``a[k]`` and ``b[k]`` come from the same case (the same rotation). Pairs are drawn
            together, so that what both have in common cancels.
        resamples: how many.
        level: the confidence.
        block: how many neighbours are drawn together; 1 for independent values.
        circular: whether the first value is the neighbour of the last one.

    Returns:
        The interval of the ratio, without unit.

    Raises:
        ArgumentError: as :func:`bootstrap`, paired samples of different lengths, or a statistic of ``b``
            that is 0.
    """
    samples = [_sample(a), _sample(b)]
    if paired and len(samples[0]) != len(samples[1]):
        raise ArgumentError(f"paired samples must be of one length, not {len(samples[0])} and {len(samples[1])}")
    if float(statistic(samples[1])) == 0.0:
        raise ArgumentError("the ratio to a statistic of zero is not defined")
    return _interval(samples, [statistic, statistic], paired, rng, resamples, level, block, circular)


def block_length(values: ArrayLike) -> int:
    """Return how many neighbours of a curve to draw together, 1 where they are not correlated.

    This is the automatic choice of Politis & White (2004) for circular blocks, with the correction of
    Patton, Politis & White (2009): the correlation is followed to the lag where it is lost in the noise, and
    the length is the one with the least error of the variance of the mean. Never more than a third of the
    values, so that a resample has something to vary.

    Args:
        values: the curve (K,), at equal steps.

    Raises:
        ArgumentError: fewer than two values, or one that is not finite.
    """
    sample = _sample(values)
    n = len(sample)
    centred = sample - sample.mean()
    # Rounding of a constant curve is not a correlation.
    if n < 9 or np.abs(centred).max() <= 1e-12 * np.abs(sample).max():
        return 1
    quiet = max(5, math.ceil(math.sqrt(math.log10(n))))  # so many lags in a row without correlation
    lags = min(math.ceil(math.sqrt(n)) + quiet, n - 1)
    covariance = np.array([centred[: n - k] @ centred[k:] for k in range(lags + 1)]) / n
    significant = np.abs(covariance[1:] / covariance[0]) >= 2.0 * math.sqrt(math.log10(n) / n)
    last = int(np.flatnonzero(significant)[-1]) + 1 if significant.any() else 0
    for k in range(lags - quiet + 1):
        if not significant[k : k + quiet].any():
            last = k
            break
    width = min(2 * max(last, 1), lags)
    lag = np.arange(1, width + 1)
    window = np.minimum(1.0, 2.0 * (1.0 - lag / width))  # 1 to the middle, then falling to 0
    slope = 2.0 * float((window * lag * covariance[1 : width + 1]).sum())
    spectrum = float(covariance[0]) + 2.0 * float((window * covariance[1 : width + 1]).sum())
    if last == 0 or spectrum <= 0.0:
        # Without a positive spectrum at zero the formula has no answer; the correlation still has a reach.
        length = float(max(last, 1))
    else:
        length = (1.5 * slope**2 / spectrum**2) ** (1.0 / 3.0) * n ** (1.0 / 3.0)
    return int(min(max(round(length), 1), n // 3))


def _sample(values: ArrayLike) -> NDArray[np.float64]:
    sample = np.ascontiguousarray(values, dtype=np.float64)
    if sample.ndim != 1 or len(sample) < 2 or not np.isfinite(sample).all():
        raise ArgumentError("an interval needs a list of at least two finite values")
    return sample


def _interval(
    samples: list[NDArray[np.float64]],
    statistics: list[Statistic],
    paired: bool,
    rng: np.random.Generator,
    resamples: int,
    level: float,
    block: int,
    circular: bool,
) -> Interval:
    if resamples < 100:
        raise ArgumentError(f"an interval needs at least 100 resamples, not {resamples}")
    if not 0.0 < level < 1.0:
        raise ArgumentError(f"the level of an interval lies between 0 and 1, not at {level:g}")
    shortest = min(len(sample) for sample in samples)
    if not 1 <= block <= shortest // 2:
        raise ArgumentError(f"a block has 1 to {shortest // 2} of {shortest} values, not {block}")

    def combine(drawn: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        found = [statistic(values) for statistic, values in zip(statistics, drawn, strict=True)]
        return found[0] if len(found) == 1 else np.asarray(found[0] / found[1])

    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(combine(samples))
        if not math.isfinite(value):
            raise ArgumentError("the statistic is not defined on these values")
        draws = np.concatenate(list(_draws(samples, combine, paired, rng, resamples, block, circular)))
        influences = _influences(samples, combine, paired, block)
    # A resample on which the statistic is not defined (a ratio 0 / 0) says nothing.
    draws = np.sort(draws[~np.isnan(draws)])
    if len(draws) < resamples / 2:
        raise ArgumentError("the statistic is not defined on most resamples of these values")
    low, high = _bca(draws, value, influences, level)
    return Interval(value, low, high, level)


def _draws(
    samples: list[NDArray[np.float64]],
    combine: Callable[[list[NDArray[np.float64]]], NDArray[np.float64]],
    paired: bool,
    rng: np.random.Generator,
    resamples: int,
    block: int,
    circular: bool,
) -> list[NDArray[np.float64]]:
    """Return the statistic of all resamples, in chunks that fit the cache rather than the memory."""
    out = []
    step = max(1, _CHUNK // max(len(sample) for sample in samples))
    for begin in range(0, resamples, step):
        rows = min(step, resamples - begin)
        indices = _indices(len(samples[0]), rows, rng, block, circular)
        drawn = [samples[0][indices]]
        for sample in samples[1:]:
            drawn.append(sample[indices if paired else _indices(len(sample), rows, rng, block, circular)])
        out.append(combine(drawn))
    return out


def _indices(n: int, rows: int, rng: np.random.Generator, block: int, circular: bool) -> NDArray[np.int64]:
    """Return indices (rows, n) of resamples: runs of ``block`` neighbours, the last run cut to fit."""
    if block == 1:
        return rng.integers(0, n, (rows, n))
    runs = -(-n // block)
    starts = rng.integers(0, n if circular else n - block + 1, (rows, runs))
    indices = (starts[:, :, None] + np.arange(block)).reshape(rows, runs * block)[:, :n]
    return indices % n if circular else indices


def _influences(
    samples: list[NDArray[np.float64]],
    combine: Callable[[list[NDArray[np.float64]]], NDArray[np.float64]],
    paired: bool,
    block: int,
) -> NDArray[np.float64]:
    """Return what each group of neighbours adds to the statistic, by leaving it out (the jackknife)."""
    influences = []
    for i in range(1 if paired else len(samples)):
        n = len(samples[i])
        groups = min(max(n // block, 2), _GROUPS)
        edges = np.linspace(0, n, groups + 1).astype(np.int64)
        left = np.empty(groups)
        for g in range(groups):
            keep = np.ones(n, np.bool_)
            keep[edges[g] : edges[g + 1]] = False
            left[g] = combine([s[keep] if paired or k == i else s for k, s in enumerate(samples)])
        influences.append(left.mean() - left)
    return np.concatenate(influences)


def _bca(
    draws: NDArray[np.float64], value: float, influences: NDArray[np.float64], level: float
) -> tuple[float, float]:
    """Return the ends of the interval among the sorted ``draws``.

    Efron & Tibshirani, An Introduction to the Bootstrap, equations (14.9) to (14.15).
    """
    below = np.searchsorted(draws, value, "left")
    equal = np.searchsorted(draws, value, "right") - below
    # Draws equal to the value count half: a constant sample has no bias to correct.
    share = (float(below) + 0.5 * float(equal)) / len(draws)
    bias = _NORMAL.inv_cdf(min(max(share, 0.5 / len(draws)), 1.0 - 0.5 / len(draws)))
    size = float((influences**2).sum()) if np.isfinite(influences).all() else 0.0
    skew = float((influences**3).sum()) / (6.0 * size**1.5) if size > 0.0 else 0.0
    ends = []
    for tail in (0.5 * (1.0 - level), 0.5 * (1.0 + level)):
        z = bias + _NORMAL.inv_cdf(tail)
        stretched = 1.0 - skew * z
        share = _NORMAL.cdf(bias + z / stretched) if stretched > 0.0 else float(z > 0.0)
        # An order statistic, not a mean of two: a draw may be infinite (a ratio to nearly nothing).
        ends.append(float(draws[min(max(math.ceil(share * len(draws)) - 1, 0), len(draws) - 1)]))
    return ends[0], ends[1]
