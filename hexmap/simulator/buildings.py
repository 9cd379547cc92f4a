"""The buildings: walls as line segments, and a path through them.

Walls have two faces and a thickness, as in a real building, so that a map shows both sides of them. Where two
solids overlap, the hidden ends of their segments are left in; no ray can reach them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line

__all__ = ["BUILDINGS", "Building", "make_building"]

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Building:
    """A building and a path through it, in the building's frame (metres, x east, y north).

    Attributes:
        name: what logs and messages call it.
        walls: (S, 2, 2) float64 end points of the wall segments, read-only.
        waypoints: (W, 2) float64 corners of the path, read-only; the drive rounds them.
    """

    name: str
    walls: NDArray[np.float64]
    waypoints: NDArray[np.float64]

    __repr__ = one_line

    def __post_init__(self) -> None:
        """Check the arrays and make them read-only copies.

        Raises:
            ArgumentError: shapes that do not fit, no walls, fewer than two way points, or values not finite.
        """
        walls = np.array(self.walls, dtype=np.float64)
        path = np.array(self.waypoints, dtype=np.float64)
        if walls.ndim != 3 or walls.shape[1:] != (2, 2) or len(walls) == 0:
            raise ArgumentError(f"the walls of a building must be (S, 2, 2) with at least one wall, not {walls.shape}")
        if path.ndim != 2 or path.shape[1] != 2 or len(path) < 2:
            raise ArgumentError(f"the way points of a building must be (W, 2) with at least two, not {path.shape}")
        if not (np.isfinite(walls).all() and np.isfinite(path).all()):
            raise ArgumentError(f"the walls and way points of the building {self.name} must be finite")
        for name, array in (("walls", walls), ("waypoints", path)):
            array.setflags(write=False)
            object.__setattr__(self, name, array)


def make_building(name: str) -> Building:
    """Return the built-in building called ``name``: one of ``BUILDINGS``.

    Raises:
        ArgumentError: no building of that name.

    Examples:
        >>> from hexmap.simulator import make_building
        >>> make_building("room").walls.shape[1:]
        (2, 2)
    """
    try:
        make = _MAKERS[name]
    except KeyError:
        raise ArgumentError(f"no building is called {name!r}; known are {', '.join(BUILDINGS)}") from None
    return make()


class _Plan:
    """Collects the outlines of walls and things while a building is drawn."""

    def __init__(self) -> None:
        self.segments: list[tuple[Point, Point]] = []

    def outline(self, corners: Sequence[Point]) -> None:
        """Add a closed polygon."""
        self.segments += zip(corners, [*corners[1:], corners[0]], strict=True)

    def box(self, x: float, y: float, width: float, depth: float, degrees: float = 0.0) -> None:
        """Add a box around (x, y), turned counter-clockwise."""
        c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
        half = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
        self.outline([(x + c * u * width - s * v * depth, y + s * u * width + c * v * depth) for u, v in half])

    def pillar(self, x: float, y: float, radius: float, sides: int = 8, degrees: float = 0.0) -> None:
        """Add a round thing as a regular polygon."""
        angles = [math.radians(degrees) + 2.0 * math.pi * k / sides for k in range(sides)]
        self.outline([(x + radius * math.cos(a), y + radius * math.sin(a)) for a in angles])

    def wall(self, a: Point, b: Point, thickness: float, doors: Iterable[tuple[float, float]] = ()) -> None:
        """Add a wall from ``a`` to ``b`` with doors at (distance of the middle from ``a``, width)."""
        length = math.dist(a, b)
        ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
        nx, ny = -0.5 * thickness * uy, 0.5 * thickness * ux
        edges = [0.0]
        for middle, width in sorted(doors):
            edges += [middle - 0.5 * width, middle + 0.5 * width]
        edges.append(length)
        for s, e in zip(edges[::2], edges[1::2], strict=True):
            p, q = (a[0] + s * ux, a[1] + s * uy), (a[0] + e * ux, a[1] + e * uy)
            self.outline(
                [(p[0] - nx, p[1] - ny), (q[0] - nx, q[1] - ny), (q[0] + nx, q[1] + ny), (p[0] + nx, p[1] + ny)]
            )

    def tower(self, x: float, y: float, inner: float, outer: float, door: float, towards: Point) -> None:
        """Add a hollow round tower with a door of a width that looks ``towards`` a point."""
        middle = math.atan2(towards[1] - y, towards[0] - x)
        corners: list[Point] = []
        for radius, sides, forwards in ((outer, 10, True), (inner, 8, False)):
            # The gap subtends more on the inside, which makes the jambs parallel.
            gap = math.asin(0.5 * door / radius)
            angles = [middle + gap + (2.0 * math.pi - 2.0 * gap) * k / sides for k in range(sides + 1)]
            arc = [(x + radius * math.cos(a), y + radius * math.sin(a)) for a in angles]
            corners += arc if forwards else arc[::-1]
        self.outline(corners)

    def building(self, name: str, waypoints: Sequence[Point]) -> Building:
        """Return the finished building."""
        return Building(name, np.array(self.segments), np.array(waypoints))


def _room() -> Building:
    """Return a plain room of 8 x 6 m with a few boxes in it."""
    plan = _Plan()
    plan.outline([(0.0, 0.0), (8.0, 0.0), (8.0, 6.0), (0.0, 6.0)])
    plan.box(3.6, 3.1, 1.4, 0.8, 15.0)
    plan.box(0.35, 4.9, 0.7, 1.6)
    plan.box(7.6, 0.5, 0.8, 1.0)
    plan.box(5.9, 5.65, 1.8, 0.7)
    plan.box(5.8, 2.6, 0.6, 0.6, 40.0)
    plan.pillar(1.9, 0.6, 0.25)
    path = [(1.2, 1.8), (4.6, 1.1), (6.8, 1.8), (6.9, 4.4), (4.8, 4.5), (2.0, 4.9), (1.2, 3.2), (1.2, 1.8), (4.6, 1.1)]
    path += [(4.9, 3.4), (4.6, 4.7), (2.0, 4.9), (1.4, 2.6), (2.4, 1.7)]
    return plan.building("room", path)


# Desks, cupboards, tables and chairs of the office: x, y, width, depth, degrees.
_OFFICE_THINGS = [
    (1.0, 1.2, 1.6, 0.8, 0.0), (2.6, 4.6, 1.8, 0.5, 0.0), (4.4, 1.4, 0.8, 1.6, 8.0),
    (7.0, 0.8, 1.2, 0.8, 0.0), (10.2, 3.2, 0.8, 1.6, 0.0), (7.1, 3.4, 0.5, 0.5, 25.0),
    (12.0, 0.6, 1.6, 0.8, 0.0), (15.1, 2.0, 0.5, 1.8, 0.0), (11.4, 3.4, 0.5, 1.0, 0.0),
    (16.5, 0.9, 1.0, 1.0, 30.0), (19.4, 2.6, 0.8, 1.8, 0.0),
    (23.2, 1.9, 2.4, 1.2, 12.0), (25.6, 4.2, 0.6, 1.0, 0.0),
    (25.4, 6.2, 0.8, 1.6, 0.0), (22.2, 9.1, 1.4, 0.5, 0.0),
    (25.5, 12.2, 0.7, 1.8, 0.0), (23.9, 9.95, 1.6, 0.6, 0.0), (22.1, 13.6, 1.2, 0.5, 0.0),
    (25.3, 17.4, 0.9, 2.4, 0.0), (24.0, 20.1, 1.8, 0.6, 0.0), (24.3, 14.6, 1.4, 0.7, -5.0),
    (25.0, 22.4, 0.8, 1.6, 0.0),
    (18.4, 25.3, 2.0, 0.8, 0.0), (17.5, 22.0, 0.6, 0.9, 0.0),
    (14.6, 24.2, 2.2, 1.1, -20.0),
    (11.9, 22.0, 0.6, 1.6, 0.0), (7.0, 25.4, 1.6, 0.8, 0.0), (9.2, 24.5, 1.6, 0.8, 10.0),
    (11.2, 25.5, 1.4, 0.7, 0.0),
    (0.8, 24.6, 0.9, 1.8, 0.0), (3.2, 25.5, 1.6, 0.7, 0.0), (1.4, 21.4, 1.4, 0.6, 0.0),
    (0.6, 18.8, 0.8, 1.8, 0.0), (2.8, 16.2, 1.6, 0.8, 0.0),
    (0.6, 11.6, 0.7, 1.6, 0.0), (2.6, 15.1, 1.8, 0.6, 0.0), (0.9, 14.4, 0.8, 0.8, 35.0),
    (1.2, 7.6, 1.4, 2.0, 15.0), (3.6, 9.8, 1.4, 0.5, 0.0),
    (7.3, 11.6, 0.8, 0.8, 0.0), (9.2, 10.2, 2.2, 1.0, 0.0),
    (11.6, 11.2, 0.7, 1.6, 0.0), (14.9, 8.4, 0.6, 1.6, 0.0), (14.8, 11.7, 0.8, 0.6, 0.0),
    (18.4, 8.0, 1.0, 0.7, -15.0), (17.0, 11.7, 2.4, 0.6, 0.0),
    (7.2, 18.2, 0.8, 0.8, 0.0), (8.6, 16.4, 1.8, 0.9, 0.0),
    (18.5, 15.2, 0.9, 1.8, 0.0), (14.7, 16.3, 1.4, 0.7, 0.0), (11.0, 14.6, 1.4, 0.7, 20.0),
]  # fmt: skip
_OFFICE_PATH: list[Point] = [
    (8.0, 6.0), (20.2, 6.0), (20.2, 11.8), (22.6, 11.8), (24.4, 12.9), (24.4, 11.0), (22.6, 11.8), (20.2, 11.8),
    (20.2, 17.2), (22.4, 17.1), (24.0, 16.6), (24.0, 18.4), (22.2, 17.2), (20.2, 17.2),
    (20.2, 19.7), (9.0, 19.7), (9.0, 22.0), (10.7, 22.2), (10.6, 23.2), (7.4, 23.3), (7.3, 22.1), (9.0, 21.8),
    (9.0, 19.7), (5.7, 19.7), (5.7, 13.1), (3.4, 13.1), (1.9, 13.7), (2.2, 12.0), (3.6, 13.1), (5.7, 13.1),
    (5.7, 6.0), (13.2, 6.0), (13.2, 8.4), (12.8, 10.0), (13.2, 11.0), (13.2, 13.0), (16.0, 13.0), (16.0, 15.0),
    (17.5, 16.3), (16.4, 17.5), (12.0, 17.6), (12.0, 19.7), (5.7, 19.7), (5.7, 6.0), (13.2, 6.0), (13.2, 3.0),
    (13.9, 1.9), (12.6, 1.9), (13.2, 3.4), (13.2, 6.0), (17.0, 6.0),
]  # fmt: skip


def _office() -> Building:
    """Return an office of 26 x 26 m: a ring of corridors, a passage across it, rooms on both sides."""
    plan = _Plan()
    plan.outline(
        [(0.0, 0.0), (26.0, 0.0), (26.0, 26.0), (24.4, 26.0), (24.4, 24.8), (21.6, 24.8), (21.6, 26.0), (0, 26)]
    )
    thin = 0.15
    # The outer side of the ring, then the rooms beyond it: south, north, west, east.
    plan.wall((0.0, 5.0), (26.0, 5.0), thin, [(5.5, 0.9), (8.6, 1.0), (13.2, 1.0), (17.6, 1.0), (20.6, 0.9)])
    plan.wall((0.0, 20.6), (26.0, 20.6), thin, [(5.3, 0.9), (9.0, 1.0), (15.2, 1.0), (18.8, 1.0), (20.6, 0.9)])
    plan.wall((4.8, 5.0), (4.8, 20.6), thin, [(2.8, 1.0), (8.1, 1.0), (13.4, 1.0)])
    plan.wall((21.2, 5.0), (21.2, 20.6), thin, [(2.4, 1.0), (6.8, 1.0), (12.2, 3.2)])
    for x in (6.2, 11.0, 15.5, 20.0):
        plan.wall((x, 0.0), (x, 5.0), thin)
    for x in (6.0, 12.5, 17.0, 20.0):
        plan.wall((x, 20.6), (x, 26.0), thin)
    for y in (10.2, 15.6):
        plan.wall((0.0, y), (4.8, y), thin)
    for y in (9.5, 14.0):
        plan.wall((21.2, y), (26.0, y), thin)
    # The core inside the ring: four rooms, a passage from west to east between them.
    plan.wall((6.6, 7.0), (19.2, 7.0), thin, [(2.2, 1.0), (6.6, 1.0), (11.0, 1.0)])
    plan.wall((6.6, 12.2), (19.2, 12.2), thin, [(6.6, 1.0)])
    plan.wall((6.6, 13.8), (19.2, 13.8), thin, [(1.7, 1.0), (9.4, 1.2)])
    plan.wall((6.6, 18.8), (19.2, 18.8), thin, [(5.4, 1.2)])
    for x in (6.6, 19.2):
        plan.wall((x, 7.0), (x, 12.2), thin)
        plan.wall((x, 13.8), (x, 18.8), thin)
    for x in (11.0, 15.4):
        plan.wall((x, 7.0), (x, 12.2), thin)
    plan.wall((10.0, 13.8), (10.0, 18.8), thin)
    # Pillars of the hall in the core and of the lobby in the east; niches and cupboards in the corridors.
    for x, y in ((13.0, 16.3), (16.4, 16.3)):
        plan.box(x, y, 0.4, 0.4)
    for y in (15.6, 18.6):
        plan.pillar(22.9, y, 0.22)
    plan.box(11.4, 5.26, 1.2, 0.36)
    plan.box(19.02, 10.4, 0.35, 1.4)
    plan.box(5.06, 9.6, 0.36, 1.0)
    plan.box(17.0, 18.98, 1.6, 0.3)
    for thing in _OFFICE_THINGS:
        plan.box(*thing)
    return plan.building("office", _OFFICE_PATH)


def _castle() -> Building:
    """Return a castle of about 42 x 38 m: thick walls at odd angles, towers, a courtyard around a keep."""
    plan = _Plan()
    yard = (17.0, 15.0)
    towers = [(0.0, 2.0), (20.0, -2.5), (36.0, 6.0), (37.5, 24.0), (22.0, 33.5), (3.5, 27.0), (-3.5, 14.5)]
    inner, outer = 2.0, 3.3
    for x, y in towers:
        plan.tower(x, y, inner, outer, 1.3, yard)
    gate = 3
    for i, (a, b) in enumerate(zip(towers, [*towers[1:], towers[0]], strict=True)):
        # From tower to tower, with ends inside the towers' masonry where nothing sees them.
        length = math.dist(a, b)
        trim = 0.5 * (inner + outer) / length
        p = (a[0] + trim * (b[0] - a[0]), a[1] + trim * (b[1] - a[1]))
        q = (b[0] - trim * (b[0] - a[0]), b[1] - trim * (b[1] - a[1]))
        plan.wall(p, q, 1.5, [(0.5 * math.dist(p, q), 3.0)] if i == gate else [])
    # The keep: a hall and a chamber behind it, turned against everything else.
    turn, cx, cy = math.radians(23.0), 18.5, 15.5

    def keep(u: float, v: float) -> Point:
        return (cx + math.cos(turn) * u - math.sin(turn) * v, cy + math.sin(turn) * u + math.cos(turn) * v)

    for a, b, doors in (
        ((-5.9, -4.0), (5.9, -4.0), [(3.6, 1.4)]),
        ((5.4, -3.5), (5.4, 3.5), [(5.2, 1.3)]),
        ((5.9, 4.0), (-5.9, 4.0), []),
        ((-5.4, 3.5), (-5.4, -3.5), []),
    ):
        plan.wall(keep(*a), keep(*b), 1.0, doors)
    plan.wall(keep(1.2, -3.6), keep(1.2, 3.6), 0.6, [(3.6, 1.2)])
    plan.pillar(*keep(-3.3, 0.9), 0.35, 8, 23.0)
    plan.pillar(*keep(-0.9, 2.1), 0.35, 8, 23.0)
    plan.box(*keep(4.3, -2.8), 0.9, 1.2, 23.0)
    # A chapel with an apse, a stable along the wall, a well, steps and a cart.
    plan.outline([(5.0, 17.6), (9.6, 15.9), (11.4, 20.9), (10.6, 22.6), (8.6, 23.1), (6.8, 22.5)])
    plan.box(10.8, 3.0, 6.0, 2.4, -13.0)
    plan.box(30.6, 9.4, 2.2, 4.4, 31.0)
    plan.pillar(27.4, 22.2, 0.9, 10, 7.0)
    plan.box(5.4, 8.2, 2.4, 1.3, 52.0)
    plan.box(16.2, 28.4, 3.0, 1.4, 19.0)
    # Once around the keep, with a look into a tower and at the gate, then through the keep itself.
    path = [
        (14.0, 7.4), (22.0, 4.2), (27.0, 7.0), (28.6, 13.0), (32.6, 16.0), (31.6, 21.5), (29.2, 27.4), (26.2, 26.4),
        (20.5, 28.2), (21.8, 32.9), (20.5, 28.2), (13.4, 25.4), (6.4, 24.6), (3.3, 20.8), (2.6, 15.4), (8.0, 12.6),
        (14.0, 7.4), keep(-2.3, -6.0), keep(-2.3, -1.2), keep(-0.6, 0.0), keep(3.2, 0.0), keep(3.4, 1.7),
        keep(7.6, 1.7), (27.6, 16.6), (28.6, 13.0), (27.0, 7.0),
    ]  # fmt: skip
    return plan.building("castle", path)


_MAKERS: dict[str, Callable[[], Building]] = {"office": _office, "castle": _castle, "room": _room}
BUILDINGS: tuple[str, ...] = tuple(_MAKERS)
"""Names of the built-in buildings."""
