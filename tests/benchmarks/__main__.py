"""``python -m tests.benchmarks``: all of them, one after the other."""

from tests.benchmarks import (
    anyangle,
    canonical,
    experiments,
    lattice_localisation,
    localisation,
    mapping,
    optimum,
    planning,
    replanning,
    voxels,
)

voxels.main()
mapping.main()
experiments.main()
for module in (planning, canonical, optimum, anyangle, replanning, localisation, lattice_localisation):
    module.main([])
