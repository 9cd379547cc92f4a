"""Two maps of one building that know nothing of each other, and pairs that must not be put together."""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import AlignmentError, ArgumentError
from hexmap.cli import main
from hexmap.io.logs.open_log import open_log
from hexmap.io.map_file import load_map, save_map
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Event, Scan
from hexmap.simulator.buildings import make_building
from hexmap.simulator.events import simulate
from hexmap.simulator.laser import Laser
from localisation.mapping.align import AlignSettings, align_maps, merge_aligned
from tests.lattices import JIT, SPATIAL, Case
from tests.mapping import map_events

# A search of a whole building is millions of nodes.
pytestmark = pytest.mark.skipif(not JIT, reason="takes hours without the compiler")


@lru_cache
def half(building: str, name: str, which: int) -> tuple[Map, Pose]:
    """Half of a drive, mapped in the frame of its own first pose, and that pose in the building."""
    laser = Laser(beams=181, rate=1.0)
    events = [e for e in simulate(make_building(building), laser, seed=5) if isinstance(e.event, Scan)]
    middle = len(events) // 2
    part = events[:middle] if which == 0 else events[middle:]
    start = part[0].T_map_robot
    builder = MapBuilder(Lattice.named(name, 0.05), 3)
    for e in part:
        builder.fuse(e.event, start.inverse() @ e.T_map_robot @ laser.mount)
    return builder.build(frame=f"half {which}", source={"log": f"{building} {which}"}), start


@pytest.mark.parametrize("name", ["A2", "Z2"])
def test_halves_of_a_drive_are_put_together(name: str) -> None:
    (a, start_a), (b, start_b) = half("office", name, 0), half("office", name, 1)
    found = align_maps(a, b)
    true = start_a.inverse() @ start_b
    assert found.pose.is_close(true, metres=0.05, radians=math.radians(0.2)), (found.pose, true)
    assert found.match.certified and found.match.gap == 0 and found.match.margin >= 0.2
    assert found.reverse.is_close(true.inverse(), metres=1.0, radians=math.radians(1.0))
    assert found.overlap > 0.3 and found.contradicted < 0.1
    merged = merge_aligned(a, b, found)
    assert merged.frame == "half 0"
    assert merged.levels[0].hits.total == a.levels[0].hits.total + b.levels[0].hits.total
    sources = {s["log"]: s for s in merged.sources()}
    assert set(sources) == {"office 0", "office 1"} and "moved" not in sources["office 0"]
    assert sources["office 1"]["moved"]["translation"] == pytest.approx(found.pose.translation)
    # What was moved once can be moved again: the sources say by how much altogether.
    again = merge_aligned(a, merged, found)
    moved = [s["moved"]["translation"] for s in again.sources() if s["log"] == "office 1"]
    assert moved == [pytest.approx((found.pose @ found.pose).translation)]
    assert align_maps(a, b).pose == found.pose, "the same maps give the same numbers"


@pytest.mark.long
def test_another_building_is_refused() -> None:
    with pytest.raises(AlignmentError, match=r"contradicted: at best \d+\.\d% .* are free there; 25\.0% are allowed"):
        align_maps(half("office", "A2", 0)[0], half("room", "A2", 0)[0])


def of_walls(*segments: tuple[float, float, float, float], sensors: list[tuple[float, float]]) -> Map:
    """A map of straight walls, seen from some positions; points every 2 cm."""
    points = np.concatenate(
        [np.linspace(s[:2], s[2:], max(2, round(math.dist(s[:2], s[2:]) / 0.02))) for s in segments]
    )
    builder = MapBuilder(Lattice.named("A2", 0.05), 3)
    for x, y in sensors:
        builder.fuse(Scan(0.0, points - [x, y]), Pose.planar(x, y, 0.0))
    return builder.build()


@pytest.mark.parametrize("degrees", [0.0, 17.0, 45.0])
def test_an_empty_square_room_fits_four_ways_and_is_refused(degrees: float) -> None:
    corners = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0], [0.0, 0.0]])

    def room(turn: float) -> Map:
        ends = Pose.planar(0.0, 0.0, turn).apply(corners)
        walls = [(*a, *b) for a, b in itertools.pairwise(ends.tolist())]
        return of_walls(*walls, sensors=[tuple(ends[:4].mean(axis=0))])

    with pytest.raises(AlignmentError, match=r"ambiguous: .* degrees, and .* degrees; a margin of 20% is needed"):
        align_maps(room(0.0), room(math.radians(degrees)))


def test_a_corridor_slides_along_itself_and_is_refused() -> None:
    whole = of_walls((0, 0, 40, 0), (0, 2, 40, 2), sensors=[(x, 1.0) for x in range(2, 40, 4)])
    part = of_walls((0, 0, 15, 0), (0, 2, 15, 2), sensors=[(x, 1.0) for x in range(2, 14, 4)])
    with pytest.raises(AlignmentError, match="ambiguous"):
        align_maps(whole, part)


def test_maps_that_hardly_meet_are_refused() -> None:
    a = of_walls((0, 0, 5, 0), (5, 0, 5, 3.5), sensors=[(2, 1)])
    with pytest.raises(AlignmentError, match=r"too little overlap: at best \d+ cells .* it takes 4000 and 10\.0%"):
        align_maps(a, a, AlignSettings(min_cells=4000))
    empty = MapBuilder(Lattice.named("A2", 0.05), 3).build()
    with pytest.raises(AlignmentError, match="the second map has no occupied cell"):
        align_maps(a, empty)
    with pytest.raises(AlignmentError, match="the first map has no occupied cell"):
        align_maps(empty, a)
    with pytest.raises(ArgumentError, match="dimension 3"):
        align_maps(a, MapBuilder(Lattice.named("Z3", 0.1), 2).build())
    with pytest.raises(ArgumentError, match="not a setting"):
        AlignSettings(min_overlap=2.0)


def test_a_search_that_runs_out_of_time_proves_nothing() -> None:
    a, b = half("office", "A2", 0)[0], half("office", "A2", 1)[0]
    with pytest.raises(AlignmentError, match=r"not finished: \d+ of its \d+ cells meet"):
        align_maps(a, b, AlignSettings(time_limit=0.0))


@pytest.mark.parametrize("case", [case for case in SPATIAL if case.label in ("Z3@0.1", "D3@0.1", "D3*@0.1")], ids=str)
def test_maps_of_space_are_turned_about_the_vertical(case: Case) -> None:
    rng = np.random.default_rng(4)

    def surface(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> np.ndarray:
        low, size = np.array([x[0], y[0], z[0]]), np.array([x[1] - x[0], y[1] - y[0], z[1] - z[0]])
        area = np.prod(size[size > 0.0])
        return low + size * rng.uniform(0.0, 1.0, (int(500 * area), 3))

    floor = surface((0, 7), (0, 5), (0, 0))
    # Walls around 7 x 5 m, 2.2 m high, one of them with a niche; a cupboard, a bench and a screen.
    walls = np.concatenate([
        surface((0, 7), (0, 0), (0, 2.2)), surface((0, 0), (0, 5), (0, 2.2)), surface((7, 7), (0, 3), (0, 2.2)),
        surface((6, 7), (3, 3), (0, 2.2)), surface((6, 6), (3, 5), (0, 2.2)), surface((0, 6), (5, 5), (0, 2.2)),
        surface((2.1, 3.5), (1.4, 1.4), (0, 1.3)), surface((4.4, 4.4), (2.2, 3.9), (0, 1.8)),
        surface((1.2, 2.6), (3.3, 3.7), (0.5, 0.5)),
    ])  # fmt: skip
    lattice = case.lattice
    levels = range(3)
    true = Pose.from_quaternion([1.3, -0.7, 0.4], [0.0, 0.0, math.sin(0.45), math.cos(0.45)])

    def map_of(points: np.ndarray) -> Map:
        lists = [VoxelList.from_points(points, lattice.scaled(2.0**k)) for k in levels]
        return Map([Level(cells, VoxelList.empty(cells.lattice)) for cells in lists])

    # So small a room is much the same half a metre higher.
    less = AlignSettings(min_margin=0.1)
    found = align_maps(map_of(walls), map_of(true.inverse().apply(walls[walls[:, 0] > 1.5])), less)
    assert found.pose.is_close(true, metres=0.15, radians=math.radians(1.5)), (found.pose, true)
    assert found.pose.rotation[2, 2] == 1.0 and found.match.gap == 0
    # Floor on floor, as far as it goes, can meet more than the truth does where both maps end somewhere: nothing here
    # speaks against it, so that it must not be taken for the answer.
    whole = np.concatenate([floor, floor, walls])
    first, second = whole[whole[:, 0] < 5.0], whole[whole[:, 0] > 2.0]
    with pytest.raises(AlignmentError, match="ambiguous"):
        align_maps(map_of(first), map_of(true.inverse().apply(second)))


def test_merging_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b, other, out = (tmp_path / f"{name}.parquet" for name in ("a", "b", "room", "ab"))
    for path, building, which in ((a, "office", 0), (b, "office", 1), (other, "room", 0)):
        save_map(path, half(building, "A2", which)[0])
    assert main(["merge", str(a), str(b), "--align", "-o", str(out)]) == 0
    line = capsys.readouterr().out
    assert "2 maps merged" in line and "; b.parquet at (" in line and "degrees" in line and "overlap" in line
    assert load_map(out) == merge_aligned(load_map(a), load_map(b), align_maps(load_map(a), load_map(b)))
    refused = tmp_path / "no.parquet"
    assert main(["merge", str(a), str(other), "--align", "-o", str(refused)]) == 1
    _, err = capsys.readouterr()
    assert err.count("\n") == 1 and "room.parquet: not found in" in err
    assert not refused.exists()
    # Without the option maps in different frames are still not merged.
    assert main(["merge", str(a), str(b), "-o", str(refused)]) == 1 and "different frames" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.data
def test_halves_of_a_real_log_are_put_together(data_dir: Path) -> None:
    log = open_log(data_dir / "laser2d" / "mit-csail.clf.gz")
    events: list[Event] = list(log)
    middle = len(events) // 2
    _, whole = map_events(events)
    start = whole[sum(isinstance(event, Scan) for event in events[:middle])]
    (first, _), (second, _) = map_events(events[:middle]), map_events(events[middle:])
    found = align_maps(first.build(), second.build())
    # The second half alone begins where the whole run puts its first scan, but for what has drifted until then.
    assert found.pose.is_close(start, metres=0.5, radians=math.radians(3.0)), (found.pose, start)
    assert found.match.gap == 0 and found.overlap > 0.4 and found.contradicted < 0.1
