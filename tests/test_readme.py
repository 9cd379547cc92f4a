"""Every block of the README runs as it is printed, from top to bottom, and prints what the README says.

Blocks that need nothing but what earlier ones have made run everywhere. Those that name a log, a scan or a map of the
shared data are run where it is there. Times differ from run to run and are not compared.
"""

from __future__ import annotations

import contextlib
import re
import shlex
from pathlib import Path

import pytest

from hexmap.cli import main

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
# What a block needs of the shared data, by the name that the README calls it.
SHARED = {
    "intel.clf.gz": "laser2d/intel.clf.gz",
    "intel.relations": "laser2d/intel.relations",
    "Complex.3dmap.gz": "planning/warframe/Complex.3dmap.gz",
}
# Figures that another machine, or the same one on another day, would not repeat: times, and what is told of them.
_TIMES = re.compile(r"\d[\d,.]*(?= (?:s|ms|MB|times)\b)")
BLOCKS = [
    (README[: found.start()].count("\n") + 1, found[1], found[2])
    for found in re.finditer(r"(?ms)^```(console|python)\n(.*?)^```", README)
]


def needs(text: str) -> list[str]:
    """Return what a block reads of the shared data."""
    return [name for name in SHARED if re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.])", text)]


def without_times(text: str) -> str:
    """Return printed text with every time in the place of which stands a mark."""
    return _TIMES.sub("#", text)


def commands(block: str) -> list[tuple[str, list[str]]]:
    """Return the commands of a console block, each with the lines that it prints."""
    out: list[tuple[str, list[str]]] = []
    for line in re.sub(r"\\\n\s*", "", block).splitlines():
        if line.startswith("$ "):
            out.append((line[2:], []))
        elif line.strip() and line.strip() != "...":
            out[-1][1].append(line)
    return out


def run_block(kind: str, block: str, names: dict[str, object], capsys: pytest.CaptureFixture[str]) -> None:
    """Run a block in the folder that is the current one, and compare what it prints."""
    if kind == "python":
        exec(compile(block, "README.md", "exec"), names)
        return
    for command, printed in commands(block):
        program, *words = shlex.split(command, comments=True)
        assert program == "hexmap"
        code = main(words)
        done = capsys.readouterr()
        assert code == 0, f"{command}\n{done.err}"
        lines = [without_times(line).rstrip() for line in (done.out + done.err).splitlines()]
        for line in printed:
            assert without_times(line).rstrip() in lines, f"{command}\nprints no line\n{line}\nbut\n{done.out}"


def test_the_readme_has_blocks_for_all_three_kinds_of_users() -> None:
    texts = " ".join(block for _, _, block in BLOCKS)
    for word in ("hexmap build", "hexmap plan", "hexmap localise", "from_array", "match_anywhere", "Localiser("):
        assert word in texts


@pytest.mark.long
def test_what_needs_no_data_runs_as_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    with contextlib.chdir(tmp_path):
        for _, kind, block in BLOCKS:
            if not needs(block):
                run_block(kind, block, names, capsys)


@pytest.mark.data
@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "block"),
    [pytest.param(kind, block, id=f"line {line}") for line, kind, block in BLOCKS if needs(block)],
)
def test_what_needs_data_runs_as_printed(
    kind: str, block: str, data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in needs(block):
        if not (data_dir / SHARED[name]).exists():
            pytest.skip(f"{SHARED[name]} is not there")
        (tmp_path / name).symlink_to(data_dir / SHARED[name])
    with contextlib.chdir(tmp_path):
        run_block(kind, block, {}, capsys)
