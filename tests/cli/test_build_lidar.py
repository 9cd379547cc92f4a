"""``hexmap build`` of LiDAR logs as a user meets it: a bag, a folder, every file asked for, one line an error."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from hexmap.cli import main
from hexmap.io.map_file import load_map
from hexmap.io.trajectories import read_tum
from hexmap.poses.pose import Pose
from hexmap.poses.trajectory import Trajectory
from localisation.evaluation import absolute_error
from tests.io.lidar.clouds import CloudBag, xyz
from tests.lattices import JIT

pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")
QUICK = ("--resolution", 0.2, "--levels", 2)
SCANS = 24


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag ``run``, its true poses ``run.tum``, and the same scans as a folder ``scans``."""
    from hexmap.io.lidar import open_lidar

    here = tmp_path_factory.mktemp("lidar")
    small = ("--rings", 16, "--azimuths", 360, "--scans", SCANS, "--seed", 3)
    assert call("simulate", "warehouse3d", "-o", here / "run", "--truth", here / "run.tum", *small) == 0
    (here / "scans").mkdir()
    for scan in open_lidar(here / "run"):
        np.save(here / "scans" / f"{1_700_000_000_000 + round(1000 * scan.stamp)}.npy", scan.points)
    return here


def failure(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> str:
    capsys.readouterr()
    assert call("build", *arguments) == code
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("hexmap: ") and err.count("\n") == 1
    return err


def test_a_bag_with_all_that_can_be_written(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names = {"-o": "m.parquet", "--trajectory": "m.tum", "--loops": "l.csv", "--graph": "g.g2o",
             "--covariance": "c.csv", "--picture": "m.png"}  # fmt: skip
    outputs = [item for option, name in names.items() for item in (option, tmp_path / name)]
    capsys.readouterr()
    assert call("build", run / "run", *outputs, *QUICK) == 0
    out, err = capsys.readouterr()
    assert all(f"wrote {tmp_path / name}" in out for name in names.values())
    assert f"{SCANS} scans" in out and "of a scan's points lie on surfaces" in out and "loops tried" in out
    assert "warning" not in err
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names.values())
    built = load_map(tmp_path / "m.parquet")
    assert built.lattice.name == "D3" and built.lattice.resolution == pytest.approx(0.2) and len(built.levels) == 2
    assert len(built.levels[0].hits) > 1000 and len(built.levels[0].passes) > 5000
    (source,) = built.sources()
    assert source["settings"]["resolution"] == 0.2 and source["settings"]["lattice"] == "D3"
    error = absolute_error(read_tum(run / "run.tum"), read_tum(tmp_path / "m.tum"), "order")
    assert error.translation.max < 0.1
    with (tmp_path / "l.csv").open() as handle:
        assert "old_node,new_node" in handle.readline() and not handle.read()
    assert "VERTEX_SE3:QUAT 0" in (tmp_path / "g.g2o").read_text()
    with (tmp_path / "c.csv").open() as handle:
        rows = list(csv.DictReader(handle))
    assert len(rows) == SCANS and {"stamp", "x", "qw", "x_x", "rz_rz"} <= set(rows[0])
    assert float(rows[0]["x_x"]) == 0.0 <= float(rows[-1]["x_x"])
    assert (tmp_path / "m.png").read_bytes()[:4] == b"\x89PNG"


def test_a_folder_with_settings_from_a_map(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = tmp_path / "a.parquet", tmp_path / "b.parquet"
    options = ("--lattice", "Z3", "--no-free-space", "--no-level", "--no-loop-closure", "--max-range", 30)
    assert call("build", run / "scans", "-o", first, "--trajectory", tmp_path / "a.tum", *QUICK, *options) == 0
    built = load_map(first)
    assert built.lattice.name == "Z3" and len(built.levels[0].passes) == 0
    assert read_tum(tmp_path / "a.tum").stamps[0] == pytest.approx(1_700_000_000.1)
    settings = built.sources()[0]["settings"]
    assert (settings["max_range"], settings["level_floor"], settings["free_space"]) == (30.0, False, False)
    assert call("build", run / "scans", "-o", second, "--config", first, "--no-loop-closure") == 0
    again = load_map(second)
    assert np.array_equal(again.levels[0].hits.index, built.levels[0].hits.index)
    values = tmp_path / "values.json"
    values.write_text(json.dumps({"resolution": 0.4, "levels": 1}))
    assert call("build", run / "scans", "-o", second, "--config", values, "--lattice", "D3*") == 0
    built = load_map(second)
    assert (built.lattice.name, len(built.levels)) == ("D3*", 1) and built.lattice.resolution == pytest.approx(0.4)
    values.write_text(json.dumps({"search_metres": 1.0}))
    assert "values.json: no setting of a map in space is called 'search_metres'" in failure(
        capsys, 1, run / "scans", "-o", second, "--config", values
    )


def test_given_poses_need_no_odometry(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "kiss_icp.kiss_icp", None)
    out = tmp_path / "m.parquet"
    err = failure(capsys, 1, run / "run", "-o", out)
    assert "needs the package kiss-icp" in err and "pip install 'hexmap[lidar]', or give --poses" in err
    assert not out.exists()
    assert call("build", run / "run", "-o", out, "--poses", run / "run.tum", *QUICK) == 0
    assert "given poses" in capsys.readouterr().out and len(load_map(out).levels[0].hits) > 1000
    # A folder's stamps are another clock's: by order they go together, by time they do not.
    assert call("build", run / "scans", "-o", out, "--poses", run / "run.tum", "--associate", "order", *QUICK) == 0
    assert "is within 0.1 s of one of" in failure(
        capsys, 1, run / "scans", "-o", out, "--poses", run / "run.tum", "--associate", "time"
    )
    lines = (run / "run.tum").read_text().splitlines(keepends=True)
    (tmp_path / "some.tum").write_text("".join(lines[:10]))
    assert call("build", run / "run", "-o", out, "--poses", tmp_path / "some.tum", *QUICK) == 0
    assert "14 scans without a pose left out" in capsys.readouterr().err
    assert "10 poses do not go by order with the 24 scans" in failure(
        capsys, 1, run / "run", "-o", out, "--poses", tmp_path / "some.tum", "--associate", "order"
    )


def test_a_folder_of_tiles_is_the_file_cut_into_tiles(run: Path, tmp_path: Path) -> None:
    given = ("--poses", run / "run.tum", *QUICK)
    assert call("build", run / "run", "-o", tmp_path / "m.parquet", *given) == 0
    assert call("merge", tmp_path / "m.parquet", "-o", tmp_path / "cut", "--tiles", 6) == 0
    assert call("build", run / "run", "-o", tmp_path / "tiles", "--tiles", 6, *given) == 0
    cut, tiles = ({p.name: p.read_bytes() for p in (tmp_path / name).iterdir()} for name in ("cut", "tiles"))
    assert cut == tiles and len(cut) > 2


@pytest.mark.parametrize(
    "options",
    [
        ("--clear-no-return", 5), ("--mount", 0, 0, 0),
        ("--search-metres", 1), ("--search-degrees", 1), ("--search-level", 1), ("--no-odometry",),
        ("--laser", "FLASER"),
        ("--odometry-topic", "/odom"), ("--loops-picture", "l.png"), ("--angle-min", -90), ("--angle-step", 1),
        ("--no-return", 80),
    ],
)  # fmt: skip
def test_options_of_a_planar_laser_are_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    options: tuple[object, ...],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    err = failure(capsys, 2, run / "run", "-o", tmp_path / "m.parquet", *options)
    option = "--odometry" if options[0] == "--no-odometry" else options[0]
    assert f"is the log of a LiDAR, and {option} is for that of a planar laser" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("options", [("--rate", 5), ("--no-free-space",), ("--level",)])
def test_options_of_a_lidar_are_refused_for_a_planar_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: tuple[object, ...]
) -> None:
    log = tmp_path / "a.clf"
    log.write_text("FLASER 3 1.0 1.0 1.0 0 0 0 0 0 0 1.0 host 1.0\n")
    err = failure(capsys, 2, log, "-o", tmp_path / "m.parquet", *options)
    assert "is the log of a planar laser, and" in err and "is for that of a LiDAR" in err
    assert not (tmp_path / "m.parquet").exists()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--lattice", "A2"), 2, "cannot be mapped on A2, a lattice of the plane; take D3"),
        (("--lattice", "E8"), 2, "E8"),
        (("--resolution", 0), 2, "resolution"),
        (("--levels", 0), 2, "a map has 1 to 16 levels, not 0"),
        (("--min-range", 5, "--max-range", 2), 2, "minimum < maximum, not 5 and 2"),
        (("--scan-topic", "/none"), 1, "no sensor_msgs/PointCloud2 on topic /none; topics are /points"),
        (("--scan-frame", "none"), 1, "another frame"),
        (("--no-loop-closure", "--loops", "l.csv"), 2, "--loops says what closing loops found"),
        (("--poses", "absent.tum"), 1, "absent.tum"),
        (("--picture", "m.docx"), 2, "m.docx"),
        (("--bogus",), 2, "--bogus"),
    ],
)
def test_wrong_values_are_one_line(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    options: tuple[object, ...], code: int, words: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert words in failure(capsys, code, run / "run", "-o", tmp_path / "m.parquet", *options)
    assert list(tmp_path.iterdir()) == []


def test_a_bag_with_tf_is_mapped_by_the_robots_poses(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hexmap.io.lidar import open_lidar
    from hexmap.io.trajectories import write_tum

    mount = Pose.from_quaternion([0.3, 0.0, 1.0], [0.0, 0.1, 0.0, 1.0])
    scans = [scan for k, scan in enumerate(open_lidar(run / "run")) if k < 4]
    with CloudBag(tmp_path, "mcap") as bag:
        bag.transforms(0.0, ("base_link", "lidar", mount))
        for scan in scans:
            bag.write(xyz(scan.points[::4]), scan.stamp)
    poses = [pose @ mount.inverse() for k, pose in enumerate(read_tum(run / "run.tum")) if k < 4]
    write_tum(tmp_path / "robot.tum", Trajectory.from_poses([scan.stamp for scan in scans], poses))
    out = tmp_path / "m.parquet"
    options = ("--poses", tmp_path / "robot.tum", "--trajectory", tmp_path / "m.tum", *QUICK)
    capsys.readouterr()
    assert call("build", bag.path, "-o", out, *options) == 0
    said = capsys.readouterr().out
    assert "the LiDAR on the robot ('base_link'): (0.300, 0.000, 1.000) m, turned by 0.0, 11.4, 0.0 degrees" in said
    assert "poses of the robot ('base_link') at the scans' stamps" in said
    assert all(a.is_close(b, 1e-6, 1e-6) for a, b in zip(read_tum(tmp_path / "m.tum"), poses, strict=True))
    centres = load_map(out).levels[0].hits.centres()
    # The floor that the robot stands on is where it was.
    assert np.abs(centres[:, 2]).min() < 0.2 and np.quantile(centres[:, 2], 0.02) > -0.5
    assert call("info", bag.path) == 0
    assert "the LiDAR on the robot ('base_link')" in capsys.readouterr().out


def two_runs(run: Path, folder: Path) -> tuple[Path, Path]:
    """Two folders of scans, the last six of the first being the first six of the second."""
    for name, chosen in (("a", slice(0, 14)), ("b", slice(8, SCANS))):
        (folder / name).mkdir()
        for file in sorted((run / "scans").iterdir())[chosen]:
            (folder / name / file.name).write_bytes(file.read_bytes())
    return folder / "a", folder / "b"


def test_several_logs_are_mapped_together(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = two_runs(run, tmp_path)
    both = tmp_path / "both.parquet"
    capsys.readouterr()
    options = (*QUICK, "--no-free-space")
    assert call("build", a, b, "-o", both, "--trajectory", tmp_path / "both.tum", *options) == 0
    out = capsys.readouterr().out
    assert "14 scans" in out and "16 scans" in out
    assert f"{b}: begins at (" in out and "1 of its 1 parts lie on it" in out
    # The frame is that of the first run, and scans that both have lie where they lay.
    poses = read_tum(tmp_path / "both.tum")
    assert len(poses) == 30
    for k in range(8, 14):
        assert poses[k].is_close(poses[k + 6], 0.1, 0.02)
    built = load_map(both)
    assert len(built.sources()) == 2 and len({source["frame"] for source in built.sources()}) == 1
    err = failure(capsys, 1, a, "-o", tmp_path / "m.parquet", "--continue", both)
    assert f"it is in {both} already" in err
    err = failure(capsys, 2, run / "run", "-o", tmp_path / "m.parquet", "--continue", both, "--no-loop-closure")
    assert "--continue and --no-loop-closure do not go together" in err
    err = failure(capsys, 2, run / "run", "-o", tmp_path / "m.parquet", "--continue", both, "--resolution", 0.4)
    assert "goes on with these, not with D3 at 0.4 m" in err


@pytest.mark.long
def test_a_map_goes_on_with_another_run(run: Path, tmp_path: Path) -> None:
    a, b = two_runs(run, tmp_path)
    both, first, second = (tmp_path / f"{name}.parquet" for name in ("both", "first", "second"))
    options = (*QUICK, "--no-free-space")
    assert call("build", a, b, "-o", both, "--picture", tmp_path / "both.png", *options) == 0
    assert call("build", a, "-o", first, *options) == 0
    assert call("build", b, "-o", second, "--continue", first) == 0
    assert load_map(second) == load_map(both), "with the settings of the map"
    assert (tmp_path / "both.png").stat().st_size > 0


def test_damage_is_warned_of_and_the_rest_is_mapped(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (whole,) = (run / "run").glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole.read_bytes()[:-40])
    assert call("build", cut, "-o", tmp_path / "m.parquet", "--no-free-space", *QUICK) == 0
    assert "warning: cut.mcap: the bag has no sound index" in capsys.readouterr().err
    folder = tmp_path / "scans"
    folder.mkdir()
    for file in sorted((run / "scans").iterdir())[:6]:
        (folder / file.name).write_bytes(file.read_bytes())
    (folder / "1700000009000.npy").write_bytes(b"rubbish")
    assert call("build", folder, "-o", tmp_path / "m.parquet", "--no-free-space", *QUICK) == 0
    out, err = capsys.readouterr()
    assert "6 scans" in out and "warning: scans: 1 file skipped, the first at" in err


def test_a_scan_of_something_else_is_left_out_and_said(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "scans"
    folder.mkdir()
    for file in sorted((run / "scans").iterdir())[:14]:
        (folder / file.name).write_bytes(file.read_bytes())
    garbage = np.random.default_rng(0).uniform(-8.0, 8.0, (4000, 3))
    np.save(folder / sorted(p.name for p in folder.iterdir())[7], garbage)
    assert call("build", folder, "-o", tmp_path / "m.parquet", "--no-free-space", *QUICK) == 0
    assert "1 scan left out, nowhere near the ones before" in capsys.readouterr().err
