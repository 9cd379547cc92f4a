"""Maps as other programs write them: pictures of every kind as map_server reads them, YAML as yaml-cpp does."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hexmap.base.errors import FileAccessError, FormatError, TooLargeError
from hexmap.io.file_kinds import is_parquet
from hexmap.io.grids.grid_map import GridMap
from hexmap.io.grids.open_grid import is_grid, open_grid
from hexmap.io.map_file import load_map
from hexmap.maps.cell_state import CellState
from tests.io.grids.test_grids import FREE, OCCUPIED, YAML, octomap_bytes, ros, write

UNKNOWN = int(CellState.UNKNOWN)
GREYS = np.array([[0, 254, 205, 100], [254, 89, 90, 206]], np.uint8)


def picture(folder: Path, image: Image.Image, suffix: str = ".png", more: str = "", **options: object) -> GridMap:
    image.save(folder / f"m{suffix}", **options)
    return open_grid(write(folder / "m.yaml", YAML.replace("m.pgm", f"m{suffix}") + more))


def states(greys: np.ndarray) -> list[list[int]]:
    """The states that map_server gives to greys, as a grid has them."""
    p = (255.0 - greys) / 255.0
    found = np.where(p > 0.65, OCCUPIED, np.where(p < 0.196, FREE, UNKNOWN))
    return found[::-1].T.tolist()


def palette(order: np.ndarray, **options: object) -> Image.Image:
    """A picture with a palette, whose entries come in this order of greys."""
    where = np.searchsorted(np.sort(order), order).argsort()
    index = np.array([[int(np.where(order == g)[0][0]) for g in row] for row in GREYS], np.uint8)
    image = Image.fromarray(index).convert("P")
    image.putpalette([v for grey in order for v in (grey, grey, grey)] + [0] * (768 - 3 * len(order)))
    image.putdata(index.reshape(-1).tolist())
    assert len(where) == len(order)
    return image


@pytest.mark.parametrize("suffix", [".png", ".bmp"])
def test_a_palette_stands_for_its_colours_and_has_no_alpha_of_its_own(tmp_path: Path, suffix: str) -> None:
    grid = picture(tmp_path, palette(np.unique(GREYS)[::-1]), suffix)
    assert grid.states.tolist() == states(GREYS)


def test_a_palette_whose_entries_are_all_opaque_has_no_alpha_either(tmp_path: Path) -> None:
    image = palette(np.unique(GREYS))
    assert picture(tmp_path, image, transparency=bytes([255] * 8)).states.tolist() == states(GREYS)
    half = bytes([255, 255, 128, 255, 255, 255, 255])  # of the pixels of grey 90
    greys = GREYS.astype(float)
    mixed = np.where(GREYS == 90, (3 * greys + 128) / 4, (3 * greys + 255) / 4)
    assert np.unique(GREYS)[2] == 90
    assert picture(tmp_path, image, transparency=half).states.tolist() == states(mixed)


@pytest.mark.parametrize("mode", ["L", "RGB", "1"])
@pytest.mark.parametrize("suffix", [".png", ".bmp"])
def test_opaque_pictures_are_the_mean_of_their_colours(tmp_path: Path, mode: str, suffix: str) -> None:
    image = Image.fromarray(GREYS)
    if mode == "RGB":
        colours = np.stack([GREYS, GREYS // 2, np.minimum(255, GREYS + 9)], axis=2).astype(np.uint8)
        grid = picture(tmp_path, Image.fromarray(colours), suffix)
        assert grid.states.tolist() == states(colours.mean(axis=2))
        return
    image = image.convert(mode, dither=Image.Dither.NONE) if mode == "1" else image
    expected = np.asarray(image.convert("L"))
    assert picture(tmp_path, image, suffix).states.tolist() == states(expected)


@pytest.mark.parametrize("mode", ["LA", "RGBA"])
def test_an_alpha_is_averaged_in_where_the_mode_is_trinary_alone(tmp_path: Path, mode: str) -> None:
    alpha = np.array([[255, 255, 255, 0], [0, 255, 10, 255]], np.uint8)
    if mode == "LA":
        image = Image.merge("LA", [Image.fromarray(GREYS), Image.fromarray(alpha)])
    else:
        image = Image.fromarray(np.stack([GREYS, GREYS, GREYS, alpha], axis=2))
    mixed = (3.0 * GREYS + alpha) / 4.0
    assert picture(tmp_path, image).states.tolist() == states(mixed)
    assert picture(tmp_path, image, more="mode: scale\n").states.tolist() == states(GREYS)


def test_of_sixteen_bits_the_upper_eight_count(tmp_path: Path) -> None:
    values = (GREYS.astype(np.uint16) << 8) | 0xFF
    assert picture(tmp_path, Image.fromarray(values)).states.tolist() == states(GREYS)
    assert picture(tmp_path, Image.fromarray(values & 0xFF00)).states.tolist() == states(GREYS)


def test_a_colour_picture_of_netpbm(tmp_path: Path) -> None:
    colours = np.stack([GREYS, GREYS, GREYS // 2], axis=2)
    expected = states(colours.mean(axis=2))
    assert ros(tmp_path, b"P6 4 2 255\n" + colours.tobytes()).states.tolist() == expected
    text = b"P3 4 2 255\n" + b" ".join(str(v).encode() for v in colours.reshape(-1).tolist())
    assert ros(tmp_path, text).states.tolist() == expected


@pytest.mark.parametrize(
    "yaml",
    [
        '{"image": "m.pgm", "resolution": 0.5, "origin": [1.0, -2, 0], "negate": 0, "occupied_thresh": 0.65,\n'
        '  "free_thresh": 0.196}\n',
        YAML.replace("m.pgm", "\n  m.pgm").replace("0.5", "\n    0.5"),
        YAML.replace("m.pgm", ">-\n  m.pgm"),
        YAML.replace("[1.0, -2, 0]", "[\n  1.0,\n  -2,\n  0,\n]"),
        YAML + "layers: {walls: {image: other.pgm, resolution: 7}, list: [[1, 2], [3]]}\nnote: >\n  image: not this\n",
        YAML + "frame: map\nframe: odom\nnegate: 0\n",
        YAML + "? [a, list]\n: of keys\n",
        YAML.replace("negate: 0", "negate: !!int 0").replace("m.pgm", "!file m.pgm"),
        (YAML + "# ä\n").encode("utf-16"),
        b"\xef\xbb\xbf" + YAML.encode(),
    ],
)
def test_yaml_of_others(tmp_path: Path, yaml: str | bytes) -> None:
    write(tmp_path / "m.pgm", b"P5 2 1 255\n\x00\xfe")
    grid = open_grid(write(tmp_path / "m.yaml", yaml))
    assert grid.states.tolist() == [[OCCUPIED], [FREE]]
    assert (grid.cell, grid.origin.tolist()) == (0.5, [1.0, -2.0])


@pytest.mark.parametrize("name", ["ColorOcTree", "OcTreeStamped"])
def test_other_trees_of_occupancy_are_the_same_in_binary_form(tmp_path: Path, name: str) -> None:
    data = octomap_bytes(b"\x03\x00" * 15 + b"\x09\x00", 18)
    plain = open_grid(write(tmp_path / "a.bt", data))
    other = open_grid(write(tmp_path / "b.bt", data.replace(b"id OcTree", b"id " + name.encode())))
    assert np.array_equal(plain.states, other.states) and plain.origin.tolist() == other.origin.tolist()
    assert sorted(np.unique(plain.states)) == sorted({OCCUPIED, FREE})


def test_files_of_few_bytes_are_not_inflated_into_gigabytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(TooLargeError, match=r"1000 x 1000 x 1000 cells in a file of 21 bytes; at most 268435456"):
        open_grid(write(tmp_path / "a.3dmap", "voxel 1000 1000 1000\n"))
    with pytest.raises(TooLargeError, match=r"HEXMAP_MAX_INFLATION raises the limit"):
        open_grid(write(tmp_path / "a.bt", octomap_bytes(b"\x03\x00" * 6 + b"\x01\x80", 9)))
    with pytest.raises(TooLargeError, match="cells would take"):
        monkeypatch.setenv("HEXMAP_MAX_INFLATION", "1000000000")
        open_grid(write(tmp_path / "b.3dmap", "voxel 2000 2000 2000\n"))
    write(tmp_path / "m.png", small_png(40_000, 40_000))
    with pytest.raises(FormatError, match="cannot hold 40000 x 40000 pixels"):
        open_grid(write(tmp_path / "m.yaml", YAML.replace("m.pgm", "m.png")))


def small_png(width: int, height: int) -> bytes:
    import struct
    import zlib

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.map")
    (tmp_path / "zero.yaml").symlink_to("/dev/zero")
    for name, kind in (("pipe.map", "a pipe"), ("zero.yaml", "a device")):
        for reader in (open_grid, load_map):
            with pytest.raises(FileAccessError, match=rf"{name}: cannot be read: it is {kind}, not a regular file"):
                reader(tmp_path / name)
        assert not is_grid(tmp_path / name) and not is_parquet(tmp_path / name)
    path = write(tmp_path / "m.yaml", YAML.replace("m.pgm", "/dev/zero"))
    with pytest.raises(FileAccessError, match=r"m\.yaml, line 1: the image /dev/zero: .* it is a device"):
        open_grid(path)


def test_a_file_that_a_map_names_is_not_quoted(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        ros(tmp_path, b"root:x:0:0:secret")
    assert "root" not in str(caught.value).replace(str(tmp_path), "") and "secret" not in str(caught.value)


def test_the_name_of_an_image_stands_in_messages_as_printable_text(tmp_path: Path) -> None:
    path = write(tmp_path / "m.yaml", YAML.replace("m.pgm", '"a\\e[31m\\u2028.pgm"'))
    with pytest.raises(FileAccessError, match=r"line 1: the image .*a\\x1b\[31m\\u2028\.pgm: no such file"):
        open_grid(path)
    write(tmp_path / "a\x1b[31m\u2028.pgm", b"P5 1 1 255\n")
    with pytest.raises(FormatError, match=r"a\\x1b\[31m\\u2028\.pgm: the image is cut off"):
        open_grid(path)
