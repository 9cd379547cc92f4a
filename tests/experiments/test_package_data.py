"""What is no Python, such as the template of the report, goes into the wheel too."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("hexmap", "planners", "localisation")


def data_files() -> set[str]:
    """Return all files of the packages that are no modules, as they are named in a wheel."""
    found = (path for package in PACKAGES for path in (ROOT / package).rglob("*") if path.is_file())
    return {str(path.relative_to(ROOT)) for path in found if path.suffix != ".py" and path.parent.name != "__pycache__"}


def test_every_data_file_is_named_in_the_project() -> None:
    patterns = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["*"]
    files = data_files()
    assert {"hexmap/experiments/report/report.html.jinja", "hexmap/experiments/report/report.css"} <= files
    assert not [file for file in files if not any(Path(file).match(pattern) for pattern in patterns)]


def test_a_wheel_holds_every_data_file(tmp_path: Path) -> None:
    source = tmp_path / "source"  # building leaves files behind
    source.mkdir()
    for package in PACKAGES:
        shutil.copytree(ROOT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    command = [sys.executable, "-m", "pip", "wheel", str(source), "--no-deps", "--wheel-dir", str(tmp_path)]
    built = subprocess.run(command, capture_output=True, text=True)
    if "No matching distribution" in built.stderr:
        pytest.skip("needs setuptools from an index")
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    assert data_files() <= set(zipfile.ZipFile(wheel).namelist())
