"""The tables of a report as CSV: all rows, all digits, and nothing that only dresses them."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

from hexmap.base.text import spreadsheet_text
from hexmap.experiments.report.elements import STANDINGS, Matrix, Table, Verdicts, clean
from hexmap.experiments.report.numbers import is_number, scalar
from hexmap.experiments.statistics import Interval


def _csv(header: Sequence[str], rows: Sequence[Sequence[Any]]) -> bytes:
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow([_text(name) for name in header])
    writer.writerows([[_csv_cell(cell) for cell in row] for row in rows])
    return buffer.getvalue().encode()


def _csv_cell(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, bool):
        return "true" if cell else "false"
    # repr of a float is the shortest text that gives the same float again.
    return repr(cell) if is_number(cell) else _text(cell)


def _text(value: Any) -> str:
    return spreadsheet_text(clean(value))


def csv_table(table: Table) -> bytes:
    """Return a table as a file; an interval takes three columns."""
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
                line += [scalar(cell.value), scalar(cell.low), scalar(cell.high)]
            else:
                line += [cell, None, None]
        rows.append(line)
    return _csv(header, rows)


def csv_verdicts(verdicts: Verdicts) -> bytes:
    """Return verdicts as a file."""
    rows = [(row.section, row.claim, row.outcome, row.evidence, row.rule) for row in verdicts.rows]
    return _csv(("section", "claim", "outcome", "evidence", "rule"), rows)


def csv_matrix(matrix: Matrix) -> bytes:
    """Return a matrix as a file of words: win, even, lose."""
    rows = [
        [row, *("" if cell is None else STANDINGS[cell.standing] for cell in line)]
        for row, line in zip(matrix.rows, matrix.cells, strict=True)
    ]
    return _csv([matrix.corner, *matrix.columns], rows)
