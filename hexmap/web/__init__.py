"""The page: a map, or one world on two lattices, in one HTML file to look and plan in.

The file needs no other one and no network. What goes into it is decided in :mod:`hexmap.web.payload`; what it looks
like and does is in ``page.html.jinja``, ``page.css`` and the scripts beside this module, which run in any browser of
2023 and later.
"""

from __future__ import annotations

from hexmap.web.frame import PageFrame, page_frame
from hexmap.web.page import page_html, write_page

__all__ = ["PageFrame", "page_frame", "page_html", "write_page"]
