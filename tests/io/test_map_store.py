"""A map that is spilled while it is built is that saved in one piece, byte for byte; nothing else is left."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, FileAccessError, FormatError
from hexmap.io import map_file, map_store
from hexmap.io.map_file import save_map
from hexmap.io.map_store import FileStore, FolderStore, MapStore, StoredMap
from hexmap.io.open_map import open_map
from hexmap.io.tile_merge import merge_maps
from hexmap.io.tile_writer import locked
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from tests.io.test_map_folder import small_steps
from tests.lattices import CASES, Case

pytestmark = pytest.mark.filterwarnings("ignore:overflow encountered:RuntimeWarning")
SOURCE = {"log": "a.clf", "log_id": "1", "frame": "1:given"}
NOT_A_BYTE = 0


def scans(lattice: Lattice, count: int = 7) -> list[tuple[Scan, Pose]]:
    """Scans that see the same from places of a few cells apart."""
    rng = np.random.default_rng(lattice.dim)
    n, cell = lattice.dim, lattice.resolution
    walls = rng.uniform(-12.0 * cell, 12.0 * cell, (12, n))
    poses = [Pose(np.eye(n), rng.uniform(-3.0 * cell, 3.0 * cell, n)) for _ in range(count)]
    return [(Scan(float(k), pose.inverse().apply(walls)), pose) for k, pose in enumerate(poses)]


def fuse(lattice: Lattice, store: MapStore | None = None) -> MapBuilder:
    builder = MapBuilder(lattice, 2, spare_hits=True)
    if store is not None:
        store.begin(builder)
    for scan, pose in scans(lattice):
        builder.fuse(scan, pose)
    return builder


def stored(lattice: Lattice, store: MapStore) -> StoredMap:
    with store:
        builder = fuse(lattice, store)
        assert len(store.parts) == 7, "every scan is more than the budget"
        made = store.finish(builder, SOURCE)
    assert builder.nbytes == 0
    return made


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("case", CASES, ids=str)
def test_what_was_spilled_makes_the_same_bytes(case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small_steps(monkeypatch)
    monkeypatch.setattr(map_store, "SIDE_BY_SIDE", 4)
    whole = fuse(case.lattice).build(source=SOURCE)
    save_map(tmp_path / "whole.parquet", whole)
    made = stored(case.lattice, FileStore(tmp_path / "parts.parquet", NOT_A_BYTE))
    assert made == StoredMap(tmp_path / "parts.parquet", case.lattice, 2, len(whole.levels[0].hits))
    assert (tmp_path / "parts.parquet").read_bytes() == (tmp_path / "whole.parquet").read_bytes()
    metres = 16 * case.lattice.resolution
    merge_maps([tmp_path / "whole.parquet"], tmp_path / "cut", metres)
    made = stored(case.lattice, FolderStore(tmp_path / "tiles", metres, NOT_A_BYTE))
    assert contents(tmp_path / "tiles") == contents(tmp_path / "cut")
    assert made.tiles == len(contents(tmp_path / "cut")) - 1 > 1 and made.hit_cells == len(whole.levels[0].hits)
    assert made.load() == whole
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cut", "parts.parquet", "tiles", "whole.parquet"]


def test_what_fits_the_budget_is_written_at_once(tmp_path: Path) -> None:
    squares = Lattice.named("Z2", 0.1)
    with FileStore(tmp_path / "a.parquet") as store:
        builder = fuse(squares, store)
        assert store.parts == []
        store.finish(builder, SOURCE)
    save_map(tmp_path / "b.parquet", fuse(squares).build(source=SOURCE))
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()


@pytest.mark.parametrize("file", [True, False], ids=["file", "folder"])
def test_a_map_without_a_cell(file: bool, tmp_path: Path) -> None:
    with FileStore(tmp_path / "map") if file else FolderStore(tmp_path / "map", 1.0) as store:
        made = store.finish(MapBuilder("D3", 2, resolution=0.1), SOURCE)
    assert made.hit_cells == 0 and made.levels == 2
    assert [len(level.hits) for level in made.load().levels] == [0, 0]


@pytest.mark.parametrize("file", [True, False], ids=["file", "folder"])
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_a_run_that_is_stopped_leaves_nothing(file: bool, error: type[BaseException], tmp_path: Path) -> None:
    store = FileStore(tmp_path / "m", NOT_A_BYTE) if file else FolderStore(tmp_path / "m", 1.0, NOT_A_BYTE)
    with pytest.raises(error), store:
        fuse(Lattice.named("A2", 0.1), store)
        assert len(list(tmp_path.iterdir())) == 1
        raise error
    assert list(tmp_path.iterdir()) == []


def test_what_a_killed_run_left_is_no_map_and_is_removed_by_the_next(tmp_path: Path) -> None:
    hexagons = Lattice.named("A2", 0.1)
    left = tmp_path / ".tiles.parts-1-00000000"
    left.mkdir()
    save_map(left / "0.parquet", fuse(hexagons).build())
    with pytest.raises(FormatError, match="a folder, but not a map"):
        open_map(left)
    at_work = tmp_path / ".tiles.parts-2-00000000"
    at_work.mkdir()
    with locked(at_work), FolderStore(tmp_path / "tiles", 1.0, NOT_A_BYTE) as store:
        assert not left.exists() and at_work.exists(), "another run is at work there"
        store.finish(fuse(hexagons, store), SOURCE)
    assert open_map(tmp_path / "tiles") == fuse(hexagons).build(source=SOURCE)


def test_a_full_disk_is_one_line_that_names_the_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(map_file.MapWriter, "write_columns", full)
    store = FolderStore(tmp_path / "tiles", 1.0, NOT_A_BYTE)
    with pytest.raises(FileAccessError, match="tiles: cannot be written: No space"), store:
        fuse(Lattice.named("A2", 0.1), store)
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_become_a_map_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(FileAccessError, match=r"something else, notes\.txt"):
        FolderStore(tmp_path, 1.0)
    with pytest.raises(ArgumentError, match="positive number of metres"):
        FolderStore(tmp_path / "tiles", 0.0)


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="another system than POSIX")
def test_nothing_is_spilled_beside_a_device() -> None:
    with FileStore("/dev/null", NOT_A_BYTE) as store:
        builder = fuse(Lattice.named("Z2", 0.1), store)
        assert store.parts == [] and builder.nbytes > 0
