"""Scans of some metres as one cloud: found in their own building, not where places are alike or elsewhere."""

from __future__ import annotations

import pytest

from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.simulator.events import SimulatedEvent
from localisation.localiser.gathering import CloudMatcher, Gathering, surface
from localisation.localiser.settings import LocaliserSettings
from tests.lattices import JIT
from tests.localisation.test_localiser import boxes, drive, make_building, map_of, rectangle, room

pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")


def gathered(moments: list[SimulatedEvent], lattice: Lattice) -> Gathering:
    gathering = Gathering(lattice, LocaliserSettings(), Pose.identity(2))
    for m in moments:
        gathering.add(m.event)
    return gathering


@pytest.mark.parametrize("lattice", ["A2", "Z2"])
def test_a_cloud_is_found_in_the_map_of_its_building(lattice: str) -> None:
    world = map_of(drive(make_building("room"), 1), Lattice.named(lattice, 0.05))
    moments = list(room()[1][60:100])
    gathering = gathered(moments, world.lattice)
    assert gathering.way > 2.0
    match = CloudMatcher(world.state(), LocaliserSettings()).find(gathering.cloud(), alone=True)
    assert match is not None and match.pose.is_close(moments[-1].T_map_robot, metres=0.2, radians=0.05)


def test_a_cloud_of_another_building_is_not_found() -> None:
    world, _ = room()
    gathering = gathered(drive(make_building("castle"), 3, duration=12.0), world.lattice)
    assert CloudMatcher(world.state(), LocaliserSettings()).find(gathering.cloud(), alone=True) is None


def test_of_two_corridors_that_are_alike_a_cloud_singles_out_neither() -> None:
    one = [*rectangle(0.0, 0.0, 14.0, 2.0), *rectangle(4.0, 1.5, 4.6, 2.0)]
    both = one + [(a, b + 6.0, c, d + 6.0) for a, b, c, d in one]
    lower, upper = (boxes("corridors", both, [(2.0, y), (12.0, y)]) for y in (0.9, 6.9))
    world = map_of(drive(lower, 1) + drive(upper, 1))
    gathering = gathered(drive(lower, 2), world.lattice)
    assert CloudMatcher(world.state(), LocaliserSettings()).find(gathering.cloud(), alone=True) is None


def test_of_a_thick_wall_its_surface_is_what_can_be_seen() -> None:
    states = room()[0].state()
    seen = surface(states)
    assert 0 < len(seen) <= len(states.occupied)
    assert any(states.free.contains(seen.index[:1] + offset)[0] for offset in seen.lattice.neighbours)
