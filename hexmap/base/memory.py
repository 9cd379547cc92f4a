"""What a program can ask of the C library's memory."""

from __future__ import annotations

import os
import sys

__all__ = ["return_free_memory", "return_freed_arrays"]

_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of malloc.h
_LARGE = 1 << 20


def return_freed_arrays() -> None:
    """Have every array of a MiB or more given back to the system as soon as it is freed.

    So it is at first. But with the first large array that is freed, glibc puts all others of up to that size, 32 MiB at
    most, among the small objects, and what is freed between those stays. A program that goes on making and dropping
    tables of some megabytes holds half as much again as it uses. This is for programs to call, not for libraries: it
    holds for the whole process. Where the user has set the limit in the environment, or the system has no such limit,
    nothing happens.
    """
    if "MALLOC_MMAP_THRESHOLD_" not in os.environ:
        _call("mallopt", _MMAP_THRESHOLD, _LARGE)


def return_free_memory() -> None:
    """Give back to the system what lies free between small objects, where it can be asked for: some milliseconds."""
    _call("malloc_trim", 0)


def _call(name: str, *numbers: int) -> None:
    """Call a function of glibc; of another library, nothing."""
    if not sys.platform.startswith("linux"):
        return
    import ctypes

    function = getattr(ctypes.CDLL(None), name, None)
    if function is not None:
        function(*numbers)
