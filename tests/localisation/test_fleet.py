"""A map of each log of a fleet, on any number of workers to the same bits; what fails is named, what fits is kept."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from hexmap.base.errors import ArgumentError
from hexmap.cli import main
from hexmap.io.map_file import load_map
from localisation.mapping.fleet import build_fleet, map_names
from localisation.settings import MappingSettings
from tests.observing import PATIENCE, children, wait_until


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    here = tmp_path_factory.mktemp("logs")
    paths = [here / f"room-{seed}.clf.gz" for seed in range(3)]
    for seed, path in enumerate(paths):
        assert main(["simulate", "room", "-o", str(path), "--seed", str(seed), "--duration", "3"]) == 0
    return paths


def test_maps_are_those_that_build_makes_and_stay_where_they_fit(logs: list[Path], tmp_path: Path) -> None:
    settings = MappingSettings(lattice="Z2", resolution=0.1)
    seen: list[tuple[int, int]] = []
    fleet = build_fleet(logs, tmp_path, settings, loop_closure=False, progress=lambda *now: seen.append(now))
    assert seen == [(0, 3), (1, 3), (2, 3), (3, 3)]
    assert [p.name for p in fleet.built] == ["room-0.parquet", "room-1.parquet", "room-2.parquet"]
    one = tmp_path / "one.parquet"
    options = ["--lattice", "Z2", "--resolution", "0.1", "--no-loop-closure"]
    assert main(["build", str(logs[1]), "-o", str(one), *options]) == 0
    assert one.read_bytes() == fleet.built[1].read_bytes()
    # What is gone, damaged or of other settings is made again; the rest is kept.
    before = [path.read_bytes() for path in fleet.built]
    stamp = fleet.built[2].stat().st_mtime_ns
    fleet.built[0].unlink()
    fleet.built[1].write_bytes(before[1][:500])
    again = build_fleet(logs, tmp_path, settings, loop_closure=False)
    assert again.built == fleet.built[:2] and again.kept == fleet.built[2:]
    assert [path.read_bytes() for path in fleet.built] == before and fleet.built[2].stat().st_mtime_ns == stamp
    other = build_fleet(logs[:1], tmp_path, MappingSettings(lattice="A2", resolution=0.1), loop_closure=False)
    assert len(other.built) == 1 and load_map(other.built[0]).lattice.name == "A2"


def test_a_log_that_fails_is_named_and_the_rest_goes_on(
    logs: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad, gone = tmp_path / "bad.clf", tmp_path / "gone.clf"
    bad.write_text("nothing that a laser saw\n")
    out = tmp_path / "maps"
    capsys.readouterr()
    command = ["build", "--fleet", str(logs[0]), str(bad), str(gone), str(logs[1]), "-o", str(out)]
    assert main([*command, "--no-loop-closure", "--resolution", "0.1"]) == 1
    text, err = capsys.readouterr()
    assert "wrote 2 maps" in text and "bad.clf" in err and "gone.clf" in err
    assert err.splitlines()[-1].startswith("hexmap: 2 of 4 logs could not be mapped")
    assert sorted(p.name for p in out.iterdir()) == ["room-0.parquet", "room-1.parquet"]
    for words, options in (
        ("--picture is of one map", ["--picture", "a.png"]), ("--poses is of one map", ["--poses", "a.tum"]),
        ("go into a folder", ["-o", "a.parquet"]), ("workers must be 1 or larger", ["--workers", "0"]),
    ):  # fmt: skip
        assert main(["build", "--fleet", str(logs[0]), "-o", str(out), *options]) == 2
        assert words in capsys.readouterr().err
    assert main(["build", str(logs[0]), "-o", str(tmp_path / "m.parquet"), "--workers", "2"]) == 2
    assert "--fleet" in capsys.readouterr().err


def test_maps_are_called_as_their_logs() -> None:
    names = map_names([Path("a/b.clf.gz"), Path("c.bag"), Path("folder")])
    assert names == ["b.parquet", "c.parquet", "folder.parquet"]
    with pytest.raises(ArgumentError, match="maps of one name"):
        map_names([Path("a/b.clf"), Path("c/b.bag")])


def kill_a_worker_that_maps() -> int:
    """Kill a worker of this process that has begun to map: it has what compiles kernels in memory."""

    def one_that_maps() -> int | None:
        for pid in sorted(children(os.getpid())):
            with contextlib.suppress(OSError):
                if "llvmlite" in Path(f"/proc/{pid}/maps").read_text():
                    return pid
        return None

    pid = wait_until(one_that_maps)
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    return pid


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="needs /proc")
def test_a_killed_worker_costs_its_log_a_second_attempt(logs: list[Path], tmp_path: Path) -> None:
    settings = MappingSettings(lattice="Z2", resolution=0.1)
    alone = build_fleet(logs[:2], tmp_path / "one", settings, loop_closure=False)
    expected = [path.read_bytes() for path in alone.built]
    with ThreadPoolExecutor(1) as thread:
        killed = thread.submit(kill_a_worker_that_maps)
        fleet = build_fleet(logs[:2], tmp_path / "two", settings, loop_closure=False, workers=2)
        assert killed.result(timeout=PATIENCE) not in children(os.getpid())
    assert not fleet.failed
    assert [path.read_bytes() for path in fleet.built] == expected


@pytest.mark.long
def test_two_workers_killed_or_not_give_the_same_bits(logs: list[Path], tmp_path: Path) -> None:
    build_fleet(logs, tmp_path / "one")
    assert not build_fleet(logs, tmp_path / "two", workers=2).failed
    names = [f"room-{k}.parquet" for k in range(3)]
    expected = [(tmp_path / "one" / name).read_bytes() for name in names]
    assert [(tmp_path / "two" / name).read_bytes() for name in names] == expected
    # The command killed at some instants, and run once more.
    command = [sys.executable, "-m", "hexmap", "build", "--fleet", *map(str, logs), "--workers", "2"]
    for seconds in (2.0, 5.0, 8.0):
        process = subprocess.Popen([*command, "-o", str(tmp_path / "three")])
        time.sleep(seconds)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        for path in (tmp_path / "three").glob("room*.parquet"):
            assert path.read_bytes() == expected[names.index(path.name)]
    subprocess.run([*command, "-o", str(tmp_path / "three")], check=True)
    assert [(tmp_path / "three" / name).read_bytes() for name in names] == expected
