"""Map files: what goes in comes out, what is not a map is refused in one line, what is killed leaves the old."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hexmap.base.errors import FileAccessError, FormatError, HexmapError
from hexmap.io.map_file import FORMAT_VERSION, load_map, read_metadata, save_map
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from tests.lattices import CASES

each_lattice = pytest.mark.parametrize("lattice", [case.lattice for case in CASES], ids=[str(case) for case in CASES])


def random_map(lattice: Lattice, seed: int = 0, count: int = 300, levels: int = 3) -> Map:
    rng = np.random.default_rng(seed)
    hits, passes = rng.uniform(-2, 2, (count, lattice.dim)), rng.uniform(-2, 2, (3 * count, lattice.dim))
    made = []
    for k in range(levels):
        at = lattice.scaled(2.0**k)
        made.append(Level(VoxelList.from_points(hits, at), VoxelList.from_points(passes, at)))
    source = json.dumps({"log": "a.clf", "settings": {"resolution": 0.1, "max_range": 80.0}}, sort_keys=True)
    return Map(made, "map", [source])


def empty_map(lattice: Lattice) -> Map:
    return Map([Level(VoxelList.empty(lattice), VoxelList.empty(lattice))])


@pytest.fixture
def hexagons() -> Lattice:
    return Lattice.named("A2", resolution=0.1)


@pytest.fixture
def saved(tmp_path: Path, hexagons: Lattice) -> Path:
    save_map(tmp_path / "map.parquet", random_map(hexagons))
    return tmp_path / "map.parquet"


def refused(path: Path) -> str:
    """Load a file that is no map; return the message after checking its manners."""
    with pytest.raises(FormatError) as caught:
        load_map(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text and text.isprintable() and len(text) < len(str(path)) + 240
    return text[len(str(path)) + 2 :]


def rewrite(path: Path, table: pa.Table) -> None:
    pq.write_table(table, path, compression="zstd")


def edit_header(path: Path, **changes: object) -> None:
    table = pq.read_table(path)
    header = json.loads(table.schema.metadata[b"hexmap"])
    header.pop("crc32")
    for key, value in changes.items():
        header[key] = value
    rewrite(path, table.replace_schema_metadata({b"hexmap": json.dumps(header).encode()}))


# ---------------------------------------------------------------------- round trips


@each_lattice
def test_round_trip(lattice: Lattice, tmp_path: Path) -> None:
    map_ = random_map(lattice)
    save_map(tmp_path / "m.parquet", map_)
    loaded = load_map(tmp_path / "m.parquet")
    assert loaded == map_
    assert loaded.lattice.name == lattice.name
    assert [level.lattice for level in loaded.levels] == [level.lattice for level in map_.levels]


@each_lattice
def test_empty_maps_round_trip(lattice: Lattice, tmp_path: Path) -> None:
    save_map(tmp_path / "m.parquet", empty_map(lattice))
    assert load_map(tmp_path / "m.parquet") == empty_map(lattice)


@pytest.mark.parametrize("name", ["A2", "D3"])
def test_outermost_cells_and_large_counts_round_trip(name: str, tmp_path: Path) -> None:
    lattice = Lattice.named(name, resolution=0.1)
    far = lattice.limit - 1
    cells = [[-far] * lattice.dim, [far] * lattice.dim]
    hits = VoxelList.from_cells(cells, lattice, [2**62, 1])
    map_ = Map([Level(hits, VoxelList.from_cells(cells, lattice))])
    save_map(tmp_path / "m.parquet", map_)
    assert load_map(tmp_path / "m.parquet") == map_


def test_provenance_comes_back_letter_by_letter(tmp_path: Path, hexagons: Lattice) -> None:
    texts = ['{"b": 1, "a": 2}', '{"a": 1}', "not JSON", '"text"', '{"max_range": Infinity}', '{"log": "Bü.clf"}']
    cells = VoxelList.empty(hexagons)
    map_ = Map([Level(cells, cells)], "käfer", texts)
    save_map(tmp_path / "m.parquet", map_)
    loaded = load_map(tmp_path / "m.parquet")
    assert loaded.provenance == tuple(sorted(texts)) and loaded.frame == "käfer"
    raw = pq.read_schema(tmp_path / "m.parquet").metadata[b"hexmap"]
    json.loads(raw, parse_constant=lambda value: pytest.fail(f"{value} is not JSON"))


def test_same_map_same_bytes(tmp_path: Path, hexagons: Lattice) -> None:
    a, b = random_map(hexagons, 1), random_map(hexagons, 2)
    save_map(tmp_path / "ab.parquet", a.merge(b))
    time.sleep(0.01)
    save_map(tmp_path / "ba.parquet", b.merge(a))
    assert (tmp_path / "ab.parquet").read_bytes() == (tmp_path / "ba.parquet").read_bytes()


def test_metadata_says_what_the_file_is(saved: Path, hexagons: Lattice) -> None:
    about = read_metadata(saved)
    assert about["format"] == FORMAT_VERSION and about["kind"] == "map" and about["levels"] == 3
    assert about["lattice"] == {"name": "A2", "basis": hexagons.basis.tolist()}
    assert about["provenance"] == [{"log": "a.clf", "settings": {"max_range": 80.0, "resolution": 0.1}}]
    assert set(about["versions"]) == {"hexmap", "numpy", "pyarrow", "python"}
    assert about["resolution"] == pytest.approx(0.1)


# ---------------------------------------------------------------------- other tools


@each_lattice
def test_any_reader_sees_a_plain_table(lattice: Lattice, tmp_path: Path) -> None:
    map_ = random_map(lattice)
    save_map(tmp_path / "m.parquet", map_)
    table = pq.read_table(tmp_path / "m.parquet")
    axes = ["a", "b", "c"][: lattice.dim]
    assert table.column_names == ["level", *axes, "hits", "passes"]
    finest = table.filter(pa.compute.equal(table["level"], 0))
    assert sum(finest["hits"].to_pylist()) == map_.levels[0].hits.total
    rows = np.column_stack([table[name].to_numpy() for name in ["level", *axes]])
    assert (rows == rows[np.lexsort(rows.T[::-1])]).all()


def test_cut_rows_are_a_map(saved: Path) -> None:
    table = pq.read_table(saved)
    before = load_map(saved)
    rewrite(saved, table.slice(100, 500))
    after = load_map(saved)
    assert 0 < len(after.levels[0].hits) < len(before.levels[0].hits)


def test_rows_concatenated_and_summed_are_the_merged_map(tmp_path: Path, hexagons: Lattice) -> None:
    a, b = random_map(hexagons, 1), random_map(hexagons, 2)
    paths = [tmp_path / "a.parquet", tmp_path / "b.parquet"]
    for path, map_ in zip(paths, (a, b), strict=True):
        save_map(path, map_)
    both = pa.concat_tables([pq.read_table(path) for path in paths])
    keys = ["level", "a", "b"]
    summed = both.group_by(keys).aggregate([("hits", "sum"), ("passes", "sum")])
    summed = summed.rename_columns([*keys, "hits", "passes"]).sort_by([(key, "ascending") for key in keys])
    rewrite(tmp_path / "ab.parquet", summed.replace_schema_metadata(both.schema.metadata))
    assert load_map(tmp_path / "ab.parquet") == a.merge(b)


# ---------------------------------------------------------------------- what is no map


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(FileAccessError, match="No such file"):
        load_map(tmp_path / "none.parquet")
    with pytest.raises(FileAccessError, match="directory"):
        load_map(tmp_path)
    with pytest.raises(FileAccessError, match="there is no folder"):
        save_map(tmp_path / "none" / "m.parquet", empty_map(Lattice.named("Z2")))


_ODD = [b"", b"PAR", b"hello there", b"PAR1", b"PAR1PAR1", b"PAR1" + b"\xff" * 50 + b"PAR1"]


@pytest.mark.parametrize("content", _ODD)
def test_foreign_files(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.parquet").write_bytes(content)
    refused(tmp_path / "x.parquet")


def test_truncated_anywhere(saved: Path) -> None:
    content = saved.read_bytes()
    for size in (5, 100, len(content) // 2, len(content) - 9, len(content) - 1):
        saved.write_bytes(content[:size])
        assert "cut off" in refused(saved)


def test_flipped_bits_never_pass_for_another_map(saved: Path) -> None:
    content, original = saved.read_bytes(), load_map(saved)
    rng = np.random.default_rng(0)
    # The end of the file, which has no checksum of Parquet's own, gets most of them.
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    for place in [
        *rng.integers(0, footer, 100),
        *rng.integers(footer, footer + 700, 400),
        *rng.integers(footer, len(content), 200),
    ]:
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        saved.write_bytes(damaged)
        try:
            assert load_map(saved) == original
        except HexmapError as error:
            assert "\n" not in str(error)


def test_foreign_parquet(tmp_path: Path) -> None:
    rewrite(tmp_path / "x.parquet", pa.table({"level": [1], "a": [1]}))
    assert "no metadata 'hexmap'" in refused(tmp_path / "x.parquet")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"format": 2}, "newer hexmap: format version 2"),
        ({"format": 0}, "format version is 0"),
        ({"format": "1"}, "format version is '1'"),
        ({"kind": "trajectory"}, "not a map: its metadata says 'trajectory'"),
        ({"frame": 3}, "frame is 3"),
        ({"provenance": [1]}, "provenance"),
        ({"levels": 2}, "row .* is on a level that is not among 0 to 1"),
        ({"levels": 0}, "it has 0 levels"),
        ({"levels": True}, "it has True levels"),
        ({"lattice": {"name": "A2"}}, "lattice"),
        ({"lattice": None}, "lattice"),
        ({"lattice": {"basis": [[1, 2], [2, 4]]}}, "independent"),
        ({"lattice": {"basis": [[1, 2, 3]]}}, "must be"),
        ({"lattice": {"basis": "A2"}}, "lattice"),
        ({"resolution": 0.2}, "states a resolution of 0.2"),
        ({"resolution": None}, "states a resolution of None"),
        ({"crc32": 1}, "checksum"),
    ],
)
def test_wrong_metadata(changes: dict[str, object], words: str, saved: Path) -> None:
    edit_header(saved, **changes)
    text = refused(saved)
    assert re.search(words, text), text


@pytest.mark.parametrize("text", [b"{", b"[]", b"{}", b"\xff", b"[" * 100_000])
def test_metadata_that_is_not_ours(text: bytes, saved: Path) -> None:
    rewrite(saved, pq.read_table(saved).replace_schema_metadata({b"hexmap": text}))
    refused(saved)


def test_missing_repeated_and_mistyped_columns(saved: Path) -> None:
    table = pq.read_table(saved)
    rewrite(saved, table.drop_columns(["passes"]))
    assert "no columns 'passes'" in refused(saved)
    rewrite(saved, table.append_column("hits", table["hits"]))
    assert "2 columns 'hits'" in refused(saved)
    for values in (pa.array(np.zeros(len(table))), pa.array(["x"] * len(table))):
        rewrite(saved, table.set_column(1, "a", values))
        assert "column 'a' holds" in refused(saved)
    rewrite(saved, table.set_column(3, "hits", pa.array([None, *[1] * (len(table) - 1)], pa.int64())))
    assert "'hits' has empty values" in refused(saved)


@pytest.mark.parametrize("kind", [pa.int16(), pa.int64(), pa.uint64()])
def test_any_width_of_integer_will_do(kind: pa.DataType, saved: Path) -> None:
    before, table = load_map(saved), pq.read_table(saved)
    rewrite(saved, table.set_column(4, "passes", table["passes"].cast(kind)))
    assert load_map(saved) == before


def changed(path: Path, column: str, row: int, value: int) -> str:
    """Set one value and return what loading says to it."""
    table = pq.read_table(path)
    values = table[column].to_numpy().astype(np.int64)
    values[row] = value
    rewrite(path, table.set_column(table.column_names.index(column), column, pa.array(values)))
    return refused(path)


@pytest.mark.parametrize(
    ("column", "row", "value", "words"),
    [
        ("hits", 7, -1, "row 7 (level 0, index ("),
        ("passes", 7, -3, "negative number of passes"),
        ("a", 0, -(2**31), "index out of range"),
        ("b", 3, 2**40, "index out of range"),
        ("b", 3, 2**31 - 2, "not sorted by level and index"),
        ("level", 0, 1, "not sorted by level and index"),
        ("level", 0, -1, "level that is not among"),
    ],
)
def test_wrong_rows(column: str, row: int, value: int, words: str, saved: Path) -> None:
    assert words in changed(saved, column, row, value)


def test_repeated_rows(saved: Path) -> None:
    table = pq.read_table(saved)
    rewrite(saved, pa.concat_tables([table.slice(0, 5), table.slice(4)]))
    assert "row 5" in refused(saved)
    assert "repeats the cell" in refused(saved)


def test_extreme_keys_out_of_order_are_found(tmp_path: Path, hexagons: Lattice) -> None:
    far = hexagons.limit - 1
    cells = VoxelList.from_cells([[-far, 0], [far, 0]], hexagons)
    save_map(tmp_path / "m.parquet", Map([Level(cells, VoxelList.empty(hexagons))]))
    table = pq.read_table(tmp_path / "m.parquet")
    rewrite(tmp_path / "m.parquet", table.take([1, 0]))
    assert "not sorted" in refused(tmp_path / "m.parquet")


def test_rows_without_counts_are_left_out(saved: Path) -> None:
    table = pq.read_table(saved)
    zeros = pa.array(np.zeros(len(table), np.int64))
    rewrite(saved, table.set_column(3, "hits", zeros).set_column(4, "passes", zeros))
    assert all(len(level.hits) == len(level.passes) == 0 for level in load_map(saved).levels)


# ---------------------------------------------------------------------- writing

_SLOW_WRITER = """
import sys, time
import numpy as np
import pyarrow.parquet as pq
from hexmap.io import save_map
from hexmap.lattice import Lattice
from hexmap.maps import Level, Map
from hexmap.maps import VoxelList

write_table = pq.ParquetWriter.write_table

def slow(writer, table):
    write_table(writer, table)
    print("half", flush=True)
    time.sleep(60)

pq.ParquetWriter.write_table = slow
lattice = Lattice.named("A2", resolution=0.1)
cells = VoxelList.from_points(np.random.default_rng(0).uniform(-9, 9, (5000, 2)), lattice)
save_map(sys.argv[1], Map([Level(cells, VoxelList.empty(lattice))]))
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
@pytest.mark.parametrize("name", ["SIGKILL", "SIGINT"])
def test_a_killed_write_leaves_the_old_file(name: str, saved: Path) -> None:
    before = saved.read_bytes()
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])}
    with subprocess.Popen(
        [sys.executable, "-c", _SLOW_WRITER, str(saved)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=environment,
    ) as writer:
        assert writer.stdout is not None and writer.stdout.readline().strip() == b"half"
        assert len(list(saved.parent.iterdir())) == 2  # the old file and a half-written one
        writer.send_signal(getattr(signal, name))
        writer.wait(timeout=20)
    assert saved.read_bytes() == before
    if name == "SIGINT":
        assert list(saved.parent.iterdir()) == [saved]
    save_map(saved, load_map(saved))
    assert saved.read_bytes() == before


def test_a_failing_write_leaves_no_file(tmp_path: Path, hexagons: Lattice, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(pq.ParquetWriter, "write_table", fail)
    with pytest.raises(KeyboardInterrupt):
        save_map(tmp_path / "m.parquet", empty_map(hexagons))
    assert list(tmp_path.iterdir()) == []
