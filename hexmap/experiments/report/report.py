"""Reports of experiments: one HTML file that needs no other, Markdown, a CSV a table, figures as PNG and PDF.

A report is put together element by element, in the order in which it is read, and written at the end. The same
elements give the same bytes: there is no date in it, and of the machine only the versions that numbers may
depend on. All text is plain text; what looks like markup in it is shown as it stands.

    report = Report("Rotation", "hexmap experiment rotation hall.pcd -o report/", {"volume": 0.001})
    report.heading("Voxel count")
    report.table("summary", [{"lattice": "D3", "variability": bootstrap(counts, cv, rng=rng)}])
    report.figure("counts", figure, "Voxel count over the angle.")
    report.write("report")
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any

import numpy as np

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError, FileAccessError
from hexmap.experiments.report.csv_tables import csv_matrix, csv_table, csv_verdicts
from hexmap.experiments.report.elements import (
    Compared,
    Element,
    Figure,
    Heading,
    Matrix,
    Outcome,
    Paragraph,
    Table,
    Verdict,
    Verdicts,
    clean,
    flat,
)
from hexmap.experiments.report.figures import COLOURS, figure_style, render
from hexmap.experiments.report.html import html
from hexmap.experiments.report.markdown import markdown
from hexmap.experiments.report.numbers import Format, column, format_interval, format_number, is_numeric, scalar

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

__all__ = ["COLOURS", "Format", "Outcome", "Report", "Verdict", "figure_style", "format_interval", "format_number"]

_LIST = "hexmap-report-files"
_KINDS = (".csv", ".png", ".pdf")
_NUMBERED = Table | Verdicts | Matrix
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")


class Report:
    """A report that is put together element by element, and then written.

    Args:
        title: of the report.
        command: that made it, as one would type it again.
        settings: all that was set, by name; values that JSON can hold.
    """

    def __init__(self, title: str, command: str = "", settings: Mapping[str, Any] | None = None) -> None:
        self.title, self.command = clean(title), clean(command)
        self.settings = {clean(name): _setting(value) for name, value in (settings or {}).items()}
        self._elements: list[Element] = []
        self._names: set[str] = set()
        self._anchors: set[str] = set()
        self._times: Report | None = None

    @property
    def times(self) -> Report:
        """The report of wall-clock figures, which are never the same twice: written into the folder ``times``.

        What is put into it is in no other file, so that all others are the same bits for the same input.
        """
        if self._times is None:
            self._times = Report(f"{self.title}: times", self.command, self.settings)
        return self._times

    def heading(self, text: str, level: int = 2) -> None:
        """Add a heading; level 2 is a section, 3 and 4 are below it.

        Raises:
            ArgumentError: another level.
        """
        if level not in (2, 3, 4):
            raise ArgumentError(f"a heading has level 2, 3 or 4, not {level!r}")
        text = flat(text)
        self._elements.append(Heading(text, level, self._new_anchor(text)))

    def paragraph(self, text: str) -> None:
        """Add a paragraph, or several where empty lines separate them."""
        for paragraph in re.split(r"\n\s*\n", clean(text)):
            if paragraph.strip():
                self._elements.append(Paragraph(flat(paragraph)))

    def table(
        self,
        name: str,
        rows: Sequence[Mapping[str, Any]],
        columns: Sequence[str] | Mapping[str, str] | None = None,
        formats: Mapping[str, Format] | None = None,
        caption: str | None = None,
        *,
        shown: int = 200,
    ) -> None:
        """Add a table; it also becomes the file ``<name>.csv``, with all rows and all digits.

        An :class:`~hexmap.experiments.statistics.Interval` is shown with its ends, and takes three columns
        of the CSV: ``key``, ``key_low``, ``key_high``.

        Args:
            name: of the file, with or without ``.csv``.
            rows: dictionaries of numbers, text, intervals, booleans and None.
            columns: the keys to show, in order, or key -> heading; all keys, as they come, where not given.
            formats: key -> a specification (``".3f"``, ``".2%"``) or a function from a value to text. Without
                one a column gets as many decimals as suit all of it.
            caption: a sentence, without the word "Table".
            shown: rows in the page; the CSV has them all. None of 0: the page only says where they are.

        Raises:
            ArgumentError: a name that is no file name or is taken, or a format that is none.
        """
        name = self._take(name.removesuffix(".csv"), "csv")
        if columns is None:
            columns = list(dict.fromkeys(key for row in rows for key in row))
        headings = dict(columns) if isinstance(columns, Mapping) else {key: key for key in columns}
        kept = [{key: scalar(row.get(key)) for key in headings} for row in rows]
        lines, numeric = _as_shown(kept[:shown], list(headings), formats or {})
        headings = {key: flat(heading) for key, heading in headings.items()}
        note = None if caption is None else flat(caption)
        number = self._count(_NUMBERED) + 1
        self._elements.append(Table(name, number, headings, kept, lines, numeric, note, shown))

    def figure(self, name: str, figure: Drawing, caption: str) -> None:
        """Add a figure, as it is now; it also becomes the files ``<name>.png`` and ``<name>.pdf``.

        Args:
            name: of the files.
            figure: of matplotlib; not changed, and not needed any more afterwards.
            caption: what it shows, without the word "Figure".

        Raises:
            ArgumentError: a name that is no file name or is taken.
        """
        name = self._take(name, "png", "pdf")
        files = {kind: render(figure, kind) for kind in ("png", "pdf", "svg")}
        self._elements.append(Figure(name, self._count(Figure) + 1, flat(caption), files))

    def verdicts(self, rows: Sequence[Verdict], name: str = "verdicts") -> None:
        """Add the claims and what became of each; they also become the file ``<name>.csv``.

        Raises:
            ArgumentError: a name that is no file name or is taken.
        """
        name = self._take(name.removesuffix(".csv"), "csv")
        kept = [
            Verdict(flat(row.claim), flat(row.section), row.outcome, flat(row.rule), flat(row.evidence)) for row in rows
        ]
        self._elements.append(Verdicts(name, self._count(_NUMBERED) + 1, kept))

    def matrix(
        self,
        name: str,
        cells: Mapping[str, Mapping[str, Compared | None]],
        corner: str,
        caption: str,
    ) -> None:
        """Add a matrix of who wins, is even and loses, coloured; it also becomes the file ``<name>.csv``.

        Args:
            name: of the file, with or without ``.csv``.
            cells: row -> column -> what became of it; columns in the order in which they come, empty where there is
                nothing to compare.
            corner: heading above the names of the rows.
            caption: a sentence, without the word "Table".

        Raises:
            ArgumentError: a name that is no file name or is taken.
        """
        name = self._take(name.removesuffix(".csv"), "csv")
        columns = list(dict.fromkeys(column for line in cells.values() for column in line))
        kept = [[line.get(column) for column in columns] for line in cells.values()]
        flattened = [[None if c is None else Compared(c.standing, flat(c.text)) for c in line] for line in kept]
        self._elements.append(
            Matrix(
                name, self._count(_NUMBERED) + 1, flat(corner), [flat(row) for row in cells],
                [flat(column) for column in columns], flattened, flat(caption),
            )
        )  # fmt: skip

    def write(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write the report into a folder, which is made if it does not exist.

        All files are whole before the first takes its name, and the pages come last, so that they never lack what
        they show. Files of an earlier report that this one does not have are removed: its page lists them.

        Returns:
            ``report.html``, ``report.md``, then the tables and figures in their order, and those of the times.

        Raises:
            FileAccessError: a file or the folder cannot be written.
        """
        target = Path(folder)
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileAccessError(f"{target}: cannot be written: {error.strerror or error}") from error
        files = _files(self._elements)
        content = (self.title, self.command, self.settings, self._elements)
        listed = f'<meta name="{_LIST}" content="{" ".join(files)}">'
        page = html(*content).replace("</head>", f"{listed}</head>", 1)
        pages = {"report.html": page.encode(), "report.md": markdown(*content).encode()}
        before = _files_of_before(target)
        with ExitStack() as stack:
            # The last one opened takes its name first.
            for name, data in reversed([*files.items(), *pages.items()]):
                handle = stack.enter_context(atomic_write(target / name))
                handle.write(data)
        for name in before - files.keys() - pages.keys():
            with suppress(OSError):
                (target / name).unlink()
        written = [target / name for name in (*pages, *files)]
        return written if self._times is None else written + self._times.write(target / "times")

    def _count(self, kinds: type | UnionType) -> int:
        return sum(isinstance(element, kinds) for element in self._elements)

    def _new_anchor(self, text: str) -> str:
        words = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "section"
        anchor, n = words, 1
        while anchor in self._anchors:
            n += 1
            anchor = f"{words}-{n}"
        self._anchors.add(anchor)
        return anchor

    def _take(self, name: str, *suffixes: str) -> str:
        if not _NAME.fullmatch(name):
            raise ArgumentError(f"{name!r} is not a name of letters, digits, points, hyphens and underscores")
        for suffix in suffixes:
            # Some file systems do not tell capitals from small letters.
            file = f"{name}.{suffix}".lower()
            if file in self._names:
                raise ArgumentError(f"the report already has a file {name}.{suffix}")
            self._names.add(file)
        return name


def _files_of_before(folder: Path) -> set[str]:
    """Return the files of the report that is in a folder already; none but those that a report may have written."""
    try:
        head = (folder / "report.html").read_bytes().partition(b"</head>")[0].decode()
    except (OSError, ValueError):
        return set()
    found = re.search(f'<meta name="{_LIST}" content="([^"]*)">', head)
    names = found[1].split() if found else []
    return {name for name in names if _NAME.fullmatch(name) and name.endswith(_KINDS)}


def _as_shown(
    rows: Sequence[Mapping[str, Any]], keys: Sequence[str], formats: Mapping[str, Format]
) -> tuple[list[list[str]], list[bool]]:
    """Return the cells of a table as they are read, row by row, and whether each column is one of numbers."""
    columns, numeric = [], []
    for key in keys:
        cells = [row[key] for row in rows]
        columns.append([flat(text) for text in column(cells, formats.get(key))])
        numeric.append(is_numeric(cells, columns[-1]))
    return [list(line) for line in zip(*columns, strict=True)], numeric


def _files(elements: Sequence[Element]) -> dict[str, bytes]:
    """Return the files that stand beside the pages, by name: tables and figures in their order."""
    files: dict[str, bytes] = {}
    for element in elements:
        if isinstance(element, Table):
            files[f"{element.name}.csv"] = csv_table(element)
        elif isinstance(element, Verdicts):
            files[f"{element.name}.csv"] = csv_verdicts(element)
        elif isinstance(element, Matrix):
            files[f"{element.name}.csv"] = csv_matrix(element)
        elif isinstance(element, Figure):
            files |= {f"{element.name}.{kind}": element.files[kind] for kind in ("png", "pdf")}
    return files


def _setting(value: Any) -> str:
    if isinstance(value, str):
        return clean(value)
    return clean(json.dumps(value, ensure_ascii=False, default=_json_value))


def _json_value(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
