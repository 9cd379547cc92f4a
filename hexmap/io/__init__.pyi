from .exports import export, export_csv, export_ply
from .map_file import load_map, read_metadata, save_map
from .ros_map import export_ros
from .trajectories import TumWriter, read_relations, read_trajectory, read_tum, write_kitti, write_tum

__all__ = [
    "TumWriter",
    "export",
    "export_csv",
    "export_ply",
    "export_ros",
    "load_map",
    "read_metadata",
    "read_relations",
    "read_trajectory",
    "read_tum",
    "save_map",
    "write_kitti",
    "write_tum",
]
