"""A pose for each scan of a log as it comes: by the wheels, or by matching each scan against those before."""

from __future__ import annotations

from localisation.odometry.motion import MotionPredictor
from localisation.odometry.odometry import Odometry, RegisteredScan
from localisation.odometry.scan_odometry import ScanOdometry

__all__ = ["MotionPredictor", "Odometry", "RegisteredScan", "ScanOdometry"]
