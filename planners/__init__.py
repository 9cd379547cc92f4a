"""Search over the graph layer of hexmap's lattices."""

from __future__ import annotations
