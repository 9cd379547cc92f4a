"""Maps of space that know nothing of each other: put together where they belong, refused with the reason elsewhere."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import AlignmentError, ArgumentError
from hexmap.cli import main
from hexmap.io.map_file import load_map, save_map
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.maps.map import Map
from hexmap.poses.pose import Pose
from hexmap.simulator.space import Building3D, simulate_lidar
from localisation.mapping.align_in_space import align_maps_in_space
from tests.lattices import JIT, SPATIAL, Case
from tests.localisation.slam.lidar_drives import QUICK, block, hall

pytestmark = pytest.mark.skipif(not JIT, reason="takes hours without the compiler")

# All rays of a sweep at once: what is tested is not how sweeps are deskewed.
STILL = replace(QUICK, sweep=0.0)


def part(building: Building3D, lattice: Lattice, first: int, last: int) -> tuple[Map, Pose]:
    """The map of a stretch of a drive in the frame of its own first pose, level, and that pose in the building."""
    run = list(simulate_lidar(building, lidar=STILL, seed=1, scans=last))[first:]
    R = np.eye(3)
    R[:2, :2] = Pose.planar(0.0, 0.0, run[0].T_map_lidar.theta).rotation
    start = Pose(R, run[0].T_map_lidar.translation)
    builder = MapBuilder(lattice, 3, min_range=0.5, spare_hits=True)
    for simulated in run[::3]:
        builder.fuse(replace(simulated.scan, times=None), start.inverse() @ simulated.T_map_lidar)
    return builder.build(frame=f"{building.name} {first}", source={"log": f"{building.name} {first}"}), start


@lru_cache
def named(which: str, name: str) -> tuple[Map, Pose]:
    lattice = Lattice.named(name, 0.15)
    if which == "other":
        return part(block(), lattice, 0, 40)
    return part(hall(), lattice, *((0, 40) if which == "first" else (35, 75)))


@pytest.mark.parametrize("name", ["D3", pytest.param("D3*", marks=pytest.mark.long), "Z3"])
def test_halves_of_a_drive_are_put_together(name: str) -> None:
    """The hall is much the same turned by half: a pillar and two boxes tell."""
    (a, start_a), (b, start_b) = named("first", name), named("second", name)
    found = align_maps_in_space(a, b)
    assert found.pose.is_close(start_a.inverse() @ start_b, metres=0.08, radians=math.radians(0.4))
    assert found.overlap > 0.6 and found.contradicted < 0.05 and found.met > 1000
    assert found.reverse_metres < 0.3


@pytest.mark.long
@pytest.mark.parametrize("name", ["Z3", "D3", "D3*"])
def test_another_place_is_refused_with_the_reason(name: str) -> None:
    with pytest.raises(AlignmentError, match=r"contradicted: at best .* free there|nor two of \d parts|ambiguous"):
        align_maps_in_space(named("first", name)[0], named("other", name)[0])


def test_maps_that_cannot_be_aligned_are_refused() -> None:
    a = named("first", "Z3")[0]
    empty = MapBuilder(Lattice.named("Z3", 0.15), 3).build()
    with pytest.raises(AlignmentError, match="the second map has no occupied cell"):
        align_maps_in_space(a, empty)
    with pytest.raises(ArgumentError, match="A2 is a lattice of the plane"):
        align_maps_in_space(a, MapBuilder(Lattice.named("A2", 0.05), 2).build())


def test_merging_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b, other, out = (tmp_path / f"{name}.parquet" for name in ("a", "b", "other", "ab"))
    for path, which in ((a, "first"), (b, "second"), (other, "other")):
        save_map(path, named(which, "Z3")[0])
    assert main(["merge", str(a), str(b), "--align", "-o", str(out)]) == 0
    line = capsys.readouterr().out
    assert "2 maps merged" in line and "; b.parquet at (" in line and "overlap" in line
    merged = load_map(out)
    assert merged.frame == "hall 0" and len(merged.sources()) == 2
    total = sum(load_map(path).levels[0].hits.total for path in (a, b))
    assert merged.levels[0].hits.total == total
    refused = tmp_path / "no.parquet"
    assert main(["merge", str(a), str(other), "--align", "-o", str(refused)]) == 1
    _, err = capsys.readouterr()
    assert err.count("\n") == 1 and "other.parquet: not found in" in err and not refused.exists()


@pytest.mark.long
@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_every_lattice_of_space(case: Case) -> None:
    lattice = case.lattice.scaled(0.15 / case.lattice.resolution)
    (a, start_a), (b, start_b) = part(hall(), lattice, 0, 40), part(hall(), lattice, 35, 75)
    found = align_maps_in_space(a, b)
    assert found.pose.is_close(start_a.inverse() @ start_b, metres=0.1, radians=math.radians(0.5))


@pytest.mark.long
def test_a_building_that_is_the_same_turned_by_half_is_refused() -> None:
    """A corridor around a block: what stands in it tells too little of where half of a drive lies."""
    lattice = Lattice.named("D3", 0.15)
    a, b = part(block(), lattice, 0, 110)[0], part(block(), lattice, 60, 190)[0]
    with pytest.raises(AlignmentError, match=r"ambiguous: 7\d\.\d% of its cells meet at .* and 7\d\.\d%"):
        align_maps_in_space(a, b)


@pytest.mark.long
def test_maps_that_reach_beyond_each_other_are_put_together_by_their_parts() -> None:
    lattice = Lattice.named("D3", 0.15)
    (a, start_a), (b, start_b) = part(block(), lattice, 0, 60), part(block(), lattice, 20, 120)
    found = align_maps_in_space(a, b)
    assert found.parts > 1 and found.pose.is_close(start_a.inverse() @ start_b, metres=0.1, radians=math.radians(0.5))
