"""Which lattice localises better, and where it does not: one experiment on one's own log, with its baselines.

``settings`` say what is done, ``reading`` splits a log into scans of the map and scans that are looked for, which make
a ``world``; ``geometry`` and ``space`` say what differs between planar logs and a LiDAR's. ``maps`` makes the maps,
``cases`` are the small pieces of work, ``baselines/`` what others do, ``run`` puts them together; ``comparison`` and
``verdicts`` judge the lattices on the same scans, and ``report`` writes it all down.
"""

from __future__ import annotations

from localisation.experiments.reading import read_world
from localisation.experiments.run import ExperimentOutcome, localisation_experiment
from localisation.experiments.settings import ExperimentSettings
from localisation.experiments.world import World

__all__ = ["ExperimentOutcome", "ExperimentSettings", "World", "localisation_experiment", "read_world"]
