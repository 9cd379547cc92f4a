from .evaluation import absolute_error, evaluate_relations, relative_error
from .mapping.build_map import build_map
from .mapping.fuse_log import fuse_log
from .settings import MappingSettings

__all__ = [
    "MappingSettings",
    "absolute_error",
    "build_map",
    "evaluate_relations",
    "fuse_log",
    "relative_error",
]
