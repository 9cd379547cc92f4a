"""A LiDAR is found in a map of space without a start pose, followed, and told from other buildings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from hexmap.simulator.space import RingLidar, SimulatedScan, make_building_3d, simulate_lidar
from localisation.localiser.estimate import TrackState
from localisation.localiser.lidar_localiser import LidarLocaliser, space_csv_header, space_csv_line
from localisation.matching.global_matcher import match_anywhere

pytest.importorskip("kiss_icp")

LATTICES = [
    Lattice.named("D3", 0.2),
    Lattice.named("Z3", 0.2),
    Lattice.named("D3*", 0.2),
    Lattice.named("A2xZ", 0.2),
    Lattice(np.array([[0.2, 0.03, 0.0], [0.0, 0.2, 0.04], [0.0, 0.0, 0.2]])),
]


@pytest.fixture(scope="module")
def run() -> list[SimulatedScan]:
    lidar = RingLidar(rings=24, azimuths=256, sweep=0.002)
    return list(simulate_lidar(make_building_3d("warehouse3d", seed=4), seed=4, lidar=lidar, scans=24))


def states_of(run: list[SimulatedScan], lattice: Lattice, left_out: int = 3) -> States:
    """Return the map of a run without every so-many-th scan."""
    builder = MapBuilder(lattice, 1, spare_hits=True)
    for number, simulated in enumerate(run):
        if number % left_out:
            builder.fuse(without_times(simulated.scan), simulated.T_map_lidar)
    return builder.build().state()


def without_times(scan: Scan) -> Scan:
    return replace(scan, times=None)


def off(a: Pose, b: Pose) -> tuple[float, float]:
    motion = a.inverse() @ b
    return float(np.linalg.norm(motion.translation)), math.degrees(
        math.acos(min(1.0, (float(np.trace(motion.rotation)) - 1.0) / 2.0))
    )


@pytest.mark.parametrize("lattice", LATTICES, ids=lambda lattice: lattice.name)
def test_a_scan_that_is_not_in_the_map_is_found_in_it_and_the_next_ones_are_followed(
    run: list[SimulatedScan], lattice: Lattice
) -> None:
    localiser = LidarLocaliser(states_of(run, lattice))
    states = []
    for simulated in run[9:15]:
        estimate = localiser.add(without_times(simulated.scan))
        states.append(estimate.state)
        assert estimate.pose is not None
        metres, degrees = off(simulated.T_map_lidar, estimate.pose)
        assert metres < 0.1, states
        assert degrees < 1.0
        assert estimate.covariance is not None
        assert (np.linalg.eigvalsh(estimate.covariance) > 0.0).all()
        assert len(space_csv_line(estimate).split(",")) == len(space_csv_header().split(","))
    assert set(states) == {TrackState.tracking}


def test_what_another_building_shows_has_no_place_in_the_map(run: list[SimulatedScan]) -> None:
    rng = np.random.default_rng(1)
    localiser = LidarLocaliser(states_of(run, LATTICES[0]))
    # A round hall with a dome, and points all over.
    angle, height = rng.uniform(0.0, 2.0 * math.pi, 6000), rng.uniform(-1.0, 4.0, 6000)
    dome = np.stack([7.0 * np.cos(angle), 7.0 * np.sin(angle), height], axis=1)
    for points in (dome, rng.normal(0.0, 4.0, (6000, 3))):
        estimate = localiser.add(Scan(0.0, points))
        assert estimate.state is TrackState.lost
        assert estimate.pose is None


def test_two_rooms_that_are_the_same_are_no_answer(run: list[SimulatedScan]) -> None:
    one = states_of(run, LATTICES[0])
    apart = np.array([200, 0, 0])
    both = States(
        *(
            VoxelList.from_cells(np.concatenate([cells.index, cells.index + apart]), cells.lattice)
            for cells in (one.occupied, one.free)
        )
    )
    estimate = LidarLocaliser(both).add(without_times(run[9].scan))
    assert estimate.state is TrackState.ambiguous
    assert estimate.pose is None
    a, b = (h.pose.translation for h in estimate.hypotheses)
    assert np.linalg.norm(a - b) == pytest.approx(np.linalg.norm(LATTICES[0].centres(apart[None])[0]), abs=0.1)


def test_a_start_pose_settles_which_of_two_rooms_it_is(run: list[SimulatedScan]) -> None:
    one = states_of(run, LATTICES[0])
    apart = np.array([200, 0, 0])
    both = States(
        *(
            VoxelList.from_cells(np.concatenate([cells.index, cells.index + apart]), cells.lattice)
            for cells in (one.occupied, one.free)
        )
    )
    true = run[9].T_map_lidar
    yaw = math.atan2(true.rotation[1, 0], true.rotation[0, 0])
    start = (float(true.translation[0]) + 0.4, float(true.translation[1]) - 0.3, yaw + 0.1)
    estimate = LidarLocaliser(both, start=start).add(without_times(run[9].scan))
    assert estimate.pose is not None
    assert off(true, estimate.pose)[0] < 0.1


def test_who_is_carried_away_is_lost_and_found_again(run: list[SimulatedScan]) -> None:
    localiser = LidarLocaliser(states_of(run, LATTICES[0]))
    assert localiser.add(without_times(run[3].scan)).state is TrackState.tracking
    nowhere = Scan(0.0, np.random.default_rng(2).normal(0.0, 4.0, (3000, 3)))
    assert [localiser.add(nowhere).state for _ in range(4)] == [TrackState.lost] * 4
    assert localiser.times_lost == 1
    estimate = localiser.add(without_times(run[18].scan))
    assert estimate.pose is not None
    assert off(run[18].T_map_lidar, estimate.pose)[0] < 0.1


def test_a_map_of_the_plane_or_without_a_wall_is_refused() -> None:
    plane = MapBuilder(Lattice.named("A2", 0.1), 1)
    plane.fuse(Scan(0.0, np.array([[1.0, 0.0]])), Pose.identity(2))
    with pytest.raises(ArgumentError, match="a lattice of the plane"):
        LidarLocaliser(plane.build().state())
    empty = VoxelList.empty(LATTICES[0])
    with pytest.raises(ArgumentError, match="no cell"):
        LidarLocaliser(States(empty, empty))


def test_match_anywhere_in_space_takes_a_whole_scan(run: list[SimulatedScan]) -> None:
    builder = MapBuilder(Lattice.named("D3", 0.2), 2)
    for number, simulated in enumerate(run):
        if number % 3:
            builder.fuse(without_times(simulated.scan), simulated.T_map_lidar)
    match = match_anywhere(builder.build(), run[9].scan.points)
    assert match is not None
    assert match.certified
    metres, degrees = off(run[9].T_map_lidar, match.pose)
    assert metres < 0.15
    assert degrees < 2.0
