"""Scan matching on any lattice: what is asked of a map, where to look, what was found."""

from __future__ import annotations

from localisation.matching.local_matcher import ScanMatcher
from localisation.matching.match import Match
from localisation.matching.occupancy import CounterOccupancy, ListOccupancy, Occupancy
from localisation.matching.search_region import SearchWindow

__all__ = ["CounterOccupancy", "ListOccupancy", "Match", "Occupancy", "ScanMatcher", "SearchWindow"]
