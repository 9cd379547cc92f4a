"""Scan matching on any lattice: near a prediction, or anywhere in a map with a proof that nothing better is there.

``local_matcher`` tracks in a map that may grow (``occupancy``); ``global_matcher`` searches a whole map over all real
angles, on the bounds of ``pyramid`` and for any ``score``; ``refinement`` goes below a cell, ``information`` and
``beams`` say how far a match can be trusted, ``hypotheses`` what else would have fitted.
"""

from __future__ import annotations

from localisation.matching.global_matcher import GlobalMatcher, match_anywhere
from localisation.matching.hypotheses import Candidate, Hypotheses, find_hypotheses
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.match import Match, RunnerUp
from localisation.matching.occupancy import Occupancy
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence, hits, likelihood
from localisation.matching.search_region import SearchRegion, SearchWindow

__all__ = [
    "Candidate",
    "GlobalMatcher",
    "Hypotheses",
    "LocalMatcher",
    "Match",
    "Occupancy",
    "OccupancyPyramid",
    "RunnerUp",
    "SearchRegion",
    "SearchWindow",
    "coincidence",
    "find_hypotheses",
    "hits",
    "likelihood",
    "match_anywhere",
]
