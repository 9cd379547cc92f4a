"""hexmap simulate: the two kinds of buildings and their options."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from hexmap.cli import main
from hexmap.io.trajectories import read_tum


def call(*arguments: object) -> int:
    return main(["simulate", *[str(a) for a in arguments]])


def test_a_lidar_on_several_floors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, truth = tmp_path / "run", tmp_path / "run.tum"
    options = ("--rings", 8, "--azimuths", 64, "--noise", 0.01, "--missing", 0.1, "--people", 2, "--seed", 7)
    assert call("warehouse3d", "-o", f"{bag}/", "--truth", truth, "--scans", 5, *options) == 0
    out = capsys.readouterr().out
    assert "5 scans" in out and str(truth) in out
    assert sorted(p.name for p in bag.iterdir()) == ["metadata.yaml", "run.mcap"]
    poses = read_tum(truth)
    assert len(poses) == 5 and poses[0].dim == 3
    np.testing.assert_allclose(poses.stamps, 0.1 + 0.2 * np.arange(5))
    # The same once more, over the old one.
    before = (bag / "run.mcap").read_bytes(), truth.read_bytes()
    assert call("warehouse3d", "-o", bag, "--truth", truth, "--duration", 1.0, *options) == 0
    assert ((bag / "run.mcap").read_bytes(), truth.read_bytes()) == before


def test_noise_and_missing_returns_of_a_planar_laser(tmp_path: Path) -> None:
    log = tmp_path / "room.clf"
    assert call("room", "-o", log, "--duration", 4, "--beams", 91, "--missing", 1.0, "--noise", 0) == 0
    scans = [line.split() for line in log.read_text().splitlines() if line.startswith("FLASER")]
    assert scans and all(set(words[2:93]) == {"81.83"} for words in scans)
    assert math.isclose(float(scans[0][1]), 91)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("moon",), 2, "known are office, castle, room, warehouse3d"),
        (("room", "--rings", 8), 2, "--rings: not with room, only with a LiDAR"),
        (("warehouse3d", "--beams", 8), 2, "--beams: not with warehouse3d, only with a laser"),
        (("warehouse3d", "--rings", 0), 2, "1 to 65535 rings, not 0"),
        (("warehouse3d", "--noise", "nan"), 2, "noise"),
        (("warehouse3d", "--missing", 2), 2, "missing return must be within 0 and 1, not 2.0"),
        (("warehouse3d", "--people", -1), 2, "number of people must be zero or more, not -1"),
        (("warehouse3d", "--scans", 0), 2, "at least one scan, not 0"),
        (("warehouse3d", "--duration", 0.01), 2, "shorter than one sweep"),
        (("warehouse3d", "--seed", -1), 2, "seed"),
    ],
)
def test_wrong_inputs_are_one_line_and_leave_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[object, ...], code: int, words: str
) -> None:
    assert call(*arguments, "-o", tmp_path / "run") == code
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and words in err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_no_bag_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    assert call("warehouse3d", "-o", tmp_path, "--scans", 1) == 1
    assert "the folder holds something else, thesis.txt" in capsys.readouterr().err
    assert (tmp_path / "thesis.txt").read_text() == "mine"
