"""Runs of a LiDAR that are killed go on to the same bits: KISS-ICP's state, submaps, graph and loops."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import FormatError
from hexmap.cli import main
from hexmap.io.lidar import open_lidar
from hexmap.poses.pose import Pose
from hexmap.simulator.space import Building3D
from hexmap.simulator.space.bag import write_bag
from localisation.lidar_settings import LidarSettings
from localisation.mapping.checkpoint import Checkpoints
from localisation.mapping.lidar_map import LidarMappingResult, build_lidar_map
from localisation.odometry.kiss import KissOdometry
from localisation.slam.settings import LoopSettings
from tests.lattices import JIT
from tests.localisation.slam.lidar_drives import QUICK, SimulatedLidarLog, block, hall

pytestmark = pytest.mark.skipif(not JIT, reason="takes hours without the compiler")

COARSE = LidarSettings(resolution=0.2, levels=2, free_space=False)


class Killed(Exception):
    pass


def killed_at(scans: int) -> Callable[..., object]:
    """What shows the progress of a run, and ends it after so many scans."""

    @contextmanager
    def phase(name: str, fraction: object) -> Iterator[Callable[[int], None]]:
        def progress(done: int) -> None:
            if name == "mapping" and done >= scans:
                raise Killed

        yield progress

    return phase


def bits(result: LidarMappingResult) -> list[bytes]:
    assert result.slam is not None
    slam = result.slam
    arrays = [slam.poses, slam.covariances, slam.graph.poses, result.poses.positions, result.poses.quaternions]
    cells = [a for level in result.map.levels for a in (level.hits.index, level.hits.counts)]
    return [a.tobytes() for a in (*arrays, *cells)] + [repr(slam.records).encode(), repr(result.mean_share).encode()]


def goes_on(bag: Path, folder: Path, building: Building3D, scans: int | None, killed: tuple[int, ...]) -> None:
    write_bag(bag, building, lidar=QUICK, seed=1, scans=scans)
    whole = bits(build_lidar_map(open_lidar(bag), COARSE))
    for at in killed:
        kept = Checkpoints(folder, every=0.0)
        with pytest.raises(Killed):
            build_lidar_map(open_lidar(bag), COARSE, phase=killed_at(at), checkpoints=kept)  # type: ignore[arg-type]
        begun = kept.find(open_lidar(bag), COARSE, LoopSettings())
        assert begun is not None and begun.readings == at - 1
        assert bits(build_lidar_map(open_lidar(bag), COARSE, checkpoints=kept)) == whole
        kept.forget()


def test_a_killed_run_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    goes_on(tmp_path / "run", tmp_path / "kept", hall(), 26, (24,))


@pytest.mark.long
def test_a_run_with_loops_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    goes_on(tmp_path / "run", tmp_path / "kept", block(), None, (90, 215))


def test_kiss_icp_goes_on_as_if_it_had_not_been_kept() -> None:
    scans = list(SimulatedLidarLog(hall(), scans=12))
    kiss = KissOdometry(0.6, 60.0, Pose.identity(3))
    for scan in scans[:6]:
        kiss.register(np.array(scan.points))
    again = pickle.loads(pickle.dumps(kiss))
    for scan in scans[6:]:
        points = np.array(scan.points)
        a, b = kiss.register(points), again.register(points)
        assert np.array_equal(a.matrix(), b.matrix())


def test_a_checkpoint_of_another_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag, other = tmp_path / "run", tmp_path / "other"
    for path, seed in ((bag, 1), (other, 2)):
        write_bag(path, hall(), lidar=QUICK, seed=seed, scans=6)
    kept = Checkpoints(tmp_path / "kept" / "0", every=0.0)
    with pytest.raises(Killed):
        build_lidar_map(open_lidar(bag), COARSE, phase=killed_at(4), checkpoints=kept)  # type: ignore[arg-type]
    with pytest.raises(FormatError, match=r"another run \(log differs\)"):
        build_lidar_map(open_lidar(other), COARSE, checkpoints=kept)
    with pytest.raises(FormatError, match=r"another run \(settings differs\)"):
        build_lidar_map(open_lidar(bag), LidarSettings(), checkpoints=kept)
    build = ["build", str(bag), "-o", str(tmp_path / "m.parquet"), "--resolution", "0.2", "--levels", "2",
             "--no-free-space", "--checkpoint", str(tmp_path / "kept")]  # fmt: skip
    assert main(build) == 0
    assert f"goes on from {kept.path}" in capsys.readouterr().out
    assert not (tmp_path / "kept").exists(), "it is done"
    assert main([*build, "--poses", "x.tum"]) == 2
    assert "--checkpoint and --poses do not go together" in capsys.readouterr().err
