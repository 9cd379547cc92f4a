"""The logs of Wean Hall: centimetres in, metres out."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import LogError
from hexmap.cli import main
from hexmap.io.logs.log import LogSettings
from hexmap.io.logs.open_log import open_log
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan

RANGES = [str(100 + i) for i in range(180)]


def odometry(x=100.0, y=-50.0, theta=0.5, stamp="1.25") -> str:
    return f"O {x} {y} {theta} {stamp}"


def laser(ranges=RANGES, x=100.0, y=-50.0, theta=0.5, ahead=25.0, stamp="1.5") -> str:
    at = f"{x + ahead * math.cos(theta):.6f} {y + ahead * math.sin(theta):.6f} {theta}"
    return f"L {x} {y} {theta} {at} {' '.join(ranges)} {stamp}"


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def read(path: Path, **settings):
    log = open_log(path, LogSettings(**settings))
    return log, list(log)


def test_centimetres_become_metres_and_the_order_stays(tmp_path: Path) -> None:
    log, events = read(write(tmp_path / "a.log", odometry(), "", laser(), odometry(stamp="1.75")))
    assert [type(e) for e in events] == [Odometry, Scan, Odometry]
    assert [(e.stamp, e.line) for e in events] == [(1.25, 1), (1.5, 3), (1.75, 4)]
    assert events[0].pose == Pose.planar(1.0, -0.5, 0.5) == events[1].odometry
    angles = np.degrees(np.arctan2(events[1].points[:, 1], events[1].points[:, 0]))
    np.testing.assert_allclose(angles, np.arange(180) - 90, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(events[1].points, axis=1), (100 + np.arange(180)) / 100.0)
    assert (log.format, log.scans, log.odometry, log.skipped, log.warnings) == ("wean", 1, 2, 0, [])
    assert log.fraction() == 1.0 and len(list(log)) == 3, "a log can be read again"


def test_the_lines_say_how_the_laser_is_mounted(tmp_path: Path) -> None:
    assert read(write(tmp_path / "a.log", laser(theta=2.0)))[0].mount == Pose.planar(0.25, 0.0, 0.0)
    assert read(write(tmp_path / "b.log", "L 1 2", laser(ahead=-11.0)))[0].mount == Pose.planar(-0.11, 0.0, 0.0)
    assert read(write(tmp_path / "c.log", laser(ahead=0.0)))[0].mount is None


def test_the_largest_range_is_no_return(tmp_path: Path) -> None:
    ranges = ["8183", "8191", "nan", "0", *RANGES[4:]]
    log, (scan,) = read(write(tmp_path / "a.log", laser(ranges)))
    assert len(scan.points) == 176
    np.testing.assert_allclose(np.degrees(np.arctan2(*scan.no_return.T[::-1])), [-90, -89])
    (warning,) = log.warnings
    assert warning.startswith("a.log: 2 beams dropped") and "line 1" in warning
    _, (scan,) = read(tmp_path / "a.log", no_return=2.0)
    assert len(scan.no_return) == 80 + 2


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("O 1 2 0.5", "3 numbers after O, where 4 belong (a pose and a time)"),
        ("O 1 two 0.5 1", "'two' is not a number"),
        ("O 1 nan 0.5 1", "the odometry is 'nan'"),
        ("O 1 2 0.5 inf", "the time stamp is 'inf'"),
        (laser(RANGES[1:]), "186 numbers after L, where 187 belong (two poses, 180 ranges and a time)"),
        (laser([*RANGES, "1"]), "188 numbers after L"),
        (laser(["1,5", *RANGES[1:]]), "'1,5' is not a number"),
        (laser().replace("L 100.0", "L inf"), "the odometry is 'inf'"),
        ("L", "0 numbers after L"),
    ],
)
def test_a_broken_line_is_named_and_counted_and_the_rest_is_read(tmp_path: Path, line: str, why: str) -> None:
    log, events = read(write(tmp_path / "a.log", odometry(), line, laser(), line))
    assert len(events) == 2 and log.skipped == 2
    (warning,) = log.warnings
    assert warning.startswith("a.log: 2 lines skipped, the first at line 2: ") and why in warning


def test_a_last_line_that_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(f"{laser(stamp='12.5')}\n{laser(stamp='12.75')[:-4]}")
    log, events = read(path)
    assert len(events) == 1 and "line 2: the line is cut off in its time stamp" in log.warnings[0]
    path.write_text(f"{laser(stamp='12.5')}\n{laser(stamp='12.75')}")
    assert len(read(path)[1]) == 2, "without a line end, but whole"


def test_the_format_is_in_the_content(tmp_path: Path) -> None:
    lines = ["# a comment", "", odometry(), laser()]
    assert read(write(tmp_path / "a.clf", *lines))[0].format == "wean"
    packed = tmp_path / "b"
    packed.write_bytes(gzip.compress("\n".join(lines).encode()))
    assert read(packed)[0].format == "wean"
    # A CARMEN log that mentions such a line stays one.
    carmen = open_log(write(tmp_path / "c.log", "ODOM 1 2 0.5 0 0 0 1.0 host 0.1", odometry()))
    assert carmen.format == "carmen"
    with pytest.raises(LogError, match=r"d\.log: no laser reading \(L\) in 2 lines"):
        read(write(tmp_path / "d.log", odometry(), odometry()))


def test_info_says_what_a_log_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "a.log", odometry(), laser(), odometry(x=200.0, stamp="2"))
    assert main(["info", str(path)]) == 0
    out, err = capsys.readouterr()
    assert "a log (wean), 1 scans, 2 odometry readings" in out and "stamps 1.250 to 2.000 s, 1.0 m" in out
    assert "the laser on the robot: 0.25 m, 0 m, 0 degrees" in out and err == ""


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "scans", "readings", "rays"), [("robotdata1", 713, 1505, 693), ("robotdata2", 2251, 3126, 15066)]
)
def test_the_real_logs(data_dir: Path, name: str, scans: int, readings: int, rays: int) -> None:
    log, events = read(data_dir / "laser2d" / "wean" / f"{name}.log.gz")
    assert (log.scans, log.odometry, log.skipped, log.warnings) == (scans, readings, 0, [])
    assert log.mount == Pose.planar(0.25, 0.0, 0.0)
    assert sum(len(e.no_return) for e in events if isinstance(e, Scan)) == rays
    stamps = np.array([e.stamp for e in events])
    assert (np.diff(stamps) >= 0.0).all() and 0.0 < stamps[0] < 1.0 and stamps[-1] > 100.0


@pytest.mark.data
def test_a_real_log_becomes_a_map(data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, out = data_dir / "laser2d" / "wean" / "robotdata1.log.gz", tmp_path / "wean.parquet"
    assert main(["build", str(log), "-o", str(out)]) == 0
    said, err = capsys.readouterr()
    assert said.startswith("713 scans, 1505 odometry readings, 89.") and err == ""
