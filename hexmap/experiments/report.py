"""Reports of experiments: one HTML file that needs no other, Markdown, a CSV a table, figures as PNG and PDF.

A report is put together piece by piece, in the order in which it is read, and written at the end. The same
pieces give the same bytes: there is no date in it, and of the machine only the versions that numbers may
depend on. All text is plain text; what looks like markup in it is shown as it stands.

    report = Report("Rotation", "hexmap experiment rotation hall.pcd -o report/", {"volume": 0.001})
    report.heading("Voxel count")
    report.table("summary", [{"lattice": "D3", "variability": bootstrap(counts, cv, rng=rng)}])
    report.figure("counts", figure, "Voxel count over the angle.")
    report.write("report")
"""

from __future__ import annotations

import base64
import contextlib
import csv
import html
import io
import json
import math
import os
import platform
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

import hexmap
from hexmap.atomic import atomic_write
from hexmap.errors import ArgumentError, FileAccessError
from hexmap.experiments.statistics import Interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["COLOURS", "Format", "Outcome", "Report", "Verdict", "figure_style", "format_interval", "format_number"]

Format = str | Callable[[Any], str]
Outcome = Literal["holds", "holds in part", "does not hold"]

# For lines that must be told apart, by people who see colours differently too, on white paper.
COLOURS = ("#33415c", "#e4572e", "#1b8a7a", "#a3509b", "#c99700", "#4a90d9", "#7b8794")

_MINUS, _NOTHING = "\N{MINUS SIGN}", "–"
_MARKS: dict[str, str] = {"holds": "✓", "holds in part": "◐", "does not hold": "✗"}
_CLASSES: dict[str, str] = {"holds": "good", "holds in part": "part", "does not hold": "bad"}
_SVG_BYTES = 1_500_000  # a larger drawing goes into the page as an image
_DPI = 200
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")


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


# ---------------------------------------------------------------------- numbers


def format_number(value: float, spec: str | None = None) -> str:
    """Return a number as it is read.

    Args:
        value: the number; one that is not finite is shown as a dash or as infinity.
        spec: a format specification such as ``".3f"`` or ``".2%"``; four significant digits where none is
            given, and all digits of a whole number.

    Raises:
        ArgumentError: the specification is not one of numbers.

    Examples:
        >>> format_number(88206), format_number(0.016914), format_number(0.016914, ".2%")
        ('88,206', '0.01691', '1.69 %')
    """
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if math.isnan(value):
        return _NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else f"{_MINUS}∞"
    if spec is None:
        return _typeset(_general(value))
    try:
        text = format(float(value) if spec.endswith(("f", "e", "g", "%")) else value, spec)
    except ValueError as error:
        raise ArgumentError(f"{spec!r} is not a format of numbers") from error
    return _typeset(text.replace("%", " %"))


def format_interval(
    interval: Interval, *, percent: bool = False, decimals: int | None = None, unit: str = "", scale: float = 1.0
) -> str:
    """Return a value and its interval, such as ``1.69 % [1.52, 1.83]``.

    Args:
        interval: the interval.
        percent: whether to show it times 100, in per cent.
        decimals: of all three numbers; as many as give half the interval's width two significant digits
            where none are given.
        unit: after the value.
        scale: by which all three are multiplied first.

    Examples:
        >>> format_interval(Interval(0.0169, 0.01523, 0.01834), percent=True)
        '1.69 % [1.52, 1.83]'
    """
    factor = scale * (100.0 if percent else 1.0)
    numbers = [factor * number for number in (interval.value, interval.low, interval.high)]
    if decimals is None:
        decimals = _interval_decimals(numbers)
    value, low, high = (format_number(number, f",.{decimals}f") for number in numbers)
    unit = "%" if percent and not unit else unit
    return f"{value} {unit}".rstrip() + f" [{low}, {high}]"


def _interval_decimals(numbers: list[float]) -> int:
    finite = [number for number in numbers if math.isfinite(number)]
    half = 0.5 * (max(finite) - min(finite)) if finite else 0.0
    if half > 0.0:
        return min(max(1 - math.floor(math.log10(half)), 0), 9)
    # No width says nothing about the digits.
    return _column_decimals(finite) or 0


def _typeset(text: str) -> str:
    """Give a negative number a true minus, and none to what is rounded to zero."""
    if not re.match(r"-[\d.]", text):
        return text
    return (_MINUS if re.search("[1-9]", text.partition("e")[0]) else "") + text[1:]


def _general(value: float) -> str:
    if isinstance(value, int | np.integer):
        return f"{value:,d}"
    decimals = _column_decimals([float(value)])
    return f"{value:.3e}" if decimals is None else f"{value:,.{decimals}f}"


def _column_decimals(values: Sequence[float]) -> int | None:
    """Return the decimals that suit all of a column, None where no number of them does.

    The largest value gets four significant digits, or the smallest two if that is more; zeros that all
    values would end with are left out.
    """
    sizes = [abs(value) for value in values if value != 0.0]
    if not sizes:
        return 0
    large, small = math.floor(math.log10(max(sizes))), math.floor(math.log10(min(sizes)))
    decimals = max(3 - large, 1 - small, 0)
    if large > 11 or decimals > 9 or large + decimals > 10:
        return None
    while decimals > 0 and all(f"{value:.{decimals}f}".endswith("0") for value in values):
        decimals -= 1
    return decimals


# ---------------------------------------------------------------------- figures


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


def _render(figure: Figure, kind: str) -> bytes:
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


# ---------------------------------------------------------------------- pieces


@dataclass(frozen=True)
class _Heading:
    text: str
    level: int
    anchor: str


@dataclass(frozen=True)
class _Paragraph:
    text: str


@dataclass(frozen=True)
class _Table:
    name: str
    columns: dict[str, str]  # key -> heading
    rows: list[dict[str, Any]]
    texts: list[list[str]]  # as shown
    numeric: list[bool]
    caption: str | None
    shown: int

    @property
    def note(self) -> str:
        """Return the caption, and what the table leaves out."""
        hidden = len(self.rows) - self.shown
        words = f"The first {self.shown:,} of {len(self.rows):,} rows." if hidden > 0 else ""
        return " ".join(part for part in (self.caption, words) if part)


@dataclass(frozen=True)
class _Figure:
    name: str
    number: int
    caption: str
    files: dict[str, bytes]  # kind -> content


@dataclass(frozen=True)
class _Verdicts:
    name: str
    rows: list[Verdict]

    @property
    def summary(self) -> str:
        """Return how many of which outcome."""
        counts = [(outcome, sum(row.outcome == outcome for row in self.rows)) for outcome in get_args(Outcome)]
        words = {"holds": "hold", "holds in part": "hold in part", "does not hold": "do not hold"}
        return ", ".join(f"{count} {outcome if count == 1 else words[outcome]}" for outcome, count in counts if count)


_Piece = _Heading | _Paragraph | _Table | _Figure | _Verdicts


class Report:
    """A report that is put together piece by piece, and then written.

    Args:
        title: of the report.
        command: that made it, as one would type it again.
        settings: all that was set, by name; values that JSON can hold.
    """

    def __init__(self, title: str, command: str = "", settings: Mapping[str, Any] | None = None) -> None:
        self.title, self.command = _clean(title), _clean(command)
        self.settings = {_clean(name): _setting(value) for name, value in (settings or {}).items()}
        self._pieces: list[_Piece] = []
        self._names: set[str] = set()
        self._anchors: set[str] = set()

    def heading(self, text: str, level: int = 2) -> None:
        """Add a heading; level 2 is a section, 3 and 4 are below it.

        Raises:
            ArgumentError: another level.
        """
        if level not in (2, 3, 4):
            raise ArgumentError(f"a heading has level 2, 3 or 4, not {level!r}")
        text = _flat(text)
        words = re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "section"
        anchor, n = words, 1
        while anchor in self._anchors:
            n += 1
            anchor = f"{words}-{n}"
        self._anchors.add(anchor)
        self._pieces.append(_Heading(text, level, anchor))

    def paragraph(self, text: str) -> None:
        """Add a paragraph, or several where empty lines separate them."""
        for part in re.split(r"\n\s*\n", _clean(text)):
            if part.strip():
                self._pieces.append(_Paragraph(" ".join(part.split())))

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
            shown: rows in the page; the CSV has them all.

        Raises:
            ArgumentError: a name that is no file name or is taken, or a format that is none.
        """
        name = self._take(name.removesuffix(".csv"), "csv")
        if columns is None:
            columns = list(dict.fromkeys(key for row in rows for key in row))
        headings = dict(columns) if isinstance(columns, Mapping) else {key: key for key in columns}
        kept = [{key: _scalar(row.get(key)) for key in headings} for row in rows]
        texts, numeric = [], []
        for key in headings:
            cells = [row[key] for row in kept]
            texts.append(_column(cells[:shown], (formats or {}).get(key)))
            numeric.append(_is_numeric(cells[:shown], texts[-1]))
        lines = [list(line) for line in zip(*texts, strict=True)]
        clean = {key: _flat(heading) for key, heading in headings.items()}
        note = None if caption is None else _flat(caption)
        self._pieces.append(_Table(name, clean, kept, lines, numeric, note, shown))

    def figure(self, name: str, figure: Figure, caption: str) -> None:
        """Add a figure, as it is now; it also becomes the files ``<name>.png`` and ``<name>.pdf``.

        Args:
            name: of the files.
            figure: of matplotlib; not changed, and not needed any more afterwards.
            caption: what it shows, without the word "Figure".

        Raises:
            ArgumentError: a name that is no file name or is taken.
        """
        name = self._take(name, "png", "pdf")
        number = 1 + sum(isinstance(piece, _Figure) for piece in self._pieces)
        files = {kind: _render(figure, kind) for kind in ("png", "pdf", "svg")}
        self._pieces.append(_Figure(name, number, _flat(caption), files))

    def verdicts(self, rows: Sequence[Verdict], name: str = "verdicts") -> None:
        """Add the claims and what became of each; they also become the file ``<name>.csv``.

        Raises:
            ArgumentError: a name that is no file name or is taken.
        """
        name = self._take(name.removesuffix(".csv"), "csv")
        clean = [
            Verdict(_flat(row.claim), _flat(row.section), row.outcome, _flat(row.rule), _flat(row.evidence))
            for row in rows
        ]
        self._pieces.append(_Verdicts(name, clean))

    def write(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write the report into a folder, which is made if it does not exist.

        Every file is the old one or the whole new one; the pages come last, so that they never lack what they
        show.

        Returns:
            ``report.html``, ``report.md``, and then the tables and figures in their order.

        Raises:
            FileAccessError: a file or the folder cannot be written.
        """
        target = Path(folder)
        try:
            target.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileAccessError(f"{target}: cannot be written: {error.strerror or error}") from error
        files: dict[str, bytes] = {}
        for piece in self._pieces:
            if isinstance(piece, _Table):
                files[f"{piece.name}.csv"] = _csv_table(piece)
            elif isinstance(piece, _Verdicts):
                files[f"{piece.name}.csv"] = _csv_verdicts(piece)
            elif isinstance(piece, _Figure):
                files.update({f"{piece.name}.{kind}": piece.files[kind] for kind in ("png", "pdf")})
        pages = {"report.html": _Page(self).text().encode(), "report.md": _markdown(self).encode()}
        for name, content in (*files.items(), *pages.items()):
            with atomic_write(target / name) as handle:
                handle.write(content)
        return [target / name for name in (*pages, *files)]

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


# ---------------------------------------------------------------------- text and cells


def _clean(text: object) -> str:
    """Return text that every format can hold: no control characters, no halves of characters."""
    whole = str(text).encode("utf-8", "replace").decode()
    return re.sub(r"[^\t\n\r\x20-\x7e\xa0-\ufffd\U00010000-\U0010ffff]", "\N{REPLACEMENT CHARACTER}", whole)


def _flat(text: object) -> str:
    return " ".join(_clean(text).split())


def _setting(value: Any) -> str:
    if isinstance(value, str):
        return _clean(value)
    return _clean(json.dumps(value, ensure_ascii=False, default=_json_value))


def _json_value(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def _scalar(value: Any) -> Any:
    """Return a cell as one of Python's own values."""
    return value.item() if isinstance(value, np.generic) else value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _column(cells: Sequence[Any], how: Format | None) -> list[str]:
    """Return the cells of a column as they are read."""
    floats = [cell for cell in cells if isinstance(cell, float) and math.isfinite(cell)]
    decimals = _column_decimals(floats)
    intervals = [cell for cell in cells if isinstance(cell, Interval)]
    percent = isinstance(how, str) and how.endswith("%")
    fixed = re.fullmatch(r"[,+]?\.(\d+)[f%]", how) if isinstance(how, str) else None
    if fixed:
        interval_decimals = int(fixed[1])
    else:
        factor = 100.0 if percent else 1.0
        # One width a column: the decimals of the surest interval would promise too much of the others.
        each = [_interval_decimals([factor * i.value, factor * i.low, factor * i.high]) for i in intervals]
        interval_decimals = sorted(each)[len(each) // 2] if each else 0
    out = []
    for cell in cells:
        if cell is None:
            text = ""
        elif callable(how):
            text = how(cell)
        elif isinstance(cell, Interval):
            text = format_interval(cell, percent=percent, decimals=interval_decimals)
        elif isinstance(cell, bool):
            text = "yes" if cell else "no"
        elif how is not None and _is_number(cell):
            text = format_number(cell, how)
        elif isinstance(cell, float) and math.isfinite(cell) and decimals is not None:
            text = format_number(cell, f",.{decimals}f")
        elif _is_number(cell):
            text = format_number(cell)
        else:
            text = str(cell)
        out.append(_flat(text))
    return out


_LOOKS_NUMERIC = re.compile(r"[-−+]?[\d∞][\d,.]*(e[-+−]?\d+)?(\s?%|\s\w{1,4})?(\s\[.*\])?|–|")


def _is_numeric(cells: Sequence[Any], texts: Sequence[str]) -> bool:
    """Return whether a column is one of numbers, which stand on the right."""
    filled = [(cell, text) for cell, text in zip(cells, texts, strict=True) if cell is not None]
    return bool(filled) and all(
        _is_number(cell) or isinstance(cell, Interval) or bool(_LOOKS_NUMERIC.fullmatch(text)) for cell, text in filled
    )


# ---------------------------------------------------------------------- CSV


def _csv(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> bytes:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([_clean(name) for name in header])
    writer.writerows([[_csv_cell(cell) for cell in row] for row in rows])
    return buffer.getvalue().encode()


def _csv_cell(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "true" if cell else "false"
    # repr of a float is the shortest text that gives the same float again.
    return repr(cell) if _is_number(cell) else _clean(cell)


def _csv_table(table: _Table) -> bytes:
    header: list[str] = []
    wide = {key for key in table.columns if any(isinstance(row[key], Interval) for row in table.rows)}
    for key in table.columns:
        header += [key, f"{key}_low", f"{key}_high"] if key in wide else [key]
    rows = []
    for row in table.rows:
        line: list[Any] = []
        for key in table.columns:
            cell = row[key]
            if key not in wide:
                line.append(cell)
            elif isinstance(cell, Interval):
                line += [_scalar(cell.value), _scalar(cell.low), _scalar(cell.high)]
            else:
                line += [cell, None, None]
        rows.append(line)
    return _csv(header, rows)


def _csv_verdicts(verdicts: _Verdicts) -> bytes:
    rows = [(row.section, row.claim, row.outcome, row.evidence, row.rule) for row in verdicts.rows]
    return _csv(("section", "claim", "outcome", "evidence", "rule"), rows)


def _versions() -> str:
    import matplotlib

    parts = {
        "hexmap": hexmap.__version__,
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "matplotlib": matplotlib.__version__,
    }
    return ", ".join(f"{name} {version}" for name, version in parts.items())


# ---------------------------------------------------------------------- Markdown


def _md(text: str) -> str:
    """Return text that Markdown shows as it stands, on one line."""
    line = re.sub(r"([\\`*_\[\]<>|~$&])", r"\\\1", " ".join(text.split()))
    # What begins a list, a heading or a rule only does so at the beginning of a line.
    line = re.sub(r"^([#+=-])", r"\\\1", line)
    return re.sub(r"^(\d+)([.)])(?= |$)", r"\1\\\2", line)


def _md_table(header: Sequence[str], right: Sequence[bool], rows: Sequence[Sequence[str]]) -> str:
    rule = ["---:" if side else "---" for side in right]
    lines = [[_md(cell) for cell in line] for line in (header, *rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in (lines[0], rule, *lines[1:]))


def _md_code(text: str) -> str:
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
    return f"{fence}\n{text}\n{fence}"


def _markdown(report: Report) -> str:
    blocks = [f"# {_md(report.title)}"]
    if report.command:
        blocks.append(_md_code(report.command))
    for piece in report._pieces:
        if isinstance(piece, _Heading):
            blocks.append(f"{'#' * piece.level} {_md(piece.text)}")
        elif isinstance(piece, _Paragraph):
            blocks.append(_md(piece.text))
        elif isinstance(piece, _Table):
            if piece.columns:
                blocks.append(_md_table(list(piece.columns.values()), piece.numeric, piece.texts))
            source = f"[{_md(piece.name)}.csv]({piece.name}.csv)"
            blocks.append(f"{_md(piece.note)} {source}".strip())
        elif isinstance(piece, _Figure):
            blocks.append(f"![{_md(piece.caption)}]({piece.name}.png)")
            blocks.append(f"**Figure {piece.number}.** {_md(piece.caption)} [PDF]({piece.name}.pdf)")
        else:
            rows = [(r.section, r.claim, f"{_MARKS[r.outcome]} {r.outcome}", r.evidence, r.rule) for r in piece.rows]
            header = ("Section", "Claim", "Verdict", "Evidence", "Rule")
            blocks += [_md(piece.summary) + "."] if piece.rows else []
            blocks.append(_md_table(header, [False] * 5, rows))
            blocks.append(f"[{_md(piece.name)}.csv]({piece.name}.csv)")
    blocks.append("---")
    if report.settings:
        blocks.append(_md_table(("Setting", "Value"), (False, False), list(report.settings.items())))
    blocks.append(_md(_versions()))
    return "\n\n".join(blocks) + "\n"


# ---------------------------------------------------------------------- HTML


class _Page:
    """The report as one HTML file."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._tables = 0

    def text(self) -> str:
        """Return the whole page."""
        report = self._report
        body = [f"<header>\n<h1>{_h(report.title)}</h1>"]
        if report.command:
            body.append(f"<pre><code>{_h(report.command)}</code></pre>")
        body.append("</header>")
        body.append(self._contents())
        body.extend(self._piece(piece) for piece in report._pieces)
        body.append(self._footer())
        return _FRAME.format(title=_h(report.title), style=_STYLE, body="\n".join(part for part in body if part))

    def _contents(self) -> str:
        sections = [piece for piece in self._report._pieces if isinstance(piece, _Heading) and piece.level == 2]
        if len(sections) < 4:
            return ""
        links = "\n".join(f'<li><a href="#{piece.anchor}">{_h(piece.text)}</a></li>' for piece in sections)
        return f'<nav aria-label="Contents">\n<ul>\n{links}\n</ul>\n</nav>'

    def _piece(self, piece: _Piece) -> str:
        if isinstance(piece, _Heading):
            return f'<h{piece.level} id="{piece.anchor}">{_h(piece.text)}</h{piece.level}>'
        if isinstance(piece, _Paragraph):
            return f"<p>{_prose(piece.text)}</p>"
        if isinstance(piece, _Figure):
            return _html_figure(piece)
        self._tables += 1
        return _html_table(piece, self._tables) if isinstance(piece, _Table) else _html_verdicts(piece, self._tables)

    def _footer(self) -> str:
        rows = "\n".join(
            f'<tr><th scope="row">{_h(name)}</th><td>{_h(value)}</td></tr>'
            for name, value in self._report.settings.items()
        )
        table = f'<h2>Settings</h2>\n<table class="settings">\n<tbody>\n{rows}\n</tbody>\n</table>\n' if rows else ""
        return f"<footer>\n{table}<p>{_h(_versions())}</p>\n</footer>"


def _h(text: str) -> str:
    return html.escape(text, quote=True)


def _prose(text: str) -> str:
    """Return text that may be broken into lines, though not between a number and its per cent."""
    return re.sub(r"(?<=\d) (?=%)", "\N{NO-BREAK SPACE}", _h(text))


def _html_figure(figure: _Figure) -> str:
    kind = "svg" if len(figure.files["svg"]) <= _SVG_BYTES else "png"
    data = base64.b64encode(figure.files[kind]).decode()
    source = f"data:image/{'svg+xml' if kind == 'svg' else 'png'};base64,{data}"
    links = f'<a href="{figure.name}.png">PNG</a> <a href="{figure.name}.pdf">PDF</a>'
    return (
        f'<figure>\n<img alt="{_h(figure.caption)}" src="{source}">\n'
        f"<figcaption><b>Figure {figure.number}.</b> {_prose(figure.caption)}"
        f' <span class="files">{links}</span></figcaption>\n</figure>'
    )


def _html_frame(number: int, caption: str, name: str, kind: str, head: str, body: str) -> str:
    words = f"<b>Table {number}.</b> {_prose(caption)}".rstrip()
    files = f'<span class="files"><a href="{name}.csv">CSV</a></span>'
    return (
        f'<figure class="{kind}">\n<figcaption>{words} {files}</figcaption>\n<div class="wide">\n<table>\n'
        f"<thead>\n<tr>{head}</tr>\n</thead>\n<tbody>\n{body}\n</tbody>\n</table>\n</div>\n</figure>"
    )


def _html_table(table: _Table, number: int) -> str:
    sides = [' class="n"' if numeric else "" for numeric in table.numeric]
    headings = zip(sides, table.columns.values(), strict=True)
    head = "".join(f'<th scope="col"{side}>{_h(heading)}</th>' for side, heading in headings)
    lines = []
    for row, texts in zip(table.rows, table.texts, strict=False):
        cells = [
            f"<td{side}>{_html_cell(row[key], text)}</td>"
            for side, key, text in zip(sides, table.columns, texts, strict=True)
        ]
        lines.append(f"<tr>{''.join(cells)}</tr>")
    return _html_frame(number, table.note, table.name, "table", head, "\n".join(lines))


def _html_cell(cell: Any, text: str) -> str:
    value, bracket, ends = text.partition(" [")
    if isinstance(cell, Interval) and bracket:
        return f'{_h(value)} <span class="ends">[{_h(ends)}</span>'
    return _h(text)


def _html_verdicts(verdicts: _Verdicts, number: int) -> str:
    head = "".join(f'<th scope="col">{word}</th>' for word in ("Section", "Claim", "Verdict", "Evidence"))
    lines = []
    for row in verdicts.rows:
        badge = f'<span class="badge {_CLASSES[row.outcome]}">{_MARKS[row.outcome]} {row.outcome}</span>'
        claim = f'{_h(row.claim)}<div class="rule">Rule: {_h(row.rule)}</div>'
        cells = (
            f'<td class="section">{_h(row.section)}</td><td>{claim}</td><td>{badge}</td><td>{_prose(row.evidence)}</td>'
        )
        lines.append(f"<tr>{cells}</tr>")
    caption = f"Claims: {verdicts.summary}." if verdicts.rows else "No claims."
    return _html_frame(number, caption, verdicts.name, "verdicts", head, "\n".join(lines))


_FRAME = """<!DOCTYPE html>
<html lang="en-GB">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""

_STYLE = """
:root {
  --paper: #ffffff; --ink: #1f2a3d; --faint: #5f6b80; --line: #d9dfe7; --soft: #f4f6f9; --link: #2b5fa8;
  --good: #17694f; --good-soft: #e2f3ec; --part: #805300; --part-soft: #fbf0d6; --bad: #a52a1e; --bad-soft: #fbe7e3;
  --serif: Charter, "Bitstream Charter", "Sitka Text", Cambria, Georgia, serif;
  --sans: system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", "Liberation Sans", Arial, sans-serif;
  --mono: ui-monospace, "SF Mono", Menlo, Consolas, "Liberation Mono", monospace;
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14181f; --ink: #dde3ec; --faint: #98a4b8; --line: #323b49; --soft: #1c222c; --link: #8ab4f0;
    --good: #7fd6b1; --good-soft: #17362b; --part: #ecc46a; --part-soft: #3a2f14; --bad: #f29b8f; --bad-soft: #43211d;
  }
}
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 17px/1.6 var(--serif); }
main { max-width: 64rem; margin: 0 auto; padding: 3.5rem 1.5rem 3rem; }
h1, h2, h3, h4 { line-height: 1.25; font-weight: 600; text-wrap: balance; overflow-wrap: anywhere; }
h1 { margin: 0 0 1rem; font-size: 2.1rem; letter-spacing: -0.01em; }
h2 { margin: 3rem 0 0.8rem; font-size: 1.4rem; }
h3 { margin: 2.2rem 0 0.6rem; font-size: 1.12rem; }
h4 { margin: 1.8rem 0 0.5rem; font-size: 1rem; font-style: italic; }
p { max-width: 42rem; margin: 0 0 1rem; overflow-wrap: break-word; }
a { color: var(--link); text-decoration-thickness: 1px; text-underline-offset: 0.15em; }
pre { margin: 0; padding: 0.7rem 0.9rem; background: var(--soft); border-radius: 6px; white-space: pre-wrap;
  overflow-wrap: anywhere; font: 0.8rem/1.5 var(--mono); }
header { margin-bottom: 1.8rem; }
nav ul { margin: 0 0 1.8rem; padding: 0; list-style: none; columns: 2 16rem; font-size: 0.95rem; }
nav a { text-decoration: none; }
nav a:hover { text-decoration: underline; }
figure { margin: 2rem 0; }
figure img { display: block; max-width: 100%; height: auto; margin: 0 auto; background: #ffffff; border-radius: 6px; }
figcaption { max-width: 46rem; margin: 0.7rem 0; color: var(--faint); font: 0.85rem/1.5 var(--sans); }
figcaption b { color: var(--ink); font-weight: 600; }
.files { white-space: nowrap; font-size: 0.92em; }
.files a { margin-left: 0.35em; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font: 0.85rem/1.45 var(--sans); font-variant-numeric: tabular-nums lining-nums; }
th, td { padding: 0.42rem 0.7rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { padding-left: 0.15rem; }
th:last-child, td:last-child { padding-right: 0.15rem; }
thead th { border-bottom: 1.5px solid var(--ink); font-weight: 600; vertical-align: bottom; }
tbody tr:last-child > * { border-bottom: 1.5px solid var(--ink); }
.n { text-align: right; }
td.n { white-space: nowrap; }
.ends { color: var(--faint); }
.verdicts table { width: 100%; }
.verdicts td { min-width: 9rem; }
.verdicts td.section { min-width: 0; white-space: nowrap; color: var(--faint); }
.rule { margin-top: 0.25rem; color: var(--faint); font-size: 0.92em; }
.badge { display: inline-block; padding: 0.08rem 0.55rem; border-radius: 1em; font-weight: 600; white-space: nowrap; }
.good { color: var(--good); background: var(--good-soft); }
.part { color: var(--part); background: var(--part-soft); }
.bad { color: var(--bad); background: var(--bad-soft); }
footer { margin-top: 4rem; padding-top: 1.2rem; border-top: 1px solid var(--line); color: var(--faint);
  font: 0.82rem/1.5 var(--sans); }
footer h2 { margin: 0 0 0.5rem; font: 600 0.9rem/1.4 var(--sans); color: var(--ink); }
footer p { margin: 1rem 0 0; }
.settings { font-size: 1em; }
.settings th { font-weight: 400; white-space: nowrap; }
footer .settings tbody tr > * { padding-top: 0.2rem; padding-bottom: 0.2rem; border-bottom: 0; }
.settings td { overflow-wrap: anywhere; color: var(--ink); }
@media print {
  :root {
    --paper: #ffffff; --ink: #000000; --faint: #444444; --line: #bbbbbb; --soft: #f4f4f4; --link: #000000;
    --good: #17694f; --good-soft: #e2f3ec; --part: #805300; --part-soft: #fbf0d6; --bad: #a52a1e; --bad-soft: #fbe7e3;
  }
  body { font-size: 10.5pt; print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  main { max-width: none; padding: 0; }
  nav, .files { display: none; }
  .wide { overflow: visible; }
  table { font-size: 8.5pt; }
  th, td { padding: 0.3rem 0.4rem; }
  h2, h3, h4, figcaption { break-after: avoid; }
  tr, figure:not(.table, .verdicts) { break-inside: avoid; }
  footer { margin-top: 2rem; }
  thead { display: table-header-group; }
}
"""
