"""A lattice of one's own goes through everything: nothing in hexmap asks a lattice for its name."""

import numpy as np

from hexmap import Lattice, MapBuilder, Pose, Scan
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.occupancy import Occupancy

mine = Lattice(np.array([[0.10, 0.03], [0.00, 0.09]]), name="mine")  # columns are the generators, metres
print(f"{len(mine.nearest)} nearest, {len(mine.faces)} faces, symmetries {len(mine.point_group)}")
print(f"cell area {mine.cell_volume:.4f} m2, second moment {mine.cell.second_moment:.6f}")

rng = np.random.default_rng(1)
room = rng.uniform((-3.0, -2.0), (4.0, 2.5), (3000, 2))
wall = rng.integers(0, 4, len(room))
room[wall == 0, 0], room[wall == 1, 0], room[wall == 2, 1], room[wall == 3, 1] = -3.0, 4.0, -2.0, 2.5

builder = MapBuilder(mine, levels=1)
builder.fuse(Scan(stamp=0.0, points=room), Pose.identity(2))
truth = Pose.planar(0.31, -0.12, 0.15)
match = LocalMatcher().match(truth.inverse().apply(room[::5]), Pose.identity(2), Occupancy.of_map(builder.build()))
print(f"found {match.pose}, true {truth}; {match.score} of {match.total} cells coincide")
