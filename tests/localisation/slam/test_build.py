"""Loop closure on the command line: files, reasons, and what is said where it cannot be done."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from hexmap.cli import main
from hexmap.io.map_file import load_map
from hexmap.io.trajectories import read_tum
from hexmap.simulator.laser import Laser
from hexmap.simulator.writer import write_log
from tests.lattices import JIT
from tests.localisation.slam.buildings import BAD, ring

pytestmark = pytest.mark.skipif(not JIT, reason="takes hours without the compiler")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ring") / "ring.clf"
    laser = Laser(beams=121, rate=2.0, max_range=15.0)
    write_log(path, ring(), laser=laser, odometry=BAD, seed=3)
    return path


def test_everything_that_is_asked_for_is_written(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = {name: tmp_path / name for name in ("m.parquet", "t.tum", "l.csv", "g.g2o", "c.csv", "l.png")}
    assert main([
        "build", str(log), "-o", str(out["m.parquet"]), "--trajectory", str(out["t.tum"]), "--loops", str(out["l.csv"]),
        "--graph", str(out["g.g2o"]), "--covariance", str(out["c.csv"]), "--loops-picture", str(out["l.png"]),
    ]) == 0  # fmt: skip
    text = capsys.readouterr().out
    assert "loops tried: " in text and " closed, " in text
    assert all(path.stat().st_size > 0 for path in out.values())
    with out["l.csv"].open() as handle:
        loops = list(csv.DictReader(handle))
    accepted = [row for row in loops if row["accepted"] == "1"]
    assert accepted and all(row["reason"] == "accepted" and row["gap"] == "0" for row in accepted)
    assert all(row["reason"] not in ("", "accepted", "waiting") for row in loops if row["accepted"] == "0")
    with out["c.csv"].open() as handle:
        sure = list(csv.DictReader(handle))
    poses = read_tum(out["t.tum"])
    assert len(sure) == len(poses)
    assert float(sure[-1]["x"]) == pytest.approx(float(poses.positions[-1, 0]), abs=1e-6)
    assert float(sure[-1]["xx"]) > 0.0 and float(sure[-1]["tt"]) > 0.0
    # The map is that of all scans at the poses that were written.
    again = tmp_path / "again.parquet"
    assert main(["build", str(log), "-o", str(again), "--poses", str(out["t.tum"])]) == 0
    first, second = load_map(out["m.parquet"]).levels[0], load_map(again).levels[0]
    assert first.hits.count_coincident(second.hits) > 0.99 * len(first.hits)


def test_loop_closure_can_be_left_out(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = tmp_path / "plain.parquet"
    assert main(["build", str(log), "-o", str(plain), "--no-loop-closure"]) == 0
    assert "loops tried" not in capsys.readouterr().out
    assert load_map(plain).sources()[0]["poses"] == "scan matching"
    assert main(["build", str(log), "-o", str(plain), "--no-loop-closure", "--loops", str(tmp_path / "l.csv")]) == 2
    assert "--no-loop-closure closes none" in capsys.readouterr().err


def test_without_gtsam_one_line_says_so(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "gtsam", None)
    assert main(["build", str(log), "-o", str(tmp_path / "m.parquet")]) == 1
    error = capsys.readouterr().err
    assert "gtsam" in error and "--no-loop-closure" in error and error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
