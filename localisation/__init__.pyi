from .evaluation import absolute_error, evaluate_relations, relative_error
from .localiser.estimate import Estimate
from .localiser.localiser import Localiser
from .localiser.settings import LocaliserSettings
from .mapping.build_map import build_map
from .mapping.fuse_log import fuse_log
from .matching.global_matcher import GlobalMatcher, match_anywhere
from .matching.match import Match
from .matching.search_region import SearchRegion
from .settings import MappingSettings

__all__ = [
    "Estimate",
    "GlobalMatcher",
    "Localiser",
    "LocaliserSettings",
    "MappingSettings",
    "Match",
    "SearchRegion",
    "absolute_error",
    "build_map",
    "evaluate_relations",
    "fuse_log",
    "match_anywhere",
    "relative_error",
]
