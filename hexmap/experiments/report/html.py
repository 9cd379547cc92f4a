"""A report as one HTML page that needs no other file: figures and style are in it."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Mapping, Sequence
from typing import Any

from hexmap.experiments.report.pieces import MARKS, Figure, Heading, Paragraph, Piece, Table, Verdicts, versions
from hexmap.experiments.statistics import Interval

_CLASSES: dict[str, str] = {"holds": "good", "holds in part": "part", "does not hold": "bad"}
_SVG_BYTES = 1_500_000  # a larger drawing goes into the page as an image


class Page:
    """The report as one HTML file."""

    def __init__(self, title: str, command: str, settings: Mapping[str, str], pieces: Sequence[Piece]) -> None:
        self._title, self._command, self._settings, self._pieces = title, command, settings, pieces
        self._tables = 0

    def text(self) -> str:
        """Return the whole page."""
        body = [f"<header>\n<h1>{_h(self._title)}</h1>"]
        if self._command:
            body.append(f"<pre><code>{_h(self._command)}</code></pre>")
        body.append("</header>")
        body.append(self._contents())
        body.extend(self._piece(piece) for piece in self._pieces)
        body.append(self._footer())
        return _FRAME.format(title=_h(self._title), style=_STYLE, body="\n".join(part for part in body if part))

    def _contents(self) -> str:
        sections = [piece for piece in self._pieces if isinstance(piece, Heading) and piece.level == 2]
        if len(sections) < 4:
            return ""
        links = "\n".join(f'<li><a href="#{piece.anchor}">{_h(piece.text)}</a></li>' for piece in sections)
        return f'<nav aria-label="Contents">\n<ul>\n{links}\n</ul>\n</nav>'

    def _piece(self, piece: Piece) -> str:
        if isinstance(piece, Heading):
            return f'<h{piece.level} id="{piece.anchor}">{_h(piece.text)}</h{piece.level}>'
        if isinstance(piece, Paragraph):
            return f"<p>{_prose(piece.text)}</p>"
        if isinstance(piece, Figure):
            return _html_figure(piece)
        self._tables += 1
        return _html_table(piece, self._tables) if isinstance(piece, Table) else _html_verdicts(piece, self._tables)

    def _footer(self) -> str:
        rows = "\n".join(
            f'<tr><th scope="row">{_h(name)}</th><td>{_h(value)}</td></tr>' for name, value in self._settings.items()
        )
        table = f'<h2>Settings</h2>\n<table class="settings">\n<tbody>\n{rows}\n</tbody>\n</table>\n' if rows else ""
        return f"<footer>\n{table}<p>{_h(versions())}</p>\n</footer>"


def _h(text: str) -> str:
    return html.escape(text, quote=True)


def _prose(text: str) -> str:
    """Return text that may be broken into lines, though not between a number and its per cent."""
    return re.sub(r"(?<=\d) (?=%)", "\N{NO-BREAK SPACE}", _h(text))


def _html_figure(figure: Figure) -> str:
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


def _html_table(table: Table, number: int) -> str:
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


def _html_verdicts(verdicts: Verdicts, number: int) -> str:
    head = "".join(f'<th scope="col">{word}</th>' for word in ("Section", "Claim", "Verdict", "Evidence"))
    lines = []
    for row in verdicts.rows:
        badge = f'<span class="badge {_CLASSES[row.outcome]}">{MARKS[row.outcome]} {row.outcome}</span>'
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
