"""The paper's rotation experiment on any scan: Table II, Figs 2 to 7, and what a lattice is really worth.

The points are rotated about an axis through the file's origin (the paper: z, 0 to 180 degrees) and
moved by uniformly random rigid transforms; on each lattice, at equal cell area or volume, the
occupied cells are counted and the distortion is measured. Every figure comes with a bootstrap
interval, and every comparison with the square or cubic lattice is a ratio under the same
transforms. The report ends with verdicts on the paper's claims.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.experiments.report.report import Report
from hexmap.experiments.run_cases import run_cases
from hexmap.experiments.statistics import block_length
from hexmap.paper import rotation_report as sections
from hexmap.paper.cases import as_columns, rotation_case, score_case
from hexmap.paper.rotation_report import RotationResults, Sample
from hexmap.paper.rotation_settings import RotationSettings

__all__ = ["rotation_experiment"]

Progress = Callable[[int, int], None]


def rotation_experiment(
    points: NDArray[np.float64],
    settings: RotationSettings,
    *,
    source: str = "points",
    command: str = "",
    notes: Sequence[str] = (),
    folder: Path | None = None,
    workers: int = 1,
    executor: Executor | None = None,
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
        executor: computes the cases instead of ``workers``, see :func:`~hexmap.experiments.run_cases`.
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
    run = partial(
        run_cases, shared={"points": points, "bases": [v.basis.tolist() for v in lattices]}, folder=folder,
        workers=workers, executor=executor, seed=settings.seed,
    )  # fmt: skip
    results = RotationResults(points, lattices, settings, _samples(settings, run, progress))
    report = Report(f"Lattices under rotation: {source}", command, asdict(settings))
    sections.add_verdicts(report, results)
    sections.add_outcomes(report, results)
    report.heading("What was done")
    report.paragraph(_summary(results))
    for note in notes:
        report.paragraph(note)
    sections.add_tables(report, results)
    sections.add_curves(report, results)
    sections.add_cells(report, results)
    sections.add_worth(report, results)
    return report


def _samples(
    settings: RotationSettings, run: Callable[..., list[dict[str, Any]]], progress: Progress | None
) -> dict[tuple[str, str], Sample]:
    """Run all cases and return their values by quantity and kind of the transforms."""
    axis = [{"kind": "axis", "axis": settings.axis, "degrees": d} for d in settings.degrees]
    moved = [{"kind": "random", "k": k} for k in range(settings.random)]
    scored = [{"k": k} for k in range(settings.random)]
    total = len(axis) + len(moved) + len(scored)

    def progress_after(before: int) -> Progress | None:
        return None if progress is None else lambda done, _: progress(before + done, total)

    counted = run(rotation_case, [*axis, *moved], progress=progress_after(0))
    scores = run(score_case, scored, progress=progress_after(len(axis) + len(moved)))

    about_the_axis, at_random = counted[: len(axis)], counted[len(axis) :]
    samples = {}
    for key in ("count", "distortion"):
        curve = as_columns(about_the_axis, key)
        # Neighbouring angles are correlated: whole stretches of the curve are drawn.
        # No longer than a sixth of it: blocks of a curve's own period would show no scatter at all.
        longest = max(1, len(axis) // 6)
        block = min(longest, max(block_length(row) for row in curve))
        samples[key, "axis"] = Sample(curve, block, settings.seed)
        samples[key, "random"] = Sample(as_columns(at_random, key), 1, settings.seed)
    for key in ("at_pose", "beside"):
        samples[key, "random"] = Sample(as_columns(scores, key), 1, settings.seed)
    return samples


def _summary(results: RotationResults) -> str:
    """Return the first paragraph: what was done with what."""
    settings, dim = results.settings, results.base.dim
    return (
        f"{len(results.points):,} points on {', '.join(v.name for v in results.lattices)} at equal cells of "
        f"{results.cell} (resolution {settings.resolution:g} m): "
        f"{len(settings.degrees)} turns about {settings.axis if dim == 3 else 'z'} through the file's origin, and "
        f"{settings.random} uniformly random rotations with random shifts. sigma is the population's, as in the paper; "
        "intervals are 95 % bootstrap intervals (BCa; of whole stretches of the curve where neighbouring angles are "
        "correlated)."
    )
