"""What holds of the paper's claims: one row each, by a rule that the row prints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from hexmap.base.values import one_line
from hexmap.experiments.report.elements import Outcome, Verdict
from hexmap.experiments.report.numbers import format_interval
from hexmap.experiments.statistics import Interval
from hexmap.lattice.lattice import Lattice

__all__ = ["Evidence", "judge", "mean_path_factor", "ties"]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What the experiments found: for each lattice but the first (square or cubic) its ratios to the first.

    Attributes:
        lattices: the square or cubic one first.
        points: (N, n) the scan, metres.
        variability: of the cell count, first lattice over each other one (more is better).
        counts: mean cell count of each other lattice over the first's (less is better).
        distortions: mean distortion of each other lattice over the first's.
        steadiness: variability of the distortion, first lattice over each other one.
        costs: time of listing the scan on each other lattice over the first's.
    """

    lattices: Sequence[Lattice]
    points: NDArray[np.float64]
    variability: Sequence[Interval]
    counts: Sequence[Interval]
    distortions: Sequence[Interval]
    steadiness: Sequence[Interval]
    costs: Sequence[float]

    __repr__ = one_line

    @property
    def base(self) -> Lattice:
        """The square or cubic lattice."""
        return self.lattices[0]

    @property
    def others(self) -> Sequence[Lattice]:
        """The lattices that are compared with it."""
        return self.lattices[1:]


def mean_path_factor(lattice: Lattice, moves: NDArray[np.int64], samples: int = 200_000) -> float:
    """Return the mean over directions of the length of long free paths, by ``moves`` (K, n), over the distance.

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
    """Return the fraction of ``points`` (N, n) that lie exactly between two cells (to 2^-31 of a cell)."""
    if len(points) == 0:
        return 0.0
    u = lattice.coordinates(points)
    offset = u - lattice.reduced_index(lattice.quantise(points))
    tables = lattice.ray_tables
    gap = tables.half - offset @ tables.planes.T
    return float((gap.min(axis=1) <= 2.0**-31 * tables.half.max()).mean())


def judge(evidence: Evidence) -> list[Verdict]:
    """Return a verdict on each claim of the paper that the lattices and the scan at hand can decide."""
    claims = [
        _neighbours_are_equal,
        _symmetry_is_higher,
        _packing_is_densest,
        _ties_are_unlikely,
        *([_worst_component_is_rounded_from_zero] if evidence.base.dim == 3 else []),
        _cell_count_is_steadier,
        _distortion_is_steadier,
        _centres_are_nearer,
        _fewer_cells,
        _shorter_routes,
    ]
    return [claim(evidence) for claim in claims]


def judge_cost(evidence: Evidence) -> list[Verdict]:
    """Return the verdict on the claim that is decided by times measured live, which are never the same twice."""
    return [_costs_more(evidence)]


def _graded(whole: bool, in_part: bool, even: bool = False) -> Outcome:
    """Return the outcome: it holds, or else holds in part, or is undecided where no interval speaks against it."""
    return "holds" if whole else "holds in part" if in_part else "undecided" if even else "does not hold"


def _listed(evidence: Evidence, intervals: Sequence[Interval]) -> str:
    """Return the interval of each other lattice with its name."""
    return "; ".join(f"{v.name} {format_interval(i)}" for v, i in zip(evidence.others, intervals, strict=True))


# ---------------------------------------------------------------------- of the lattices alone


def _neighbours_are_equal(evidence: Evidence) -> Verdict:
    equal = [len(v.faces) == len(v.nearest) for v in evidence.others]
    return Verdict(
        "All neighbours of a cell are equally far and share a face with it",
        "I, II",
        _graded(all(equal), any(equal)),
        "holds where every cell that shares a face is a nearest one; in part where it does on some lattices",
        "; ".join(f"{v.name}: {len(v.nearest)} nearest, {len(v.faces)} faces" for v in evidence.others),
    )


def _symmetry_is_higher(evidence: Evidence) -> Verdict:
    orders = {v.name: len(v.point_group) for v in evidence.lattices}
    higher = [orders[v.name] > orders[evidence.base.name] for v in evidence.others]
    return Verdict(
        f"The lattices have a higher order of rotational symmetry than {evidence.base.name}",
        "II",
        _graded(all(higher), any(higher)),
        "compares the orders of the point groups, counted from the bases",
        ", ".join(f"{name} {order}" for name, order in orders.items()),
    )


def _packing_is_densest(evidence: Evidence) -> Verdict:
    plane = evidence.base.dim == 2
    packing = {v.name: v.packing_density for v in evidence.lattices}
    optimum = 0.9068 if plane else 0.7404  # rounded down
    return Verdict(
        "The hexagonal lattice is the densest packing" if plane else "FCC is the densest packing",
        "II",
        _graded(max(packing.values()) >= optimum, False),
        "holds where the densest of the lattices reaches pi / sqrt(12) in the plane, pi / sqrt(18) in space "
        "(proved optimal by Thue and by Hales)",
        ", ".join(f"{name} {density:.4f}" for name, density in packing.items()),
    )


def _worst_component_is_rounded_from_zero(evidence: Evidence) -> Verdict:
    right = _literal_d3(np.random.default_rng(0).uniform(-50.0, 50.0, (200_000, 3)))
    return Verdict(
        "D_n is quantised by rounding the worst component further from zero",
        "III",
        _graded(right == 1.0, False),
        "part of 200,000 uniform points on which the rule as printed gives the nearest lattice point",
        f"right for {right:.1%}; it must be rounded to the other side of x (Conway and Sloane)",
    )


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


def _shorter_routes(evidence: Evidence) -> Verdict:
    base = evidence.base
    nearest, diagonals = base.nearest, base.shell(8 if base.dim == 2 else 26)
    straight, diagonal = mean_path_factor(base, nearest), mean_path_factor(base, diagonals)
    factors = {v.name: mean_path_factor(v, v.neighbours) for v in evidence.others}
    return Verdict(
        "Routes are shorter",
        "I, VII",
        _graded(max(factors.values()) < diagonal, min(factors.values()) < straight),
        f"mean length of free paths over the straight way: holds against {base.name} with {len(diagonals)} neighbours, "
        f"in part against {len(nearest)}",
        f"{base.name}-{len(nearest)} {straight:.4f}, {base.name}-{len(diagonals)} {diagonal:.4f}; "
        + ", ".join(f"{v.name}-{len(v.neighbours)} {factors[v.name]:.4f}" for v in evidence.others),
    )


# ---------------------------------------------------------------------- of the scan


def _ties_are_unlikely(evidence: Evidence) -> Verdict:
    in_centimetres = np.round(evidence.points * 100) / 100
    given = {v.name: ties(evidence.points, v) for v in evidence.lattices}
    rounded = {v.name: ties(in_centimetres, v) for v in evidence.lattices}
    unlikely = max(given.values()) < 1e-4
    return Verdict(
        "Points exactly between two cells are very unlikely",
        "III",
        _graded(unlikely and max(rounded.values()) < 1e-4, unlikely),
        "ties among the points as given, and rounded to whole centimetres as many sensors do: holds below 1 in "
        "10,000 for both, in part for the points as given",
        "; ".join(f"{name} {given[name]:.2%}, rounded {rounded[name]:.2%}" for name in given),
    )


def _cell_count_is_steadier(evidence: Evidence) -> Verdict:
    # The paper says how much steadier only of space.
    space = evidence.base.dim == 3
    lowest = min(interval.low for interval in evidence.variability)
    even = min(interval.high for interval in evidence.variability) >= (3.0 if space else 1.0)
    return Verdict(
        "The number of cells varies three times less under rotation" if space
        else "The number of cells varies less under rotation",
        "abstract, VI",
        _graded(lowest >= (3.0 if space else 1.0), lowest >= 1.0, even),
        f"ratio of sigma / mu, {evidence.base.name} over the other: holds where every interval lies above "
        + ("3, in part above 1" if space else "1"),
        _listed(evidence, evidence.variability),
    )  # fmt: skip


def _distortion_is_steadier(evidence: Evidence) -> Verdict:
    lows = [interval.low for interval in evidence.steadiness]
    return Verdict(
        "The distortion varies less under rotation",
        "VI",
        _graded(min(lows) > 1, max(lows) > 1, min(interval.high for interval in evidence.steadiness) >= 1),
        f"ratio of sigma / mu, {evidence.base.name} over the other: holds where every interval lies above 1",
        _listed(evidence, evidence.steadiness),
    )


def _centres_are_nearer(evidence: Evidence) -> Verdict:
    highs = [interval.high for interval in evidence.distortions]
    return Verdict(
        "Points lie nearer to the centres of their cells",
        "II, VI",
        _graded(max(highs) < 1, min(highs) < 1, max(interval.low for interval in evidence.distortions) <= 1),
        f"mean distortion over {evidence.base.name}'s at equal cell size: holds where every interval lies below 1",
        _listed(evidence, evidence.distortions),
    )


def _fewer_cells(evidence: Evidence) -> Verdict:
    base, others = evidence.base, evidence.others
    covering = [v.covering_thickness / base.covering_thickness for v in others]
    return Verdict(
        "A map needs fewer cells (representation efficiency)",
        "I, VII",
        _graded(
            max(interval.high for interval in evidence.counts) < 1, max(covering) < 1,
            max(interval.low for interval in evidence.counts) <= 1,
        ),
        f"cells of the scan over {base.name}'s at equal cell size: holds where every interval lies below 1; in "
        "part where that is so only for space as a whole at equal covering radius",
        "; ".join(
            f"{v.name} {format_interval(i)}, at equal covering radius {cover:.3f}"
            for v, i, cover in zip(others, evidence.counts, covering, strict=True)
        ),
    )  # fmt: skip


def _costs_more(evidence: Evidence) -> Verdict:
    # The paper's figures: 5 times for D3 and A2, whose faces all lead to nearest cells, 10 times for D3*.
    costs = list(zip(evidence.others, evidence.costs, strict=True))
    as_printed = all(cost >= 0.8 * (5.0 if len(v.nearest) == len(v.faces) else 10.0) for v, cost in costs)
    return Verdict(
        "Quantising and listing costs 5 and 10 times as much" if evidence.base.dim == 3
        else "The hexagonal lattice costs more",
        "VI",
        _graded(as_printed, False),
        f"time of listing the scan over {evidence.base.name}'s, one thread, this machine: holds within a fifth of the "
        "paper's figures (Octave)",
        ", ".join(f"{v.name} {cost:.2f} times" for v, cost in costs),
    )  # fmt: skip
