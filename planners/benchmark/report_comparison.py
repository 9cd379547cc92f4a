"""Who wins what: every grid compared with the square or cubic ones, as verdicts, as a matrix and as a table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.experiments.report.elements import Compared, Outcome, Standing, Verdict
from hexmap.experiments.report.numbers import format_interval, format_number
from hexmap.experiments.report.report import Report
from hexmap.experiments.statistics import Interval, bootstrap_ratio
from hexmap.experiments.statistics import mean as mean_of
from planners.benchmark.report_words import compared_sizes, share_word
from planners.benchmark.result_group import ResultGroup
from planners.benchmark.settings import LEAST_QUERIES

__all__ = ["Comparison", "compare_grids", "length_verdicts", "report_comparison"]


@dataclass(frozen=True)
class _Measure:
    """A value of a group: its name in the report, whether more (1) or less (-1) of it is better, and its statistic."""

    key: str
    word: str
    better: int
    statistic: Callable[[FloatArray], FloatArray] = mean_of


def _median(values: FloatArray) -> FloatArray:
    return np.asarray(np.median(values, axis=-1))


_MEASURES = (
    _Measure("ratio", "length", -1),
    _Measure("turning", "turning", -1),
    _Measure("clearance", "least clearance", 1),
    _Measure("expansions", "expansions", -1),
)
# A few long queries would rule a mean of times; and times are never the same twice: they have a report of their own.
_TIME = _Measure("seconds", "median time", -1, _median)


@dataclass(frozen=True, eq=False)
class Comparison:
    """What became of one grid against another, by one measure.

    Attributes:
        dim, fraction: which comparison of the benchmark it belongs to.
        grid, against: labels of the two.
        measure: by what.
        ratio: how many times the second's value the first's is.
        standing: of the first: decided where the interval does not hold 1.
    """

    dim: int
    fraction: int
    grid: str
    against: str
    measure: str
    ratio: Interval
    standing: Standing


def compare_grids(groups: Sequence[ResultGroup], seed: int) -> list[Comparison]:
    """Compare every grid with the squares (cubes) of fewest and of most neighbours, and any-angle paths with theirs."""
    out: list[Comparison] = []
    for dim, fraction in compared_sizes(groups):
        mine = [x for x in groups if x.dim == dim and x.fraction == fraction]
        grids, free = ([x for x in mine if x.planner == planner] for planner in ("astar", "any_angle"))
        boxes = sorted((x for x in grids if _is_box(x)), key=lambda x: x.grid.moves)
        others = [x for x in grids if not _is_box(x)]
        pairs = [(x, box) for x in others for box in dict.fromkeys((boxes[0], boxes[-1]))] if boxes else []
        pairs += [(x, free[0]) for x in free[1:]]
        for a, b in pairs:
            for measure in (*_MEASURES, _TIME):
                ratio = _ratio(a, b, measure, seed)
                if ratio is not None:
                    better = (ratio.value > 1.0) == (measure.better > 0)
                    standing: Standing = "tie" if ratio.low <= 1.0 <= ratio.high else "win" if better else "lose"
                    out.append(Comparison(dim, fraction, a.label, b.label, measure.word, ratio, standing))
    return out


def _is_box(x: ResultGroup) -> bool:
    """Tell whether a lattice's cell is a square or a cube: as many faces as there are directions of axes."""
    lattice = x.grid.make()
    return len(lattice.faces) == 2 * lattice.dim


def _ratio(a: ResultGroup, b: ResultGroup, measure: _Measure, seed: int) -> Interval | None:
    """Return how many times ``b``'s value ``a``'s is on the same queries; None for too few or for zeros."""
    u, v = a.values[measure.key], b.values[measure.key]
    if len(u) != len(v) or len(u) < LEAST_QUERIES or not v.mean() > 0 or not u.mean() > 0:
        return None
    return bootstrap_ratio(u, v, measure.statistic, rng=np.random.default_rng([seed, 3]))


def length_verdicts(comparisons: Sequence[Comparison]) -> list[Verdict]:
    """Return a verdict for each pair of grids: whether the first plans shorter paths than the second."""
    lengths = [c for c in comparisons if c.measure == "length"]
    out = []
    for dim, grid, against in dict.fromkeys((c.dim, c.grid, c.against) for c in lengths):
        about = [c for c in lengths if (c.dim, c.grid, c.against) == (dim, grid, against)]
        won = sum(c.standing == "win" for c in about)
        lost = sum(c.standing == "lose" for c in about)
        outcome: Outcome = "does not hold" if lost else "undecided"
        if won:
            outcome = "holds" if won == len(about) else "holds in part"
        out.append(
            Verdict(
                f"{grid} plans shorter paths than {against}", f"{dim}D", outcome,
                "mean length over the other's on the same queries: holds where the interval lies below 1 at every cell "
                "size, in part where it does at some, undecided where it holds 1 at all",
                "; ".join(f"{format_interval(c.ratio)} times at {share_word(c.fraction)}" for c in about),
            )
        )  # fmt: skip
    return out


def report_comparison(report: Report, comparisons: Sequence[Comparison]) -> None:
    """Say who wins what, as a matrix and as a table of ratios; what is decided by times goes into their own report."""
    if not comparisons:
        return
    timed = [c for c in comparisons if c.measure == _TIME.word]
    by_length = [c for c in comparisons if c.measure != _TIME.word]
    rule = (
        "The number is how many times the second's value the first's is, on the same queries; won and lost where its "
        "95 % interval does not hold 1, as one in twenty would not by chance. Less is better but for clearance."
    )
    _add(report, by_length, "outcomes", "compare", f"{rule} Turning and clearance are those of one of many equally "
         "short paths.")  # fmt: skip
    report.times.heading("Who is faster")
    _add(report.times, timed, "outcomes_times", "compare_times", rule)


def _add(report: Report, comparisons: Sequence[Comparison], matrix: str, table: str, caption: str) -> None:
    # Measure by measure, each at all sizes.
    words = list(dict.fromkeys(c.measure for c in comparisons))
    by_column = sorted(comparisons, key=lambda c: (words.index(c.measure), c.fraction))
    for dim in dict.fromkeys(c.dim for c in comparisons):
        columns = [f"{c.measure}, {share_word(c.fraction)}" for c in by_column if c.dim == dim]
        cells: dict[str, dict[str, Compared | None]] = {}
        for c in comparisons:
            if c.dim == dim:
                line = cells.setdefault(f"{c.grid} against {c.against}", dict.fromkeys(columns))
                line[f"{c.measure}, {share_word(c.fraction)}"] = Compared(c.standing, _short(c.ratio.value))
        place = "In the plane" if dim == 2 else "In space"
        report.matrix(f"{matrix}_{dim}d", cells, "first against second", f"{place}. {caption}")
    rows: dict[tuple[Any, ...], dict[str, Any]] = {}
    for c in comparisons:
        about = {"dimension": c.dim, "cell": 1.0 / c.fraction, "grid": c.grid, "against": c.against}
        rows.setdefault(tuple(about.values()), about)[c.measure] = c.ratio
    columns = ["dimension", "cell", "grid", "against", *words]
    report.table(
        table, list(rows.values()),
        {name: "cell, source cells' edges" if name == "cell" else name for name in columns},
        formats=dict.fromkeys(words, ".3f") | {"cell": "g"},
        caption="The same with intervals: how many times the second's value the first's is.",
    )  # fmt: skip


def _short(ratio: float) -> str:
    """Return a ratio with as many digits as tell it from 1."""
    return format_number(ratio, ".2f" if abs(ratio - 1.0) >= 0.01 else ".4f")
