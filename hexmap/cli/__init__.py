"""The command line: parse first, import what a command needs inside it, wrap a library function, print.

This is the roof of the house: it sees everything and nothing imports it.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType
from typing import Any, NoReturn

__all__ = ["main", "program"]

# Seconds after which a signal is looked at again that came where Python drops what a handler raises.
_AGAIN = 0.02


def program() -> NoReturn:
    """Run the command of the command line, and end this process with its exit code."""
    code = main()
    if code > 128:
        # Where an interrupt met a text that was being executed (a dataclass being made), Python remembers it, and at
        # its own end it would replace the exit code.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code: 0, 1 for bad input, 2 for wrong usage, 130 for Ctrl-C."""
    # A closed stream (program >&-) is None, which nobody expects.
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    # Before numpy is loaded. The matrices here are small: threads in the algebra would only wait for one another, and
    # sum in an order that depends on how many processors there are.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    interrupted = 0

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = number
        if _is_called_by_llvm(frame):
            again = threading.Timer(_AGAIN, signal.raise_signal, (number,))
            again.daemon = True
            again.start()
            return
        raise KeyboardInterrupt

    before: dict[int, Any] = {}
    with contextlib.suppress(ValueError):  # not the main thread: leave signals alone
        # Of nohup no signal is taken that it wants ignored.
        ends = [signal.SIGINT, signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
        for number in ends:
            if signal.getsignal(number) is not signal.SIG_IGN:
                before[number] = signal.signal(number, note)
    try:
        # Even while modules load, Ctrl-C must end in one line.
        from hexmap.cli.commands import run

        return run(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt:
        return _stopped(interrupted)
    except Exception:
        # The kernels' compiler swallows a KeyboardInterrupt and then fails in its own way.
        if interrupted:
            return _stopped(interrupted)
        raise
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler)


def _stopped(number: int) -> int:
    sys.stderr.write("\nhexmap: stopped; what was not yet announced as written is as it was\n")
    return 128 + (number or signal.SIGINT)


def _is_called_by_llvm(frame: FrameType | None) -> bool:
    """Tell whether the frame is within a call of the kernels' compiler: what is raised there is dropped, or worse."""
    while frame is not None:
        if f"{os.sep}llvmlite{os.sep}" in frame.f_code.co_filename:
            return True
        frame = frame.f_back
    return False
