"""A place that is found late is judged by what was seen before: the twin of a room does not inherit the robot's way."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Map
from hexmap.poses.pose import Pose
from localisation.localiser.history import History, Step
from localisation.localiser.place import Place
from localisation.localiser.place_matcher import PlaceMatcher
from localisation.localiser.settings import LocaliserSettings
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.hypotheses import is_same_place
from tests.lattices import JIT
from tests.localisation.test_localiser import boxes, drive, map_of, rectangle

pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")

SETTINGS = LocaliserSettings()
APART = 30.0  # metres between the halls


@cache
def two_halls(lattice: str) -> tuple[Map, list[tuple[np.ndarray, Pose]]]:
    """Two halls of one shape, the first with pillars where the robot comes from; and its way, seen 3 m far."""
    pillars = [wall for x in (2.0, 4.0, 6.0) for wall in rectangle(x, 1.0, x + 0.5, 1.5)]
    walls = [*rectangle(0.0, 0.0, 16.0, 4.0), *rectangle(APART, 0.0, APART + 16.0, 4.0), *pillars]
    walls += [wall for x in (11.0, 13.5) for y in (0.0, APART) for wall in rectangle(x + y, 0.8, x + y + 0.3, 1.4)]
    path = [(1.0, 2.5), (15.0, 2.5)]
    there = [(x + APART, y) for x, y in path]
    world = map_of(drive(boxes("halls", walls, path), 1) + drive(boxes("halls", walls, there), 1),
                   Lattice.named(lattice, 0.1))  # fmt: skip
    way = []
    for m in drive(boxes("halls", walls, path), 2)[::5]:
        p = m.event.points
        way.append((p[np.linalg.norm(p, axis=1) < 3.0], m.T_map_robot))
    return world, way


def remembered(lattice: str) -> tuple[History, PlaceMatcher, Step, np.ndarray, Pose, list[Pose]]:
    """Return the history until before the last scan, the step to that one, it and its pose, and the track."""
    world, way = two_halls(lattice)
    near = PlaceMatcher(GlobalMatcher.of_map(world), SETTINGS)
    history = History(near, SETTINGS)
    step = Step(Pose.identity(2), (0.0, 0.0), True)
    for k, (points, pose) in enumerate(way):
        if k:
            motion = way[k - 1][1].inverse() @ pose
            step = Step(motion, (float(np.linalg.norm(motion.translation)), motion.angle), True)
        if k < len(way) - 1:
            match = near.match_near(points, pose)
            history.add(points, step, match.fraction, float(np.median(np.linalg.norm(points, axis=1))), 0.0)
    return history, near, step, *way[-1], [pose for _, pose in way]


def found_at(near: PlaceMatcher, points: np.ndarray, pose: Pose) -> Place:
    match = near.match_near(points, pose)
    return Place.at(match.pose, near.covariance(points, match))


@pytest.mark.parametrize("lattice", ["A2", "Z2"])
def test_the_twin_of_a_place_fits_now_and_is_out_by_what_was_seen_before(lattice: str) -> None:
    history, near, step, points, pose, track = remembered(lattice)
    twin = Pose.planar(APART, 0.0, 0.0) @ pose
    here, there = found_at(near, points, pose), found_at(near, points, twin)
    shares = [near.match_near(points, p.pose).fraction for p in (here, there)]
    assert shares[0] == pytest.approx(shares[1], abs=0.1)
    assert history.judge(here, step, -10.0) and here.settled > -1.0
    assert all(is_same_place(a, b, (0.2, 0.1)) for a, b in zip(here.track, track, strict=True))
    assert len(here.judged) == len(track) - 1
    assert not history.judge(there, step, here.settled - 5.0)
    assert history.judge(found_at(near, points, twin), step, -1000.0)  # nothing is dropped that need not be


def test_what_was_seen_on_the_way_comes_together_in_the_frame_of_the_sensor_now() -> None:
    history, _, _, points, pose, track = remembered("A2")
    gathered = history.gather(points, track)
    assert np.array_equal(gathered[: len(points)], points)
    world, _ = two_halls("A2")
    walls = world.state().occupied
    hit = walls.lattice.quantise(pose.apply(gathered))
    cells = {tuple(c) for c in walls.index.tolist()}
    assert np.mean([tuple(c) in cells for c in hit.tolist()]) > 0.8
    # From the pillars on, which a scan of now does not see.
    assert np.ptp(pose.apply(gathered)[:, 0]) > np.ptp(pose.apply(points)[:, 0]) + 5.0


def test_without_a_history_a_place_is_taken_as_it_is() -> None:
    _, near, step, points, pose, _ = remembered("A2")
    place = found_at(near, points, pose)
    assert History(near, SETTINGS).judge(place, step, 0.0) and place.settled == 0.0
