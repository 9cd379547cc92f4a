"""Maps are merged where their frames are the same, or where it is said how they lie; no log counts twice by mistake."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from hexmap.cli import main
from hexmap.io.map_file import load_map, save_map
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.origin import common_logs, frames_of
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from tests.lattices import CASES, Case


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Maps of two logs by matching, of one of them again, and of both at given poses."""
    here = tmp_path_factory.mktemp("merge")
    for name, seed in (("one", 1), ("two", 2)):
        log, truth = here / f"{name}.clf", here / f"{name}.tum"
        assert call("simulate", "room", "-o", log, "--truth", truth, "--seed", seed, "--duration", 6) == 0
        assert call("build", log, "-o", here / f"{name}.parquet", "--no-loop-closure") == 0
    copy = here / "copy.clf"
    copy.write_bytes((here / "one.clf").read_bytes())
    assert call("build", copy, "-o", here / "copy.parquet", "--no-loop-closure") == 0
    assert call("build", here / "one.clf", "-o", here / "given.parquet", "--poses", here / "one.tum") == 0
    return here


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


def failure(capsys: pytest.CaptureFixture[str], code: int, *arguments: object) -> str:
    capsys.readouterr()
    assert call(*arguments) == code
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1
    return err


def test_maps_of_different_logs_are_in_different_frames(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two, out = folder / "one.parquet", folder / "two.parquet", folder / "out.parquet"
    text = failure(capsys, 1, "merge", one, two, "-o", out)
    assert "two.parquet: cannot be merged with" in text and "different frames, of one.clf and of two.clf" in text
    assert all(way in text for way in ("--align", "--transform X Y DEGREES", "--same-frame"))
    assert not out.exists()
    assert call("merge", one, two, "--same-frame", "-o", out) == 0
    a, b, merged = load_map(one), load_map(two), load_map(out)
    assert merged == a.merge(b, same_frame=True) == b.merge(a, same_frame=True)
    # Once declared the same, a map in either frame goes with it.
    assert frames_of(merged.sources()).keys() == frames_of(a.sources()).keys() | frames_of(b.sources()).keys()
    assert call("merge", out, two, "--again", "-o", folder / "more.parquet") == 0


def test_info_says_once_what_all_logs_of_a_map_have_in_common(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both, mixed = folder / "both.parquet", folder / "mixed.parquet"
    assert call("merge", folder / "one.parquet", folder / "two.parquet", "--same-frame", "-o", both) == 0
    capsys.readouterr()
    assert call("info", both) == 0
    text = capsys.readouterr().out
    assert text.count("from one.clf") == text.count("from two.clf") == 1
    assert text.count("versions") == text.count("configuration") == text.count('"search_metres"') == 1
    assert "configuration (for --config):" in text
    other = load_map(folder / "two.parquet")
    changed = [json.dumps({**s, "settings": {**s["settings"], "min_range": 0.5}}) for s in other.sources()]
    save_map(folder / "odd.parquet", Map(other.levels, other.frame, changed))
    assert call("merge", folder / "one.parquet", folder / "odd.parquet", "--same-frame", "-o", mixed) == 0
    capsys.readouterr()
    assert call("info", mixed) == 0
    text = capsys.readouterr().out
    assert "configuration of one.clf:" in text and "configuration of two.clf:" in text and "--config" not in text


def test_a_transform_says_where_a_map_lies(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, two, out = folder / "one.parquet", folder / "two.parquet", folder / "moved.parquet"
    assert call("merge", one, two, "--transform", 1.0, -2.0, 90, "-o", out) == 0
    a, b, merged = load_map(one), load_map(two), load_map(out)
    moved = b.transform(Pose.planar(1.0, -2.0, math.radians(90)))
    assert merged.levels == a.merge(moved, same_frame=True).levels
    assert frames_of(merged.sources()).keys() == frames_of(a.sources()).keys()
    source = next(s for s in merged.sources() if s["log"] == "two.clf")
    assert np.allclose(source["moved"]["translation"], [1.0, -2.0])
    # One map is moved by itself, and is in no frame that is known.
    assert call("merge", two, "--transform", 1.0, -2.0, 90, "-o", out) == 0
    assert load_map(out) == moved
    assert frames_of(moved.sources()) == {}
    capsys.readouterr()
    for arguments in (
        (one, two, one, "--transform", 1, 2, 3), (one, two, "--transform", 1, 2, "nan"),
        (one, two, "--align", "--same-frame"), (one, two, "--transform", 1, 2, 3, "--same-frame"), (one,),
    ):  # fmt: skip
        failure(capsys, 2, "merge", *arguments, "-o", folder / "no.parquet")
    assert not (folder / "no.parquet").exists()


def test_the_same_log_counts_once(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    one, copy, out = folder / "one.parquet", folder / "copy.parquet", folder / "again.parquet"
    for other in (one, copy):
        text = failure(capsys, 1, "merge", one, other, "-o", out)
        assert "would count twice; --again does that" in text
    assert common_logs(load_map(one).sources(), load_map(copy).sources()) == ["copy.clf"]
    assert call("merge", one, copy, "--again", "-o", out) == 0
    assert load_map(out).levels[0].hits.total == 2 * load_map(one).levels[0].hits.total
    # Posed in another way, the same log is in another frame.
    text = failure(capsys, 1, "merge", one, folder / "given.parquet", "--again", "-o", out)
    assert "both of one.clf, posed in two ways" in text


def test_counts_that_would_wrap_are_an_error_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    squares = Lattice.named("Z2")
    full = VoxelList.from_cells([[3, 4]], squares, [2**62])
    save_map(tmp_path / "a.parquet", Map([Level(full, VoxelList.empty(squares))]))
    out = tmp_path / "out.parquet"
    text = failure(capsys, 1, "merge", tmp_path / "a.parquet", tmp_path / "a.parquet", "-o", out)
    assert "the counts of cell (3, 4) add up to" in text and not out.exists()


@pytest.mark.parametrize("case", CASES, ids=str)
def test_maps_without_an_identity_merge_as_they_are(case: Case) -> None:
    cells = VoxelList.from_cells([[0] * case.dim], case.lattice)
    plain = Map([Level(cells, cells)])
    known = Map([Level(cells, cells)], provenance=['{"frame": "x", "log": "a"}'])
    other = Map([Level(cells, cells)], provenance=['{"frame": "y", "log": "b"}'])
    assert plain.merge(known) == known.merge(plain)
    with pytest.raises(ValueError, match="of a and of b"):
        known.merge(other)
    assert known.transform(Pose.identity(case.dim)) == known


def test_a_part_of_a_map_is_the_same_from_a_file_and_from_tiles(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, tiles = folder / "one.parquet", tmp_path / "tiles"
    assert call("merge", whole, "-o", tiles, "--tiles", 1.6) == 0
    low, high = load_map(whole).bounds()
    middle = (low + high) / 2.0
    box = ",".join(str(v) for v in (*low, *middle))
    parts = [tmp_path / f"part-{k}.parquet" for k in range(2)]
    for source, part in zip((whole, tiles), parts, strict=True):
        assert call("crop", source, "--box", box, "-o", part) == 0
    assert parts[0].read_bytes() == parts[1].read_bytes()
    part = load_map(parts[0])
    assert 0 < len(part.levels[0].hits) < len(load_map(whole).levels[0].hits)
    assert (part.levels[0].hits.centres() <= middle).all()
    capsys.readouterr()
    for words, code, said in (
        (("--box", "0,0,1"), 2, "4 or 6 numbers"),
        (("--box", "0,0,0,1,1,1"), 2, "--box takes 4 numbers"),
        (("--box", "900,900,901,901"), 1, "no cell of the map lies in the box"),
    ):
        assert call("crop", whole, *words, "-o", tmp_path / "none.parquet") == code
        assert said in capsys.readouterr().err
    assert not (tmp_path / "none.parquet").exists()
