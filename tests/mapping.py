"""Maps for tests that need one: a part of a log mapped by scan matching, and a small room in space."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Map
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Scan
from localisation.odometry.scan_odometry import ScanOdometry
from localisation.settings import MappingSettings, make_builder


def map_events(
    events: Iterable[Event], settings: MappingSettings | None = None, mount: Pose | None = None
) -> tuple[MapBuilder, list[Pose]]:
    """Return the builder of all scans, and the robot's pose at each of them."""
    settings = settings or MappingSettings()
    builder = make_builder(settings)
    odometry = ScanOdometry(settings, builder, mount)
    poses = []
    for event in events:
        if isinstance(event, Scan):
            registered = odometry.register(event)
            builder.fuse(event, registered.T_map_scan)
            poses.append(registered.T_map_robot)
        else:
            odometry.observe(event)
    return builder, poses


ROOM = np.array([[-2.5, -1.5, 0.0], [2.5, 1.5, 2.0]])
PILLAR = np.array([[0.6, -0.2], [1.0, 0.2]])


def cast_in_room(position: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where rays (R, 3) of any length from ``position`` (3,) in the room meet its walls or its pillar, metres."""
    with np.errstate(divide="ignore"):
        far = np.where(directions > 0, ROOM[1] - position, ROOM[0] - position) / directions
        reach = np.where(directions == 0, np.inf, far).min(axis=1)
        ends = np.sort((PILLAR[:, None, :] - position[:2]) / directions[:, :2], axis=0)
    enter, leave = ends[0].max(axis=1), ends[1].min(axis=1)
    met = (enter < leave) & (enter > 0.0)
    return position + np.where(met, np.minimum(enter, reach), reach)[:, None] * directions


def room_in_space(
    lattice: Lattice, levels: int = 1, beams: int = 12_000, T_map_room: Pose | None = None, seed: int = 0
) -> Map:
    """A map of a room of 5 x 3 x 2 m with a pillar, from three places in it, on a lattice in space."""
    rng = np.random.default_rng(seed)
    builder = MapBuilder(lattice, levels)
    for x, y in ((-1.5, -0.7), (0.0, 0.8), (1.7, -0.5)):
        directions = rng.normal(size=(beams // 3, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        at = np.array([x, y, 1.1])
        points = cast_in_room(at, directions) - at
        pose = Pose.from_matrix(np.block([[np.eye(3), at[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]))
        builder.fuse(Scan(stamp=0.0, points=points), pose if T_map_room is None else T_map_room @ pose)
    return builder.build()
