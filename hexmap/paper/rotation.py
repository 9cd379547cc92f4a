"""The paper's rotation experiment on any scan: Table II, Figs 2 to 7, and what a lattice is really worth.

The points are turned about an axis through the file's origin (the paper: z, 0 to 180 degrees) and
moved by uniformly random rigid transforms; on each lattice, at equal cell area or volume, the
occupied cells are counted and the distortion is measured. Every figure comes with a bootstrap
interval, and every comparison with the square or cubic lattice is a ratio under the same
transforms. The report ends with verdicts on the paper's claims.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.experiments.report.figures import COLOURS, figure_style
from hexmap.experiments.report.report import Report
from hexmap.experiments.run_cases import run_cases
from hexmap.experiments.statistics import Interval, block_length, bootstrap, bootstrap_ratio, cv, interquartile_factor
from hexmap.experiments.statistics import mean as mean_of
from hexmap.experiments.timing import median_seconds
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.paper.cases import about_axis, as_columns, rotation_case, score_case

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["PAPER", "RotationSettings", "rotation_experiment"]

Progress = Callable[[int, int], None]

# Table II and section VI of the paper: sigma / mu of voxel count and of distortion, in percent and plain.
PAPER: dict[str, dict[str, float]] = {
    "Z3": {"count": 0.017, "distortion": 0.0066},
    "D3": {"count": 0.007, "distortion": 0.0065},
    "D3*": {"count": 0.006, "distortion": 0.0033},
    "Z2": {"count": 13.7 / 390.0, "distortion": 0.0046 / 0.382},
    "A2": {"count": 7.02 / 376.0, "distortion": 0.0040 / 0.378},
}
_STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (1, 1)))


@dataclass(frozen=True)
class RotationSettings:
    """What the experiment does, as plain numbers and texts.

    Attributes:
        resolution: side, metres, of the square or cube as large as a cell.
        axis: "x", "y" or "z" (in the plane always z).
        start, stop, step: degrees; ``stop`` is left out, as 180 is 0 again for the cubic lattice.
        random: how many uniformly random rigid transforms.
        lattices: names; the square or cubic one is put first. None: all of the points' dimension.
        own: bases of further lattices, columns are generators in any unit: they are scaled.
        seed: of the random transforms and of the bootstrap.
    """

    resolution: float
    axis: str = "z"
    start: float = 0.0
    stop: float = 180.0
    step: float = 5.0
    random: int = 200
    lattices: tuple[str, ...] | None = None
    own: tuple[list[list[float]], ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the numbers."""
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise ArgumentError(f"a resolution must be a positive number of metres, not {self.resolution}")
        if self.axis not in ("x", "y", "z"):
            raise ArgumentError(f"the axis must be x, y or z, not {self.axis!r}")
        if not (self.step > 0 and self.stop > self.start and math.isfinite(self.stop - self.start)):
            raise ArgumentError(f"angles from {self.start} to {self.stop} by {self.step} degrees make no curve")
        if self.random < 8 or len(self.degrees) < 8:
            raise ArgumentError("an interval needs 8 angles and 8 random transforms at the least")

    @property
    def degrees(self) -> list[float]:
        """The angles about the axis."""
        count = math.ceil((self.stop - self.start) / self.step - 1e-9)
        return [self.start + k * self.step for k in range(count)]

    def make_lattices(self, dim: int) -> list[Lattice]:
        """Return the lattices, the square or cubic one first, all at the resolution.

        Raises:
            LatticeError: a name is not known.
            ArgumentError: a lattice is of another dimension than the points.
        """
        base = "Z2" if dim == 2 else "Z3"
        names = self.lattices or (("Z2", "A2") if dim == 2 else ("Z3", "D3", "D3*", "A2xZ"))
        made = [Lattice.named(name, self.resolution) for name in names]
        made = [Lattice.named(base, self.resolution), *(v for v in made if v.name != base)]
        for k, basis in enumerate(self.own):
            own = Lattice(np.array(basis), "own" if len(self.own) == 1 else f"own {k + 1}")
            made.append(own.scaled(self.resolution / own.resolution))
        for lattice in made:
            if lattice.dim != dim:
                raise ArgumentError(f"{lattice.name} is a lattice of dimension {lattice.dim}, the points of {dim}")
        return made


@dataclass(frozen=True, eq=False)
class _Sample:
    """Values of one quantity: a row a lattice, a column a transform; and the length of blocks to resample."""

    values: NDArray[np.float64]
    block: int

    def interval(self, k: int, statistic: Any, seed: int) -> Interval:
        return bootstrap(self.values[k], statistic, rng=np.random.default_rng([seed, 1]), block=self.block)

    def ratio(self, a: int, b: int, statistic: Any, seed: int) -> Interval:
        rng = np.random.default_rng([seed, 2])
        return bootstrap_ratio(self.values[a], self.values[b], statistic, rng=rng, block=self.block)


def rotation_experiment(
    points: NDArray[np.float64],
    settings: RotationSettings,
    *,
    source: str = "points",
    command: str = "",
    notes: Sequence[str] = (),
    folder: Path | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Report:
    """Run the experiment on ``points`` (N, 2) or (N, 3), metres, and return its report.

    Args:
        points: the scan, with the axis of rotation through the origin.
        settings: what to do.
        source: what the points are, for the report.
        command: the command line, for the report.
        notes: what was done to the points before, a sentence each.
        folder: where finished cases are kept; an interrupted run goes on from there.
        workers: processes; the numbers do not depend on it.
        progress: called with the cases done and their number.

    Raises:
        ArgumentError: there are too few points, or a lattice of another dimension.
        BoundsError: a point is not finite or out of range.
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or len(points) < 10:
        raise ArgumentError(f"the experiment needs 10 points or more, (N, 2) or (N, 3), not {points.shape}")
    dim = points.shape[1]
    lattices = settings.make_lattices(dim)
    for lattice in lattices:
        lattice.quantise(points)  # a bad point is an error before the work begins
    shared = {"points": points, "bases": [v.basis.tolist() for v in lattices]}
    axis = [{"kind": "axis", "axis": settings.axis, "degrees": d} for d in settings.degrees]
    moved = [{"kind": "random", "k": k} for k in range(settings.random)]
    scored = [{"k": k} for k in range(settings.random)]
    total = len(axis) + len(moved) + len(scored)

    def report_progress(before: int) -> Callable[[int, int], None] | None:
        return None if progress is None else lambda done, _: progress(before + done, total)

    def run(function: Any, cases: list[dict[str, Any]], before: int) -> list[dict[str, Any]]:
        return run_cases(
            function, cases, shared=shared, folder=folder, workers=workers, seed=settings.seed,
            progress=report_progress(before),
        )  # fmt: skip

    turns = run(rotation_case, [*axis, *moved], 0)
    scores = run(score_case, scored, len(axis) + len(moved))

    about, anyhow = turns[: len(axis)], turns[len(axis) :]
    samples = {}
    for key in ("count", "distortion"):
        curve = as_columns(about, key)
        # Neighbouring angles are correlated: whole stretches of the curve are drawn.
        # No longer than a sixth of it: blocks of a curve's own period would show no scatter at all.
        longest = max(1, len(axis) // 6)
        samples[key, "axis"] = _Sample(curve, min(longest, max(block_length(row) for row in curve)))
        samples[key, "random"] = _Sample(as_columns(anyhow, key), 1)
    for key in ("at_pose", "beside"):
        samples[key, "random"] = _Sample(as_columns(scores, key), 1)

    size = settings.resolution**dim
    unit = "m2" if dim == 2 else "litres"
    report = Report(f"Lattices under rotation: {source}", command, asdict(settings))
    report.paragraph(
        f"{len(points):,} points on {', '.join(v.name for v in lattices)} at equal cells of "
        f"{size if dim == 2 else 1000 * size:g} {unit} (resolution {settings.resolution:g} m): "
        f"{len(axis)} turns about {settings.axis if dim == 3 else 'z'} through the file's origin, and {len(moved)} "
        "uniformly random rotations with random shifts. sigma is the population's, as in the paper; intervals are "
        "95 % bootstrap intervals (BCa; of whole stretches of the curve where neighbouring angles are correlated)."
    )
    for note in notes:
        report.paragraph(note)
    _tables(report, lattices, samples, settings)
    _curves(report, lattices, samples, settings)
    if dim == 2:
        _cells_drawn(report, points, lattices)
    else:
        _solids_drawn(report, points, lattices)
    _dividend(report, points, lattices, samples, settings)
    _judge(report, points, lattices, samples, settings)
    return report


def _tables(
    report: Report, lattices: list[Lattice], samples: dict[tuple[str, str], _Sample], s: RotationSettings
) -> None:
    """Table II with intervals, ours beside the paper's, and the ratios to the square or cubic lattice."""
    titles = {"axis": f"Turns about {s.axis}", "random": "Random rotations and shifts"}
    for kind, title in titles.items():
        report.heading(title)
        rows = []
        for k, lattice in enumerate(lattices):
            row: dict[str, Any] = {"lattice": lattice.name}
            for key in ("count", "distortion"):
                sample = samples[key, kind]
                row[f"{key} mean"] = float(sample.values[k].mean())
                row[f"{key} sigma/mu"] = sample.interval(k, cv, s.seed)
                row[f"{key} quartiles"] = sample.interval(k, interquartile_factor, s.seed)
                paper = PAPER.get(lattice.name, {}).get(key) if kind == "axis" else None
                if kind == "axis":
                    row[f"{key} paper"] = paper
            rows.append(row)
        percent = ".2%"
        formats = {f"{q} {w}": percent for q in ("count", "distortion") for w in ("sigma/mu", "quartiles", "paper")}
        report.table(
            f"table2_{kind}", rows,
            columns={c: c for c in rows[0]},
            formats=formats | {"count mean": ".1f", "distortion mean": ".5f"},
            caption="Cells and distortion (m): mean, sigma / mu and inter-quartile factor (Q3 - Q1) / (Q3 + Q1)"
            + (", and the paper's sigma / mu on its own scan (Table II)." if kind == "axis" else "."),
        )  # fmt: skip
        rows = []
        for k in range(1, len(lattices)):
            row = {"lattice": f"{lattices[0].name} over {lattices[k].name}"}
            for key in ("count", "distortion"):
                row[f"{key} sigma/mu"] = samples[key, kind].ratio(0, k, cv, s.seed)
                row[f"{key} mean"] = samples[key, kind].ratio(0, k, mean_of, s.seed)
            rows.append(row)
        report.table(
            f"ratios_{kind}", rows,
            formats={c: ".3f" for c in rows[0] if c != "lattice"},
            caption=f"How many times {lattices[0].name}'s value is the other's, under the same transforms.",
        )  # fmt: skip


def _axes(count: int, width: float = 7.0, height: float = 2.6) -> tuple[Figure, list[Any]]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height * count), layout="constrained")
    return figure, [figure.add_subplot(count, 1, k + 1) for k in range(count)]


def _curves(
    report: Report, lattices: list[Lattice], samples: dict[tuple[str, str], _Sample], s: RotationSettings
) -> None:
    """Figs 4, 6 and 7: cells and distortion over the angle, each as a part of its mean."""
    report.heading("Curves over the angle")
    names = {"count": ("fig4" if lattices[0].dim == 2 else "fig6", "cells"), "distortion": ("fig7", "distortion")}
    for key, (name, word) in names.items():
        with figure_style():
            figure, (axes,) = _axes(1)
            for k, lattice in enumerate(lattices):
                values = samples[key, "axis"].values[k]
                axes.plot(
                    s.degrees, 100 * (values / values.mean() - 1), _STYLES[k % len(_STYLES)],
                    color=COLOURS[k % len(COLOURS)], label=f"{lattice.name}, mean {values.mean():.5g}",
                )  # fmt: skip
            axes.set_xlabel("angle, degrees")
            axes.set_ylabel(f"{word}, % off their mean")
            # Beside the curves: wherever it stood among them it would hide some.
            axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(lattices), fontsize=7.5)
        which = {"fig4": "4", "fig6": "6", "fig7": "7"}[name]
        report.figure(name, figure, f"As the paper's Fig. {which}: {word} while the scan turns.")


def _draw_cells(axes: Any, cells: VoxelList, k: int, title: str) -> None:
    """Draw the true cells of a planar list in the colour of the k-th lattice."""
    from matplotlib.collections import PolyCollection

    shapes = cells.lattice.cell.vertices[None] + cells.centres()[:, None]
    colour = COLOURS[k % len(COLOURS)]
    axes.add_collection(PolyCollection(list(shapes), facecolors=colour, edgecolors="white", linewidths=0.4))
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=9)
    axes.set_axis_off()


def _cells_drawn(report: Report, points: NDArray[np.float64], lattices: list[Lattice]) -> None:
    """Figs 2 and 3: the same points on every lattice, side by side, as they are and turned by 45 degrees."""
    from matplotlib.figure import Figure

    report.heading("The cells")
    with figure_style():
        figure = Figure(figsize=(3.6 * len(lattices), 7.2), layout="constrained")
        for row, degrees in enumerate((0.0, 45.0)):
            turned = about_axis("z", degrees, 2).apply(points)
            for k, lattice in enumerate(lattices):
                cells = VoxelList.from_points(turned, lattice)
                axes = figure.add_subplot(2, len(lattices), row * len(lattices) + k + 1)
                _draw_cells(axes, cells, k, f"{lattice.name}, {degrees:g} degrees: {len(cells)} cells")
    report.figure("fig2_3", figure, "As the paper's Figs 2 and 3: the occupied cells of the same points.")


def _solids_drawn(report: Report, points: NDArray[np.float64], lattices: list[Lattice]) -> None:
    """Fig. 5: the scan as shaded polyhedra, one picture a lattice."""
    from matplotlib.figure import Figure
    from matplotlib.image import imread

    from hexmap.drawing.solids.draw_solids import draw_solids

    report.heading("The cells")
    with tempfile.TemporaryDirectory() as work, figure_style():
        columns = 2
        rows = -(-len(lattices) // columns)
        figure = Figure(figsize=(8.0, 3.0 * rows), layout="constrained")
        for k, lattice in enumerate(lattices):
            cells = VoxelList.from_points(points, lattice)
            path = draw_solids(cells, Path(work) / f"{k}.png", size=(1200, 900))
            axes = figure.add_subplot(rows, columns, k + 1)
            axes.imshow(imread(path), interpolation="antialiased")
            axes.set_title(f"{lattice.name} ({lattice.title}), {len(cells):,} cells", fontsize=9)
            axes.set_axis_off()
    report.figure("fig5", figure, "As the paper's Fig. 5: the occupied cells, coloured by height, cut open.")


def _dividend(
    report: Report,
    points: NDArray[np.float64],
    lattices: list[Lattice],
    samples: dict[tuple[str, str], _Sample],
    s: RotationSettings,
) -> None:
    """Beyond the paper: cells and bytes at equal size and equal covering radius, match scores, candidate poses."""
    from hexmap.io.map_file import save_map
    from hexmap.maps.map import Level, Map

    base = lattices[0]
    report.heading("What a lattice is worth")
    rows = []
    with tempfile.TemporaryDirectory() as work:
        for lattice in lattices:
            row: dict[str, Any] = {"lattice": lattice.name}
            same_cover = lattice.scaled(base.covering_radius / lattice.covering_radius)
            for word, on in (("size", lattice), ("covering radius", same_cover)):
                cells = VoxelList.from_points(points, on)
                path = Path(work) / "m.parquet"
                save_map(path, Map([Level(cells, VoxelList.empty(on))]))
                row[f"cells, equal {word}"] = len(cells)
                row[f"bytes, equal {word}"] = path.stat().st_size
            row["cells of space, candidate shifts"] = lattice.covering_thickness / base.covering_thickness
            rows.append(row)
    report.table(
        "dividend", rows,
        formats={"cells of space, candidate shifts": ".3f"},
        caption="Cells that the scan needs and bytes on disk (as stored, compressed). Equal covering radius: the same "
        "guarantee on how far a point may be from its centre. Last: the cells that all of space needs for that, and "
        f"so the shifts that a matcher must try to be within a given distance of the truth, over {base.name}'s.",
    )  # fmt: skip
    rows = []
    for k, lattice in enumerate(lattices):
        row = {"lattice": lattice.name}
        for key, word in (("at_pose", "exact pose"), ("beside", "half a cell off")):
            sample = samples[key, "random"]
            row[f"score, {word}"] = sample.interval(k, mean_of, s.seed)
            row[f"sigma/mu, {word}"] = sample.interval(k, cv, s.seed)
            if k:
                row[f"{base.name} over it, {word}"] = sample.ratio(0, k, cv, s.seed)
        rows.append(row)
    columns = list(rows[-1])
    report.table(
        "match_score", rows, columns=columns,
        formats={c: (".2f" if "over" in c else ".2%") for c in columns if c != "lattice"},
        caption="What localisation feels: the part of the cells of one half of the scan that coincide with the map of "
        "the other half, over random rotations and shifts, where the pose is right and half a resolution beside it.",
    )  # fmt: skip
    if base.dim == 2:
        _diagonal(report, lattices)


def _diagonal(report: Report, lattices: list[Lattice]) -> None:
    """The thought experiment of the introduction: a line along an axis and one at 45 degrees."""
    line = np.stack([np.linspace(-10.0, 10.0, 40_001), np.full(40_001, 0.1)], axis=1)
    rows = []
    with figure_style():
        figure, _ = _axes(1, 7.0, 3.0)
        figure.clear()
        for k, lattice in enumerate(lattices):
            on = lattice.scaled(1.0 / lattice.resolution)
            row: dict[str, Any] = {"lattice": lattice.name}
            axes = figure.add_subplot(1, len(lattices), k + 1)
            for degrees in (0.0, 15.0, 30.0, 45.0):
                cells = VoxelList.from_points(about_axis("z", degrees, 2).apply(line), on)
                row[f"{degrees:g} degrees"] = len(cells)
                if degrees == 45.0:
                    _draw_cells(axes, cells, k, f"{lattice.name}: {len(cells)} cells")
            rows.append(row)
    report.table("diagonal", rows, caption="Cells of 1 m2 that a line of 20 m needs, by its direction.")
    report.figure("diagonal", figure, "The introduction's thought experiment: a line of 20 m at 45 degrees.")


def _judge(
    report: Report,
    points: NDArray[np.float64],
    lattices: list[Lattice],
    samples: dict[tuple[str, str], _Sample],
    s: RotationSettings,
) -> None:
    from hexmap.paper.verdicts import Evidence, judge

    # The paper speaks of its own lattices; others are in the tables.
    others = [k for k in range(1, len(lattices)) if lattices[k].name in PAPER]
    if not others:
        return
    costs = [median_seconds(partial(VoxelList.from_points, points, on)) for on in lattices]
    evidence = Evidence(
        [lattices[k] for k in (0, *others)],
        points,
        variability=[samples["count", "axis"].ratio(0, k, cv, s.seed) for k in others],
        counts=[samples["count", "axis"].ratio(k, 0, mean_of, s.seed) for k in others],
        distortions=[samples["distortion", "axis"].ratio(k, 0, mean_of, s.seed) for k in others],
        steadiness=[samples["distortion", "axis"].ratio(0, k, cv, s.seed) for k in others],
        costs=[costs[k] / costs[0] for k in others],
    )
    report.heading("Verdicts on the paper's claims")
    report.paragraph(
        "Each by the rule in its row, computed from these points; costs were measured live, on one thread."
    )
    report.verdicts(judge(evidence))
