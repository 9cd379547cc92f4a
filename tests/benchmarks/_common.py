"""What the benchmarks share: the folder of the data, versions, tables on the screen."""

from __future__ import annotations

import argparse
import contextlib
import os
import platform
import tempfile
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TypeVar

Sizes = TypeVar("Sizes")


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


def run_figures(
    parser: argparse.ArgumentParser,
    arguments: list[str] | None,
    figures: Mapping[str, Callable[[Path, Sizes], None]],
    sizes_of: Callable[[argparse.Namespace], Sizes],
    simulated: Collection[str] = (),
) -> None:
    """Print the figures that are asked for, or all; those not in ``simulated`` need the real logs.

    Each is called with a folder in which it may keep what it makes, and with how much of everything is done.
    """
    parser.add_argument("figures", nargs="*", help=f"{', '.join(figures)}; all without a name")
    parser.add_argument("--cache", type=Path, help="folder for trajectories and maps; none keeps nothing")
    chosen = parser.parse_args(arguments)
    names = chosen.figures or list(figures)
    for name in names:
        if name not in figures:
            parser.error(f"no figure {name!r}: {', '.join(figures)}")
    sizes = sizes_of(chosen)
    print(versions("hexmap", "numpy", "numba", "rosbags"))
    print(f"Python {platform.python_version()}, {platform.machine()}, {os.cpu_count()} cores, {sizes}\n")
    with contextlib.ExitStack() as stack:
        cache = chosen.cache or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        cache.mkdir(parents=True, exist_ok=True)
        for name in names:
            if name not in simulated and not (data_folder() / "laser2d").is_dir():
                print(f"{name} is left out: no shared data (set HEXMAP_DATA)\n")
                continue
            begin = time.perf_counter()
            print(f"== {name}\n")
            figures[name](cache, sizes)
            print(f"({name}: {time.perf_counter() - begin:.0f} s)\n", flush=True)
