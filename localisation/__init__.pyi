from .evaluation import PoseErrors, absolute_error, evaluate_relations, pose_errors, relative_error
from .lidar_settings import LidarSettings
from .localiser.estimate import Estimate
from .localiser.lidar_localiser import LidarLocaliser
from .localiser.localiser import Localiser
from .localiser.settings import LocaliserSettings
from .mapping.add_lidar_run import add_lidar_run
from .mapping.add_run import add_run
from .mapping.build_map import build_map
from .mapping.fuse_log import fuse_log
from .mapping.lidar_map import build_lidar_map, fuse_lidar_log
from .mapping.loop_closed_map import build_loop_closed_map
from .matching.global_matcher import GlobalMatcher, match_anywhere
from .matching.match import Match
from .matching.search_region import SearchRegion
from .settings import MappingSettings
from .slam.settings import LoopSettings

__all__ = [
    "Estimate",
    "GlobalMatcher",
    "LidarLocaliser",
    "LidarSettings",
    "Localiser",
    "LocaliserSettings",
    "LoopSettings",
    "MappingSettings",
    "Match",
    "PoseErrors",
    "SearchRegion",
    "absolute_error",
    "add_lidar_run",
    "add_run",
    "build_lidar_map",
    "build_loop_closed_map",
    "build_map",
    "evaluate_relations",
    "fuse_lidar_log",
    "fuse_log",
    "match_anywhere",
    "pose_errors",
    "relative_error",
]
