"""Every answer of the planning benchmark as a row of one table."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.experiments.report.report import Report
from planners.benchmark.results import Results

__all__ = ["QUERIES", "report_queries"]

QUERIES = "queries"
_AXES = "xyz"
_MEASURES = ("length", "cost", "turning", "clearance", "mean_clearance", "expansions", "pushes", "scanned")


def report_queries(
    report: Report, results: Results, kept: list[NDArray[np.bool_]], optima: list[FloatArray]
) -> None:
    """Add the table of all answers: one row a map, grid, cell size, angle, planner and query.

    ``kept`` says which queries count, ``optima`` what lengths are compared with, both by map.
    """
    report.heading("Every query")
    rows = [row for run in range(len(results.runs)) for row in _rows(results, run, kept, optima)]
    report.table(
        QUERIES, rows, columns=list(rows[0]) if rows else None, shown=0,
        caption="The answer of every planner to every query: the problem's number and source cells, the grid, its "
        "cell in edges of the source's, the map's angle (degrees), whether it is among those compared and whether "
        "there was a path; lengths, cost and clearances in metres, turning in radians.",
    )  # fmt: skip
    seconds = [row for run in range(len(results.runs)) for row in _rows(results, run, kept, optima, seconds=True)]
    report.times.table(
        f"{QUERIES}_times", seconds, columns=list(seconds[0]) if seconds else None, shown=0,
        caption=f"Seconds of every search, in the order of {QUERIES}.csv.",
    )  # fmt: skip


def _rows(
    results: Results, number: int, kept: list[NDArray[np.bool_]], optima: list[FloatArray], seconds: bool = False
) -> list[dict[str, Any]]:
    run = results.runs[number]
    problems = results.problem_sets[run.map]
    most = max(each.dim for each in results.runs)
    rows = []
    for planner, answers in run.answers.items():
        for q, answer in enumerate(answers):
            row: dict[str, Any] = {
                "map": problems.name, "problem": int(problems.problem[q]),
                "grid": results.settings.grids(run.dim)[run.lattice].label, "planner": planner,
                "cell": 1.0 / run.fraction, "degrees": run.degrees,
            }  # fmt: skip
            if seconds:
                rows.append({**row, "seconds": None if answer is None else answer.seconds})
                continue
            for end, cells in (("start", problems.starts), ("goal", problems.goals)):
                row |= {f"{end}_{_AXES[k]}": int(cells[q, k]) if k < run.dim else None for k in range(most)}
            best = float(optima[run.map][q])
            row |= {"compared": bool(kept[run.map][q]) and run.fraction > 1, "found": answer is not None}
            row["reference_length"] = best if math.isfinite(best) else None
            row |= {name: None if answer is None else getattr(answer, name) for name in _MEASURES}
            rows.append(row)
    return rows
