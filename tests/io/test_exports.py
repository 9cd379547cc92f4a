"""Exports: what ROS, a table reader and a point viewer find in the files is what the map says."""

from __future__ import annotations

import csv
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hexmap.base.errors import ArgumentError, FileAccessError
from hexmap.io import ros_map
from hexmap.io.exports import export, export_csv, export_ply
from hexmap.io.ros_map import export_ros
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Level, Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from tests.lattices import CASES, EXAMPLES, PLANAR, SPATIAL, Case

UNKNOWN, FREE, OCCUPIED = CellState

planar = pytest.mark.parametrize("case", PLANAR, ids=str)
spatial = pytest.mark.parametrize("case", SPATIAL, ids=str)
each = pytest.mark.parametrize("case", CASES, ids=str)


def random_map(lattice: Lattice, seed: int = 0, count: int = 200, levels: int = 2, at: float = 0.0) -> Map:
    """Points in a ragged cloud around ``at``, so that occupied, free and unknown cells mix."""
    rng = np.random.default_rng(seed)
    hits, passes = (at + rng.uniform(-1.5, 2.5, (n, lattice.dim)) for n in (count, 2 * count))
    scaled = [lattice.scaled(2.0**k) for k in range(levels)]
    return Map([Level(VoxelList.from_points(hits, s), VoxelList.from_points(passes, s)) for s in scaled])


def empty_map(lattice: Lattice) -> Map:
    return Map([Level(VoxelList.empty(lattice), VoxelList.empty(lattice))])


def read_ros(path: Path) -> tuple[NDArray[np.uint8], float, NDArray[np.float64], dict[str, str]]:
    """Read a map_server map as map_server does: states (H, W) with the bottom row first, side, origin, the YAML."""
    fields = dict(line.split(": ", 1) for line in path.read_text(encoding="utf-8").splitlines())
    raw = (path.parent / fields["image"].strip('"')).read_bytes()
    magic, size, depth, data = raw.split(b"\n", 3)
    assert (magic, depth) == (b"P5", b"255")
    width, height = map(int, size.split())
    assert len(data) == width * height
    pixels = np.frombuffer(data, np.uint8).reshape(height, width)[::-1].astype(np.float64)
    assert fields["negate"] == "0" and fields["mode"] == "trinary"
    occupancy = (255.0 - pixels) / 255.0
    states = np.full(pixels.shape, UNKNOWN, np.uint8)
    states[occupancy > float(fields["occupied_thresh"])] = OCCUPIED
    states[occupancy < float(fields["free_thresh"])] = FREE
    origin = [float(v) for v in fields["origin"].strip("[]").split(",")]
    assert origin[2] == 0.0
    return states, float(fields["resolution"]), np.array(origin[:2]), fields


def check_ros(map_: Map, path: Path, level: int = 0, rule: StateRule | None = None) -> NDArray[np.uint8]:
    """Check every promise of the export on the files as they are."""
    image, side, origin, _ = read_ros(path)
    states = map_.state(rule, level)
    lattice = states.occupied.lattice
    assert side == pytest.approx(lattice.resolution, rel=1e-11)

    def pixels(points: NDArray[np.float64]) -> set[tuple[int, int]]:
        return set(map(tuple, np.floor((points - origin) / side).astype(int).tolist()))

    occupied, free = pixels(states.occupied.centres()), pixels(states.free.centres())
    height, width = image.shape
    found = {(int(c), int(r)) for r, c in zip(*np.nonzero(image == OCCUPIED), strict=True)}
    assert found == occupied
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
    own = states.of(lattice.quantise(origin + (grid + 0.5) * side)).reshape(height, width)
    for r in range(height):
        for c in range(width):
            if (c, r) not in occupied:
                is_free = (c, r) in free or own[r, c] == FREE
                assert image[r, c] == (FREE if is_free else UNKNOWN)
    return image


@planar
@pytest.mark.parametrize("level", [0, 1])
def test_ros_round_trip(case: Case, level: int, tmp_path: Path) -> None:
    map_ = random_map(case.lattice)
    rule = StateRule(min_hits=1, min_ratio=0.4)
    assert export_ros(map_, tmp_path / "m.yaml", level, rule) == [tmp_path / "m.yaml", tmp_path / "m.pgm"]
    image = check_ros(map_, tmp_path / "m.yaml", level, rule)
    assert {OCCUPIED, FREE, UNKNOWN} == set(np.unique(image))


@settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    case=st.sampled_from(PLANAR),
    at=st.floats(-5000.0, 5000.0),
    seed=st.integers(0, 1000),
    count=st.integers(1, 60),
    factor=st.sampled_from([1.0, 0.37, 1 / 3, 1.7]),
)
def test_ros_pixels_and_centres_agree_anywhere(
    case: Case, at: float, seed: int, count: int, factor: float, tmp_path: Path
) -> None:
    map_ = random_map(case.lattice.scaled(factor), seed, count, 1, at)
    export_ros(map_, tmp_path / "m.yaml")
    check_ros(map_, tmp_path / "m.yaml")


def test_ros_squares_are_pixels(tmp_path: Path) -> None:
    lattice = Lattice.named("Z2", resolution=0.05)
    map_ = random_map(lattice, count=3000)
    export_ros(map_, tmp_path / "m.yaml")
    image, _, _, _ = read_ros(tmp_path / "m.yaml")
    states = map_.state()
    assert np.count_nonzero(image == OCCUPIED) == len(states.occupied)
    assert np.count_nonzero(image == FREE) == len(states.free)


def test_ros_conventions(tmp_path: Path) -> None:
    lattice = Lattice.named("Z2", resolution=0.1)
    hits = VoxelList.from_cells([[0, 0], [3, 1]], lattice)
    export_ros(Map([Level(hits, VoxelList.from_cells([[1, 0]], lattice))]), tmp_path / "map of mine.yml")
    assert (tmp_path / "map of mine.yml").read_text() == (
        'image: "map of mine.pgm"\nresolution: 0.1\norigin: [-0.05, -0.05, 0.0]\nnegate: 0\n'
        "occupied_thresh: 0.65\nfree_thresh: 0.196\nmode: trinary\n"
    )
    # The first row of the image is the top one.
    assert (tmp_path / "map of mine.pgm").read_bytes() == b"P5\n4 2\n255\n" + bytes(
        [205, 205, 205, 0, 0, 254, 205, 205]
    )


def test_ros_empty_map(tmp_path: Path) -> None:
    export_ros(empty_map(Lattice.named("A2", resolution=0.1)), tmp_path / "m.yaml")
    image, _, _, _ = read_ros(tmp_path / "m.yaml")
    assert image.tolist() == [[UNKNOWN]]


def test_ros_refuses_a_gigantic_image(tmp_path: Path) -> None:
    lattice = Lattice.named("A2", resolution=0.01)
    hits = VoxelList.from_points([[0.0, 0.0], [20_000.0, 10_000.0]], lattice)
    with pytest.raises(ArgumentError, match=r"2000001 x 100000\d pixels"):
        export_ros(Map([Level(hits, VoxelList.empty(lattice))]), tmp_path / "m.yaml")
    assert list(tmp_path.iterdir()) == []


def test_ros_far_apart_cells_of_a_wide_window(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Looking cells up by searching gives what the window gives."""
    map_ = random_map(Lattice.named("A2", resolution=0.1))
    export_ros(map_, tmp_path / "a.yaml")
    monkeypatch.setattr("hexmap.maps.outlines._WINDOW", 1)
    export_ros(map_, tmp_path / "b.yaml")
    assert (tmp_path / "a.pgm").read_bytes() == (tmp_path / "b.pgm").read_bytes()


@spatial
def test_ros_is_flat(case: Case, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"\.pcd or \.csv"):
        export_ros(empty_map(case.lattice), tmp_path / "m.yaml")
    assert list(tmp_path.iterdir()) == []


def test_ros_the_image_is_whole_before_the_yaml_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[str] = []
    real = ros_map.atomic_write

    def spy(path: Path, *arguments: Any) -> Any:
        written.append(Path(path).suffix)
        return real(path, *arguments)

    monkeypatch.setattr(ros_map, "atomic_write", spy)
    export_ros(empty_map(Lattice.named("A2")), tmp_path / "m.yaml")
    assert written == [".pgm", ".yaml"]


# ---------------------------------------------------------------------- tables and points


@each
@pytest.mark.parametrize("level", [0, 1])
def test_csv_holds_every_cell(case: Case, level: int, tmp_path: Path) -> None:
    map_ = random_map(case.lattice)
    assert export_csv(map_, tmp_path / "m.csv", level) == [tmp_path / "m.csv"]
    with open(tmp_path / "m.csv", newline="") as handle:
        header, *rows = list(csv.reader(handle))
    n = case.dim
    assert header == ["level", *"abc"[:n], *"xyz"[:n], "hits", "passes", "state"]
    at, states = map_.level(level), map_.state(level=level)
    index = np.array([[int(v) for v in row[1 : 1 + n]] for row in rows])
    assert {row[0] for row in rows} == {str(level)}
    assert np.array_equal(
        np.array([[float(v) for v in row[1 + n : 1 + 2 * n]] for row in rows]), at.lattice.centres(index)
    )
    assert np.array_equal(at.hits.find(index), [int(row[-3]) for row in rows])
    assert np.array_equal(at.passes.find(index), [int(row[-2]) for row in rows])
    assert len(rows) == len(at.columns()[0])
    names = np.array(["unknown", "free", "occupied"])
    assert names[states.of(index)].tolist() == [row[-1] for row in rows]


@each
def test_ply_holds_the_occupied_centres(case: Case, tmp_path: Path) -> None:
    map_ = random_map(case.lattice, count=3000)
    rule = StateRule(min_hits=2)
    assert export_ply(map_, tmp_path / "m.ply", 1, rule) == [tmp_path / "m.ply"]
    head, data = (tmp_path / "m.ply").read_bytes().split(b"end_header\n", 1)
    occupied = map_.state(rule, 1).occupied
    assert head.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert f"element vertex {len(occupied)}\n".encode() in head and len(occupied) > 0
    rows = list(struct.iter_unpack("<dddI", data))
    centres = occupied.centres()
    assert np.array_equal(np.array(rows)[:, : case.dim], centres)
    assert [row[3] for row in rows] == occupied.counts.tolist()
    if case.dim == 2:
        assert {row[2] for row in rows} == {0.0}


def test_ply_hits_stay_at_the_largest_number_there_is(tmp_path: Path) -> None:
    lattice = Lattice.named("A2", resolution=0.1)
    hits = VoxelList.from_cells([[0, 0]], lattice, [2**40])
    export_ply(Map([Level(hits, VoxelList.empty(lattice))]), tmp_path / "m.ply")
    assert (tmp_path / "m.ply").read_bytes()[-4:] == b"\xff\xff\xff\xff"


@each
def test_empty_tables(case: Case, tmp_path: Path) -> None:
    for name in ("m.csv", "m.ply"):
        export(empty_map(case.lattice), tmp_path / name)
    assert len((tmp_path / "m.csv").read_text().splitlines()) == 1
    assert b"element vertex 0\n" in (tmp_path / "m.ply").read_bytes()


@pytest.mark.parametrize("name", ["m.yaml", "m.YML", "m.csv", "m.ply"])
def test_export_by_suffix(name: str, tmp_path: Path) -> None:
    written = export(random_map(Lattice.named("A2", resolution=0.1)), tmp_path / name)
    assert sorted(written) == sorted(tmp_path.iterdir()) and written[0] == tmp_path / name


@pytest.mark.parametrize("name", ["m.parquet", "m", "m.yaml.gz"])
def test_unknown_suffix(name: str, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"known are \.yaml, \.yml, \.bt, \.csv, \.ply, \.pcd"):
        export(empty_map(Lattice.named("A2")), tmp_path / name)


@pytest.mark.parametrize("name", ["m.yaml", "m.csv", "m.ply"])
def test_errors_come_before_files(name: str, tmp_path: Path) -> None:
    map_ = empty_map(Lattice.named("A2"))
    with pytest.raises(ArgumentError, match="levels 0 to 0"):
        export(map_, tmp_path / name, level=1)
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(FileAccessError, match="there is no folder"):
        export(map_, tmp_path / "none" / name)
