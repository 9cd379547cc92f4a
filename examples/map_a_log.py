"""Map a laser log, save and draw the map, and score the poses against the simulated truth.

python examples/map_a_log.py            simulates a log first
python examples/map_a_log.py my.clf.gz  maps your own
"""

import sys
import tempfile
from pathlib import Path

from hexmap import Trajectory, draw_map, load_map, open_log, read_tum, save_map
from hexmap.simulator.buildings import make_building
from hexmap.simulator.writer import write_log
from localisation.evaluation import absolute_error
from localisation.mapping.build_map import build_map
from localisation.settings import MappingSettings

folder = Path(tempfile.mkdtemp())
log = Path(sys.argv[1]) if len(sys.argv) > 1 else folder / "room.clf"
if len(sys.argv) == 1:
    write_log(log, make_building("room"), folder / "truth.tum", seed=7)

stamps, poses = [], []


def keep(stamp, pose, is_scan):
    stamps.append(stamp)
    poses.append(pose)


result = build_map(open_log(log), MappingSettings(lattice="A2", resolution=0.05), on_pose=keep)
estimate = Trajectory.from_poses(stamps, poses)
save_map(folder / "map.parquet", result.map)
draw_map(load_map(folder / "map.parquet"), folder / "map.png", trajectory=estimate)
print(f"{result.scans} scans, {len(result.map.levels[0].hits)} cells hit; see {folder}")

if len(sys.argv) == 1:
    error = absolute_error(read_tum(folder / "truth.tum"), estimate, "order")
    print(f"mean error {error.translation.mean:.3f} m, {error.rotation_deg.mean:.2f} degrees")
