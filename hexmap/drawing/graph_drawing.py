"""Pictures of a graph of poses on its map: the path, the nodes, and the loops that hold it together."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hexmap.drawing.map_drawing import draw_states
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule

__all__ = ["draw_graph"]

_NODE, _LOOP, _REJECTED = "#1f5fa8", "#1a9850", "#d73027"


def draw_graph(
    map: Map,
    path: str | os.PathLike[str],
    trajectory: ArrayLike,
    nodes: ArrayLike,
    loops: ArrayLike,
    rejected: ArrayLike,
    rule: StateRule | None = None,
) -> Path:
    """Draw a map with the path, the nodes of a graph on it, and lines between the nodes of each loop.

    Args:
        map: the map.
        path: ``.png``, ``.svg`` or ``.pdf``.
        trajectory: (N, 2) where the robot went, metres.
        nodes: (M, 2) the nodes, metres.
        loops: (L, 2) pairs of nodes whose loop was accepted.
        rejected: (R, 2) pairs of nodes whose loop was tried and rejected.
        rule: what makes a cell occupied or free.

    Raises:
        ArgumentError: a suffix that is not known, or more pixels than an image should have.
        FileAccessError: the file cannot be written.
    """
    at = np.asarray(nodes, np.float64).reshape(-1, 2)

    def overlay(axes: Any) -> None:
        from matplotlib.collections import LineCollection

        for pairs, colour, width, order in ((rejected, _REJECTED, 0.3, 3), (loops, _LOOP, 0.7, 4)):
            lines = at[np.asarray(pairs, np.int64).reshape(-1, 2)]
            axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=width, zorder=order))
        axes.plot(at[:, 0], at[:, 1], ".", color=_NODE, markersize=2.0, zorder=5)

    words = f"{len(at)} nodes; loops: {_count(loops)} accepted (green), {_count(rejected)} rejected (red)"
    return draw_states(map.state(rule), path, trajectory, title=words, overlay=overlay)


def _count(pairs: ArrayLike) -> int:
    return len(np.asarray(pairs).reshape(-1, 2))
