"""Node, in which the scripts of the page run without a browser."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib import resources
from pathlib import Path
from typing import Any

import pytest


def _find() -> str | None:
    """Return where Node is: installed by itself, or with playwright, which brings one along."""
    found = shutil.which("node")
    if found is not None:
        return found
    try:
        from playwright._impl._driver import compute_driver_executable

        return str(compute_driver_executable()[0])
    except ImportError:
        return None


NODE = _find()
needs_node = pytest.mark.skipif(NODE is None, reason="needs Node (node), which is not installed")


def run(folder: Path, scripts: list[str], last: str, given: Any) -> Any:
    """Return what the script ``last`` of this folder, after some of the page's, makes of ``given``; both as JSON."""
    own = [(resources.files("hexmap.web") / name).read_text() for name in scripts]
    script = folder / last
    script.write_text("\n".join([*own, (Path(__file__).parent / last).read_text()]))
    assert NODE is not None
    done = subprocess.run([NODE, script], input=json.dumps(given), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
