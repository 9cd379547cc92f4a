"""What holds of the paper's claims: one row each, by a rule that the row prints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from hexmap.experiments.report.numbers import format_interval
from hexmap.experiments.report.elements import Verdict
from hexmap.experiments.statistics import Interval
from hexmap.lattice.lattice import Lattice

Outcome: TypeAlias = Literal["holds", "holds in part", "does not hold"]

__all__ = ["Evidence", "judge", "mean_path_factor", "ties"]


class Evidence:
    """What the experiments found: for each lattice but the first (square or cubic) its ratios to the first."""

    def __init__(
        self,
        lattices: Sequence[Lattice],
        points: NDArray[np.float64],
        variability: Sequence[Interval],
        counts: Sequence[Interval],
        distortions: Sequence[Interval],
        steadiness: Sequence[Interval],
        costs: Sequence[float],
    ) -> None:
        """Keep the evidence.

        Args:
            lattices: the square or cubic one first.
            points: (N, n) the scan, metres.
            variability: of the cell count, first lattice over each other one (more is better).
            counts: mean cell count of each other lattice over the first's (less is better).
            distortions: mean distortion of each other lattice over the first's.
            steadiness: variability of the distortion, first lattice over each other one.
            costs: time of listing the scan on each other lattice over the first's.
        """
        self.lattices = lattices
        self.points = points
        self.variability = variability
        self.counts = counts
        self.distortions = distortions
        self.steadiness = steadiness
        self.costs = costs


def mean_path_factor(lattice: Lattice, moves: NDArray[np.int64], samples: int = 200_000) -> float:
    """Return the mean over directions of the length of long free paths, by ``moves`` (K, n), over the straight way.

    The length of a long path is the gauge of the convex hull of the moves, each divided by its own
    length; directions are a fixed low-discrepancy set, so the value is the same every time.
    """
    steps = lattice.centres(moves)
    hull = ConvexHull(steps / np.linalg.norm(steps, axis=1)[:, None])
    planes = np.unique(np.round(-hull.equations[:, :-1] / hull.equations[:, -1:], 12), axis=0)
    k = np.arange(samples, dtype=np.float64) + 0.5
    if lattice.dim == 2:
        angle = 2.0 * math.pi * k / samples
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    else:
        z = 1.0 - 2.0 * k / samples
        angle = math.pi * (1.0 + math.sqrt(5.0)) * k
        ring = np.sqrt(1.0 - z * z)
        directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    best: NDArray[np.float64] = np.full(samples, -np.inf)
    for plane in planes:
        np.maximum(best, directions @ plane, out=best)
    return float(best.mean())


def ties(points: NDArray[np.float64], lattice: Lattice) -> float:
    """Return the part of ``points`` (N, n) that lie exactly between two cells (to 2^-31 of a cell)."""
    if len(points) == 0:
        return 0.0
    u = lattice.coordinates(points)
    offset = u - lattice.reduced_index(lattice.quantise(points))
    tables = lattice.ray_tables
    gap = tables.half - offset @ tables.planes.T
    return float((gap.min(axis=1) <= 2.0**-31 * tables.half.max()).mean())


def _literal_d3(points: NDArray[np.float64]) -> float:
    """Return how often the paper's rule for D_n, read literally, gives the nearest point (unit D3)."""
    nearest = np.rint(points)
    error = points - nearest
    odd = nearest.sum(axis=1) % 2 != 0
    worst = np.argmax(np.abs(error), axis=1)
    rows = np.arange(len(points))
    literal, right = nearest.copy(), nearest.copy()
    away = np.where(nearest >= 0, 1.0, -1.0)[rows, worst]  # "further from zero"
    other = np.where(error >= 0, 1.0, -1.0)[rows, worst]  # the other side of x
    literal[rows[odd], worst[odd]] += away[odd]
    right[rows[odd], worst[odd]] += other[odd]
    return float(1.0 - (literal != right).any(axis=1)[odd].mean() * odd.mean())


def _three(best: float, good: float, value: float) -> Outcome:
    """Return the outcome of a value where more is better."""
    return "holds" if value >= best else "holds in part" if value >= good else "does not hold"


def judge(evidence: Evidence) -> list[Verdict]:
    """Return a verdict on each claim of the paper that the lattices and the scan at hand can decide."""
    cubic, others = evidence.lattices[0], list(evidence.lattices[1:])
    rows: list[Verdict] = []

    equal = {v.name: len(v.faces) == len(v.nearest) for v in others}
    rows.append(
        Verdict(
            "All neighbours of a cell are equally far and share a face with it",
            "I, II",
            "holds" if all(equal.values()) else "holds in part" if any(equal.values()) else "does not hold",
            "holds where every cell that shares a face is a nearest one; in part where it does on some lattices",
            "; ".join(f"{v.name}: {len(v.nearest)} nearest, {len(v.faces)} faces" for v in others),
        )
    )
    orders = {v.name: len(v.point_group) for v in evidence.lattices}
    more = [orders[v.name] > orders[cubic.name] for v in others]
    rows.append(
        Verdict(
            f"The lattices have a higher order of rotational symmetry than {cubic.name}",
            "II",
            "holds" if all(more) else "holds in part" if any(more) else "does not hold",
            "compares the orders of the point groups, counted from the bases",
            ", ".join(f"{k} {v}" for k, v in orders.items()),
        )
    )
    packing = {v.name: v.packing_density for v in evidence.lattices}
    densest = 0.9068 if cubic.dim == 2 else 0.7404
    best_packing = max(packing.values())
    rows.append(
        Verdict(
            "The hexagonal lattice is the densest packing" if cubic.dim == 2 else "FCC is the densest packing",
            "II",
            "holds" if best_packing >= densest else "does not hold",
            "holds where the densest of the lattices reaches pi / sqrt(12) in the plane, pi / sqrt(18) in space "
            "(proved optimal by Thue and by Hales)",
            ", ".join(f"{k} {v:.4f}" for k, v in packing.items()),
        )
    )
    found = {v.name: ties(evidence.points, v) for v in evidence.lattices}
    whole = np.round(evidence.points * 100) / 100
    in_centimetres = {v.name: ties(whole, v) for v in evidence.lattices}
    worst = max(found.values())
    rounded = max(in_centimetres.values())
    rows.append(
        Verdict(
            "Points exactly between two cells are very unlikely",
            "III",
            "holds" if max(worst, rounded) < 1e-4 else "holds in part" if worst < 1e-4 else "does not hold",
            "ties among the points as given, and rounded to whole centimetres as many sensors do: holds below 1 in "
            "10,000 for both, in part for the points as given",
            "; ".join(f"{k} {found[k]:.2%}, rounded {in_centimetres[k]:.2%}" for k in found),
        )
    )
    if cubic.dim == 3:
        share = _literal_d3(np.random.default_rng(0).uniform(-50.0, 50.0, (200_000, 3)))
        rows.append(
            Verdict(
                "D_n is quantised by rounding the worst component further from zero",
                "III",
                "holds" if share == 1.0 else "does not hold",
                "part of 200,000 uniform points on which the rule as printed gives the nearest lattice point",
                f"right for {share:.1%}; it must be rounded to the other side of x (Conway and Sloane)",
            )
        )
    low = [v.low for v in evidence.variability]
    rows.append(
        Verdict(
            "The number of cells varies three times less under rotation" if cubic.dim == 3
            else "The number of cells varies less under rotation",
            "abstract, VI",
            _three(3.0 if cubic.dim == 3 else 1.0, 1.0, min(low)),
            f"ratio of sigma / mu, {cubic.name} over the other: holds where every interval lies above "
            + ("3, in part above 1" if cubic.dim == 3 else "1"),
            "; ".join(f"{v.name} {format_interval(i)}" for v, i in zip(others, evidence.variability, strict=True)),
        )
    )  # fmt: skip
    steady = [v.low for v in evidence.steadiness]
    rows.append(
        Verdict(
            "The distortion varies less under rotation",
            "VI",
            "holds" if min(steady) > 1 else "holds in part" if max(steady) > 1 else "does not hold",
            f"ratio of sigma / mu, {cubic.name} over the other: holds where every interval lies above 1",
            "; ".join(f"{v.name} {format_interval(i)}" for v, i in zip(others, evidence.steadiness, strict=True)),
        )
    )
    high = [v.high for v in evidence.distortions]
    rows.append(
        Verdict(
            "Points lie nearer to the centres of their cells",
            "II, VI",
            "holds" if max(high) < 1 else "holds in part" if min(high) < 1 else "does not hold",
            f"mean distortion over {cubic.name}'s at equal cell size: holds where every interval lies below 1",
            "; ".join(f"{v.name} {format_interval(i)}" for v, i in zip(others, evidence.distortions, strict=True)),
        )
    )
    fewer = [v.high for v in evidence.counts]
    cover = {v.name: v.covering_thickness / cubic.covering_thickness for v in others}
    outcome: Outcome = "holds" if max(fewer) < 1 else "holds in part" if max(cover.values()) < 1 else "does not hold"
    rows.append(
        Verdict(
            "A map needs fewer cells (representation efficiency)",
            "I, VII",
            outcome,
            f"cells of the scan over {cubic.name}'s at equal cell size: holds where every interval lies below 1; in "
            "part where that is so only for space as a whole at equal covering radius",
            "; ".join(
                f"{v.name} {format_interval(i)}, at equal covering radius {cover[v.name]:.3f}"
                for v, i in zip(others, evidence.counts, strict=True)
            ),
        )
    )
    plain = mean_path_factor(cubic, cubic.nearest)
    long = cubic.shell(8 if cubic.dim == 2 else 26)
    with_diagonals = mean_path_factor(cubic, long)
    factors = {v.name: mean_path_factor(v, v.neighbours) for v in others}
    rows.append(
        Verdict(
            "Routes are shorter",
            "I, VII",
            "holds" if max(factors.values()) < with_diagonals
            else "holds in part" if min(factors.values()) < plain else "does not hold",
            f"mean length of free paths over the straight way: holds against {cubic.name} with {len(long)} neighbours, "
            f"in part against {len(cubic.nearest)}",
            f"{cubic.name}-{len(cubic.nearest)} {plain:.4f}, {cubic.name}-{len(long)} {with_diagonals:.4f}; "
            + ", ".join(f"{v.name}-{len(v.neighbours)} {factors[v.name]:.4f}" for v in others),
        )
    )  # fmt: skip
    limits = {v.name: 5.0 if len(v.nearest) == len(v.faces) else 10.0 for v in others}
    rows.append(
        Verdict(
            "Quantising and listing costs 5 and 10 times as much" if cubic.dim == 3
            else "The hexagonal lattice costs more",
            "VI",
            "holds" if all(c >= 0.8 * limits[v.name] for v, c in zip(others, evidence.costs, strict=True))
            else "does not hold",
            f"time of listing the scan over {cubic.name}'s, one thread, this machine: holds within a fifth of the "
            "paper's figures (Octave)",
            ", ".join(f"{v.name} {c:.2f} times" for v, c in zip(others, evidence.costs, strict=True)),
        )
    )  # fmt: skip
    return rows
