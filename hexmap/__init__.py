"""hexmap: scan matching, mapping and path planning on square, hexagonal, cubic, FCC and BCC lattices.

The folders are the layers, and each imports only from those below it: ``cli``, ``paper``, ``experiments``, ``web``,
``drawing``, ``io``, ``graph``, ``simulator``, ``maps``, ``poses``, ``lattice``, ``base``. The packages ``planners`` and
``localisation`` lie between ``cli`` and ``paper``.
"""

from __future__ import annotations

from typing import Any

import lazy_loader

from hexmap.base.kernel_cache import find_kernel_cache
from hexmap.base.pictures import draw_with

# Before any module with kernels is loaded.
find_kernel_cache()


def _drawing() -> Any:
    """Return what draws maps, lists of cells and trajectories, which lie in layers below it."""
    from hexmap.drawing import value_drawing

    return value_drawing


def _frame() -> Any:
    """Return what makes the page of a map, which lies in a layer below it."""
    from hexmap.web import frame

    return frame


draw_with(_drawing, _frame)

# The names, and the modules they live in, stand in __init__.pyi; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
