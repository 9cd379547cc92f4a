"""How loops are looked for, and what a loop must pass before it is believed."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hexmap.base.errors import ArgumentError

__all__ = ["LoopSettings"]


@dataclass(frozen=True)
class LoopSettings:
    """How loops are looked for, and what a loop must pass before it is believed.

    Attributes:
        node_metres: path after which a submap begins. Two of these make a submap: long enough that a corridor's doors
            and ends are in it, short enough that scan matching drifts by less than a cell of the finest level.
        node_radians: the same for turns: once around, everything in view has been seen from here.
        node_scans: scans between two nodes at least, so that sparse scans make a submap as well.
        trusted: standard deviation, as a share of the matcher's window, up to which an old submap's place is known well
            enough to match scans against it: three of them leave a quarter of the window for the motion.
        most_local: stretches between nodes that scans are matched against at most, the nearest ones: the time for a
            scan must not grow with the log, and farther away than this much path there is little in view.
        sigmas: the window of a search is so many standard deviations of where the submap may be.
        searches: old submaps that a new one is looked for in at most.
        node_limit: blocks and poses that one search may take: some tenths of a second.
        min_margin: part of its score, 0 to 1, by which a match must outscore all others in its window. Matches of the
            same place by other scans differ by less.
        min_overlap: part of the cells of the one that lies in view of the other, 0 to 1, that must meet a wall there.
        min_cells: cells that must meet a wall at least: some metres of walls.
        max_contradicted: of the walls of one that the other knows, the part, 0 to 1, that may be free there: people,
            doors and what quantising leaves.
        reverse_cells: by how many searched cells the search in the other direction may differ, and
        reverse_radians: by what angle.
        confirm_metres: standard deviation of the place from which on a second loop must agree with the first one: three
            of them are as far as from one door or cupboard to the next one that looks the same.
        confirm_nodes: by how many nodes the new submaps of the two loops must differ at least.
        probability: of a true loop to pass each test of its residual.
    """

    node_metres: float = 4.0
    node_radians: float = 2.0 * math.pi
    node_scans: int = 4
    trusted: float = 0.25
    most_local: int = 24
    sigmas: float = 3.0
    searches: int = 3
    node_limit: int = 300_000
    min_margin: float = 0.1
    min_overlap: float = 0.35
    min_cells: int = 60
    max_contradicted: float = 0.2
    reverse_cells: float = 2.0
    reverse_radians: float = math.radians(1.0)
    confirm_metres: float = 0.25
    confirm_nodes: int = 2
    probability: float = 0.99

    def __post_init__(self) -> None:
        """Check the limits.

        Raises:
            ArgumentError: a number is out of its range.
        """
        parts = (self.trusted, self.min_margin, self.min_overlap, self.max_contradicted)
        counts = (self.node_scans, self.most_local, self.searches, self.node_limit, self.min_cells)
        lengths = (self.node_metres, self.node_radians, self.sigmas, self.confirm_metres)
        right = all(0.0 <= part <= 1.0 for part in parts) and all(count >= 1 for count in counts)
        if not (right and all(0.0 < v < math.inf for v in lengths) and 0.0 < self.probability < 1.0):
            raise ArgumentError(f"not a setting for closing loops: {self}")
