from .exports import export, export_csv, export_ply
from .map_file import load_map, read_metadata, save_map
from .map_folder import MapFolder
from .map_store import FileStore, FolderStore, StoredMap
from .open_map import open_map
from .ros_map import export_ros
from .tile_merge import merge_maps
from .trajectories import TumWriter, read_relations, read_trajectory, read_tum, write_kitti, write_tum

__all__ = [
    "FileStore",
    "FolderStore",
    "MapFolder",
    "StoredMap",
    "TumWriter",
    "export",
    "export_csv",
    "export_ply",
    "export_ros",
    "load_map",
    "merge_maps",
    "open_map",
    "read_metadata",
    "read_relations",
    "read_trajectory",
    "read_tum",
    "save_map",
    "write_kitti",
    "write_tum",
]
