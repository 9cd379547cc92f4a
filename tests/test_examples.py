"""The examples run as they stand, and the ones in docstrings say what is true."""

from __future__ import annotations

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTED = [
    "hexmap.lattice.lattice", "hexmap.maps.builder", "hexmap.poses.pose", "hexmap.maps.voxel_list",
    "hexmap.io.trajectories", "hexmap.poses.trajectory", "localisation.evaluation",
    "localisation.matching.local_matcher",
]  # fmt: skip


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.stem)
def test_an_example_runs(path: Path) -> None:
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=120, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize("name", DOCUMENTED)
def test_the_examples_in_docstrings_are_true(name: str) -> None:
    module = importlib.import_module(name)
    names = vars(module) | {"math": importlib.import_module("math"), "np": importlib.import_module("numpy")}
    names |= {k: getattr(importlib.import_module("hexmap"), k) for k in ("Lattice", "Pose", "Scan", "VoxelList")}
    result = doctest.testmod(module, extraglobs=names)
    assert result.failed == 0
