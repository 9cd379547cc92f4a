"""Simulated robots: a few buildings, a drive through them, a laser, wheels that drift.

The demonstration, the examples and most tests run on what this package makes: a CARMEN log, and the true poses to
judge a map by. Rays are cast in closed form against wall segments and never through a lattice, so nothing that is
tested with them has a hand in making them.

    from hexmap.simulator import make_building, write_log

    write_log("office.clf", make_building("office"), "office.tum", seed=7)

Walls, way points and true poses share one frame, the building's: metres, x east, y north, angles counter-clockwise
from x. The odometry has a frame of its own that begins at the robot's start.
"""

from hexmap.simulator.buildings import BUILDINGS, Building, make_building
from hexmap.simulator.drive import Drive, clearance
from hexmap.simulator.events import OdometryNoise, SimulatedEvent, simulate
from hexmap.simulator.laser import NO_RETURN, Laser, cast
from hexmap.simulator.writer import LogSummary, write_log

__all__ = [
    "BUILDINGS",
    "NO_RETURN",
    "Building",
    "Drive",
    "Laser",
    "LogSummary",
    "OdometryNoise",
    "SimulatedEvent",
    "cast",
    "clearance",
    "make_building",
    "simulate",
    "write_log",
]
