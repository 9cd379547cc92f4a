"""The section of the benchmark's report on lengths: by grid, map, distance and angle."""

from __future__ import annotations

import math
from math import nan
from typing import Any

import numpy as np

from hexmap.experiments.report.figures import COLOURS, figure_style
from hexmap.experiments.report.report import Report
from hexmap.experiments.statistics import Interval
from hexmap.paper.verdicts import mean_path_factor
from planners.benchmark.report_words import IntervalOf, compared_sizes, length_groups, optimum_word, size_word
from planners.benchmark.result_group import ResultGroup
from planners.benchmark.results import Results
from planners.benchmark.settings import LEAST_QUERIES

__all__ = ["report_lengths"]

_BINS = 4
_MARKERS = "osD^vP*Xhd"
_APART = 0.012  # of the distance, by which the markers of two grids are moved apart
_LEAST = 0.01  # per cent: on the scale of logarithms what is less stands at its foot
_STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)), (0, (3, 1, 1, 1)), (0, (7, 2)))


def report_lengths(report: Report, results: Results, groups: list[ResultGroup], interval: IntervalOf) -> None:
    """Report lengths over the optimum, for each dimension and cell size."""
    report.heading("Length")
    for dim, fraction in compared_sizes(groups):
        shown = length_groups(groups, dim, fraction)
        word = optimum_word(dim)
        rows = [_length_row(x, interval) for x in shown]
        formats = {c: ".4f" for c in ("mean", "median", "95 %", "worst", "best", "exact free-space mean")}
        report.table(
            f"length_{dim}d_{fraction}", rows, formats=formats,
            caption=f"Length over the {word}, at a resolution of {size_word(dim, fraction)}. A value below 1 is a "
            "path that cuts a corner within a cell.",
        )  # fmt: skip
        _by_map(report, results, shown, dim, fraction, interval)
        _by_distance(report, shown, dim, fraction, interval)
        _by_angle(report, shown, dim, fraction, interval)


def _length_row(x: ResultGroup, interval: IntervalOf) -> dict[str, Any]:
    ratio = x.values["ratio"]
    lattice = x.grid.make()
    exact = None if x.planner == "any_angle" else mean_path_factor(lattice, lattice.shell(x.grid.moves))
    return {
        "grid": x.label,
        "mean": interval(ratio),
        "median": float(np.median(ratio)),
        "95 %": float(np.quantile(ratio, 0.95)),
        "worst": float(ratio.max()),
        "best": float(ratio.min()),
        "exact free-space mean": exact,
        "queries": len(ratio),
    }


def _by_map(
    report: Report, results: Results, shown: list[ResultGroup], dim: int, fraction: int, interval: IntervalOf
) -> None:
    """Report the mean length of each map and grid."""
    rows = []
    for i, problems in enumerate(results.problem_sets):
        row: dict[str, Any] = {"map": problems.name}
        for x in shown:
            mine = x.values["ratio"][x.maps == i]
            if len(mine):
                row[x.label] = interval(mine)
        if len(row) > 1:
            rows.append(row)
    columns = ["map", *(x.label for x in shown)]
    report.table(
        f"length_by_map_{dim}d_{fraction}", rows, columns=columns, formats={c: ".4f" for c in columns[1:]},
        caption=f"The same by map, edge 1/{fraction}.",
    )  # fmt: skip


def _by_distance(report: Report, shown: list[ResultGroup], dim: int, fraction: int, interval: IntervalOf) -> None:
    """Report lengths by that of the optimum, in as many queries a bin, as a table and a figure."""
    from matplotlib.ticker import FuncFormatter, NullFormatter, ScalarFormatter

    optimum = shown[0].values["optimum"]
    edges = np.quantile(optimum, np.linspace(0, 1, _BINS + 1))
    bins = np.clip(np.searchsorted(edges, optimum, side="right") - 1, 0, _BINS - 1)
    middles = [float(optimum[bins == b].mean()) for b in range(_BINS) if (bins == b).any()]
    rows = []
    with figure_style():
        figure, axes = _axes()
        for k, x in enumerate(shown):
            row: dict[str, Any] = {"grid": x.label}
            found = []
            for b in range(_BINS):
                if not (bins == b).any():
                    continue
                row[f"{edges[b]:.1f} to {edges[b + 1]:.1f}"] = value = interval(x.values["ratio"][bins == b])
                found.append(value if isinstance(value, Interval) else Interval(value, nan, nan))
            rows.append(row)
            excess, lows, highs = (
                [nan if math.isnan(value) else max(100.0 * (value - 1.0), _LEAST) for value in values]
                for values in ([v.value for v in found], [v.low for v in found], [v.high for v in found])
            )
            low = [a - b for a, b in zip(excess, lows, strict=True)]
            high = [b - a for a, b in zip(excess, highs, strict=True)]
            # Apart from each other, so that no interval hides another one.
            at = [m * math.exp(_APART * (k - 0.5 * (len(shown) - 1))) for m in middles]
            sure = any(not math.isnan(end) for end in low)
            axes.errorbar(
                at, excess, yerr=[low, high] if sure else None, linestyle=_STYLES[k % len(_STYLES)],
                marker=_MARKERS[k % len(_MARKERS)],
                color=COLOURS[k % len(COLOURS)], label=x.label, capsize=2.5, linewidth=1.1, markersize=4.5,
            )  # fmt: skip
        axes.set_xscale("log")
        # Lines from a tenth of a per cent to a half: only on such a scale do they part.
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xticks([float(f"{m:.2g}") for m in middles])
        axes.set_xlabel(f"{optimum_word(dim)}, source cells")
        axes.set_ylabel(f"% longer than the {optimum_word(dim)}")
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=7.5)
    counts = [int((bins == b).sum()) for b in range(_BINS)]
    few = "" if min(counts) >= LEAST_QUERIES else f", none of fewer than {LEAST_QUERIES} queries"
    words = f"means with 95 % intervals{few}" if max(counts) >= LEAST_QUERIES else (
        f"means, without intervals: each is of fewer than {LEAST_QUERIES} queries"
    )  # fmt: skip
    report.table(
        f"distance_{dim}d_{fraction}", rows, formats={c: ".4f" for c in rows[0] if c != "grid"},
        caption=f"Length over the {optimum_word(dim)} by its length in source cells, edge 1/{fraction}; "
        f"{', '.join(map(str, counts))} queries.",
    )  # fmt: skip
    report.figure(
        f"distance_{dim}d_{fraction}", figure,
        f"By how much paths are longer than the {optimum_word(dim)}, by distance, edge 1/{fraction}: {words}, "
        f"on a scale of logarithms; no more than {_LEAST:g} % stands at its foot.",
    )  # fmt: skip


def _by_angle(report: Report, shown: list[ResultGroup], dim: int, fraction: int, interval: IntervalOf) -> None:
    """Report lengths by the angle of the map, where there are several."""
    angles = sorted({a for x in shown for a in x.by_angle})
    if len(angles) < 2:
        return
    rows = []
    for x in shown:
        row: dict[str, Any] = {"grid": x.label}
        for a in angles:
            if a in x.by_angle:
                row[f"{a:g}°"] = interval(x.by_angle[a])
        means = [float(v.mean()) for v in x.by_angle.values()]
        row["spread"] = max(means) - min(means)
        rows.append(row)
    report.table(
        f"angle_{dim}d_{fraction}", rows,
        columns=["grid", *(f"{a:g}°" for a in angles), "spread"],
        formats={c: ".4f" for c in ("spread", *(f"{a:g}°" for a in angles))},
        caption=f"Mean length over the {optimum_word(dim)} by the angle the map is turned by, edge 1/{fraction}.",
    )  # fmt: skip


def _axes() -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    return figure, figure.add_subplot()
