"""Submaps: what two of them have in view of one another."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from localisation.slam.submap import Submap, in_view, make_stretch
from tests.benchmarks.agreement import agreement


def submap(number: int, points: np.ndarray) -> Submap:
    return Submap.of(number, None, make_stretch(0, 1, np.zeros(3), points, Lattice.named("A2", 0.05)))


def squares(points: np.ndarray, wide: bool) -> set[tuple[int, int]]:
    """The squares of a metre that hold points, or also those beside them."""
    own = {tuple(row) for row in np.floor(points.astype(np.float32)).astype(int).tolist()}
    near = range(-1, 2) if wide else (0,)
    return {(x + i, y + j) for x, y in own for i in near for j in near}


def test_what_is_in_view_is_the_share_of_squares_both_ways_round() -> None:
    rng = np.random.default_rng(0)
    clouds = [rng.uniform(-6.0, 6.0, (n, 2)) * [1.0, rng.uniform(0.1, 1.0)] for n in (300, 80, 5, 0, 200)]
    poses = np.column_stack([rng.uniform(-5.0, 5.0, (5, 2)), rng.uniform(-3.0, 3.0, 5)])
    submaps = [submap(k, cloud) for k, cloud in enumerate(clouds)]
    found = in_view(submaps, poses, np.arange(4), 4)
    for i in range(4):
        shares = []
        for a, b in ((i, 4), (4, i)):
            middles = np.array(sorted(squares(clouds[a], False))).reshape(-1, 2) + 0.5
            there = Pose.planar(*poses[b]).inverse().apply(Pose.planar(*poses[a]).apply(middles))
            met = sum(tuple(row) in squares(clouds[b], True) for row in np.floor(there).astype(int).tolist())
            shares.append(met / max(1, len(middles)))
        assert found[i] == pytest.approx(math.sqrt(shares[0] * shares[1]))
    assert 0.1 < found[0] < 1.0 and found[3] == 0.0
    assert len(in_view(submaps, poses, np.zeros(0, np.int64), 4)) == 0


def test_passes_that_see_a_wall_elsewhere_disagree_by_as_much() -> None:
    # Along a wall there and back again, 45 m each way; the second time the poses are off by 0.2 m.
    wall = np.column_stack([np.arange(-5.0, 5.0, 0.05), np.full(200, 2.0)])
    there = [Pose.planar(0.5 * k, 0.0, 0.0) for k in range(90)]
    for shift in (0.0, 0.2):
        back = [Pose.planar(0.5 * k, shift, 0.0) for k in range(89, -1, -1)]
        off, share = agreement([wall] * 180, [*there, *back])
        assert off == pytest.approx(shift, abs=0.03) and share > 0.7
    alone, share = agreement([wall] * 90, there)
    assert alone < 0.03 and share < 0.2
