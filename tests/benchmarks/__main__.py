"""``python -m tests.benchmarks``: all of them, one after the other."""

from tests.benchmarks import mapping, voxels

voxels.main()
mapping.main()
