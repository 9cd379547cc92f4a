"""``hexmap localise`` as a user meets it: real files, exit codes, one line an error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hexmap.cli import main
from hexmap.io.trajectories import read_tum
from localisation.evaluation import absolute_error
from tests.lattices import JIT

pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The map of one drive through the room, fused at the true poses, and the log of another."""
    here = tmp_path_factory.mktemp("localise")
    assert call("simulate", "room", "-o", here / "a.clf", "--truth", here / "a.tum", "--seed", 7) == 0
    assert call("build", here / "a.clf", "-o", here / "a.parquet", "--poses", here / "a.tum") == 0
    assert call("simulate", "room", "-o", here / "b.clf", "--truth", here / "b.tum", "--seed", 8, "--duration", 20) == 0
    return here


def failure(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> str:
    capsys.readouterr()
    assert call(*arguments) == code
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("hexmap: ") and err.count("\n") == 1
    return err


def test_poses_table_and_picture(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses, table, picture = folder / "p.tum", folder / "p.csv", folder / "p.png"
    assert (
        call("localise", folder / "a.parquet", folder / "b.clf", "-o", poses, "--csv", table, "--picture", picture) == 0
    )
    out = capsys.readouterr().out
    assert "localised after" in out and "lost 0 times" in out and out.count("wrote ") == 3
    error = absolute_error(read_tum(folder / "b.tum"), read_tum(poses), "time")
    assert error.translation.max < 0.08
    lines = table.read_text().splitlines()
    header, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
    assert all(len(row) == len(header) for row in rows) and len(rows) == 101
    states = [row[header.index("state")] for row in rows]
    assert states[0] == "ambiguous" and states[-1] == "tracking" and states.count("tracking") == len(read_tum(poses))
    first = [float(v) for v in rows[-1][3:6]]
    assert np.allclose(first[:2], read_tum(poses).positions[-1, :2], atol=1e-5)
    assert picture.stat().st_size > 1000


def test_a_start_pose_and_a_map_of_others(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("export", folder / "a.parquet", "-o", folder / "a.yaml") == 0
    truth = read_tum(folder / "b.tum")[0]
    start = (truth.x, truth.y, np.degrees(truth.theta))
    poses = folder / "q.tum"
    assert call("localise", folder / "a.yaml", folder / "b.clf", "-o", poses, "--start", *start, "--no-odometry") == 0
    assert len(read_tum(poses)) == 101
    assert absolute_error(read_tum(folder / "b.tum"), read_tum(poses), "time").translation.mean < 0.1


def test_another_building_is_said_in_one_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, poses = folder / "castle.clf", folder / "castle.tum"
    assert call("simulate", "castle", "-o", log, "--duration", 4) == 0
    text = failure(capsys, 1, "localise", folder / "a.parquet", log, "-o", poses)
    assert "not in this map" in text and str(log) in text
    assert not poses.exists()


def test_wrong_use_is_said_before_the_work(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world, log, poses = folder / "a.parquet", folder / "b.clf", folder / "w.tum"
    assert "no folder" in failure(capsys, 1, "localise", world, log, "-o", folder / "none" / "p.tum")
    assert "overwrite" in failure(capsys, 1, "localise", world, log, "-o", log)
    assert "--lattice" in failure(capsys, 1, "localise", world, log, "-o", poses, "--lattice", "Z2")
    assert "cannot draw" in failure(capsys, 2, "localise", world, log, "-o", poses, "--picture", folder / "a.gif")
    for option, *values, what in (
        ("--time-limit", "-1", "time limit"), ("--time-limit", "nan", "time limit"),
        ("--search-metres", "-1", "search"),
        ("--search-degrees", "0", "search"), ("--max-range", "-3", "range"), ("--min-range", "inf", "min_range"),
        ("--start", "1", "nan", "0", "--start"), ("--mount", "0", "inf", "0", "--mount"), ("--level", "-1", "--level"),
        ("--resolution", "0", "--resolution"), ("--angle-step", "0", "angle_step"), ("--no-return", "-1", "no_return"),
        ("--laser", "left", "laser"),
    ):  # fmt: skip
        assert what in failure(capsys, 2, "localise", world, log, "-o", poses, option, *values)
    assert "output" in failure(capsys, 2, "localise", world, log)
    assert not poses.exists()
