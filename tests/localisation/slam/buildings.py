"""Buildings in which loops close, or must not."""

from __future__ import annotations

import itertools

import numpy as np

from hexmap.poses.scan import Scan
from hexmap.simulator.buildings import Building
from hexmap.simulator.events import OdometryNoise, simulate
from hexmap.simulator.laser import Laser
from localisation.settings import MappingSettings
from localisation.slam import planar
from localisation.slam.settings import LoopSettings
from localisation.slam.slam import Slam, SlamResult

LASER = Laser(beams=121, rate=2.0, max_range=15.0)
BAD = OdometryNoise(rate=2.0, translation=0.1, rotation=0.06, heading=0.03, scale_bias=0.1, heading_bias=0.02)


def box(x: float, y: float, width: float, height: float) -> list[tuple[tuple[float, float], tuple[float, float]]]:
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    return list(zip(corners, [*corners[1:], corners[0]], strict=True))


def niches(length: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Points along a wall of some length with niches, distance and depth: no two alike."""
    points = [(0.0, 0.0)]
    at = rng.uniform(0.8, 2.5)
    while at < length - 3.0:
        width, depth = rng.uniform(0.6, 2.2), rng.uniform(0.3, 1.8)
        points += [(at, 0.0), (at, depth), (at + width, depth), (at + width, 0.0)]
        at += width + rng.uniform(0.8, 3.0)
    return [*points, (length, 0.0)]


def ring() -> Building:
    """Corridors 2.4 m wide around a block, with niches in the outer wall, and a drive once around and on."""
    walls = box(2.4, 2.4, 25.2, 15.2)
    rng = np.random.default_rng(3)
    corners = np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 20.0], [0.0, 20.0]])
    for k in range(4):
        a, b = corners[k], corners[(k + 1) % 4]
        along = (b - a) / np.hypot(*(b - a))
        out = np.array([along[1], -along[0]])
        points = [a + along * d + out * depth for d, depth in niches(float(np.hypot(*(b - a))), rng)]
        walls += [(tuple(p), tuple(q)) for p, q in itertools.pairwise(points)]
    path = [(4, 1.2), (28.8, 1.2), (28.8, 18.8), (1.2, 18.8), (1.2, 1.2), (24, 1.2)]
    return Building("ring", np.array(walls), np.array(path))


def twins() -> Building:
    """Two rooms with the same things in them, 14 m apart along a bare corridor."""
    walls = [((0.0, 0.0), (22.0, 0.0)), ((0.0, 0.0), (0.0, 2.4)), ((22.0, 0.0), (22.0, 2.4))]
    for x in (0.0, 14.0):
        walls += [((x, 2.4), (x, 8.0)), ((x, 8.0), (x + 8.0, 8.0)), ((x + 8.0, 8.0), (x + 8.0, 2.4))]
        walls += [((x, 2.4), (x + 3.0, 2.4)), ((x + 5.0, 2.4), (x + 8.0, 2.4))]
        walls += box(x + 0.8, 5.6, 1.1, 0.7) + box(x + 5.7, 3.0, 0.6, 1.4) + box(x + 6.1, 7.0, 1.2, 0.5)
    walls += [((8.0, 2.4), (14.0, 2.4))]
    path = [(4, 4), (5, 6.5), (2.5, 5), (4, 3.5), (4, 1.2), (18, 1.2), (18, 4), (19, 6.5), (16.5, 5), (18, 3.5)]
    return Building("twins", np.array(walls), np.array(path))


def drive(
    building: Building,
    odometry: OdometryNoise | None = None,
    loops: LoopSettings | None = None,
    seed: int = 1,
    **settings: object,
) -> tuple[SlamResult, np.ndarray]:
    """Map a drive; returns the result and the true poses (N, 3) of all readings, seen from the first."""
    slam = Slam(MappingSettings(mount=tuple(planar.of_pose(LASER.mount)), **settings), loops)
    truth = []
    for event in simulate(building, LASER, odometry, seed=seed):
        truth.append(planar.of_pose(event.T_map_robot))
        if isinstance(event.event, Scan):
            slam.register(event.event)
        else:
            slam.observe(event.event)
    true = np.array(truth)
    return slam.finish(), planar.between(np.broadcast_to(true[0], true.shape), true)


def errors(result: SlamResult, true: np.ndarray) -> np.ndarray:
    """Metres by which each pose is off."""
    seen = planar.between(np.broadcast_to(result.poses[0], result.poses.shape), result.poses)
    return np.hypot(*(seen - true)[:, :2].T)


def loop_errors(result: SlamResult, true: np.ndarray) -> np.ndarray:
    """Metres by which each accepted loop is off."""
    nodes = true[np.flatnonzero(result.is_scan)[result.node_scans]]
    found = [r for r in result.records if r.accepted]
    off = [planar.between(planar.between(nodes[r.i], nodes[r.j]), np.array(r.pose)) for r in found]
    return np.array([np.hypot(d[0], d[1]) for d in off])


def revisit_errors(result: SlamResult, true: np.ndarray) -> np.ndarray:
    """Metres by which scans that were taken at one place on two laps are off from one another."""
    at = np.flatnonzero(result.is_scan)
    poses, truth = result.poses[at], true[at]
    out = []
    for k in range(len(at)):
        distance = np.hypot(*(truth[:, :2] - truth[k, :2]).T)
        distance[max(0, k - len(at) // 3) :] = np.inf
        first = int(np.argmin(distance))
        if distance[first] < 0.5:
            off = planar.between(poses[first], poses[k]) - planar.between(truth[first], truth[k])
            out.append(np.hypot(off[0], off[1]))
    return np.array(out)
