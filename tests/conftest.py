"""Fixtures of all tests."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

import pytest

# Before anything imports numba: an edited helper in another file does not invalidate a cached
# caller, so a cache that outlives the session would test yesterday's kernels.
_CACHE = tempfile.TemporaryDirectory(prefix="hexmap-numba-")
os.environ["NUMBA_CACHE_DIR"] = _CACHE.name


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real logs and maps; tests that need it skip where it is absent."""
    named = os.environ.get("HEXMAP_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; set HEXMAP_DATA")
    return folder
