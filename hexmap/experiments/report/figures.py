"""The figures of a report: one style for all, and the same bytes from the same figure."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# For lines that must be told apart, by people who see colours differently too, on white paper.
COLOURS = (
    "#33415c", "#e4572e", "#1b8a7a", "#a3509b", "#c99700", "#4a90d9", "#7b8794", "#7a4419", "#5a8f29", "#d16ba5",
)  # fmt: skip

_DPI = 200


@contextlib.contextmanager
def figure_style() -> Iterator[None]:
    """Make figures that are created in the block look like the report they go into.

    The user's own settings of matplotlib do not leak in, nor do these leak out.
    """
    import matplotlib
    from cycler import cycler
    from matplotlib import style

    with style.context("default", after_reset=True), matplotlib.rc_context({**_style(), **_SAVING}):
        matplotlib.rcParams["axes.prop_cycle"] = cycler(color=list(COLOURS))
        yield


def _style() -> dict[Any, Any]:
    text, faint, grid = "#1f2a3d", "#6b778c", "#e3e8ef"
    return {
        "figure.figsize": (7.2, 3.6),
        "figure.constrained_layout.use": True,
        "font.size": 9.0,
        "text.color": text,
        "axes.labelcolor": text,
        "axes.titlesize": 9.5,
        "axes.titlelocation": "left",
        "axes.titlecolor": text,
        "axes.edgecolor": "#b4bfcd",
        "axes.linewidth": 0.8,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "axes.axisbelow": True,
        "grid.color": grid,
        "grid.linewidth": 0.7,
        "xtick.color": faint,
        "ytick.color": faint,
        "xtick.labelcolor": text,
        "ytick.labelcolor": text,
        "xtick.major.size": 3.0,
        "ytick.major.size": 0.0,
        "lines.linewidth": 1.6,
        "lines.markersize": 4.0,
        "legend.frameon": False,
        "legend.fontsize": 8.5,
    }


# What decides the bytes of a file while it is written; the salt makes ids in SVG repeatable.
_SAVING: dict[Any, Any] = {"svg.hashsalt": "hexmap", "pdf.fonttype": 42, "font.family": ["DejaVu Sans"]}
_METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


def render(figure: Figure, kind: str) -> bytes:
    """Return a figure as a file: png, svg or pdf."""
    import matplotlib
    from matplotlib import style

    buffer = io.BytesIO()
    with style.context("default", after_reset=True), matplotlib.rc_context(_SAVING):
        figure.savefig(
            buffer,
            format=kind,
            dpi=_DPI,
            facecolor="white",
            bbox_inches="tight",
            pad_inches=0.08,
            metadata=_METADATA[kind],
        )
    content = buffer.getvalue()
    if kind == "svg":
        # Six digits of a point are half of the file.
        content = re.sub(rb' d="[^"]*"', lambda curve: re.sub(rb"(\.\d{3})\d+", rb"\1", curve[0]), content)
    return content
