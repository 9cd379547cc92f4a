"""Buildings made by a seed for figures of mapping: ten kinds, and one of 230 x 200 m with loops of 500 m."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from hexmap.poses.pose import Pose
from hexmap.simulator.buildings import Building, make_building
from tests.localisation.slam.buildings import box, niches

__all__ = ["KINDS", "made_by_seed"]

# Widths of the blocks from west to east, their depths from south to north, width of the corridors, metres; and the
# drive, as numbers of the corridors from west and south.
Junction = tuple[int, int]
_BLOCKS: dict[str, tuple[Sequence[float], Sequence[float], float, Sequence[Junction]]] = {
    "ring": ([26], [16], 2.4, [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (1, 0)]),
    "long ring": ([70], [30], 2.6, [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (1, 0)]),
    "eight": ([18, 24], [20], 2.2, [(1, 0), (2, 0), (2, 1), (1, 1), (1, 0), (0, 0), (0, 1), (1, 1), (1, 0), (2, 0)]),
    "four blocks": (
        [16, 20], [14, 18], 2.4,
        [(0, 0), (2, 0), (2, 2), (0, 2), (0, 0), (0, 1), (2, 1), (2, 2), (1, 2), (1, 0), (0, 0), (0, 1)],
    ),
    "six blocks": (
        [15, 18, 13], [16, 14], 2.0,
        [(0, 0), (3, 0), (3, 1), (0, 1), (0, 2), (3, 2), (3, 1), (2, 1), (2, 0), (1, 0), (1, 2), (2, 2), (2, 1)],
    ),
    "large": (
        [138, 84], [108, 84], 3.0,
        [
            (0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (2, 0), (2, 2),
            (0, 2), (0, 1), (2, 1), (2, 2), (1, 2), (1, 0), (0, 0),
        ],
    ),
}  # fmt: skip

KINDS = ("office", "castle", "room", "corridor", "hall", *(name for name in _BLOCKS if name != "large"))
"""Ten kinds of buildings."""


def made_by_seed(kind: str, seed: int) -> Building:
    """Return a building of a kind: its niches, pillars and boxes are drawn, then it is stretched and turned."""
    rng = np.random.default_rng(seed)
    if kind in _BLOCKS:
        made = _blocks(kind, rng)
    elif kind == "corridor":
        made = _corridor(rng)
    elif kind == "hall":
        made = _hall(rng)
    else:
        made = make_building(kind)
    stretch = rng.uniform(0.95, 1.15, 2) if kind != "large" else np.ones(2)
    A = Pose.planar(0.0, 0.0, rng.uniform(0.0, 2.0 * math.pi)).rotation @ np.diag(stretch)
    return Building(f"{kind} {seed}", made.walls @ A.T, made.waypoints @ A.T)


def _outline(corners: Sequence[tuple[float, float]], rng: np.random.Generator, side: float) -> list[object]:
    """Return the walls along a polygon, anticlockwise, with niches to the right (1) or to the left (-1) of it."""
    walls: list[object] = []
    for a, b in zip(np.array(corners), np.array([*corners[1:], corners[0]]), strict=True):
        length = float(np.hypot(*(b - a)))
        along = (b - a) / length
        aside = side * np.array([along[1], -along[0]])
        points = [a + along * d + aside * depth for d, depth in niches(length, rng)]
        walls += itertools.pairwise(points)
    return walls


def _rectangle(x: float, y: float, width: float, depth: float) -> list[tuple[float, float]]:
    return [(x, y), (x + width, y), (x + width, y + depth), (x, y + depth)]


def _blocks(kind: str, rng: np.random.Generator) -> Building:
    """Return blocks with corridors between and around them; all walls have niches, no two alike."""
    widths, depths, gap, junctions = _BLOCKS[kind]
    x, y = (gap + np.concatenate([[0.0], np.cumsum(np.array(s) + gap)]) for s in (widths, depths))
    walls = _outline(_rectangle(0.0, 0.0, float(x[-1]), float(y[-1])), rng, 1.0)
    for i, width in enumerate(widths):
        for j, depth in enumerate(depths):
            walls += _outline(_rectangle(float(x[i]), float(y[j]), width, depth), rng, -1.0)
    path = np.array([(x[i] - 0.5 * gap, y[j] - 0.5 * gap) for i, j in junctions])
    # It begins and ends a little inside of the corridors, where there is something to see.
    path[0] += 2.0 * (path[1] - path[0]) / np.hypot(*(path[1] - path[0]))
    path[-1] -= 2.0 * (path[-1] - path[-2]) / np.hypot(*(path[-1] - path[-2]))
    return Building(kind, np.array(walls), path)


def _corridor(rng: np.random.Generator) -> Building:
    """Return a corridor of 40 m that is driven there and back, and there again."""
    walls = _outline(_rectangle(0.0, 0.0, 40.0, 2.4), rng, 1.0)
    return Building("corridor", np.array(walls), np.array([(1.5, 1.2), (38, 1.0), (2, 1.4), (36, 1.2)]))


def _hall(rng: np.random.Generator) -> Building:
    """Return a hall of 34 x 24 m with pillars in rows, boxes beside them, and two rounds of unequal size."""
    walls = _outline(_rectangle(0.0, 0.0, 34.0, 24.0), rng, 1.0)
    for x in (6.0, 13.0, 20.0, 27.0):
        for y in (7.0, 16.0):
            walls += box(x - 0.3, y - 0.3, 0.6, 0.6)
            width, depth = rng.uniform(0.4, 1.6, 2)
            walls += box(x + rng.uniform(-1.5, 0.8), y + 0.5, float(width), float(depth))
    path = [(3, 3), (31, 3.5), (30.5, 20.5), (3.5, 20), (3, 4), (16.5, 3), (17, 20.5), (30, 20), (31, 5), (18, 3.2)]
    return Building("hall", np.array(walls), np.array(path))
