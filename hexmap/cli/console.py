"""What the commands share: a progress line, notes, checks of outputs before long work begins."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hexmap.base.errors import FileAccessError
from hexmap.base.text import printable

if TYPE_CHECKING:
    from hexmap.poses.pose import Pose

# Metres: lasers measure to a few millimetres at best, and a room is some metres wide.
_FINEST, _COARSEST = 0.001, 10.0
_PICTURES = (".png", ".svg", ".pdf", ".jpg", ".jpeg")

__all__ = [
    "check_applies",
    "check_map_output",
    "check_outputs",
    "compiling_note",
    "first_run_note",
    "is_compiled",
    "mount_words",
    "progress_line",
    "say",
    "warn",
    "warn_of_size",
    "wrote",
]


def say(text: str) -> None:
    """Print a line of the result."""
    typer.echo(printable(text))


def warn(text: str) -> None:
    """Print a warning to standard error."""
    typer.echo(printable(f"warning: {text}"), err=True)


def wrote(path: Path | str, what: str) -> None:
    """Say what was written, and where."""
    typer.echo(printable(f"wrote {path}  ({what})".replace("\n", "\\n")))


def check_applies(path: Path | None, what: str, options: dict[str, bool]) -> None:
    """Refuse options that say nothing of what is given: option -> whether it was set.

    Raises:
        BadParameter: naming those that were set.
    """
    given = [name for name, is_set in options.items() if is_set]
    if given:
        raise typer.BadParameter(f"{path}: {what}; leave out {' and '.join(given)}")


def check_map_output(path: Path) -> None:
    """Check that a map file to write is called one.

    Raises:
        BadParameter: its suffix is another; a picture or a text of that name would hold Parquet.
    """
    if path.suffix.lower() != ".parquet" and not _is_device(path):
        instead = f"; hexmap show draws a map into {path.name}" if path.suffix.lower() in _PICTURES else ""
        found = f"as {path.suffix}" if path.suffix else "to a file without a suffix"
        raise typer.BadParameter(f"--output: {path}: a map is written as .parquet, not {found}{instead}")


def warn_of_size(metres: float | None) -> None:
    """Warn of cells that are finer than a laser measures, or larger than the rooms that a map is to show."""
    if metres is not None and 0.0 < metres < _FINEST:
        warn(f"cells of {metres:g} m are finer than a laser measures; a map of them is large and full of gaps")
    if metres is not None and _COARSEST < metres < float("inf"):
        warn(f"cells of {metres:g} m are larger than rooms; hardly anything can be told apart in a map of them")


def _is_device(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()


def check_outputs(outputs: dict[str, Path | None], inputs: tuple[Path, ...] = ()) -> None:
    """Check before the work begins that every output can be written and that none is another or an input.

    Args:
        outputs: option name -> path, None where it is not asked for.
        inputs: files that are read.

    Raises:
        FileAccessError: a folder does not exist or cannot be written to; two outputs, or an output and an input, are
            the same file.
    """
    seen: dict[str, Path] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        folder = path.parent
        if not folder.is_dir():
            raise FileAccessError(f"{path}: cannot be written: there is no folder {folder}")
        if path.is_dir():
            raise FileAccessError(f"{path}: cannot be written: it is a folder")
        if not os.access(folder, os.W_OK):
            raise FileAccessError(f"{path}: cannot be written: the folder is write-protected")
        for other, there in seen.items():
            if _same(path, there):
                raise FileAccessError(f"{other} and {option} are the same file: {path}")
        seen[option] = path
    for path in inputs:
        for option, there in seen.items():
            if _same(path, there):
                raise FileAccessError(f"{option} would overwrite what is read: {path}")


def _same(a: Path, b: Path) -> bool:
    """Tell whether two paths are one file, through links of both kinds."""
    if os.path.realpath(a) == os.path.realpath(b):
        return True
    try:
        return os.path.samefile(a, b)
    except OSError:
        return False


def first_run_note(seconds: int = 20) -> None:
    """Say on standard error that kernels are being compiled, where none is found compiled, and how long that takes."""
    from hexmap.lattice import _kernels as _lattice_kernels

    if not any(is_compiled(kernel) for kernel in (_lattice_kernels.quantise_2d, _lattice_kernels.quantise_3d)):
        _say_compiling("kernels", seconds)


def compiling_note(*kernels: Any, seconds: int = 5) -> None:
    """Say on standard error that a planner is being compiled, where one of its kernels is found nowhere."""
    if not all(is_compiled(kernel) for kernel in kernels):
        _say_compiling("the planner", seconds)


def _say_compiling(what: str, seconds: int) -> None:
    typer.echo(f"compiling {what}, once, some {seconds} s", err=True)


def is_compiled(kernel: Any) -> bool:
    """Tell whether a kernel's index is in the cache, or no kernel is compiled at all."""
    cache = getattr(getattr(kernel, "_cache", None), "cache_path", None)
    if cache is None:
        return True
    module = kernel.py_func.__module__.rpartition(".")[2]
    return any(Path(cache).glob(f"{module}.{kernel.py_func.__name__}-*.nbi"))


@contextmanager
def progress_line(what: str, fraction: Callable[[], float], noun: str = "scans") -> Iterator[Callable[[int], None]]:
    """Show scans (or ``noun``) a second and the time left, on a terminal only; yields what to call after each."""
    if not sys.stderr.isatty():
        yield lambda scans: None
        return
    from hexmap.cli.progress import progress_on_terminal

    with progress_on_terminal(what, fraction, noun) as update:
        yield update


def mount_words(mount: Pose) -> str:
    """Return how a sensor is mounted in space, in words."""
    R = mount.rotation
    yaw, roll = math.atan2(R[1, 0], R[0, 0]), math.atan2(R[2, 1], R[2, 2])
    pitch = math.atan2(-R[2, 0], math.hypot(R[0, 0], R[1, 0]))
    place = ", ".join(f"{v:.3f}" for v in mount.translation.tolist())
    turn = ", ".join(f"{math.degrees(v):.1f}" for v in (roll, pitch, yaw))
    return f"({place}) m, turned by {turn} degrees (roll, pitch, yaw)"
