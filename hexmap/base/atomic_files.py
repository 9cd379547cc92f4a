"""Files and folders that are either the old one or the whole new one, never half of it.

Everything is written under a temporary name in the folder of the target, synced to the disk and
renamed onto the target. A run that is killed leaves the old file; one that fails or is
interrupted also removes its temporary file.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, TypeAlias

from hexmap.base.errors import FileAccessError
from hexmap.base.text import reason

__all__ = ["PathLike", "atomic_folder", "atomic_path", "atomic_write", "replaceable_folder"]

PathLike: TypeAlias = str | os.PathLike[str]

# What a full or failing disk reports while the body writes; other OSErrors are not about our file.
_DISK_ERRORS = frozenset(
    getattr(errno, name) for name in ("ENOSPC", "EDQUOT", "EFBIG", "EIO", "EROFS") if hasattr(errno, name)
)


def _cannot_write(path: Path, error: OSError) -> FileAccessError:
    if isinstance(error, FileNotFoundError) and not path.parent.is_dir():
        return FileAccessError(f"{path}: cannot be written: there is no folder {path.parent}")
    if isinstance(error, FileNotFoundError):
        return FileAccessError(f"{path}: cannot be written: no files can be made in {path.parent}")
    return FileAccessError(f"{path}: cannot be written: {reason(error)}")


def _sync_folder(folder: Path) -> None:
    """Sync the folder's entry too, where the system lets one: the rename itself lives there."""
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


def _create_beside(target: Path) -> Path:
    """Create an empty file with a new name beside ``target``, with the mode open() would give."""
    while True:
        # The suffix stays last, because some writers choose their format by it.
        temporary = target.with_name(f".{target.stem[:100]}.{os.getpid()}-{os.urandom(4).hex()}{target.suffix}")
        try:
            # 0o666 less the umask, which is what open() gives; tempfile would give 0600.
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        except FileExistsError:
            continue
        except BaseException:  # Ctrl-C, when the file has been made and nobody knows of it yet
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
            raise
        return temporary


@contextlib.contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path to write to, which becomes ``path`` when the block ends well.

    The temporary file lies in the folder of ``path`` and has its suffix. On any exception,
    Ctrl-C included, it is removed and ``path`` stays as it was. A symbolic link is followed; a
    device or a pipe is written to directly, since renaming onto it would replace it.

    Args:
        path: the file to make or to replace.

    Yields:
        The path to write to; an empty file exists there.

    Raises:
        FileAccessError: the folder is missing, is not writable, or the disk is full.

    Examples:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from hexmap.base.atomic_files import atomic_path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with atomic_path(Path(folder) / "a.txt") as temporary:
        ...         _ = temporary.write_text("whole")
        ...     (Path(folder) / "a.txt").read_text()
        'whole'
    """
    given = Path(path)
    try:
        target = Path(os.path.realpath(given))
        mode = target.stat().st_mode if target.exists() else None
        if mode is not None and stat.S_ISDIR(mode):
            raise FileAccessError(f"{given}: cannot be written: it is a folder")
        if mode is not None and not stat.S_ISREG(mode):
            yield given
            return
        if mode is not None and not os.access(target, os.W_OK):
            # Renaming needs no right on the file itself; a write-protected map must stay all the same.
            raise FileAccessError(f"{given}: cannot be written: the file is write-protected")
        temporary = _create_beside(target)
    except FileAccessError:
        raise
    except OSError as error:
        raise _cannot_write(given, error) from error
    try:
        yield temporary
        try:
            if mode is not None:
                os.chmod(temporary, stat.S_IMODE(mode))
            fd = os.open(temporary, os.O_RDWR)
            try:
                os.fsync(fd)
            finally:
                os.close(fd)
            os.replace(temporary, target)
        except OSError as error:
            raise _cannot_write(given, error) from error
        _sync_folder(target.parent)
    except BaseException as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and not isinstance(error, FileAccessError) and error.errno in _DISK_ERRORS:
            raise FileAccessError(f"{given}: cannot be written: {reason(error)}") from error
        raise


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str], mode: str = "wb", encoding: str | None = None) -> Iterator[IO[Any]]:
    """Give an open file whose content becomes ``path`` when the block ends well.

    Args:
        path: the file to make or to replace.
        mode: ``"wb"`` for bytes, ``"w"`` for text (UTF-8 and newlines as written, on every system).
        encoding: of the text, UTF-8 unless said otherwise.

    Yields:
        The open file; close is ours.

    Raises:
        FileAccessError: the folder is missing, is not writable, or the disk is full.
    """
    binary = "b" in mode
    text_encoding, newline = (None, None) if binary else (encoding or "utf-8", "\n")
    with atomic_path(path) as temporary, open(temporary, mode, encoding=text_encoding, newline=newline) as handle:
        yield handle


def replaceable_folder(path: str | os.PathLike[str], content: frozenset[str]) -> Path:
    """Return the true path of a folder that may be made or replaced: it is missing, or holds files of ``content`` only.

    Args:
        path: the folder to make or to replace.
        content: names of the files that it may hold.

    Raises:
        FileAccessError: a file of that name, a folder that holds anything else, or a parent folder that is missing or
            write-protected.
    """
    given = Path(path)
    target = Path(os.path.realpath(given))
    if not target.parent.is_dir():
        raise FileAccessError(f"{given}: cannot be written: there is no folder {target.parent}")
    if not os.access(target.parent, os.W_OK):
        raise FileAccessError(f"{given}: cannot be written: the folder {target.parent} is write-protected")
    if os.path.lexists(target):
        if not target.is_dir():
            raise FileAccessError(f"{given}: cannot be written: there is a file of that name")
        for entry in sorted(os.listdir(target)):
            if entry not in content or not (target / entry).is_file():
                raise FileAccessError(f"{given}: cannot be written: the folder holds something else, {entry}")
    return target


@contextlib.contextmanager
def atomic_folder(path: str | os.PathLike[str], content: frozenset[str]) -> Iterator[Path]:
    """Give the path of a folder to make and fill, which becomes ``path`` when the block ends well.

    It has the name of ``path``, lies in a temporary folder beside it and does not exist yet. On any exception, Ctrl-C
    included, the temporary folder is removed and ``path`` stays as it was. No system call replaces a folder that holds
    files, so a process that is killed between two renames leaves the old one in the temporary folder.

    Args:
        path: the folder to make or to replace.
        content: names of the files that a folder may hold to be replaced; any other is left alone.

    Yields:
        The path of the folder to make.

    Raises:
        FileAccessError: what :func:`replaceable_folder` refuses, or a full disk.
    """
    given, target = Path(path), replaceable_folder(path, content)
    around = target.with_name(f".{target.name[:100]}.{os.getpid()}-{os.urandom(4).hex()}")
    try:
        around.mkdir()
    except OSError as error:
        raise _cannot_write(given, error) from error
    made, old = around / target.name, around / "replaced" / target.name
    try:
        yield made
        for entry in sorted(made.iterdir()):
            with open(entry, "rb") as handle:
                os.fsync(handle.fileno())
        _sync_folder(made)
        try:
            if os.path.lexists(target):
                # A folder cannot be renamed onto one that holds files: the old one steps aside first.
                old.parent.mkdir()
                os.rename(target, old)
            try:
                os.rename(made, target)
            except OSError:
                if old.exists():
                    os.rename(old, target)
                raise
        except OSError as error:
            raise _cannot_write(given, error) from error
        _sync_folder(target.parent)
    except OSError as error:
        if not isinstance(error, FileAccessError) and error.errno in _DISK_ERRORS:
            raise FileAccessError(f"{given}: cannot be written: {reason(error)}") from error
        raise
    finally:
        shutil.rmtree(around, ignore_errors=True)
