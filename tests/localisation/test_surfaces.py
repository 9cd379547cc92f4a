"""Surfaces of a map in space: the kernels against slow obvious references, and scans that are drawn onto them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.lattice.lattice import Lattice
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from localisation.matching import _surface_kernels as kernels
from localisation.matching.surfaces import SurfaceMap, first_of_each_cell
from tests import reference
from tests.lattices import SPATIAL, Case

Cell = tuple[int, ...]
# What the module says of planes: ten points at least, as wide as a tenth of a resolution, and three times flatter.
LEAST, SPREAD, FLAT = 10, 0.1, 0.35


def scattered(seed: int, n: int = 1500) -> np.ndarray:
    """Points on two planes, a line and a bush, in half a metre: some dozen a cell of the lattices under test."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.25, 0.25, (n, 3))
    part = n // 5
    points[: 2 * part, 2] = -0.1 + 0.005 * rng.standard_normal(2 * part) + 0.3 * points[: 2 * part, 0]
    points[2 * part : 4 * part, 0] = 0.1 + 0.002 * rng.standard_normal(2 * part)
    points[4 * part : 4 * part + 50, 1:] = [0.02, 0.03]  # a ring's line
    points[4 * part + 50 :, 0] -= 0.3
    return points


def by_cell(case: Case, points: np.ndarray) -> dict[Cell, np.ndarray]:
    """The points of each cell, by the exact reference."""
    found: dict[Cell, list[np.ndarray]] = {}
    for cell, point in zip(reference.as_tuples(reference.nearest(case, points)), points, strict=True):
        found.setdefault(cell, []).append(point)
    return {cell: np.array(some) for cell, some in found.items()}


def plane_of(points: np.ndarray, resolution: float) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Mean, normal and variance of some points, or None where they are no plane."""
    if len(points) < LEAST:
        return None
    mean = points.mean(axis=0)
    values, axes = np.linalg.eigh((points - mean).T @ (points - mean) / len(points))
    if values[1] <= (SPREAD * resolution) ** 2 or values[0] >= FLAT**2 * values[1]:
        return None
    return mean, axes[:, 0], values[0]


def rows_of(surfaces: SurfaceMap) -> dict[Cell, int]:
    """The row of each cell, by looking at the table."""
    from hexmap.lattice.keys import unpack

    a = surfaces._arrays
    taken = a.table != kernels.EMPTY
    return dict(zip(reference.as_tuples(unpack(a.table[taken], 3)), a.rows[taken].tolist(), strict=True))


def assert_holds(surfaces: SurfaceMap, case: Case, points: np.ndarray) -> int:
    """Sums and planes are those of these points; return how many planes there are."""
    expected, rows, a = by_cell(case, points), rows_of(surfaces), surfaces._arrays
    assert {cell for cell, row in rows.items() if a.sums[row, 0] > 0} == set(expected)
    planes = 0
    for cell, some in expected.items():
        row = rows[cell]
        off = some - case.lattice.centres([cell])[0]
        x, y, z = off.T
        want = [
            len(some),
            *off.sum(axis=0),
            *[(u * v).sum() for u, v in ((x, x), (x, y), (x, z), (y, y), (y, z), (z, z))],
        ]
        np.testing.assert_allclose(a.sums[row], want, rtol=0, atol=1e-10)
        plane = plane_of(some, case.lattice.resolution)
        assert (a.variances[row] >= 0.0) == (plane is not None)
        if plane is not None:
            planes += 1
            np.testing.assert_allclose(a.means[row], plane[0], rtol=0, atol=1e-10)
            assert abs(a.normals[row] @ plane[1]) == pytest.approx(1.0, abs=1e-6)
            assert a.variances[row] == pytest.approx(plane[2], abs=1e-10)
    return planes


@pytest.mark.parametrize("case", SPATIAL, ids=str)
@settings(max_examples=5)
@given(seed=st.integers(0, 10**6))
def test_sums_and_planes_are_those_of_the_points_of_each_cell(case: Case, seed: int) -> None:
    points = scattered(seed)
    surfaces = SurfaceMap(case.lattice)
    for part in np.array_split(points, 3):
        surfaces.add(part)
    assert assert_holds(surfaces, case, points) > 3
    means, normals, counts = surfaces.planes()
    assert len(means) == len(normals) == (surfaces._arrays.variances >= 0.0).sum() and (counts >= LEAST).all()
    assert set(reference.as_tuples(surfaces.cells().index)) == set(by_cell(case, points))


@pytest.mark.parametrize("case", SPATIAL, ids=str)
@settings(max_examples=5)
@given(seed=st.integers(0, 10**6), cut=st.integers(0, 1500))
def test_what_is_added_and_taken_away_leaves_the_rest(case: Case, seed: int, cut: int) -> None:
    points = scattered(seed)
    surfaces = SurfaceMap(case.lattice)
    surfaces.add(points)
    surfaces.take_away(points[:cut])
    assert_holds(surfaces, case, points[cut:])
    # Where there is nothing there is nothing to take.
    surfaces.take_away(points[:3] + 5.0)
    assert_holds(surfaces, case, points[cut:])
    surfaces.add(points[:cut])
    assert_holds(surfaces, case, points)


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_room_is_made_where_there_are_many_cells(case: Case) -> None:
    points = np.random.default_rng(1).uniform(-2.0, 2.0, (30_000, 3))
    surfaces = SurfaceMap(case.lattice)
    surfaces.add(points)
    cells, counts = np.unique(case.lattice.quantise(points), axis=0, return_counts=True)
    assert len(surfaces) == len(cells) > 3 * 4096
    rows = rows_of(surfaces)
    found = [surfaces._arrays.sums[rows[cell], 0] for cell in reference.as_tuples(cells)]
    np.testing.assert_array_equal(found, counts)
    surfaces.take_away(points)
    assert len(surfaces.cells()) == 0 and len(surfaces.planes()[0]) == 0


@pytest.mark.parametrize("case", SPATIAL, ids=str)
@settings(max_examples=20)
@given(seed=st.integers(0, 10**6), n=st.integers(0, 300))
def test_the_first_point_of_each_cell(case: Case, seed: int, n: int) -> None:
    points = np.random.default_rng(seed).uniform(-0.2, 0.2, (n, 3))
    seen, expected = set(), []
    for cell, point in zip(reference.as_tuples(reference.nearest(case, points)) if n else [], points, strict=True):
        if cell not in seen:
            seen.add(cell)
            expected.append(point)
    np.testing.assert_array_equal(first_of_each_cell(points, case.lattice), np.array(expected).reshape(-1, 3))


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_points_find_the_planes_of_their_cells(case: Case) -> None:
    points, asked = scattered(4), np.random.default_rng(5).uniform(-0.4, 0.4, (600, 3))
    surfaces = SurfaceMap(case.lattice)
    surfaces.add(points)
    index, planes = np.empty((len(asked), 3), np.int32), np.empty(len(asked), np.int64)
    met = kernels.find_planes(surfaces._arrays, case.lattice.quantiser_tables, asked, index, planes)
    cells, rows = by_cell(case, points), rows_of(surfaces)
    expected = reference.as_tuples(reference.nearest(case, asked))
    assert reference.as_tuples(index) == expected
    assert met == sum(cell in cells for cell in expected)
    for cell, row in zip(expected, planes.tolist(), strict=True):
        on = cell in cells and plane_of(cells[cell], case.lattice.resolution) is not None
        assert row == (rows[cell] if on else -1)


# --- normal equations -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", SPATIAL, ids=str)
@pytest.mark.parametrize("width", [0.01, 0.05])
def test_the_normal_equations_are_the_derivatives_of_the_robust_cost(case: Case, width: float) -> None:
    points = scattered(6)
    surfaces = SurfaceMap(case.lattice)
    surfaces.add(points)
    placed = points[::3] + np.random.default_rng(7).normal(0.0, 0.02, points[::3].shape)
    index, planes = np.empty((len(placed), 3), np.int32), np.empty(len(placed), np.int64)
    kernels.find_planes(surfaces._arrays, case.lattice.quantiser_tables, placed, index, planes)
    origin, H, g = np.array([0.3, -0.2, 0.1]), np.full((6, 6), 9.0), np.full(6, 9.0)
    total, squares, count = kernels.normal_equations(surfaces._arrays, placed, planes, origin, width, H, g)

    a, on = surfaces._arrays, planes >= 0

    def distances(v: np.ndarray) -> np.ndarray:
        moved = (placed[on] - origin) @ exponential(v[3:]).T + origin + v[:3]
        return ((moved - a.means[planes[on]]) * a.normals[planes[on]]).sum(axis=1)

    def cost(v: np.ndarray) -> float:
        r = distances(v)
        # Geman and McClure: the weight of its derivative is 1 / (1 + r^2 / width^2)^2.
        return float((0.5 * r**2 / (1.0 + r**2 / width**2)).sum())

    r = distances(np.zeros(6))
    weights = 1.0 / (1.0 + (r / width) ** 2) ** 2
    assert count == on.sum() > 30
    assert total == pytest.approx(weights.sum()) and squares == pytest.approx((weights * r**2).sum())
    steps = 1e-6 * np.eye(6)
    np.testing.assert_allclose(g, [(cost(e) - cost(-e)) / 2e-6 for e in steps], rtol=1e-4, atol=1e-6)
    J = np.array([(distances(e) - distances(-e)) / 2e-6 for e in steps]).T
    np.testing.assert_allclose(H, J.T @ (weights[:, None] * J), rtol=1e-5, atol=1e-6)


# --- drawing --------------------------------------------------------------------------------------------------------


def sides(low: np.ndarray, high: np.ndarray, which: tuple[int, ...], rng: np.random.Generator, n: int) -> np.ndarray:
    """Points on some sides of a box, with a centimetre of noise: side 2 k and 2 k + 1 are across axis k."""
    out = []
    for side in which:
        points = rng.uniform(low, high, (n, 3))
        points[:, side // 2] = (low, high)[side % 2][side // 2]
        out.append(points + 0.01 * rng.standard_normal(points.shape))
    return np.concatenate(out)


LOW, HIGH = np.array([-3.0, -2.0, -1.0]), np.array([3.0, 2.0, 1.5])


def surfaces_at(case: Case, points: np.ndarray, resolution: float = 0.5) -> SurfaceMap:
    surfaces = SurfaceMap(case.lattice.scaled(resolution / case.lattice.resolution))
    surfaces.add(points)
    return surfaces


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_a_scan_is_drawn_to_where_it_was_taken(case: Case) -> None:
    rng = np.random.default_rng(0)
    surfaces = surfaces_at(case, sides(LOW, HIGH, (0, 1, 2, 3, 4, 5), rng, 4000))
    seen = sides(LOW, HIGH, (0, 1, 2, 3, 4, 5), rng, 400)
    for _ in range(12):
        true = Pose(exponential(rng.uniform(-0.5, 0.5, 3)), rng.uniform(-0.8, 0.8, 3))
        points = true.inverse().apply(seen)
        # Within a quarter of a cell, and what moves the walls as much.
        off = np.concatenate([rng.uniform(-0.12, 0.12, 3), rng.uniform(-0.04, 0.04, 3)])
        start = Pose(exponential(off[3:]) @ true.rotation, true.translation + off[:3])
        drawn = surfaces.draw(points, start)
        assert drawn.converged and drawn.pose.is_close(true, 0.005, 0.003)
        assert drawn.share > 0.7 and drawn.met > 0.95 and 0.005 < drawn.sigma < 0.02
        assert np.linalg.eigvalsh(drawn.information)[0] > 0.0


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_a_corridor_does_not_move_a_scan_along_itself(case: Case) -> None:
    """Whichever way it lies in the lattice."""
    low, high = LOW * [5.0, 0.5, 1.0], HIGH * [5.0, 0.5, 1.0]
    slid = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        lies = Pose(exponential(rng.uniform(-1.0, 1.0, 3) * [0.05, 0.05, 1.5]), rng.uniform(-1.0, 1.0, 3))
        surfaces = surfaces_at(case, lies.apply(sides(low, high, (2, 3, 4, 5), rng, 20_000)))
        seen = sides(low / [3.0, 1.0, 1.0], high / [3.0, 1.0, 1.0], (2, 3, 4, 5), rng, 600)
        for along in (-0.3, 0.2):
            start = Pose(exponential(np.array([0.01, -0.01, 0.02])), [along, 0.05, -0.04])
            drawn = surfaces.draw(seen, lies @ start)
            found = lies.inverse() @ drawn.pose
            assert drawn.converged and found.angle < 0.003
            np.testing.assert_allclose(found.translation[1:], 0.0, atol=0.003)
            slid.append(abs(float(found.translation[0]) - along))
    assert max(slid) < 0.003


@pytest.mark.parametrize("case", SPATIAL, ids=str)
def test_a_few_walls_hold_a_scan_on_a_wide_floor(case: Case) -> None:
    """A floor says much of tilt, metres away, which must not hide what little else there is to say of the place."""
    rng = np.random.default_rng(8)
    low, high = np.array([-40.0, -40.0, -1.0]), np.array([40.0, 40.0, -1.0])
    walls = [np.array([-6.0, -3.0, -1.0]), np.array([8.0, 5.0, 2.0])]
    surfaces = surfaces_at(
        case, np.concatenate([sides(low, high, (4,), rng, 300_000), sides(*walls, (0, 3), rng, 4000)])
    )
    seen = np.concatenate([sides(low, high, (4,), rng, 9_000), sides(*walls, (0, 3), rng, 120)])
    drawn = surfaces.draw(seen, Pose(exponential(np.array([0.0, 0.002, 0.005])), [0.1, -0.08, 0.02]))
    assert drawn.converged and drawn.pose.is_close(Pose.identity(3), 0.03, 0.006)


def test_a_floor_alone_holds_height_and_tilt_and_nothing_else() -> None:
    grid = np.stack(np.meshgrid(np.arange(-4, 4, 0.04), np.arange(-4, 4, 0.04)), -1).reshape(-1, 2)
    floor = np.insert(grid, 2, -1.0, axis=1)
    surfaces = SurfaceMap(Lattice.named("D3", 0.5))
    surfaces.add(floor)
    start = Pose(exponential(np.array([0.01, -0.02, 0.3])), [0.2, -0.1, 0.05])
    drawn = surfaces.draw(floor[(np.abs(floor[:, :2]) < 2.5).all(axis=1)], start)
    assert drawn.converged
    np.testing.assert_allclose(drawn.pose.translation, [0.2, -0.1, 0.0], atol=1e-3)
    np.testing.assert_allclose(drawn.pose.rotation[2], [0.0, 0.0, 1.0], atol=1e-3)
    assert math.atan2(drawn.pose.rotation[1, 0], drawn.pose.rotation[0, 0]) == pytest.approx(0.3, abs=1e-3)


def test_what_has_nothing_to_lie_on_stays_where_it_began() -> None:
    rng = np.random.default_rng(2)
    surfaces = SurfaceMap(Lattice.named("D3", 0.5))
    scan, start = sides(LOW, HIGH, (0, 2, 4), rng, 500), Pose(exponential(np.array([0.1, 0.0, 0.2])), [1.0, 2.0, 3.0])
    for _ in range(2):
        drawn = surfaces.draw(scan, start)
        assert not drawn.converged and drawn.pose == start and drawn.share == 0.0
        surfaces.add(scan + 50.0)
    assert not surfaces.draw(scan[:0], start).converged
    # Lines are no planes: rings on the floor pull nothing.
    ring = np.column_stack([np.cos(np.arange(0, 6.28, 0.002)), np.sin(np.arange(0, 6.28, 0.002)), np.zeros(3140)])
    lines = SurfaceMap(Lattice.named("D3", 0.5))
    lines.add(np.concatenate([r * ring for r in (2.0, 4.0, 6.0)]) * [1.0, 1.0, 0.0])
    assert not lines.draw(4.0 * ring, Pose.identity(3)).converged


def test_a_scan_that_would_move_too_far_has_met_something_else() -> None:
    rng = np.random.default_rng(3)
    surfaces = SurfaceMap(Lattice.named("D3", 0.5))
    surfaces.add(sides(LOW, HIGH, (0, 1, 2, 3, 4, 5), rng, 4000))
    scan, start = sides(LOW, HIGH, (0, 1, 2, 3, 4, 5), rng, 300), Pose(np.eye(3), [0.1, 0.0, 0.0])
    assert surfaces.draw(scan, start, farthest=0.3).converged
    drawn = surfaces.draw(scan, start, farthest=0.1)
    assert not drawn.converged and drawn.pose == start and drawn.share > 0.7


def test_the_same_points_give_the_same_bits() -> None:
    rng = np.random.default_rng(4)
    points, scan = sides(LOW, HIGH, (0, 1, 2, 3, 4, 5), rng, 2000), sides(LOW, HIGH, (0, 1, 2, 3, 4, 5), rng, 200)
    found = []
    for _ in range(2):
        surfaces = SurfaceMap(Lattice.named("D3*", 0.5))
        surfaces.add(points)
        drawn = surfaces.draw(scan, Pose(np.eye(3), [0.1, 0.05, 0.0]))
        found.append((drawn.pose.matrix().tobytes(), drawn.information.tobytes(), drawn.share, drawn.sigma))
    assert found[0] == found[1]


def test_wrong_input_is_refused_and_adds_nothing() -> None:
    with pytest.raises(ArgumentError, match="surfaces lie in space, and A2 is a lattice of the plane"):
        SurfaceMap(Lattice.named("A2", 0.1))
    surfaces = SurfaceMap(Lattice.named("D3", 0.1))
    for bad in (np.nan, np.inf, 1e12):
        with pytest.raises(BoundsError):
            surfaces.add(np.array([[0.0, 0.0, 0.0], [0.0, bad, 0.0]]))
        assert len(surfaces) == 0
    surfaces.add(np.zeros((0, 3)))
    assert len(surfaces) == 0 and len(surfaces.cells()) == 0 and len(surfaces.planes()[0]) == 0
