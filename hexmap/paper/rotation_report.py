"""The report of the rotation experiment, a function a section: Table II, Figs 2 to 7, what it is worth, verdicts."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.values import one_line
from hexmap.experiments.report.elements import Compared, Standing
from hexmap.experiments.report.figures import COLOURS, figure_style
from hexmap.experiments.report.numbers import format_number
from hexmap.experiments.report.report import Report
from hexmap.experiments.statistics import Interval, Statistic, bootstrap, bootstrap_ratio, cv, interquartile_factor
from hexmap.experiments.statistics import mean as mean_of
from hexmap.experiments.timing import median_seconds
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.paper.cases import about_axis
from hexmap.paper.cell_figures import draw_cells, new_figure, planar_cells, solid_cells
from hexmap.paper.rotation_settings import RotationSettings
from hexmap.paper.verdicts import Evidence, judge, judge_cost

__all__ = [
    "PAPER",
    "RotationResults",
    "Sample",
    "add_cells",
    "add_curves",
    "add_outcomes",
    "add_tables",
    "add_verdicts",
    "add_worth",
]

# Table II and section VI of the paper: sigma / mu of voxel count and of distortion, in percent and plain.
PAPER: dict[str, dict[str, float]] = {
    "Z3": {"count": 0.017, "distortion": 0.0066},
    "D3": {"count": 0.007, "distortion": 0.0065},
    "D3*": {"count": 0.006, "distortion": 0.0033},
    "Z2": {"count": 13.7 / 390.0, "distortion": 0.0046 / 0.382},
    "A2": {"count": 7.02 / 376.0, "distortion": 0.0040 / 0.378},
}
# By dimension: what the paper's column was measured on.
_PAPERS_OWN = {
    2: "The paper's sigma / mu is that of its own scan on cells of 1 m2 (section VI).",
    3: "The paper's sigma / mu (Table II) is that of its own scan of 80,000 points and its own cells; how much "
    "varies depends on the size of the cells, so compare lattices within a column.",
}
_STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))


@dataclass(frozen=True, eq=False)
class Sample:
    """Values of one quantity under all transforms of one kind.

    Attributes:
        values: a row a lattice, a column a transform.
        block: how many neighbouring transforms are resampled together.
        seed: of the resamples.
    """

    values: NDArray[np.float64]
    block: int
    seed: int

    __repr__ = one_line

    def interval(self, k: int, statistic: Statistic) -> Interval:
        """Return a statistic on the k-th lattice."""
        return bootstrap(self.values[k], statistic, rng=np.random.default_rng([self.seed, 1]), block=self.block)

    def ratio(self, a: int, b: int, statistic: Statistic) -> Interval:
        """Return a statistic on the a-th lattice over that on the b-th one, under the same transforms."""
        rng = np.random.default_rng([self.seed, 2])
        return bootstrap_ratio(self.values[a], self.values[b], statistic, rng=rng, block=self.block)


@dataclass(frozen=True, eq=False)
class RotationResults:
    """What the experiment was done with, and what it found.

    Attributes:
        points: (N, n) the scan, metres.
        lattices: the square or cubic one first, all of one cell size.
        settings: of the experiment.
        samples: by quantity (``"count"``, ``"distortion"``, ``"at_pose"``, ``"beside"``) and kind of the transforms
            (``"axis"``, ``"random"``); the scores of matching under random ones only.
    """

    points: NDArray[np.float64]
    lattices: list[Lattice]
    settings: RotationSettings
    samples: Mapping[tuple[str, str], Sample]

    __repr__ = one_line

    @property
    def base(self) -> Lattice:
        """The square or cubic lattice."""
        return self.lattices[0]

    @property
    def cell(self) -> str:
        """The size of a cell in words."""
        size = self.settings.resolution**self.base.dim
        return f"{size:g} m2" if self.base.dim == 2 else f"{1000 * size:g} litres"


# ---------------------------------------------------------------------- Table II


def add_tables(report: Report, results: RotationResults) -> None:
    """Add Table II with intervals, ours beside the paper's, and the ratios to the square or cubic lattice."""
    titles = {"axis": f"Turns about {results.settings.axis}", "random": "Random rotations and shifts"}
    for kind, title in titles.items():
        report.heading(title)
        rows = [_variability(results, k, kind) for k in range(len(results.lattices))]
        percent = [f"{q} {w}" for q in ("count", "distortion") for w in ("sigma/mu", "quartiles", "paper")]
        report.table(
            f"table2_{kind}", rows,
            columns={c: _heading(c, results) for c in rows[0]},
            formats=dict.fromkeys(percent, ".2%") | {"count mean": ".1f", "distortion mean": ".5f"},
            caption="Cells and distortion (m): mean, sigma / mu and inter-quartile factor (Q3 - Q1) / (Q3 + Q1)"
            + (f". {_PAPERS_OWN[results.base.dim]}" if kind == "axis" else "."),
        )  # fmt: skip
        ratios = [_ratios(results, k, kind) for k in range(1, len(results.lattices))]
        report.table(
            f"ratios_{kind}", ratios,
            formats={c: ".3f" for c in ratios[0] if c != "lattice"},
            caption=f"How many times {results.base.name}'s value is the other's, under the same transforms.",
        )  # fmt: skip


def _heading(column: str, results: RotationResults) -> str:
    """Return the heading of a column of Table II: beside the paper's, ours says of what cells it is."""
    if column.endswith(" paper"):
        return f"{column}, its cells" + (" of 1 m2" if results.base.dim == 2 else "")
    return f"{column}, cells of {results.cell}" if column.endswith("sigma/mu") else column


def _variability(results: RotationResults, k: int, kind: str) -> dict[str, Any]:
    name = results.lattices[k].name
    row: dict[str, Any] = {"lattice": name}
    for key in ("count", "distortion"):
        sample = results.samples[key, kind]
        row[f"{key} mean"] = float(sample.values[k].mean())
        row[f"{key} sigma/mu"] = sample.interval(k, cv)
        row[f"{key} quartiles"] = sample.interval(k, interquartile_factor)
        if kind == "axis":
            row[f"{key} paper"] = PAPER.get(name, {}).get(key)
    return row


def _ratios(results: RotationResults, k: int, kind: str) -> dict[str, Any]:
    row: dict[str, Any] = {"lattice": f"{results.base.name} over {results.lattices[k].name}"}
    for key in ("count", "distortion"):
        row[f"{key} sigma/mu"] = results.samples[key, kind].ratio(0, k, cv)
        row[f"{key} mean"] = results.samples[key, kind].ratio(0, k, mean_of)
    return row


# ---------------------------------------------------------------------- figures


def add_curves(report: Report, results: RotationResults) -> None:
    """Add Figs 4, 6 and 7: cells and distortion over the angle, in per cent of their mean."""
    report.heading("Curves over the angle")
    plane = results.base.dim == 2
    for key, number, word in (("count", 4 if plane else 6, "cells"), ("distortion", 7, "distortion")):
        with figure_style():
            figure = new_figure(7.0, 2.6)
            axes = figure.add_subplot(1, 1, 1)
            for k, lattice in enumerate(results.lattices):
                values = results.samples[key, "axis"].values[k]
                axes.plot(
                    results.settings.degrees, 100 * (values / values.mean() - 1), linestyle=_STYLES[k % len(_STYLES)],
                    color=COLOURS[k % len(COLOURS)], label=f"{lattice.name}, mean {values.mean():.5g}",
                )  # fmt: skip
            axes.set_xlabel("angle, degrees")
            axes.set_ylabel(f"{word}, % off their mean")
            # Beside the curves: wherever it stood among them it would hide some.
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(results.lattices), fontsize=7.5)
        report.figure(f"fig{number}", figure, f"As the paper's Fig. {number}: {word} while the scan turns.")


def add_cells(report: Report, results: RotationResults) -> None:
    """Add Figs 2 and 3 in the plane, Fig. 5 in space: the occupied cells on every lattice."""
    report.heading("The cells")
    if results.base.dim == 2:
        report.figure(
            "fig2_3", planar_cells(results.points, results.lattices),
            "As the paper's Figs 2 and 3: the occupied cells of the same points, all on one scale, metres.",
        )  # fmt: skip
    else:
        report.figure(
            "fig5", solid_cells(results.points, results.lattices),
            "As the paper's Fig. 5: the occupied cells, coloured by height, cut open, and beside them a part of them "
            "from close by.",
        )  # fmt: skip


# ---------------------------------------------------------------------- beyond the paper


def add_worth(report: Report, results: RotationResults) -> None:
    """Add cells and bytes at equal size and equal covering radius, match scores, candidate poses."""
    report.heading("What a lattice is worth")
    report.table(
        "dividend", _sizes(results),
        formats={"cells of space, candidate shifts": ".3f"},
        caption="Cells that the scan needs and bytes on disk (as stored, compressed). Equal covering radius: the same "
        "guarantee on how far a point may be from its centre. Last: the cells that all of space needs for that, and "
        "so the shifts that a matcher must try to be within a given distance of the truth, over "
        f"{results.base.name}'s.",
    )  # fmt: skip
    scores = [_scores(results, k) for k in range(len(results.lattices))]
    columns = list(scores[-1])  # the first lattice has no ratio to itself
    report.table(
        "match_score", scores, columns=columns,
        formats={c: (".2f" if "over" in c else ".2%") for c in columns if c != "lattice"},
        caption="What localisation feels: the part of the cells of one half of the scan that coincide with the map of "
        "the other half, over random rotations and shifts, where the pose is right and half a resolution beside it.",
    )  # fmt: skip
    if results.base.dim == 2:
        _add_diagonal(report, results.lattices)


def _sizes(results: RotationResults) -> list[dict[str, Any]]:
    """Return cells and bytes of the scan's map on each lattice, at equal cell size and at equal covering radius."""
    from hexmap.io.map_file import save_map
    from hexmap.maps.map import Level, Map

    base, rows = results.base, []
    with tempfile.TemporaryDirectory() as work:
        path = Path(work) / "m.parquet"
        for lattice in results.lattices:
            row: dict[str, Any] = {"lattice": lattice.name}
            same_cover = lattice.scaled(base.covering_radius / lattice.covering_radius)
            for word, on in (("size", lattice), ("covering radius", same_cover)):
                cells = VoxelList.from_points(results.points, on)
                save_map(path, Map([Level(cells, VoxelList.empty(on))]))
                row[f"cells, equal {word}"] = len(cells)
                row[f"bytes, equal {word}"] = path.stat().st_size
            row["cells of space, candidate shifts"] = lattice.covering_thickness / base.covering_thickness
            rows.append(row)
    return rows


def _scores(results: RotationResults, k: int) -> dict[str, Any]:
    row: dict[str, Any] = {"lattice": results.lattices[k].name}
    for key, word in (("at_pose", "exact pose"), ("beside", "half a cell off")):
        sample = results.samples[key, "random"]
        row[f"score, {word}"] = sample.interval(k, mean_of)
        row[f"sigma/mu, {word}"] = sample.interval(k, cv)
        if k > 0:
            row[f"{results.base.name} over it, {word}"] = sample.ratio(0, k, cv)
    return row


def _add_diagonal(report: Report, lattices: list[Lattice]) -> None:
    """Add the thought experiment of the introduction: a line along an axis and one at 45 degrees."""
    line = np.stack([np.linspace(-10.0, 10.0, 40_001), np.full(40_001, 0.1)], axis=1)
    rows = []
    with figure_style():
        figure = new_figure(7.0, 3.0)
        for k, lattice in enumerate(lattices):
            on = lattice.scaled(1.0 / lattice.resolution)
            row: dict[str, Any] = {"lattice": lattice.name}
            axes = figure.add_subplot(1, len(lattices), k + 1)
            for degrees in (0.0, 15.0, 30.0, 45.0):
                cells = VoxelList.from_points(about_axis("z", degrees, 2).apply(line), on)
                row[f"{degrees:g} degrees"] = len(cells)
                if degrees == 45.0:
                    draw_cells(axes, cells, k, f"{lattice.name}: {len(cells)} cells")
            rows.append(row)
    report.table("diagonal", rows, caption="Cells of 1 m2 that a line of 20 m needs, by its direction.")
    report.figure("diagonal", figure, "The introduction's thought experiment: a line of 20 m at 45 degrees.")


# ---------------------------------------------------------------------- verdicts


def add_outcomes(report: Report, results: RotationResults) -> None:
    """Add the matrix of what each lattice wins and loses against the square or cubic one."""
    measures = (
        ("cells vary", "count", "axis", cv), ("cells vary", "count", "random", cv),
        ("distortion varies", "distortion", "axis", cv), ("distortion varies", "distortion", "random", cv),
        ("match score varies", "at_pose", "random", cv),
        ("cells", "count", "axis", mean_of), ("cells", "count", "random", mean_of),
        ("distortion", "distortion", "axis", mean_of), ("distortion", "distortion", "random", mean_of),
    )  # fmt: skip
    cells: dict[str, dict[str, Compared | None]] = {}
    for k in range(1, len(results.lattices)):
        line = cells.setdefault(f"{results.lattices[k].name} against {results.base.name}", {})
        for word, key, kind, statistic in measures:
            column = f"{word}, {'turns' if kind == 'axis' else 'at random'}"
            line[column] = _compared(results.samples[key, kind], k, statistic)
    if not cells:
        return
    report.heading("Win, even, lose")
    report.matrix(
        "outcomes", cells, "lattice",
        f"How many times {results.base.name}'s value a lattice's is, under the same transforms, on cells of "
        f"{results.cell}: sigma / mu where something varies, else the mean; under the turns, and under random "
        "rotations and shifts. Less is better; won and lost where the 95 % interval does not hold 1.",
    )  # fmt: skip


def _compared(sample: Sample, k: int, statistic: Statistic) -> Compared | None:
    """Return what became of the k-th lattice against the first; None where there is no ratio, as nothing varies."""
    if not statistic(sample.values[0]) > 0.0:
        return None
    ratio = sample.ratio(k, 0, statistic)
    standing: Standing = "tie" if ratio.low <= 1.0 <= ratio.high else "win" if ratio.value < 1.0 else "lose"
    return Compared(standing, format_number(ratio.value, ".2f" if abs(ratio.value - 1.0) >= 0.01 else ".4f"))


def add_verdicts(report: Report, results: RotationResults) -> None:
    """Add a verdict on each claim of the paper, where any of the paper's own lattices is compared."""
    # The paper speaks of its own lattices; others are in the tables.
    lattices = results.lattices
    others = [k for k in range(1, len(lattices)) if lattices[k].name in PAPER]
    if not others:
        return
    costs = [median_seconds(partial(VoxelList.from_points, results.points, on)) for on in lattices]
    count, distortion = results.samples["count", "axis"], results.samples["distortion", "axis"]
    evidence = Evidence(
        [lattices[k] for k in (0, *others)],
        results.points,
        variability=[count.ratio(0, k, cv) for k in others],
        counts=[count.ratio(k, 0, mean_of) for k in others],
        distortions=[distortion.ratio(k, 0, mean_of) for k in others],
        steadiness=[distortion.ratio(0, k, cv) for k in others],
        costs=[costs[k] / costs[0] for k in others],
    )
    report.heading("Verdicts on the paper's claims")
    report.paragraph(
        "Each by the rule in its row, computed from these points. What is decided by times is in the folder times."
    )
    report.verdicts(judge(evidence))
    report.times.paragraph("Costs were measured live, on one thread, medians; they differ from run to run.")
    report.times.verdicts(judge_cost(evidence))
