"""``python -m tests.benchmarks``: all of them, one after the other."""

from tests.benchmarks import experiments, mapping, planning, voxels

voxels.main()
mapping.main()
experiments.main()
planning.main()
