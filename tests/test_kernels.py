"""What a machine can see of the rules for kernels (CONTRIBUTING.md)."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("hexmap", "planners", "localisation")
SOURCES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
KERNEL_FILES = [path for path in SOURCES if path.name.startswith("_") and path.name.endswith("kernels.py")]


def decorators(path: Path) -> dict[str, ast.expr]:
    """Return what the functions of a file that Numba compiles are decorated with."""
    found = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef):
            for decorator in node.decorator_list:
                if any(word in ast.unparse(decorator) for word in ("jit", "vectorize", "stencil")):
                    found[node.name] = decorator
    return found


def test_kernels_live_in_kernel_files() -> None:
    """Only their content names the folder of compiled kernels that tests use."""
    assert [path for path in SOURCES if path not in KERNEL_FILES and decorators(path)] == []
    assert len(KERNEL_FILES) > 10


@pytest.mark.parametrize("path", KERNEL_FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_kernel_is_cached_and_keeps_to_exact_arithmetic(path: Path) -> None:
    kernels = decorators(path)
    assert kernels
    for name, decorator in kernels.items():
        assert isinstance(decorator, ast.Call), f"{name}: @njit takes cache=True"
        options = {option.arg: ast.literal_eval(option.value) for option in decorator.keywords}
        assert options.get("cache") is True, f"{name} is compiled anew in every process"
        assert not options.get("fastmath"), f"{name}: fastmath breaks the checks for NaN and infinity"
        assert options.get("nogil") is True, f"{name} would hold up other threads"
