"""What is at a point of a map, in metres."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from hexmap import CellState, Map, MapBuilder, Pose, Scan, StateRule
from hexmap.base.errors import ArgumentError, BoundsError
from tests.lattices import CASES, Case

each = pytest.mark.parametrize("case", CASES, ids=str)


def map_on(case: Case) -> Map:
    builder = MapBuilder(case.lattice, levels=2)
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (40, case.dim))
    builder.fuse(Scan(stamp=0.0, points=points), Pose.identity(case.dim))
    return builder.build()


@each
@pytest.mark.parametrize("level", [0, 1])
def test_it_is_the_state_of_the_cell_of_the_point(case: Case, level: int) -> None:
    made = map_on(case)
    states = made.state(level=level)
    scattered = np.random.default_rng(2).uniform(-3.0, 3.0, (500, case.dim))
    points = np.concatenate([scattered, states.free.centres()[::5] + 0.1 * case.lattice.inradius])
    expected = states.of(states.occupied.lattice.quantise(points))
    found = made.state_at(points, level)
    assert found.dtype == np.uint8
    assert np.array_equal(found, expected)
    assert set(np.unique(found)) >= {CellState.FREE, CellState.UNKNOWN}
    assert (made.state_at(states.occupied.centres(), level) == CellState.OCCUPIED).all()


@each
def test_wherever_the_map_does_not_reach_is_unknown(case: Case) -> None:
    made = map_on(case)
    far = np.array([[1e3], [1e7], [1e12], [1e300], [-1e300]]) * np.ones(case.dim)
    assert made.state_at(far).tolist() == [CellState.UNKNOWN] * 5
    assert made.state_at([]).shape == (0,)
    assert MapBuilder(case.lattice).build().state_at(far).tolist() == [CellState.UNKNOWN] * 5


@each
def test_rules_and_wrong_points(case: Case) -> None:
    made = map_on(case)
    wall = made.state().occupied.centres()[:1]
    assert made.state_at(wall) == CellState.OCCUPIED
    assert made.state_at(wall, rule=StateRule(min_hits=1000)) != CellState.OCCUPIED
    assert made.state_at(wall) == CellState.OCCUPIED  # the rule of the last question is not kept
    with pytest.raises(BoundsError, match="point 1 is not finite"):
        made.state_at([[0.0] * case.dim, [np.nan] * case.dim])
    assert made.state_at(wall[0]) is CellState.OCCUPIED and made.state_at(wall[0].tolist()) is CellState.OCCUPIED
    for wrong in ([0.0] * (case.dim + 1), np.zeros((1, 4)), [["a"] * case.dim]):
        with pytest.raises(ArgumentError, match="points in this map"):
            made.state_at(wrong)
    with pytest.raises(ArgumentError, match="levels 0 to 1"):
        made.state_at(wall, level=2)
    assert pickle.loads(pickle.dumps(made)) == made
