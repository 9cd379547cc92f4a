"""Point files: every format there and back, what is wrong with them, and the filters."""

from __future__ import annotations

import gzip
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hexmap.base.errors import ArgumentError, FileAccessError, FormatError, HexmapError
from hexmap.io.clouds.filters import FilterReport, PointFilter, random_sample, unique_points, within_box, within_range
from hexmap.io.clouds.lzf import LzfError, inflate
from hexmap.io.clouds.read_points import read_points
from hexmap.io.clouds.scans import scans_to_points
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from tests.lattices import EXAMPLES
from tests.observing import count_calls

# Whole 64ths: every format, with float32 or nine digits, holds them exactly.
POINTS = np.round(np.random.default_rng(1).normal(0.0, 640.0, (50, 3))) / 64.0


# Small writers.


def lzf(data: bytes) -> bytes:
    """Compress: greedy matches of three bytes and more, overlapping ones too."""
    out, literal, seen, i = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for at in range(0, len(literal), 32):
            part = literal[at : at + 32]
            out.append(len(part) - 1)
            out.extend(part)
        literal.clear()

    while i < len(data):
        at = seen.get(data[i : i + 3], -1)
        seen[data[i : i + 3]] = i
        length = 0
        if at >= 0 and i - at <= 8192:
            while length < 264 and i + length < len(data) and data[at + length] == data[i + length]:
                length += 1
        if length < 3:
            literal.append(data[i])
            i += 1
            continue
        flush()
        distance = i - at - 1
        if length - 2 < 7:
            out.append((length - 2) << 5 | distance >> 8)
        else:
            out.extend((7 << 5 | distance >> 8, length - 9))
        out.append(distance & 255)
        i += length
    flush()
    return bytes(out)


def pcd(points=POINTS, kind="binary", fields="x y z", types="F F F", sizes="4 4 4", counts="1 1 1", **more) -> bytes:
    """Write the columns of ``points`` in order into the fields; counts above 1 take several columns."""
    entries = {
        "VERSION": "0.7", "FIELDS": fields, "SIZE": sizes, "TYPE": types, "COUNT": counts, "WIDTH": str(len(points)),
        "HEIGHT": "1", "VIEWPOINT": "0 0 0 1 0 0 0", "POINTS": str(len(points)), "DATA": kind,
    } | more  # fmt: skip
    header = "# .PCD v0.7\n" + "".join(f"{key} {value}\n" for key, value in entries.items() if value is not None)
    if kind == "ascii":
        return (header + "\n".join(" ".join(f"{v:.9g}" for v in row) for row in points) + "\n").encode()
    letters = [f"<{t.lower()}{s}" for t, s in zip(types.split(), sizes.split(), strict=True)]
    repeats = [int(c) for c in counts.split()]
    firsts = np.cumsum([0, *repeats])
    blocks = [points[:, f : f + c].astype(t) for f, c, t in zip(firsts, repeats, letters, strict=False)]
    if kind == "binary":
        rows = zip(*([row.tobytes() for row in block] for block in blocks), strict=True)
        return header.encode() + b"".join(b"".join(row) for row in rows)
    plain = b"".join(block.tobytes() for block in blocks)
    packed = lzf(plain)
    return header.encode() + struct.pack("<II", len(packed), len(plain)) + packed


PLY_TYPES = {"float": "f", "double": "d", "uchar": "B", "short": "h", "int": "i", "uint16": "H", "int8": "b"}


def ply(elements, kind="binary_little_endian", newline="\n") -> bytes:
    """Write elements: (name, [(type, name) or (length type, type, name)], rows); lists are lists in the rows."""
    lines = ["ply", f"format {kind} 1.0", "comment made by a test", "obj_info too"]
    body = bytearray()
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind, "")
    for name, properties, rows in elements:
        lines.append(f"element {name} {len(rows)}")
        lines += [f"property {'list ' if len(p) == 3 else ''}{' '.join(p)}" for p in properties]
        for row in rows:
            texts = []
            for p, value in zip(properties, row, strict=True):
                values = list(value) if len(p) == 3 else [value]
                if len(p) == 3:
                    texts.append(str(len(values)))
                    body += struct.pack(order + PLY_TYPES[p[0]], len(values)) if order else b""
                texts += [f"{v:.9g}" for v in values]
                if order:
                    letter = PLY_TYPES[p[-2]]
                    numbers = [float(v) if letter in "fd" else int(v) for v in values]
                    body += struct.pack(f"{order}{len(values)}{letter}", *numbers)
            body += b"" if order else (" ".join(texts) + newline).encode()
    return (newline.join([*lines, "end_header"]) + newline).encode() + bytes(body)


XYZ = [("float", "x"), ("float", "y"), ("float", "z")]
PLY_KINDS = ("ascii", "binary_little_endian", "binary_big_endian")


def lines(points=POINTS, separator=" ", header="") -> bytes:
    return (header + "\n".join(separator.join(f"{v:.9g}" for v in row) for row in points) + "\n").encode()


def npy(array, **options) -> bytes:
    import io

    out = io.BytesIO()
    np.save(out, array, **options)
    return out.getvalue()


def kitti(points=POINTS) -> bytes:
    return np.column_stack([points, np.ones(len(points))]).astype("<f4").tobytes()


def read(folder: Path, data: bytes, name="a.dat", **options):
    path = folder / name
    path.write_bytes(data)
    return read_points(path, **options)


def fails(folder: Path, data: bytes, *parts: str, name="a.dat", **options) -> str:
    """Expect one clear line that names the file and holds ``parts``."""
    with pytest.raises(FormatError) as caught:
        read(folder, data, name, **options)
    text = str(caught.value)
    assert text.startswith(str(folder / name))
    assert text.isprintable(), text
    for part in parts:
        assert part in text, text
    return text


SAMPLES = {
    "ascii.pcd": (pcd(kind="ascii"), "pcd"),
    "binary.pcd": (pcd(), "pcd"),
    "compressed.pcd": (pcd(kind="binary_compressed"), "pcd"),
    **{f"{kind}.ply": (ply([("vertex", XYZ, POINTS)], kind), "ply") for kind in PLY_KINDS},
    "blanks.xyz": (lines(), "text"),
    "tabs.txt": (lines(separator="\t"), "text"),
    "commas.csv": (lines(separator=","), "text"),
    "header.csv": (lines(separator="; ", header="x;y;z\n"), "text"),
    "scan.bin": (kitti(), "kitti"),
    "array.npy": (npy(POINTS), "npy"),
}


@pytest.mark.parametrize("name", SAMPLES)
@pytest.mark.parametrize("squeezed", [False, True], ids=["plain", "gzip"])
def test_every_format_there_and_back(tmp_path: Path, name: str, squeezed: bool) -> None:
    data, kind = SAMPLES[name]
    name = name + ".gz" if squeezed else name
    found = read(tmp_path, gzip.compress(data) if squeezed else data, name)
    assert found.points.dtype == np.float64 and found.points.flags.c_contiguous
    assert np.array_equal(found.points, POINTS)
    assert (found.format, found.dropped, found.warnings, found.dim, len(found)) == (kind, 0, (), 3, 50)
    assert found.path == tmp_path / name
    # The same by its content alone (a KITTI scan has no mark), and where the format is given.
    other = read(tmp_path, data, "other", format=kind if kind == "kitti" else None)
    assert np.array_equal(other.points, POINTS) and other.format == kind
    assert np.array_equal(read(tmp_path, data, "given", format=kind).points, POINTS)


@pytest.mark.parametrize("name", SAMPLES)
def test_a_file_cut_off_anywhere_is_one_clear_line_or_fewer_points(tmp_path: Path, name: str) -> None:
    data, kind = SAMPLES[name]
    path = tmp_path / name
    for end in [*range(0, len(data) - 1, 7), len(data) - 2]:
        path.write_bytes(data[:end])
        try:
            found = read_points(path)
        except FormatError as error:
            assert str(error).startswith(str(path)) and str(error).isprintable()
        else:
            # Text and KITTI scans do not say how long they are; a last number may lose digits.
            assert kind in ("text", "kitti") or end > len(data) - 12
            assert np.array_equal(found.points[:-1], POINTS[: len(found) - 1, : found.dim])


@settings(max_examples=8 * EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.sampled_from(sorted(SAMPLES)), st.data())
def test_damage_is_never_anything_but_a_clear_line(tmp_path: Path, name: str, draw: st.DataObject) -> None:
    data = bytearray(SAMPLES[name][0])
    for _ in range(draw.draw(st.integers(1, 4))):
        at = draw.draw(st.integers(0, min(len(data) - 1, 400)))
        data[at : at + draw.draw(st.integers(0, 3))] = draw.draw(st.binary(max_size=4))
    path = tmp_path / name
    path.write_bytes(bytes(data))
    try:
        found = read_points(path)
    except HexmapError as error:
        assert str(path) in str(error) and str(error).isprintable()
    else:
        assert np.isfinite(found.points).all() and len(found) > 0


@settings(max_examples=4 * EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300), st.sampled_from([None, "pcd", "ply", "text", "kitti", "npy"]))
def test_bytes_of_any_kind_make_nothing_but_a_clear_line(tmp_path: Path, data: bytes, kind: str | None) -> None:
    path = tmp_path / "a"
    path.write_bytes(data)
    try:
        read_points(path, format=kind)
    except HexmapError as error:
        assert str(path) in str(error) and str(error).isprintable()


# LZF.


@given(st.lists(st.sampled_from([b"a", b"ab", b"xyz", bytes(300), bytes(range(40))]), max_size=60).map(b"".join))
def test_lzf_there_and_back(data: bytes) -> None:
    assert inflate(lzf(data), len(data)) == data


def test_lzf_takes_literals_and_refuses_damage() -> None:
    assert inflate(b"\x02abc\x00d", 4) == b"abcd"
    # One byte, then 2 + 3 more of it: a copy that runs into itself.
    assert inflate(b"\x00a\x60\x00", 6) == b"aaaaaa"
    for stream, size, at in (
        (b"\x05ab", 6, 0),  # the source ends inside literals
        (b"\x00a\x20", 3, 2),  # ... before a distance
        (b"\x00a\xe0", 3, 2),  # ... before a length
        (b"\x00a\x20\x01", 4, 2),  # before the start
        (b"\x00a\x20\x00", 3, 2),  # beyond the size
        (b"\x00a", 3, 2),  # too few bytes
    ):
        with pytest.raises(LzfError) as caught:
            inflate(stream, size)
        # Damage at the size shows at the instruction that passes it, or at the end.
        assert caught.value.at == at or stream == b"\x00a\x20\x00"


# PCD.


@pytest.mark.parametrize("kind", ["ascii", "binary", "binary_compressed"])
def test_pcd_honours_types_sizes_counts_and_order_of_fields(tmp_path: Path, kind: str) -> None:
    table = np.column_stack([np.full((50, 3), 7), np.arange(50), POINTS[:, 2], POINTS[:, 0], np.arange(50) - 25])
    layout = {"fields": "normal label z x y", "types": "F U F F I", "sizes": "4 2 8 4 2", "counts": "3 1 1 1 1"}
    found = read(tmp_path, pcd(table, kind, **layout))
    assert np.array_equal(found.points, np.column_stack([POINTS[:, 0], np.arange(50) - 25, POINTS[:, 2]]))
    found = read(tmp_path, pcd(table, kind, **layout), columns=["label", "z"])
    assert np.array_equal(found.points, np.column_stack([np.arange(50), POINTS[:, 2]]))
    fails(tmp_path, pcd(table, kind, **layout), "line 6", "'normal' has 3 values", columns=["normal", "x"])


def test_pcd_of_the_plane_organised_and_with_short_headers(tmp_path: Path) -> None:
    flat = read(tmp_path, pcd(POINTS[:, :2], fields="x y", types="F F", sizes="4 4", counts="1 1"))
    assert flat.dim == 2 and np.array_equal(flat.points, POINTS[:, :2])
    assert len(read(tmp_path, pcd(WIDTH="10", HEIGHT="5"))) == 50
    for missing in ({"POINTS": None}, {"WIDTH": None, "HEIGHT": None}, {"COUNT": None}, {"VIEWPOINT": None}):
        assert np.array_equal(read(tmp_path, pcd(**missing)).points, POINTS)
    assert np.array_equal(read(tmp_path, pcd().replace(b"\n", b"\r\n", 11)).points, POINTS)
    assert np.array_equal(read(tmp_path, pcd(kind="ascii").replace(b"\n", b"\r\n")).points, POINTS)


def test_pcd_viewpoint_is_not_applied_but_told(tmp_path: Path) -> None:
    found = read(tmp_path, pcd(VIEWPOINT="1 2 3 1 0 0 0"))
    assert np.array_equal(found.points, POINTS)
    assert found.warnings == ("a.dat: VIEWPOINT 1 2 3 1 0 0 0 is not applied",)
    assert read(tmp_path, pcd(VIEWPOINT="0.0 0 0 1.000 0 -0 0")).warnings == ()


def test_pcd_what_can_be_wrong(tmp_path: Path) -> None:
    fails(tmp_path, pcd(DATA="zipped"), "line 11", "'zipped'")
    fails(tmp_path, pcd(WIDTH="49"), "line 10", "POINTS 50", "49")
    fails(tmp_path, pcd(WIDTH="x"), "line 7", "'x' is not a whole number")
    fails(tmp_path, pcd(WIDTH="9" * 5000), "line 7", "is not a whole number")
    fails(tmp_path, pcd(SIZE="4 4"), "line 4", "SIZE has 2 values, expected 3")
    fails(tmp_path, pcd(SIZE="4 4 3"), "line 5", "SIZE 3 is unknown")
    fails(tmp_path, pcd(TYPE="F F Q"), "line 5", "'Q'")
    fails(tmp_path, pcd(SIZE=None), "no SIZE")
    fails(tmp_path, pcd(kind="ascii", COUNT="1 1 " + "9" * 18), "line 6", "values a point")
    fails(tmp_path, pcd(fields="a b c"), "no 'x' among the fields", "a b c")
    fails(tmp_path, pcd(WIDTH="1000000000000", POINTS="1000000000000"), "cut off", "1000000000000 points")
    fails(tmp_path, pcd()[:-1], "cut off", "49 in the file")
    fails(tmp_path, pcd(POINTS[:0]), "no points in the file")
    fails(tmp_path, pcd(POINTS[:0], kind="binary_compressed"), "no points in the file")
    fails(tmp_path, pcd()[:40], "no DATA line")
    fails(tmp_path, pcd().replace(b"WIDTH", b"WIDHT"), "line 7", "'WIDHT'")
    fails(tmp_path, pcd(kind="ascii", WIDTH="51", POINTS="51"), "51 points announced, 50 in the file")
    text = pcd(kind="ascii").decode().splitlines()
    text[20] = "1 2 here"
    fails(tmp_path, "\n".join(text).encode(), "line 21", "'here' is not a number")
    text[20] = "1 2"
    fails(tmp_path, "\n".join(text).encode(), "line 21", "2 columns")
    fails(tmp_path, b"this is no PCD", "line 1", "'this'", name="a.pcd")


def test_compressed_pcd_what_can_be_wrong(tmp_path: Path) -> None:
    data = pcd(kind="binary_compressed")
    start = data.index(b"binary_compressed\n") + 18
    packed, _size = struct.unpack_from("<II", data, start)
    fails(tmp_path, data[: start + 5], "cut off before the sizes")
    fails(tmp_path, data[:-1], f"{packed} compressed bytes announced, {packed - 1} in the file")
    fails(tmp_path, data[: start + 4] + struct.pack("<I", 9) + data[start + 8 :], f"byte {start + 4}: 9 bytes", "600")
    damaged = data[: start + 8] + b"\xff" + data[start + 9 :]
    fails(tmp_path, damaged, f"byte {start + 8}: the compressed data are damaged")
    big = pcd(kind="binary_compressed", WIDTH="100000000", POINTS="100000000")
    start = big.index(b"binary_compressed\n") + 18
    fails(tmp_path, big[: start + 4] + struct.pack("<I", 1200000000) + big[start + 8 :], "cannot hold 1200000000 bytes")


# PLY.


@pytest.mark.parametrize("kind", PLY_KINDS)
@pytest.mark.parametrize("lists", [False, True], ids=["table", "lists"])
def test_ply_skips_other_elements_and_properties(tmp_path: Path, kind: str, lists: bool) -> None:
    rng = np.random.default_rng(5)
    faces = [(rng.integers(0, 9, rng.integers(0, 6)).tolist(), 3) for _ in range(20)]
    extra = [("uchar", "short", "seen_by")] if lists else [("short", "label")]
    vertex = [("uchar", "red"), ("double", "z"), *extra, ("int", "x"), ("float", "y")]
    rows = [(k, POINTS[k, 2], list(range(k % 4)) if lists else k, k - 20, POINTS[k, 1]) for k in range(len(POINTS))]
    elements = [
        ("camera", [("float", "x"), ("uint16", "id")], [(1.5, 2), (2.5, 3)]),
        ("face", [("uchar", "int", "vertex_indices"), ("int8", "flag")], faces),
        ("nothing", [], []),
        ("vertex", vertex, rows),
        ("face", [("uchar", "int", "vertex_indices"), ("int8", "flag")], faces),
    ]
    for newline in ("\n", "\r\n", "\r"):
        found = read(tmp_path, ply(elements, kind, newline))
        assert np.array_equal(found.points, np.column_stack([np.arange(50) - 20.0, POINTS[:, 1], POINTS[:, 2]]))
    found = read(tmp_path, ply(elements, kind), columns=("y", "red"))
    assert np.array_equal(found.points, np.column_stack([POINTS[:, 1], np.arange(50.0)]))
    found = read(tmp_path, ply(elements, kind), columns=("y", "y"))
    assert np.array_equal(found.points, POINTS[:, [1, 1]])


@pytest.mark.parametrize("kind", PLY_KINDS)
@pytest.mark.parametrize("letter", ["double", "short", "int", "int8"])
def test_ply_coordinates_of_any_type(tmp_path: Path, kind: str, letter: str) -> None:
    whole = np.round(POINTS)
    data = ply([("vertex", [(letter, "x"), (letter, "y"), (letter, "z")], whole)], kind)
    assert np.array_equal(read(tmp_path, data).points, whole)
    assert read(tmp_path, ply([("vertex", XYZ[:2], POINTS[:, :2])], kind)).dim == 2


@pytest.mark.parametrize("kind", PLY_KINDS)
def test_ply_what_can_be_wrong(tmp_path: Path, kind: str) -> None:
    good = ply([("vertex", XYZ, POINTS)], kind)
    fails(tmp_path, good.replace(b"vertex 50", b"vertex many"), "line 5", "'many'")
    fails(tmp_path, good.replace(b"vertex 50", b"vertex 51"), "51 of 'vertex' announced, 50 in the file")
    fails(tmp_path, good.replace(b"vertex 50", b"vertex 0"), "no points in the file")
    fails(tmp_path, good.replace(b"element vertex", b"element corner"), "no element 'vertex'", "corner")
    fails(tmp_path, good.replace(b"float y", b"float v"), "no 'y' among the properties of 'vertex'", "x v z")
    fails(tmp_path, good.replace(b"float y", b"quad y"), "line 7", "'quad'")
    fails(tmp_path, good.replace(b"property float y", b"propty float y"), "line 7", "'propty float y'")
    fails(tmp_path, good.replace(kind.encode(), b"binary_middle"), "line 2", "'binary_middle'")
    fails(tmp_path, good.replace(b"format", b"comment"), "no format line")
    fails(tmp_path, good.replace(b"end_header", b"comment"), "PLY header" if kind == "ascii" else "")
    fails(tmp_path, good[:60], "no end_header")
    fails(tmp_path, b"1 2 3\n", "line 1", "'1 2 3", name="a.ply")
    listed = good.replace(b"property float y", b"property list uchar float y")
    fails(tmp_path, listed, "'y' is a list")
    faces = ("face", [("int", "int", "vertex_indices")], [([1, 2, 3],)] * 4)
    both = ply([faces, ("vertex", XYZ, POINTS)], kind)
    assert np.array_equal(read(tmp_path, both).points, POINTS)
    fails(tmp_path, both.replace(b"face 4", b"face 400"), "cut off" if kind == "ascii" else "")
    if kind != "ascii":
        start = both.index(b"end_header\n") + 11
        fails(tmp_path, both[:start] + b"\xff" * 4 + both[start + 4 :], f"byte {start}", "length -1")


def test_ascii_ply_names_the_line(tmp_path: Path) -> None:
    text = ply([("camera", [("int", "id")], [(1,), (2,)]), ("vertex", XYZ, POINTS)], "ascii").decode().splitlines()
    at = text.index("end_header") + 3 + 7
    assert np.array_equal(read(tmp_path, "\n".join([*text[: at - 1], "", *text[at - 1 :]]).encode()).points, POINTS)
    text[at - 1] = "1 two 3"
    fails(tmp_path, "\n".join(text).encode(), f"line {at}:", "'two' is not a number")
    # As many lines more as there are blank ones before.
    where = text.index("end_header") + 1
    fails(tmp_path, "\n".join([*text[:where], "", *text[where:]]).encode(), f"line {at + 1}:", "'two'")
    rows = [([1], *POINTS[k]) for k in range(5)]
    listed = ply([("vertex", [("uchar", "int", "s"), *XYZ], rows)], "ascii").decode().splitlines()
    listed[-1] = "1 1 2"
    fails(tmp_path, "\n".join(listed).encode(), f"line {len(listed)}:", "3 numbers, more expected")
    listed[-1] = "-1 1 2 3"
    fails(tmp_path, "\n".join(listed).encode(), f"line {len(listed)}:", "'-1'")


# Text.


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 5 6\n",
        "1 2 3\n4 5 6",
        "  1\t2   3  \n\n\n4 5\t6\n",
        "1,2,3\r\n4,5,6\r\n",
        "1,2,3\r4,5,6\r",
        "1, 2, 3,\n4, 5, 6,\n",
        "# x y z\n1;2;3\n4;5;6 # the last\n",
        "x y z\n1 2 3\n4 5 6\n",
        "y,intensity,X,z\n2,0,1,3\n5,0,4,6\n",
        '"z","x","y"\n"3","1","2"\n"6","4","5"\n',
        "# id x y z\n7 1 2 3\n7 4 5 6\n",
        "//X Y Z R G B\n1 2 3 9 9 9\n4 5 6 9 9 9\n",
        "x [m] y [m] z [m]\n1 2 3\n4 5 6\n",
        "x (m); y (m); z (m)\n1;2;3\n4;5;6\n",
        "1 2 3 chair\n4 5 6 table\n",
        "label,x,y,z\nchair,1,2,3\n,4,5,6\n",
        'label,x,y,z\n"chair, high",1,2,3\ntable,4,5,6\n',
        "2\n1 2 3 9\n4 5 6 9\n",
        "\ufeffx,y,z\n1,2,3\n4,5,6\n",
        "# one\n\n# two\n1e0 +2.0 3.\n4 .5e1 6\n",
    ],
)
def test_text_of_many_kinds(tmp_path: Path, text: str) -> None:
    found = read(tmp_path, text.encode())
    assert found.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert (found.format, found.warnings) == ("text", ())


def test_text_of_the_plane(tmp_path: Path) -> None:
    for text in ("1 2\n4 5\n", "y,x,t\n2,1,9\n5,4,9\n", "x;y\n1;2\n4;5\n"):
        assert read(tmp_path, text.encode()).points.tolist() == [[1, 2], [4, 5]]


@pytest.mark.parametrize(
    "text",
    ["1,5;2,5;3\n4;5;6\n", "x;y;z\n1,5;2,5;3\n4;5;6\n", "1,5\t2,5\t3\n4\t5\t6\n", "1,5 2,5 3\n4 5 6"],
)
def test_text_with_decimal_commas(tmp_path: Path, text: str) -> None:
    found = read(tmp_path, text.encode())
    assert found.points.tolist() == [[1.5, 2.5, 3], [4, 5, 6]]
    assert found.warnings == ("a.dat: commas in the numbers are read as decimal points",)


def test_text_with_columns_and_delimiter_of_ones_own(tmp_path: Path) -> None:
    assert read(tmp_path, b"9 1 2 3\n9 4 5 6\n", columns=[1, 2, 3]).points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert read(tmp_path, b"9 1 2 3\n9 4 5 6\n", columns="3,1").points.tolist() == [[3, 1], [6, 4]]
    assert read(tmp_path, b"t,east,north\n9,1,2\n", columns=("East", "north")).points.tolist() == [[1, 2]]
    assert read(tmp_path, b"1|2|3\n", delimiter="|").points.tolist() == [[1, 2, 3]]
    for name in ("comma", ","):
        assert read(tmp_path, b"1,2,3\n", delimiter=name).points.tolist() == [[1, 2, 3]]
    assert read(tmp_path, b"1 2 3\n", delimiter="blank").points.tolist() == [[1, 2, 3]]
    fails(tmp_path, b"t,east,north\n9,1,2\n", "no 'west'", "t east north", columns=("west", "north"))
    fails(tmp_path, b"1 2 3\n", "no '3'", columns=(1, 3))


def test_text_headers_that_do_not_help_are_told(tmp_path: Path) -> None:
    found = read(tmp_path, b"a,b,c\n1,2,3\n")
    assert found.points.tolist() == [[1, 2, 3]]
    assert found.warnings == ("a.dat: the header names no x and y; the first 3 columns are used",)
    found = read(tmp_path, b"a x y z\n1 2 3\n")
    assert "4 columns, but there are 3" in found.warnings[0]
    assert "3 in the file" in read(tmp_path, b"2\n1 2 3\n1 2 3\n1 2 3\n").warnings[0]


def test_text_what_can_be_wrong(tmp_path: Path) -> None:
    fails(tmp_path, b"# only\n\n# comments\n", "no points in the file")
    fails(tmp_path, b"x,y,z\n", "line 1", "'x' is not a number")
    fails(tmp_path, b"1 2 3\n\n# a\n4 b 6\n", "line 4", "'b' is not a number")
    fails(tmp_path, b"x,y,z\r\n1,2,3\r\n4,,6\r\n", "line 3", "'' is not a number")
    fails(tmp_path, b"1,2,3\n4,5\n", "line 2", "2 columns, expected at least 3")
    fails(tmp_path, b"1\n2\n", "line 1", "one column")
    fails(tmp_path, b"5\n1 2 3\n", "5 points announced, 1 in the file")
    fails(tmp_path, b"v 1 2 3\nv 4 5 6\n", "line 1", "'v' is not a number")
    fails(tmp_path, b"Dear reader,\nthis is a letter.\n", "line 2", "is not a number")
    fails(tmp_path, b"1 2 3\n4 5 1_0\n", "line 2", "'1_0'")
    fails(tmp_path, b"1 2 3\n4 5 \x1b[31m\n" + b"1 2 3\n" * 9, "line 2", "\\x1b")
    fails(tmp_path, b"1 2 3\n" * 1000 + b"4 5 \x00\n", "line 1001")


# KITTI and NPY.


def test_kitti_what_can_be_wrong(tmp_path: Path) -> None:
    fails(tmp_path, kitti()[:-1], "byte 784", "799 bytes are no multiple of 16", name="a.bin")
    wild = bytearray(kitti())
    struct.pack_into("<f", wild, 16 * 3 + 4, 1e30)
    fails(tmp_path, bytes(wild), "byte 52", "1e+30", name="a.bin")
    assert len(read(tmp_path, kitti(), name="b.pcd.bin", format="kitti")) == 50
    assert read(tmp_path, kitti(), name="a.bin", columns=("x", 3)).points[:, 1].tolist() == [1.0] * 50
    assert read(tmp_path, pcd(), name="really_a_pcd.bin").format == "pcd"


def test_npy_of_many_kinds(tmp_path: Path) -> None:
    wide = np.column_stack([POINTS, np.ones(50)])
    for array in (POINTS, POINTS.astype(">f8"), POINTS.astype("f4"), np.asfortranarray(POINTS), wide):
        assert np.array_equal(read(tmp_path, npy(array)).points, POINTS)
    assert np.array_equal(read(tmp_path, npy(POINTS[:, :2])).points, POINTS[:, :2])
    assert np.array_equal(read(tmp_path, npy(np.arange(6).reshape(2, 3))).points, [[0, 1, 2], [3, 4, 5]])
    assert np.array_equal(read(tmp_path, npy(wide), columns=(3, 0)).points, wide[:, [3, 0]])
    records = np.zeros(2, dtype=[("t", "U3"), ("z", "f4"), ("x", "i2"), ("y", "f8")])
    records["x"], records["y"] = [1, 2], [3, 4]
    assert read(tmp_path, npy(records)).points.tolist() == [[1, 3, 0], [2, 4, 0]]
    fails(tmp_path, npy(records), "'t' is of type <U3", columns=("t", "x"))


def test_npy_what_can_be_wrong(tmp_path: Path) -> None:
    fails(tmp_path, npy(np.zeros(5)), "shape (5,)")
    fails(tmp_path, npy(np.zeros((5, 1))), "shape (5, 1)")
    fails(tmp_path, npy(np.zeros((5, 3), dtype=complex)), "complex128")
    fails(tmp_path, npy(np.zeros((5, 3), dtype=bool)), "bool")
    fails(tmp_path, npy(np.zeros((0, 3))), "no points in the file")
    fails(tmp_path, npy(np.array([[{}, {}]], dtype=object), allow_pickle=True), "not a sound NPY file")
    fails(tmp_path, npy(POINTS)[:-1], "not a sound NPY file")
    fails(tmp_path, npy(POINTS)[:9], "not a sound NPY file")
    fails(tmp_path, npy(POINTS).replace(b"(50, 3)", b"(50, x)"), "not a sound NPY file")


# What all formats share.


def test_points_that_are_not_finite_are_dropped_and_counted(tmp_path: Path) -> None:
    spoilt = POINTS.copy()
    spoilt[3, 0], spoilt[7, 2], spoilt[9] = np.nan, np.inf, -np.inf
    good = np.delete(POINTS, [3, 7, 9], axis=0)
    for name, data in {
        "a.pcd": pcd(spoilt), "b.pcd": pcd(spoilt, "ascii"), "c.pcd": pcd(spoilt, "binary_compressed"),
        "a.ply": ply([("vertex", XYZ, spoilt)]), "a.csv": lines(spoilt, ","), "a.bin": kitti(spoilt),
        "a.npy": npy(spoilt),
    }.items():  # fmt: skip
        found = read(tmp_path, data, name)
        assert np.array_equal(found.points, good) and found.dropped == 3
        assert found.warnings == (f"{name}: 3 points of 50 dropped, not finite",)
    fails(tmp_path, pcd(np.full((4, 3), np.nan)), "none of the 4 points in the file is finite")
    assert read(tmp_path, b"1e308 1 1\n1 1 1\n", units=1000.0).points.tolist() == [[1000, 1000, 1000]]


def test_units(tmp_path: Path) -> None:
    for units, expected in (("m", 7.0), ("cm", 0.07), ("mm", 0.007), (2.5, 17.5), ("0.3048", 7 * 0.3048)):
        assert read(tmp_path, b"7 7 7\n", units=units).points.tolist() == [[expected] * 3]
    for bad in ("km", 0, -1.0, float("nan"), float("inf"), None):
        with pytest.raises(ArgumentError, match="units"):
            read(tmp_path, b"7 7 7\n", units=bad)


def test_axes(tmp_path: Path) -> None:
    turns = {"xyz": [1, 2, 3], "z,-x,-y": [3, -1, -2], "X, -Z, Y": [1, -3, 2], "-x-yz": [-1, -2, 3]}
    for axes, expected in turns.items():
        found = read(tmp_path, b"1 2 3\n", axes=axes)
        assert found.points.tolist() == [expected] and found.warnings == ()
    mirrored = read(tmp_path, b"1 2 3\n", axes="xzy")
    assert mirrored.points.tolist() == [[1, 3, 2]]
    assert mirrored.warnings == ("a.dat: the axes 'xzy' mirror the points",)
    assert not np.signbit(read(tmp_path, b"0 1 2\n", axes="-x,-y,z").points[0, 0])
    for axes, flat in (("xyz", [1, 2]), ("xy", [1, 2]), ("-y,x", [-2, 1]), ("-y,x,z", [-2, 1])):
        assert read(tmp_path, b"1 2\n", axes=axes).points.tolist() == [flat]
    for bad in ("xxy", "x", "", "xyw", "x--yz", "xyzz", "yz", "1", "x;y;z"):
        with pytest.raises(ArgumentError, match="axes"):
            read(tmp_path, b"1 2 3\n", axes=bad)
    for data, bad in ((b"1 2 3\n", "xy"), (b"1 2\n", "xzy"), (b"1 2\n", "x,y,-z")):
        with pytest.raises(ArgumentError, match="do not fit points of dimension"):
            read(tmp_path, data, axes=bad)


def test_arguments_are_checked_before_the_file(tmp_path: Path) -> None:
    missing = tmp_path / "missing"
    for options in (
        {"format": "las"}, {"columns": ["x"]}, {"columns": [0, -1]}, {"columns": [0.5, 1]}, {"delimiter": "ab"},
        {"delimiter": "1"},
    ):  # fmt: skip
        with pytest.raises(ArgumentError, match=next(iter(options))):
            read_points(missing, **options)
    with pytest.raises(ArgumentError, match="delimiter is for text"):
        read(tmp_path, pcd(), delimiter=",")
    with pytest.raises(FileAccessError, match="missing: no such file"):
        read_points(missing)
    with pytest.raises(FileAccessError, match="cannot be read"):
        read_points(tmp_path)


def test_empty_damaged_and_foreign_files(tmp_path: Path) -> None:
    fails(tmp_path, b"", "the file is empty")
    fails(tmp_path, gzip.compress(b""), "inside gzip is empty")
    squeezed = gzip.compress(lines())
    fails(tmp_path, squeezed[:-9], "the gzip file is cut off")
    fails(tmp_path, squeezed[:30] + b"\xff\xff\xff" + squeezed[33:], "the gzip file is damaged")
    for data, word in (
        (b"PK\x03\x04rest", "archive"), (b"LASFrest", "LAS"), (b"PAR1rest", "Parquet"), (b"\x89PNG\r\n", "PNG"),
        (b"# Octomap OcTree binary file\n", "OctoMap"), (b"#ROSBAG V2.0\n", "bag"),
        ("1 2 3\n".encode("utf-16"), "UTF-16"),
        (b"version https://git-lfs.github.com/spec/v1\n", "LFS"), (b"<!DOCTYPE html>\n", "HTML"),
        (b"# a\nFLASER 1 2 3\n", "CARMEN"),
    ):  # fmt: skip
        fails(tmp_path, data, word)
    fails(tmp_path, b"1 2 3\n\x01\x02", "byte 6", "binary (0x01) and of no known kind")
    fails(tmp_path, b"\x00" * 32, "binary", "KITTI")
    fails(tmp_path, b"\x93NOTNUMPY", "NPY", name="a.npy")
    fails(tmp_path, lines(), "trajectory", name="a.tum")


def test_large_text_takes_no_calls_for_each_line(tmp_path: Path) -> None:
    found, calls = count_calls(read, tmp_path, lines(np.tile(POINTS, (2000, 1))))
    assert len(found) == 100_000 and calls < 10_000


def test_importing_is_light() -> None:
    heavy = "('numba', 'scipy', 'pyarrow', 'open3d')"
    code = f"import sys, hexmap.io.clouds; sys.exit(any(m in sys.modules for m in {heavy}))"
    assert subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[3], check=False).returncode == 0


# Filters.

clouds = st.integers(2, 3).flatmap(
    lambda n: hnp.arrays(
        np.float64,
        st.tuples(st.integers(0, 40), st.just(n)),
        elements=st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5]), st.floats(-1e200, 1e200)),
    )
)


@given(clouds, st.floats(0, 5), st.floats(0, 5))
def test_within_range(points: np.ndarray, a: float, b: float) -> None:
    least, most = min(a, b), max(a, b) + 0.1
    with np.errstate(over="ignore"):
        distance = np.sqrt((points**2).sum(axis=1))
    expected = [p for p, d in zip(points.tolist(), distance, strict=True) if least <= d <= most]
    assert within_range(points, least, most).tolist() == expected
    far = [p for p, d in zip(points.tolist(), distance, strict=True) if least <= d]
    assert within_range(points, least).tolist() == far


@given(clouds, st.data())
def test_within_box(points: np.ndarray, draw: st.DataObject) -> None:
    n = points.shape[1]
    corner = st.tuples(*[st.floats(-2, 2) | st.sampled_from([-np.inf, np.inf])] * n)
    a, b = draw.draw(corner), draw.draw(corner)
    low, high = np.minimum(a, b), np.maximum(a, b)
    expected = [p for p in points.tolist() if all(x <= v <= y for x, v, y in zip(low, p, high, strict=True))]
    assert within_box(points, low, high).tolist() == expected
    assert len(within_box(points, None, None)) == len(points)
    assert len(within_box(points, low, None)) >= len(expected) <= len(within_box(points, None, high))


@given(clouds)
def test_unique_points_keeps_the_first_of_equals_in_order(points: np.ndarray) -> None:
    kept = unique_points(points)
    # Lists of floats compare 0.0 and -0.0 equal, as the filter does.
    assert kept.tolist() == [list(p) for p in dict.fromkeys(map(tuple, points.tolist()))]
    assert np.array_equal(unique_points(kept), kept)
    assert np.array_equal(unique_points(np.concatenate([points, points])), kept)


@given(clouds, st.integers(1, 50), st.integers(0, 2**40))
def test_random_sample(points: np.ndarray, count: int, seed: int) -> None:
    tagged = np.column_stack([np.arange(len(points), dtype=np.float64), points[:, 0]])
    kept = random_sample(tagged, count, seed)
    assert len(kept) == min(count, len(points))
    assert (np.diff(kept[:, 0]) > 0).all()
    assert np.array_equal(tagged[kept[:, 0].astype(int)], kept)
    assert np.array_equal(random_sample(tagged, count, seed), kept)


def test_random_sample_takes_all_points_alike() -> None:
    points = np.column_stack([np.arange(10.0), np.zeros(10)])
    hits = np.zeros(10)
    for seed in range(2000):
        hits[random_sample(points, 3, seed)[:, 0].astype(int)] += 1
    # 600 expected, standard deviation 20.5.
    assert np.abs(hits - 600).max() < 5 * 20.5


@given(
    clouds,
    st.floats(0, 1),
    st.none() | st.floats(1, 4),
    st.booleans(),
    st.none() | st.integers(1, 10),
    st.booleans(),
)
def test_the_filter_is_its_parts_in_order(
    points: np.ndarray, least: float, most: float | None, unique: bool, sample: int | None, boxed: bool
) -> None:
    n = points.shape[1]
    low, high = ((-1.5,) * n, (1.0,) * n) if boxed else (None, None)
    chosen = PointFilter(least, most if most is None else most + 0.1, low, high, unique, sample, seed=3)
    before = points.copy()
    kept, report = chosen.apply_counted(points)
    a = within_range(points, least, chosen.max_range)
    b = within_box(a, low, high)
    c = unique_points(b) if unique else b
    d = random_sample(c, sample, 3) if sample else c
    assert np.array_equal(kept, d) and np.array_equal(chosen.apply(points), d)
    assert report == FilterReport(len(points), len(points) - len(a), len(a) - len(b), len(b) - len(c), len(c) - len(d))
    assert report.kept == len(kept) and str(report).isprintable()
    assert np.array_equal(points, before) and not np.shares_memory(kept, points)


def test_filters_refuse_what_makes_no_sense() -> None:
    for options in (
        {"min_range": -1.0}, {"min_range": np.nan}, {"min_range": 2.0, "max_range": 1.0}, {"max_range": np.nan},
        {"max_range": 0.0}, {"low": (1.0,)}, {"low": (1.0, 2.0), "high": (0.0, 3.0)}, {"high": (np.nan, 1.0)},
        {"low": (0.0, 0.0), "high": (1.0, 1.0, 1.0)}, {"sample": 0}, {"sample": 2.5}, {"seed": -1},
    ):  # fmt: skip
        with pytest.raises(ArgumentError):
            PointFilter(**options)
    with pytest.raises(ArgumentError, match="takes 3 numbers"):
        PointFilter(low=(0.0, 0.0)).apply(POINTS)
    for bad in (np.zeros(3), np.zeros((4, 5)), [[1.0, np.nan]]):
        with pytest.raises(ArgumentError):
            PointFilter().apply(bad)
    assert PointFilter(low=[0, 0], high=[1, 1]) == PointFilter(low=(0.0, 0.0), high=(1.0, 1.0))
    assert PointFilter(max_range=np.inf) == PointFilter()
    assert hash(PointFilter(low=[0, 0])) == hash(PointFilter(low=(0.0, 0.0)))


# Points of a log.


def test_scans_to_points() -> None:
    scans = [Scan(0.0, POINTS[:5, :2]), Scan(1.0, np.empty((0, 2))), Scan(0.5, POINTS[5:8, :2])]
    poses = [Pose.planar(1, 2, 0.3), Pose.identity(), Pose.planar(-1, 0, 2.0)]
    joined = scans_to_points(zip(scans, poses, strict=True))
    assert np.array_equal(joined, np.concatenate([poses[0].apply(POINTS[:5, :2]), poses[2].apply(POINTS[5:8, :2])]))
    assert scans_to_points([]).shape == (0, 2)
    solid = Scan(0.0, POINTS)
    assert np.array_equal(scans_to_points([(solid, Pose.identity(3))]), POINTS)
    with pytest.raises(ArgumentError):
        scans_to_points([(solid, Pose.identity(2))])
    with pytest.raises(ArgumentError, match="dimension 3"):
        scans_to_points([(scans[0], poses[0]), (solid, Pose.identity(3))])


# Real scans.


@pytest.mark.data
def test_stairs_hall(data_dir: Path) -> None:
    found = read_points(data_dir / "scans3d" / "stairs_hall.pcd")
    assert found.points.shape == (88_206, 3) and (found.dropped, found.warnings) == (0, ())
    assert np.abs(np.ptp(found.points, axis=0) - (27, 31, 11)).max() < 1.0


@pytest.mark.data
@pytest.mark.parametrize("name", ["room_scan1", "room_scan2"])
def test_room_scans(data_dir: Path, name: str) -> None:
    found, calls = count_calls(read_points, data_dir / "scans3d" / f"{name}.pcd")
    assert calls < len(found)  # of decompressing, which goes in runs of bytes
    given_points = len(found)
    near = PointFilter(min_range=0.5).apply_counted(found.points)[1]
    same = PointFilter(unique=True).apply_counted(found.points)[1]
    assert abs(near.out_of_range - 22_400) < 100
    assert abs(same.duplicates / given_points - 0.5) < 0.01
    kept, both = PointFilter(min_range=0.5, unique=True).apply_counted(found.points)
    assert both.kept == len(kept) == given_points - both.out_of_range - both.duplicates


@pytest.mark.data
def test_a_log_or_a_map_is_not_points(data_dir: Path) -> None:
    logs, maps = ("intel.clf.gz", "csail_first120s.bag"), ("fr_079.bt", "willow-2010-02-18-0.10.pgm")
    for name in [f"laser2d/{log}" for log in logs] + [f"maps/{grid}" for grid in maps]:
        with pytest.raises(FormatError):
            read_points(data_dir / name)
