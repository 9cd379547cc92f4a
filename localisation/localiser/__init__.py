"""Where a robot is in a map that is known: found without a start pose, tracked, and found again when lost.

``localiser`` is the loop, ``settings`` what it can be told, ``estimate`` what it answers, ``evidence`` when a scan
belongs to a map, ``fusion`` how a match and a prediction become one pose.
"""

from __future__ import annotations

from localisation.localiser.estimate import Estimate, Hypothesis, TrackState
from localisation.localiser.localise_log import Track, localise_log
from localisation.localiser.localiser import Localiser
from localisation.localiser.settings import LocaliserSettings

__all__ = ["Estimate", "Hypothesis", "Localiser", "LocaliserSettings", "Track", "TrackState", "localise_log"]
