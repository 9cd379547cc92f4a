"""Search over the graph layer of hexmap's lattices; a part of hexmap.

``search/`` has A*, Dijkstra and canonical search, ``any_angle/`` straight paths and their true optimum,
``replanning/`` paths in maps that change, ``benchmark/`` the comparison of lattices on published maps. What a planner
returns is in ``path``, how it is written to a file in ``path_files``.
"""

from __future__ import annotations

import lazy_loader

# The names, and the modules they live in, stand in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
