"""The report of the planning benchmark: tables, figures, and who wins what in plain words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from hexmap.experiments.report.report import Report, Verdict
from hexmap.experiments.statistics import Interval, bootstrap
from hexmap.experiments.statistics import mean as mean_of
from planners.benchmark.report_comparison import compare_grids, length_verdicts, report_comparison
from planners.benchmark.report_effort import report_free_space, report_maps, report_measures, report_times
from planners.benchmark.report_lengths import report_lengths
from planners.benchmark.report_queries import report_queries
from planners.benchmark.report_words import IntervalOf, compared_sizes, optimum_word, share_word
from planners.benchmark.result_group import (
    BaselineRow,
    ResultGroup,
    baseline_rows,
    collect,
    kept_queries,
    reference_lengths,
)
from planners.benchmark.results import Results
from planners.benchmark.settings import LEAST_QUERIES, MOST_DROPPED, settings_table


@dataclass(frozen=True, eq=False)
class Outcome:
    """The report, and what makes the run a failure: nothing where the baseline check passed.

    Attributes:
        report: to be written.
        failures: sentences.
    """

    report: Report
    failures: list[str]

    __repr__ = one_line


def make_report(results: Results, command: str) -> Outcome:
    """Return the report of a run."""
    s = results.settings
    baseline, roots = baseline_rows(results)
    kept, optima = kept_queries(results), reference_lengths(results)
    groups = collect(results, kept, optima)
    interval = _interval(s.seed)
    names = ", ".join(problems.name for problems in results.problem_sets)
    report = Report(f"Planning on squares and hexagons, cubes, FCC and BCC: {names}", command, settings_table(s))

    _report_baseline(report, baseline)
    comparisons = compare_grids(groups, s.seed)
    report.heading("Verdicts")
    report.verdicts([*_baseline_verdict(baseline, roots), *length_verdicts(comparisons)])
    report.heading("Win, even, lose")
    report_comparison(report, comparisons)
    report.heading("The run in numbers")
    _report_queries(report, results, kept)
    report.table(
        "summary", _summary(baseline, kept, groups, interval),
        caption="Its first lines say whether the baseline check passed; edge 1/2: a resolution of half the source "
        "cell's edge.",
    )  # fmt: skip
    report_lengths(report, results, groups, interval)
    report_measures(report, groups, interval)
    report_times(report, results, groups, interval)
    report_free_space(report, results)
    report_maps(report, results, kept)
    report_queries(report, results, kept, optima)
    _report_differences(report, baseline)
    return Outcome(report, _failures(results, baseline, kept, groups))


def _interval(seed: int) -> IntervalOf:
    """Return the function that makes intervals, with random numbers of the seed alone."""

    def interval(values: FloatArray) -> Interval | float:
        value = float(values.mean()) if len(values) else math.nan
        if len(values) < LEAST_QUERIES:
            return value
        if np.ptp(values) == 0.0:
            return Interval(value, value, value)
        return bootstrap(values, mean_of, rng=np.random.default_rng([seed, 1]))

    return interval


def _counts(kept: list[NDArray[np.bool_]]) -> tuple[int, int]:
    """Return how many queries there are, and how many are dropped."""
    total = sum(len(k) for k in kept)
    return total, total - sum(int(k.sum()) for k in kept)


def _report_baseline(report: Report, baseline: list[BaselineRow]) -> None:
    """Say first whether the lengths on the source cells are the published ones."""
    if not baseline:
        report.paragraph("No map has published problems beside it: the lengths of the square grid are not checked.")
        return
    equal = sum(row.equal for row in baseline)
    different = len(baseline) - equal
    report.paragraph(
        f"{equal} of {len(baseline)} problems have the published length to the last published digit on the square or "
        f"cubic grid of the map itself (all neighbours, no corner cutting); {different} "
        + ("differ and are listed below." if different else "differ.")
    )


def _baseline_verdict(baseline: list[BaselineRow], roots: dict[str, str]) -> list[Verdict]:
    """Return the verdict on the published lengths; none where there are none."""
    if not baseline:
        return []
    equal = sum(row.equal for row in baseline)
    return [
        Verdict(
            "The published lengths come out to the last digit", "baseline",
            "holds" if equal == len(baseline) else "holds in part" if equal else "does not hold",
            "all published digits are the same, on the grid of the map itself, with all neighbours and no corner "
            "cutting; steps are counted in whole numbers, and a length is their sum with the roots its publisher used",
            f"{equal} of {len(baseline)}; roots: " + "; ".join(f"{name}: {which}" for name, which in roots.items()),
        )
    ]  # fmt: skip


def _report_queries(report: Report, results: Results, kept: list[NDArray[np.bool_]]) -> None:
    """Say which queries are compared, with what and how, and what is left out."""
    total, dropped = _counts(kept)
    report.paragraph(
        f"{total} queries, of which {dropped} are dropped everywhere because on some grid, angle or cell size their "
        "start and goal are not connected. Lengths run from the query's own start point to its own goal point, over "
        "the length of the true any-angle optimum on the source map, which may touch walls; in space, where no such "
        "optimum is at hand, over the shortest path that anything found here. Maps are rasterised by cell centre, "
        "and closed around points where blocked cells touch only there. Intervals are 95 % bootstrap intervals over "
        f"queries (BCa), each query the mean over the angles; means of fewer than {LEAST_QUERIES} queries have none. "
        "A grid is named by its lattice and its number of moves: A2-12 are hexagons with their 12 nearest neighbours."
    )
    for text in results.left_out:
        report.paragraph(f"Left out, larger than {results.settings.max_cells:,} cells: {text}.")


def _summary(
    baseline: list[BaselineRow], kept: list[NDArray[np.bool_]], groups: list[ResultGroup], interval: IntervalOf
) -> list[dict[str, Any]]:
    """Return the rows of the table of the run in numbers."""
    total, dropped = _counts(kept)
    rows: list[dict[str, Any]] = [{"quantity": "problems with a published length", "value": 0}]
    if baseline:
        equal = sum(row.equal for row in baseline)
        rows = [
            {"quantity": "problems equal to the published length", "value": equal},
            {"quantity": "problems different from it", "value": len(baseline) - equal},
        ]
    rows += [{"quantity": "queries", "value": total}, {"quantity": "queries dropped", "value": dropped}]
    for group in groups:
        if group.fraction > 1 and group.planner in ("astar", "any_angle"):
            about = f"length over the {optimum_word(group.dim)}: {group.label}, {share_word(group.fraction)}"
            rows.append({"quantity": about, "value": interval(group.values["ratio"])})
    return rows


def _report_differences(report: Report, baseline: list[BaselineRow]) -> None:
    """List the problems whose length is not the published one, if there are any."""
    rows = [
        {"map": row.map, "problem": row.problem, "published": row.published, "ours": f"{row.ours:.9f}"}
        for row in baseline
        if not row.equal
    ]
    if rows:
        report.heading("Lengths that differ from the published ones")
        report.table("differences", rows, caption="Every problem whose length differs in a published digit.", shown=50)


def _failures(
    results: Results, baseline: list[BaselineRow], kept: list[NDArray[np.bool_]], groups: list[ResultGroup]
) -> list[str]:
    """Return what makes the run a failure, in sentences."""
    failures: list[str] = []
    different = sum(not row.equal for row in baseline)
    if different:
        failures.append(f"{different} of {len(baseline)} lengths differ from the published ones")
    if not compared_sizes(groups):
        failures.append(f"nothing was compared: every window is larger than {results.settings.max_cells:,} cells")
    total, dropped = _counts(kept)
    if dropped > MOST_DROPPED * total:
        failures.append(f"{dropped} of {total} queries were dropped; at most {MOST_DROPPED:.0%} may be")
    return failures
