"""The command line: parse first, import what a command needs inside it, wrap a library function, print.

This is the roof of the house: it sees everything and nothing imports it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 for bad input, 2 for wrong usage, 130 for Ctrl-C."""
    try:
        # Even while modules load, Ctrl-C must end in one line.
        from hexmap.cli.commands import run

        return run(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt:
        sys.stderr.write("\nhexmap: stopped; what was not yet announced as written is as it was\n")
        return 130
