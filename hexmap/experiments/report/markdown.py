"""A report as Markdown, in which text that looks like markup is shown as it stands."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from hexmap.experiments.report.elements import (
    MARKS,
    STANDING_MARKS,
    STANDINGS,
    Compared,
    Element,
    Figure,
    Heading,
    Matrix,
    Paragraph,
    Table,
    versions,
)


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


def _compared(cell: Compared | None) -> str:
    if cell is None:
        return ""
    return f"{STANDING_MARKS[cell.standing]} {STANDINGS[cell.standing]} {cell.text}".rstrip()


def markdown(title: str, command: str, settings: Mapping[str, str], elements: Sequence[Element]) -> str:
    """Return the text of the report."""
    blocks = [f"# {_md(title)}"]
    if command:
        blocks.append(_md_code(command))
    for element in elements:
        if isinstance(element, Heading):
            blocks.append(f"{'#' * element.level} {_md(element.text)}")
        elif isinstance(element, Paragraph):
            blocks.append(_md(element.text))
        elif isinstance(element, Table):
            if element.columns and element.shown:
                blocks.append(_md_table(list(element.columns.values()), element.numeric, element.texts))
            source = f"[{_md(element.name)}.csv]({element.name}.csv)"
            blocks.append(f"{_md(element.note)} {source}".strip())
        elif isinstance(element, Figure):
            blocks.append(f"![{_md(element.caption)}]({element.name}.png)")
            blocks.append(f"**Figure {element.number}.** {_md(element.caption)} [PDF]({element.name}.pdf)")
        elif isinstance(element, Matrix):
            lines = [[row, *map(_compared, line)] for row, line in zip(element.rows, element.cells, strict=True)]
            blocks.append(_md_table([element.corner, *element.columns], [False] * (1 + len(element.columns)), lines))
            blocks.append(f"{_md(element.summary)} [{_md(element.name)}.csv]({element.name}.csv)")
        else:
            rows = [(r.section, r.claim, f"{MARKS[r.outcome]} {r.outcome}", r.evidence, r.rule) for r in element.rows]
            header = ("Section", "Claim", "Verdict", "Evidence", "Rule")
            blocks += [_md(element.summary) + "."] if element.rows else []
            blocks.append(_md_table(header, [False] * 5, rows))
            blocks.append(f"[{_md(element.name)}.csv]({element.name}.csv)")
    blocks.append("---")
    if settings:
        blocks.append(_md_table(("Setting", "Value"), (False, False), list(settings.items())))
    blocks.append(_md(versions()))
    return "\n\n".join(blocks) + "\n"
