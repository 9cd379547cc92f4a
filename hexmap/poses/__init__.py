"""Rigid transforms, trajectories, and what a log is made of: scans and odometry readings."""

from __future__ import annotations

from hexmap.poses.pose import Pose, wrap_angle
from hexmap.poses.scan import Event, Odometry, Scan
from hexmap.poses.trajectory import Relations, Trajectory

__all__ = ["Event", "Odometry", "Pose", "Relations", "Scan", "Trajectory", "wrap_angle"]
