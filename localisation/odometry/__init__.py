"""A pose for each scan of a log."""

from __future__ import annotations

from localisation.odometry.scan_odometry import ScanMapper

__all__ = ["ScanMapper"]
