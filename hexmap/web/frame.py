"""The page in a notebook: in a frame that may run its own scripts and nothing else."""

from __future__ import annotations

import html
from typing import Any

from hexmap.base.errors import ArgumentError
from hexmap.io.grids.grid_map import GridMap
from hexmap.maps.map import Map
from hexmap.web.page import page_html

__all__ = ["PageFrame", "page_frame"]

_LEAST, _MOST = 100, 10_000


class PageFrame:
    """A page that a notebook shows below the cell that it is the value of.

    Attributes:
        page: the whole page, as :func:`~hexmap.web.page.page_html` returns it.
        pixels: how high the frame is.
    """

    def __init__(self, page: str, pixels: int = 560) -> None:
        """Take a page.

        Raises:
            ArgumentError: the frame would be lower than 100 pixels or higher than 10,000.
        """
        if not _LEAST <= pixels <= _MOST:
            raise ArgumentError(f"a frame is {_LEAST} to {_MOST} pixels high, not {pixels}")
        self.page = page
        self.pixels = int(pixels)

    def _repr_html_(self) -> str:
        """Return the frame, for a notebook."""
        # The page comes as an attribute: it has no address, and shares no storage with the notebook.
        return (
            f'<iframe sandbox="allow-scripts" width="100%" height="{self.pixels}" style="border:0" '
            f'srcdoc="{html.escape(self.page, quote=True)}"></iframe>'
        )

    def __repr__(self) -> str:
        """Say how large it is."""
        return f"<PageFrame of {len(self.page) / 1e6:.2f} MB; a notebook shows it>"


def page_frame(source: Map | GridMap, *, pixels: int = 560, **options: Any) -> PageFrame:
    """Return the page of a map for a notebook; ``options`` are those of :func:`~hexmap.web.page.page_html`."""
    return PageFrame(page_html(source, **options), pixels)
