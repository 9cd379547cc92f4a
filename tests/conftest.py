"""Fixtures of all tests."""

from __future__ import annotations

import os
import signal
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

# Before anything imports numba: an edited helper in another file does not invalidate a cached
# caller, so a cache that outlives the session would test yesterday's kernels.
_CACHE = tempfile.TemporaryDirectory(prefix="hexmap-numba-")
os.environ["NUMBA_CACHE_DIR"] = _CACHE.name


# A suite that was started in the background ignores Ctrl-C, and so would the programs that its tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# A change must not fail to land by the draw of another day's examples; at home they are drawn anew.
settings.register_profile("ci", derandomize=True, print_blob=True)
if os.environ.get("CI"):
    settings.load_profile("ci")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real logs and maps; tests that need it skip where it is absent."""
    named = os.environ.get("HEXMAP_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; set HEXMAP_DATA")
    return folder
