"""Maps that close their loops: overlapping submaps, certified matches between them, a robust graph of their poses."""

from __future__ import annotations

from localisation.slam.loop_search import LoopRecord
from localisation.slam.pose_graph import PoseGraph
from localisation.slam.settings import LoopSettings
from localisation.slam.slam import Slam, SlamResult

__all__ = ["LoopRecord", "LoopSettings", "PoseGraph", "Slam", "SlamResult"]
