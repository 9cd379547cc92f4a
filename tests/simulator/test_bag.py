"""The simulated run as a ROS 2 bag, read back with rosbags."""

import math
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from hexmap.base.errors import ArgumentError, FileAccessError
from hexmap.poses.pose import Pose
from hexmap.simulator.space import Drive3D, People, RingLidar, make_building_3d, simulate_lidar, write_bag

LIDAR = RingLidar(rings=8, azimuths=128)
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("time", "<f4")])


@pytest.fixture(scope="module")
def building():
    return make_building_3d("warehouse3d", seed=5, floors=2)


def messages(path):
    with AnyReader([Path(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        assert [(c.topic, c.msgtype) for c in reader.connections] == [("/points", "sensor_msgs/msg/PointCloud2")]
        for connection, stamp, raw in reader.messages():
            yield stamp, reader.deserialize(raw, connection.msgtype)


def test_a_bag_says_what_was_simulated(tmp_path, building):
    summary = write_bag(tmp_path / "run", building, tmp_path / "run.tum", lidar=LIDAR, seed=5, scans=6)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run", "run.tum"]
    run = list(simulate_lidar(building, lidar=LIDAR, seed=5, scans=6))
    truth = np.loadtxt(tmp_path / "run.tum")
    assert (summary.scans, summary.points) == (6, sum(len(s.scan.points) for s in run))
    assert summary.seconds == pytest.approx(1.1) and summary.metres == pytest.approx(1.2 * (1.1 - 0.4), rel=0.01)
    assert (summary.path, summary.truth_path) == (tmp_path / "run", tmp_path / "run.tum")
    for (stamp, message), row, simulated in zip(messages(tmp_path / "run"), truth, run, strict=True):
        header = message.header
        assert header.frame_id == "lidar" and header.stamp.sec * 10**9 + header.stamp.nanosec == stamp
        assert stamp * 1e-9 == pytest.approx(simulated.scan.stamp) == pytest.approx(row[0])
        assert [(f.name, f.offset, f.datatype) for f in message.fields] == [
            ("x", 0, 7), ("y", 4, 7), ("z", 8, 7), ("intensity", 12, 7), ("ring", 16, 4), ("time", 18, 7)
        ]  # fmt: skip
        assert (message.height, message.point_step) == (1, POINT.itemsize) and message.is_dense
        rows = message.data.view(POINT)
        assert message.width == len(rows) == len(simulated.scan.points)
        points = np.column_stack([rows["x"], rows["y"], rows["z"]])
        np.testing.assert_allclose(points, simulated.scan.points, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(rows["time"], simulated.scan.times, atol=1e-7)
        np.testing.assert_array_equal(rows["intensity"], simulated.scan.intensity)
        np.testing.assert_array_equal(rows["ring"], simulated.rings)
        assert Pose.from_quaternion(row[1:4], row[4:]).is_close(simulated.T_map_lidar, 1e-8, 1e-8)


def test_the_same_seed_writes_the_same_bytes(tmp_path, building):
    contents = []
    for folder, seed in (("one", 3), ("two", 3), ("three", 4)):
        (tmp_path / folder).mkdir()
        path, truth = tmp_path / folder / "run", tmp_path / folder / "run.tum"
        write_bag(path, building, truth, lidar=LIDAR, seed=seed, people=People(3), duration=2.0)
        contents.append([(path / "run.mcap").read_bytes(), (path / "metadata.yaml").read_bytes(), truth.read_bytes()])
    assert contents[0] == contents[1]
    assert contents[0][0] != contents[2][0]


def test_a_bag_is_replaced_and_nothing_else_is(tmp_path, building):
    path = tmp_path / "run"
    path.mkdir()
    for scans in (1, 3):
        write_bag(path, building, lidar=LIDAR, scans=scans)
        assert len(list(messages(path))) == scans
    (path / "notes.txt").write_text("mine")
    before = {p.name: p.read_bytes() for p in path.iterdir()}
    with pytest.raises(FileAccessError, match=r"run: cannot be written: the folder holds something else, notes\.txt"):
        write_bag(path, building, lidar=LIDAR, scans=1)
    assert {p.name: p.read_bytes() for p in path.iterdir()} == before
    (tmp_path / "file").write_text("mine")
    with pytest.raises(FileAccessError, match="there is a file of that name"):
        write_bag(tmp_path / "file", building, lidar=LIDAR, scans=1)
    with pytest.raises(FileAccessError, match="there is no folder"):
        write_bag(tmp_path / "nowhere" / "run", building, lidar=LIDAR, scans=1)
    with pytest.raises(FileAccessError, match="there is no folder"):
        write_bag(tmp_path / "new", building, tmp_path / "nowhere" / "run.tum", lidar=LIDAR, scans=1)
    with pytest.raises(ArgumentError, match="cannot lie in the bag"):
        write_bag(path, building, path / "run.tum", lidar=LIDAR, scans=1)
    with pytest.raises(ArgumentError, match="at least one scan"):
        write_bag(tmp_path / "new", building, lidar=LIDAR, scans=0)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "run"]


def test_an_interrupted_run_leaves_the_old_bag(tmp_path, building):
    path, truth = tmp_path / "run", tmp_path / "run.tum"
    write_bag(path, building, truth, lidar=LIDAR, scans=2)
    before = {p: p.read_bytes() for p in (*path.iterdir(), truth)}

    def stop(count, _total):
        if count == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_bag(path, building, truth, lidar=LIDAR, scans=5, progress=stop)
    assert {p: p.read_bytes() for p in (*path.iterdir(), truth)} == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run", "run.tum"]


def test_a_whole_drive_counts_its_scans(tmp_path, building):
    lidar = RingLidar(rings=1, azimuths=4, rate=0.1)
    seen = []
    summary = write_bag(tmp_path / "run", building, lidar=lidar, progress=lambda *counts: seen.append(counts))
    drive = Drive3D(building.waypoints)
    assert summary.scans == math.floor((drive.duration - 0.1) * 0.1) + 1
    assert seen == [(k + 1, summary.scans) for k in range(summary.scans)]
