"""Scan matching, mapping from logs, and their evaluation; a part of hexmap.

``localiser/`` finds and follows a robot in a map, ``matching/`` finds a scan in it, ``odometry/`` gives each scan of
a log a pose, ``slam/`` closes loops, ``mapping/`` makes a map of a whole log, ``evaluation`` says how good a
trajectory is; ``settings`` holds what all of them can be told.
"""

from __future__ import annotations

import lazy_loader

# The names, and the modules they live in, stand in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
