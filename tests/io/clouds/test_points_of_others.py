"""Points as other programs write them: columns without names, other spellings, coordinates of surveyors."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, BoundsError, FileAccessError, FormatError, TooLargeError
from hexmap.io.clouds.read_points import read_points
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from tests.io.clouds.test_clouds import POINTS, XYZ, fails, lines, pcd, ply, read


def hall(count: int = 3000) -> np.ndarray:
    """Points on the walls, the floor and the ceiling of a hall, ring by ring: x y z intensity ring time."""
    rng = np.random.default_rng(5)
    angle = np.linspace(0.0, 40.0 * np.pi, count)
    x = np.clip(14.0 * np.cos(angle), -6.0, 6.0)
    y = np.clip(11.0 * np.sin(angle), -3.5, 3.5)
    z = np.linspace(-1.0, 2.0, count)
    rings = np.floor(np.linspace(0.0, 15.99, count))
    return np.column_stack([x, y, z, rng.integers(0, 256, count), rings, np.linspace(0.0, 0.1, count)])


@pytest.mark.parametrize("width", [3, 4, 5, 6])
@pytest.mark.parametrize("count", [2880, 3001])
def test_the_columns_of_a_bin_file_are_told_apart(tmp_path: Path, width: int, count: int) -> None:
    table = hall(count)[:, :width].astype("<f4")
    found = read(tmp_path, table.tobytes(), "a.bin")
    assert np.array_equal(found.points, table[:, :3].astype(np.float64))
    if width == 4:
        assert found.warnings == ()
    else:
        (text,) = found.warnings
        assert text.startswith(f"a.bin: read as {width} numbers a point, x y z")


def test_what_nothing_tells_is_told(tmp_path: Path) -> None:
    cube = np.random.default_rng(1).random((4000, 3)).astype("<f4")
    (text,) = read(tmp_path, cube.tobytes(), "a.bin").warnings
    assert "nothing in the file tells how many numbers a point has; read as 4" in text
    found = read(tmp_path, cube.tobytes(), "a.bin", columns=["3"])
    assert np.array_equal(found.points, cube.astype(np.float64)) and found.warnings == ()


def test_columns_say_what_a_bin_file_has(tmp_path: Path) -> None:
    table = hall(60)[:, [3, 0, 1, 2, 4]].astype("<f4")
    names = ["intensity", "x", "y", "z", "ring"]
    found = read(tmp_path, table.tobytes(), "a.bin", columns=names)
    assert np.array_equal(found.points, table[:, 1:4].astype(np.float64)) and found.warnings == ()
    wide = np.column_stack([hall(50), hall(50)[:, :2]]).astype("<f4")
    assert np.array_equal(read(tmp_path, wide.tobytes(), "a.bin", columns="8").points, wide[:, :3].astype(np.float64))
    fails(tmp_path, table.tobytes()[:-4], "no multiple of 20", name="a.bin", columns=names)
    with pytest.raises(ArgumentError, match="columns of a file of format text are two or three"):
        read(tmp_path, lines(), "a.xyz", columns=names)
    five = hall(3000)[:, :5].astype("<f4")
    assert np.array_equal(read(tmp_path, five.tobytes(), "a.pcd.bin").points, five[:, :3].astype(np.float64))


def test_a_cut_off_scan_is_no_file_of_other_columns(tmp_path: Path) -> None:
    data = hall(3000)[:, :4].astype("<f4").tobytes()
    for left in (len(data) - 12, len(data) - 16 * 500 - 8):
        fails(tmp_path, data[:left], "no multiple of 16", "with columns", name="a.bin")


def test_a_header_in_any_case(tmp_path: Path) -> None:
    for kind in ("ascii", "binary", "binary_compressed"):
        assert np.array_equal(read(tmp_path, pcd(kind=kind, types="F F F").replace(b"TYPE F F F", b"TYPE f f f"),
                                   "a.pcd").points, POINTS)  # fmt: skip
    spelt = pcd(kind="ascii").replace(b"FIELDS", b"fields").replace(b"DATA ascii", b"data ASCII")
    assert np.array_equal(read(tmp_path, spelt, "a.pcd").points, POINTS)


@pytest.mark.parametrize(
    "word", ["-1.#IND", "1.#QNAN", "1.#QNAN00", "-1.#INF", "1.#INF000", "nan(ind)", "-nan(ind)", "-1.#J"]
)
def test_numbers_that_are_none_as_visual_c_writes_them(tmp_path: Path, word: str) -> None:
    rows = [["1", "2", "3"], ["4", "5", word], [word, "7", "8"], ["9", "10", "11"]]
    text = "\n".join(" ".join(row) for row in rows)
    head = pcd(POINTS[:4], "ascii").split(b"DATA ascii\n")[0] + b"DATA ascii\n"
    surface = ply([("vertex", XYZ, np.ones((4, 3)))], "ascii").split(b"end_header\n")[0] + b"end_header\n"
    for name, data in {
        "a.pcd": head + text.encode(), "a.ply": surface + text.encode() + b"\n", "a.xyz": text.encode(),
        "a.csv": b"x,y,z\n" + text.replace(" ", ",").encode(),
    }.items():  # fmt: skip
        found = read(tmp_path, data, name)
        assert found.points.tolist() == [[1, 2, 3], [9, 10, 11]] and found.dropped == 2


def ptx(points: np.ndarray, matrix: np.ndarray, columns: int, newline: str = "\n") -> bytes:
    rows = [str(columns), str(len(points) // columns), "1 2 3", "1 0 0", "0 1 0", "0 0 1"]
    rows += [" ".join(map(str, row)) for row in matrix.tolist()]
    rows += [" ".join(f"{v:.9g}" for v in point) + " 0.5" for point in points.tolist()]
    return (newline.join(rows) + newline).encode()


def test_scans_in_ptx_are_carried_to_where_their_matrices_say(tmp_path: Path) -> None:
    turn = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [10, 20, 30, 1]])
    unseen = POINTS.copy()
    unseen[[3, 8]] = 0.0
    data = ptx(unseen, turn, 10, "\r\n") + ptx(POINTS, np.eye(4), 5)
    found = read(tmp_path, data, "a.ptx")
    seen = np.delete(POINTS, [3, 8], axis=0)
    moved = np.column_stack([-seen[:, 1], seen[:, 0], seen[:, 2]]) + np.array([10, 20, 30])
    assert found.format == "ptx" and np.allclose(found.points, np.concatenate([moved, POINTS]))
    assert found.warnings == ("a.ptx: 2 points without a return left out",)
    assert np.array_equal(read(tmp_path, data, "noname", columns="z,x").points[0], found.points[0][[2, 0]])
    fails(tmp_path, data[:-60], "line 61: cut off: 50 points announced", name="a.ptx")
    fails(tmp_path, ptx(POINTS, np.eye(4), 5) + b"5\nten\n", "line 61: a scan begins with two numbers", name="a.ptx")


@pytest.mark.parametrize(
    "header",
    [
        "Exported 2024-01-01\nx,y,z\n",
        "Scan 12 of 2024\n\nby somebody, somewhere\nx,y,z\n",
        "Points:0,Points:1,Points:2\n",
        '"pos_x","pos_y","pos_z"\n',
        "Position.X [m],Position.Y [m],Position.Z [m]\n",
        "Easting,Northing,Elevation\n",
        "x_m,y_m,z_m\n",
    ],
)
def test_headers_below_titles_and_by_other_names(tmp_path: Path, header: str) -> None:
    found = read(tmp_path, header.encode() + lines(separator=","), "a.csv")
    assert np.array_equal(found.points, POINTS) and found.warnings == ()
    # The same with others before and among them.
    names = header.splitlines()[-1].split(",")
    wide = np.column_stack([POINTS[:, 2] + 7, POINTS[:, 0], POINTS[:, 2], POINTS[:, 1], POINTS[:, 1] - 3])
    titles = header.splitlines()[:-1]
    names = ["Normals:0", names[0], names[2], names[1], "ring"]
    data = "\n".join([*titles, ",".join(names), ""]).encode() + lines(wide, ",")
    assert np.array_equal(read(tmp_path, data, "a.csv").points, POINTS)


def test_coordinates_of_surveyors_take_an_offset(tmp_path: Path) -> None:
    there = np.array([500_000.0, 5_400_000.0, 300.0])
    path = tmp_path / "a.csv"
    np.savetxt(path, POINTS + there, fmt="%.6f", delimiter=",", header="x,y,z", comments="")
    plain = read_points(path)
    assert plain.offset == () and np.allclose(plain.points, POINTS + there)
    with pytest.raises(BoundsError, match=r"point 0 is out of range: \(5000[0-9]+\.[0-9]+, 54000[0-9]+\.[0-9]+, 30"):
        VoxelList.from_points(plain.points, Lattice.named("D3", 0.1))
    found = read_points(path, offset="auto")
    assert found.offset == (500_000.0, 5_400_000.0, 0.0)
    assert np.allclose(found.points + found.offset, POINTS + there, atol=1e-6)
    assert found.warnings == ("a.csv: coordinates beyond 100000 m; 500000,5400000,0 m is taken off them (offset)",)
    own = read_points(path, offset=there)
    assert np.allclose(own.points, POINTS, atol=1e-6) and own.warnings == () and own.offset == tuple(there)
    assert read(tmp_path, lines(), "b.xyz", offset="auto").offset == ()
    for wrong in ("first", (1.0,), (1.0, float("nan"))):
        with pytest.raises(ArgumentError, match="an offset is two or three finite numbers"):
            read_points(path, offset=wrong)
    with pytest.raises(ArgumentError, match="an offset of 2 numbers for points of dimension 3"):
        read_points(path, offset=(1.0, 2.0))


def test_single_precision_that_loses_decimetres_is_told(tmp_path: Path) -> None:
    far = POINTS + np.array([500_000.0, 5_400_000.0, 300.0])
    (text,) = read(tmp_path, ply([("vertex", XYZ, far)]), "a.ply").warnings
    assert "coordinates up to 54000" in text and "steps of 0.5 in the file" in text
    double = [("double", name) for _, name in XYZ]
    assert read(tmp_path, ply([("vertex", double, far + 0.001)]), "b.ply").warnings == ()


def test_the_command_line_takes_columns_and_offset(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    np.savetxt(path, hall(500)[:, [3, 0, 1, 2]] + [0, 5e5, 5.4e6, 0], fmt="%.3f", delimiter=",")

    def show(*options: str) -> subprocess.CompletedProcess[str]:
        output = str(tmp_path / "a.ply")
        command = [sys.executable, "-m", "hexmap", "show", str(path), "--resolution", "0.5", "-o", output]
        return subprocess.run([*command, *options], capture_output=True, text=True, check=False)

    done = show("--columns", "1,2,3")
    assert done.returncode == 0 and "500000,5400000,0 m is taken off them" in done.stderr, done.stderr
    done = show("--columns", "1,2,3", "--offset", "500000,5400000,0", "--crop", "499990,5399990,-5,500010,5400010,5")
    assert done.returncode == 0 and done.stderr == "", done.stderr
    done = show("--columns", "1,2,3", "--offset", "500000,north")
    assert done.returncode == 2 and "--offset takes two or three numbers with commas" in done.stderr


def test_points_are_read_from_regular_files_or_asked_for_pipes(tmp_path: Path) -> None:
    (tmp_path / "a.pcd").symlink_to("/dev/zero")
    with pytest.raises(FileAccessError, match=r"a\.pcd: cannot be read: it is a device"):
        read_points(tmp_path / "a.pcd")
    code = "from hexmap.io.clouds.read_points import read_points; print(len(read_points('/dev/stdin')))"
    done = subprocess.run([sys.executable, "-c", code], input=lines(), capture_output=True, check=True)
    assert done.stdout.strip() == b"50"


def test_gzip_of_points_inflates_to_no_more_than_is_stated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import gzip

    data = gzip.compress(lines() + b"\n" * 80_000_000, 9)
    path = tmp_path / "a.xyz.gz"
    path.write_bytes(data)
    with pytest.raises(TooLargeError, match="bytes of gzip hold more than 67108864; HEXMAP_MAX_INFLATION raises"):
        read_points(path)
    monkeypatch.setenv("HEXMAP_MAX_INFLATION", "2000")
    assert len(read_points(path)) == 50
    with pytest.raises(FormatError):
        read(tmp_path, b"", "empty.xyz")


def test_numbers_of_points_that_no_file_has_are_not_allocated(tmp_path: Path) -> None:
    huge = 2**31
    surface = ply([("vertex", XYZ, POINTS)], "ascii").replace(b"element vertex 50", f"element vertex {huge}".encode())
    fails(tmp_path, surface, f"cut off: {huge} of 'vertex' announced, 50 in the file", name="a.ply")
    cloud = pcd(kind="ascii", WIDTH=str(huge), POINTS=str(huge))
    fails(tmp_path, cloud, f"cut off: {huge} points announced, 50 in the file", name="a.pcd")
