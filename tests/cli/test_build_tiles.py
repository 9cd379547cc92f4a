"""``hexmap build --tiles``: the folder that building a file and cutting it gives; what is said; what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from hexmap.cli import main
from hexmap.io import map_store
from hexmap.io.map_folder import MapFolder
from tests.cli.test_cli import failure
from tests.lattices import JIT

pytestmark = pytest.mark.skipif(not JIT, reason="whole drives take minutes without the compiler")
TILES = ("--tiles", 2)


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("tiles")
    drive = ("--truth", folder / "room.tum", "--seed", 7, "--beams", 61, "--duration", 12)
    assert call("simulate", "room", "-o", folder / "room.clf", *drive) == 0
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("how", ["given poses", "loops"])
def test_a_folder_is_the_file_cut_into_tiles(
    how: str, here: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # A checkpoint knows nothing of the map.
    options = ("--poses", here / "room.tum") if how == "given poses" else ("--checkpoint", tmp_path / "kept")
    log = here / "room.clf"
    assert call("build", log, "-o", tmp_path / "m.parquet", "--picture", tmp_path / "m.png", *options) == 0
    assert call("merge", tmp_path / "m.parquet", "-o", tmp_path / "cut", *TILES) == 0
    spilled: list[int] = []
    plain = map_store.FolderStore.finish
    monkeypatch.setattr(
        map_store.FolderStore, "finish", lambda self, *rest: (spilled.append(len(self.parts)), plain(self, *rest))[1]
    )
    monkeypatch.setattr(map_store.FolderStore.__init__, "__defaults__", (1 << 16,))
    capsys.readouterr()
    assert call("build", log, "-o", tmp_path / "tiles", *TILES, "--picture", tmp_path / "t.png", *options) == 0
    assert spilled[0] > 1
    assert contents(tmp_path / "tiles") == contents(tmp_path / "cut")
    assert (tmp_path / "t.png").read_bytes() == (tmp_path / "m.png").read_bytes()
    folder = MapFolder.open(tmp_path / "tiles")
    hit = folder.totals()[0]["hit_cells"]
    said = f"wrote {tmp_path / 'tiles'}  ({len(folder.tiles)} tiles, 3 levels, {hit} cells hit, hexagonal)"
    assert said in capsys.readouterr().out
    # Again onto the old one, which is replaced.
    assert call("build", log, "-o", tmp_path / "tiles", "--tiles", 4, *options) == 0
    assert 1 < len(contents(tmp_path / "tiles")) < len(contents(tmp_path / "cut"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cut", "m.parquet", "m.png", "t.png", "tiles"]


def test_what_needs_the_whole_map_is_refused_in_one_line(
    here: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, out = here / "room.clf", tmp_path / "tiles"
    for options, word in (
        (("--no-loop-closure",), "--no-loop-closure"),
        (("--continue", here / "old.parquet"), "--continue"),
        ((log,), "several logs"),
        (("--fleet",), "--tiles is of one map"),
        (("--tiles", "0"), "positive number of metres"),
        (("--tiles", "nan"), "positive number of metres"),
    ):
        assert word in failure(capsys, "build", log, "-o", out, *TILES, *options, code=2), options
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "old").mkdir()
    for given, options, word in (
        (tmp_path, (), "something else, notes.txt"),
        (tmp_path / "no" / "tiles", (), "no folder"),
        (tmp_path / "notes.txt", (), "is a file"),
        (tmp_path / "m.parquet", (), "names a file"),
        (tmp_path / "old", ("--trajectory", tmp_path / "old" / "a.tum"), "holds nothing but its tiles"),
    ):
        assert word in failure(capsys, "build", log, "-o", given, *TILES, *options), word
    assert sorted(p.name for p in tmp_path.iterdir()) == ["notes.txt", "old"]
