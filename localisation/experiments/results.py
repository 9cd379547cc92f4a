"""What the cases found, row by row, and columns of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.values import one_line
from localisation.experiments.settings import THRESHOLDS, ExperimentSettings, Grid
from localisation.experiments.world import World

__all__ = ["Results", "Row", "column", "confidence", "is_right", "parquet_bytes"]

Row: TypeAlias = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Results:
    """All rows, in the order of the cases.

    Attributes:
        settings: of the experiment.
        world: scans and reference.
        grids: every lattice at every size.
        rows: of every grid and task: see ``cases``.
    """

    settings: ExperimentSettings
    world: World
    grids: list[Grid]
    rows: list[Row]

    __repr__ = one_line

    def select(self, **where: Any) -> list[Row]:
        """Return the rows in which every given column has the given value."""
        return [row for row in self.rows if all(row.get(key) == value for key, value in where.items())]

    def base(self, resolution: float) -> Grid:
        """Return the grid that the others of a resolution are compared with: the first."""
        return next(grid for grid in self.grids if grid.resolution == resolution)

    def rivals(self, resolution: float) -> list[Grid]:
        """Return the other grids of a resolution."""
        return [grid for grid in self.grids if grid.resolution == resolution][1:]

    def methods(self, task: str) -> list[str]:
        """Return the methods of a task, in their order."""
        return list(dict.fromkeys(row["method"] for row in self.rows if row["task"] == task))


def column(rows: Sequence[Row], key: str) -> FloatArray:
    """Return a column (K,) as numbers, NaN where a row has none."""
    return np.array([math.nan if row.get(key) is None else float(row[key]) for row in rows], dtype=np.float64)


def is_right(rows: Sequence[Row], threshold: tuple[float, float] = THRESHOLDS[-1]) -> NDArray[np.bool_]:
    """Tell which rows (K,) have a pose within metres and degrees of the reference."""
    return np.asarray(
        (column(rows, "metres") <= threshold[0]) & (column(rows, "degrees") <= threshold[1])
    )  # NaN is not


def confidence(rows: Sequence[Row]) -> FloatArray:
    """Return how sure each answer (K,) is: what a run says, or the margin and, of equal margins, the score."""
    if rows and "confidence" in rows[0]:
        return column(rows, "confidence")
    if rows and "margin" in rows[0]:
        return np.asarray(column(rows, "margin") + 1e-6 * column(rows, "fraction"))
    return column(rows, "fraction")


def parquet_bytes(rows: Sequence[Row], columns: Sequence[str]) -> bytes:
    """Return rows as a Parquet file: the same bytes for the same rows."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({name: pa.array([row.get(name) for row in rows]) for name in columns})
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return bytes(sink.getvalue().to_pybytes())
