"""A lattice of one's own on the command line: build, plan and benchmark with ``--basis``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, FileAccessError, FormatError, HexmapError
from hexmap.cli import main
from hexmap.cli.lattice_options import parse_basis
from hexmap.io.map_file import load_map
from hexmap.lattice.lattice import Lattice
from tests.lattices import CASES, Case

OWN = np.array([[0.13, 0.04], [0.0, 0.11]])  # columns are the generators (0.13, 0), (0.04, 0.11)
WRITTEN = "0.13,0;0.04,0.11"


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_basis_is_read_from_the_command_line_and_from_a_file(case: Case, tmp_path: Path) -> None:
    generators = case.lattice.basis.T.tolist()
    written = ";".join(",".join(map(repr, row)) for row in generators)
    assert Lattice(parse_basis(written)) == case.lattice
    file = tmp_path / "basis.txt"
    file.write_text("# mine\n\n" + "".join(" ".join(map(repr, row)) + "  # a generator\n" for row in generators))
    assert Lattice(parse_basis(str(file))) == case.lattice
    file.write_text("\n".join(", ".join(map(repr, row)) for row in generators))
    assert Lattice(parse_basis(str(file))) == case.lattice


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("1 0\n0 x\n", "line 2: not a number: 'x'"),
        ("1 0\n\n0 1 0\n", "line 3: 3 numbers, where 2 stand before"),
        ("1 0 0\n0 1 0\n", "here are 2 of 3"),
        ("# nothing\n", "here are none"),
        ("1 0\n" * 20_000, "more than 65,536 bytes"),
    ],
)
def test_a_file_that_is_no_basis_is_named_with_its_line(content: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "basis.txt"
    file.write_text(content)
    with pytest.raises(FormatError, match=words) as error:
        parse_basis(str(file))
    assert str(error.value).startswith(f"{file}: ") and "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["", "1", "1,2", "1,2;3", "1,2;3,4;5,6", "a,b;c,d", "basis.txt", "\0", "x" * 5000])
def test_what_is_no_basis_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ArgumentError, match="a basis is written as x,y;x,y or") as error:
        parse_basis(text)
    assert "\n" not in str(error.value) and len(str(error.value)) < 200


def test_a_file_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "basis.txt"
    file.write_text("1 0\n0 1\n")

    def denied(*args: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(FileAccessError, match="Permission denied"):
        parse_basis(str(file))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("basis") / "room.clf"
    assert call("simulate", "room", "-o", path, "--seed", 1, "--duration", 6) == 0
    return path


def test_a_map_is_built_and_planned_in_on_it(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = log.with_name("own.parquet")
    assert call("build", log, "-o", output, "--basis", WRITTEN, "--no-loop-closure") == 0
    assert load_map(output).lattice == Lattice(OWN)
    finer = log.with_name("finer.parquet")
    assert call("build", log, "-o", finer, "--basis", WRITTEN, "--resolution", 0.05, "--no-loop-closure") == 0
    made = load_map(finer).lattice
    np.testing.assert_allclose(made.basis / 0.05, OWN / Lattice(OWN).resolution, atol=1e-9)
    capsys.readouterr()
    for more in ((), ("--basis", "0.09,0.01;0,0.1"), ("--resolution", 0.08), ("--lattice", "A2")):
        assert call("plan", output, "--from", 0, 0, "--to", 0.5, 0.3, *more) == 0
    assert "own lattice at 0.0948683 m" in capsys.readouterr().out


def test_a_name_and_a_basis_do_not_go_together(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = log.with_name("none.parquet")
    capsys.readouterr()
    assert call("build", log, "-o", output, "--basis", WRITTEN, "--lattice", "A2") == 2
    assert "give --lattice A2 or --basis, not both" in capsys.readouterr().err
    for basis, words in (("1,2;2,4", "independent"), ("1,0,0;0,1,0;0,0,1", "a lattice of space")):
        assert call("build", log, "-o", output, "--basis", basis, "--no-loop-closure") != 0
        err = capsys.readouterr().err
        assert words in err and err.count("\n") == 1
    assert not output.exists()


@pytest.mark.long
def test_the_benchmark_compares_it(tmp_path: Path) -> None:
    rows = ["." * 16] * 5 + ["....@@@@@@@@...."] + ["." * 16] * 5
    (tmp_path / "a.map").write_text(f"type octile\nheight {len(rows)}\nwidth 16\nmap\n" + "\n".join(rows) + "\n")
    few = ("--queries", 8, "--angles", 0, "--fractions", 2, "--planners", "astar")
    output = tmp_path / "report"
    assert call("benchmark", "planning", tmp_path / "a.map", "-o", output, *few, "--basis", WRITTEN) == 0
    text = (output / "report.md").read_text()
    assert "own-6" in text and "own-8" in text


def test_a_basis_with_no_lattice_is_our_error() -> None:
    with pytest.raises(HexmapError):
        Lattice(parse_basis("nan,0;0,1"))
