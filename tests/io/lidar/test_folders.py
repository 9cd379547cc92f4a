"""Folders of point files as the log of a LiDAR: order, stamps, formats, files that are none."""

from __future__ import annotations

import gzip
import time
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, LogError
from hexmap.io.lidar import LidarLogSettings, is_lidar_log, open_lidar
from hexmap.io.lidar.folder import LidarFolder, scan_files
from tests.io.lidar.clouds import room


def write(path: Path, points: np.ndarray) -> None:
    """Write points in the format that the name says."""
    points = np.asarray(points, np.float32)
    kind = path.suffix
    if kind == ".bin":
        np.column_stack([points, np.zeros(len(points), np.float32)]).tofile(path)
    elif kind == ".npy":
        np.save(path, points)
    elif kind == ".ply":
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
        path.write_bytes(head.encode() + points.tobytes())
    elif kind == ".pcd":
        head = f"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\n"
        head += f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
        path.write_bytes(head.encode() + points.tobytes())
    else:
        np.savetxt(path, points, fmt="%.9g")


def folder(path: Path, names: list[str]) -> LidarFolder:
    for k, name in enumerate(names):
        write(path / name, room(40, k))
    log = open_lidar(path)
    assert isinstance(log, LidarFolder)
    return log


def test_numbers_in_names_count_as_numbers(tmp_path: Path) -> None:
    for name in ("scan10.npy", "scan9.npy", "scan2.npy", "scan100.npy", "scan1.npy"):
        write(tmp_path / name, room(5))
    assert [p.stem for p in scan_files(tmp_path)] == ["scan1", "scan2", "scan9", "scan10", "scan100"]


def test_all_formats_in_one_folder_are_one_run(tmp_path: Path) -> None:
    names = ["000.pcd", "001.ply", "002.bin", "003.npy", "004.xyz"]
    log = folder(tmp_path, names)
    assert is_lidar_log(tmp_path) and log.format == "bin+npy+pcd+ply+xyz"
    scans = list(log)
    for k, scan in enumerate(scans):
        np.testing.assert_allclose(scan.points, room(40, k), atol=1e-8, err_msg=names[k])
    assert len(scans) == 5 and log.fraction() == 1.0
    assert any("files of several kinds" in w for w in log.warnings)
    assert len(list(log)) == 5


def test_files_beside_the_scans_are_not_scans(tmp_path: Path) -> None:
    for name in (
        "times.txt",
        "poses.txt",
        "calib.txt",
        "README.txt",
        "Trajectory.csv",
        "timestamps.txt",
        ".hidden.npy",
    ):
        (tmp_path / name).write_text("0.0\n0.1\n")
    (tmp_path / "picture.png").write_bytes(b"")
    (tmp_path / "old.npy").mkdir()
    log = folder(tmp_path, ["posed_scan.npy", "timed.npy"])
    assert [p.name for p in log.files] == ["posed_scan.npy", "timed.npy"]
    assert log.stamps == [0.0, 0.1]


@pytest.mark.parametrize(
    ("names", "stamps"),
    [
        (["1700000000.500000.pcd", "1700000001.250000.pcd"], [1700000000.5, 1700000001.25]),
        (["1700000000_500000000.npy", "1700000001_250000000.npy"], [1700000000.5, 1700000001.25]),
        (["1700000000.npy", "1700000001.npy"], [1700000000.0, 1700000001.0]),
        (["1700000000500.npy", "1700000001250.npy"], [1700000000.5, 1700000001.25]),
        (["1700000000500000.bin", "1700000001250000.bin"], [1700000000.5, 1700000001.25]),
        (["1700000000500000000.bin", "1700000001250000000.bin"], [1700000000.5, 1700000001.25]),
    ],
)
def test_names_that_are_stamps(tmp_path: Path, names: list[str], stamps: list[float]) -> None:
    log = folder(tmp_path, names)
    assert log.stamps == pytest.approx(stamps, abs=1e-6) and log.warnings == []
    assert [s.stamp for s in log] == log.stamps


def test_a_file_of_times_says_the_stamps(tmp_path: Path) -> None:
    (tmp_path / "times.txt").write_text("10.0\n10.5\n\n11.25\n")
    log = folder(tmp_path, ["0.bin", "1.bin", "2.bin"])
    assert log.stamps == [10.0, 10.5, 11.25] and log.warnings == []


def test_kittis_dates_beside_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "America/New_York")
    time.tzset()
    try:
        (tmp_path / "data").mkdir()
        (tmp_path / "timestamps.txt").write_text("2011-09-26 13:02:25.964389445\n2011-09-26 13:02:26.064\n")
        log = folder(tmp_path / "data", ["0.bin", "1.bin"])
    finally:
        monkeypatch.undo()
        time.tzset()
    # UTC, wherever the computer is.
    assert log.stamps == pytest.approx([1317042145.964389, 1317042146.064], abs=1e-5)


def test_times_of_another_number_or_none_are_the_rate(tmp_path: Path) -> None:
    (tmp_path / "times.txt").write_text("10.0\n")
    log = folder(tmp_path, ["0.bin", "1.bin", "2.bin"])
    assert log.stamps == [0.0, 0.1, 0.2] and any("10 scans a second" in w for w in log.warnings)
    assert open_lidar(tmp_path, LidarLogSettings(rate=2.0)).stamps == [0.0, 0.5, 1.0]  # type: ignore[attr-defined]
    (tmp_path / "times.txt").write_text("10.0\nnoon\n11.0\n")
    with pytest.raises(LogError, match=r"times.txt: line 2: not a time: 'noon'"):
        open_lidar(tmp_path)
    with pytest.raises(ArgumentError, match="positive number of scans a second, not 0"):
        LidarLogSettings(rate=0.0)


def test_an_unreadable_file_is_skipped_and_the_rest_keep_their_stamps(tmp_path: Path) -> None:
    for k in range(4):
        write(tmp_path / f"{k}.pcd", room(40, k))
    (tmp_path / "1.pcd").write_bytes(b"VERSION .7\nFIELDS x y z\nrubbish")
    write(tmp_path / "4.npy", np.zeros((0, 3)))
    np.save(tmp_path / "5.npy", np.ones((9, 2)))
    points = room(40)
    points[3] = np.nan
    points[4] = 0.0
    write(tmp_path / "6.npy", points)
    log = open_lidar(tmp_path, LidarLogSettings(rate=1.0))
    assert [s.stamp for s in log] == [0.0, 2.0, 3.0, 6.0]
    text = "\n".join(log.warnings)
    assert "2 files skipped, the first at " in text and "1.pcd" in text
    assert "1 scan without points left out, the first at 4.npy" in text
    assert "2 points dropped" in text


def test_compressed_files(tmp_path: Path) -> None:
    write(tmp_path / "a.xyz", room(40))
    (tmp_path / "1700000000.xyz.gz").write_bytes(gzip.compress((tmp_path / "a.xyz").read_bytes()))
    (tmp_path / "a.xyz").unlink()
    log = open_lidar(tmp_path)
    (scan,) = log
    assert scan.stamp == 1700000000.0 and np.allclose(scan.points, room(40), atol=1e-8)


def test_no_scan_at_all_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"no scan in the folder; scans are \.pcd, \.ply"):
        open_lidar(tmp_path)
    assert not is_lidar_log(tmp_path)
    (tmp_path / "0.pcd").write_bytes(b"rubbish")
    log = open_lidar(tmp_path)
    with pytest.raises(LogError, match=r"none of the 1 files can be used as a scan \(1 file skipped"):
        list(log)


SWEEP = np.linspace(0.0, 0.099, 40)
# As drivers and their recorders write them: name, numpy's type, what it counts, whether from 1970 on.
TIMES = [
    ("time", "f4", 1.0, 0.0), ("t", "u4", 1e-9, 0.0), ("offset_time", "u4", 1e-9, 0.0), ("t", "i4", 1e-6, 0.0),
    ("Timestamp", "f8", 1.0, 1_700_000_000.0), ("timestamp", "f8", 1e-9, 1_700_000_000.0),
]  # fmt: skip


def timed(path: Path, points: np.ndarray, name: str, values: np.ndarray, kind: str) -> None:
    """Write points with a further column as PCD (ascii, binary) or PLY (ascii, binary, big endian)."""
    n, letter, size = len(points), {"u": "U", "i": "I", "f": "F"}[values.dtype.kind], values.dtype.itemsize
    order = ">" if kind == "big" else "<"
    number = values.dtype.str[1:]
    rows = np.zeros(n, [("ring", "u1"), (name, order + number), *[(axis, order + "f4") for axis in "xyz"]])
    rows["ring"], rows[name] = 7, values
    for k, axis in enumerate("xyz"):
        rows[axis] = points[:, k]
    text = "\n".join(f"7 {v!r} {x:.9g} {y:.9g} {z:.9g}" for v, (x, y, z) in zip(values.tolist(), points, strict=True))
    data = (text + "\n").encode() if kind == "ascii" else rows.tobytes()
    if path.suffix == ".pcd":
        head = f"VERSION .7\nFIELDS ring {name} x y z\nSIZE 1 {size} 4 4 4\nTYPE U {letter} F F F\nCOUNT 1 1 1 1 1\n"
        head += f"WIDTH {n}\nHEIGHT 1\nPOINTS {n}\nDATA {kind}\n"
    else:
        form = {"ascii": "ascii", "binary": "binary_little_endian", "big": "binary_big_endian"}[kind]
        typed = {"u4": "uint", "i4": "int", "f4": "float", "f8": "double"}[number]
        head = f"ply\nformat {form} 1.0\nelement vertex {n}\nproperty uchar ring\nproperty {typed} {name}\n"
        head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    path.write_bytes(head.encode() + data)


@pytest.mark.parametrize(("suffix", "kind"), [(".pcd", "ascii"), (".pcd", "binary"), (".ply", "ascii"),
                                              (".ply", "binary"), (".ply", "big")])  # fmt: skip
@pytest.mark.parametrize(("name", "dtype", "unit", "zero"), TIMES)
def test_times_of_points_in_files(
    tmp_path: Path, suffix: str, kind: str, name: str, dtype: str, unit: float, zero: float
) -> None:
    values = ((zero + SWEEP) / unit).astype(dtype)
    points = room(40)
    points[3] = np.nan
    timed(tmp_path / f"1700000000{suffix}", points, name, values, kind)
    log = open_lidar(tmp_path)
    (scan,) = log
    # Nanoseconds since 1970 have room for a quarter of a microsecond in a float64.
    np.testing.assert_allclose(scan.times, np.delete(SWEEP, 3), atol=2e-6)
    np.testing.assert_allclose(scan.points, np.delete(room(40), 3, axis=0), atol=1e-6)
    assert len(log.warnings) == 1 and "1 point dropped" in log.warnings[0]


def test_times_that_make_no_sweep_cost_the_deskewing_alone(tmp_path: Path) -> None:
    for k, values in enumerate((SWEEP, 1e11 * SWEEP, np.full(40, np.nan), SWEEP)):
        timed(tmp_path / f"{k}.pcd", room(40, k), "time", values.astype(np.float32), "binary")
    log = open_lidar(tmp_path)
    scans = list(log)
    assert [scan.times is None for scan in scans] == [False, True, True, False]
    tmp_path = tmp_path / "odd"
    tmp_path.mkdir()
    timed(tmp_path / "0.ply", room(40), "time", (1e11 * SWEEP).astype(np.float32), "binary")
    log = open_lidar(tmp_path)
    assert [scan.times for scan in log] == [None]
    assert any("1 scan taken without the times of their points, the first 0.ply: times" in w for w in log.warnings)


def test_intensity_is_kept_and_a_list_is_no_time(tmp_path: Path) -> None:
    timed(tmp_path / "0.pcd", room(40), "intensity", np.arange(40, dtype=np.float32), "binary")
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty list uchar float time\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    (tmp_path / "1.ply").write_text(head + "2 0.5 0.6 1 2 3\n1 0.5 4 5 6\n")
    first, second = open_lidar(tmp_path)
    np.testing.assert_array_equal(first.intensity, np.arange(40))
    assert second.times is None and second.points.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
