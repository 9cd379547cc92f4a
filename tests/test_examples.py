"""Everything that documentation shows is run: the scripts of examples/ and docstrings; the README in its own test."""

from __future__ import annotations

import doctest
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("hexmap", "planners", "localisation")
DOCUMENTED = sorted(
    path.relative_to(ROOT)
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
    if ">>>" in path.read_text(encoding="utf-8")
)


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.py")), ids=lambda p: p.stem)
def test_an_example_runs(path: Path) -> None:
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=120, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def module_of(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_docstrings_have_examples() -> None:
    assert {path.parts[0] for path in DOCUMENTED} == set(PACKAGES)


@pytest.mark.parametrize("name", [module_of(path) for path in DOCUMENTED])
def test_the_examples_in_docstrings_are_true(name: str) -> None:
    """Each docstring by itself, with no names but those it imports or makes, as a reader would try it."""
    module = importlib.import_module(name)
    written = (ROOT / f"{module.__file__}").read_text(encoding="utf-8").count(">>>")
    tests = doctest.DocTestFinder(exclude_empty=True).find(module, globs={})
    examples = [example for test in tests for example in test.examples]
    assert len(examples) == written, "some examples stand where they are never run"
    runner = doctest.DocTestRunner()
    for test in tests:
        runner.run(test)
    skipped = [example for example in examples if example.options.get(doctest.SKIP)]
    result = runner.summarize(verbose=False)
    assert result.failed == 0
    assert result.attempted == len(examples) - len(skipped) > 0
