from .base.errors import HexmapError
from .base.version import __version__
from .drawing.map_drawing import draw_map
from .drawing.path_drawing import draw_path
from .graph.lattice_graph import LatticeGraph
from .io.exports import export
from .io.grids.open_grid import open_grid
from .io.lidar.open_lidar import open_lidar
from .io.logs.open_log import open_log
from .io.map_file import load_map, save_map
from .io.trajectories import read_tum
from .lattice.lattice import Lattice
from .maps.builder import MapBuilder
from .maps.cell_state import CellState
from .maps.map import Map
from .maps.state_rule import StateRule
from .maps.voxel_list import VoxelList
from .poses.pose import Pose
from .poses.scan import Scan
from .poses.trajectory import Trajectory
from .web.page import write_page

__all__ = [
    "CellState",
    "HexmapError",
    "Lattice",
    "LatticeGraph",
    "Map",
    "MapBuilder",
    "Pose",
    "Scan",
    "StateRule",
    "Trajectory",
    "VoxelList",
    "__version__",
    "draw_map",
    "draw_path",
    "export",
    "load_map",
    "open_grid",
    "open_lidar",
    "open_log",
    "read_tum",
    "save_map",
    "write_page",
]
