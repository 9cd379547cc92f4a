"""Maps of logs that go through a store are those made in memory: in the plane and in space, given poses and loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from hexmap.io.logs.open_log import open_log
from hexmap.io.map_file import save_map
from hexmap.io.map_store import FileStore, FolderStore, MapStore
from hexmap.io.tile_merge import merge_maps
from hexmap.io.trajectories import read_tum
from hexmap.poses.trajectory import Trajectory
from hexmap.simulator.buildings import make_building
from hexmap.simulator.laser import Laser
from hexmap.simulator.writer import write_log
from localisation.lidar_settings import LidarSettings
from localisation.mapping.build_map import build_map
from localisation.mapping.fuse_log import fuse_log
from localisation.mapping.lidar_map import fuse_lidar_log
from localisation.mapping.loop_closed_map import fuse_run, map_run
from localisation.settings import MappingSettings
from tests.lattices import JIT
from tests.localisation.slam.lidar_drives import SimulatedLidarLog, hall

pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")
BUDGET = 1 << 17
LATTICES = pytest.mark.parametrize("lattice", ["A2", "Z2", [[0.1, 0.03], [0.0, 0.1]]], ids=["A2", "Z2", "own basis"])


@dataclass
class Drive:
    log: Path
    truth: Trajectory


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    folder = tmp_path_factory.mktemp("drive")
    log, truth = folder / "office.clf", folder / "office.tum"
    write_log(log, make_building("office"), truth, laser=Laser(beams=61), seed=3, duration=20.0)
    return Drive(log, read_tum(truth))


def check_same(make: Callable[[MapStore | None], object], folder: Path, metres: float) -> None:
    """Check that a file and a folder of tiles are those of the map in memory, byte for byte."""
    whole = make(None)
    save_map(folder / "whole.parquet", whole.map)
    merge_maps([folder / "whole.parquet"], folder / "cut", metres)
    for store in (FileStore(folder / "file.parquet", BUDGET), FolderStore(folder / "tiles", metres, BUDGET)):
        with store:
            result = make(store)
            assert len(store.parts) > 2, "it is not spilled"
        assert result.made.hit_cells == len(whole.map.levels[0].hits) and result.map == whole.map
        assert (result.scans, result.metres) == (whole.scans, whole.metres)
    assert (folder / "file.parquet").read_bytes() == (folder / "whole.parquet").read_bytes()
    tiles = [{p.name: p.read_bytes() for p in (folder / name).iterdir()} for name in ("tiles", "cut")]
    assert tiles[0] == tiles[1] and len(tiles[0]) > 2


@LATTICES
def test_a_log_at_given_poses(lattice: object, drive: Drive, tmp_path: Path) -> None:
    settings = MappingSettings(lattice=lattice, resolution=0.1 if isinstance(lattice, str) else None)
    check_same(lambda store: fuse_log(open_log(drive.log), drive.truth, settings, store=store), tmp_path, 5.0)


def test_a_log_whose_loops_are_closed(drive: Drive, tmp_path: Path) -> None:
    settings = MappingSettings(resolution=0.1)
    run = map_run(open_log(drive.log), settings)
    check_same(lambda store: fuse_run(run, settings, store=store), tmp_path, 5.0)


def test_a_log_that_is_matched_against_its_own_map_is_written_at_the_end(drive: Drive, tmp_path: Path) -> None:
    settings = MappingSettings(resolution=0.1)
    whole = build_map(open_log(drive.log), settings)
    with FileStore(tmp_path / "a.parquet", BUDGET) as store:
        result = build_map(open_log(drive.log), settings, store=store)
        assert store.parts == []
    assert result.map == whole.map


@pytest.mark.parametrize("free", [True, False], ids=["free space", "hits"])
def test_a_log_of_a_lidar(free: bool, tmp_path: Path) -> None:
    log = SimulatedLidarLog(hall(), scans=4)
    truth = Trajectory.from_poses([scan.stamp for scan in log], log.truth)
    settings = LidarSettings(resolution=0.2, levels=2, free_space=free)
    check_same(lambda store: fuse_lidar_log(log, truth, settings, store=store), tmp_path, 4.0)
