"""The localiser as a user meets it: found without a start pose, honest where it cannot know, found again when lost."""

from __future__ import annotations

import itertools
import math
from functools import cache

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Map
from hexmap.maps.state_rule import States
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from hexmap.simulator.buildings import Building, make_building
from hexmap.simulator.events import SimulatedEvent, simulate
from localisation.localiser import localiser as localiser_module
from localisation.localiser.estimate import Estimate, TrackState
from localisation.localiser.localise_log import localise_log
from localisation.localiser.localiser import Localiser
from localisation.localiser.settings import LocaliserSettings
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.hypotheses import find_hypotheses, is_same_place
from tests.lattices import JIT

pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")


def drive(building: Building, seed: int, duration: float | None = None) -> list[SimulatedEvent]:
    return [m for m in simulate(building, seed=seed, duration=duration) if isinstance(m.event, Scan)]


def map_of(moments: list[SimulatedEvent], lattice: Lattice | None = None) -> Map:
    builder = MapBuilder(lattice or Lattice.named("A2", 0.05))
    for m in moments:
        builder.fuse(m.event, m.T_map_robot)
    return builder.build()


@cache
def room() -> tuple[Map, tuple[SimulatedEvent, ...]]:
    """The map of one drive through the room, and another drive."""
    building = make_building("room")
    return map_of(drive(building, 1)), tuple(drive(building, 2))


def boxes(name: str, walls: list[tuple[float, float, float, float]], path: list[tuple[float, float]]) -> Building:
    return Building(name, np.array([[(a, b), (c, d)] for a, b, c, d in walls]), np.array(path))


def rectangle(x0: float, y0: float, x1: float, y1: float) -> list[tuple[float, float, float, float]]:
    return [(x0, y0, x1, y0), (x1, y0, x1, y1), (x1, y1, x0, y1), (x0, y1, x0, y0)]


def run(localiser: Localiser, scans: list[Scan]) -> list[Estimate]:
    out = [localiser.add(scan) for scan in scans]
    assert all(e is not None for e in out)
    return out  # type: ignore[return-value]


def off(estimate: Estimate, truth: Pose) -> float:
    assert estimate.pose is not None
    return math.dist(estimate.pose.translation, truth.translation)


@pytest.mark.parametrize("lattice", ["A2", "Z2"])
def test_no_start_pose_is_needed_and_the_track_is_good_to_centimetres(lattice: str) -> None:
    world, moments = room()
    if lattice != "A2":
        world = map_of(drive(make_building("room"), 1), Lattice.named(lattice, 0.05))
    moments = moments[70:130]
    estimates = run(Localiser(world), [m.event for m in moments])
    assert estimates[0].state is TrackState.ambiguous and estimates[0].pose is None
    placed = [(e, m) for e, m in zip(estimates, moments, strict=True) if e.pose is not None]
    assert len(placed) >= len(moments) - 15  # a metre and a half
    assert max(off(e, m.T_map_robot) for e, m in placed) < 0.06
    errors = [e.pose.inverse() @ m.T_map_robot for e, m in placed]
    assert max(abs(d.theta) for d in errors) < 0.03
    for e, _ in placed:
        assert e.covariance.shape == (3, 3) and (np.linalg.eigvalsh(e.covariance) > 0.0).all()


def test_the_same_scans_give_the_same_bits() -> None:
    world, moments = room()
    scans = [m.event for m in moments[40:60]]
    first, second = (run(Localiser(world), scans) for _ in range(2))
    assert [e.pose for e in first] == [e.pose for e in second]
    assert [e.state for e in first] == [e.state for e in second]


def test_it_works_without_odometry_and_with_a_mount() -> None:
    world, moments = room()
    mount = Pose.planar(0.2, 0.1, 0.5)
    moments = moments[70:100]
    scans = [Scan(m.event.stamp, mount.inverse().apply(m.event.points)) for m in moments]
    estimates = run(Localiser(world, LocaliserSettings(use_odometry=False), mount=mount), scans)
    assert estimates[-1].pose is not None and off(estimates[-1], moments[-1].T_map_robot) < 0.06


def test_a_start_pose_is_tracked_from_the_first_scan() -> None:
    world, moments = room()
    near = moments[50].T_map_robot @ Pose.planar(0.15, -0.1, 0.1)
    (estimate,) = run(Localiser(world, start=near), [moments[50].event])
    assert estimate.state is TrackState.tracking and off(estimate, moments[50].T_map_robot) < 0.06


def test_another_building_is_not_in_this_map() -> None:
    world, _ = room()
    moments = drive(make_building("castle"), 3, duration=12.0)[::4]
    estimates = run(Localiser(world), [m.event for m in moments])
    assert not any(e.pose is not None for e in estimates)
    assert estimates[-1].state is TrackState.lost


def test_a_robot_that_is_nowhere_in_the_map_is_looked_for_less_and_less_often(monkeypatch: pytest.MonkeyPatch) -> None:
    """A log of another building ends in minutes: its long searches do not come every half a metre."""
    world, _ = room()
    searches: list[float] = []
    found = localiser_module.find_hypotheses

    def counted(*given: object, **how: object) -> object:
        searches.append(driven)
        return found(*given, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(localiser_module, "find_hypotheses", counted)
    localiser, driven, before = Localiser(world), 0.0, None
    for moment in drive(make_building("castle"), 3, duration=60.0):
        at = moment.T_map_robot.translation
        driven += 0.0 if before is None else float(np.linalg.norm(at - before))
        before = at
        assert isinstance(moment.event, Scan)
        localiser.add(moment.event)
    assert localiser.state is TrackState.lost
    assert len(searches) < 0.5 * driven / localiser.settings.step_metres
    assert searches[2] < 3.0  # the first ones come at once, for a robot that only began where little is seen


def test_two_equal_rooms_are_both_kept_until_the_robot_sees_what_tells_them_apart() -> None:
    # Rooms without anything in them, but for a pillar in the left one, which a short-sighted laser sees late.
    left, right = (0.0, 0.0, 6.0, 4.0), (10.0, 0.0, 16.0, 4.0)
    notch = [(1.0, 4.0, 1.0, 3.0), (11.0, 4.0, 11.0, 3.0)]
    cells = [*rectangle(*left), *rectangle(*right), *notch, *rectangle(4.6, 0.6, 5.2, 1.2)]
    # There and back, so that the pillar is seen along several metres: one view of it might be anything.
    path = [(1.0, 1.0), (5.0, 2.5), (1.2, 2.4), (5.0, 2.5)]
    building = boxes("twins", cells, path)
    world = map_of(drive(building, 1) + drive(boxes("twins", cells, [(x + 10.0, y) for x, y in path]), 1))
    moments = drive(building, 2)
    scans, half_way = [], 21
    for k, m in enumerate(moments):
        p = m.event.points
        # Until it is half way across the pillar is hidden from the robot.
        world_points = m.T_map_robot.apply(p)
        hidden = (world_points[:, 0] > 3.5) & (world_points[:, 1] < 1.6) & (k < half_way)
        scans.append(Scan(m.event.stamp, p[~hidden], odometry=m.event.odometry))
    estimates = run(Localiser(world), scans)
    half = estimates[half_way - 1]
    assert half.state is TrackState.ambiguous and half.pose is None
    best, *others = (h.pose.translation for h in half.hypotheses)
    assert any(abs(math.dist(best, other) - 10.0) < 0.2 for other in others)
    assert all(h.score > 0 and h.weight > 0.0 for h in half.hypotheses)
    assert estimates[-1].state is TrackState.tracking and off(estimates[-1], moments[-1].T_map_robot) < 0.1


def test_in_a_corridor_the_covariance_is_long_along_it() -> None:
    walls = rectangle(0.0, 0.0, 40.0, 2.0)
    world = map_of(drive(boxes("corridor", walls, [(8.0, 1.0), (32.0, 1.0)]), 1))
    m = drive(boxes("corridor", walls, [(18.0, 1.0), (22.0, 1.0)]), 2)[0]
    near = m.event.points[np.linalg.norm(m.event.points, axis=1) < 6.0]
    estimates = run(Localiser(world, start=m.T_map_robot), [Scan(0.0, near)] * 2)
    assert estimates[-1].pose is not None
    assert estimates[-1].covariance[0, 0] > 9.0 * estimates[-1].covariance[1, 1]


def test_people_half_the_beams_and_scans_without_a_return() -> None:
    world, moments = room()
    moments = moments[70:110]
    rng = np.random.default_rng(0)
    scans = []
    for k, m in enumerate(moments):
        p = np.array(m.event.points)
        if k == 20:
            p = p[:0]  # maximum ranges only
        elif k > 20:
            p = p[: len(p) // 2]
        else:
            shorter = rng.random(len(p)) < 0.25  # someone stands there
            p[shorter] *= rng.uniform(0.2, 0.9, (int(shorter.sum()), 1))
        scans.append(Scan(m.event.stamp, p, odometry=m.event.odometry))
    localiser = Localiser(world)
    estimates = run(localiser, scans)
    assert estimates[20].state is TrackState.tracking
    assert off(estimates[20], moments[20].T_map_robot) < 0.1
    assert localiser.times_lost == 0 and off(estimates[-1], moments[-1].T_map_robot) < 0.1
    first = run(Localiser(world), [scans[20]])
    assert first[0].state is TrackState.lost and first[0].hypotheses == []


def test_a_map_of_which_half_has_changed_still_serves() -> None:
    world, moments = room()
    states = world.state()
    low, high = world.bounds()
    middle = 0.5 * (low + high)[0]
    rng = np.random.default_rng(1)
    old = states.occupied.centres()
    moved = old[:, 0] > middle
    old[moved] += np.where(rng.random((int(moved.sum()), 1)) < 0.5, 0.3, 0.0)
    occupied = VoxelList.from_points(old, states.occupied.lattice)
    localiser = Localiser(States(occupied, states.free), start=moments[0].T_map_robot)
    estimates = run(localiser, [m.event for m in moments[:40]])
    assert estimates[-1].pose is not None and off(estimates[-1], moments[39].T_map_robot) < 0.15


def test_a_kidnapped_robot_is_noticed_and_found_again() -> None:
    world, moments = room()
    before, after = moments[60:75], moments[200:230]
    localiser = Localiser(world)
    estimates = run(localiser, [Scan(m.event.stamp, m.event.points, odometry=m.event.odometry) for m in before])
    assert estimates[-1].pose is not None
    # The wheels did not notice: they go on from where they were.
    jump = before[-1].event.odometry @ after[0].event.odometry.inverse()
    estimates = run(localiser, [Scan(m.event.stamp, m.event.points, odometry=jump @ m.event.odometry) for m in after])
    assert localiser.times_lost >= 1
    assert estimates[-1].pose is not None and off(estimates[-1], after[-1].T_map_robot) < 0.06


def test_twin_corridors_stay_two_hypotheses_with_their_scores() -> None:
    # Two corridors with the same niche, and nothing else that could tell which one it is.
    one = [*rectangle(0.0, 0.0, 14.0, 2.0), *rectangle(4.0, 1.5, 4.6, 2.0)]
    both = one + [(a, b + 6.0, c, d + 6.0) for a, b, c, d in one]
    lower, upper = (boxes("corridors", both, [(2.0, y), (12.0, y)]) for y in (0.9, 6.9))
    world = map_of(drive(lower, 1) + drive(upper, 1))
    moments = drive(lower, 2)
    estimates = run(Localiser(world), [m.event for m in moments])
    assert not any(e.pose is not None for e in estimates)
    last = estimates[-1]
    assert last.state is TrackState.ambiguous and len(last.hypotheses) == 2
    assert all(h.score > 0.5 * last.total and 0.01 < h.weight < 0.99 for h in last.hypotheses)
    found = sorted(h.pose.y for h in last.hypotheses)
    assert np.allclose(found, [moments[-1].T_map_robot.y, moments[-1].T_map_robot.y + 6.0], atol=0.1)


def floors() -> tuple[list[SimulatedEvent], list[SimulatedEvent], list[SimulatedEvent]]:
    """A drive on the lower floor, another one there, and one on the upper floor, drawn 40 m beside it."""
    castle = make_building("castle")
    up = Building("upper floor", castle.walls + np.array([40.0, 0.0]), castle.waypoints + np.array([40.0, 0.0]))
    return drive(make_building("room"), 1), drive(make_building("room"), 2)[60:90], drive(up, 3, duration=32.0)


def test_a_lift_to_a_floor_that_is_not_in_the_map_is_noticed() -> None:
    lower, before, after = floors()
    localiser = Localiser(map_of(lower))
    assert run(localiser, [m.event for m in before])[-1].state is TrackState.tracking
    # The wheels stand still in the lift.
    jump = before[-1].event.odometry @ after[0].event.odometry.inverse()
    scans = [Scan(m.event.stamp, m.event.points, odometry=jump @ m.event.odometry) for m in after]
    estimates = run(localiser, scans)
    assert localiser.times_lost == 1
    assert all(e.pose is None for e in estimates[10:])
    assert estimates[-1].state is TrackState.lost


def test_a_lift_to_a_floor_elsewhere_in_the_map_is_found_there() -> None:
    lower, before, after = floors()
    # The map is of every second scan there, those that are looked for are the others.
    localiser = Localiser(map_of(lower + after[::2]))
    assert run(localiser, [m.event for m in before])[-1].state is TrackState.tracking
    jump = before[-1].event.odometry @ after[0].event.odometry.inverse()
    again = after[1::2]
    scans = [Scan(m.event.stamp, m.event.points, odometry=jump @ m.event.odometry) for m in again]
    estimates = run(localiser, scans)
    assert localiser.times_lost == 1
    placed = [(e, m) for e, m in zip(estimates[5:], again[5:], strict=True) if e.pose is not None]
    assert placed and max(off(e, m.T_map_robot) for e, m in placed) < 0.1
    assert estimates[-1].state is TrackState.tracking


def test_places_go_as_far_along_a_plain_corridor_as_the_wheels_say() -> None:
    # Two niches alike at 8 and 20 m, then nothing but walls: the scans fit as well wherever a place might slide to.
    along = np.arange(0.0, 40.0, 0.02)
    in_niche = (np.abs(along - 8.0) < 0.4) | (np.abs(along - 20.0) < 0.4)
    deep = np.where(in_niche, 1.6, 1.0)
    ends = [(x, y) for x in (7.6, 8.4, 19.6, 20.4) for y in np.arange(1.0, 1.6, 0.02)]
    cloud = np.concatenate([np.stack([along, -np.ones_like(along)], 1), np.stack([along, deep], 1), np.array(ends)])
    lattice = Lattice.named("A2", 0.1)
    inside = np.stack(np.meshgrid(np.arange(0.0, 40.0, 0.05), np.arange(-0.85, 0.85, 0.05)), -1).reshape(-1, 2)
    world = States(VoxelList.from_points(cloud, lattice), VoxelList.from_points(inside, lattice))
    localiser = Localiser(world)
    for k in range(25):
        true = Pose.planar(8.0 + 0.25 * k, 0.0, 0.0)
        seen = true.inverse().apply(cloud[np.abs(cloud[:, 0] - true.x) < 3.0][::3])
        # The wheels err by three in a hundred.
        estimate = localiser.add(Scan(float(k), seen, odometry=Pose.planar(0.2575 * k, 0.0, 0.0)))
        assert estimate is not None and estimate.state is TrackState.ambiguous
    places = sorted(h.pose.x for h in estimate.hypotheses)
    assert np.abs(np.array(places) - [14.0, 26.0]).max() < 0.6


def test_in_space_the_same_code_finds_a_cloud() -> None:
    rng = np.random.default_rng(3)
    walls = [rng.uniform([0, 0, 0], [8, 6, 3], (1500, 3)) for _ in range(4)]
    walls[0][:, 0], walls[1][:, 0], walls[2][:, 1], walls[3][:, 1] = 0.0, 8.0, 0.0, 6.0
    box = rng.uniform([2, 1, 0], [3, 2.5, 1.5], (600, 3))
    cloud = np.concatenate([*walls, box, rng.uniform([5, 4, 0], [6.5, 5, 2.5], (600, 3))])
    lattice = Lattice.named("D3", 0.25)
    occupied = VoxelList.from_points(cloud, lattice)
    free = VoxelList.from_points(rng.uniform([0.5, 0.5, 0.5], [7.5, 5.5, 2.0], (20_000, 3)), lattice)
    localiser = Localiser(States(occupied, free), LocaliserSettings(contradicted=0.3, search_metres=0.5))
    estimate = None
    for k in range(40):
        c, s = math.cos(0.7 + 0.1 * k), math.sin(0.7 + 0.1 * k)
        at = [4.5 + 1.5 * math.sin(0.2 * k), 3.0 + 1.5 * math.cos(0.2 * k), 1.2]
        truth = Pose([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], at)
        seen = cloud[rng.choice(len(cloud), 400, replace=False)]
        estimate = localiser.add(Scan(float(k), truth.inverse().apply(seen)))
        if estimate is not None and estimate.state is TrackState.tracking:
            break
    assert estimate is not None and estimate.pose is not None
    assert estimate.pose.is_close(truth, metres=0.15, radians=0.05) and estimate.covariance.shape == (6, 6)


def test_hypotheses_are_the_best_places_in_order_and_apart() -> None:
    left, right = rectangle(0.0, 0.0, 5.0, 4.0), rectangle(8.0, 0.0, 13.0, 4.0)
    wall = np.concatenate([np.linspace((a, b), (c, d), 120) for a, b, c, d in left + right])
    cells = VoxelList.from_points(wall, Lattice.named("A2", 0.1))
    scan = np.concatenate([np.linspace((a, b), (c, d), 30) for a, b, c, d in left]) - [2.0, 1.0]
    matcher = GlobalMatcher(Localiser(States(cells, VoxelList.empty(cells.lattice))).matcher.pyramid)
    found = find_hypotheses(matcher, scan, 6, least=0.5, part=0.9)
    scores = [c.score for c in found.candidates]
    # Two rooms, each the right way round and turned by 180 degrees.
    assert found.complete and len(scores) == 4 and scores == sorted(scores, reverse=True)
    poses = [c.pose for c in found.candidates]
    assert not any(is_same_place(a, b, (0.5, 0.17)) for i, a in enumerate(poses) for b in poses[:i])
    best = matcher.match(scan, information=False)
    assert best is not None and scores[0] == best.score
    few = find_hypotheses(matcher, scan, 2, least=0.5, part=0.9)
    assert not few.complete and [c.score for c in few.candidates] == scores[:2]


def test_what_does_not_fit_is_said() -> None:
    world, _ = room()
    with pytest.raises(ArgumentError, match="dimension 2"):
        Localiser(world).add(Scan(0.0, np.zeros((3, 3))))
    with pytest.raises(ArgumentError, match="explained"):
        LocaliserSettings(explained=1.5)
    with pytest.raises(ArgumentError, match="dimension"):
        Localiser(world, mount=Pose.identity(3))


def test_the_way_until_the_robot_is_found_is_not_counted_to_and_fro() -> None:
    # Lines of odometry between scans are newer than the reading that comes with the next scan.
    world, moments = room()
    moments = moments[70:100]
    events: list[Scan | Odometry] = []
    for m, after in itertools.pairwise(moments):
        events += [m.event, *(Odometry(e.stamp, e.odometry) for e in (after.event, m.event))]

    class Drive(list):  # what localise_log takes of a log
        path, mount, warnings = "a drive", None, ()

    places: list[Estimate] = []
    track = localise_log(Drive(events), world, on_estimate=places.append)
    assert track.scans_until is not None
    way = [m.event.odometry.translation for m in moments[: track.scans_until]]
    assert track.metres_until == pytest.approx(sum(map(math.dist, way[1:], way)), abs=1e-9)
