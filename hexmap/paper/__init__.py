"""The paper's own experiments: rotation, the quantiser, and a verdict on each of its claims."""

from __future__ import annotations

from hexmap.paper.quantiser import quantiser_experiment
from hexmap.paper.rotation import rotation_experiment
from hexmap.paper.rotation_settings import RotationSettings
from hexmap.paper.verdicts import Evidence, judge

__all__ = ["Evidence", "RotationSettings", "judge", "quantiser_experiment", "rotation_experiment"]
