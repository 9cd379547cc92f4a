"""Lattices compared on the same scans: paired bootstrap, measure by measure."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.experiments.report.elements import Standing
from hexmap.experiments.statistics import Interval, block_length, bootstrap
from localisation.experiments.results import Results, Row, column, confidence, is_right
from localisation.experiments.settings import THRESHOLDS, Grid

__all__ = ["MEASURES", "Comparison", "Measure", "compare", "compare_all", "permutation_test", "risk_area", "sign_test"]

# Below it a test says that two samples differ.
_SIGNIFICANT = 0.05
# Intervals of fewer pairs are not made.
_LEAST = 4
# Pairs that are swapped in all ways.
_ENUMERATED = 10

Values: TypeAlias = FloatArray  # (K, c): the columns of K scans
Statistic: TypeAlias = Callable[[Values], FloatArray]  # (..., K, c) -> (...)


@dataclass(frozen=True)
class Measure:
    """Something by which two lattices are compared.

    Attributes:
        key: short name.
        label: in words.
        task, method: whose rows.
        better: 1 where more is better, -1 where less is.
        ratio: whether lattices are compared by a ratio, rather than a difference.
        values: the columns (K, c) of rows; pairs with NaN in them are left out.
        statistic: of columns.
        size: number of the perturbation, for local matching.
        equal_cells: whether it means something at equal cells only: larger ones are met more often by any scan.
    """

    key: str
    label: str
    task: str
    method: str
    better: int
    ratio: bool
    values: Callable[[Sequence[Row]], Values]
    statistic: Statistic
    size: int | None = None
    equal_cells: bool = False


@dataclass(frozen=True)
class Comparison:
    """What became of a lattice against the first one.

    Attributes:
        measure: by what.
        resolution, equal, rival, base: which two.
        there: the measure of the rival.
        here: that of the first lattice.
        interval: rival less first, or rival over first.
        pairs: scans (or starts) that were compared.
        outcome: "win", "tie" or "lose", of the rival.
    """

    measure: Measure
    resolution: float
    equal: str
    rival: str
    base: str
    there: float
    here: float
    interval: Interval
    pairs: int
    outcome: Standing


# ---------------------------------------------------------------------- columns and statistics


def _mean(values: Values) -> FloatArray:
    return np.asarray(values[..., 0].mean(axis=-1))


def _median(values: Values) -> FloatArray:
    return np.asarray(np.median(values[..., 0], axis=-1))


def risk_area(values: Values) -> FloatArray:
    """Return the area under the risk over the coverage: columns are whether an answer is right, and how sure it is.

    The share of wrong answers among the surest ones, averaged over how many of them are taken (Geifman and El-Yaniv
    2017); 0 where all answers are right.
    """
    order = np.argsort(-values[..., 1], axis=-1, kind="stable")
    wrong = 1.0 - np.take_along_axis(values[..., 0], order, axis=-1)
    taken = np.arange(1, wrong.shape[-1] + 1)
    return np.asarray((np.cumsum(wrong, axis=-1) / taken).mean(axis=-1))


def _off_95(values: Values) -> FloatArray:
    """Return by how much the share of errors inside the 95 % ellipses is not 0.95."""
    return np.asarray(np.abs((values[..., 0] <= 0.95).mean(axis=-1) - 0.95))


def _success(threshold: tuple[float, float]) -> Callable[[Sequence[Row]], Values]:
    return lambda rows: is_right(rows, threshold).astype(np.float64)[:, None]


def _of_right(key: str) -> Callable[[Sequence[Row]], Values]:
    """Return a column where the answer is right, NaN where it is not: of those that both find."""
    return lambda rows: np.where(is_right(rows), column(rows, key), math.nan)[:, None]


def _plain(key: str) -> Callable[[Sequence[Row]], Values]:
    return lambda rows: column(rows, key)[:, None]


def _risk(rows: Sequence[Row]) -> Values:
    return np.stack([is_right(rows).astype(np.float64), confidence(rows)], axis=1)


def _runs(rows: Sequence[Row], what: Callable[[list[Row]], float], key: str = "start") -> Values:
    """Return one number a run: what happens within one is not independent."""
    starts = dict.fromkeys(row[key] for row in rows)
    return np.array([[what([row for row in rows if row[key] == start])] for start in starts])


def _by_run(key: str) -> Callable[[Sequence[Row]], Values]:
    """Return the mean of a column over each mapping run."""
    return lambda rows: _runs(rows, lambda run: float(column(run, key).mean()), "run")


def _found_at_end(rows: Sequence[Row]) -> Values:
    return _runs(rows, lambda run: float(run[-1]["answered"] and is_right(run[-1:], THRESHOLDS[1])[0]))


def _false_answers(rows: Sequence[Row]) -> Values:
    return _runs(rows, lambda run: float(np.mean([row["answered"] and not is_right([row])[0] for row in run])))


def _scans_until(rows: Sequence[Row]) -> Values:
    """Return after how many scans a right answer came; one more than there were where none did."""

    def until(run: list[Row]) -> float:
        good = [row["answered"] and bool(is_right([row], THRESHOLDS[1])[0]) for row in run]
        return float(good.index(True) + 1 if any(good) else len(run) + 1)

    return _runs(rows, until)


def _measures() -> list[Measure]:
    anywhere = ("global", "all angles")
    out: list[Measure] = []
    for metres, degrees in THRESHOLDS:
        out.append(Measure(
            f"found {metres:g} m", f"scans found within {metres:g} m and {degrees:g}°", *anywhere, 1, False,
            _success((metres, degrees)), _mean,
        ))  # fmt: skip
    out += [
        Measure("error", "median error of those found, m", *anywhere, -1, True, _of_right("metres"), _median),
        Measure("turn", "median error of those found, °", *anywhere, -1, True, _of_right("degrees"), _median),
        Measure("risk", "area under risk over coverage", *anywhere, -1, False, _risk, risk_area),
        Measure("95 %", "distance from 95 % in the 95 % ellipses", *anywhere, -1, False, _of_right("within"),
                _off_95),
        Measure("nodes", "nodes of the search", *anywhere, -1, True, _plain("nodes"), _mean),
    ]  # fmt: skip
    return out


MEASURES: list[Measure] = [
    *_measures(),
    Measure("score", "variability of the score under rotation, sigma / mu", "rotation", "score", -1, True,
            _plain("variability"), _mean),
    Measure("localised", "robots localised at the end, within 0.25 m and 2°", "localise", "localiser", 1, False,
            _found_at_end, _mean),
    Measure("until", "scans until the right answer", "localise", "localiser", -1, True, _scans_until, _mean),
    Measure("false", "false answers, share of scans", "localise", "localiser", -1, False, _false_answers, _mean),
    Measure("filter", "robots localised by the particle filter", "localise", "particle filter", 1, False,
            _found_at_end, _mean),
    Measure("overlap", "held-out points on the walls of a map built on the grid", "mapping", "build", 1, False,
            _by_run("overlap"), _mean, equal_cells=True),
    Measure("trajectory", "mean error of a trajectory built on the grid, m", "mapping", "build", -1, True,
            _by_run("metres"), _mean),
]  # fmt: skip
"""Everything but local matching, which is compared for each size of the perturbation: :func:`local_measures`."""


def local_measures(sizes: Sequence[tuple[float, float]]) -> list[Measure]:
    """Return the measures of local matching from each perturbation of metres and degrees."""
    out: list[Measure] = []
    for number, (metres, degrees) in enumerate(sizes):
        start = f"from {metres:g} m and {degrees:g}° off"
        out += [
            Measure(f"local {metres:g} m", f"matched within 0.1 m and 1° {start}", "local", "local", 1, False,
                    _success(THRESHOLDS[0]), _mean, number),
            Measure(f"local error {metres:g} m", f"median error {start}, m", "local", "local", -1, True,
                    _of_right("metres"), _median, number),
        ]  # fmt: skip
    return out


# ---------------------------------------------------------------------- comparing


def sign_test(a: FloatArray, b: FloatArray) -> float:
    """Return how likely pairs (K,) of zeros and ones differ as unevenly as these by chance (McNemar's exact test)."""
    more, less = int((a > b).sum()), int((a < b).sum())
    n = more + less
    if n == 0:
        return 1.0
    tail = sum(math.comb(n, k) for k in range(min(more, less) + 1)) / 2**n
    return min(1.0, 2.0 * tail)


def permutation_test(u: Values, v: Values, statistic: Statistic, ratio: bool, block: int = 1, seed: int = 0) -> float:
    """Return how likely two paired samples (K, c) differ as much as they do, were it chance which of a pair is which.

    Pairs are swapped at random, ``block`` neighbours together, in all ways where there are few and in 2,000 ways else.
    """
    groups = -(-len(u) // block)
    if groups <= _ENUMERATED:
        swaps = (np.arange(2**groups)[:, None] >> np.arange(groups)) & 1
    else:
        swaps = np.random.default_rng([seed, 8]).integers(0, 2, (2000, groups))
        swaps[0] = 0  # as it is: never less likely than one in so many
    swapped = np.repeat(swaps, block, axis=1)[:, : len(u), None] == 1
    one, other = statistic(np.where(swapped, v, u)), statistic(np.where(swapped, u, v))
    with np.errstate(divide="ignore", invalid="ignore"):
        apart = np.abs(np.log(one / other)) if ratio else np.abs(one - other)
    # What is not defined speaks for chance.
    return float((~(apart < apart[0] * (1.0 - 1e-9))).mean())


def compare(
    measure: Measure, a: Sequence[Row], b: Sequence[Row], seed: int
) -> tuple[float, float, Interval, int, Standing] | None:
    """Compare rows of one grid with those of another on the same scans, in the order of the log.

    Returns:
        Both values, difference or ratio with its interval, the number of pairs, and what became of the first one; None
        where there are too few pairs or nothing is defined.
    """
    u, v = measure.values(a), measure.values(b)
    if len(u) != len(v):
        raise ArgumentError(f"{len(u)} and {len(v)} scans are no pairs")
    both = ~(np.isnan(u).any(axis=1) | np.isnan(v).any(axis=1))
    u, v = u[both], v[both]
    if len(u) < _LEAST:
        return None
    there, here = float(measure.statistic(u)), float(measure.statistic(v))
    if measure.ratio and not here > 0.0:
        return None

    def statistic(draw: FloatArray) -> FloatArray:
        k = draw.astype(np.int64)
        one, other = measure.statistic(u[k]), measure.statistic(v[k])
        return np.asarray(one / other if measure.ratio else one - other)

    # Neighbouring scans are alike: stretches of the log are drawn.
    block = max(1, min(block_length(u[:, 0] - v[:, 0]), len(u) // 2))
    interval = bootstrap(
        np.arange(len(u), dtype=np.float64), statistic, rng=np.random.default_rng([seed, 5]), block=block
    )
    even = 1.0 if measure.ratio else 0.0
    decided = not interval.low <= even <= interval.high
    # Where few pairs differ, or there are few, the bootstrap is too sure of them.
    decided = decided and permutation_test(u, v, measure.statistic, measure.ratio, block, seed) <= _SIGNIFICANT
    more = interval.value > even
    outcome: Standing = "tie" if not decided else "win" if more == (measure.better > 0) else "lose"
    return there, here, interval, len(u), outcome


def compare_all(results: Results) -> list[Comparison]:
    """Compare every lattice with the first at every resolution, by every measure of the tasks that were done."""
    out: list[Comparison] = []
    for measure in [*MEASURES, *local_measures(results.settings.perturbations)]:
        for resolution in results.settings.resolutions:
            base = results.base(resolution)
            first = _rows(results, measure, base)
            if not first:
                continue
            for rival in results.rivals(resolution):
                if measure.equal_cells and rival.equal != "cell":
                    continue
                found = compare(measure, _rows(results, measure, rival), first, results.settings.seed)
                if found is not None:
                    there, here, interval, pairs, outcome = found
                    out.append(Comparison(measure, resolution, rival.equal, rival.name, base.name, there, here,
                                          interval, pairs, outcome))  # fmt: skip
    return out


def _rows(results: Results, measure: Measure, grid: Grid) -> list[Row]:
    where = {} if measure.size is None else {"size": measure.size}
    return results.select(task=measure.task, method=measure.method, grid=grid.number, **where)
