"""The paper's metrics by hand and on uniform points."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.metrics import coefficient_of_variation, distortion, interquartile_variability, voxel_count
from tests import reference
from tests.lattices import BULK, CASES, Case

each = pytest.mark.parametrize("case", CASES, ids=str)


def test_by_hand() -> None:
    squares = Lattice.named("Z2", 1.0)
    points = [[0.3, 0.4], [10.0, 0.0], [10.0, 0.25]]
    assert voxel_count(points, squares) == 2
    assert distortion(points, squares) == pytest.approx((0.5 + 0.0 + 0.25) / 3)
    values = [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]  # mean 5, the population's sigma is 2
    assert coefficient_of_variation(values) == pytest.approx(0.4)
    assert interquartile_variability([1, 2, 3, 4, 5]) == pytest.approx((4 - 2) / (4 + 2))
    assert coefficient_of_variation([3, 3, 3]) == interquartile_variability([3, 3, 3]) == 0.0
    assert coefficient_of_variation([-v for v in values]) == pytest.approx(0.4)


@each
def test_voxel_count_is_the_length_of_the_list(case: Case) -> None:
    points = np.random.default_rng(1).uniform(-3, 3, (200, case.dim)) * case.lattice.resolution
    assert voxel_count(points, case.lattice) == len(reference.voxels(case, points))
    assert voxel_count([], case.lattice) == 0


@each
def test_distortion_of_uniform_points_is_the_mean_error_of_the_cell(case: Case) -> None:
    """At 1 m^2 the paper has 0.382 for squares and 0.378 for hexagons; over whole cells it is exact."""
    lattice = case.lattice
    rng = np.random.default_rng(2)
    points = rng.random((2 * BULK, case.dim)) @ lattice.basis.T
    sigma = lattice.resolution * math.sqrt(lattice.cell.second_moment * case.dim - lattice.cell.mean_error**2)
    expected = lattice.cell.mean_error * lattice.resolution
    assert abs(distortion(points, lattice) - expected) < 5 * sigma / math.sqrt(len(points))


@each
def test_metrics_scale_with_the_lattice(case: Case) -> None:
    points = np.random.default_rng(3).uniform(-2, 2, (300, case.dim))
    big = case.lattice.scaled(4.0)
    assert distortion(points * 4.0, big) == pytest.approx(4 * distortion(points, case.lattice))
    assert voxel_count(points * 4.0, big) == voxel_count(points, case.lattice)


def test_what_has_no_answer_is_refused() -> None:
    with pytest.raises(ArgumentError):
        distortion(np.empty((0, 2)), Lattice.named("A2"))
    for values in ([], [1.0, math.nan], [[1.0, 2.0]], [0.0, 0.0], [1.0, -1.0], [math.inf, 1.0]):
        with pytest.raises(ArgumentError):
            coefficient_of_variation(values)
        with pytest.raises(ArgumentError):
            interquartile_variability(values)
