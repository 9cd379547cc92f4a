"""Maps that close their loops: what holds for whole drives."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from hexmap.simulator.buildings import make_building
from localisation.settings import MappingSettings
from localisation.slam.settings import LoopSettings
from localisation.slam.slam import Slam
from tests.lattices import JIT
from tests.localisation.slam.buildings import BAD, drive, errors, loop_errors, revisit_errors, ring, twins

# A search of submaps is millions of nodes.
pytestmark = pytest.mark.skipif(not JIT, reason="takes hours without the compiler")

# No match has so many cells: nothing is closed.
NONE = LoopSettings(min_cells=10**6)
SKEWED = [[0.045, 0.012], [0.0, 0.055]]


@pytest.mark.parametrize("lattice", ["A2", "Z2", SKEWED], ids=["A2", "Z2", "skewed"])
def test_loops_bring_two_laps_together(lattice: str | list[list[float]]) -> None:
    closed, true = drive(ring(), lattice=lattice, seed=0)
    open_, _ = drive(ring(), None, NONE, lattice=lattice, seed=0)
    assert sum(r.accepted for r in closed.records) >= 2
    assert not any(r.accepted for r in open_.records)
    assert revisit_errors(closed, true).mean() < 0.7 * revisit_errors(open_, true).mean()
    assert revisit_errors(closed, true).mean() < 0.05


def test_rooms_that_look_the_same_are_not_put_together() -> None:
    for seed in (1, 2, 3):
        result, true = drive(twins(), BAD, seed=seed)
        # A false one would be off by the 14 m between the rooms.
        assert loop_errors(result, true).max(initial=0.0) < 1.0


def test_the_same_drive_gives_the_same_bits_and_can_be_pickled_halfway() -> None:
    first, _ = drive(ring(), BAD, seed=1)
    again, _ = drive(ring(), BAD, seed=1)
    assert np.array_equal(first.poses, again.poses)
    assert np.array_equal(first.covariances, again.covariances)
    assert first.records == again.records
    assert np.array_equal(pickle.loads(pickle.dumps(first.graph)).poses, first.graph.poses)


def test_every_reading_has_a_pose_in_the_order_of_the_log() -> None:
    result, true = drive(ring(), None)
    assert len(result.poses) == len(true) == len(result.stamps) == len(result.covariances)
    assert (np.diff(result.stamps) >= 0.0).all()
    # No jumps where the poses of two submaps are blended.
    steps = np.hypot(*np.diff(result.poses[:, :2], axis=0).T)
    true_steps = np.hypot(*np.diff(true[:, :2], axis=0).T)
    assert np.abs(steps - true_steps).max() < 0.2
    assert result.poses[0] == pytest.approx(0.0, abs=1e-12)
    sizes = np.linalg.eigvalsh(result.covariances[result.is_scan])
    assert (sizes[-1] > 0.0).all() and (sizes >= -1e-12).all()


def test_logs_of_no_scan_one_scan_and_scans_without_points() -> None:
    empty = Slam(MappingSettings()).finish()
    assert len(empty.poses) == len(empty.scans) == len(empty.graph) == 0
    slam = Slam(MappingSettings())
    slam.observe(Odometry(0.0, Pose.planar(3.0, 1.0, 0.2)))
    slam.observe(Odometry(1.0, Pose.planar(4.0, 1.0, 0.2)))
    slam.register(Scan(2.0, np.array([[1.0, 0.0], [2.0, 1.0]]), odometry=Pose.planar(5.0, 1.0, 0.2)))
    one = slam.finish()
    assert one.is_scan.tolist() == [False, False, True]
    assert one.poses[0] == pytest.approx(0.0) and np.hypot(*one.poses[2, :2]) == pytest.approx(2.0)
    slam = Slam(MappingSettings())
    for k in range(12):
        slam.register(Scan(float(k), np.zeros((0, 2)), odometry=Pose.planar(1.5 * k, 0.0, 0.0)))
    blind = slam.finish()
    assert blind.poses[-1] == pytest.approx([16.5, 0.0, 0.0])
    assert len(blind.graph) > 2 and not blind.records


def test_without_odometry_a_building_is_mapped_all_the_same() -> None:
    result, true = drive(make_building("castle"), BAD, seed=3, use_odometry=False)
    assert errors(result, true)[result.is_scan].mean() < 0.1


def test_settings_that_make_no_sense_are_refused() -> None:
    for wrong in ({"trusted": 2.0}, {"node_scans": 0}, {"node_metres": 0.0}, {"probability": 1.0}):
        with pytest.raises(ArgumentError, match="not a setting for closing loops"):
            LoopSettings(**wrong)
