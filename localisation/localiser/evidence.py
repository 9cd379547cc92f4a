"""Whether scans belong to a map: the shares of points that meet it and of beams that go through its walls.

Neighbouring beams see the same wall, so that a scan counts as no more than 1 / TEMPERATURE independent ones, as in the
covariance of a match. Of n such beams a share of p succeeds give or take sqrt(p (1 - p) / n); farther off than so many
standard deviations the map does not fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from localisation.localiser.settings import LocaliserSettings
from localisation.matching.information import TEMPERATURE
from localisation.matching.match import Match

__all__ = ["LOUDEST", "Evidence", "fits", "least_overlap", "log_odds", "meets"]

# One view in e^3 = 20 shows what the map knows nothing of, people or an open door: none speaks louder than that against
# a place, so that several must before it is out (p_rand of Thrun, Burgard and Fox, "Probabilistic Robotics", 6.3).
LOUDEST = 3.0


@dataclass(frozen=True)
class Evidence:
    """One scan at one pose: independent beams, and the shares of them that meet the map and that contradict it."""

    beams: float
    overlap: float
    contradicted: float

    @classmethod
    def of(cls, points: int, overlap: float, contradicted: float) -> Evidence:
        """Return the evidence of a scan of ``points`` points."""
        return cls(min(float(points), 1.0 / TEMPERATURE), overlap, contradicted)

    @classmethod
    def of_match(cls, points: int, match: Match | None) -> Evidence:
        """Return the evidence of a scan of ``points`` points and its match, None where nothing coincides."""
        return cls.of(points, 0.0, 0.0) if match is None else cls.of(points, match.overlap, match.contradicted or 0.0)


def least_overlap(beams: float, settings: LocaliserSettings) -> float:
    """Return the share of points that must meet the map, of ``beams`` independent ones."""
    p = settings.explained
    return max(0.0, p - settings.sigmas * math.sqrt(p * (1.0 - p) / beams))


def fits(scans: Iterable[Evidence], settings: LocaliserSettings, *, tracked: bool = False) -> bool:
    """Tell whether scans, taken together, agree with the map; no beam at all contradicts nothing.

    Of the points enough must meet the map, of the beams not too many end beyond its walls, and the one less the other
    must not fall short either: a place in another building may well reach both limits at once. A pose that is
    ``tracked`` has its history to speak for it, and beams go through the old places of moved walls.
    """
    scans = list(scans)
    n = sum(s.beams for s in scans)
    if n == 0.0:
        return True
    overlap = sum(s.beams * s.overlap for s in scans) / n
    contradicted = sum(s.beams * s.contradicted for s in scans) / n
    p, q = settings.explained, settings.changed if tracked else settings.contradicted
    most = q + settings.sigmas * math.sqrt(q * (1.0 - q) / n)
    # One beam counts 1, 0 or -1, with probabilities p, 1 - p - q and q.
    least = p - q - settings.sigmas * math.sqrt((p + q - (p - q) ** 2) / n)
    return overlap >= least_overlap(n, settings) and contradicted <= most and overlap - contradicted >= least


def meets(scans: Iterable[Evidence], settings: LocaliserSettings) -> bool:
    """Tell whether the points of scans, taken together, meet the map; no point at all misses nothing."""
    scans = list(scans)
    n = sum(s.beams for s in scans)
    return n == 0.0 or sum(s.beams * s.overlap for s in scans) / n >= least_overlap(n, settings)


def log_odds(share: float, best: float, points: int) -> float:
    """Return what a scan of ``points`` points says of a place against the best one: a log-likelihood, zero or less.

    The share of points that meet the map scatters by chance and with the cells they happen to fall into: what is within
    one standard deviation of the ``best`` share tells nothing, or such chances would add up to certainty.
    """
    share_of_beam = max(TEMPERATURE, 1.0 / points)
    chance = math.sqrt(max(best * (1.0 - best), share_of_beam) * share_of_beam)
    return max(-LOUDEST, min(0.0, share - best + chance) / share_of_beam)
