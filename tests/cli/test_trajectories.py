"""The commands ``hexmap evaluate`` and ``hexmap convert`` as a user meets them, and the files they write."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from hexmap.cli import main
from hexmap.drawing.track_drawing import Track, draw_tracks
from hexmap.io.trajectories import read_trajectory, read_tum, write_kitti, write_tum
from hexmap.poses.pose import Pose
from hexmap.poses.trajectory import Trajectory
from localisation.evaluation import absolute_error


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive, two estimates of it in other frames, and one with the odometry's poses in between."""
    here = tmp_path_factory.mktemp("trajectories")
    k = np.arange(60)
    true = [Pose.planar(5 * math.cos(0.1 * i), 3 * math.sin(0.1 * i), 0.1 * i) for i in k]
    rng = np.random.default_rng(1)
    write_tum(here / "true.tum", Trajectory.from_poses(10.0 + k, true))
    for name, sigma, T in (("good", 0.01, Pose.planar(3, 2, 1.0)), ("bad", 0.3, Pose.planar(-3, 1, 2.0))):
        noisy = [T @ p @ Pose.planar(*rng.normal(0.0, sigma, 2), 0.0) for p in true]
        write_tum(here / f"{name}.tum", Trajectory.from_poses(10.0 + k, noisy))
    every = [10.0 + i + d for i in k for d in (0.0, 0.5)]
    write_tum(here / "all.tum", Trajectory.from_poses(every, [p for p in true for _ in range(2)]))
    write_tum(here / "later.tum", Trajectory.from_poses(9000.0 + k, true))
    return here


@pytest.mark.parametrize("with_option", [False, True])
def test_several_trajectories_stand_side_by_side(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], with_option: bool
) -> None:
    files = [tmp_path / name for name in ("e.csv", "e.json", "e.png")]
    outputs = ("--csv", files[0], "--json", files[1], "--picture", files[2])
    good, bad = folder / "good.tum", folder / "bad.tum"
    reference = (good, bad, "--reference", folder / "true.tum") if with_option else (folder / "true.tum", good, bad)
    assert call("evaluate", *reference, *outputs) == 0
    out = capsys.readouterr().out
    truth = read_tum(folder / "true.tum")
    scores = {name: absolute_error(truth, read_tum(folder / f"{name}.tum")) for name in ("good", "bad")}
    for name, score in scores.items():
        t = score.translation
        line = next(line for line in out.splitlines() if line.startswith(f"  {name}.tum"))
        assert line.split()[1:7] == ["60", "0", *(f"{v:.4f}" for v in (t.mean, t.rmse, t.median, t.max))]
    assert "relative error over 1 m" in out and all(f"wrote {file}" in out for file in files)
    with open(files[0], newline="") as handle:
        rows = list(csv.DictReader(handle))
    assert [row["trajectory"] for row in rows] == ["good.tum"] * 60 + ["bad.tum"] * 60
    assert [float(row["stamp"]) for row in rows[:60]] == truth.stamps.tolist()
    whole = json.loads(files[1].read_text())
    for k, name in enumerate(("good", "bad")):
        errors = [float(row["error_m"]) for row in rows[60 * k : 60 * k + 60]]
        assert max(errors) == scores[name].translation.max
        # The file has them in the frame of the reference: errors can be made of it again.
        at = [[float(row[axis]) for axis in "xyz"] for row in rows[60 * k : 60 * k + 60]]
        assert np.linalg.norm(truth.positions - at, axis=1) == pytest.approx(errors, abs=1e-12)
        judged = whole["trajectories"][k]
        assert judged["file"] == f"{name}.tum" and judged["absolute"]["translation_m"]["rmse"] == pytest.approx(
            scores[name].translation.rmse
        )
        assert [pose["error_m"] for pose in judged["poses"]] == errors
    assert whole["reference"] == "true.tum" and whole["step_m"] == 1.0
    assert files[2].read_bytes().startswith(b"\x89PNG")
    before = [file.read_bytes() for file in files]
    assert call("evaluate", *reference, *outputs) == 0
    assert [file.read_bytes() for file in files] == before


def test_stamps_that_go_with_nothing_name_the_way_out(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def failure(*arguments: object) -> str:
        capsys.readouterr()
        assert call("evaluate", *arguments) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1
        return err

    true = folder / "true.tum"
    text = failure(folder / "later.tum", "--reference", true)
    assert "later.tum" in text and "--associate order" in text and "--trajectory-of scans" in text
    assert call("evaluate", folder / "later.tum", "--reference", true, "--associate", "order") == 0
    text = failure(folder / "all.tum", "--reference", true, "--associate", "order")
    assert "60" in text and "120" in text and "--trajectory-of scans" in text


@pytest.mark.parametrize(
    ("stamps", "axis"),
    [
        (0.1 * (np.arange(20) // 2), [0.0, 0.9]),  # a scan and its odometry share a stamp
        (0.1 * (np.arange(20) // 4), [30.0, 49.0]),
        (0.1 * (np.arange(20)[::-1]), [30.0, 49.0]),
    ],
    ids=["pairs", "repeated", "backwards"],
)
def test_errors_stand_over_time_or_over_the_pose_of_the_reference(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stamps: np.ndarray, axis: list[float]
) -> None:
    seen: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *a, **k: seen.append(figure))
    at = np.column_stack([np.arange(20), np.zeros((20, 2))])
    track = Track("a", stamps, at, np.ones(20), np.arange(30, 50))
    draw_tracks(tmp_path / "t.png", at, [track])
    (line,) = seen[0].axes[1].get_lines()
    assert [line.get_xdata().min(), line.get_xdata().max()] == pytest.approx(axis)
    assert seen[0].axes[1].get_xlabel() == ("time, s" if axis[0] == 0.0 else "number of the reference's pose")


def test_the_table_says_how_much_of_the_time_is_covered(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    poses = read_tum(folder / "good.tum")
    write_tum(tmp_path / "half.tum", Trajectory(poses.stamps[:31], poses.positions[:31], poses.quaternions[:31]))
    assert call("evaluate", folder / "true.tum", folder / "good.tum", tmp_path / "half.tum") == 0
    lines = capsys.readouterr().out.splitlines()
    shares = [line.split()[-1] for line in lines if line.startswith(("  good", "  half")) and line.endswith("%")]
    assert shares == ["100.0%", "50.8%"]


def test_few_partners_are_said(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = read_tum(folder / "good.tum")
    write_tum(tmp_path / "apart.tum", Trajectory(poses.stamps + 50.0, poses.positions, poses.quaternions))
    assert call("evaluate", tmp_path / "apart.tum", "--reference", folder / "true.tum") == 0
    err = capsys.readouterr().err
    assert "50 poses have no partner" in err and "--associate order" in err and "--trajectory-of scans" in err


def test_wrong_usage_of_evaluate(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    true = folder / "true.tum"
    relations = tmp_path / "r.relations"
    relations.write_text("10 11 0 0 0 0 0 0\n")
    for arguments, word in [
        ((true,), "--reference"),
        ((true, "--relations", relations, "--csv", tmp_path / "a.csv"), "--csv"),
        ((true, "--relations", relations, "--picture", tmp_path / "a.png"), "--picture"),
        ((true, true, "--picture", tmp_path / "a.xyz"), ".xyz"),
    ]:
        capsys.readouterr()
        assert call("evaluate", *arguments) == 2
        assert word in capsys.readouterr().err
    assert call("evaluate", true, folder / "good.tum", "--relations", relations, "--json", tmp_path / "a.json") == 0
    assert len(json.loads((tmp_path / "a.json").read_text())["trajectories"]) == 2


def test_poses_of_kitti_there_and_back(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kitti, times, back = tmp_path / "p.kitti", tmp_path / "times.txt", tmp_path / "b.txt"
    assert call("convert", folder / "good.tum", "-o", kitti, "--write-times", times) == 0
    assert call("convert", kitti, "--times", times, "-o", back, "--to", "tum") == 0
    was, now = read_tum(folder / "good.tum"), read_tum(back)
    assert np.array_equal(was.stamps, now.stamps)
    assert all(a.is_close(b, 1e-8, 1e-8) for a, b in zip(was, now, strict=True))
    assert call("convert", kitti, "-o", tmp_path / "c.tum") == 0
    assert "--times" in capsys.readouterr().out  # stamps count the poses, which is said
    assert read_tum(tmp_path / "c.tum").stamps.tolist() == list(range(60))
    tumbled = Trajectory.from_poses([0.5, 1.5], [Pose.from_quaternion([1, 2, 3], [0.5, 0.5, 0.5, 0.5])] * 2)
    write_kitti(kitti, tumbled)
    assert read_trajectory(kitti)[1].is_close(tumbled[1], 1e-12, 1e-12)


def test_poses_of_euroc_become_tum(tmp_path: Path) -> None:
    (tmp_path / "data.csv").write_text("#timestamp,x,y,z,qw,qx,qy,qz\n1500000000,1,2,0,1,0,0,0\n")
    assert call("convert", tmp_path / "data.csv", "-o", tmp_path / "p.tum") == 0
    assert (tmp_path / "p.tum").read_text().split()[:3] == ["1.500000", "1.000000000", "2.000000000"]


def test_what_convert_refuses(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    times, kitti = tmp_path / "t.txt", tmp_path / "p.kitti"
    times.write_text("1\n2\n")
    write_kitti(kitti, read_tum(folder / "true.tum"))
    for arguments, code, word in [
        ((kitti, "-o", tmp_path / "p.txt"), 2, "--to"),
        ((folder / "true.tum", "-o", tmp_path / "p.tum", "--write-times", tmp_path / "w"), 2, "--write-times"),
        ((kitti, "-o", tmp_path / "p.tum", "--times", times), 1, "2 stamps do not fit the 60 poses"),
        ((folder / "true.tum", "-o", tmp_path / "p.kitti", "--times", times), 1, "stamps of their own"),
        ((kitti, "-o", kitti), 1, "would overwrite"),
    ]:
        capsys.readouterr()
        assert call("convert", *arguments) == code
        assert word in capsys.readouterr().err
    assert not (tmp_path / "p.tum").exists()


def test_a_file_of_another_kind_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "m.parquet").write_bytes(b"PAR1\x15\x04")
    assert main(["convert", str(tmp_path / "m.parquet"), "-o", str(tmp_path / "x.tum")]) == 1
    assert capsys.readouterr().err.endswith("m.parquet: this is a Parquet file, not a trajectory\n")
    assert not (tmp_path / "x.tum").exists()
