"""CARMEN logs and telling log formats apart."""

from __future__ import annotations

import dataclasses
import gzip
import json
import math
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, FileAccessError, LogError, TooLargeError
from hexmap.io.logs.log import LogSettings
from hexmap.io.logs.open_log import is_log, open_log
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Odometry, Scan
from tests.observing import count_calls

RANGES = [f"{1 + 0.01 * i:.2f}" for i in range(180)]


def flaser(ranges=RANGES, odometry="1 2 0.5", stamp: str | None = "10.5", tag="FLASER", n=None) -> str:
    tail = f" {stamp} host 0.1" if stamp is not None else ""
    return f"{tag} {len(ranges) if n is None else n} {' '.join(ranges)} 9 9 9 {odometry}{tail}"


def odom(x=1.0, y=2.0, theta=0.5, stamp: str | None = "10.25") -> str:
    return f"ODOM {x} {y} {theta} 0 0 0" + (f" {stamp} host 0.1" if stamp is not None else "")


def robotlaser(ranges, laser="1.2 2 0.5", robot="1 2 0.5", tag="ROBOTLASER1", start=-1.0, step=0.01, maximum=30) -> str:
    fov = step * (len(ranges) - 1)
    return (
        f"{tag} 0 {start} {fov} {step} {maximum} 0.01 0 {len(ranges)} {' '.join(ranges)} 2 7 7 "
        f"{laser} {robot} 0.1 0.2 0.3 0.4 0.5 12.5 host 0.1"
    )


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def read(path: Path, **settings):
    log = open_log(path, LogSettings(**settings))
    return log, list(log)


def test_events_come_in_the_order_of_the_file(tmp_path: Path) -> None:
    path = write(tmp_path / "a.log", "# comment", "PARAM x y", odom(), "", flaser(stamp="9.0"), odom(stamp="8.5"))
    log, events = read(path)
    assert [type(e) for e in events] == [Odometry, Scan, Odometry]
    assert [e.stamp for e in events] == [10.25, 9.0, 8.5]
    assert [e.line for e in events] == [3, 5, 6]
    assert events[0].pose == Pose.planar(1, 2, 0.5)
    assert events[1].odometry == Pose.planar(1, 2, 0.5)
    assert (log.format, log.scans, log.odometry, log.skipped, log.warnings) == ("carmen", 1, 2, 0, [])
    assert log.mount is None and log.fraction() == 1.0
    assert len(list(log)) == 3, "a log can be read again"


def test_beams_run_counter_clockwise_from_the_right(tmp_path: Path) -> None:
    _, (scan,) = read(write(tmp_path / "a.log", flaser()))
    angles = np.arctan2(scan.points[:, 1], scan.points[:, 0])
    np.testing.assert_allclose(angles, np.radians(np.arange(180) - 90), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(scan.points, axis=1), np.array(RANGES, dtype=float))


@pytest.mark.parametrize(
    ("beams", "first", "last"), [(181, -90, 90), (360, -90, 89.5), (361, -90, 90), (541, -135, 135), (1081, -135, 135)]
)
def test_field_of_view_follows_from_the_number_of_beams(tmp_path: Path, beams: int, first: float, last: float) -> None:
    log, (scan,) = read(write(tmp_path / "a.log", flaser(["1"] * beams)))
    angles = np.degrees(np.arctan2(scan.points[:, 1], scan.points[:, 0]))
    assert angles[[0, -1]] == pytest.approx([first, last]) and log.warnings == []


def test_unknown_laser_is_warned_of_and_can_be_set(tmp_path: Path) -> None:
    path = write(tmp_path / "a.log", flaser(["1"] * 683))
    log, _ = read(path)
    assert len(log.warnings) == 1 and "683 beams" in log.warnings[0] and "angle_min" in log.warnings[0]
    step = math.radians(240) / 682
    log, (scan,) = read(path, angle_min=math.radians(-120), angle_step=step)
    assert log.warnings == []
    angles = np.degrees(np.arctan2(scan.points[:, 1], scan.points[:, 0]))
    assert angles[[0, -1]] == pytest.approx([-120, 120])


def test_ranges_without_return_become_rays(tmp_path: Path) -> None:
    ranges = [*RANGES[:-4], "81.83", "81.91", "inf", "80"]
    log, (scan,) = read(write(tmp_path / "a.log", flaser(ranges)))
    assert len(scan.points) == 176 and log.warnings == []
    np.testing.assert_allclose(np.degrees(np.arctan2(*scan.no_return.T[::-1])), [86, 87, 88, 89])
    _, (scan,) = read(tmp_path / "a.log", no_return=2.0)
    assert len(scan.no_return) == 180 - 100


def test_single_bad_ranges_drop_their_beam_only(tmp_path: Path) -> None:
    ranges = ["nan", "-1", "0", "-inf", *RANGES[4:]]
    log, (_, scan) = read(write(tmp_path / "a.log", flaser(), flaser(ranges)))
    assert len(scan.points) == 176 and len(scan.no_return) == 0
    assert np.degrees(np.arctan2(scan.points[0, 1], scan.points[0, 0])) == pytest.approx(-86)
    assert log.skipped == 0
    (warning,) = log.warnings
    assert warning.startswith("a.log: 4 beams dropped") and "line 2" in warning


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (flaser(RANGES[:-1], n=180), "180 beams announced, 179 found"),
        (flaser([*RANGES, "1"], n=180), "180 beams announced, 181 found"),
        (flaser(RANGES[:-3], n=180), "180 beams announced, 177 found"),
        (flaser(RANGES[:-1], n=180, stamp=None), "180 beams announced, 179 found|cut off"),
        ("FLASER 180 1.0 1.0", "180 beams announced, 2 found"),
        (flaser().rsplit(" ", 5)[0], "cut off"),
        (flaser([*RANGES[:-1], "x1.2"]), "'x1.2' is not a number"),
        (flaser(odometry="1 nan 0"), "odometry is 'nan'"),
        (flaser(odometry="1 inf 0"), "odometry is 'inf'"),
        (flaser(stamp="nan"), "time stamp is 'nan'"),
        ("FLASER many 1 2", "number of beams is 'many'"),
        ("FLASER", "number of beams is ''"),
        ("FLASER -3 1 2", "number of beams is '-3'"),
        (flaser([]), "0 beams"),
        (odom(x="nan"), "odometry is 'nan'"),
        ("ODOM 1 2", "ODOM"),
        ("ODOM a b c 0 0 0 1 host 1", "'a' is not a number"),
    ],
)
def test_bad_line_is_skipped_and_the_rest_is_read(tmp_path: Path, line: str, why: str) -> None:
    import re

    log, events = read(write(tmp_path / "a.log", flaser(), odom(), line, flaser()))
    assert len(events) == 3 and log.skipped == 1
    (warning,) = log.warnings
    assert re.fullmatch(rf"a\.log: 1 line skipped, the first at line 3: .*({why}).*", warning), warning


def test_skipped_lines_are_counted_together(tmp_path: Path) -> None:
    bad = flaser(RANGES[:-1], n=180)
    log, _ = read(write(tmp_path / "intel.clf", flaser(), bad, bad, odom(x="nan")))
    assert log.warnings == [
        "intel.clf: 3 lines skipped, the first at line 2: 180 beams announced, 179 found"
    ]  # fmt: skip


def test_lines_without_a_stamp_take_the_one_before(tmp_path: Path) -> None:
    log, events = read(write(tmp_path / "a.log", flaser(stamp="7.5"), odom(stamp=None), flaser(stamp=None)))
    assert [e.stamp for e in events] == [7.5, 7.5, 7.5]
    assert log.warnings == ["a.log: 2 lines without a time stamp took the one before"]


def test_robotlaser_carries_geometry_range_and_mount(tmp_path: Path) -> None:
    ranges = ["1", "2", "29.99", "30", "81.83"]
    log, (scan,) = read(write(tmp_path / "a.log", robotlaser(ranges, laser="1.2 2 0.6", robot="1 2 0")))
    assert log.mount is not None and log.mount.is_close(Pose.planar(0.2, 0, 0.6))
    assert scan.odometry == Pose.planar(1, 2, 0) and scan.stamp == 12.5
    np.testing.assert_allclose(np.arctan2(scan.points[:, 1], scan.points[:, 0]), [-1.0, -0.99, -0.98])
    assert len(scan.no_return) == 2
    log = open_log(write(tmp_path / "b.log", robotlaser(ranges, laser="1 2 0", robot="1 2 0")))
    assert log.mount is None


@pytest.mark.parametrize(
    "line",
    [
        robotlaser(["1"] * 5).replace(" 5 1 1", " 5 1", 1),
        robotlaser(["1"] * 5).replace(" 5 1 1", " 5 1 1 1", 1),
        "ROBOTLASER1 0 -1 2 0.01 30 0.01 0 5 1 1",
        robotlaser(["1"] * 5, start="nan"),
        robotlaser(["1"] * 5, robot="1 inf 0"),
    ],
)
def test_bad_robotlaser_line_is_skipped(tmp_path: Path, line: str) -> None:
    log, events = read(write(tmp_path / "a.log", robotlaser(["1"] * 5), line))
    assert len(events) == 1 and log.skipped == 1


def test_same_scan_twice_is_read_once(tmp_path: Path) -> None:
    path = write(tmp_path / "a.log", flaser(), robotlaser(["1"] * 5), flaser(), robotlaser(["1"] * 5))
    log, events = read(path)
    assert [len(e.points) for e in events] == [5, 5] and log.warnings == []
    _, events = read(path, laser="FLASER")
    assert [len(e.points) for e in events] == [180, 180]


def test_rear_laser_only_on_request_or_alone(tmp_path: Path) -> None:
    rear = flaser(["1"] * 181, tag="RLASER")
    path = write(tmp_path / "a.log", rear, flaser(), rear, flaser())
    log, events = read(path)
    assert [len(e.points) for e in events] == [180, 180]
    assert "2 scans of another laser left out" in log.warnings[0] and "line 1" in log.warnings[0]
    log, events = read(path, laser="rear")
    assert [len(e.points) for e in events] == [181, 181]
    alone, events = read(write(tmp_path / "b.log", rear, rear))
    assert len(events) == 2 and any("mounted" in w for w in alone.warnings)
    with pytest.raises(LogError, match="ROBOTLASER1, FLASER"):
        read(tmp_path / "b.log", laser="front")


def test_truncated_gzip_gives_what_it_holds(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    lines = [flaser([f"{r:.2f}" for r in rng.uniform(1, 20, 180)]) for _ in range(200)]
    whole = gzip.compress(("\n".join(lines) + "\n").encode())
    path = tmp_path / "a.clf.gz"
    path.write_bytes(whole[: len(whole) // 2])
    log, events = read(path)
    assert 80 < len(events) < 120
    assert log.warnings == [f"a.clf.gz: the gzip file is cut off; read up to line {len(events)}, its last whole one"]
    reference, all_events = read(_bytes(tmp_path / "b.clf.gz", whole))
    assert len(all_events) == 200 and reference.warnings == []
    np.testing.assert_array_equal(events[-1].points, all_events[len(events) - 1].points)


def _bytes(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_damaged_gzip_gives_what_came_before(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    lines = [flaser([f"{r:.2f}" for r in rng.uniform(1, 20, 180)]) for _ in range(200)]
    data = bytearray(gzip.compress(("\n".join(lines) + "\n").encode()))
    data[len(data) // 2 :] = rng.bytes(len(data) - len(data) // 2)
    log, events = read(_bytes(tmp_path / "a.gz", bytes(data)))
    assert 80 < len(events) < 120 and "damaged" in " ".join(log.warnings)


def test_gzip_of_several_members_is_one_log(tmp_path: Path) -> None:
    members = [gzip.compress((flaser() + "\n" + odom() + "\n").encode()) for _ in range(3)]
    log, events = read(_bytes(tmp_path / "a.gz", b"".join(members) + b"\0" * 100))
    assert len(events) == 6 and log.warnings == []


def test_text_cut_off_in_its_last_line(tmp_path: Path) -> None:
    for cut in (1, 3, 11, 20, 500):
        path = tmp_path / "a.log"
        path.write_text((flaser() + "\n" + flaser())[:-cut])
        log, events = read(path)
        assert len(events) == 1 + (cut == 1), cut
    path.write_text(flaser() + "\r\n" + odom() + "\r\n" + flaser())
    log, events = read(path)
    assert len(events) == 3 and log.warnings == []


PNG = b"\x89PNG\r\n\x1a\n" + bytes(range(256))


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("map.png", PNG, "PNG"),
        ("a.clf", PNG, "PNG"),
        ("a.clf", b"", "empty"),
        ("a.clf.gz", gzip.compress(b""), "empty"),
        ("a.clf.gz", gzip.compress(PNG), "PNG"),
        ("a.clf.gz", gzip.compress(b"#ROSBAG V2.0\n"), "decompress"),
        ("a.clf.gz", gzip.compress(b"hello")[:8], "gzip"),
        ("a.clf.gz", b"\x1f\x8b" + bytes(100), "gzip"),
        ("a.clf", np.random.default_rng(0).bytes(5000), "binary"),
        ("a.clf", "FLASER".encode("utf-16"), "UTF-16; save it as UTF-8"),
        ("a.parquet", b"PAR1\x15\x04", "Parquet"),
        ("run.bag", b"#ROSBAG V2.0\nrubbish", "bag cannot be read"),
        ("run.bag", b"#ROSBAG V1.2\n", "bag cannot be read"),
        ("run.mcap", b"\x89MCAP0\r\n", "bag cannot be read"),
        ("run.db3", b"SQLite format 3\x00rubbish", "bag cannot be read"),
    ],
)
def test_something_else_altogether_is_one_clear_line(tmp_path: Path, name: str, content: bytes, why: str) -> None:
    path = _bytes(tmp_path / name, content)
    with pytest.raises(LogError, match=why) as caught:
        open_log(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_folders_and_missing_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(LogError, match=r"without metadata\.yaml"):
        open_log(tmp_path)
    (tmp_path / "x_0.db3").write_bytes(b"")
    with pytest.raises(LogError, match=r"x_0\.db3.*ros2 bag reindex"):
        open_log(tmp_path)
    with pytest.raises(FileAccessError, match=r"nowhere\.clf: no such file"):
        open_log(tmp_path / "nowhere.clf")
    path = write(tmp_path / "a.log", flaser())
    log = open_log(path)
    path.unlink()
    with pytest.raises(FileAccessError, match=r"a\.log"):
        list(log)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    write(path, flaser())
    monkeypatch.setattr("builtins.open", refuse)
    with pytest.raises(FileAccessError, match="Permission denied"):
        open_log(path)


def test_log_without_a_laser_is_an_error_at_its_end(tmp_path: Path) -> None:
    log = open_log(write(tmp_path / "a.log", odom(), odom()))
    seen = []
    with pytest.raises(LogError, match=r"a\.log: no laser reading \(ROBOTLASER1, FLASER.* in 2 lines"):
        seen.extend(log)
    for event in iter(log):
        seen.append(event)
        break
    assert isinstance(seen[0], Odometry)
    broken = open_log(write(tmp_path / "b.log", flaser(RANGES[:-1], n=180)))
    with pytest.raises(LogError, match="1 line skipped, the first at line 1: 180 beams announced, 179 found"):
        list(broken)


def test_file_without_line_ends_does_not_fill_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_bytes(b"a" * (20 << 20))
    with pytest.raises(LogError, match="line 1: longer than"):
        list(open_log(path))


@pytest.mark.parametrize("suffix", [".log", ".gz"])
def test_memory_does_not_grow_with_the_log(tmp_path: Path, suffix: str) -> None:
    def peak(repeats: int) -> int:
        path = tmp_path / f"{repeats}{suffix}"
        text = (flaser() + "\n" + odom() + "\n").encode() * repeats
        path.write_bytes(gzip.compress(text, 1) if suffix == ".gz" else text)
        del text
        tracemalloc.start()
        try:
            assert sum(1 for _ in open_log(path)) == 2 * repeats
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    # The longer one holds 5 MB of text and 13 MB of scans.
    assert peak(5000) < peak(1000) + 500_000


def test_progress_runs_from_nought_to_one(tmp_path: Path) -> None:
    path = write(tmp_path / "a.log", *[flaser()] * 1000)
    log = open_log(path)
    fractions = [log.fraction() for _ in log]
    assert fractions == sorted(fractions) and 0 <= fractions[0] < 0.2 and fractions[-1] == 1.0


def test_settings_are_checked_and_plain_json() -> None:
    settings = LogSettings(angle_min=-1.0, laser="rear")
    assert LogSettings(**json.loads(json.dumps(dataclasses.asdict(settings)))) == settings
    for wrong in (
        {"angle_min": math.nan},
        {"angle_step": 0.0},
        {"no_return": 0.0},
        {"no_return": math.nan},
        {"laser": "left"},
    ):
        with pytest.raises(ArgumentError):
            LogSettings(**wrong)


def test_a_line_of_a_long_log_takes_no_more_calls_than_one_of_a_short_log(tmp_path: Path) -> None:
    calls = []
    for count in (100, 800):
        path = tmp_path / f"{count}.clf"
        path.write_text((flaser() + "\n" + odom() + "\n") * count)
        (_, events), made = count_calls(read, path)
        assert len(events) == 2 * count
        calls.append(made / count)
    assert calls[1] <= 1.05 * calls[0]


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "scans", "odometry", "rays"),
    [("intel", 2726, 13631, 13586), ("mit-csail", 1988, 0, 23711), ("belgioioso", 395, 4442, 699)],
)
def test_real_logs(data_dir: Path, name: str, scans: int, odometry: int, rays: int) -> None:
    log = open_log(data_dir / "laser2d" / f"{name}.clf.gz")
    count = sum(len(event.no_return) for event in log if isinstance(event, Scan))
    assert (log.scans, log.odometry, log.skipped, count) == (scans, odometry, 0, rays)
    assert log.warnings == [] and log.mount is None


@pytest.mark.data
def test_real_log_of_another_format_is_refused(data_dir: Path) -> None:
    with pytest.raises(LogError, match="no laser reading"):
        list(open_log(data_dir / "laser2d" / "intel.association.csv"))


@pytest.mark.parametrize(
    ("tag", "params", "mount"),
    [
        ("FLASER", ["robot_frontlaser_offset 0.3 nohost 0"], Pose.planar(0.3, 0.0, 0.0)),
        ("FLASER", ["robot_frontlaser_offset 0.1", "robot_frontlaser_offset 0.3"], Pose.planar(0.3, 0.0, 0.0)),
        (
            "FLASER",
            ["robot_frontlaser_offset 0.3", "robot_frontlaser_side_offset -0.1", "robot_frontlaser_angular_offset 0.2"],
            Pose.planar(0.3, -0.1, 0.2),
        ),
        ("FLASER", ["robot_rearlaser_offset -0.3", "robot_frontlaser_offset 0.0"], None),
        ("RLASER", ["robot_rearlaser_offset -0.3", "robot_frontlaser_offset 1"], Pose.planar(-0.3, 0, math.pi)),
        ("RLASER", ["robot_rearlaser_offset -0.3", "robot_rearlaser_angular_offset 3.0"], Pose.planar(-0.3, 0, 3.0)),
    ],
)
def test_params_say_how_a_laser_is_mounted(tmp_path: Path, tag: str, params: list[str], mount: Pose | None) -> None:
    lines = [*(f"PARAM {param}" for param in params), flaser(tag=tag)]
    log, _ = read(write(tmp_path / "a.log", *lines))
    assert (log.mount is None) if mount is None else log.mount.is_close(mount)
    assert log.warnings == []


def test_a_param_that_is_no_number_is_told_and_poses_of_a_line_come_first(tmp_path: Path) -> None:
    log, _ = read(write(tmp_path / "a.log", "PARAM robot_frontlaser_offset none", flaser()))
    assert log.mount is None and "PARAM robot_frontlaser_offset ignored: 'none' is not a number" in log.warnings[0]
    both = write(tmp_path / "b.log", "PARAM robot_frontlaser_offset 0.7", robotlaser(RANGES))
    assert read(both)[0].mount.is_close(Pose.planar(0.2 * math.cos(0.5), -0.2 * math.sin(0.5), 0.0))


def rawlaser(stamp: float, tag: str = "RAWLASER1", tail: str = "0") -> str:
    return f"{tag} 0 -1.0 2.0 0.01 30 0.01 0 201 {' '.join(['2.5'] * 200)} 31 {tail} {stamp} host {stamp}"


@pytest.mark.parametrize("tail", ["0", "2 7 7"])
def test_raw_laser_lines_take_the_odometry_around_them(tmp_path: Path, tail: str) -> None:
    lines = ["PARAM robot_frontlaser_offset 0.2", rawlaser(9.5, tail=tail)]
    for i in range(5):
        lines += [odom(0.5 * i, 0.0, 0.2 * i, str(10.0 + i)), rawlaser(10.5 + i, tail=tail)]
    log, events = read(write(tmp_path / "a.log", *lines))
    assert (log.scans, log.odometry, log.warnings) == (6, 5, []) and log.mount.is_close(Pose.planar(0.2, 0.0, 0.0))
    scans = [event for event in events if isinstance(event, Scan)]
    assert (len(scans[0].points), len(scans[0].no_return)) == (200, 1)
    assert math.isclose(math.atan2(scans[0].points[0, 1], scans[0].points[0, 0]), -1.0)
    assert scans[0].odometry is None, "before the first reading"
    assert scans[2].odometry.is_close(Pose.planar(0.75, 0.0, 0.3)), "half way between two readings"
    assert scans[5].odometry.is_close(Pose.planar(2.0, 0.0, 0.8)), "the last one known"
    assert [event.line for event in events] == sorted(event.line for event in events)


def test_raw_laser_lines_beside_others_are_the_same_scans(tmp_path: Path) -> None:
    path = write(tmp_path / "a.log", rawlaser(10.0), flaser(), rawlaser(11.0), flaser())
    log, _ = read(path)
    assert (log.scans, log.warnings) == (2, [])
    log, _ = read(path, laser="RAWLASER1")
    assert (log.scans, log.warnings) == (2, [])
    log, _ = read(write(tmp_path / "b.log", rawlaser(10.0, "RAWLASER2")), laser="rear")
    assert log.scans == 1 and "rear laser (RAWLASER2)" in log.warnings[0]


@pytest.mark.parametrize("squeezed", [False, True])
def test_a_byte_order_mark_costs_no_line(tmp_path: Path, squeezed: bool) -> None:
    data = b"\xef\xbb\xbf" + "\n".join([flaser(), flaser()]).encode() + b"\n"
    path = tmp_path / "a.log"
    path.write_bytes(gzip.compress(data) if squeezed else data)
    log, _ = read(path)
    assert (log.scans, log.skipped) == (2, 0)
    assert is_log(path)


def test_gzip_that_swells_without_end_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "bomb.clf.gz"
    path.write_bytes(gzip.compress(flaser().encode() + b"\n" * 100_000_000, 9))
    with pytest.raises(TooLargeError, match=r"bomb\.clf\.gz: [0-9]+ bytes of gzip hold more than 67108864"):
        list(open_log(path))


def test_devices_and_pipes_are_no_logs(tmp_path: Path) -> None:
    import os

    os.mkfifo(tmp_path / "pipe.log")
    (tmp_path / "zero.bag").symlink_to("/dev/zero")
    for name in ("pipe.log", "zero.bag"):
        with pytest.raises(LogError, match="not a file that can be read twice"):
            open_log(tmp_path / name)
        assert not is_log(tmp_path / name)


def test_beams_that_no_fan_has_cost_their_line(tmp_path: Path) -> None:
    log, events = read(write(tmp_path / "a.log", robotlaser(RANGES), robotlaser(RANGES, step=1e300)))
    assert len(events) == 1 and "line 2: beams from -1 by 1e+300 rad" in log.warnings[0]


def test_a_folder_of_several_logs_is_refused_by_name(tmp_path: Path) -> None:
    for name in ("a.clf", "b.clf"):
        (tmp_path / name).write_text("ODOM 0 0 0 0 0 0 1 h 1\n" * 3)
    with pytest.raises(LogError, match=r"a folder of 2 logs \(a.clf, b.clf\); name the log to read"):
        open_log(tmp_path)
