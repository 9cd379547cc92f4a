"""How good a trajectory is: against true relations, or against a reference trajectory.

Three measures. :func:`evaluate_relations` compares relative poses with known ones (Kuemmerle et
al., "On measuring the accuracy of SLAM algorithms", 2009), so an early error does not spoil all
that follows. :func:`absolute_error` (ATE) aligns the estimate rigidly with a reference and
measures what is left. :func:`relative_error` (RPE) compares the motion over a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError, TrajectoryError
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose
from hexmap.poses.trajectory import Relations, Trajectory

__all__ = [
    "AbsoluteError",
    "ErrorStatistics",
    "PoseErrors",
    "RelationScore",
    "RelativeError",
    "absolute_error",
    "evaluate_relations",
    "pose_errors",
    "relative_error",
]

Associate = Literal["time", "order"]
# What makes lists of poses that go together by order.
_SCANS = "hexmap build --trajectory-of scans writes one pose a scan, without those of the odometry"


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of the absolute errors; in the unit of the errors, ``mean_squared`` in its square.

    Attributes:
        mean: mean absolute error.
        std: standard deviation of the absolute errors.
        median: median of the absolute errors.
        max: largest absolute error.
        mean_squared: mean of the squared errors.
    """

    mean: float
    std: float
    median: float
    max: float
    mean_squared: float

    @property
    def rmse(self) -> float:
        """Root of the mean squared error."""
        return math.sqrt(self.mean_squared)

    @classmethod
    def of(cls, errors: FloatArray) -> ErrorStatistics:
        """Return the statistics of absolute errors (N,), N > 0."""
        return cls(
            mean=float(errors.mean()),
            std=float(errors.std()),
            median=float(np.median(errors)),
            max=float(errors.max()),
            mean_squared=float((errors**2).mean()),
        )


@dataclass(frozen=True)
class RelationScore:
    """What :func:`evaluate_relations` found.

    Attributes:
        translation: errors in metres.
        rotation_deg: errors in degrees.
        used: relations that were scored.
        skipped: relations without a pose near enough in time to one of their stamps.
    """

    translation: ErrorStatistics
    rotation_deg: ErrorStatistics
    used: int
    skipped: int


@dataclass(frozen=True)
class AbsoluteError:
    """What :func:`absolute_error` found.

    Attributes:
        translation: distances in metres after alignment; ``translation.rmse`` is the usual ATE.
        rotation_deg: angles in degrees after alignment.
        used: pairs of poses compared.
        skipped: poses of the sparser trajectory without a partner.
        T_reference_estimate: the alignment; of the plane where both trajectories are planar.
    """

    translation: ErrorStatistics
    rotation_deg: ErrorStatistics
    used: int
    skipped: int
    T_reference_estimate: Pose


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """What :func:`pose_errors` found of each of M poses of the estimate, in the order of time.

    Attributes:
        reference: (M,) int64, number of the pose of the reference that goes with each.
        estimate: (M,) int64, number of each pose of the estimate.
        stamps: (M,) float64 seconds, of the estimate.
        positions: (M, 3) float64 metres, of the estimate in the frame of the reference.
        translation: (M,) float64 metres to the reference.
        rotation_deg: (M,) float64 degrees to the reference.
        skipped: poses of the sparser trajectory without a partner.
        covered: share of the reference's time from its first pose with a partner to its last.
        T_reference_estimate: the alignment; of the plane where both trajectories are planar.
    """

    reference: IntArray
    estimate: IntArray
    stamps: FloatArray
    positions: FloatArray
    translation: FloatArray
    rotation_deg: FloatArray
    skipped: int
    covered: float
    T_reference_estimate: Pose

    __repr__ = one_line

    def summary(self) -> AbsoluteError:
        """Return the statistics of all poses."""
        return AbsoluteError(
            ErrorStatistics.of(self.translation),
            ErrorStatistics.of(self.rotation_deg),
            used=len(self.estimate),
            skipped=self.skipped,
            T_reference_estimate=self.T_reference_estimate,
        )


@dataclass(frozen=True)
class RelativeError:
    """What :func:`relative_error` found.

    Attributes:
        translation: errors of the motion over a step, metres.
        rotation_deg: errors of the rotation over a step, degrees.
        used: steps compared.
        skipped: poses of the sparser trajectory without a partner.
        step: length of the step.
        unit: unit of the step, "poses" or "metres".
    """

    translation: ErrorStatistics
    rotation_deg: ErrorStatistics
    used: int
    skipped: int
    step: float
    unit: str


def _angles_deg(R: FloatArray) -> FloatArray:
    """Return the angles of rotations (N, 3, 3) in degrees; atan2 stays exact near 0 and 180."""
    axis = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
    return np.degrees(np.arctan2(np.linalg.norm(axis, axis=1), np.trace(R, axis1=1, axis2=2) - 1.0))


def _relative(p: FloatArray, R: FloatArray, i: IntArray, j: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return poses ``j`` seen from poses ``i``: translations (M, 3) and rotations (M, 3, 3)."""
    Rt = np.swapaxes(R[i], 1, 2)
    return np.einsum("nab,nb->na", Rt, p[j] - p[i]), Rt @ R[j]


def _range(stamps: FloatArray) -> str:
    return f"{stamps.min():.6f} to {stamps.max():.6f} s"


def _check_tolerance(tolerance: float) -> None:
    if not tolerance >= 0.0:
        raise ArgumentError(f"the tolerance must be zero or more seconds, not {tolerance}")


def evaluate_relations(trajectory: Trajectory, relations: Relations, tolerance: float = 0.1) -> RelationScore:
    """Score a trajectory against true relative poses.

    For each relation the poses nearest in time to its two stamps are taken; their relative pose
    is compared with the relation. The published figure is the mean absolute error.

    Args:
        trajectory: the estimate; its stamps need not be sorted.
        relations: the truth, see :func:`hexmap.io.read_relations`.
        tolerance: how far off a pose may be, in seconds; relations without one are skipped.

    Raises:
        TrajectoryError: no relation has poses near enough in time, or there are none.
        ArgumentError: a negative tolerance.
    """
    _check_tolerance(tolerance)
    if len(relations) == 0 or len(trajectory) == 0:
        raise TrajectoryError(f"nothing to compare: {len(trajectory)} poses and {len(relations)} relations")
    i, off_i = trajectory.nearest(relations.from_stamps)
    j, off_j = trajectory.nearest(relations.to_stamps)
    ok = (off_i <= tolerance) & (off_j <= tolerance)
    if not ok.any():
        stamps = np.concatenate([relations.from_stamps, relations.to_stamps])
        raise TrajectoryError(
            f"no relation has poses within {tolerance:g} s of its stamps: {len(relations)} relations at "
            f"{_range(stamps)}, {len(trajectory)} poses at {_range(trajectory.stamps)}"
        )
    t, R = _relative(trajectory.positions, trajectory.rotations(), i[ok], j[ok])
    errors_t = np.linalg.norm(t - relations.translations[ok], axis=1)
    errors_r = _angles_deg(np.swapaxes(relations.rotations[ok], 1, 2) @ R)
    used = int(ok.sum())
    return RelationScore(
        ErrorStatistics.of(errors_t), ErrorStatistics.of(errors_r), used=used, skipped=len(relations) - used
    )


def _associate(
    reference: Trajectory, estimate: Trajectory, associate: Associate, tolerance: float
) -> tuple[IntArray, IntArray, int]:
    """Pair the poses: indices into both trajectories, by time if so paired, and how many poses found no partner."""
    _check_tolerance(tolerance)
    if len(reference) == 0 or len(estimate) == 0:
        raise TrajectoryError(
            f"nothing to compare: the reference has {len(reference)} poses, the estimate {len(estimate)}"
        )
    if associate == "order":
        if len(reference) != len(estimate):
            raise TrajectoryError(
                f"association by order takes as many poses in both: the reference has {len(reference)}, "
                f"the estimate {len(estimate)}; {_SCANS}"
            )
        both = np.arange(len(reference))
        return both, both, 0
    if associate != "time":
        raise ArgumentError(f"poses associate by 'time' or by 'order', not by {associate!r}")
    # Going through the sparser one pairs no pose of it twice and leaves no gaps unseen.
    swap = len(estimate) < len(reference)
    sparse, dense = (estimate, reference) if swap else (reference, estimate)
    different = len(np.unique(sparse.stamps))
    if len(sparse) > 3 and different * 2 < len(sparse):
        name = "estimate" if swap else "reference"
        raise TrajectoryError(
            f"the {len(sparse)} poses of the {name} have only {different} different stamps, "
            f"so they cannot be told apart by time; use --associate order; {_SCANS}"
        )
    by_time = [np.argsort(each.stamps, kind="stable") for each in (reference, estimate)]
    if np.array_equal(reference.stamps[by_time[0]], estimate.stamps[by_time[1]]):
        # Stamps repeat in real logs; where both list the same ones, each pose goes with its own.
        return by_time[0], by_time[1], 0
    found, off = dense.nearest(sparse.stamps)
    ok = off <= tolerance
    if not ok.any():
        raise TrajectoryError(
            f"no poses within {tolerance:g} s of each other: reference {len(reference)} stamps, "
            f"{_range(reference.stamps)}; estimate {len(estimate)} stamps, {_range(estimate.stamps)}; "
            f"try --associate order if both list the same poses; {_SCANS}"
        )
    # By time, and not in the order of the lines: the motion over a step is that between poses that follow one another.
    order = by_time[1 if swap else 0]
    of_sparse = order[ok[order]]
    of_dense = found[of_sparse]
    skipped = len(sparse) - len(of_sparse)
    return (of_dense, of_sparse, skipped) if swap else (of_sparse, of_dense, skipped)


def _align(reference: FloatArray, estimate: FloatArray, dim: int) -> Pose:
    """Return the rigid transform that carries ``estimate`` (N, 3) best onto ``reference``.

    Least squares after Umeyama (1991), equations (40) to (42), with the scale kept at 1; in the
    first ``dim`` coordinates.
    """
    a, b = estimate[:, :dim], reference[:, :dim]
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    U, _, Vt = np.linalg.svd((b - mean_b).T @ (a - mean_a))
    S = np.eye(dim)
    if np.linalg.det(U) * np.linalg.det(Vt) < 0.0:
        S[-1, -1] = -1.0
    R = U @ S @ Vt
    return Pose(R, mean_b - R @ mean_a)


def absolute_error(
    reference: Trajectory, estimate: Trajectory, associate: Associate = "time", tolerance: float = 0.1
) -> AbsoluteError:
    """Measure the absolute trajectory error (ATE) after rigid alignment.

    The alignment is in the plane where both trajectories are planar, else in space; the scale is
    never touched.

    Args:
        reference: the truth, or what is taken for it.
        estimate: what is measured.
        associate: "time" pairs each pose of the sparser trajectory with the nearest in time of
            the other; "order" pairs the first with the first and so on.
        tolerance: how far apart in time a pair may be, seconds.

    Raises:
        TrajectoryError: nothing associates, by order the lengths differ, or there are fewer than
            two pairs.
        ArgumentError: an unknown way to associate, or a negative tolerance.
    """
    return pose_errors(reference, estimate, associate, tolerance).summary()


def pose_errors(
    reference: Trajectory, estimate: Trajectory, associate: Associate = "time", tolerance: float = 0.1
) -> PoseErrors:
    """Measure the error of every pose after rigid alignment: arguments and errors as of :func:`absolute_error`."""
    i, j, skipped = _associate(reference, estimate, associate, tolerance)
    if len(i) < 2:
        raise TrajectoryError("an alignment takes at least two pairs of poses, and only one associates")
    dim = 2 if reference.planar and estimate.planar else 3
    T = _align(reference.positions[i], estimate.positions[j], dim)
    R, t = np.eye(3), np.zeros(3)
    R[:dim, :dim], t[:dim] = T.rotation, T.translation
    aligned = estimate.positions[j] @ R.T + t
    return PoseErrors(
        i, j, estimate.stamps[j], aligned,
        np.linalg.norm(reference.positions[i] - aligned, axis=1),
        _angles_deg(np.swapaxes(reference.rotations()[i], 1, 2) @ (R @ estimate.rotations()[j])),
        skipped, _share_of_time(reference.stamps, i), T,
    )  # fmt: skip


def _share_of_time(stamps: FloatArray, chosen: IntArray) -> float:
    """Return what share of the time of ``stamps`` lies between the first and the last of those chosen."""
    whole = float(np.ptp(stamps))
    return float(np.ptp(stamps[chosen])) / whole if whole > 0.0 else 1.0


def relative_error(
    reference: Trajectory,
    estimate: Trajectory,
    step: float = 1,
    unit: Literal["poses", "metres"] = "poses",
    associate: Associate = "time",
    tolerance: float = 0.1,
) -> RelativeError:
    """Measure the relative pose error (RPE): the motion over a step, estimate against reference.

    Args:
        reference: the truth, or what is taken for it.
        estimate: what is measured.
        step: a whole number of associated poses, or a distance along the reference in metres.
        unit: unit of ``step``.
        associate: as in :func:`absolute_error`.
        tolerance: how far apart in time a pair may be, seconds.

    Raises:
        TrajectoryError: nothing associates, or the trajectory is shorter than one step.
        ArgumentError: a step that is not positive (or not whole, for poses), an unknown unit or
            way to associate, or a negative tolerance.
    """
    if unit not in ("poses", "metres"):
        raise ArgumentError(f"the unit of a step is 'poses' or 'metres', not {unit!r}")
    if not (math.isfinite(step) and step > 0.0) or (unit == "poses" and step != int(step)):
        raise ArgumentError(f"a step of {step} {unit} cannot be taken")
    i, j, skipped = _associate(reference, estimate, associate, tolerance)
    p = reference.positions[i]
    start = np.arange(len(i))
    if unit == "poses":
        end = start + int(step)
    else:
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=1))])
        # A nanometre of slack, so that steps of exactly the asked length are not lost to rounding.
        end = np.searchsorted(along, along + step - 1e-9)
    inside = end < len(i)
    if not inside.any():
        raise TrajectoryError(f"the {len(i)} associated poses are shorter than one step of {step:g} {unit}")
    start, end = start[inside], end[inside]
    t_ref, R_ref = _relative(p, reference.rotations()[i], start, end)
    t_est, R_est = _relative(estimate.positions[j], estimate.rotations()[j], start, end)
    return RelativeError(
        ErrorStatistics.of(np.linalg.norm(t_est - t_ref, axis=1)),
        ErrorStatistics.of(_angles_deg(np.swapaxes(R_ref, 1, 2) @ R_est)),
        used=len(start),
        skipped=skipped,
        step=float(step),
        unit=unit,
    )
