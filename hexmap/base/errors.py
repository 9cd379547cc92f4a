"""Every error that hexmap raises on purpose.

Each class is a :class:`HexmapError`, so that one ``except`` catches them all, and also the
builtin that it refines, so that code which never heard of hexmap still catches it. The command
line turns a :class:`HexmapError` into one line on standard error and exit code 1.
"""

from __future__ import annotations


class HexmapError(Exception):
    """Root of all errors raised on purpose; its text is one line fit for a user."""


class BoundsError(HexmapError, ValueError):
    """A coordinate or an index lies outside what a lattice index can hold, or is not finite."""


class LatticeError(HexmapError, ValueError):
    """A lattice cannot be made, is not known by that name, or two lattices do not agree."""


class ArgumentError(HexmapError, ValueError):
    """A value given to a function or an option is out of range or of the wrong shape."""


class TooLargeError(HexmapError, MemoryError):
    """What was asked for would not fit into memory; the text says the size, before anything is allocated."""


class LogError(HexmapError, ValueError):
    """A log cannot be read; the text names the file and, where there is one, the line."""


class TrajectoryError(HexmapError, ValueError):
    """A trajectory or relations file cannot be read, or two of them do not associate."""


class AlignmentError(HexmapError, ValueError):
    """One map cannot be found in another beyond doubt; the text says which test failed, with its numbers."""


class FormatError(HexmapError, ValueError):
    """A map or another data file is damaged, of a foreign kind or of a newer version."""


class FileAccessError(HexmapError, OSError):
    """A file cannot be opened or written; the text names it and says why."""


class MissingDependencyError(HexmapError, ImportError):
    """An optional package, or a system library it needs, is missing; the text says what to install."""
