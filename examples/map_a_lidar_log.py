"""Map the log of a LiDAR on face-centred cubic cells, look at it, and find a scan in the map again.

The log is simulated here: three seconds in a warehouse. Yours is a bag with PointCloud2 or a folder of point files.
"""

import tempfile
from pathlib import Path

import numpy as np

from hexmap.io.lidar import open_lidar
from hexmap.io.trajectories import read_trajectory
from hexmap.simulator.space import RingLidar, make_building_3d, write_bag
from localisation import LidarLocaliser, LidarSettings, build_lidar_map

folder = Path(tempfile.mkdtemp())
truth = folder / "truth.tum"
lidar = RingLidar(rings=32, azimuths=256)
write_bag(folder / "run", make_building_3d("warehouse3d", seed=1), truth, lidar=lidar, seed=1, scans=15)

# One pass for the poses, one for the map: a scan at a time is in memory.
log = open_lidar(folder / "run")
result = build_lidar_map(log, LidarSettings(lattice="D3", resolution=0.2, levels=2))
print(f"{result.scans} scans, {result.metres:.1f} m, {result.mean_share:.0%} of a scan's points lie on surfaces")
for k, level in enumerate(result.map.levels):
    print(f"level {k}: {len(level.hits)} cells of {level.lattice.resolution:g} m hit, {len(level.passes)} passed")

true = read_trajectory(truth)
way = np.linalg.norm(true.positions[-1] - true.positions[0])
found = np.linalg.norm(result.poses.positions[-1] - result.poses.positions[0])
print(f"from the first to the last scan: {found:.3f} m, in truth {way:.3f} m")

# Without a start pose: all yaws, the whole map, and then a look at how many points lie where the map is free.
localiser = LidarLocaliser(result.map.state())
scan = list(open_lidar(folder / "run"))[10]
estimate = localiser.add(scan)
print(f"{estimate.state}: {estimate.overlap:.0%} of the points meet the map, {estimate.contradicted:.0%} do not")
