"""What the experiment cost: a report of its own, because times are never the same twice."""

from __future__ import annotations

from typing import Any

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.experiments.report.report import Report
from hexmap.experiments.statistics import Interval, bootstrap_ratio
from localisation.experiments.results import Results, column

__all__ = ["make_times"]


def make_times(results: Results, command: str = "") -> Report:
    """Return the report of processor seconds, of one thread, by task, method and grid."""
    report = Report(f"Localisation on lattices, times: {results.world.source}", command, results.settings.table())
    report.paragraph(
        "Processor time of the process that computed a case, one thread, in milliseconds a scan; the maps and tables "
        "are there before. Where other work runs beside it, times are longer; their ratios suffer less."
    )
    rows: list[dict[str, Any]] = []
    for task in results.settings.tasks:
        for method in results.methods(task):
            for resolution in results.settings.resolutions:
                base = results.base(resolution)
                first = column(results.select(task=task, method=method, grid=base.number), "cpu")
                for grid in [base, *results.rivals(resolution)]:
                    cpu = column(results.select(task=task, method=method, grid=grid.number), "cpu")
                    if not np.isfinite(cpu).any():
                        continue
                    rows.append({
                        "task": task, "method": method, "m": resolution, "grid": grid.label,
                        "median": 1e3 * float(np.nanmedian(cpu)), "95 %": 1e3 * float(np.nanpercentile(cpu, 95)),
                        f"over {base.name}": None if grid is base else _ratio(cpu, first, results.settings.seed),
                    })  # fmt: skip
    report.table(
        "times", rows, formats={"median": ",.1f", "95 %": ",.1f", "m": "g"},
        caption="Milliseconds a scan (build: a whole mapping run), and the ratio of the medians on the same scans "
        "with its bootstrap interval. The first of a kind may have compiled its kernels.",
    )  # fmt: skip
    return report


def _ratio(a: FloatArray, b: FloatArray, seed: int) -> Interval | None:
    """Return the ratio of the medians of pairs, None where there are too few."""
    if len(a) != len(b) or len(a) < 8 or not np.isfinite([a, b]).all() or not np.median(b) > 0.0:
        return None
    return bootstrap_ratio(a, b, _median, rng=np.random.default_rng([seed, 7]))


def _median(values: FloatArray) -> FloatArray:
    return np.asarray(np.median(values, axis=-1))
