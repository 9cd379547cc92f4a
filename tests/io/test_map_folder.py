"""A map of tiles is the map that merging in memory gives; a window reads only its tiles; old or new, never half."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import reduce
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from hexmap.base.errors import BoundsError, FileAccessError, FormatError, TooLargeError
from hexmap.cli import main
from hexmap.io import map_folder, row_streams, tile_merge, tile_writer
from hexmap.io.map_file import load_map, save_map
from hexmap.io.map_folder import MapFolder
from hexmap.io.open_map import open_map
from hexmap.io.tile_merge import merge_maps as merge
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from tests.lattices import CASES, Case
from tests.observing import PATIENCE, children, wait_until


def some_map(lattice: Lattice, seed: int, count: int = 120, levels: int = 3, spread: float = 15.0) -> Map:
    """A map of random cells, with hits alone, passes alone and both."""
    rng = np.random.default_rng([seed, lattice.dim])
    parts = []
    for k in range(levels):
        at = lattice.scaled(2.0**k)
        lists = []
        for _ in range(2):
            index = np.rint(rng.normal(0.0, spread / 2**k, (count >> k, lattice.dim))).astype(np.int64)
            lists.append(VoxelList.from_cells(index, at, rng.integers(1, 9, len(index))))
        parts.append(Level(*lists))
    return Map(parts, "map", [json.dumps({"log": f"{seed}.clf", "log_id": str(seed), "frame": "one"}, sort_keys=True)])


def saved(folder: Path, maps: list[Map]) -> list[Path]:
    paths = [folder / f"{i}.parquet" for i in range(len(maps))]
    for path, map in zip(paths, maps, strict=True):
        save_map(path, map)
    return paths


def small_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make everything that is a few rows at a time a few rows: what holds of a hundred rows then holds of all."""
    monkeypatch.setattr(tile_merge, "_BATCH", 37)
    monkeypatch.setattr(tile_merge, "_LEAST_BATCH", 37)
    monkeypatch.setattr(tile_merge, "SIDE_BY_SIDE", 4)
    monkeypatch.setattr(tile_writer, "_GROUP", 23)
    monkeypatch.setattr("hexmap.io.map_file._GROUP", 101)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_tiles_hold_what_merging_in_memory_gives(case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    maps = [some_map(case.lattice, seed) for seed in range(5)]
    small_steps(monkeypatch)
    paths = saved(tmp_path, maps)
    metres = (48 if case.dim == 2 else 80) * case.lattice.resolution
    folder = merge(paths, tmp_path / "all", metres)
    expected = reduce(Map.merge, maps)
    assert open_map(tmp_path / "all") == expected
    assert len(folder.tiles) >= 4
    # Any order of the maps gives the same files, byte for byte, and so does merging what was merged before.
    merge([*reversed(paths)], tmp_path / "again", metres)
    merge(paths[:3], tmp_path / "some", metres / 2)
    merge([tmp_path / "some", *paths[3:]], tmp_path / "rest", metres)
    assert contents(tmp_path / "all") == contents(tmp_path / "again") == contents(tmp_path / "rest")
    # So does any number of workers, each of which merges a part.
    with ThreadPoolExecutor(3) as executor:
        merge(paths, tmp_path / "parts", metres, executor=executor)
        merge([tmp_path / "some", *paths[3:]], tmp_path / "rest", metres, executor=executor)
    assert contents(tmp_path / "all") == contents(tmp_path / "parts") == contents(tmp_path / "rest")
    # Every tile is a map by itself, as wide as it was to be, and no cell is in two.
    rows = 0
    for tile, part in zip(folder.tiles, folder.maps(list(folder.tiles)), strict=True):
        index = part.levels[0].hits.index
        assert (index // np.array(folder.cells) == tile.index).all()
        rows += sum(len(level.columns()[0]) for level in part.levels)
        assert tile.rows == sum(len(level.columns()[0]) for level in part.levels)
    assert rows == folder.rows == sum(len(level.columns()[0]) for level in expected.levels)
    for k, total in enumerate(folder.totals()):
        level = expected.levels[k]
        numbers = (len(level.columns()[0]), len(level.hits), level.hits.total, len(level.passes))
        assert tuple(total.values()) == numbers
        corners, found = expected.bounds(k), folder.bounds(k)
        assert corners is not None and found is not None and np.array_equal(corners, found)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("case", [c for c in CASES if c.label in ("A2@0.1", "skew2", "D3*@0.1")], ids=str)
def test_a_window_is_the_crop_of_the_whole_and_reads_its_tiles_alone(
    case: Case, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    maps = [some_map(case.lattice, seed) for seed in range(2)]
    merge(saved(tmp_path, maps), tmp_path / "all", 24 * case.lattice.resolution)
    folder = MapFolder.open(tmp_path / "all")
    low, high = np.full(case.dim, -0.5), np.full(case.dim, 0.7)
    assert open_map(tmp_path / "all", low, high) == maps[0].merge(maps[1]).crop(low, high)
    assert open_map(tmp_path / "0.parquet", low, high) == maps[0].crop(low, high)
    needed = {tile.file for tile in folder.within(low, high)}
    assert 0 < len(needed) < len(folder.tiles)
    for tile in folder.tiles:
        if tile.file not in needed:
            (tmp_path / "all" / tile.file).unlink()
    assert open_map(tmp_path / "all", low, high) == maps[0].merge(maps[1]).crop(low, high)
    # Without the window everything is needed, and what is missing is named.
    with pytest.raises(FileAccessError, match=r"tile_.*\.parquet: a tile of the map cannot be read"):
        open_map(tmp_path / "all")
    monkeypatch.setattr(map_folder, "MOST_ROWS", 10)
    with pytest.raises(TooLargeError, match="--crop takes a part"):
        open_map(tmp_path / "all")


def test_others_read_the_tiles_as_one_table(tmp_path: Path) -> None:
    maps = [some_map(Lattice.named("A2", 0.1), seed) for seed in range(3)]
    merge(saved(tmp_path, maps), tmp_path / "all", 3.2)
    expected = reduce(Map.merge, maps)
    save_map(tmp_path / "one.parquet", expected)
    names = ["level", "a", "b"]
    tiles = pq.read_table(tmp_path / "all", filters=None).sort_by([(n, "ascending") for n in names])
    one = pq.read_table(tmp_path / "one.parquet")
    assert tiles.select(one.column_names).equals(one.select(one.column_names))
    # A tile says of itself what a map file says, and its rows are sorted.
    tile = sorted((tmp_path / "all").glob("*.parquet"))[0]
    assert load_map(tile).sources() == expected.sources()
    assert pq.read_schema(tile).equals(pq.read_schema(tmp_path / "one.parquet"))


def test_a_rerun_leaves_no_tile_of_the_run_before(tmp_path: Path) -> None:
    maps = [some_map(Lattice.named("Z2", 0.1), seed) for seed in range(3)]
    paths, out = saved(tmp_path, maps), tmp_path / "all"
    merge(paths, out, 3.2)
    # What a killed run may leave: tiles that no manifest names, and a folder of half-written ones.
    (out / "tile_9_9.0123456789abcdef.parquet").write_bytes(b"stale")
    (out / ".new-1-00000000").mkdir()
    (out / ".new-1-00000000" / "tile_0_0").write_bytes(b"half")
    assert open_map(out) == reduce(Map.merge, maps)
    folder = merge(paths[:2], out, 1.6)
    assert {p.name for p in out.iterdir()} == {"_manifest.json", *(t.file for t in folder.tiles)}
    assert open_map(out) == maps[0].merge(maps[1])
    # The folder may be one of those that are merged.
    merge([out, paths[2]], out, 1.6)
    assert open_map(out) == reduce(Map.merge, maps)
    assert {p.name for p in tmp_path.iterdir()} == {"0.parquet", "1.parquet", "2.parquet", "all"}


def test_what_cannot_be_merged_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    squares = Lattice.named("Z2", 0.1)
    full = VoxelList.from_cells([[3, 4]], squares, [2**62])
    huge = [Map([Level(full, VoxelList.empty(squares))], "map", [f"{i}"]) for i in range(2)]
    paths = saved(tmp_path, [*huge, some_map(squares, 1), some_map(Lattice.named("A2", 0.1), 2)])
    with pytest.raises(BoundsError, match=r"cell \(3, 4\) add up to 9223372036854775808, beyond"):
        merge(paths[:2], tmp_path / "all", 1.0)
    assert not (tmp_path / "all").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    (tmp_path / "empty").mkdir()
    for arguments, code, words in (
        ((paths[2], paths[3], "-o", tmp_path / "all", "--tiles", 1), 1, "on different lattices"),
        ((paths[2], paths[2], "-o", tmp_path / "all", "--tiles", 1), 1, "would count twice; --again does that"),
        ((paths[2], "-o", tmp_path / "other", "--tiles", 1), 1, "holds something else, notes.txt"),
        ((paths[2], "-o", tmp_path / "all.parquet", "--tiles", 1), 1, "the map is a folder"),
        ((paths[2], "-o", tmp_path / "all", "--tiles", 0), 2, "tiles are a positive number"),
        ((paths[2], paths[2], "-o", tmp_path / "all", "--tiles", 1, "--align"), 2, "--align"),
        ((tmp_path / "empty", paths[2], "-o", tmp_path / "all", "--tiles", 1), 1, "not a map"),
    ):
        capsys.readouterr()
        assert main(["merge", *map(str, arguments)]) == code
        out, err = capsys.readouterr()
        assert out == "" and err.count("\n") == 1 and words in err, err
    assert not (tmp_path / "all").exists() and (tmp_path / "other" / "notes.txt").exists()


def test_a_damaged_row_or_manifest_is_named(tmp_path: Path) -> None:
    squares = Lattice.named("Z2", 0.1)
    (path,) = saved(tmp_path, [some_map(squares, 1)])
    table = pq.read_table(path)
    swapped = table.take([*range(7), 8, 7, *range(9, len(table))])
    pq.write_table(swapped, tmp_path / "swapped.parquet")
    with pytest.raises(FormatError, match=r"swapped.parquet: damaged map: row \d+, index .* is not sorted"):
        merge([tmp_path / "swapped.parquet"], tmp_path / "all", 1.0)
    merge([path], tmp_path / "all", 1.0)
    manifest = tmp_path / "all" / "_manifest.json"
    text = manifest.read_text()
    for content, words in (
        (text[:-20], "not JSON"), (text.replace('"rows": 1', '"rows": 2', 1), "checksum"), ("{}", "not the manifest"),
        (text.replace('"format": 1, "map"', '"format": 2, "map"'), "newer hexmap"),
    ):  # fmt: skip
        manifest.write_text(content)
        with pytest.raises(FormatError, match=words):
            MapFolder.open(tmp_path / "all")
    manifest.unlink()
    with pytest.raises(FormatError, match="a folder, but not a map: it has no _manifest"):
        open_map(tmp_path / "all")


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a room, its map, and the same as tiles."""
    here = tmp_path_factory.mktemp("room")
    assert main(["simulate", "room", "-o", f"{here}/room.clf", "--truth", f"{here}/room.tum", "--duration", "8"]) == 0
    assert main(["build", f"{here}/room.clf", "-o", f"{here}/one.parquet", "--poses", f"{here}/room.tum"]) == 0
    assert main(["merge", f"{here}/one.parquet", "-o", f"{here}/all", "--tiles", "3.2"]) == 0
    return here


def around_the_start(room: Path) -> tuple[float, float, str]:
    x, y = (float(word) for word in (room / "room.tum").read_text().split()[1:3])
    return x, y, f"{x - 2},{y - 2},{x + 2},{y + 2}"


def same_outputs(room: Path, tmp_path: Path, *commands: tuple[str, ...]) -> None:
    """Run commands on the map and on its tiles, and compare what they write."""
    results = []
    for source in ("one.parquet", "all"):
        (here := tmp_path / source).mkdir()
        for command, *words in commands:
            assert main([command, str(room / source), *(word.replace("OUT", str(here)) for word in words)]) == 0
        results.append([path.read_bytes() for path in sorted(here.iterdir())])
    assert results[0] == results[1] and len(results[0]) == len(commands)


def test_info_and_export_take_a_map_of_tiles(room: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    known = load_map(room / "one.parquet")
    assert open_map(room / "all") == known
    capsys.readouterr()
    assert main(["info", str(room / "all")]) == 0
    text = capsys.readouterr().out
    assert f"{len(known.levels[0].hits):,d}" in text and "tiles of 60 x 60 cells" in text and "from room.clf" in text
    assert main(["info", "--config", str(room / "all")]) == 0
    _, _, box = around_the_start(room)
    same_outputs(room, tmp_path, ("export", "--crop", box, "-o", "OUT/a.csv"), ("export", "-o", "OUT/b.ply"))


@pytest.mark.long
def test_show_plan_and_localise_take_a_map_of_tiles(room: Path, tmp_path: Path) -> None:
    x, y, box = around_the_start(room)
    same_outputs(
        room, tmp_path, ("show", "--crop", box, "-o", "OUT/a.png"),
        ("plan", "--from", f"{x} {y}", "--to", f"{x + 0.5} {y}", "--crop", box, "-o", "OUT/b.csv"),
        ("localise", str(room / "room.clf"), "-o", "OUT/c.tum"),
    )  # fmt: skip


@pytest.mark.long
def test_a_killed_merge_leaves_the_old_map_or_the_new_one(tmp_path: Path) -> None:
    maps = [some_map(Lattice.named("A2", 0.1), seed, 200_000, spread=400.0) for seed in range(4)]
    paths, out = saved(tmp_path, maps), tmp_path / "all"
    old, new = maps[0], reduce(Map.merge, maps)
    merge(paths[:1], out, 51.2)
    command = [sys.executable, "-m", "hexmap", "merge", *map(str, paths), "-o", str(out), "--tiles", "51.2"]
    command += ["--workers", "2"]
    begin = time.monotonic()
    subprocess.run(command, check=True, capture_output=True)
    whole = time.monotonic() - begin
    assert open_map(out) == new
    reference = contents(out)
    rng = np.random.default_rng(5)
    for _ in range(6):
        merge(paths[:1], out, 51.2)
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(rng.uniform(0.3 * whole, whole))
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert open_map(out) in (old, new)
    merge(paths, out, 51.2)
    assert contents(out) == reference


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_workers_killed_or_not_write_the_same_tiles(tmp_path: Path) -> None:
    maps = [some_map(Lattice.named("A2", 0.1), seed, 20_000, spread=200.0) for seed in range(3)]
    paths = saved(tmp_path, maps)
    merge(paths, tmp_path / "one", 25.6)
    steps: list[tuple[int, int]] = []
    with ThreadPoolExecutor(1) as thread:
        killed = thread.submit(kill_a_worker)
        merge(paths, tmp_path / "two", 25.6, workers=2, progress=lambda *now: steps.append(now))
        assert killed.result(timeout=PATIENCE) not in children(os.getpid())
    assert contents(tmp_path / "two") == contents(tmp_path / "one")
    rows = sum(len(level.columns()[0]) for map in maps for level in map.levels)
    assert steps == sorted(steps) and steps[-1] == (rows, rows)
    assert main(["merge", *map(str, paths), "-o", str(tmp_path / "one.parquet"), "--workers", "2"]) == 2
    assert main(["merge", *map(str, paths), "-o", str(tmp_path / "one"), "--tiles", "3.2", "--workers", "0"]) == 2


def kill_a_worker() -> int:
    """Kill a process that this one starts to merge, as soon as it has opened what it needs for that."""

    def one_that_merges() -> int | None:
        for pid in sorted(children(os.getpid())):
            with contextlib.suppress(OSError):
                if "pyarrow" in Path(f"/proc/{pid}/maps").read_text():
                    return pid
        return None

    pid = wait_until(one_that_merges)
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    return pid


def test_parts_find_rows_out_of_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexmap.io.map_file._GROUP", 20)
    (path,) = saved(tmp_path, [some_map(Lattice.named("A2", 0.1), 1, levels=1)])
    table = pq.read_table(path)
    # The row groups of the file in another order, each of them sorted: a part that begins in the middle passes over
    # those before it.
    for swap in ((0, 3), (2, 4), (1, 5)):
        order = list(range(len(table) // 20))
        order[swap[0]], order[swap[1]] = order[swap[1]], order[swap[0]]
        with pq.ParquetWriter(tmp_path / "bad.parquet", table.schema) as writer:
            for k in order:
                writer.write_table(table.slice(20 * k, 20))
        with (
            ThreadPoolExecutor(2) as executor,
            pytest.raises(FormatError, match=r"bad.parquet: damaged map: row .* is not sorted"),
        ):
            merge([tmp_path / "bad.parquet"], tmp_path / "all", 0.4, executor=executor)
        assert not (tmp_path / "all").exists()


def test_a_part_reads_the_row_groups_that_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexmap.io.map_file._GROUP", 20)
    (path,) = saved(tmp_path, [some_map(Lattice.named("A2", 0.1), 1, levels=1)])
    metadata = pq.read_metadata(path)
    assert metadata.num_row_groups >= 5
    content = bytearray(path.read_bytes())
    column = metadata.row_group(0).column(1)  # the first of all pages with indices
    content[column.data_page_offset : column.data_page_offset + column.total_compressed_size] = bytes(
        column.total_compressed_size
    )
    path.write_bytes(content)
    rows = row_streams.MapRows(path)
    (begin, end), low = rows.level_ends().tolist(), metadata.row_group(2).column(1).statistics.max
    later = row_streams.RowStream(rows, rows.first_row(begin, end, low), end, 37)
    assert later.head() is not None and len(later.take(later.last())[0]) == min(37, end - 40)
    with pytest.raises(FormatError, match="damaged map"):
        row_streams.RowStream(rows, rows.first_row(begin, end, -1000), end, 37).head()
    rows.close()


def test_streams_take_rows_of_files_without_statistics(tmp_path: Path) -> None:
    map = some_map(Lattice.named("D3", 0.1), 3)
    (path,) = saved(tmp_path, [map])
    table = pq.read_table(path)
    pq.write_table(table, tmp_path / "plain.parquet", write_statistics=False, row_group_size=50)
    assert row_streams.MapRows(tmp_path / "plain.parquet").level_ends().tolist()[-1] == len(table)
    merge([tmp_path / "plain.parquet"], tmp_path / "all", 1.0)
    assert open_map(tmp_path / "all") == map
