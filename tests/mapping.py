"""A part of a log mapped by scan matching, for tests that need a map of it."""

from __future__ import annotations

from collections.abc import Iterable

from hexmap.maps.builder import MapBuilder
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
