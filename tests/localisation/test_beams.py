"""Beams that contradict a map, against clipping every beam with every cell, on every lattice."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from localisation.matching.beams import contradicted_share
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from tests.lattices import CASES, JIT, SHEARED, Case

EVERY = [*CASES, *SHEARED]


def cells_met(cells: VoxelList, start: NDArray, end: NDArray) -> int:
    """How many of the cells a line goes through, and out again: clipped at the faces of each of them."""
    lattice = cells.lattice
    normals = lattice.cell.normals
    half = 0.5 * (normals**2).sum(axis=1)
    centres = lattice.centres(cells.index)
    # On the line x = start + t (end - start) a cell holds v . (x - centre) <= |v|^2 / 2 for each face v.
    rate = normals @ (end - start)
    room = half[None, :] - (start - centres) @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = room / rate[None, :]
    enter = np.where(rate < 0, t, -np.inf).max(axis=1)
    leave = np.where(rate > 0, t, np.inf).min(axis=1)
    parallel_outside = ((rate[None, :] == 0) & (room < 0)).any(axis=1)
    enter, leave = np.maximum(enter, 0.0), np.minimum(leave, 1.0)
    met = (leave - enter > 1e-9) & ~parallel_outside
    # Backwards from the end, cells that follow each other without a gap are a wall that the line has not left.
    inside, count = 1.0, int(met.sum())
    for k in np.argsort(-leave[met], kind="stable"):
        if leave[met][k] < inside - 1e-9:
            break
        inside = min(inside, float(enter[met][k]))
        count -= 1
    return count


def slow_share(cells: VoxelList, points: NDArray, pose: Pose) -> float:
    """The rule as it is told: two cells of walls and out again, four resolutions and 0.3 m before the end."""
    contradicted = 0
    for p in points:
        distance = float(np.linalg.norm(p))
        shorter = distance - max(0.3, 4.0 * cells.lattice.resolution)
        if shorter <= cells.lattice.resolution:
            continue
        end = pose.apply((p * (shorter / distance))[None])[0]
        contradicted += cells_met(cells, np.asarray(pose.translation), end) >= 2
    return contradicted / len(points)


@pytest.mark.parametrize("case", EVERY, ids=str)
@pytest.mark.parametrize("seed", range(4))
def test_it_is_equal_to_clipping_every_beam_with_every_cell(case: Case, seed: int) -> None:
    rng = np.random.default_rng([seed, case.dim])
    n = case.dim
    lattice = case.lattice.scaled([0.05, 0.2][seed % 2] / case.lattice.resolution)
    size = 25.0 * lattice.resolution
    count = (600 if n == 2 else 6000) if JIT else 300
    cells = VoxelList.from_points(rng.uniform(-size, size, (count, n)), lattice)
    points = rng.normal(0.0, 0.6 * size, (80 if JIT else 10, n))
    yaw = rng.uniform(-math.pi, math.pi)
    if n == 2:
        pose = Pose.planar(*rng.uniform(-size / 2, size / 2, 2), yaw)
    else:
        pose = Pose(exponential(rng.uniform(-1, 1, 3)), rng.uniform(-size / 2, size / 2, 3))
    share = contradicted_share(OccupancyPyramid(cells, 2), points, pose)
    assert share == slow_share(cells, points, pose)
    if JIT:
        assert 0.0 < share < 1.0  # the case tells something


def square_room(lattice: Lattice) -> tuple[OccupancyPyramid, NDArray]:
    """A room of 8 x 6 m with a wall across it at x = 1, and what is seen of it from the left half at (-2, 0)."""
    along = np.linspace(0.0, 1.0, 2000)[:, None]
    corners = [(-4, -3), (4, -3), (4, 3), (-4, 3), (-4, -3), (1, -3), (1, 3)]
    walls = np.concatenate(
        [np.array(a) * (1 - along) + np.array(b) * along for a, b in itertools.pairwise(corners)]
    ).astype(float)
    # Two cells thick, as walls are that were seen many times.
    walls = np.concatenate([walls, walls * 1.012])
    seen = []
    for angle in np.linspace(-math.pi, math.pi, 181)[:-1]:
        d = np.array([math.cos(angle), math.sin(angle)])
        reach = [t for t in ((3.0 / d[0]) if d[0] > 0 else (-2.0 / d[0]) if d[0] < 0 else math.inf,
                             3.0 / abs(d[1]) if d[1] else math.inf)]  # fmt: skip
        seen.append(min(reach) * d)
    return OccupancyPyramid(coincidence(VoxelList.from_points(walls, lattice))), np.array(seen)


@pytest.mark.parametrize("name", ["Z2", "A2"])
def test_no_beam_contradicts_the_right_pose_and_many_contradict_one_beyond_a_wall(name: str) -> None:
    pyramid, scan = square_room(Lattice.named(name, 0.05))
    assert contradicted_share(pyramid, scan, Pose.planar(-2.0, 0.0, 0.0)) == 0.0
    # From the right half every beam to the left that is longer than the room ends beyond the wall at x = 1.
    assert contradicted_share(pyramid, scan, Pose.planar(2.5, 0.0, math.pi)) > 0.2


def test_a_wall_one_cell_thick_that_is_met_once_contradicts_nothing() -> None:
    lattice = Lattice.named("Z2", 0.1)
    stray = VoxelList.from_points([[2.0, 0.0]], lattice)
    ends = np.array([[4.0, 0.0], [0.0, 4.0]])
    assert contradicted_share(OccupancyPyramid(stray), ends, Pose.identity(2)) == 0.0
    wall = VoxelList.from_points([[2.0, 0.0], [2.1, 0.0]], lattice)
    assert contradicted_share(OccupancyPyramid(wall), ends, Pose.identity(2)) == 0.5


def test_beams_too_short_to_tell_contradict_nothing() -> None:
    lattice = Lattice.named("A2", 0.1)
    cells = VoxelList.from_points([[0.1, 0.0], [0.2, 0.0], [0.3, 0.0]], lattice)
    assert contradicted_share(OccupancyPyramid(cells), np.array([[0.4, 0.0]]), Pose.identity(2)) == 0.0


def test_a_beam_that_ends_inside_a_thick_wall_is_not_beyond_it() -> None:
    lattice = Lattice.named("Z2", 0.1)
    x, y = np.meshgrid(np.arange(2.0, 3.0, 0.1), np.arange(-0.5, 0.55, 0.1))
    wall = OccupancyPyramid(VoxelList.from_points(np.stack([x.ravel(), y.ravel()], axis=1), lattice))
    assert contradicted_share(wall, np.array([[2.9, 0.0]]), Pose.identity(2)) == 0.0
    assert contradicted_share(wall, np.array([[4.0, 0.0]]), Pose.identity(2)) == 1.0
