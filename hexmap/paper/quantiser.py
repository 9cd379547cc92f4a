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
from hexmap.lattice.convert import LatticeLike, as_lattice
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
    lattices: Sequence[LatticeLike] | None = None, *, count: int = 1_000_000, seed: int = 0, command: str = ""
) -> Report:
    """Measure each lattice's quantiser on uniform data and return the report.

    Args:
        lattices: lattices, names or bases; by default all named ones, at resolution 1.
        count: points a lattice and measurement.
        seed: of the points.
        command: the command line, for the report.

    Raises:
        ArgumentError: too few points to say anything.
    """
    if count < 1000:
        raise ArgumentError(f"the experiment needs 1,000 points or more, not {count}")
    measured = [as_lattice(lattice) for lattice in lattices or NAMES]
    report = Report("Lattices as quantisers", command, {"points": count, "seed": seed})
    report.paragraph(
        f"{count:,} uniform points over whole unit cells of each lattice, cells of area or volume 1. Exact values come "
        "from the polytope of the cell; measured ones carry a 95 % interval of their sampling error."
    )
    moments, volumes, moved, costs = [], [], [], []
    listing_base: dict[int, float] = {}  # by the dimension: seconds of its first lattice, the square or cubic one
    for k, given in enumerate(measured):
        lattice = given.scaled(1.0 / given.resolution)
        # One generator a lattice, drawn from in this order.
        rng = np.random.default_rng([seed, k])
        points = uniform_on_cells(lattice, count, rng)
        squared = _squared_errors(points, lattice)
        moments.append(_moments(lattice, squared))
        volumes.append(_volumes(lattice, count, rng))
        moved.append(_under_transforms(lattice, squared, count, rng))
        quantising, listing = _seconds(lattice, points)
        base = listing_base.setdefault(lattice.dim, listing)
        costs.append({
            "lattice": lattice.name, "quantise, ns a point": quantising / count * 1e9,
            "list, ns a point": listing / count * 1e9, "times the square or cubic": listing / base,
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
    report.paragraph("What quantising costs is in the folder times.")
    report.times.heading("Cost")
    report.times.table(
        "cost", costs, formats={c: ".2f" for c in costs[0] if c != "lattice"},
        caption="Measured live on one thread, medians; the paper (Octave): 1, 5 (D3) and 10 (D3*) times.",
    )  # fmt: skip
    return report


def _squared_errors(points: NDArray[np.float64], lattice: Lattice) -> NDArray[np.float64]:
    """Return the squared distance (N,) of each point to the centre of its cell, square metres."""
    return np.asarray(((points - lattice.centres(lattice.quantise(points))) ** 2).sum(axis=1))


def _moments(lattice: Lattice, squared: NDArray[np.float64]) -> dict[str, Any]:
    """Return the second moment and the mean error, exact and measured (Conway and Sloane, chapter 21)."""
    return {
        "lattice": lattice.name,
        "G exact": lattice.cell.second_moment,
        "G measured": _with_error(squared / lattice.dim),
        "mean error exact": lattice.cell.mean_error,
        "mean error measured": _with_error(np.sqrt(squared)),
        "largest error": float(np.sqrt(squared.max())),
        "covering radius": lattice.covering_radius,
    }


def _volumes(lattice: Lattice, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return the volume of the cell by its polytope, by the basis, and by the points of a box that are in it."""
    reach = 1.05 * lattice.covering_radius
    box = rng.uniform(-reach, reach, (count, lattice.dim))
    inside = (lattice.quantise(box) == 0).all(axis=1) * (2.0 * reach) ** lattice.dim
    return {
        "lattice": lattice.name,
        "polytope": lattice.cell.volume,
        "determinant": lattice.cell_volume,
        "sampled": _with_error(inside.astype(np.float64)),
    }


def _under_transforms(
    lattice: Lattice, squared: NDArray[np.float64], count: int, rng: np.random.Generator
) -> dict[str, Any]:
    """Return how much the mean error varies under random rigid transforms, and how much by sampling alone."""
    n = lattice.dim
    # A ball far larger than a cell: its own edge is all that could make a difference.
    ball = rng.normal(size=(min(count, 200_000), n))
    ball *= (50.0 * rng.uniform(0.0, 1.0, len(ball)) ** (1.0 / n) / np.sqrt((ball**2).sum(axis=1)))[:, None]
    drawn = []
    for _ in range(20):
        moved = Pose(random_rotation(rng, n).rotation, rng.uniform(-1.0, 1.0, n)).apply(ball)
        drawn.append(np.sqrt(_squared_errors(moved, lattice)).mean())
    means, errors = np.array(drawn), np.sqrt(squared)
    return {
        "lattice": lattice.name,
        "mean error": float(means.mean()),
        "sigma/mu over 20 transforms": float(means.std() / means.mean()),
        "sigma/mu of sampling alone": float(errors.std() / errors.mean() / np.sqrt(len(ball))),
    }


def _seconds(lattice: Lattice, points: NDArray[np.float64]) -> tuple[float, float]:
    """Return the seconds of quantising the points and of listing their cells."""
    spread = points * 1000.0  # as a map has them, not all in one cell
    return (
        median_seconds(partial(lattice.quantise, spread)),
        median_seconds(partial(VoxelList.from_points, spread, lattice)),
    )
