"""From a log to a map: by scan matching, or at given poses."""

from __future__ import annotations

from localisation.mapping.build_map import build_map
from localisation.mapping.fuse_log import fuse_log, readings_at_poses
from localisation.mapping.result import MappingResult

__all__ = ["MappingResult", "build_map", "fuse_log", "readings_at_poses"]
