"""The sections of the benchmark's report on turning, clearance, effort, time, free space and the maps."""

from __future__ import annotations

import contextlib
import math
import os
import platform
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexmap.experiments.report.report import Report
from hexmap.paper.verdicts import mean_path_factor
from planners.benchmark.problem_set import free_cells
from planners.benchmark.report_words import IntervalOf, compared_sizes
from planners.benchmark.result_group import ResultGroup
from planners.benchmark.results import Results

__all__ = ["report_free_space", "report_maps", "report_measures", "report_times"]

_COMPETITION = (
    "For comparison, the grid-based path planning competition of 2023 (C++, its own machine and its own choice of "
    "problems, so no more than an order of magnitude): A* 90 ms a query, JPS2 0.79, JPS+ 0.53, Polyanya (any-angle, "
    "optimal) 1.47; there the octile optimum is 6.07 % longer than the any-angle optimum."
)


def report_measures(report: Report, groups: list[ResultGroup], interval: IntervalOf) -> None:
    """Report what paths and searches are like besides their length, by cell size, grid and planner."""
    report.heading("Turning, clearance, effort")
    for dim, fraction in compared_sizes(groups):
        rows, times = [], []
        for x in [y for y in groups if y.dim == dim and y.fraction == fraction]:
            v = x.values
            times.append({"grid": x.grid.label, "planner": x.planner, "ms": interval(v["seconds"])})
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
                    "graph, MB": x.megabytes,
                    "bytes a free cell": x.bytes_a_cell,
                }
            )
        formats = {
            "turning, degrees": ".0f", "least clearance": ".3f", "mean clearance": ".2f", "expansions": ".0f",
            "pushes": ".0f", "scanned": ".0f", "graph, MB": ".1f", "bytes a free cell": ".2f",
        }  # fmt: skip
        report.table(
            f"effort_{dim}d_{fraction}", rows, formats=formats,
            caption=f"Means a query, edge 1/{fraction}. Clearance: from the path (sampled every quarter of a "
            "source cell) to the nearest blocked source cell, in source cells. Planners other than A* and "
            "any-angle ran at the first angle only: compare rows of as many angles.",
        )  # fmt: skip
        report.times.table(
            f"ms_{dim}d_{fraction}", times, formats={"ms": ".3f"},
            caption=f"Milliseconds a query, edge 1/{fraction}, in the mean.",
        )  # fmt: skip


def report_times(report: Report, results: Results, groups: list[ResultGroup], interval: IntervalOf) -> None:
    """Report milliseconds a query on cells of the source's own size, by map, grid and planner."""
    report.paragraph("What the searches took is in the folder times.")
    report = report.times
    report.heading("Time on cells of the source's own size")
    report.paragraph(f"All times of this report were taken on {_machine()}; kept cases bring the times they took.")
    for dim in sorted({x.dim for x in groups}):
        shown = [x for x in groups if x.dim == dim and x.fraction == 1]
        if not shown:
            continue
        rows = []
        for i, problems in enumerate(results.problem_sets):
            for x in shown:
                mine = x.maps == i
                if mine.any():
                    ms = x.values["seconds"][mine]
                    rows.append(
                        {
                            "map": problems.name, "grid": x.grid.label, "planner": x.planner, "mean ms": interval(ms),
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
            times = [o.seconds[np.isfinite(o.seconds)] for o in results.optima if o is not None]
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


def report_free_space(report: Report, results: Results) -> None:
    """Report lengths where nothing stands in the way, exact and measured."""
    report.heading("Free space")
    rows = []
    for check in results.free_space:
        grid = results.settings.grids(check.dim)[check.lattice]
        lattice = grid.make()
        exact = mean_path_factor(lattice, lattice.shell(grid.moves))
        rows.append(
            {
                "grid": grid.label, "exact mean": exact, "measured mean": check.mean,
                "standard error": check.sd / math.sqrt(check.directions), "measured worst": check.worst,
                "radius, cells": check.radius, "directions": check.directions,
            }
        )  # fmt: skip
    report.table(
        "free_space", rows,
        formats={"exact mean": ".5f", "measured mean": ".5f", "standard error": ".5f", "measured worst": ".5f"},
        caption="Length by moves over the straight distance where nothing stands in the way: the mean over all "
        "directions, exactly (the gauge of the moves) and measured by Dijkstra in an empty window.",
    )  # fmt: skip


def report_maps(report: Report, results: Results, kept: list[NDArray[np.bool_]]) -> None:
    """Report the maps, with their queries and how many of them were dropped."""
    report.heading("The maps")
    rows = []
    for problems, use in zip(results.problem_sets, kept, strict=True):
        shape = problems.grid_map.states.shape
        rows.append(
            {
                "map": problems.name, "cells": " x ".join(str(v) for v in shape), "free": free_cells(problems),
                "cell, m": problems.grid_map.cell, "queries": len(use), "dropped": int((~use).sum()),
                "published problems": len(problems.texts),
            }
        )  # fmt: skip
    report.table("maps", rows, caption="What was planned in; queries of maps without problems of their own are random.")
