"""The command line as a user meets it: real processes, real files, exit codes, one line an error."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hexmap.base.errors import FormatError
from hexmap.cli import main
from hexmap.io.map_file import load_map
from tests.observing import PATIENCE, wait_until


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a short simulated log, its truth and its map."""
    here = tmp_path_factory.mktemp("cli")
    assert (
        main(["simulate", "room", "-o", str(here / "room.clf.gz"), "--truth", str(here / "room.tum"), "--seed", "7"])
        == 0
    )
    assert (
        main(
            ["build", str(here / "room.clf.gz"), "-o", str(here / "room.parquet"), "--trajectory", str(here / "t.tum")]
        )
        == 0
    )
    return here


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


def failure(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 1) -> str:
    """Run a command that must fail with an exit code and one line on standard error; return the line."""
    capsys.readouterr()
    assert call(*arguments) == code, arguments
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("hexmap: ") and "Traceback" not in err
    return err


def test_the_whole_way_from_a_log_to_everything(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    m = folder / "room.parquet"
    for picture in ("a.png", "a.svg", "a.pdf"):
        assert call("show", m, "-o", folder / picture, "--level", 1, "--trajectory", folder / "t.tum") == 0
        assert (folder / picture).stat().st_size > 1000
    for name in ("a.yaml", "a.csv", "a.ply"):
        assert call("export", m, "-o", folder / name) == 0
        assert (folder / name).exists()
    assert (folder / "a.pgm").exists()
    assert call("merge", m, m, "--again", "-o", folder / "twice.parquet") == 0
    once, twice = load_map(m), load_map(folder / "twice.parquet")
    assert twice.levels[0].hits.total == 2 * once.levels[0].hits.total
    capsys.readouterr()
    assert call("evaluate", folder / "t.tum", "--reference", folder / "room.tum") == 0
    assert "absolute error" in capsys.readouterr().out
    assert call("info", m) == 0 and call("lattices") == 0
    assert "0.080188" in capsys.readouterr().out


def test_the_configuration_of_a_map_makes_the_same_map_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = folder / "room.clf.gz"
    first, again, third = folder / "c1.parquet", folder / "c2.parquet", folder / "c3.parquet"
    assert (
        call("build", log, "-o", first, "--lattice", "Z2", "--resolution", 0.08, "--levels", 2, "--max-range", 6) == 0
    )
    capsys.readouterr()
    assert call("info", first, "--config") == 0
    config = folder / "config.json"
    config.write_text(capsys.readouterr().out)
    assert json.loads(config.read_text())["lattice"] == "Z2"
    assert call("build", log, "-o", again, "--config", config) == 0
    assert call("build", log, "-o", third, "--config", first) == 0
    assert load_map(first) == load_map(again) == load_map(third)
    assert first.read_bytes() == again.read_bytes()


def test_given_poses_are_fused(folder: Path) -> None:
    out = folder / "given.parquet"
    assert (
        call("build", folder / "room.clf.gz", "-o", out, "--poses", folder / "room.tum", "--trajectory-of", "scans")
        == 0
    )
    assert load_map(out).sources()[0]["poses"] == "given"


def test_bad_input_is_one_line_and_loses_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, good = folder / "room.clf.gz", folder / "room.parquet"
    out = tmp_path / "out.parquet"
    out.write_bytes(b"an old map")
    png = tmp_path / "a.clf"
    png.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    empty = tmp_path / "empty.clf"
    empty.write_bytes(b"")
    bad = tmp_path / "bad.json"
    bad.write_text('{"lattice": "A2",\n "resolution": }')
    typo = tmp_path / "typo.json"
    typo.write_text('{"resolutoin": 1}')
    cases = [
        (("build", tmp_path / "no.clf", "-o", out), "no.clf"),
        (("build", png, "-o", out), "PNG"),
        (("build", empty, "-o", out), "empty"),
        (("build", log, "-o", out, "--lattice", "D3"), "planar"),
        (("build", log, "-o", out, "--lattice", "hexagone"), "hexagone"),
        (("build", log, "-o", out, "--resolution", "-1"), "-1"),
        (("build", log, "-o", out, "--levels", "0"), "0"),
        (("build", log, "-o", tmp_path / "no" / "m.parquet"), "folder"),
        (("build", log, "-o", log), "overwrite"),
        (("build", log, "-o", out, "--trajectory", out), "same file"),
        (("build", log, "-o", out, "--picture", tmp_path / "a.bmp"), "bmp"),
        (("build", log, "-o", out, "--config", bad), "line 2"),
        (("build", log, "-o", out, "--config", typo), "resolutoin"),
        (("build", log, "-o", out, "--poses", log), "room.clf.gz"),
        (("build", log, "-o", out, "--min-range", "5", "--max-range", "3"), "maximum"),
        (("show", png, "-o", tmp_path / "b.png"), "a.clf"),
        (("show", good, "-o", tmp_path / "b.png", "--level", "7"), "7"),
        (("show", good, "-o", tmp_path / "b.gif"), "gif"),
        (("info", tmp_path / "no.parquet"), "no.parquet"),
        (("export", good, "-o", tmp_path / "b.obj"), "obj"),
        (("merge", good, "-o", out), "two"),
        (("simulate", "moon", "-o", tmp_path / "m.clf"), "office"),
        (("evaluate", folder / "t.tum"), "--relations"),
        (("evaluate", good, "--reference", folder / "room.tum"), "room.parquet"),
    ]
    # Wrong values of options are wrong usage, whichever layer refuses them.
    wrong = {"planar", "hexagone", "-1", "0", "bmp", "maximum", "7", "gif", "obj", "two", "office", "--relations"}
    for arguments, word in cases:
        assert word in failure(capsys, *arguments, code=2 if word in wrong else 1), arguments
        assert out.read_bytes() == b"an old map"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.clf", "bad.json", "empty.clf", "out.parquet", "typo.json"]


@pytest.mark.parametrize(
    "arguments", [["fly"], ["build"], ["build", "a", "--levels", "many", "-o", "b"], ["show", "a"]]
)
def test_wrong_usage_is_exit_code_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert call(*arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_maps_on_different_lattices_do_not_merge(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = folder / "other.parquet"
    assert call("build", folder / "room.clf.gz", "-o", other, "--lattice", "Z2", "--poses", folder / "room.tum") == 0
    text = failure(capsys, "merge", folder / "room.parquet", other, "-o", folder / "no.parquet")
    assert "other.parquet" in text and not (folder / "no.parquet").exists()


def test_a_truncated_log_is_mapped_as_far_as_it_goes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.clf.gz"
    whole = (folder / "room.clf.gz").read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    capsys.readouterr()
    assert call("build", cut, "-o", tmp_path / "cut.parquet") == 0
    err = capsys.readouterr().err
    assert err.startswith("warning: ") and "cut.clf.gz" in err
    assert len(load_map(tmp_path / "cut.parquet").levels[0].hits) > 100


def run_process(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "hexmap", *map(str, arguments)], capture_output=True, text=True, timeout=120, check=False
    )


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from hexmap.cli import main; main(['--help']); "
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'pyarrow', 'rosbags', 'rich'} & set(sys.modules); "
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert "build" in done.stdout and "evaluate" in done.stdout
    commands = done.stdout.partition("Commands:")[2]
    assert commands and "..." not in commands  # every line is whole


@pytest.mark.parametrize(
    ("command", "usage"),
    [("build", "LOG..."), ("evaluate", "TRAJECTORY..."), ("merge", "MAPS..."), ("plan", "MAP"), ("info", "MAP")],
)
def test_usage_names_arguments_plainly(command: str, usage: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(command, "--help") == 0
    assert capsys.readouterr().out.splitlines()[0] == f"Usage: hexmap {command} [OPTIONS] {usage}"


def test_lattices_of_ones_own_stand_in_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert call("lattices", "--basis", "2,0;1,1.7320508075688772") == 0
    rows = {line.split()[0]: line for line in capsys.readouterr().out.splitlines()[:9] if line.split()}
    own, hexagonal = rows["own"].split(), rows["A2"].split()
    assert own[-9:] == hexagonal[-9:]  # hexagons by another name


def test_a_map_of_others_is_read_by_another_function(tmp_path: Path) -> None:
    (tmp_path / "office.yaml").write_text("image: office.pgm\n")
    with pytest.raises(FormatError, match=r"office\.yaml: .*open_grid"):
        load_map(tmp_path / "office.yaml")


def test_the_program_runs_as_a_module_and_says_its_version() -> None:
    done = run_process("--version")
    assert done.returncode == 0 and done.stdout.startswith("hexmap ")


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_stops_and_leaves_no_half_written_file(tmp_path: Path) -> None:
    assert call("simulate", "office", "-o", tmp_path / "office.clf") == 0
    old = tmp_path / "m.parquet"
    old.write_bytes(b"an old map")
    process = subprocess.Popen(
        [sys.executable, "-m", "hexmap", "build", str(tmp_path / "office.clf"), "-o", str(old),
         "--trajectory", str(tmp_path / "t.tum")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    # Poses arrive in the trajectory's temporary file when all kernels have been loaded, which an interrupt would spoil.
    wait_until(lambda: any(file.stat().st_size for file in tmp_path.glob(".t.*")))
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130, err
    assert err.strip().count("\n") == 0 and "stopped" in err and out == ""
    assert sorted(p.name for p in tmp_path.iterdir()) == ["m.parquet", "office.clf"]
    assert old.read_bytes() == b"an old map"


def test_what_a_reviewer_broke_stays_mended(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = folder / "room.clf.gz", tmp_path / "out.parquet"
    for text in ('{"levels": 2.5}', '{"levels": null}', '{"min_range": "a"}', '{"rule": 5}', '{"use_odometry": "no"}',
                 '{"log": {"foo": 1}}', '{"lattice": [[1, 0], [0, 1e-7]]}', "[" * 100_000, "[1]"):  # fmt: skip
        config = tmp_path / "c.json"
        config.write_text(text)
        assert "c.json" in failure(capsys, "build", log, "-o", out, "--config", config)
    # a saved configuration names the level that was searched on; fewer levels must still work
    assert call("build", log, "-o", out, "--config", folder / "room.parquet", "--levels", 1) == 0
    assert call("build", log, "-o", out, "--poses", folder / "room.tum", "--trajectory", tmp_path / "t.tum") == 0
    assert len((tmp_path / "t.tum").read_text().splitlines()) == len((folder / "room.tum").read_text().splitlines())
    capsys.readouterr()
    assert call("evaluate", folder / "t.tum", "--reference", folder / "t.tum") == 0
    assert "mean 0.0000" in capsys.readouterr().out
    disguised = tmp_path / "m.pgm"
    disguised.write_bytes((folder / "room.parquet").read_bytes())
    assert "overwrite" in failure(capsys, "export", disguised, "-o", tmp_path / "m.yaml")
    space = tmp_path / "space.tum"
    space.write_text("0.0 0 0 1.5 0 0 0 1\n")
    assert "space.tum" in failure(capsys, "build", log, "-o", out, "--poses", space)
    assert "1 to 16" in failure(capsys, "build", log, "-o", out, "--levels", 0, code=2)
    assert call() == 2
    assert capsys.readouterr().err.count("\n") > 5  # the help, readable


def test_a_damaged_odometry_value_or_range_costs_little(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("simulate", "room", "-o", tmp_path / "a.clf", "--duration", 8) == 0
    lines = (tmp_path / "a.clf").read_text().splitlines()
    scans = [k for k, line in enumerate(lines) if line.startswith("FLASER")]
    for value, part in (("1e9", -9), ("1e300", -6), ("1e7", 30)):
        fields = lines[scans[20]].split()
        fields[part] = value
        if part == -9:
            fields[-6] = value
        bad = tmp_path / "bad.clf"
        bad.write_text("\n".join([*lines[: scans[20]], " ".join(fields), *lines[scans[20] + 1 :]]) + "\n")
        capsys.readouterr()
        arguments = ["build", bad, "-o", tmp_path / "m.parquet"] + (["--no-return", "inf"] if part == 30 else [])
        assert call(*arguments) == 0
        _, err = capsys.readouterr()
        assert err.startswith("warning: ") and "bad.clf" in err
        assert len(load_map(tmp_path / "m.parquet").levels[0].hits) > 300
        low, high = load_map(tmp_path / "m.parquet").bounds()
        # with --no-return inf the laser's 81.83 m are points, too
        assert (high - low).max() < (200.0 if part == 30 else 20.0)
    capsys.readouterr()
    assert call("build", tmp_path / "a.clf", "-o", tmp_path / "n.parquet", "--resolution", "1e-5") == 1
    warning, text, end = capsys.readouterr().err.split("\n")
    assert warning.startswith("warning: cells of 1e-05 m are finer than a laser measures")
    assert "no scan can be used, line" in text and "coarser" in text and not end


def test_a_reader_that_leaves_is_no_error(folder: Path) -> None:
    command = f'"{sys.executable}" -m hexmap info "{folder / "room.parquet"}" | true; exit ${{PIPESTATUS[0]}}'
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and done.stderr == ""
    closed = f'"{sys.executable}" -m hexmap lattices >&-'
    assert subprocess.run(["bash", "-c", closed], capture_output=True, timeout=60, check=False).returncode == 0
