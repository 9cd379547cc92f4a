"""Pictures of trajectories beside a reference: the tracks in the plane, and the error of each over time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.atomic_files import atomic_path
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.drawing.map_drawing import check_picture

__all__ = ["Track", "draw_tracks"]

# For lines that must be told apart, by people who see colours differently too, on white paper.
_COLOURS = ("#e4572e", "#1b8a7a", "#4a90d9", "#a3509b", "#c99700", "#7a4419", "#5a8f29", "#d16ba5")
_STYLES = ("-", "--", "-.", ":")
_REFERENCE, _TEXT, _FAINT, _GRID = "#9aa5b5", "#1f2a3d", "#6b778c", "#e3e8ef"
_WIDTH = 8.0  # inches
_MOST = len(_COLOURS) * len(_STYLES)
# No line hides the one below it.
_THIN: dict[str, Any] = {"linewidth": 0.9, "alpha": 0.8}
_SAVING: dict[Any, Any] = {
    "svg.hashsalt": "hexmap", "pdf.fonttype": 42, "font.family": ["DejaVu Sans"], "font.size": 9.0,
}  # fmt: skip
_METADATA: dict[str, dict[str, None]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


@dataclass(frozen=True, eq=False)
class Track:
    """A trajectory that is drawn.

    Attributes:
        name: in the legend.
        stamps: (M,) float64 seconds.
        positions: (M, 3) float64 metres, in the frame of the reference.
        errors: (M,) float64 metres to the reference.
        reference: (M,) int64, number of the reference's pose that goes with each.
    """

    name: str
    stamps: NDArray[np.float64]
    positions: NDArray[np.float64]
    errors: NDArray[np.float64]
    reference: NDArray[np.int64]

    __repr__ = one_line


def draw_tracks(
    path: str | os.PathLike[str], reference: NDArray[np.float64], tracks: Sequence[Track], name: str = "reference"
) -> Path:
    """Draw the tracks from above over that of the reference, and below them the error of each over time.

    The errors stand over time; where stamps are no times, because they step back or most repeat, over the number of the
    reference's pose.

    Args:
        path: ``.png``, ``.svg`` or ``.pdf``.
        reference: (N, 3) float64 positions, metres.
        tracks: one or more.
        name: of the reference.

    Raises:
        ArgumentError: a suffix that is not known, or more tracks than can be told apart.
        FileAccessError: the file cannot be written.
    """
    import matplotlib
    from matplotlib import style
    from matplotlib.figure import Figure

    suffix = check_picture(Path(path))
    if not 1 <= len(tracks) <= _MOST:
        raise ArgumentError(f"1 to {_MOST} tracks can be told apart in a picture, not {len(tracks)}")
    seen = np.concatenate([reference, *(track.positions for track in tracks)])[:, :2]
    size = np.ptp(seen, axis=0)
    # As wide as the figure, and neither a strip nor a tower.
    height = _WIDTH * float(np.clip(size[1] / max(size[0], 1e-9), 0.3, 1.0))
    with style.context("default", after_reset=True), matplotlib.rc_context(_SAVING):
        figure = Figure(figsize=(_WIDTH, height + 2.6), layout="constrained", facecolor="white")
        above, below = figure.subplots(2, 1, height_ratios=[height, 2.2])
        above.plot(*reference[:, :2].T, color=_REFERENCE, linewidth=3.0, label=name, zorder=2)
        first = min(float(track.stamps[0]) for track in tracks)
        timed = all(_are_times(track.stamps) for track in tracks)
        for k, track in enumerate(tracks):
            line = {"color": _COLOURS[k % len(_COLOURS)], "linestyle": _STYLES[k // len(_COLOURS)]}
            above.plot(*track.positions[:, :2].T, label=track.name, zorder=3, **_THIN, **line)
            at = track.stamps - first if timed else track.reference
            below.plot(at, track.errors, **_THIN, **line)
        above.plot(*reference[0, :2], "o", color=_TEXT, markersize=5, label="start", zorder=4)
        above.set_aspect("equal", adjustable="datalim")
        above.set_xlabel("x, m")
        above.set_ylabel("y, m")
        below.set_xlabel("time, s" if timed else "number of the reference's pose")
        below.set_ylabel("error, m")
        below.set_ylim(bottom=0.0)
        below.margins(x=0.01)
        for axes in (above, below):
            axes.grid(color=_GRID, linewidth=0.7)
            axes.set_axisbelow(True)
            axes.tick_params(color=_FAINT, labelcolor=_TEXT)
            for side in ("top", "right"):
                axes.spines[side].set_visible(False)
        figure.legend(loc="outside upper left", ncols=min(4, len(tracks) + 2), frameon=False, fontsize=8.5)
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=150, metadata=_METADATA.get(suffix.removeprefix("."), {"Software": None}))
    return Path(path)


def _are_times(stamps: NDArray[np.float64]) -> bool:
    """Tell whether stamps are times: a scan and its odometry may share one, but none steps back and most are new."""
    steps = np.diff(stamps)
    return bool((steps >= 0.0).all() and 2 * np.count_nonzero(steps == 0.0) <= len(stamps))
