"""Rays: exactly the cells that a straight line passes, on any lattice."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.lattice.lattice import Lattice
from hexmap.lattice.rays import traverse
from tests import reference
from tests.lattices import BULK, CASES, DYADIC, EXAMPLES, JIT, PART, SHEARED, Case

each = pytest.mark.parametrize("case", CASES, ids=str)
every = pytest.mark.parametrize("case", [*CASES, *DYADIC, *SHEARED], ids=str)
# The long run draws no more of them: among hundreds one runs in a face to the last bit, where on a rounded Gram matrix
# either cell is right and the reference, in exact numbers, knows one only.
RAYS = max(12, int(80 * min(PART, 1.0)))


def special_points(case: Case, rng: np.random.Generator, n: int, reach: int) -> np.ndarray:
    """Centres of cells, of their faces, and corners: the ends of lines that run in faces and meet corners."""
    cell = case.lattice.cell
    offsets = np.vstack([cell.vertices, cell.normals / 2, np.zeros((len(cell.vertices), case.dim))])
    centres = case.lattice.centres(rng.integers(-reach, reach + 1, (n, case.dim)))
    return centres + offsets[rng.integers(len(offsets), size=n)]


def compare(case: Case, starts: np.ndarray, ends: np.ndarray) -> None:
    """Hold each ray against clipping; on a rounded Gram matrix up to cells passed along almost nothing."""
    rays = traverse(case.lattice, starts, ends)
    assert len(rays) == len(starts) and rays.offsets[0] == 0 and rays.offsets[-1] == len(rays.index)
    for r in range(len(starts)):
        found = reference.as_tuples(rays.ray(r))
        if case.integer_gram is not None:
            assert found == reference.traversed(case, starts[r], ends[r]), f"ray {starts[r]!r} to {ends[r]!r}"
        else:
            surely = {c for _, c in reference.cells_along(case, starts[r], ends[r], Fraction(1, 10**7))}
            ours = set(found)
            assert surely <= ours and len(ours) == len(found), f"ray {starts[r]!r} to {ends[r]!r}"
            check_near(case, found, starts[r], ends[r])


def check_near(case: Case, cells: list[reference.Index], start: np.ndarray, end: np.ndarray) -> None:
    """Every cell of a ray has its centre within the covering radius of the segment."""
    x = case.lattice.centres(np.array(cells))
    along = end - start
    t = np.clip((x - start) @ along / max(along @ along, 1e-300), 0, 1)
    off = np.linalg.norm(x - start - t[:, None] * along, axis=1)
    assert off.max() <= case.lattice.covering_radius * (1 + 1e-6), f"ray {start!r} to {end!r}"


@every
def test_random_rays_equal_clipping(case: Case) -> None:
    rng = np.random.default_rng(1)
    reach = (12 if case.dim == 2 else 5) * case.lattice.resolution
    starts, ends = rng.uniform(-reach, reach, (2, RAYS, case.dim))
    compare(case, starts, ends)


@every
def test_rays_through_corners_and_along_faces_equal_clipping(case: Case) -> None:
    rng = np.random.default_rng(2)
    reach = 4 if case.dim == 2 else 2
    starts, ends = (special_points(case, rng, RAYS, reach) for _ in range(2))
    compare(case, starts, ends)


@every
def test_rays_along_lattice_directions_equal_clipping(case: Case) -> None:
    """From a corner or the middle of a face on, along neighbours and edges: whole stretches are ties."""
    rng = np.random.default_rng(3)
    cell = case.lattice.cell
    edges = np.array([cell.vertices[r[0]] - cell.vertices[r[1]] for r in cell.rings])
    directions = np.vstack([cell.normals, edges, np.eye(case.dim) * case.lattice.resolution])
    starts = special_points(case, rng, RAYS, 2)
    steps = rng.integers(1, 4, (RAYS, 1)) * directions[rng.integers(len(directions), size=RAYS)]
    compare(case, starts, starts + steps)


@each
def test_axis_aligned_rays_on_whole_centimetres(case: Case) -> None:
    rng = np.random.default_rng(4)
    whole = rng.integers(-8, 9, (RAYS, case.dim)) * 0.05
    ends = whole.copy()
    ends[np.arange(RAYS), rng.integers(case.dim, size=RAYS)] += rng.integers(-60, 61, RAYS) * 0.01
    compare(case, whole, ends)


def test_rays_on_squares_by_hand() -> None:
    lattice = Lattice.named("Z2", 1.0)

    def cells(*ends: float) -> list[list[int]]:
        return traverse(lattice, [ends[:2]], [ends[2:]]).ray(0).tolist()

    assert cells(0, 0, 3, 0) == [[0, 0], [1, 0], [2, 0], [3, 0]]
    assert cells(0, 0.5, 2, 0.5) == [[0, 0], [1, 0], [2, 0]], "along a face: the lower cells"
    assert cells(0, -0.5, 2, -0.5) == [[0, -1], [1, -1], [2, -1]]
    assert cells(0, 0, 2, 2) == [[0, 0], [1, 1], [2, 2]], "through corners"
    assert cells(0, 2, 2, 0) == [[0, 2], [1, 1], [2, 0]]
    assert cells(0, 0, 0, 0) == [[0, 0]]
    assert cells(0.5, 0.5, 0.5, 0.5) == [[0, 0]]
    assert cells(-0.5, 0, 0, 0) == [[-1, 0], [0, 0]], "the start's own cell, by the tie rule"


@each
def test_a_ray_without_length_is_one_cell(case: Case) -> None:
    points = special_points(case, np.random.default_rng(5), 60, 5)
    rays = traverse(case.lattice, points, points)
    np.testing.assert_array_equal(rays.index, case.lattice.quantise(points))
    np.testing.assert_array_equal(rays.offsets, np.arange(61))
    assert len(rays.without_ends()) == 0


@every
def test_ends_order_and_adjacency_of_many_rays(case: Case) -> None:
    """In bulk: the ends are quantised, no cell comes twice, each step crosses a face, edge or corner."""
    lattice = case.lattice
    rng = np.random.default_rng(6)
    n = max(40, BULK // 50)
    starts = np.vstack([special_points(case, rng, n, 6), rng.uniform(-6, 6, (n, case.dim)) * lattice.resolution])
    ends = np.vstack([special_points(case, rng, n, 6), rng.uniform(-6, 6, (n, case.dim)) * lattice.resolution])
    rays = traverse(lattice, starts, ends)
    np.testing.assert_array_equal(rays.index[rays.offsets[:-1]], lattice.quantise(starts))
    np.testing.assert_array_equal(rays.index[rays.offsets[1:] - 1], lattice.quantise(ends))
    ray_of = np.repeat(np.arange(len(rays)), np.diff(rays.offsets))
    assert len(np.unique(np.column_stack([ray_of, rays.index]), axis=0)) == len(rays.index), "all distinct"
    along = (ends - starts)[ray_of]
    x = lattice.centres(rays.index)
    t = ((x - starts[ray_of]) * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-300)
    off = np.linalg.norm(x - starts[ray_of] - np.clip(t, 0, 1)[:, None] * along, axis=1)
    assert off.max() <= lattice.covering_radius * (1 + 1e-6), (
        f"{(off > lattice.covering_radius * 1.000001).sum()} astray"
    )
    same = np.diff(ray_of) == 0
    moves = np.diff(rays.index.astype(np.int64), axis=0)[same]
    faces = {tuple(v) for v in lattice.faces.tolist()}
    by_face = np.array([tuple(v) in faces for v in moves.tolist()])
    # A corner touches no cell whose centre is farther away than twice the covering radius.
    jumps = np.linalg.norm(lattice.centres(moves[~by_face]), axis=1)
    assert (jumps <= 2 * lattice.covering_radius * (1 + 1e-6)).all()
    at_random = (ray_of >= n)[1:][same]
    assert by_face[at_random].all(), "random rays meet no corner"


@every
def test_the_way_back_passes_the_same_cells(case: Case) -> None:
    lattice = case.lattice
    rng = np.random.default_rng(7)
    starts, ends = rng.uniform(-8, 8, (2, max(40, BULK // 200), case.dim)) * lattice.resolution
    there, back = traverse(lattice, starts, ends), traverse(lattice, ends, starts)
    for r in range(len(there)):
        np.testing.assert_array_equal(there.ray(r), back.ray(r)[::-1])


@each
def test_moving_a_ray_by_a_lattice_vector_moves_its_cells(case: Case) -> None:
    lattice = case.lattice
    rng = np.random.default_rng(8)
    starts, ends = rng.uniform(-5, 5, (2, 30, case.dim)) * lattice.resolution
    v = np.array([70, -55, 31][: case.dim])
    moved = traverse(lattice, starts + lattice.centres(v[None]), ends + lattice.centres(v[None]))
    np.testing.assert_array_equal(moved.index, traverse(lattice, starts, ends).index + v)


@each
def test_long_rays_pass_as_many_cells_as_samples_find(case: Case) -> None:
    lattice = case.lattice
    rng = np.random.default_rng(9)
    length = 3000 if JIT else 100
    for _ in range(3):
        a = rng.uniform(-1, 1, case.dim) * lattice.resolution
        d = rng.normal(size=case.dim)
        b = a + d / np.linalg.norm(d) * length * lattice.resolution
        cells = traverse(lattice, a[None], b[None]).ray(0)
        t = np.linspace(0, 1, 200 * length)[:, None]
        sampled = lattice.quantise(a + t * (b - a))
        kept = sampled[np.r_[True, (np.diff(sampled, axis=0) != 0).any(axis=1)]]
        found = {tuple(c) for c in cells.tolist()}
        assert {tuple(c) for c in kept.tolist()} <= found, "samples miss short stretches, the traversal none"
        assert len(cells) <= len(kept) * 1.03 + 3


@each
def test_leaving_out_the_ends(case: Case) -> None:
    rng = np.random.default_rng(10)
    starts, ends = rng.uniform(-5, 5, (2, 20, case.dim)) * case.lattice.resolution
    starts[3] = ends[3]
    rays = traverse(case.lattice, starts, ends)
    expected = np.vstack([rays.ray(r)[:-1] for r in range(20)])
    np.testing.assert_array_equal(rays.without_ends(), expected)


@each
def test_no_rays(case: Case) -> None:
    rays = traverse(case.lattice, np.empty((0, case.dim)), np.empty((0, case.dim)))
    assert len(rays) == 0 and rays.index.shape == (0, case.dim) and len(rays.without_ends()) == 0


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_ends_are_checked() -> None:
    lattice = Lattice.named("A2", 0.1)
    for a, b in (([[0, 0]], [[0, 0, 0]]), ([[0, 0]], [[0, 0], [1, 1]]), ([0, 0], [1, 1]), ([[0, 0, 0]], [[1, 1, 1]])):
        with pytest.raises(ArgumentError):
            traverse(lattice, a, b)
    with pytest.raises(BoundsError, match="point 1"):
        traverse(lattice, [[0, 0], [0, 0]], [[1, 1], [np.nan, 0]])
    with pytest.raises(BoundsError):
        traverse(lattice, [[0, 0]], [[1e12, 0]])


@settings(max_examples=EXAMPLES, deadline=None)
@given(
    st.sampled_from([2, 3]).flatmap(
        lambda n: st.lists(st.lists(st.floats(-2, 2), min_size=n, max_size=n), min_size=n, max_size=n)
    ),
    st.integers(0, 2**32 - 1),
)
def test_rays_on_any_basis_end_where_they_should(basis: list[list[float]], seed: int) -> None:
    """Also between corners, where rounding may put a corner on either side of the ray."""
    B = np.array(basis)
    lengths = np.linalg.norm(B, axis=0)
    assume(lengths.min() > 0.2 and abs(np.linalg.det(B / lengths)) > 0.1)
    case = Case("any", Lattice(B))
    rng = np.random.default_rng(seed)
    n = 30
    starts, ends = special_points(case, rng, n, 3), special_points(case, rng, n, 3)
    rays = traverse(case.lattice, starts, ends)
    for r in range(n):
        check_near(case, reference.as_tuples(rays.ray(r)), starts[r], ends[r])
