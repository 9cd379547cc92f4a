"""A report as one HTML page that needs no other file: figures and style are in it.

What the page looks like is in ``report.html.jinja`` and ``report.css`` beside this module.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import NamedTuple

from hexmap.experiments.report.elements import (
    MARKS,
    STANDING_MARKS,
    STANDINGS,
    Element,
    Figure,
    Heading,
    Table,
    versions,
)
from hexmap.experiments.statistics import Interval

_SVG_BYTES = 1_500_000  # a larger drawing goes into the page as an image


def html(title: str, command: str, settings: Mapping[str, str], elements: Sequence[Element]) -> str:
    """Return the whole page."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    files = resources.files("hexmap.experiments.report")
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    environment.filters |= {"unbroken": _unbroken, "headings": _headings, "cells": _cells, "data_uri": _data_uri}
    template = environment.from_string((files / "report.html.jinja").read_text(encoding="utf-8"))
    return template.render(
        title=title,
        command=command,
        settings=settings,
        elements=elements,
        sections=[element for element in elements if isinstance(element, Heading) and element.level == 2],
        marks=MARKS,
        standings=STANDINGS,
        standing_marks=STANDING_MARKS,
        style=Markup((files / "report.css").read_text(encoding="utf-8")),
        versions=versions(),
    )


class _Cell(NamedTuple):
    """A cell of a table: its text, and the ends of an interval, which stand back."""

    text: str
    ends: str
    numeric: bool


def _headings(table: Table) -> list[_Cell]:
    return [_Cell(text, "", numeric) for text, numeric in zip(table.columns.values(), table.numeric, strict=True)]


def _cells(table: Table) -> list[list[_Cell]]:
    """Return the cells that a page shows, row by row; ``table.rows`` may be longer."""
    lines = []
    for row, texts in zip(table.rows, table.texts, strict=False):
        line = []
        for key, text, numeric in zip(table.columns, texts, table.numeric, strict=True):
            value, bracket, ends = text.partition(" [")
            interval = isinstance(row[key], Interval) and bracket
            line.append(_Cell(value, f"[{ends}", numeric) if interval else _Cell(text, "", numeric))
        lines.append(line)
    return lines


def _unbroken(text: str) -> str:
    """Return text that may be broken into lines, though not between a number and its per cent."""
    return re.sub(r"(?<=\d) (?=%)", "\N{NO-BREAK SPACE}", text)


def _data_uri(figure: Figure) -> str:
    """Return a figure as an address that holds all of it: as a drawing, or as an image where that is smaller."""
    kind = "svg" if len(figure.files["svg"]) <= _SVG_BYTES else "png"
    data = base64.b64encode(figure.files[kind]).decode()
    return f"data:image/{'svg+xml' if kind == 'svg' else 'png'};base64,{data}"
