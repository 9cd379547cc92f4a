"""What the commands say of wrong values, odd names and inputs that were made to break them: one line, no traceback."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import FileAccessError, FormatError, HexmapError
from hexmap.cli import main
from hexmap.experiments.report.report import Report
from hexmap.experiments.run_cases import run_cases
from hexmap.io.exports import export
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.map_file import load_map, save_map
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.score import coincidence
from tests.observing import wait_until


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short log, its map, points of a cube, and a packed map of a game."""
    here = tmp_path_factory.mktemp("words")
    assert call("simulate", "room", "-o", here / "a.clf", "--truth", here / "a.tum", "--duration", 5) == 0
    assert call("build", here / "a.clf", "-o", here / "a.parquet", "--no-loop-closure") == 0
    np.savetxt(here / "cube.xyz", np.random.default_rng(0).random((400, 3)))
    return here


def refused(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> str:
    capsys.readouterr()
    assert call(*arguments) == code, arguments
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("hexmap: ") and err.rstrip("\n").isprintable()
    return err


# ---------------------------------------------------------------------- wrong values


def test_a_map_is_not_written_into_a_picture(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "x.png"
    picture.write_bytes(b"mine")
    for command in (("build", folder / "a.clf"), ("merge", folder / "a.parquet", folder / "a.parquet")):
        for name in ("x.png", "x.txt", "x"):
            assert ".parquet" in refused(capsys, 2, *command, "-o", tmp_path / name)
    assert [p.name for p in tmp_path.iterdir()] == ["x.png"] and picture.read_bytes() == b"mine"


@pytest.mark.parametrize(
    "arguments",
    [
        ("build", "a.clf", "-o", "o.parquet", "--resolution", "-1"),
        ("build", "a.clf", "-o", "o.parquet", "--lattice", "D3"),
        ("build", "a.clf", "-o", "o.parquet", "--levels", "0"),
        ("build", "a.clf", "-o", "o.parquet", "--min-hits", "0"),
        ("build", "a.clf", "-o", "o.parquet", "--angle-step", "0"),
        ("build", "a.clf", "-o", "o.parquet", "--laser", "left"),
        ("show", "a.parquet", "-o", "o.png", "--level", "7"),
        ("show", "a.parquet", "-o", "o.png", "--min-ratio", "2"),
        ("export", "a.parquet", "-o", "o.csv", "--level", "-1"),
        ("export", "a.parquet", "-o", "o.obj"),
        ("plan", "a.parquet", "--from", "0", "0", "--to", "1", "1", "--radius", "-1"),
        ("plan", "a.parquet", "--from", "0", "0", "--to", "1", "1", "--lattice", "hexagone"),
        ("evaluate", "a.tum", "--reference", "a.tum", "--tolerance", "-1"),
        ("evaluate", "a.tum", "--reference", "a.tum", "--step", "0"),
        ("simulate", "moon", "-o", "o.clf"),
        ("experiment", "rotation", "cube.xyz", "-o", "o", "--volume", "-1"),
        ("experiment", "rotation", "cube.xyz", "-o", "o", "--volume", "0.1", "--lattice", "Z3", "--lattice", "Z3"),
        ("experiment", "rotation", "cube.xyz", "-o", "o", "--volume", "0.1", "--basis", "1,2"),
        ("experiment", "quantiser", "-o", "o", "--count", "0"),
    ],
    ids=" ".join,
)
def test_wrong_values_of_options_are_wrong_usage(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...]
) -> None:
    monkeypatch.chdir(folder)
    before = sorted(p.name for p in folder.iterdir())
    text = refused(capsys, 2, *arguments)
    command = " ".join(arguments[: 2 if arguments[0] == "experiment" else 1])
    assert f"(see: hexmap {command} --help)" in text
    assert sorted(p.name for p in folder.iterdir()) == before


@pytest.mark.parametrize(("metres", "word"), [(0.0001, "finer than a laser"), (5000, "larger than rooms")])
def test_cells_that_make_no_map_get_a_word(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], metres: float, word: str
) -> None:
    capsys.readouterr()
    gone = folder / "gone.tum"  # said before anything is read
    assert call("build", folder / "a.clf", "-o", tmp_path / "m.parquet", "--resolution", metres, "--poses", gone) == 1
    assert f"warning: cells of {metres:g} m are {word}" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (("--levels", "many"), "--levels takes a whole number, not 'many'"),
        (("--resolution=fine",), "--resolution takes a number, not 'fine'"),
        (("--trajectory-of", "foo"), "'foo' is not one of 'all', 'scans'"),
    ],
)
def test_what_the_parser_says_is_plain(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option: tuple[str, ...], words: str
) -> None:
    text = refused(capsys, 2, "build", folder / "a.clf", "-o", tmp_path / "m.parquet", *option)
    assert words in text
    assert not any(jargon in text for jargon in ("parse", "Input should", "Value error"))


def test_an_error_that_was_asked_for_and_said_is_no_failure(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("evaluate", folder / "a.tum", "--reference", folder / "a.tum", "--step", 1000) == 0
    out, err = capsys.readouterr()
    assert "absolute error" in out and err.startswith("warning: no relative error: ")


def test_plan_and_benchmark_name_the_same_maps(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import gzip

    walls = "".join(f"4 {y} {z}\n" for y in range(8) for z in range(6) if z < 4)
    (tmp_path / "rooms.3dmap.gz").write_bytes(gzip.compress(f"voxel 9 8 6\n{walls}".encode()))
    ends = ("--from", 1, 1, 1, "--to", 7, 1, 1, "--lattice", "Z3")
    assert call("plan", tmp_path / "rooms.3dmap", *ends) == 0 == call("plan", tmp_path / "rooms.3dmap.gz", *ends)
    text = refused(capsys, 1, "benchmark", "planning", folder / "a.parquet", "-o", tmp_path / "report")
    assert "a map of hexmap is on one lattice already; hexmap export" in text and not (tmp_path / "report").exists()


@pytest.mark.parametrize("lattice", ["Z2", "A2"])
def test_a_map_of_ones_own_is_planned_in_on_another_lattice(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], lattice: str
) -> None:
    csv = tmp_path / "p.csv"
    way = ("plan", folder / "a.parquet", "--from", 0, 0, "--to", 1, 0.5, "-o", csv, "--unknown", "free")
    assert call(*way, "--lattice", lattice, "--resolution", 0.025) == 0
    assert f"{'square' if lattice == 'Z2' else 'hexagonal'} lattice at 0.025 m on hexagonal cells of 0.05 m" in (
        capsys.readouterr().out
    )
    from planners.path_files import read_path

    assert read_path(csv).points[[0, -1]].tolist() == [[0.0, 0.0], [1.0, 0.5]]
    occupied = load_map(folder / "a.parquet").state().occupied
    assert not occupied.contains(occupied.lattice.quantise(read_path(csv).points)).any()


@pytest.mark.parametrize(
    "option", [("--trajectory", "a.tum"), ("--level", "1"), ("--min-hits", "2"), ("--min-ratio", "0.5")], ids=" ".join
)
def test_options_of_maps_do_not_apply_to_points(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, option: tuple[str, str]
) -> None:
    monkeypatch.chdir(folder)
    assert f"leave out {option[0]}" in refused(capsys, 2, "show", "cube.xyz", "-o", "o.png", "--volume", "0.1", *option)


@pytest.mark.parametrize(
    "option",
    [("--units", "mm"), ("--sample", "9"), ("--seed", "1"), ("--unique",), ("--max-range", "3"),
     ("--view", "0", "90"), ("--cut-above", "1")],
    ids=" ".join,
)  # fmt: skip
def test_options_of_points_or_of_space_do_not_apply_to_a_flat_map(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, option: tuple[str, ...]
) -> None:
    monkeypatch.chdir(folder)
    assert f"leave out {option[0]}" in refused(capsys, 2, "show", "a.parquet", "-o", "o.png", *option)
    assert not (folder / "o.png").exists()


# ---------------------------------------------------------------------- odd names and values


def one_cell() -> Map:
    squares = Lattice.named("Z2", 0.1)
    cells = VoxelList.from_cells([[0, 0]], squares)
    return Map([Level(cells, cells.shift([3, 1]))])


@pytest.mark.parametrize("name", ["a\tb", "a\nb", "a\u2028b", "a\x1b[31mb", 'a"b\\c', "käfer", "\U0001f600", "- a: b"])
def test_a_map_of_any_name_is_read_back_or_refused(tmp_path: Path, name: str) -> None:
    paths = export(one_cell(), tmp_path / f"{name}.yaml")
    assert all(path.exists() for path in paths)
    text = paths[0].read_text(encoding="utf-8")
    assert text.replace("\n", "").isprintable()
    try:
        assert open_grid(paths[0]).states.shape == (4, 2)
    except FormatError as error:
        assert str(error).isprintable()


def test_a_name_that_is_no_utf_8_leaves_no_orphan(tmp_path: Path) -> None:
    with pytest.raises(FileAccessError, match="not UTF-8"):
        export(one_cell(), os.fsdecode(bytes(tmp_path) + b"/\xff.yaml"))
    assert list(tmp_path.iterdir()) == []


def test_export_of_two_files_is_both_or_none(tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text("old")
    (tmp_path / "m.pgm").mkdir()
    with pytest.raises(FileAccessError):
        export(one_cell(), tmp_path / "m.yaml")
    assert (tmp_path / "m.yaml").read_text() == "old"
    (tmp_path / "m.pgm").rmdir()
    (tmp_path / "m.pgm").write_text("old")
    (tmp_path / "m.yaml").unlink()
    (tmp_path / "m.yaml").mkdir()
    with pytest.raises(FileAccessError):
        export(one_cell(), tmp_path / "m.yaml")
    assert (tmp_path / "m.pgm").read_text() == "old"


def test_names_are_printed_without_control_characters(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = "a\x1b[31mred\u2028\udcff.parquet"
    assert "\\x1b[31mred\\u2028\\udcff" in refused(capsys, 1, "info", tmp_path / name)
    save_map(tmp_path / name, one_cell())
    assert call("info", tmp_path / name) == 0
    assert capsys.readouterr().out.replace("\n", "").isprintable()


def test_no_folder_is_said_of_one_that_is_there(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = refused(capsys, 1, "merge", folder / "a.parquet", folder / "a.parquet", "--again", "-o", "/proc/x.parquet")
    assert "there is no folder" not in text and "/proc/x.parquet: cannot be written" in text


def test_text_that_a_spreadsheet_would_run_is_quoted(tmp_path: Path) -> None:
    report = Report("r")
    formulas = ("=cmd|' /C calc'!A0", "+HYPERLINK(1)", "-cmd|' /C calc'!A0", "@SUM(1)")
    rows = [{"=1+1": text, "n": -1.5} for text in (*formulas, "D3*", "a=b")]
    report.table("t", rows)
    report.write(tmp_path)
    lines = (tmp_path / "t.csv").read_text().splitlines()
    assert not any(line.lstrip('"').startswith(("=", "+", "-", "@")) for line in lines)
    assert lines[0].startswith("'=1+1") and lines[5] == "D3*,-1.5" and lines[6] == "a=b,-1.5"


def double(case: dict[str, object], rng: object, shared: object) -> dict[str, object]:
    return {"twice": 2 * int(case["n"])}  # type: ignore[call-overload]


@pytest.mark.parametrize(
    "change",
    [
        lambda line: line.replace(b'"twice":2', b'"other":2'),
        lambda line: line.replace(b'"twice":2', b'"twice":3'),
        lambda line: line.replace(b'"result"', b'"resolt"'),
        lambda line: b"[" * 20_000,
        lambda line: b"9" * 5_000,
    ],
)
def test_a_journal_line_that_was_changed_costs_its_case_again(tmp_path: Path, change: object) -> None:
    cases = [{"n": 1}, {"n": 2}]
    expected = run_cases(double, cases, folder=tmp_path)
    (journal,) = tmp_path.glob("cases-*.jsonl")
    head, first, second = journal.read_bytes().splitlines()
    journal.write_bytes(b"\n".join([head, change(first), second, b""]))  # type: ignore[operator]
    assert run_cases(double, cases, folder=tmp_path) == expected == [{"twice": 2}, {"twice": 4}]


@pytest.mark.parametrize("resolution", [10**4000, 10**400, -(10**400), 1e308])
def test_a_resolution_of_thousands_of_digits_is_damage(tmp_path: Path, resolution: float) -> None:
    import pyarrow.parquet as pq

    save_map(tmp_path / "m.parquet", one_cell())
    table = pq.read_table(tmp_path / "m.parquet")
    header = json.loads(table.schema.metadata[b"hexmap"])
    del header["crc32"]
    for change in ({"resolution": resolution}, {"lattice": {"basis": [[resolution, 0], [0, resolution]]}}):
        text = json.dumps({**header, **change})
        pq.write_table(table.replace_schema_metadata({b"hexmap": text.encode()}), tmp_path / "n.parquet")
        with pytest.raises(FormatError, match="damaged map"):
            load_map(tmp_path / "n.parquet")


def test_values_far_beyond_all_maps_are_errors_of_ours(tmp_path: Path) -> None:
    cells = one_cell().levels[0].hits
    with pytest.raises(HexmapError):
        LocalMatcher().match([[1e300, 0.0]], Pose.identity(2), coincidence(cells))
    with pytest.raises(FileAccessError):
        load_map("a\0b")


# ---------------------------------------------------------------------- surroundings


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signal here")
def test_a_terminal_that_goes_away_leaves_nothing(folder: Path, tmp_path: Path) -> None:
    log = folder / "long.clf"
    assert call("simulate", "office", "-o", log) == 0
    out = tmp_path / "m.parquet"
    arguments = ["build", str(log), "-o", str(out), "--trajectory", str(tmp_path / "t.tum"), "--resolution", "0.02"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hexmap", *arguments, "--no-loop-closure"], stderr=subprocess.PIPE, text=True
    )
    wait_until(lambda: any(tmp_path.iterdir()))
    process.send_signal(signal.SIGHUP)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGHUP and err.strip() == (
        "hexmap: stopped; what was not yet announced as written is as it was"
    )
    assert list(tmp_path.iterdir()) == []


def test_without_a_place_for_compiled_kernels_it_runs_and_says_so(tmp_path: Path) -> None:
    here = Path(__file__).parents[2]
    copy = tmp_path / "code"
    shutil.copytree(here / "hexmap", copy / "hexmap", ignore=shutil.ignore_patterns("__pycache__"))
    # A file where the folder should be stops everybody, the superuser, too.
    (copy / "hexmap" / "lattice" / "__pycache__").write_text("")
    (tmp_path / "home").write_text("")
    (tmp_path / "tmp").mkdir()
    environment = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    environment |= {
        "PYTHONPATH": str(copy), "HOME": str(tmp_path / "home"), "PYTHONDONTWRITEBYTECODE": "1",
        "TMPDIR": str(tmp_path / "tmp"),
    }  # fmt: skip
    code = "from hexmap import Lattice; print(Lattice.named('Z2').quantise([[0.6, 0.2]]).tolist())"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False, env=environment,
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0 and done.stdout == "[[1, 0]]\n", done.stderr
    assert done.stderr.startswith("warning: there is no folder to keep compiled kernels in") and (
        done.stderr.count("\n") == 1
    )
    assert list((tmp_path / "tmp").iterdir()) == []


def test_ctrl_c_within_the_compiler_of_kernels_comes_a_moment_later(monkeypatch: pytest.MonkeyPatch) -> None:
    after: list[int] = []
    words = "signal.raise_signal(signal.SIGINT); after.append(1)"
    called = compile(words, f"{os.sep}llvmlite{os.sep}binding.py", "exec")

    def run(arguments: list[str]) -> int:
        exec(called, {"signal": signal, "after": after})
        time.sleep(20.0)
        return 0

    monkeypatch.setattr("hexmap.cli.commands.run", run)
    # What is raised in a call from C would be dropped, and the command would go on.
    assert call("info") == 130 and after == [1]
