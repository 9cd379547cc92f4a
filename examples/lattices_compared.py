"""How many cells two walls need on squares and on hexagons of the same area, as they turn and shift."""

import math

import numpy as np

from hexmap import Lattice, Pose, VoxelList
from hexmap.maps.metrics import coefficient_of_variation, distortion

rng = np.random.default_rng(0)
walls = np.concatenate([
    np.stack([rng.uniform(-10, 10, 20_000), np.full(20_000, 4.0)], axis=1),
    np.stack([np.full(20_000, -10.0), rng.uniform(-6, 4, 20_000)], axis=1),
])  # fmt: skip

for name in ("Z2", "A2"):
    lattice = Lattice.named(name, resolution=0.5)
    poses = [Pose.planar(*rng.uniform(-5, 5, 2), rng.uniform(0, 2 * math.pi)) for _ in range(100)]
    turned = [pose.apply(walls) for pose in poses]
    counts = [len(VoxelList.from_points(points, lattice)) for points in turned]
    error = np.mean([distortion(points, lattice) for points in turned])
    print(
        f"{name}: {np.mean(counts):.1f} cells, varying by {100 * coefficient_of_variation(counts):.2f} % "
        f"as the walls turn and shift; mean error {error:.4f} m"
    )
