"""How good a quantiser each lattice is: uniform data, cell volumes by sampling, cost (the paper's section IV)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.experiments.report.report import Report
from hexmap.experiments.statistics import Interval
from hexmap.experiments.timing import median_seconds
from hexmap.lattice.lattice import NAMES, Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.paper.cases import random_rotation
from hexmap.poses.pose import Pose

__all__ = ["quantiser_experiment", "uniform_on_cells"]


def uniform_on_cells(lattice: Lattice, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return points (count, n) uniform over a whole unit cell, metres: a box cut anywhere would be biased."""
    return np.asarray(rng.uniform(0.0, 1.0, (count, lattice.dim)) @ lattice.basis.T)


def _with_error(values: NDArray[np.float64]) -> Interval:
    """Return the mean of independent values with its 95 % interval."""
    mean, error = float(values.mean()), float(values.std() / np.sqrt(len(values)))
    return Interval(mean, mean - 1.96 * error, mean + 1.96 * error)


def quantiser_experiment(
    lattices: Sequence[Lattice] | None = None, *, count: int = 1_000_000, seed: int = 0, command: str = ""
) -> Report:
    """Measure each lattice's quantiser on uniform data and return the report.

    Args:
        lattices: which; by default all named ones at resolution 1.
        count: points a lattice and measurement.
        seed: of the points.
        command: the command line, for the report.

    Raises:
        ArgumentError: too few points to say anything.
    """
    if count < 1000:
        raise ArgumentError(f"the experiment needs 1,000 points or more, not {count}")
    lattices = list(lattices or (Lattice.named(name) for name in NAMES))
    report = Report("Lattices as quantisers", command, {"points": count, "seed": seed})
    report.paragraph(
        f"{count:,} uniform points over whole unit cells of each lattice, cells of area or volume 1. Exact values come "
        "from the polytope of the cell; measured ones carry a 95 % interval of their sampling error."
    )
    moments: list[dict[str, Any]] = []
    volumes: list[dict[str, Any]] = []
    moved: list[dict[str, Any]] = []
    costs: list[dict[str, Any]] = []
    base_cost: dict[int, float] = {}
    for k, given in enumerate(lattices):
        lattice = given.scaled(1.0 / given.resolution)
        n = lattice.dim
        rng = np.random.default_rng([seed, k])
        points = uniform_on_cells(lattice, count, rng)
        offset = points - lattice.centres(lattice.quantise(points))
        square = (offset**2).sum(axis=1)
        moments.append({
            "lattice": lattice.name,
            "G exact": lattice.cell.second_moment,
            "G measured": _with_error(square / n),
            "mean error exact": lattice.cell.mean_error,
            "mean error measured": _with_error(np.sqrt(square)),
            "largest error": float(np.sqrt(square.max())),
            "covering radius": lattice.covering_radius,
        })  # fmt: skip
        reach = 1.05 * lattice.covering_radius
        box = rng.uniform(-reach, reach, (count, n))
        inside = (lattice.quantise(box) == 0).all(axis=1) * (2.0 * reach) ** n
        volumes.append({
            "lattice": lattice.name, "polytope": lattice.cell.volume, "determinant": lattice.cell_volume,
            "sampled": _with_error(inside.astype(np.float64)),
        })  # fmt: skip
        # A ball far larger than a cell, turned and shifted: its own edge is all that could make a difference.
        ball = rng.normal(size=(min(count, 200_000), n))
        ball *= (50.0 * rng.uniform(0.0, 1.0, len(ball)) ** (1.0 / n) / np.sqrt((ball**2).sum(axis=1)))[:, None]
        means = []
        for _ in range(20):
            turned = Pose(random_rotation(rng, n).rotation, rng.uniform(-1.0, 1.0, n)).apply(ball)
            means.append(np.sqrt(((turned - lattice.centres(lattice.quantise(turned))) ** 2).sum(axis=1)).mean())
        means_array = np.array(means)
        moved.append({
            "lattice": lattice.name, "mean error": float(means_array.mean()),
            "sigma/mu over 20 transforms": float(means_array.std() / means_array.mean()),
            "sigma/mu of sampling alone": float(np.sqrt(square).std() / np.sqrt(square).mean() / np.sqrt(len(ball))),
        })  # fmt: skip
        spread = points * 1000.0  # as a map has them, not all in one cell
        quantise, listing = (
            median_seconds(partial(lattice.quantise, spread)),
            median_seconds(partial(VoxelList.from_points, spread, lattice)),
        )
        base_cost.setdefault(n, listing)
        costs.append({
            "lattice": lattice.name, "quantise, ns a point": quantise / count * 1e9,
            "list, ns a point": listing / count * 1e9, "times the square or cubic": listing / base_cost[n],
        })  # fmt: skip
    report.heading("Distortion of uniform data")
    report.table(
        "moments", moments, formats={c: ".6f" for c in moments[0] if c.startswith("G")},
        caption="Dimensionless second moment G and mean error: exact and measured.",
    )  # fmt: skip
    report.heading("Cell volumes (section IV-B)")
    report.table("volumes", volumes, caption="By the polytope, by the basis, and by sampling a box around the cell.")
    report.heading("Turned and shifted")
    report.table(
        "transforms", moved, formats={c: ".3%" for c in moved[0] if c.startswith("sigma")},
        caption="Mean error of a ball of uniform points under random rigid transforms: it varies as sampling does.",
    )  # fmt: skip
    report.heading("Cost")
    report.table(
        "cost", costs, formats={c: ".2f" for c in costs[0] if c != "lattice"},
        caption="Measured live on one thread, medians; the paper (Octave): 1, 5 (D3) and 10 (D3*) times.",
    )  # fmt: skip
    return report
