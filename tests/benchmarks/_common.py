"""What the benchmarks share: the folder of the data, versions, tables on the screen."""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path


def data_folder() -> Path:
    """Return the folder of the real logs and maps, there or not."""
    named = os.environ.get("HEXMAP_DATA")
    return Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "data"


def versions(*names: str) -> str:
    """Return the versions of distributions, as far as they are installed."""
    found = []
    for name in names:
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            found.append(f"{name} absent")
    return ", ".join(found)


def table(rows: Sequence[Sequence[object]]) -> None:
    """Print rows of cells, the first row as the head, numbers to the right."""
    text = [[f"{c:.4g}" if isinstance(c, float) else str(c) for c in row] for row in rows]
    widths = [max(len(row[k]) for row in text) for k in range(len(text[0]))]
    for row in text:
        print("  ".join(c.ljust(w) if k == 0 else c.rjust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))))
    print()
