"""Trajectories, their files, and files that are replaced in one step."""

from __future__ import annotations

import math
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.atomic_files import atomic_path, atomic_write
from hexmap.base.errors import ArgumentError, FileAccessError, TrajectoryError
from hexmap.io.trajectories import TumWriter, read_relations, read_trajectory, read_tum, write_tum
from hexmap.poses.pose import Pose
from hexmap.poses.trajectory import Trajectory


def spiral(n: int = 20) -> Trajectory:
    k = np.arange(n)
    poses = [Pose.planar(0.1 * i, math.sin(0.3 * i), 0.4 * i) for i in k]
    return Trajectory.from_poses(976052857.337557 + 0.2 * k, poses)


def tumbling(n: int = 20) -> Trajectory:
    rng = np.random.default_rng(3)
    poses = [Pose.from_quaternion(rng.normal(size=3), rng.normal(size=4)) for _ in range(n)]
    return Trajectory.from_poses(np.arange(n) / 3, poses)


@pytest.mark.parametrize("trajectory", [spiral(), tumbling()], ids=["plane", "space"])
def test_written_trajectory_reads_back(tmp_path: Path, trajectory: Trajectory) -> None:
    write_tum(tmp_path / "a.tum", trajectory)
    again = read_tum(tmp_path / "a.tum")
    assert len(again) == len(trajectory) and again.planar == trajectory.planar
    np.testing.assert_allclose(again.stamps, trajectory.stamps, atol=1e-6)
    for a, b in zip(again, trajectory, strict=True):
        assert a.dim == b.dim and a.is_close(b, 1e-8, 1e-8)


def test_file_has_the_digits_of_the_format(tmp_path: Path) -> None:
    with TumWriter(tmp_path / "a.tum") as writer:
        writer.append(976052857.337557, Pose.planar(1 / 3, -2.0, 0.0))
    fields = (tmp_path / "a.tum").read_text().split()
    assert len(fields) == 8 and fields[0] == "976052857.337557"
    assert all(len(f.split(".")[1]) >= 9 for f in fields[1:])


def test_stamps_may_repeat_and_step_back(tmp_path: Path) -> None:
    stamps = [5.0, 5.0, 3.0, 4.0]
    write_tum(tmp_path / "a.tum", Trajectory.from_poses(stamps, [Pose.planar(i, 0, 0) for i in range(4)]))
    again = read_tum(tmp_path / "a.tum")
    assert again.stamps.tolist() == stamps and again.positions[:, 0].tolist() == [0, 1, 2, 3]
    found, off = again.nearest([3.4, 4.9, 100.0, 5.0])
    assert found.tolist() == [2, 0, 1, 0]
    np.testing.assert_allclose(off, [0.4, 0.1, 95.0, 0.0])


def test_nearest_agrees_with_looking_at_all() -> None:
    rng = np.random.default_rng(0)
    t = Trajectory.from_poses(rng.permutation(500) / 7, [Pose.identity(2)] * 500)
    wanted = rng.uniform(-5, 80, 300)
    found, off = t.nearest(wanted)
    np.testing.assert_allclose(off, np.abs(wanted[:, None] - t.stamps).min(axis=1))
    np.testing.assert_allclose(np.abs(t.stamps[found] - wanted), off)


def test_trajectory_is_a_value() -> None:
    t = spiral()
    with pytest.raises(AttributeError):
        t.stamps = np.zeros(3)
    with pytest.raises(ValueError):
        t.positions[0] = 1.0
    assert len(t[3:7]) == 4 and t[3:7][0] == t[3]
    assert len(pickle.loads(pickle.dumps(t))) == len(t)
    assert t[-1].is_close(list(t)[-1])
    assert Trajectory.from_poses([], []).length() == 0.0


def test_what_is_no_trajectory_is_refused() -> None:
    with pytest.raises(ArgumentError, match="pose 1 "):
        Trajectory([0, 1], np.zeros((2, 3)), [[0, 0, 0, 1], [0, 0, 0, 0]])
    with pytest.raises(ArgumentError, match="shape"):
        Trajectory([0, 1], np.zeros((2, 2)), np.ones((2, 4)))
    with pytest.raises(ArgumentError):
        Trajectory.from_poses([0.0], [])
    with pytest.raises(TrajectoryError):
        Trajectory.from_poses([], []).nearest([1.0])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("# comment\n\n1 0 0 0 0 0 0 1\n1 0 0 0 0 0 1\n", r"line 4: 7 numbers, expected 8"),
        ("1 0 0 0 0 0 0 1\n1 0 x1 0 0 0 0 1\n", r"line 2: 'x1' is not a number"),
        ("1 0 nan 0 0 0 0 1\n", r"line 1: 'nan' is not finite"),
        ("1 0 0 0 0 0 0 0\n", r"line 1: the quaternion's length is 0"),
        ("1 0 0 0 0 0 0 2\n", r"line 1: the quaternion's length is 2"),
        ("# nothing\n", r"no poses"),
        ("", r"no poses"),
        ("\x89PNG\x00\x01", r"line 1: .* is not a number"),
    ],
)
def test_bad_file_is_one_line_naming_file_and_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "bad.tum"
    path.write_text(text)
    with pytest.raises(TrajectoryError, match=says) as caught:
        read_tum(path)
    assert "bad.tum" in str(caught.value) and str(caught.value).isprintable()


def test_missing_file_is_a_file_error(tmp_path: Path) -> None:
    for read in (read_tum, read_relations):
        with pytest.raises(FileAccessError, match="nowhere"):
            read(tmp_path / "nowhere.txt")


def test_relations_are_read_as_poses(tmp_path: Path) -> None:
    path = tmp_path / "a.relations"
    path.write_text("# t1 t2 dx dy dz roll pitch yaw\n1 2 0.5 -1 0.25 0.1 -0.2 1.3\n")
    relations = read_relations(path)
    assert len(relations) == 1 and relations.from_stamps[0] == 1 and relations.to_stamps[0] == 2
    from scipy.spatial.transform import Rotation

    np.testing.assert_allclose(
        relations.rotations[0], Rotation.from_euler("ZYX", [1.3, -0.2, 0.1]).as_matrix(), atol=1e-12
    )
    path.write_text("1 2 0.5\n")
    with pytest.raises(TrajectoryError, match="line 1: 3 numbers, expected 8: t1 t2"):
        read_relations(path)


def test_interrupted_writer_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    write_tum(path, spiral(3))
    before = path.read_bytes()
    with pytest.raises(KeyboardInterrupt), TumWriter(path) as writer:
        writer.append(0.0, Pose.identity(2))
        assert path.read_bytes() == before
        raise KeyboardInterrupt
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["a.tum"]


def test_writer_refuses_what_no_reader_takes(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError), TumWriter(tmp_path / "a.tum") as writer:
        writer.append(math.nan, Pose.identity(2))
    assert os.listdir(tmp_path) == []
    with pytest.raises(ArgumentError):
        writer.append(0.0, Pose.identity(2))


def test_atomic_file_is_whole_or_not_there(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    with pytest.raises(ValueError), atomic_write(path) as handle:
        handle.write(b"half")
        raise ValueError
    assert os.listdir(tmp_path) == []
    with atomic_write(path) as handle:
        handle.write(b"whole")
        assert not path.exists()
    assert path.read_bytes() == b"whole" and os.listdir(tmp_path) == ["a.bin"]


def test_atomic_path_keeps_the_suffix(tmp_path: Path) -> None:
    with atomic_path(tmp_path / "picture.svg") as temporary:
        assert temporary.suffix == ".svg" and temporary.parent == tmp_path
        temporary.write_text("<svg/>")
    assert (tmp_path / "picture.svg").read_text() == "<svg/>"


@pytest.mark.skipif(os.name != "posix", reason="POSIX file modes")
def test_mode_is_that_of_an_ordinary_file(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    with atomic_write(tmp_path / "new") as handle:
        handle.write(b"")
    assert (tmp_path / "new").stat().st_mode == (tmp_path / "plain").stat().st_mode
    (tmp_path / "new").chmod(0o640)
    with atomic_write(tmp_path / "new") as handle:
        handle.write(b"x")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(os.name != "posix", reason="symbolic links")
def test_link_is_followed_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    with atomic_write(tmp_path / "link", "w") as handle:
        handle.write("new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "real").read_text() == "new"


def test_where_nothing_can_be_written_the_error_says_so(tmp_path: Path) -> None:
    with pytest.raises(FileAccessError, match="no folder"), atomic_write(tmp_path / "no" / "a"):
        pass
    with pytest.raises(FileAccessError, match="folder"), atomic_write(tmp_path):
        pass
    with pytest.raises(FileAccessError), TumWriter(tmp_path / "no" / "a.tum"):
        pass


def test_full_disk_is_a_file_error(tmp_path: Path) -> None:
    import errno

    with pytest.raises(FileAccessError, match=r"a\.bin.*[Nn]o space"), atomic_write(tmp_path / "a.bin"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert os.listdir(tmp_path) == []


def kitti_text(trajectory: Trajectory) -> str:
    rows = (pose.matrix()[:3, :4].reshape(-1) for pose in trajectory)
    return "".join(" ".join(f"{v:.9e}" for v in row) + "\n" for row in rows)


def euroc_text(trajectory: Trajectory, header: str = "#timestamp [ns],p_x [m],...\n", more: str = ",0,0,0") -> str:
    lines = [header]
    for stamp, pose in zip(trajectory.stamps, trajectory, strict=True):
        x, y, z, w = pose.quaternion()
        numbers = [*pose.translation, w, x, y, z]
        lines.append(f"{round((stamp + 1.5e9) * 1e9)},{','.join(f'{v:.12g}' for v in numbers)}{more}\n")
    return "".join(lines)


def test_trajectories_of_kitti_and_euroc(tmp_path: Path) -> None:
    trajectory = tumbling()
    path = tmp_path / "poses.txt"
    for text, stamps in (
        (kitti_text(trajectory), np.arange(20.0)),
        (euroc_text(trajectory), trajectory.stamps + 1.5e9),
        ("\ufeff" + euroc_text(trajectory, "timestamp,x,y,z,qw,qx,qy,qz\n", ""), trajectory.stamps + 1.5e9),
    ):
        path.write_text(text)
        found = read_trajectory(path)
        np.testing.assert_allclose(found.stamps, stamps, atol=1e-6)
        assert all(a.is_close(b, 1e-7, 1e-7) for a, b in zip(found, trajectory, strict=True))
    write_tum(path, trajectory)
    path.write_text("\ufeff" + path.read_text())
    assert len(read_trajectory(path)) == len(read_tum(path)) == 20


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 0 0 0 0 1 0 0 0 0 1 0\n2 0 0 0 0 1 0 0 0 0 1 0\n", "line 2: the first three columns .* no rotation"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", "line 1: the first three columns .* no rotation"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1\n", "line 2: 11 numbers, expected 12"),
        ("1.5,0,0,0,1,0,0,0\n", "line 1: the stamp 1.5 is no number of nanoseconds"),
        ("#x\n1500000000,0,0,0,2,0,0,0\n", "line 2: the quaternion's length is 2, not 1"),
        ("1500000000,0,0,0,1,0,0\n", "line 1: 7 numbers, expected 8"),
        ("1500000000,0,0,zero,1,0,0,0\n", "line 1: 'zero' is not a number"),
        ("# nothing\n\n", "no poses in the file"),
    ],
)
def test_what_is_wrong_with_a_trajectory_is_said(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "poses.txt"
    path.write_text(text)
    with pytest.raises(TrajectoryError, match=message):
        read_trajectory(path)


def test_a_trajectory_is_a_regular_file(tmp_path: Path) -> None:
    (tmp_path / "a.tum").symlink_to("/dev/zero")
    for reader in (read_trajectory, read_tum, read_relations):
        with pytest.raises(FileAccessError, match=r"a\.tum: cannot be read: it is a device"):
            reader(tmp_path / "a.tum")
