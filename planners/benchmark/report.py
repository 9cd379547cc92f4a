"""The report of the planning benchmark: tables, figures, and who wins what in plain words."""

from __future__ import annotations

import contextlib
import math
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.experiments.report.figures import COLOURS, figure_style
from hexmap.experiments.report.numbers import format_number
from hexmap.experiments.report.report import Report
from hexmap.experiments.statistics import Interval, bootstrap, bootstrap_ratio
from hexmap.experiments.statistics import mean as mean_of
from hexmap.paper.verdicts import mean_path_factor
from planners.benchmark.course import free_cells
from planners.benchmark.results import Results
from planners.benchmark.series import Series, collect, kept_queries, optima, ruler_rows
from planners.benchmark.settings import LEAST_QUERIES, MOST_DROPPED, settings_table

_BINS = 4
_STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)), (0, (3, 1, 1, 1)), (0, (7, 2)))
_COMPETITION = (
    "For comparison, the grid-based path planning competition of 2023 (C++, its own machine and its own choice of "
    "problems, so no more than an order of magnitude): A* 90 ms a query, JPS2 0.79, JPS+ 0.53, Polyanya (any-angle, "
    "optimal) 1.47; there the octile optimum is 6.07 % longer than the any-angle optimum."
)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The report, and what makes the run a failure: nothing where the ruler is straight.

    Attributes:
        report: to be written.
        failures: sentences.
    """

    report: Report
    failures: list[str]


def make_report(results: Results, command: str) -> Outcome:
    """Return the report of a run."""
    s = results.settings
    ruler, roots = ruler_rows(results)
    kept = kept_queries(results)
    best = optima(results)
    series = collect(results, kept, best)
    failures: list[str] = []

    def interval(values: FloatArray) -> Interval:
        if len(values) < 2 or np.ptp(values) == 0.0:
            value = float(values.mean()) if len(values) else math.nan
            return Interval(value, value, value)
        return bootstrap(values, mean_of, rng=np.random.default_rng([s.seed, 1]))

    names = ", ".join(course.name for course in results.courses)
    report = Report(f"Planning on squares and hexagons, cubes, FCC and BCC: {names}", command, settings_table(s))

    equal = sum(row.equal for row in ruler)
    different = len(ruler) - equal
    if ruler:
        report.paragraph(
            f"{equal} of {len(ruler)} problems have the published length to the last published digit on the square or "
            f"cubic grid of the map itself (all neighbours, no corner cutting); {different} "
            + ("differ and are listed below." if different else "differ.")
            + " Steps are counted in whole numbers; a length is their sum with the roots its publisher used ("
            + "; ".join(f"{name}: {which}" for name, which in roots.items())
            + ")."
        )
    else:
        report.paragraph("No map has published problems beside it: the lengths of the square grid are not checked.")
    if different:
        failures.append(f"{different} of {len(ruler)} lengths differ from the published ones")

    if not _parts(series):
        failures.append(f"nothing was compared: every window is larger than {s.max_cells:,} cells")
    total = sum(len(k) for k in kept)
    dropped = total - sum(int(k.sum()) for k in kept)
    if dropped > MOST_DROPPED * total:
        failures.append(f"{dropped} of {total} queries were dropped; at most {MOST_DROPPED:.0%} may be")
    report.paragraph(
        f"{total} queries, of which {dropped} are dropped everywhere because on some grid, angle or cell size their "
        "start and goal are not connected. Lengths run from the query's own start point to its own goal point, over "
        "the length of the true any-angle optimum on the source map, which may touch walls; in space, where no such "
        "optimum is at hand, over the shortest path that anything found here. Worlds are rasterised by cell centre, "
        "and closed around points where blocked cells touch only there. Intervals are 95 % bootstrap intervals over "
        "queries (BCa), each query the mean over the angles. A grid is named by its lattice and its number of moves: "
        "A2-12 are hexagons with their 12 nearest neighbours."
    )
    for text in results.left_out:
        report.paragraph(f"Left out, larger than {s.max_cells:,} cells: {text}.")

    summary: list[dict[str, Any]] = [
        *(
            [
                {"quantity": "problems equal to the published length", "value": equal},
                {"quantity": "problems different from it", "value": different},
            ]
            if ruler
            else [{"quantity": "problems with a published length", "value": 0}]
        ),
        {"quantity": "queries", "value": total},
        {"quantity": "queries dropped", "value": dropped},
    ]
    for one in series:
        if one.fraction > 1 and one.planner in ("astar", "any_angle"):
            summary.append(
                {
                    "quantity": f"length over the {_optimum_word(one.dim)}: {one.label}, edge 1/{one.fraction}",
                    "value": interval(one.values["ratio"]),
                }
            )
    report.heading("Who wins what")
    _verdict(report, series, s.seed)
    report.table(
        "summary",
        summary,
        caption="The run in numbers. Its first lines say whether the ruler is straight; edge 1/2: a resolution of half "
        "the source cell's edge.",
    )

    _lengths(report, results, series, interval)
    _other_measures(report, series, interval)
    _times(report, results, series, interval)
    _free_space(report, results)
    _maps(report, results, kept)
    rows = [
        {
            "map": row.map, "problem": row.problem, "published": row.published, "ours": f"{row.ours:.9f}",
        }
        for row in ruler if not row.equal
    ]  # fmt: skip
    if rows:
        report.heading("Lengths that differ from the published ones")
        report.table("differences", rows, caption="Every problem whose length differs in a published digit.", shown=50)
    return Outcome(report, failures)


def _optimum_word(dim: int) -> str:
    return "any-angle optimum" if dim == 2 else "best path found"


def _size_word(dim: int, fraction: int) -> str:
    part = f"1/{fraction**dim} of its {'area' if dim == 2 else 'volume'}"
    return f"1/{fraction} of the source cell's edge (cells of {part}, whatever their shape)"


def _shown(series: Sequence[Series], dim: int, fraction: int) -> list[Series]:
    """Return the series that lengths are shown of: each grid once, and its any-angle paths."""
    return [x for x in series if x.dim == dim and x.fraction == fraction and x.planner in ("astar", "any_angle")]


def _parts(series: Sequence[Series]) -> list[tuple[int, int]]:
    return sorted({(x.dim, x.fraction) for x in series if x.fraction > 1})


def _lengths(report: Report, results: Results, series: list[Series], interval: Any) -> None:
    report.heading("Length")
    for dim, fraction in _parts(series):
        shown = _shown(series, dim, fraction)
        word = _optimum_word(dim)
        rows = []
        for x in shown:
            ratio = x.values["ratio"]
            rows.append(
                {
                    "grid": x.label,
                    "mean": interval(ratio),
                    "median": float(np.median(ratio)),
                    "95 %": float(np.quantile(ratio, 0.95)),
                    "worst": float(ratio.max()),
                    "best": float(ratio.min()),
                    "exact free-space mean": None
                    if x.planner == "any_angle"
                    else mean_path_factor(x.grid.make(), x.grid.make().shell(x.grid.moves)),
                    "queries": len(ratio),
                }
            )
        formats = {c: ".4f" for c in ("mean", "median", "95 %", "worst", "best", "exact free-space mean")}
        report.table(
            f"length_{dim}d_{fraction}", rows, formats=formats,
            caption=f"Length over the {word}, at a resolution of {_size_word(dim, fraction)}. A value below 1 is a "
            "path that cuts a corner within a cell.",
        )  # fmt: skip
        by_map = []
        for i, course in enumerate(results.courses):
            row: dict[str, Any] = {"map": course.name}
            for x in shown:
                mine = x.values["ratio"][x.maps == i]
                if len(mine):
                    row[x.label] = interval(mine)
            if len(row) > 1:
                by_map.append(row)
        columns = ["map", *(x.label for x in shown)]
        report.table(
            f"length_by_map_{dim}d_{fraction}", by_map, columns=columns, formats={c: ".4f" for c in columns[1:]},
            caption=f"The same by map, edge 1/{fraction}.",
        )  # fmt: skip
        _by_distance(report, shown, dim, fraction, interval)
        _by_angle(report, shown, dim, fraction, interval)


def _by_distance(report: Report, shown: list[Series], dim: int, fraction: int, interval: Any) -> None:
    from matplotlib.ticker import NullFormatter, ScalarFormatter

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
                found.append(value if (bins == b).sum() >= LEAST_QUERIES else replace(value, low=nan, high=nan))
            rows.append(row)
            low = [v.value - v.low for v in found]
            high = [v.high - v.value for v in found]
            axes.errorbar(
                middles, [v.value for v in found], yerr=[low, high], linestyle=_STYLES[k % len(_STYLES)],
                color=COLOURS[k % len(COLOURS)], label=x.label, capsize=2, linewidth=1.2,
            )  # fmt: skip
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(ScalarFormatter())
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.set_xticks([float(f"{m:.2g}") for m in middles])
        axes.set_xlabel(f"{_optimum_word(dim)}, source cells")
        axes.set_ylabel(f"length / {_optimum_word(dim)}")
        axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=7.5)
    report.table(
        f"distance_{dim}d_{fraction}", rows, formats={c: ".4f" for c in rows[0] if c != "grid"},
        caption=f"Length over the {_optimum_word(dim)} by its length in source cells, edge 1/{fraction}; "
        f"{', '.join(str(int((bins == b).sum())) for b in range(_BINS))} queries.",
    )  # fmt: skip
    report.figure(f"distance_{dim}d_{fraction}", figure, f"Length by distance, edge 1/{fraction}.")


def _by_angle(report: Report, shown: list[Series], dim: int, fraction: int, interval: Any) -> None:
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
        caption=f"Mean length over the {_optimum_word(dim)} by the angle the map is turned by, edge 1/{fraction}.",
    )  # fmt: skip


def _axes() -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    return figure, figure.add_subplot()


def _other_measures(report: Report, series: list[Series], interval: Any) -> None:
    report.heading("Turning, clearance, effort")
    for dim, fraction in _parts(series):
        rows = []
        for x in [y for y in series if y.dim == dim and y.fraction == fraction]:
            v = x.values
            rows.append(
                {
                    "grid": x.grid.label,
                    "planner": x.planner,
                    "angles": len(x.by_angle),
                    "turning, degrees": interval(v["turning"]),
                    "least clearance": interval(v["clearance"]),
                    "mean clearance": interval(v["mean_clearance"]),
                    "expansions": interval(v["expansions"]),
                    "pushes": interval(v["pushes"]),
                    "scanned": interval(v["scanned"]),
                    "ms": interval(v["seconds"]),
                    "graph, MB": x.megabytes,
                    "bytes a free cell": x.bytes_a_cell,
                }
            )
        formats = {
            "turning, degrees": ".0f", "least clearance": ".3f", "mean clearance": ".2f", "expansions": ".0f",
            "pushes": ".0f", "scanned": ".0f", "ms": ".3f", "graph, MB": ".1f", "bytes a free cell": ".2f",
        }  # fmt: skip
        report.table(
            f"effort_{dim}d_{fraction}", rows, formats=formats,
            caption=f"Means a query, edge 1/{fraction}. Clearance: from the path (sampled every quarter of a "
            "source cell) to the nearest blocked source cell, in source cells. Planners other than A* and "
            "any-angle ran at the first angle only: compare rows of as many angles.",
        )  # fmt: skip


def _times(report: Report, results: Results, series: list[Series], interval: Any) -> None:
    """Milliseconds a query on cells of the source's own size, by map, grid and planner."""
    report.heading("Time on cells of the source's own size")
    report.paragraph(f"All times of this report were taken on {_machine()}; kept cases bring the times they took.")
    for dim in sorted({x.dim for x in series}):
        shown = [x for x in series if x.dim == dim and x.fraction == 1]
        if not shown:
            continue
        rows = []
        for i, course in enumerate(results.courses):
            for x in shown:
                mine = x.maps == i
                if mine.any():
                    ms = x.values["seconds"][mine]
                    rows.append(
                        {
                            "map": course.name, "grid": x.grid.label, "planner": x.planner, "mean ms": interval(ms),
                            "median ms": float(np.median(ms)), "expansions": float(x.values["expansions"][mine].mean()),
                            "pushes": float(x.values["pushes"][mine].mean()),
                            "scanned": float(x.values["scanned"][mine].mean()),
                        }
                    )  # fmt: skip
        report.table(
            f"time_{dim}d", rows,
            formats={"mean ms": ".3f", "median ms": ".3f", "expansions": ".0f", "pushes": ".0f", "scanned": ".0f"},
            caption="Milliseconds a query, warm, the search alone, on the queries that are connected on every grid. At "
            "this size lattices other than the map's own may leak through walls of one cell, which may flatter their "
            "times; lengths would be wrong, and none are given.",
        )  # fmt: skip
        if dim == 2:
            times = [t[np.isfinite(t)] for t in results.optimum_seconds if t is not None]
            if times:
                report.paragraph(
                    f"The any-angle optimum itself took {1e3 * float(np.concatenate(times).mean()):.2f} ms a query in "
                    f"the mean. {_COMPETITION}"
                )


def _machine() -> str:
    """Return the processor's name and how many there are."""
    name = platform.processor() or platform.machine()
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                name = line.partition(":")[2].strip()
                break
    return f"{os.cpu_count()} x {name}"


def _free_space(report: Report, results: Results) -> None:
    report.heading("Free space")
    rows = []
    for case in results.open:
        grid = results.settings.grids(case["dim"])[case["lattice"]]
        lattice = grid.make()
        exact = mean_path_factor(lattice, lattice.shell(grid.moves))
        rows.append(
            {
                "grid": grid.label, "exact mean": exact, "measured mean": case["mean"],
                "standard error": case["sd"] / math.sqrt(case["directions"]), "measured worst": case["worst"],
                "radius, cells": case["radius"], "directions": case["directions"],
            }
        )  # fmt: skip
    report.table(
        "free_space", rows,
        formats={"exact mean": ".5f", "measured mean": ".5f", "standard error": ".5f", "measured worst": ".5f"},
        caption="Length by moves over the straight distance where nothing stands in the way: the mean over all "
        "directions, exactly (the gauge of the moves) and measured by Dijkstra in an empty window.",
    )  # fmt: skip


def _maps(report: Report, results: Results, kept: list[NDArray[np.bool_]]) -> None:
    report.heading("The maps")
    rows = []
    for course, use in zip(results.courses, kept, strict=True):
        shape = course.world.states.shape
        rows.append(
            {
                "map": course.name, "cells": " x ".join(str(v) for v in shape), "free": free_cells(course),
                "cell, m": course.world.cell, "queries": len(use), "dropped": int((~use).sum()),
                "published problems": len(course.texts),
            }
        )  # fmt: skip
    report.table("maps", rows, caption="What was planned in; queries of maps without problems of their own are random.")


_MEASURES = (
    ("ratio", "length", -1),
    ("turning", "turning", -1),
    ("clearance", "least clearance", 1),
    ("expansions", "expansions", -1),
    ("seconds", "median time", -1),
)


def _verdict(report: Report, series: list[Series], seed: int) -> None:
    """Say who wins what, the losses of the hexagon included, in plain words and as a table of ratios."""
    rows: list[dict[str, Any]] = []
    for dim, fraction in _parts(series):
        mine = {(x.grid.label, x.planner): x for x in series if x.dim == dim and x.fraction == fraction}
        grids = [x for (_, planner), x in mine.items() if planner == "astar"]
        free = [x for (_, planner), x in mine.items() if planner == "any_angle"]
        boxes = sorted((x for x in grids if _is_box(x)), key=lambda x: x.grid.moves)
        others = [x for x in grids if not _is_box(x)]
        ranked = sorted(grids, key=lambda x: float(x.values["ratio"].mean()))
        order = ", ".join(_excess(x) for x in ranked)
        text = (
            f"At a resolution of {_size_word(dim, fraction)}, A* on the moves of the grid, shortest first: {order} "
            f"over the {_optimum_word(dim)}"
        )
        if free:
            text += f"; any-angle paths: {', '.join(_excess(x) for x in free)}"
        sentences = [text + "."]
        pairs = [(x, box) for x in others for box in dict.fromkeys((boxes[0], boxes[-1]))] if boxes else []
        pairs += [(x, free[0]) for x in free[1:]]
        for x, box in pairs:
            row, won, lost = _compared(x, box, seed)
            rows.append({"dimension": dim, "edge": f"1/{fraction}", **row})
            if x.planner == "any_angle" and not (won or lost):
                continue
            parts = [f"wins {_listed(won)}"] if won else []
            parts += [f"loses {_listed(lost)}"] if lost else []
            sentences.append(f"Against {box.label}, {x.label} {' and '.join(parts) or 'is even in everything'}.")
        report.paragraph(" ".join(sentences))
    if rows:
        report.table(
            "compare", rows, formats={word: ".3f" for _, word, _ in _MEASURES},
            caption="How many times the second's value the first's is, on the same queries. Won and lost: where the "
            "interval does not hold 1, as one in twenty would by chance; less is better but for clearance. Turning and "
            "clearance are those of one of many equally short paths.",
        )  # fmt: skip


def _excess(x: Series) -> str:
    return f"{x.label} {100 * (float(x.values['ratio'].mean()) - 1):.1f} %"


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _is_box(x: Series) -> bool:
    """Tell whether a lattice's cell is a square or a cube: as many faces as there are directions of axes."""
    lattice = x.grid.make()
    return len(lattice.faces) == 2 * lattice.dim


def _median(values: FloatArray) -> FloatArray:
    return np.asarray(np.median(values, axis=-1))


def _compared(a: Series, b: Series, seed: int) -> tuple[dict[str, Any], list[str], list[str]]:
    """Return the ratios of ``a`` to ``b`` on the same queries, and what it wins and loses."""
    row: dict[str, Any] = {"grid": a.label, "against": b.label}
    won: list[str] = []
    lost: list[str] = []
    for key, word, good in _MEASURES:
        u, v = a.values[key], b.values[key]
        if len(u) != len(v) or len(u) < 2 or not v.mean() > 0 or not u.mean() > 0:
            continue
        statistic = _median if key == "seconds" else mean_of  # a few long queries would rule a mean of times
        row[word] = ratio = bootstrap_ratio(u, v, statistic, rng=np.random.default_rng([seed, 3]))
        if not ratio.low <= 1.0 <= ratio.high:
            digits = ".2f" if abs(ratio.value - 1.0) >= 0.01 else ".4f"
            shown = f"{word} ({format_number(ratio.value, digits)} times)"
            (won if (ratio.value > 1.0) == (good > 0) else lost).append(shown)
    row["won"], row["lost"] = (
        ", ".join(w.partition(" (")[0] for w in won),
        ", ".join(w.partition(" (")[0] for w in lost),
    )
    return row, won, lost
