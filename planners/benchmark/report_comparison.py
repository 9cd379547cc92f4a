"""Who wins what: the section of the benchmark's report that compares every grid with the square or cubic one."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.experiments.report.numbers import format_number
from hexmap.experiments.report.report import Report
from hexmap.experiments.statistics import bootstrap_ratio
from hexmap.experiments.statistics import mean as mean_of
from planners.benchmark.report_words import compared_sizes, optimum_word, size_word
from planners.benchmark.result_group import ResultGroup

__all__ = ["report_comparison"]

# Value of a group, its name in the report, and whether more (1) or less (-1) of it is better.
_MEASURES = (
    ("ratio", "length", -1),
    ("turning", "turning", -1),
    ("clearance", "least clearance", 1),
    ("expansions", "expansions", -1),
    ("seconds", "median time", -1),
)


def report_comparison(report: Report, groups: list[ResultGroup], seed: int) -> None:
    """Say who wins what, the losses of the hexagon included, in plain words and as a table of ratios."""
    rows: list[dict[str, Any]] = []
    for dim, fraction in compared_sizes(groups):
        mine = {(x.grid.label, x.planner): x for x in groups if x.dim == dim and x.fraction == fraction}
        grids = [x for (_, planner), x in mine.items() if planner == "astar"]
        free = [x for (_, planner), x in mine.items() if planner == "any_angle"]
        boxes = sorted((x for x in grids if _is_box(x)), key=lambda x: x.grid.moves)
        others = [x for x in grids if not _is_box(x)]
        ranked = sorted(grids, key=lambda x: float(x.values["ratio"].mean()))
        order = ", ".join(_excess(x) for x in ranked)
        text = (
            f"At a resolution of {size_word(dim, fraction)}, A* on the moves of the grid, shortest first: {order} "
            f"over the {optimum_word(dim)}"
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
            claims = [f"wins {_listed(won)}"] if won else []
            claims += [f"loses {_listed(lost)}"] if lost else []
            sentences.append(f"Against {box.label}, {x.label} {' and '.join(claims) or 'is even in everything'}.")
        report.paragraph(" ".join(sentences))
    if rows:
        report.table(
            "compare", rows, formats={word: ".3f" for _, word, _ in _MEASURES},
            caption="How many times the second's value the first's is, on the same queries. Won and lost: where the "
            "interval does not hold 1, as one in twenty would by chance; less is better but for clearance. Turning and "
            "clearance are those of one of many equally short paths.",
        )  # fmt: skip


def _excess(x: ResultGroup) -> str:
    """Return a group with the per cent by which its paths are longer than the optimum."""
    return f"{x.label} {100 * (float(x.values['ratio'].mean()) - 1):.1f} %"


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


def _is_box(x: ResultGroup) -> bool:
    """Tell whether a lattice's cell is a square or a cube: as many faces as there are directions of axes."""
    lattice = x.grid.make()
    return len(lattice.faces) == 2 * lattice.dim


def _median(values: FloatArray) -> FloatArray:
    return np.asarray(np.median(values, axis=-1))


def _compared(a: ResultGroup, b: ResultGroup, seed: int) -> tuple[dict[str, Any], list[str], list[str]]:
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
