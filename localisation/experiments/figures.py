"""The figures of the localisation experiment: a panel a resolution, a colour a lattice."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hexmap.experiments.report.figures import COLOURS, figure_style
from localisation.experiments.results import Results, column, confidence, is_right
from localisation.experiments.settings import LEARNING_AXES, THRESHOLDS, Grid

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["learning_curves", "local_curves", "risk_curves", "run_curves", "success_curves"]

_STYLES = {"cell": "-", "radius": "--"}
_FAINT = 0.5  # of the lines of a baseline
_PALER = 0.45  # of white in the colour of a lattice at equal covering radius
_WHOLE = 1.03  # of shares: a line at 1 is seen whole
_AXIS_WORDS = {
    "scans": "share of scans in the map", "beams": "share of beams kept", "range": "range, m",
    "changed": "share of walls changed",
}  # fmt: skip


def _width(results: Results, grid: Grid, width: float = 1.6) -> float:
    """Return the width of a line: the first lattice's is wider, to be seen under an equal one."""
    return width if grid.name != results.grids[0].name else 1.7 * width


def _colour(results: Results, grid: Grid) -> tuple[float, float, float]:
    """Return the colour of a lattice, paler at equal covering radius."""
    from matplotlib.colors import to_rgb

    names = list(dict.fromkeys(g.name for g in results.grids))
    paler = 0.0 if grid.equal == "cell" else _PALER
    red, green, blue = (v + paler * (1.0 - v) for v in to_rgb(COLOURS[names.index(grid.name) % len(COLOURS)]))
    return red, green, blue


def _panels(results: Results, draw: Callable[[Any, Grid], None], across: str, up: str) -> Figure:
    """Return a figure with a panel for each resolution, in which ``draw`` draws each grid."""
    from matplotlib.figure import Figure

    sizes = results.settings.resolutions
    with figure_style():
        figure = Figure(figsize=(1.4 + 2.9 * len(sizes), 3.0), layout="constrained")
        axes = np.atleast_1d(figure.subplots(1, len(sizes), sharey=True, squeeze=False)[0])
        for panel, resolution in zip(axes, sizes, strict=True):
            for grid in results.grids:
                if grid.resolution == resolution:
                    draw(panel, grid)
            panel.set_title(f"{resolution:g} m")
            panel.set_xlabel(across)
        axes[0].set_ylabel(up)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    return figure


def _words(threshold: tuple[float, float]) -> str:
    return f"within {threshold[0]:g} m and {threshold[1]:g}°"


def success_curves(results: Results, task: str) -> Figure:
    """Return the share of scans found over the distance that is allowed."""
    metres = np.geomspace(0.003, 2.0, 150)

    def draw(panel: Any, grid: Grid) -> None:
        for method, width, alpha in (("all angles", 1.6, 1.0), ("angle set", 1.0, _FAINT)):
            rows = results.select(task=task, grid=grid.number, method=method)
            off = np.where(column(rows, "degrees") <= THRESHOLDS[-1][1], column(rows, "metres"), np.inf)
            panel.semilogx(
                metres, [float((off <= m).mean()) for m in metres], _STYLES[grid.equal], color=_colour(results, grid),
                linewidth=_width(results, grid, width), alpha=alpha,
                label=grid.label if method == "all angles" else f"{grid.label}, angle set",
            )  # fmt: skip
        panel.set_ylim(0.0, _WHOLE)
        panel.set_xticks([0.01, 0.1, 1.0], ["0.01", "0.1", "1"])

    return _panels(results, draw, "metres allowed", f"share of scans found\n(and within {THRESHOLDS[-1][1]:g}°)")


def risk_curves(results: Results, task: str) -> Figure:
    """Return the share of wrong answers among the surest, of the first method of a task and thinner of the second."""
    methods = results.methods(task)[: 1 if task == "global" else 2]

    def draw(panel: Any, grid: Grid) -> None:
        for method, width, alpha in zip(methods, (1.6, 1.0), (1.0, _FAINT), strict=False):
            rows = results.select(task=task, grid=grid.number, method=method)
            order = np.argsort(-confidence(rows), kind="stable")
            wrong = 1.0 - is_right(rows)[order]
            taken = np.arange(1, len(wrong) + 1)
            label = grid.label if method == methods[0] else f"{grid.label}, filter"
            panel.plot(taken / len(wrong), np.cumsum(wrong) / taken, _STYLES[grid.equal], color=_colour(results, grid),
                       linewidth=_width(results, grid, width), alpha=alpha, label=label)  # fmt: skip
        panel.set_xlim(0.0, 1.0)
        panel.set_ylim(-0.02, max(0.3, panel.get_ylim()[1]))

    return _panels(results, draw, "share of scans answered, the surest first", "share of wrong answers")


def local_curves(results: Results) -> Figure:
    """Return the share of scans matched by the size of the perturbation."""
    sizes = [metres for metres, _ in results.settings.perturbations]

    def draw(panel: Any, grid: Grid) -> None:
        shares = [
            float(is_right(results.select(task="local", grid=grid.number, size=k), THRESHOLDS[0]).mean())
            for k in range(len(sizes))
        ]
        panel.plot(sizes, shares, _STYLES[grid.equal], marker="o", color=_colour(results, grid), label=grid.label,
                   linewidth=_width(results, grid))  # fmt: skip
        panel.set_ylim(0.0, _WHOLE)

    return _panels(results, draw, "start off by, m", f"share of scans matched\n({_words(THRESHOLDS[0])})")


def run_curves(results: Results) -> Figure:
    """Return the share of robots with a right answer over the scans they have seen."""

    def draw(panel: Any, grid: Grid) -> None:
        for method, width, alpha in (("localiser", 1.6, 1.0), ("particle filter", 1.0, _FAINT)):
            rows = results.select(task="localise", grid=grid.number, method=method)
            if not rows:
                continue
            good = is_right(rows, THRESHOLDS[1]) & (column(rows, "answered") > 0)
            steps = column(rows, "step")
            along = np.unique(steps)
            label = grid.label if method == "localiser" else f"{grid.label}, filter"
            panel.plot(along + 1, [float(good[steps == k].mean()) for k in along], _STYLES[grid.equal],
                       color=_colour(results, grid), linewidth=_width(results, grid, width), alpha=alpha,
                       label=label)  # fmt: skip
        panel.set_ylim(0.0, _WHOLE)

    return _panels(results, draw, "scans seen", f"share of robots localised\n({_words(THRESHOLDS[1])})")


def learning_curves(results: Results) -> Figure:
    """Return the share of scans found as less is known, a panel for each way of knowing less."""
    from matplotlib.figure import Figure

    s = results.settings
    grids = [grid for grid in results.grids if grid.resolution == s.learning_resolution]
    points = {
        "scans": [1.0, *s.shares], "beams": [1.0, *s.shares], "changed": [0.0, *s.changes], "range": list(s.ranges),
    }  # fmt: skip
    with figure_style():
        # A point is no curve.
        shown = [axis for axis in LEARNING_AXES if len(points[axis]) > 1] or LEARNING_AXES[:1]
        figure = Figure(figsize=(1.4 + 1.7 * len(shown), 2.9), layout="constrained")
        panels = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
        for panel, axis in zip(panels, shown, strict=True):
            for grid in grids:
                shares = []
                for value in points[axis]:
                    whole = axis != "range" and value == points[axis][0]
                    where = {"axis": "whole"} if whole else {"axis": axis, "value": value}
                    shares.append(float(is_right(results.select(task="learning", grid=grid.number, **where)).mean()))
                panel.plot(points[axis], shares, _STYLES[grid.equal], marker="o", color=_colour(results, grid),
                           label=grid.label, linewidth=_width(results, grid))  # fmt: skip
            panel.set_xlabel(_AXIS_WORDS[axis])
            panel.set_ylim(0.0, _WHOLE)
        panels[0].set_ylabel(f"share of scans found\n({_words(THRESHOLDS[-1])})")
        handles, labels = panels[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    return figure
