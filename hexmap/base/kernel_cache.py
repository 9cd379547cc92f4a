"""Where compiled kernels are kept: beside their modules, in the user's cache, or else in a folder of their own."""

from __future__ import annotations

import os
import sys
from pathlib import Path

__all__ = ["find_kernel_cache"]


def find_kernel_cache() -> None:
    """Give the compiler a folder where it finds none: it keeps kernels in places that may all be write-protected.

    That folder is removed at the end of the process; those that it starts use the same one.
    """
    if os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return
    package = Path(__file__).resolve().parents[1]
    if _is_writable(package / "lattice" / "__pycache__") or _is_writable(_users()):
        return
    import atexit
    import shutil
    import tempfile

    try:
        folder = tempfile.mkdtemp(prefix="hexmap-kernels-")
    except OSError:
        sys.stderr.write("warning: no folder can be written to, not even a temporary one; kernels cannot be compiled\n")
        return
    owner = os.getpid()
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == owner else None)
    os.environ["NUMBA_CACHE_DIR"] = folder
    sys.stderr.write(
        "warning: there is no folder to keep compiled kernels in, they are compiled again for every run; "
        "set NUMBA_CACHE_DIR to one\n"
    )


def _users() -> Path:
    """Return the folder of the user's caches."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path(os.path.expanduser("~")) / ".cache") / "numba"


def _is_writable(folder: Path) -> bool:
    """Tell whether files can be made in a folder, which is made if it is missing, by making one: rights may lie."""
    probe = folder / f".{os.getpid()}-{os.urandom(4).hex()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.close(os.open(probe, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
        probe.unlink()
    except OSError:
        return False
    return True
