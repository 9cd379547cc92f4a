"""How values show themselves, which know nothing of drawing: the root of the package says where that is found.

Maps, lists of cells and trajectories lie in layers below those that draw and make pages. Their ``plot`` and
``_repr_html_`` ask :func:`drawing` for it, ``Map.page`` asks :func:`pages`, and nothing is loaded before it is wanted.
"""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import Any

from hexmap.base.errors import MissingDependencyError

__all__ = ["draw_with", "drawing", "pages", "picture_html"]

_sources: list[Callable[[], Any]] = []


def draw_with(values: Callable[[], Any], web: Callable[[], Any]) -> None:
    """Name what returns the modules that draw values and make pages of maps, asked when they are needed.

    Args:
        values: returns ``hexmap.drawing.value_drawing``.
        web: returns ``hexmap.web.frame``.
    """
    _sources[:] = [values, web]


def drawing() -> Any:
    """Return the module that draws values.

    Raises:
        MissingDependencyError: nobody has named one.
    """
    return _source(0)


def pages() -> Any:
    """Return the module that makes pages of maps.

    Raises:
        MissingDependencyError: nobody has named one.
    """
    return _source(1)


def _source(number: int) -> Any:
    if not _sources:
        raise MissingDependencyError("nothing draws values: import hexmap first")
    return _sources[number]()


def picture_html(value: Any) -> str:
    """Return a small picture of a value and the line of its ``repr``, as HTML; the line alone where none can be drawn.

    Never more than some hundred kilobytes, and never an error: a notebook calls this for whatever a cell ends with.
    """
    line = f"<pre>{html.escape(repr(value))}</pre>"
    try:
        picture: str = drawing().inline_picture(value)
    except Exception:  # whatever it is, the value itself is sound, and its line says what it is
        return line
    return f"<div>{picture}{line}</div>"
