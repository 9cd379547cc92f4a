"""What is done with a map in space from the command line: info, show, export, plan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hexmap.cli import main
from hexmap.io.map_file import save_map
from hexmap.io.trajectories import write_tum
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.poses.trajectory import Trajectory
from tests.lattices import JIT
from tests.mapping import room_in_space

pytestmark = pytest.mark.skipif(not JIT, reason="pictures and searches take minutes without the compiler")


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


@pytest.mark.parametrize("name", ["Z3", "D3", "D3*", "A2xZ"])
def test_a_room_is_looked_at_exported_and_planned_in(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    room = tmp_path / "room.parquet"
    save_map(room, room_in_space(Lattice.named(name, 0.125), levels=2, beams=30_000))
    poses = [Pose.from_quaternion([x, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]) for x in (-1.5, 0.0)]
    write_tum(tmp_path / "t.tum", Trajectory.from_poses([0.0, 1.0], poses))
    assert call("info", room) == 0
    for file, more in (
        ("a.png", ()),
        ("a.glb", ()),
        ("a.ply", ()),
        ("a.svg", ()),
        ("s.png", ("--slice", "z=1.0")),
        ("c.png", ("--level", 1)),
    ):
        assert call("show", room, "-o", tmp_path / file, "--trajectory", tmp_path / "t.tum", *more) == 0
        assert (tmp_path / file).stat().st_size > 1000
    assert call("export", room, "-o", tmp_path / "room.bt") == 0
    assert call("export", room, "-o", tmp_path / "band.yaml", "--height", 0.3, 1.5) == 0
    said = capsys.readouterr().out
    assert "cubes of 0.125 m; lost: " in said and "heights from 0.3 to 1.5 m: " in said
    # The octree again, as a map of others.
    assert call("info", tmp_path / "room.bt") == 0
    assert call("show", tmp_path / "room.bt", "-o", tmp_path / "bt.png", "--slice", "1.0") == 0
    path = ("--from", -2, 0, 1, "--to", 2, 0.1, 1, "--radius", 0.2)
    assert call("plan", room, *path, "-o", tmp_path / "p.csv", "--picture", tmp_path / "p.png") == 0
    assert call("plan", tmp_path / "room.bt", *path) == 0
    points = np.loadtxt(tmp_path / "p.csv", delimiter=",", skiprows=1, usecols=(0, 1, 2))
    # Round the pillar with the robot's radius, less half a cell's diagonal at most.
    beside = np.maximum(np.abs(points[:, :2] - (0.8, 0.0)) - 0.2, 0.0)
    assert np.hypot(*beside.T).min() > 0.1
    # Unknown is not free: nothing was seen inside the pillar.
    capsys.readouterr()
    assert call("plan", room, "--from", -2, 0, 1, "--to", 0.8, 0.0, 1.0) == 1
    assert "unknown" in capsys.readouterr().err


def test_what_is_said_of_wrong_options(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    room = tmp_path / "room.parquet"
    save_map(room, room_in_space(Lattice.named("D3", 0.25), beams=3_000))
    for arguments, code, text in (
        (("show", room, "-o", tmp_path / "a.png", "--slice", "x=1"), 2, "a slice is at a height such as z=1.2"),
        (("show", room, "-o", tmp_path / "a.png", "--slice", "90"), 2, "no known cell is at the height of 90 m"),
        (("show", room, "-o", tmp_path / "a.glb", "--slice", "1"), 2, "a slice is drawn as .png"),
        (("show", room, "--viewer", "--slice", "1"), 2, "a slice is a picture"),
        (("export", room, "-o", tmp_path / "a.yaml"), 2, "--height LOW HIGH"),
        (("export", room, "-o", tmp_path / "a.bt", "--crop", "0,0,1,1"), 2, "--crop takes 6 numbers"),
        (
            ("export", room, "-o", tmp_path / "a.bt", "--crop", "50,50,50,60,60,60"),
            1,
            "no cell of the map lies in the box",
        ),
    ):
        assert call(*arguments) == code
        assert text in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["room.parquet"]
