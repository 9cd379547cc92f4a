"""The command line: parse first, import what a command needs inside it, wrap a library function, print.

This is the roof of the house: it sees everything and nothing imports it.
"""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Sequence
from types import FrameType

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 for bad input, 2 for wrong usage, 130 for Ctrl-C."""
    interrupted = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        raise KeyboardInterrupt

    before = None
    with contextlib.suppress(ValueError):  # not the main thread: leave signals alone
        before = signal.signal(signal.SIGINT, note)
    try:
        # Even while modules load, Ctrl-C must end in one line.
        from hexmap.cli.commands import run

        return run(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt:
        return _stopped()
    except Exception:
        # The kernels' compiler swallows a KeyboardInterrupt and then fails in its own way.
        if interrupted:
            return _stopped()
        raise
    finally:
        if before is not None:
            signal.signal(signal.SIGINT, before)


def _stopped() -> int:
    sys.stderr.write("\nhexmap: stopped; what was not yet announced as written is as it was\n")
    return 130
