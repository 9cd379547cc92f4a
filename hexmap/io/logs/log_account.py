"""What is told of any log while it is read: how far it is, what was left out, and what was not as it should be."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from hexmap.base.text import plural

__all__ = ["LogAccount", "Tally"]


@dataclass
class Tally:
    """Counts one kind of trouble and remembers where it was first met."""

    count: int = 0
    first: str = ""

    def add(self, where: str, count: int = 1) -> None:
        """Count; ``where`` says line and reason of the first."""
        if self.count == 0:
            self.first = where
        self.count += count


class LogAccount:
    """A log of any sensor: where it is, how much of it has been read, and its warnings.

    Attributes:
        path: the file or folder.
        size: bytes of it, compressed as it is.
        position: bytes read so far, about.
        scans: scans yielded so far.
    """

    _unit = "line"

    def __init__(self, path: Path, size: int) -> None:
        """Begin; nothing is read yet."""
        self.path, self.size = path, size
        self._notes: list[str] = []
        self._reset()

    def _reset(self) -> None:
        """Forget what the last reading has counted."""
        self.position = self.scans = 0
        self._skipped = Tally()
        self._late_notes: list[str] = []

    def __repr__(self) -> str:
        """Say which file it is and how far it has been read."""
        return f"<{type(self).__name__} {self.path.name}, {self.scans} scans read>"

    @property
    def skipped(self) -> int:
        """Lines, messages or files that could not be used so far."""
        return self._skipped.count

    def fraction(self) -> float:
        """Return how much of the log has been read, from 0 to 1."""
        return min(self.position / self.size, 1.0) if self.size > 0 else 1.0

    @property
    def warnings(self) -> list[str]:
        """What was not as it should be, one line each, each naming the file."""
        texts = list(self._notes)
        if self._skipped.count:
            texts.append(f"{plural(self._skipped.count, self._unit)} skipped, the first at {self._skipped.first}")
        return [f"{self.path.name}: {text}" for text in (*texts, *self._told(), *self._late_notes)]

    def _told(self) -> list[str]:
        """Return what else was left out, one line each."""
        return []
