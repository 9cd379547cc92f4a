"""Fixtures of all tests."""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import sys
from importlib import metadata
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parents[1]


def _kernel_cache() -> Path:
    """Return the folder of compiled kernels, by the content of all kernels.

    An edited helper in another file does not invalidate a cached caller, so a cache that outlives an edit would test
    yesterday's kernels. One folder for each state of all of them can outlive the session, and the workers share it.
    """
    digest = hashlib.blake2b(f"{sys.version} {metadata.version('numba')} {ROOT}".encode(), digest_size=10)
    for path in sorted(ROOT.glob("[hpl]*/**/_*kernels.py")):
        digest.update(path.read_bytes())
    folder = ROOT / ".kernels" / digest.hexdigest()
    if "PYTEST_XDIST_WORKER" not in os.environ:
        for stale in (ROOT / ".kernels").glob("*"):
            if stale != folder:
                shutil.rmtree(stale, ignore_errors=True)
    return folder


# Before anything imports numba.
os.environ["NUMBA_CACHE_DIR"] = str(_kernel_cache())


# A suite that was started in the background ignores Ctrl-C, and so would the programs that its tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# A change must not fail to land by the draw of another day's examples; at home they are drawn anew.
settings.register_profile("ci", derandomize=True, print_blob=True)
if os.environ.get("CI"):
    settings.load_profile("ci")


def pytest_make_parametrize_id(val: object) -> str | None:
    """Name bytes by their length: gzip writes the time into them, and all workers must collect the same names."""
    return f"{len(val)} bytes" if isinstance(val, bytes) else None


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real logs and maps; tests that need it skip where it is absent."""
    named = os.environ.get("HEXMAP_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; set HEXMAP_DATA")
    return folder
