"""Bags with clouds in ROS 1, ROS 2 and MCAP, written here with rosbags; damage; what cannot be used is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import FileAccessError, LogError
from hexmap.io.lidar import LidarLog, LidarLogSettings, is_lidar_log, open_lidar
from hexmap.poses.scan import Scan
from tests.io.lidar.clouds import KINDS, CloudBag, room, xyz

LASER = "sensor_msgs/msg/LaserScan"


def read(path: Path, **settings: object) -> tuple[LidarLog, list[Scan]]:
    log = open_lidar(path, LidarLogSettings(**settings))  # type: ignore[arg-type]
    return log, list(log)


def sweep(seed: int = 0) -> dict[str, np.ndarray]:
    """What an Ouster says of sixty points."""
    times = np.round(np.linspace(0, 0.1, 60) * 1e9).astype(np.uint32)
    return {**xyz(room(60, seed)), "intensity": np.arange(60, dtype=np.float32), "t": times}


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_of_each_kind(tmp_path: Path, kind: str) -> None:
    with CloudBag(tmp_path, kind) as bag:
        for k in range(5):
            bag.write(sweep(k), 100.0 + k, stamp=99.5 + k)
    log, scans = read(bag.path)
    assert is_lidar_log(bag.path) and log.format == kind and log.warnings == []
    assert [s.stamp for s in scans] == [99.5 + k for k in range(5)], "the header's stamp and not when it was received"
    for k, scan in enumerate(scans):
        np.testing.assert_array_equal(scan.points, room(60, k))
        np.testing.assert_array_equal(scan.intensity, np.arange(60))
        np.testing.assert_allclose(scan.times, np.linspace(0, 0.1, 60), atol=1e-9)
        assert scan.line == k + 1
    assert log.fraction() == 1.0 and log.scans == 5
    assert len(list(log)) == 5 and log.warnings == [], "a bag can be read again"


def test_a_folder_and_its_only_file_are_the_same_bag(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.write(sweep(), 100.0)
    (file,) = bag.path.glob("*.mcap")
    assert np.array_equal(read(file)[1][0].points, read(bag.path)[1][0].points)


def test_points_that_are_none_are_dropped_and_counted(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        columns = sweep()
        for k in range(4):
            for axis in "xyz":
                columns[axis][k] = (np.nan, np.inf, 0.0, 1e-4)[k]
        columns["y"][4] = np.nan
        # The time of a beam that did not return may be anything.
        columns["t"][0] = 4_000_000_000
        bag.write(columns, 100.0, height=4, row_padding=8)
    log, (scan,) = read(bag.path)
    np.testing.assert_array_equal(scan.points, room(60)[5:])
    np.testing.assert_allclose(scan.times, np.linspace(0, 0.1, 60)[5:], atol=1e-9)
    np.testing.assert_array_equal(scan.intensity, np.arange(5, 60))
    assert log.warnings == ["run: 5 points dropped (not finite, or at the sensor itself), the first at message 1"]


def test_empty_scans_are_left_out_and_counted(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.write({name: values[:0] for name, values in sweep().items()}, 100.0)
        bag.write({**sweep(), **xyz(np.full((60, 3), np.nan))}, 101.0)
        bag.write(sweep(), 102.0)
    log, scans = read(bag.path)
    assert [s.stamp for s in scans] == [102.0]
    assert any("2 scans without points left out, the first at message 1" in w for w in log.warnings)


def test_one_bad_message_is_skipped_and_counted(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.write(sweep(), 100.0)
        bag.write({"x": np.ones(5, np.float32), "range": np.ones(5, np.float32)}, 101.0)
        bag.raw("/points", "sensor_msgs/msg/PointCloud2", b"\0\1\0\0rubbish", 102.0)
        bag.write({**sweep(), "t": np.linspace(0, 4e9, 60).astype(np.uint32)}, 103.0)
        bag.write(sweep(), 104.0)
    log, scans = read(bag.path)
    # Four seconds of a sweep are odd, but the unit is known by then.
    assert [s.stamp for s in scans] == [100.0, 103.0, 104.0]
    (warning,) = log.warnings
    assert "2 messages skipped, the first at message 2 (/points): a cloud without x, y and z" in warning


def test_a_bag_of_bad_messages_says_why(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.write({"x": np.ones(5, np.float32)}, 100.0)
    with pytest.raises(LogError, match=r"no cloud that can be used on topic /points \(1 message skipped.*without x, y"):
        read(bag.path)


def test_without_times_it_says_that_scans_stay_skewed(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "rosbag2") as bag:
        bag.write(xyz(room()), 100.0)
    log, (scan,) = read(bag.path)
    assert scan.times is None and scan.intensity is None
    assert log.warnings == ["run: no time a point: scans are not corrected for the motion within a sweep"]


def test_a_stamp_of_zero_is_when_it_was_received(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.write(sweep(), 1_700_000_000.5, stamp=0.0)
    assert read(bag.path)[1][0].stamp == pytest.approx(1_700_000_000.5, abs=1e-6)


def test_two_topics_are_chosen_between(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        for k in range(3):
            bag.write(sweep(0), 100.0 + k, topic="/front/points")
            bag.write(sweep(1), 100.0 + k, topic="/rear/points")
    with pytest.raises(LogError, match=r"several sensor_msgs/PointCloud2: /front/points, /rear/points; choose.*topic"):
        open_lidar(bag.path)
    _, scans = read(bag.path, topic="rear/points")
    assert len(scans) == 3 and np.array_equal(scans[0].points, room(60, 1))
    with pytest.raises(LogError, match="no sensor_msgs/PointCloud2 on topic /top; topics are"):
        open_lidar(bag.path, LidarLogSettings(topic="/top"))


def test_two_lidars_on_one_topic_are_told_apart_by_their_frames(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        for k in range(3):
            bag.write(sweep(0), 100.0 + k, frame="/left")
            bag.write(sweep(1), 100.0 + k, frame="right")
    log, scans = read(bag.path)
    assert len(scans) == 3 and all(np.array_equal(s.points, room(60, 0)) for s in scans)
    assert log.warnings == [
        "run: 3 scans of another frame left out, the first at message 2 ('right' and not 'left'); "
        "choose with --scan-frame"
    ]
    for frame in ("right", "/right"):
        log, scans = read(bag.path, frame=frame)
        assert len(scans) == 3 and all(np.array_equal(s.points, room(60, 1)) for s in scans)
    with pytest.raises(LogError, match="another frame"):
        read(bag.path, frame="middle")


def test_a_bag_of_packets_says_what_makes_clouds_of_them(tmp_path: Path) -> None:
    bag = CloudBag(tmp_path, "mcap")
    bag.register("velodyne_msgs/msg/VelodyneScan", "std_msgs/Header header\nuint8[] packets")
    with bag:
        header = bag.store.types["std_msgs/msg/Header"](
            stamp=bag.store.types["builtin_interfaces/msg/Time"](sec=1, nanosec=0), frame_id="velodyne"
        )
        kind = "velodyne_msgs/msg/VelodyneScan"
        bag.message("/velodyne_packets", kind, bag.store.types[kind](header, np.zeros(9, np.uint8)), 1.0)
    with pytest.raises(LogError, match=r"no sensor_msgs/PointCloud2.*/velodyne_packets holds packets.*maker's driver"):
        open_lidar(bag.path)
    assert not is_lidar_log(bag.path)


def test_a_bag_with_a_planar_laser_too_is_that_lasers(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        bag.write(sweep(), 100.0)
        bag.raw("/scan", LASER, b"", 100.0)
    assert not is_lidar_log(bag.path)
    assert len(read(bag.path)[1]) == 1, "but its clouds can be read all the same"


@pytest.mark.parametrize("kind", ["rosbag1", "mcap"])
def test_a_cut_bag_is_read_up_to_its_last_whole_message(tmp_path: Path, kind: str) -> None:
    with CloudBag(tmp_path, kind) as bag:
        for k in range(40):
            bag.write(sweep(k), 100.0 + k)
    whole = next(bag.path.glob("*.mcap")) if kind == "mcap" else bag.path
    data = whole.read_bytes()
    cut = tmp_path / f"cut{whole.suffix}"
    cut.write_bytes(data[:-60])
    log, scans = read(cut)
    # What the index alone said is lost with it, and no scan.
    assert len(scans) == 40 and any("no sound index" in w and "repair" in w for w in log.warnings)
    assert len(list(log)) == 40
    counts = []
    for part in (0.2, 0.5, 0.8):
        cut.write_bytes(data[: int(part * len(data))])
        try:
            log, scans = read(cut)
        except LogError as error:
            assert str(cut) in str(error) and "\n" not in str(error)
            counts.append(0)
        else:
            counts.append(len(scans))
            assert log.warnings and all(np.array_equal(s.points, room(60, k)) for k, s in enumerate(scans))
    assert counts == sorted(counts) and counts[-1] < 40


def test_a_damaged_record_ends_the_log_and_says_so(tmp_path: Path) -> None:
    with CloudBag(tmp_path, "mcap") as bag:
        for k in range(400):
            bag.write(sweep(k % 7), 100.0 + k)
    (file,) = bag.path.glob("*.mcap")
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 4000] = b"\xff" * 4000
    file.write_bytes(data)
    try:
        log, scans = read(bag.path)
    except LogError as error:
        assert "cannot be read" in str(error) and "\n" not in str(error)
    else:
        assert len(scans) < 400 and log.warnings


def test_what_is_no_lidar_log_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(FileAccessError, match="no such file or folder"):
        open_lidar(tmp_path / "absent")
    text = tmp_path / "notes.md"
    text.write_text("no log\n")
    with pytest.raises(LogError, match="neither a bag with clouds nor a folder of point files"):
        open_lidar(text)
    assert not is_lidar_log(text) and not is_lidar_log(tmp_path / "absent")
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(b"\x89MCAP0\r\n" + b"\0" * 50)
    assert not is_lidar_log(bad)
    with pytest.raises(LogError, match=r"bad\.mcap: "):
        open_lidar(bad)


@pytest.mark.data
def test_the_hall_is_read(data_dir: Path) -> None:
    log = open_lidar(data_dir / "lidar3d" / "hall")
    assert log.format == "mcap" and 60_000 < len(next(iter(log)).points) < 90_000
