"""Simulated robots in space: a building of several floors, a drive through it, a ring LiDAR.

Rays are cast in closed form against boxes and cylinders and never through a lattice. Every column of a sweep is cast
from the pose at its own time.

    from hexmap.simulator.space import make_building_3d, simulate_lidar

    for simulated in simulate_lidar(make_building_3d("warehouse3d", seed=7), seed=7):
        simulated.scan, simulated.T_map_lidar

Solids, way points and true poses share one frame, the building's: metres, x east, y north, z up from the ground floor.
"""

from hexmap.simulator.space.bag import BagSummary, write_bag
from hexmap.simulator.space.building import Building3D, Scene, SolidList, cast_in_space
from hexmap.simulator.space.drive import Drive3D
from hexmap.simulator.space.ring_lidar import RingLidar
from hexmap.simulator.space.run import People, SimulatedScan, lidar_poses, scan_stamps, simulate_lidar
from hexmap.simulator.space.warehouse import BUILDINGS_3D, make_building_3d

__all__ = [
    "BUILDINGS_3D",
    "BagSummary",
    "Building3D",
    "Drive3D",
    "People",
    "RingLidar",
    "Scene",
    "SimulatedScan",
    "SolidList",
    "cast_in_space",
    "lidar_poses",
    "make_building_3d",
    "scan_stamps",
    "simulate_lidar",
    "write_bag",
]
