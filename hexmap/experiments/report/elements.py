"""The elements of a report: headings, paragraphs, tables, figures, verdicts and matrices, and the text that they hold.

An element holds what every format shows of it, as clean plain text; each format escapes what it must.
"""

from __future__ import annotations

import platform
import re
from dataclasses import dataclass
from importlib import metadata
from typing import Any, ClassVar, Literal, get_args

import numpy as np

from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.base.version import __version__

# Undecided where the data speak neither for the claim nor against it.
Outcome = Literal["holds", "holds in part", "undecided", "does not hold"]

MARKS: dict[str, str] = {"holds": "✓", "holds in part": "◐", "undecided": "=", "does not hold": "✗"}

Standing = Literal["win", "tie", "lose"]

# In words, and as what is told apart without colours.
STANDINGS: dict[str, str] = {"win": "win", "tie": "even", "lose": "lose"}
STANDING_MARKS: dict[str, str] = {"win": "▲", "tie": "=", "lose": "▼"}


@dataclass(frozen=True, slots=True)
class Compared:
    """What became of one comparison.

    Attributes:
        standing: of the contestant that the row is about.
        text: the number that decided, such as ``"0.96"``.

    Raises:
        ArgumentError: a standing of another name.
    """

    standing: Standing
    text: str = ""

    def __post_init__(self) -> None:
        if self.standing not in get_args(Standing):
            raise ArgumentError(f"a standing is one of {', '.join(get_args(Standing))}, not {self.standing!r}")


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a claim.

    Attributes:
        claim: in one sentence.
        section: where it is made, such as ``"IV-B"``.
        outcome: what the data say.
        rule: by which the outcome was computed.
        evidence: the numbers it was computed from.

    Raises:
        ArgumentError: an outcome of another name.
    """

    claim: str
    section: str
    outcome: Outcome
    rule: str
    evidence: str

    def __post_init__(self) -> None:
        if self.outcome not in get_args(Outcome):
            raise ArgumentError(f"an outcome is one of {', '.join(get_args(Outcome))}, not {self.outcome!r}")


@dataclass(frozen=True)
class Heading:
    """A heading, and where links to it lead."""

    kind: ClassVar[str] = "heading"
    text: str
    level: int
    anchor: str


@dataclass(frozen=True)
class Paragraph:
    """A paragraph, on one line."""

    kind: ClassVar[str] = "paragraph"
    text: str


@dataclass(frozen=True)
class Table:
    """A table: what its file holds, and what a page shows."""

    kind: ClassVar[str] = "table"
    name: str
    number: int  # of tables and verdicts together
    columns: dict[str, str]  # key -> heading
    rows: list[dict[str, Any]]
    texts: list[list[str]]  # as shown
    numeric: list[bool]
    caption: str | None
    shown: int

    __repr__ = one_line

    @property
    def note(self) -> str:
        """Return the caption, and what the table leaves out."""
        hidden = len(self.rows) - self.shown
        words = f"The first {self.shown:,} of {len(self.rows):,} rows." if hidden > 0 else ""
        if self.shown == 0:
            words = f"{len(self.rows):,} rows, in the file alone."
        return " ".join(text for text in (self.caption, words) if text)


@dataclass(frozen=True)
class Figure:
    """A figure, drawn in every format."""

    kind: ClassVar[str] = "figure"
    name: str
    number: int
    caption: str
    files: dict[str, bytes]  # png, pdf, svg -> content

    __repr__ = one_line


@dataclass(frozen=True)
class Verdicts:
    """Claims and what became of each."""

    kind: ClassVar[str] = "verdicts"
    name: str
    number: int  # of tables and verdicts together
    rows: list[Verdict]

    __repr__ = one_line

    @property
    def summary(self) -> str:
        """Return how many of which outcome."""
        counts = [(outcome, sum(row.outcome == outcome for row in self.rows)) for outcome in get_args(Outcome)]
        words = {"holds": "hold", "holds in part": "hold in part", "undecided": "undecided"}
        words["does not hold"] = "do not hold"
        return ", ".join(f"{count} {outcome if count == 1 else words[outcome]}" for outcome, count in counts if count)


@dataclass(frozen=True)
class Matrix:
    """Who wins, is even and loses: a row a contestant, a column a measure."""

    kind: ClassVar[str] = "matrix"
    name: str
    number: int  # of tables, verdicts and matrices together
    corner: str
    rows: list[str]
    columns: list[str]
    cells: list[list[Compared | None]]
    caption: str

    @property
    def summary(self) -> str:
        """Return how many of which standing, and what it is about."""
        found = [cell.standing for line in self.cells for cell in line if cell is not None]
        counts = {name: found.count(name) for name in get_args(Standing)}
        return f"{counts['win']} won, {counts['tie']} even, {counts['lose']} lost. {self.caption}"


Element = Heading | Paragraph | Table | Figure | Verdicts | Matrix


# ---------------------------------------------------------------------- text


def clean(text: object) -> str:
    """Return text that every format can hold: no control characters, no halves of characters."""
    whole = str(text).encode("utf-8", "replace").decode()
    return re.sub(r"[^\t\n\r\x20-\x7e\xa0-\ufffd\U00010000-\U0010ffff]", "\N{REPLACEMENT CHARACTER}", whole)


def flat(text: object) -> str:
    """Return clean text on one line."""
    return " ".join(clean(text).split())


def versions() -> str:
    """Return the versions that numbers and figures may depend on, for the foot of a page."""
    import matplotlib

    found = {
        "hexmap": __version__,
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "numba": metadata.version("numba"),
        "matplotlib": matplotlib.__version__,
    }
    return ", ".join(f"{name} {version}" for name, version in found.items())
