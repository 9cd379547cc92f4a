"""``python -m tests.benchmarks``: all of them, one after the other."""

from tests.benchmarks import (
    anyangle,
    canonical,
    experiments,
    lattice_localisation,
    lidar,
    localisation,
    localiser,
    mapping,
    optimum,
    page,
    planning,
    replanning,
    slam,
    voxels,
)

voxels.main()
mapping.main()
experiments.main()
slam.main([])
lidar.main([])
for module in (
    planning, canonical, optimum, anyangle, replanning, localisation, localiser, lattice_localisation, page,
):  # fmt: skip
    module.main([])
