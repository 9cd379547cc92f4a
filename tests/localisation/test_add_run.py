"""Further runs of a place, and runs that are killed: found in the map, held to it, gone on with to the same bits."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import AlignmentError, ArgumentError, FormatError
from hexmap.cli import main
from hexmap.io.logs.open_log import open_log
from hexmap.io.map_file import load_map
from hexmap.io.trajectories import read_tum
from hexmap.poses.pose import Pose
from hexmap.simulator.buildings import make_building
from hexmap.simulator.laser import Laser
from hexmap.simulator.writer import write_log
from localisation.mapping.add_run import add_run, settings_of
from localisation.mapping.checkpoint import Checkpoints
from localisation.mapping.loop_closed_map import build_loop_closed_map
from localisation.settings import MappingSettings
from localisation.slam.settings import LoopSettings
from tests.lattices import JIT, SKEW2

pytestmark = pytest.mark.skipif(not JIT, reason="takes hours without the compiler")

LASER = Laser(beams=181, rate=2.5)
SKEWED = (SKEW2.lattice.basis * (0.05 / SKEW2.lattice.resolution)).tolist()


def runs(folder: Path, building: str) -> tuple[Path, Path, list[Pose]]:
    """Two logs of a building, and where the robot truly was at each scan of the second, which begins on the way."""
    first, second, truth = folder / "first.clf", folder / "second.clf", folder / "truth.tum"
    write_log(first, make_building(building), laser=LASER, seed=1)
    write_log(second, make_building(building), truth, laser=LASER, seed=2)
    lines = second.read_text().splitlines(keepends=True)
    readings = [k for k, line in enumerate(lines) if line.startswith(("FLASER", "ODOM"))]
    cut = len(readings) // 3
    second.write_text("".join(line for k, line in enumerate(lines) if k not in set(readings[:cut])))
    poses = read_tum(truth)
    scans = [n for n, k in enumerate(readings) if n >= cut and lines[k].startswith("FLASER")]
    return first, second, [poses[0].inverse() @ poses[n] for n in scans]


@pytest.fixture(scope="module")
def office(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, list[Pose]]:
    return runs(tmp_path_factory.mktemp("office"), "office")


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


@pytest.mark.parametrize("lattice", ["A2", "Z2", SKEWED], ids=["A2", "Z2", "user's"])
def test_a_second_run_lies_in_the_map_of_the_first(office: tuple[Path, Path, list[Pose]], lattice: object) -> None:
    first, second, truth = office
    world = build_loop_closed_map(open_log(first), MappingSettings(lattice=lattice)).map  # type: ignore[arg-type]
    before = world.levels[0].hits.total
    seen: list[Pose] = []
    result, _ = add_run(world, open_log(second), on_pose=lambda stamp, pose, scan: seen.append(pose) if scan else None)
    off = [float(np.hypot(*(a.translation - b.translation))) for a, b in zip(seen, truth, strict=True)]
    assert np.median(off) < 0.05 and max(off) < 0.2
    # Both are in the new map, and the old one is what it was.
    added = sum(len(scan.points) for scan in result.slam.scans) if result.slam else 0
    assert result.map.levels[0].hits.total == before + added
    assert world.levels[0].hits.total == before
    assert len(result.map.sources()) == 2


def test_a_run_of_two_scans_is_added_where_it_is_found(office: tuple[Path, Path, list[Pose]], tmp_path: Path) -> None:
    world = build_loop_closed_map(open_log(office[0])).map
    short = tmp_path / "short.clf"
    scans = [line for line in office[1].read_text().splitlines(keepends=True) if line.startswith("FLASER")]
    short.write_text("".join(scans[:2]))
    # So little has no submap; it is placed as a whole, or refused in words.
    try:
        result, found = add_run(world, open_log(short))
    except AlignmentError:
        return
    assert math.dist(found.pose.translation, office[2][0].translation) < 0.2
    assert result.scans == 2


def test_a_run_of_another_building_is_refused(office: tuple[Path, Path, list[Pose]], tmp_path: Path) -> None:
    castle = tmp_path / "castle.clf"
    write_log(castle, make_building("castle"), laser=LASER, seed=1, duration=20.0)
    world = build_loop_closed_map(open_log(office[0])).map
    with pytest.raises(AlignmentError):
        add_run(world, open_log(castle))


def test_a_map_goes_on_with_its_own_settings_only(office: tuple[Path, Path, list[Pose]]) -> None:
    settings = MappingSettings(resolution=0.1, levels=2)
    world = build_loop_closed_map(open_log(office[0]), settings).map
    assert settings_of(world) == settings
    with pytest.raises(ArgumentError, match=r"0\.1 m of 2 levels"):
        add_run(world, open_log(office[1]), MappingSettings())


def test_the_command_line_continues_a_map_and_maps_several_logs(
    office: tuple[Path, Path, list[Pose]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, _ = (str(part) for part in office)
    one, both, two = (str(tmp_path / name) for name in ("one.parquet", "both.parquet", "two.parquet"))
    assert main(["build", first, "-o", one, "--checkpoint", str(tmp_path / "kept")]) == 0
    assert not (tmp_path / "kept").exists()
    assert main(["build", second, "-o", two, "--continue", one]) == 0
    assert main(["build", first, second, "-o", both]) == 0
    assert "begins at" in capsys.readouterr().out
    # One after the other or together: the same bits.
    assert Path(both).read_bytes() == Path(two).read_bytes()
    assert len(load_map(both).sources()) == 2
    for wrong in (["--poses", str(office[0].parent / "truth.tum")], ["--no-loop-closure"]):
        assert main(["build", second, "-o", str(tmp_path / "x.parquet"), "--continue", one, *wrong]) == 2
        assert "--continue" in capsys.readouterr().err
    assert main(["build", second, second, "-o", str(tmp_path / "x.parquet")]) == 1
    assert "twice" in capsys.readouterr().err
    assert not (tmp_path / "x.parquet").exists()


def test_a_killed_run_goes_on_to_the_same_bits(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "room.clf"
    write_log(log, make_building("room"), laser=LASER, seed=1)

    def poses_of(**how: object) -> list[Pose]:
        seen: list[Pose] = []
        build_loop_closed_map(open_log(log), on_pose=lambda s, pose, i: seen.append(pose), **how)  # type: ignore[arg-type]
        return seen

    whole = poses_of()
    for scans in (3, 37, 61):
        kept = Checkpoints(tmp_path, every=0.0)
        with pytest.raises(Killed):
            poses_of(phase=killed_at(scans), checkpoints=kept)
        begun = kept.find(open_log(log), MappingSettings(), LoopSettings())
        assert begun is not None and begun.readings > 0 and kept.readings() == begun.readings
        resumed = poses_of(checkpoints=kept)
        assert all(
            np.array_equal(a.translation, b.translation) and np.array_equal(a.rotation, b.rotation)
            for a, b in zip(whole, resumed, strict=True)
        )
        kept.forget()
        assert kept.readings() is None
    # The command line says that it goes on, and after how much.
    kept = Checkpoints(tmp_path / "kept" / "0", every=0.0)
    with pytest.raises(Killed):
        poses_of(phase=killed_at(5), checkpoints=kept)
    begun_after = kept.readings()
    capsys.readouterr()
    assert main(["build", str(log), "-o", str(tmp_path / "m.parquet"), "--checkpoint", str(tmp_path / "kept")]) == 0
    assert f"goes on after {begun_after} readings" in capsys.readouterr().out
    assert not (tmp_path / "kept").exists()


def test_a_checkpoint_of_something_else_is_refused(office: tuple[Path, Path, list[Pose]], tmp_path: Path) -> None:
    kept = Checkpoints(tmp_path, every=0.0)
    with pytest.raises(Killed):
        build_loop_closed_map(open_log(office[0]), phase=killed_at(30), checkpoints=kept)  # type: ignore[arg-type]
    with pytest.raises(FormatError, match="another run"):
        build_loop_closed_map(open_log(office[1]), checkpoints=kept)
    with pytest.raises(FormatError, match="another run"):
        build_loop_closed_map(open_log(office[0]), MappingSettings(resolution=0.1), checkpoints=kept)
    good = kept.path.read_bytes()
    for bad, words in (
        (b"nonsense", "not a checkpoint"), (good[:-10], "damaged"), (good[:40], "damaged|another"),
        (good[: len(good) // 2] + b"?" + good[len(good) // 2 + 1 :], "damaged"),
    ):  # fmt: skip
        kept.path.write_bytes(bad)
        with pytest.raises(FormatError, match=words):
            build_loop_closed_map(open_log(office[0]), checkpoints=kept)


def test_a_checkpoint_from_elsewhere_cannot_run_anything(office: tuple[Path, Path, list[Pose]], tmp_path: Path) -> None:
    import hashlib

    class Attack:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return __import__("os").system, (f"touch {tmp_path / 'harmed'}",)

    kept = Checkpoints(tmp_path, every=0.0)
    with pytest.raises(Killed):
        build_loop_closed_map(open_log(office[0]), phase=killed_at(10), checkpoints=kept)  # type: ignore[arg-type]
    head = kept.path.read_bytes().split(b"\n")[:2]
    body = pickle.dumps((1, Attack()))
    kept.path.write_bytes(b"\n".join([*head, hashlib.sha256(body).hexdigest().encode(), body]))
    with pytest.raises(FormatError, match="which no checkpoint holds"):
        build_loop_closed_map(open_log(office[0]), checkpoints=kept)
    assert not (tmp_path / "harmed").exists()
