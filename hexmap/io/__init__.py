"""Everything that is read or written: logs, point clouds, maps of others, map files, trajectories, exports."""

from __future__ import annotations

import lazy_loader

# The names, and the modules they live in, stand in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
