"""Fixtures of all tests."""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import sys
import time
from importlib import metadata
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parents[1]
FORGOTTEN = 7 * 86_400.0  # seconds after which compiled kernels that no suite has used are deleted


def _kernel_cache() -> Path:
    """Return the folder of compiled kernels, by the content of all kernels.

    An edited helper in another file does not invalidate a cached caller, so a cache that outlives an edit would test
    yesterday's kernels. One folder for each state of all of them can outlive the session, and the workers, and the
    programs that tests start, share it: they inherit the variable.
    """
    digest = hashlib.blake2b(f"{sys.version} {metadata.version('numba')} {ROOT}".encode(), digest_size=10)
    for path in sorted(ROOT.glob("[hpl]*/**/_*kernels.py")):
        digest.update(path.read_bytes())
    folder = ROOT / ".kernels" / digest.hexdigest()
    if "PYTEST_XDIST_WORKER" not in os.environ:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for other in (ROOT / ".kernels").iterdir():
            if time.time() - other.stat().st_mtime > FORGOTTEN:
                shutil.rmtree(other, ignore_errors=True)
    return folder


# Before anything imports numba.
os.environ["NUMBA_CACHE_DIR"] = str(_kernel_cache())


# A suite that was started in the background ignores Ctrl-C, and so would the programs that its tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# How many examples are drawn is EXAMPLES in tests/lattices.py. A change must not fail to land by the draw of another
# day's examples; at home they are drawn anew.
settings.register_profile("home", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "home")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--long``."""
    parser.addoption("--long", action="store_true", help="the long sweeps as well, and more examples of everything")


def pytest_configure(config: pytest.Config) -> None:
    """Tell tests/lattices.py, which no test has imported yet, and the programs that tests start."""
    if config.getoption("long"):
        os.environ["HEXMAP_LONG"] = "1"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave the long sweeps out where they are not asked for."""
    if not config.getoption("long"):
        left_out = [item for item in items if "long" in item.keywords]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if "long" not in item.keywords]


def pytest_make_parametrize_id(val: object) -> str | None:
    """Name bytes by their length: gzip writes the time into them, and all workers must collect the same names."""
    return f"{len(val)} bytes" if isinstance(val, bytes) else None


@pytest.fixture(autouse=True)
def _no_notes_of_compiling(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep notes of compiling off standard error: they depend on which test is the first in a new folder of kernels."""
    monkeypatch.setattr("hexmap.cli.console.is_compiled", lambda kernel: True)


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real logs and maps; tests that need it skip where it is absent."""
    named = os.environ.get("HEXMAP_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}; set HEXMAP_DATA")
    return folder


@pytest.fixture(scope="session")
def cases_dir() -> Path:
    """Folder of the small inputs that users' situations led to; tests that need it skip where it is absent."""
    named = os.environ.get("HEXMAP_CASES")
    folder = Path(named) if named else ROOT.parent / "shared" / "cases"
    if not folder.is_dir():
        pytest.skip(f"no cases at {folder}; set HEXMAP_CASES")
    return folder
