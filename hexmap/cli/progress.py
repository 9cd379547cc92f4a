"""The line that shows, on a terminal, what a command is doing, how far it is and how long it will take."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["Estimate", "progress_on_terminal"]

_STEP = 0.1  # seconds between two looks at how far the work is
_ENOUGH = 1.0  # seconds of work from which the rest can be told


class Estimate:
    """How fast the work goes and how long it will take: from its first step on, without what was compiled since.

    Args:
        clock: returns seconds.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._begin: float | None = None
        self._first = (0, 0.0)
        self._compiled = 0.0

    def compiled(self, seconds: float) -> None:
        """Take note of a time in which the compiler ran: it will not run again."""
        if self._begin is not None:
            self._compiled += seconds

    def of(self, count: int, fraction: float) -> tuple[float, float]:
        """Return how many a second there are, and the seconds left; NaN where there is no telling yet."""
        now = self._clock()
        if self._begin is None:
            # What came before the first step, as loading, says nothing of the others.
            self._begin, self._first = now, (count, fraction)
            return math.nan, math.nan
        spent = now - self._begin - self._compiled
        done = fraction - self._first[1]
        rate = (count - self._first[0]) / spent if spent > 0.0 else math.nan
        if spent < _ENOUGH or not done > 0.0:
            return rate, math.nan
        return rate, spent * max(0.0, 1.0 - fraction) / done


@contextmanager
def progress_on_terminal(what: str, fraction: Callable[[], float], noun: str) -> Iterator[Callable[[int], None]]:
    """Show a line that moves from the first second on; yields what to call with the number of ``noun`` done.

    Until the first call it shows that something is being done, and for how long. Whenever the kernels' compiler runs,
    the line says so.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (
        SpinnerColumn(finished_text=" "),
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[words]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        # Without a total the bar pulses: how much there is to do is known from the first scan on.
        task = bar.add_task(what, total=None, words="")
        estimate = Estimate()
        words, left, last = "", "", -math.inf

        def show(compiling: bool) -> None:
            # How long the compiler takes nobody can tell.
            note = "compiling, once" if compiling else left
            bar.update(task, words=", ".join(text for text in (words, note) if text))

        def on_compiled(begun: bool, seconds: float) -> None:
            estimate.compiled(seconds)
            show(begun)

        def update(count: int) -> None:
            nonlocal words, left, last
            now = time.monotonic()
            if now - last < _STEP:
                return
            last = now
            done = min(max(fraction(), 0.0), 1.0)
            rate, seconds = estimate.of(count, done)
            words, left = _words(count, noun, done, rate), _left(seconds)
            bar.update(task, total=1.0, completed=done)
            show(False)

        with _compiler_watched(on_compiled):
            show(False)
            yield update


def _words(count: int, noun: str, done: float, rate: float) -> str:
    """Return how far the work is."""
    words = f"{100.0 * done:3.0f} %  {count:,} {noun.removesuffix('s') if count == 1 else noun}"
    if math.isfinite(rate) and rate > 0.0:
        words += f", {rate:.0f} a second" if rate >= 10.0 else f", {rate:.1f} a second"
    return words


def _left(seconds: float) -> str:
    """Return how long the work will take; nothing where there is no telling."""
    if not math.isfinite(seconds):
        return ""
    minutes, rest = divmod(math.ceil(seconds), 60)
    return f"{minutes}:{rest:02d} left"


@contextmanager
def _compiler_watched(tell: Callable[[bool, float], None]) -> Iterator[None]:
    """Call ``tell(True, 0.0)`` when the kernels' compiler begins, and ``tell(False, seconds)`` when it is done."""
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        depth = 0
        begin = 0.0

        def on_start(self, event: Any) -> None:
            if self.depth == 0:
                self.begin = time.monotonic()
                tell(True, 0.0)
            self.depth += 1

        def on_end(self, event: Any) -> None:
            self.depth -= 1
            if self.depth == 0:
                tell(False, time.monotonic() - self.begin)

    with event.install_listener("numba:compile", Listener()):
        yield
