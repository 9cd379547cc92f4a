"""From a log to a map: by scan matching, or at given poses; and from two maps to one, wherever they lie."""

from __future__ import annotations

from localisation.mapping.align import Alignment, AlignSettings, align_maps, merge_aligned
from localisation.mapping.build_map import build_map
from localisation.mapping.fuse_log import fuse_log, readings_at_poses
from localisation.mapping.loop_closed_map import build_loop_closed_map
from localisation.mapping.result import MappingResult

__all__ = [
    "AlignSettings",
    "Alignment",
    "MappingResult",
    "align_maps",
    "build_loop_closed_map",
    "build_map",
    "fuse_log",
    "merge_aligned",
    "readings_at_poses",
]
