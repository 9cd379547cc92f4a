"""Scan matching on any lattice: what is asked of a map, where to look, what was found."""

from __future__ import annotations

from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.match import Match
from localisation.matching.occupancy import Occupancy
from localisation.matching.search_region import SearchWindow

__all__ = ["LocalMatcher", "Match", "Occupancy", "SearchWindow"]
