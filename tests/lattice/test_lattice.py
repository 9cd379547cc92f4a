"""Lattices: the exact quantiser, the geometry of the cell, symmetries, steps between cells."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad
from scipy.spatial import cKDTree

from hexmap.base.errors import ArgumentError, BoundsError, HexmapError, LatticeError
from hexmap.lattice.lattice import NAMES, Lattice, default_name
from tests import reference
from tests.lattices import ALL, BULK, CASES, DYADIC, EXAMPLES, PART, PLANAR, SHEARED, Case, named

each = pytest.mark.parametrize("case", CASES, ids=str)
every = pytest.mark.parametrize("case", [*ALL, *DYADIC], ids=str)


def points_of_cells(case: Case, rng: np.random.Generator, cells: int) -> np.ndarray:
    """Corners, centres of faces and of edges, and centres of some cells: where ties are."""
    lattice = case.lattice
    V = lattice.cell.vertices
    pairs = {tuple(sorted((r[k - 1], r[k]))) for r in lattice.cell.rings for k in range(len(r))}
    edges = np.array([(V[a] + V[b]) / 2 for a, b in sorted(pairs)])
    middles = lattice.cell.normals / 2
    offsets = np.vstack([V, edges, middles, np.zeros((1, case.dim))])
    centres = lattice.centres(rng.integers(-40, 40, (cells, case.dim)))
    return (centres[:, None] + offsets).reshape(-1, case.dim)


# ---------------------------------------------------------------------- quantising


@each
def test_quantise_finds_the_nearest_of_all_centres(case: Case) -> None:
    """In metres, by a search tree over all centres: nothing here knows how the library thinks."""
    lattice = case.lattice
    rng = np.random.default_rng(1)
    reach = 30 if case.dim == 2 else 9
    inner = rng.uniform(-0.4, 0.4, (BULK, case.dim)) * reach @ lattice.basis.T
    index = np.array(list(itertools.product(range(-reach, reach + 1), repeat=case.dim)))
    best, _ = cKDTree(lattice.centres(index)).query(inner)
    found = np.linalg.norm(inner - lattice.centres(lattice.quantise(inner)), axis=1)
    assert np.abs(found - best).max() < 1e-8 * lattice.resolution


@every
def test_quantise_equals_the_reference_on_random_points(case: Case) -> None:
    rng = np.random.default_rng(2)
    exact_integers = case.integer_gram is not None
    points = rng.uniform(-300, 300, (BULK if exact_integers else BULK // 100, case.dim)) * case.lattice.resolution
    found, expected = case.lattice.quantise(points), reference.nearest(case, points)
    assert found.dtype == np.int32 and found.shape == points.shape
    np.testing.assert_array_equal(found, expected)


@every
def test_quantise_settles_ties_as_the_reference_does(case: Case) -> None:
    """On corners, edges and faces, where several centres are equally near."""
    points = points_of_cells(case, np.random.default_rng(3), max(2, int(40 * PART)))
    found = case.lattice.quantise(points)
    if case.integer_gram is not None:
        np.testing.assert_array_equal(found, reference.nearest(case, points))
        return
    # The Gram matrix of any basis is rounded, so that corners are corners only to 2^-32; the
    # centres of faces and of cells are exact, for there the matrix cancels.
    s, public, floor = reference.scores(case, points)
    chosen = np.argmax((floor[:, None] + public == found[:, None]).all(axis=2), axis=1)
    excess = s[np.arange(len(s)), chosen] - s.min(axis=1)
    unit = int(reference.reduced_gram(case).max()) * reference.ONE
    assert max(Fraction(int(v), unit) for v in excess) < Fraction(1, 2**31)
    exact = points_of_cells(case, np.random.default_rng(3), 2)[-len(case.lattice.faces) - 1 :]
    np.testing.assert_array_equal(case.lattice.quantise(exact), reference.nearest(case, exact))


@pytest.mark.parametrize("case", DYADIC, ids=str)
def test_corners_of_cubic_cells_are_true_ties(case: Case) -> None:
    """The reference itself: at these corners exactly as many centres tie as cells meet there."""
    meet = {"Z2 dyadic": {4}, "Z3 dyadic": {8}, "D3 dyadic": {4, 6}, "D3* dyadic": {4}}[case.label]
    s, public, floor = reference.scores(case, case.lattice.cell.vertices)
    ties = s == s.min(axis=1)[:, None]
    assert set(ties.sum(axis=1)) == meet
    for row, tie in enumerate(ties):
        lowest = min(reference.as_tuples(floor[row] + public[tie]))
        assert reference.as_tuples(case.lattice.quantise(case.lattice.cell.vertices[row : row + 1])) == [lowest]


@pytest.mark.parametrize("name", ["Z2", "Z3"])
def test_whole_centimetres_go_to_the_lower_index(name: str) -> None:
    """Sensors report whole centimetres: at 0.1 m every tenth one lies exactly between two cells."""
    lattice = Lattice.named(name, resolution=0.1)
    centimetres = np.arange(-4000, 4001)
    expected = -((5 - centimetres) // 10)  # ceil(c / 10 - 1/2) in integers
    for written in (centimetres * 0.01, centimetres / 100, np.round(centimetres * 0.01, 2)):
        points = np.repeat(written[:, None], lattice.dim, axis=1)
        np.testing.assert_array_equal(lattice.quantise(points), np.repeat(expected[:, None], lattice.dim, axis=1))


@every
def test_moving_by_a_lattice_vector_moves_the_index(case: Case) -> None:
    lattice = case.lattice
    rng = np.random.default_rng(4)
    n = max(200, BULK // 50)
    whole = rng.integers(-500, 500, (n, case.dim)) * 0.01
    points = np.vstack([whole, points_of_cells(case, rng, 2)])
    v = rng.integers(-300, 300, points.shape)
    np.testing.assert_array_equal(lattice.quantise(points + lattice.centres(v)), lattice.quantise(points) + v)


@pytest.mark.parametrize("name", ["Z2", "Z3"])
def test_ties_are_settled_alike_far_from_the_origin(name: str) -> None:
    """At ten kilometres the sum of two exact decimals is off by far more than near the origin."""
    lattice = Lattice.named(name, resolution=0.1)
    rng = np.random.default_rng(15)
    halves = rng.integers(-100, 100, (max(500, BULK // 20), lattice.dim)) * 0.05
    v = rng.integers(-100_000, 100_000, halves.shape)
    np.testing.assert_array_equal(lattice.quantise(halves + lattice.centres(v)), lattice.quantise(halves) + v)


@each
def test_symmetric_points_have_symmetric_indices(case: Case) -> None:
    """Up to ties, which no rule can settle symmetrically."""
    lattice = case.lattice
    rng = np.random.default_rng(5)
    points = rng.uniform(-20, 20, (max(100, BULK // 100), case.dim)) * lattice.resolution
    index = lattice.quantise(points)
    inverse = np.linalg.inv(lattice.basis)
    for M in lattice.point_group:
        turned = points @ (lattice.basis @ M @ inverse).T
        differ = (lattice.quantise(turned) != index @ M.T).any(axis=1)
        # At random the second nearest centre is never as near as this; a tie would be.
        gap = np.linalg.norm(turned - lattice.centres(index @ M.T), axis=1) - np.linalg.norm(
            turned - lattice.centres(lattice.quantise(turned)), axis=1
        )
        assert (np.abs(gap[differ]) < 1e-9).all() and differ.mean() < 0.01


def test_the_papers_rounding_of_dn_is_wrong_for_a_quarter_of_all_points() -> None:
    """Misprint: rounding the worst component "further from zero", where the other side of x is meant."""
    case = DYADIC[2]
    rng = np.random.default_rng(6)
    x = rng.uniform(-50, 50, (BULK, 3))

    def round_to_even_sum(step: np.ndarray) -> np.ndarray:
        f = np.rint(x)
        worst = np.argmax(np.abs(x - f), axis=1)[:, None]
        moved = np.take_along_axis(f + step, worst, axis=1)
        odd = f.sum(axis=1) % 2 != 0
        g = f.copy()
        np.put_along_axis(g, worst, moved, axis=1)
        f[odd] = g[odd]
        return f

    away_from_zero = round_to_even_sum(np.where(np.rint(x) >= 0, 1.0, -1.0))
    other_side = round_to_even_sum(np.where(x - np.rint(x) >= 0, 1.0, -1.0))
    ours = case.lattice.centres(case.lattice.quantise(x))
    np.testing.assert_array_equal(ours, other_side)
    right = (away_from_zero == ours).all(axis=1).mean()
    assert right == pytest.approx(0.75, abs=0.01 if BULK > 10_000 else 0.06)


@each
def test_any_layout_and_width_of_input_gives_the_same(case: Case) -> None:
    lattice = case.lattice
    rng = np.random.default_rng(7)
    p = rng.uniform(-3, 3, (max(50, BULK // 100), case.dim)).astype(np.float32)
    expected = lattice.quantise(p.astype(np.float64))
    frozen = p.astype(np.float64)
    frozen.setflags(write=False)
    wide = np.zeros((2 * len(p), case.dim + 3), np.float32)
    wide[::2, 1 : 1 + case.dim] = p
    for given_points in (
        p, np.asfortranarray(p), np.asfortranarray(p.astype(np.float64)), wide[::2, 1 : 1 + case.dim], frozen,
        p.tolist(), p[::-1][::-1], p.astype(">f8"),
    ):  # fmt: skip
        np.testing.assert_array_equal(lattice.quantise(given_points), expected)
    np.testing.assert_array_equal(lattice.quantise([[1] * case.dim]), lattice.quantise([[1.0] * case.dim]))
    np.testing.assert_array_equal(np.vstack([lattice.quantise(p[:7]), lattice.quantise(p[7:])]), expected)
    assert (p == wide[::2, 1 : 1 + case.dim]).all(), "the input was written to"


@each
def test_no_points_give_no_indices(case: Case) -> None:
    for nothing in ([], np.empty((0, case.dim)), np.empty((0, case.dim), np.float32), np.empty(0)):
        assert case.lattice.quantise(nothing).shape == (0, case.dim)
        assert case.lattice.quantise(nothing).dtype == np.int32
    assert case.lattice.centres(np.empty((0, case.dim), np.int32)).shape == (0, case.dim)


# With the JIT off numpy warns of the arithmetic that compiled code does silently.
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@each
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300, -1e18])
@pytest.mark.parametrize("row", [0, 3, 700])
def test_the_first_row_that_cannot_be_quantised_is_named(case: Case, bad: float, row: int) -> None:
    points = np.zeros((900, case.dim))
    points[row, row % case.dim] = bad
    points[row + 1 :: 50] = math.nan
    with pytest.raises(BoundsError, match=rf"point {row} ") as caught:
        case.lattice.quantise(points)
    assert isinstance(caught.value, ValueError) and isinstance(caught.value, HexmapError)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("shape", [(3,), (2, 1), (2, 4), (1, 2, 2), (0, 5)])
def test_points_of_the_wrong_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ArgumentError):
        Lattice.named("Z2").quantise(np.zeros(shape))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@each
def test_indices_reach_to_the_limit_and_not_beyond(case: Case) -> None:
    lattice = case.lattice
    top = lattice.limit - 1
    assert top == (2**31 - 2 if case.dim == 2 else 2**20 - 1)
    for axis, sign in itertools.product(range(case.dim), (1, -1)):
        index = np.zeros((1, case.dim), np.int64)
        index[0, axis] = sign * top
        np.testing.assert_array_equal(lattice.quantise(lattice.centres(index)), index)
        index[0, axis] += sign
        with pytest.raises(BoundsError, match="point 0 is out of range"):
            lattice.quantise(lattice.centres(index))
        with pytest.raises(BoundsError, match="index 0 is out of range"):
            lattice.check_index(index)


def test_no_integer_is_too_large_to_be_refused() -> None:
    for value in (2**31, 2**62, 2**63 - 1, -(2**63)):
        with pytest.raises(BoundsError):
            Lattice.named("Z2").check_index(np.array([[0, value]]))


@each
def test_large_indices_come_back(case: Case) -> None:
    rng = np.random.default_rng(8)
    index = rng.integers(-case.lattice.limit // 3, case.lattice.limit // 3, (200, case.dim))
    np.testing.assert_array_equal(case.lattice.quantise(case.lattice.centres(index)), index)


@each
def test_coordinates_are_multiples_of_the_grid_and_give_the_points_back(case: Case) -> None:
    lattice = case.lattice
    points = np.random.default_rng(9).uniform(-5, 5, (100, case.dim))
    u = lattice.coordinates(points)
    assert (u * 2.0**32 == np.rint(u * 2.0**32)).all()
    basis = lattice.basis @ reference.to_public(case)
    np.testing.assert_allclose(u @ basis.T, points, atol=2.0**-31 * np.abs(basis).max() * case.dim)


bases = st.sampled_from([2, 3]).flatmap(
    lambda n: st.one_of(
        st.lists(st.lists(st.integers(-4, 4), min_size=n, max_size=n), min_size=n, max_size=n),
        st.lists(st.lists(st.floats(-2, 2), min_size=n, max_size=n), min_size=n, max_size=n),
    )
)


# The long run draws no more of them, until the two tests below pass: among hundreds there is one such basis.
BASES = min(EXAMPLES, 50)


def test_a_basis_that_is_almost_square_has_a_cell() -> None:
    for hair in 10.0 ** np.arange(-12.0, -5.0, 0.25):
        assert Lattice([[1.0, 0.0], [hair, 1.0]]).cell.volume == pytest.approx(1.0)


def test_a_shell_has_with_each_vector_its_opposite() -> None:
    for hair in 10.0 ** np.arange(-12.0, -5.0, 0.25):
        lattice = Lattice([[0.0, 1.0], [1.0 + hair, 0.0]])
        for vectors in map(lattice.shell, lattice.shell_sizes):
            assert {(-a, -b) for a, b in vectors.tolist()} == set(map(tuple, vectors.tolist())), hair


def any_lattice(basis: list[list[float]]) -> Lattice:
    """The lattice of a random basis, where that is not nearly flat."""
    B = np.array(basis, dtype=float)
    lengths = np.linalg.norm(B, axis=0)
    assume(lengths.min() > 0.1 and abs(np.linalg.det(B / lengths)) > 0.02)
    return Lattice(B)


@settings(max_examples=BASES, deadline=None)
@given(bases, st.integers(0, 2**32 - 1))
def test_any_basis_is_quantised_to_the_nearest_point(basis: list[list[float]], seed: int) -> None:
    lattice = any_lattice(basis)
    case = Case("any", lattice)
    rng = np.random.default_rng(seed)
    points = rng.uniform(-9, 9, (40, lattice.dim))
    np.testing.assert_array_equal(lattice.quantise(points), reference.nearest(case, points, reach=2))
    assert lattice.cell.volume == pytest.approx(lattice.cell_volume)
    corners, faces = len(lattice.cell.vertices), len(lattice.faces)
    sides = sum(len(ring) for ring in lattice.cell.rings) // 2
    if (lattice.basis == np.rint(lattice.basis)).all():  # else faces may be thinner than the corners are exact
        assert corners == (faces if lattice.dim == 2 else sides - faces + 2), "Euler"


@pytest.mark.parametrize(
    "basis",
    [
        [[1, 1e-7], [0, 1]],
        [[1, 0.5], [0, 0.8660254]],
        [[0, 0, 1], [0, 1, 0], [1, 0, 1e-7]],
        [[0, 0, 1], [0, 1, 0], [0.75, 1, 1e-7]],
        [[1, 0.5, 0.5], [0, 0.8660254, 0.2886751], [0, 0, 0.8164966]],
    ],
)
def test_a_basis_written_with_seven_digits_works(basis: list[list[float]]) -> None:
    """Its cell has slivers for faces, where that of the lattice that was meant has edges."""
    case = Case("seven digits", Lattice(basis))
    points = np.random.default_rng(16).uniform(-9, 9, (200, case.dim))
    np.testing.assert_array_equal(case.lattice.quantise(points), reference.nearest(case, points))
    assert case.lattice.cell.volume == pytest.approx(case.lattice.cell_volume)
    assert case.lattice.covering_radius < 1.0 and case.lattice.cell.mean_error < 0.5


@settings(max_examples=EXAMPLES, deadline=None)
@given(st.sampled_from([2, 3]).flatmap(lambda n: st.lists(st.integers(-2, 2), min_size=3, max_size=3)), st.booleans())
def test_hidden_squares_and_cubes_settle_ties_by_the_lower_index(shear: list[int], planar: bool) -> None:
    """Four or eight cells meet at every corner, whatever the basis."""
    a, b, c = shear
    basis = [[1, a], [b, 1 + a * b]] if planar else [[1, a, b], [0, 1, c], [0, 0, 1]]
    B = np.array(basis)
    case = Case("hidden", Lattice(B.astype(float)), (B.T @ B).tolist())
    halves = np.array(list(itertools.product((-0.5, 0.0, 0.5, 1.5), repeat=case.dim)))
    np.testing.assert_array_equal(case.lattice.quantise(halves), reference.nearest(case, halves, reach=3))


# ---------------------------------------------------------------------- the value


def test_lattices_are_values() -> None:
    a = Lattice.named("D3*", resolution=0.1)
    assert a == Lattice.named("D3s", resolution=0.1) == Lattice.named("BCC", 0.1)
    assert hash(a) == hash(Lattice.named("bcc", 0.1))
    assert a != Lattice.named("D3*", resolution=0.2) and a != Lattice.named("Z3", 0.1)
    assert (a == "D3*") is False
    assert Lattice.from_dict(a.to_dict()) == a
    assert Lattice(a.basis) == a, "names do not count"
    with pytest.raises(ValueError, match="read-only"):
        a.basis[0, 0] = 1.0
    given_basis = np.eye(2)
    b = Lattice(given_basis)
    given_basis[0, 0] = 7.0
    assert b.basis[0, 0] == 1.0


@pytest.mark.parametrize("name", [name for name in NAMES])
def test_resolution_is_the_side_of_an_equal_square_or_cube(name: str) -> None:
    for r in (0.05, 1.0, 3.0):
        lattice = Lattice.named(name, resolution=r)
        assert lattice.resolution == pytest.approx(r, rel=1e-12)
        assert lattice.cell_volume == pytest.approx(r**lattice.dim, rel=1e-12)
        assert lattice.cell.volume == pytest.approx(r**lattice.dim, rel=1e-9)
        assert lattice.scaled(2.0).resolution == pytest.approx(2 * r, rel=1e-12)
        assert name in repr(lattice)


def test_defaults_by_dimension() -> None:
    assert default_name(2) == "A2" and default_name(3) == "D3"


@pytest.mark.parametrize(
    "basis", [[[1, 2], [2, 4]], np.eye(4), [1, 2], [[1, math.nan], [0, 1]], [[0, 0], [0, 1]], [[math.inf, 0], [0, 1]]]
)
def test_what_is_not_a_basis_is_refused(basis: object) -> None:
    with pytest.raises(LatticeError):
        Lattice(basis)


def test_unknown_names_and_resolutions_are_refused() -> None:
    with pytest.raises(LatticeError, match="Z2, A2, Z3"):
        Lattice.named("E8")
    for r in (0, -1.0, math.nan, math.inf, "fine"):
        with pytest.raises(LatticeError):
            Lattice.named("A2", r)  # type: ignore[arg-type]
    for value in ({}, {"basis": "x"}, {"basis": [[1, 1], [1, 1]]}, {"basis": None}):
        with pytest.raises(LatticeError):
            Lattice.from_dict(value)
    for factor in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(LatticeError):
            Lattice.named("A2").scaled(factor)


# ---------------------------------------------------------------------- the geometry

FACTS = {  # nearest, faces, point group, neighbourhoods, corners of the cell
    "Z2": (4, 4, 8, (4, 8, 16), 4),
    "A2": (6, 6, 12, (6, 12), 6),
    "Z3": (6, 6, 48, (6, 18, 26), 8),
    "D3": (12, 12, 48, (12, 18), 14),
    "D3*": (8, 14, 48, (8, 14), 24),
    "A2xZ": (8, 8, 24, (8, 20), 12),
}
EXTENDED = {"Z2": 8, "A2": 12, "Z3": 18, "D3": 18, "D3*": 14, "A2xZ": 20}
# G, packing density and covering thickness in closed form (Conway and Sloane, SPLAG, tables 1.2 and 2.1).
QUALITY = {
    "Z2": (1 / 12, math.pi / 4, math.pi / 2),
    "A2": (5 / (36 * math.sqrt(3)), math.pi / math.sqrt(12), 2 * math.pi / math.sqrt(27)),
    "Z3": (1 / 12, math.pi / 6, math.pi * math.sqrt(3) / 2),
    "D3": (2 ** (-11 / 3), math.pi / math.sqrt(18), 2 * math.pi / 3),
    "D3*": (19 / (192 * 2 ** (1 / 3)), math.pi * math.sqrt(3) / 8, 5 * math.sqrt(5) * math.pi / 24),
}


@pytest.mark.parametrize("name", FACTS)
def test_neighbours_faces_and_symmetries(name: str) -> None:
    nearest, faces, order, shells, corners = FACTS[name]
    for r in (1.0, 0.05):
        lattice = Lattice.named(name, resolution=r)
        assert len(lattice.nearest) == nearest and len(lattice.faces) == faces
        assert len(lattice.point_group) == order
        for size in shells:
            shell = lattice.shell(size)
            assert shell.shape == (size, lattice.dim) and len(np.unique(shell, axis=0)) == size
        assert len(lattice.extended) == EXTENDED[name]
        assert len(lattice.cell.vertices) == corners
        lengths = np.linalg.norm(lattice.centres(lattice.nearest), axis=1)
        assert np.ptp(lengths) < 1e-9 * r, "the nearest are equidistant"
        with pytest.raises(ArgumentError, match=str(nearest)):
            lattice.shell(nearest + 1)


@pytest.mark.parametrize("case", [*ALL, *DYADIC], ids=str)
def test_shells_are_the_shortest_primitive_vectors(case: Case) -> None:
    lattice = case.lattice
    box = np.array(list(itertools.product(range(-12, 13), repeat=case.dim)))
    box = box[np.gcd.reduce(box, axis=1) == 1]
    box = box @ reference.to_public(case).T
    lengths = np.linalg.norm(lattice.centres(box), axis=1)
    order = np.argsort(lengths)
    for size in lattice.shell_sizes[:3]:
        expected = {tuple(v) for v in box[order[:size]].tolist()}
        assert {tuple(v) for v in lattice.shell(size).tolist()} == expected
        assert lengths[order[size]] > lengths[order[size - 1]] * (1 + 1e-9), "a shell is whole"


def test_shells_of_a_long_cell_are_complete() -> None:
    """In a long brick vectors of many short steps are still short."""
    lattice = Lattice([[1.0, 0.0], [0.0, 100.0]])
    sizes = [size for size in lattice.shell_sizes if size > 20]
    lengths = np.linalg.norm(lattice.centres(lattice.shell(sizes[0])), axis=1)
    expected = sorted(math.hypot(a, 100 * b) for a in range(-60, 61) for b in range(-2, 3) if math.gcd(a, b) == 1)
    np.testing.assert_allclose(np.sort(lengths), expected[: sizes[0]])


@pytest.mark.parametrize("case", [*CASES, *DYADIC, *SHEARED], ids=str)
def test_the_point_group_is_all_symmetries_and_a_group(case: Case) -> None:
    group = case.lattice.point_group
    members = {tuple(int(v) for v in M.ravel()) for M in group}
    assert len(members) == len(group)
    if case.integer_gram is not None:
        assert all(reference.is_symmetry(case, M) for M in group)
        assert members == reference.symmetries(case)
    assert tuple(np.eye(case.dim, dtype=int).ravel()) in members
    assert tuple(-np.eye(case.dim, dtype=int).ravel()) in members
    assert all(tuple(int(v) for v in (a @ b).ravel()) in members for a in group[:6] for b in group)


@pytest.mark.parametrize("shear", [0, 1, 3, 10, -7])
def test_symmetries_do_not_depend_on_the_basis(shear: int) -> None:
    assert len(Lattice([[1, shear], [0, 1]]).point_group) == 8
    assert len(Lattice([[1, shear, 0], [0, 1, 0], [0, -shear, 1]]).point_group) == 48


@pytest.mark.parametrize("name", QUALITY)
def test_quality_of_the_quantisers_in_closed_form(name: str) -> None:
    G, density, thickness = QUALITY[name]
    for r in (1.0, 0.1):
        lattice = Lattice.named(name, resolution=r)
        assert lattice.cell.second_moment == pytest.approx(G, rel=1e-9)
        assert lattice.packing_density == pytest.approx(density, rel=1e-9)
        assert lattice.covering_thickness == pytest.approx(thickness, rel=1e-9)


def _mean_distance(reach: float, third: Callable[[float, float], float], second: Callable[[float], float]) -> float:
    """Mean of |x| over the 48th part 0 <= z <= y <= x of a cubic cell, by quadrature, at unit volume.

    ``x`` goes to ``reach``, ``y`` to ``second(x)`` and ``z`` to ``third(x, y)``.
    """

    def integral(power: int) -> float:
        def inner(y: float, x: float) -> float:
            z = third(x, y)
            if power == 0:
                return z
            h2 = x * x + y * y
            return 0.5 * (z * math.sqrt(h2 + z * z) + h2 * math.asinh(z / math.sqrt(h2)))

        return dblquad(inner, 0, reach, 0, second, epsabs=1e-11, epsrel=1e-11)[0]

    volume = 48 * integral(0)
    return 48 * integral(1) / volume / volume ** (1 / 3)


# Mean distance from the centre of a unit cell: in closed form, and by an integration of its own for
# D3 and D3*. The table of lattices.md has 0.4802, 0.4694 and 0.4693 for the three in space; the
# fourth digits are 0.4803, 0.4695 and 0.4691.
MEAN_ERROR = {
    "Z2": lambda: (math.sqrt(2) + math.asinh(1)) / 6,
    "A2": lambda: math.sqrt(2 / (3 * math.sqrt(3))) * (1 / 3 + math.log(3) / 4),
    "Z3": lambda: math.sqrt(3) / 8 - math.pi / 48 + math.log(2 + math.sqrt(3)) / 4,
    "D3": lambda: _mean_distance(1.0, lambda x, y: y, lambda x: min(x, 1 - x)),
    "D3*": lambda: _mean_distance(0.5, lambda x, y: max(0.0, min(y, 0.75 - x - y)), lambda x: min(x, 0.75 - x)),
}
DIGITS = {"Z2": 0.3826, "A2": 0.3772, "Z3": 0.4803, "D3": 0.4695, "D3*": 0.4691}


@pytest.mark.parametrize("name", MEAN_ERROR)
def test_mean_error_of_the_quantisers(name: str) -> None:
    found = Lattice.named(name, 0.1).cell.mean_error
    assert found == pytest.approx(MEAN_ERROR[name](), rel=1e-7)
    assert round(found, 4) == DIGITS[name]


@each
def test_moments_and_mean_error_by_sampling_whole_cells(case: Case) -> None:
    """Points uniform over a unit cell of the basis: a box cut anywhere would be biased."""
    lattice = case.lattice
    n = 10 * BULK
    rng = np.random.default_rng(10)
    points = rng.random((n if BULK > 10_000 else BULK, case.dim)) @ lattice.basis.T
    error = np.linalg.norm(points - lattice.centres(lattice.quantise(points)), axis=1) / lattice.resolution
    for values, expected in (
        (error, lattice.cell.mean_error),
        (error**2 / case.dim, lattice.cell.second_moment),
    ):
        assert abs(values.mean() - expected) < 5 * values.std() / math.sqrt(len(values))
    assert error.max() <= lattice.covering_radius / lattice.resolution * (1 + 1e-8)


@each
def test_cell_volume_by_counting_points_in_a_box(case: Case) -> None:
    """As in the paper's section IV-B: of points uniform in a box, the share that falls into one cell."""
    lattice = case.lattice
    rng = np.random.default_rng(11)
    reach = 1.05 * np.abs(lattice.cell.vertices).max(axis=0)
    points = rng.uniform(-1, 1, (2 * BULK, case.dim)) * reach
    inside = (lattice.quantise(points) == 0).all(axis=1)
    box = float(np.prod(2 * reach))
    share = lattice.cell_volume / box
    assert abs(inside.mean() - share) < 5 * math.sqrt(share * (1 - share) / len(points))
    by_planes = (points @ lattice.cell.normals.T <= 0.5 * (lattice.cell.normals**2).sum(axis=1)).all(axis=1)
    assert (inside != by_planes).mean() < 1e-6, "the polytope is what quantises to the origin"


@each
def test_the_cell_is_the_polytope_of_its_faces(case: Case) -> None:
    lattice = case.lattice
    cell = lattice.cell
    half = 0.5 * (cell.normals**2).sum(axis=1)
    np.testing.assert_array_equal(cell.faces, lattice.faces)
    np.testing.assert_allclose(cell.normals, lattice.centres(lattice.faces))
    assert (cell.vertices @ cell.normals.T <= half * (1 + 1e-9)).all()
    for ring, normal, h in zip(cell.rings, cell.normals, half, strict=True):
        np.testing.assert_allclose(cell.vertices[ring] @ normal, h)
        assert len(set(ring.tolist())) == len(ring) >= case.dim
        if case.dim == 3:
            corners = cell.vertices[ring]
            for k in range(len(ring)):
                turn = np.cross(corners[k] - corners[k - 1], corners[(k + 1) % len(ring)] - corners[k])
                assert turn @ normal > 0, "counter-clockwise from outside"
    assert lattice.inradius == pytest.approx(math.sqrt(half.min() / 2))
    faces = {tuple(v) for v in lattice.faces.tolist()}
    assert faces == {tuple(-v for v in f) for f in faces}
    if case.dim == 2:
        x, y = cell.vertices.T
        assert (x * np.roll(y, -1) - y * np.roll(x, -1) > 0).all(), "counter-clockwise"


def test_orientation_is_as_fixed() -> None:
    hexagon = Lattice.named("A2").cell
    sides = [hexagon.vertices[b] - hexagon.vertices[a] for a, b in hexagon.rings]
    parallel = [s for s in sides if abs(s[1]) < 1e-12]
    assert len(parallel) == 2, "two edges parallel to x"
    t = np.linalg.norm(sides[0])
    # Eq. 2: rectangular sublattices of 3 t by sqrt(3) t, the second offset by half of each.
    rectangles = np.array([[3 * t, 0], [0, math.sqrt(3) * t], [1.5 * t, math.sqrt(3) / 2 * t]])
    lattice = Lattice.named("A2")
    np.testing.assert_allclose(lattice.centres(lattice.quantise(rectangles)), rectangles, atol=1e-12)
    assert lattice.cell_volume == pytest.approx(1.5 * math.sqrt(3) * t * t)

    index = np.array(list(itertools.product(range(-3, 4), repeat=3)))
    fcc = np.rint(Lattice.named("D3").centres(index) * 2 ** (1 / 3)).astype(int)
    np.testing.assert_allclose(Lattice.named("D3").centres(index) * 2 ** (1 / 3), fcc, atol=1e-9)
    assert (fcc.sum(axis=1) % 2 == 0).all()
    bcc = np.rint(Lattice.named("D3*").centres(index) * 4 ** (1 / 3)).astype(int)
    np.testing.assert_allclose(Lattice.named("D3*").centres(index) * 4 ** (1 / 3), bcc, atol=1e-9)
    assert ((bcc % 2).min(axis=1) == (bcc % 2).max(axis=1)).all()
    prism, plane = Lattice.named("A2xZ").basis, Lattice.named("A2").basis
    np.testing.assert_allclose(prism[:2, :2] / prism[0, 0], plane / plane[0, 0], atol=1e-12)
    assert prism[2, 2] == pytest.approx(np.linalg.norm(prism[:, 1])) and (prism[2, :2] == 0).all()


# ---------------------------------------------------------------------- steps between cells


@pytest.mark.parametrize("case", [*CASES, *SHEARED], ids=str)
def test_steps_disks_and_rings_equal_breadth_first_search(case: Case) -> None:
    lattice = case.lattice
    radius = 7 if case.dim == 2 else 4
    found = reference.steps_from_origin(lattice.neighbours, radius)
    cells = np.array(sorted(found))
    origin = np.zeros_like(cells)
    np.testing.assert_array_equal(lattice.steps(origin, cells), [found[tuple(c)] for c in cells.tolist()])
    centre = np.array([5, -7, 11][: case.dim])
    np.testing.assert_array_equal(lattice.disk(centre, radius), cells + centre)
    for k in range(radius + 1):
        ring = cells[[found[tuple(c)] == k for c in cells.tolist()]]
        np.testing.assert_array_equal(lattice.ring(centre, k), ring + centre)
    # Cells beyond the search are farther.
    far = np.array(list(itertools.product(range(-radius, radius + 1), repeat=case.dim)))
    far = far[[tuple(c) not in found for c in far.tolist()]]
    assert (lattice.steps(np.zeros_like(far), far) > radius).all()


@settings(max_examples=BASES, deadline=None)
@given(bases)
def test_steps_on_any_basis_equal_breadth_first_search(basis: list[list[float]]) -> None:
    lattice = any_lattice(basis)
    found = reference.steps_from_origin(lattice.neighbours, 3)
    cells = np.array(sorted(found))
    np.testing.assert_array_equal(lattice.steps(np.zeros_like(cells), cells), [found[tuple(c)] for c in cells.tolist()])
    np.testing.assert_array_equal(lattice.disk([0] * lattice.dim, 3), cells)


def test_steps_by_the_formulas_of_the_cartesian_indices() -> None:
    rng = np.random.default_rng(12)
    v = rng.integers(-5000, 5000, (2000, 2))
    q, r = v.T
    hexagons = np.maximum(np.maximum(np.abs(q), np.abs(r)), np.abs(q + r))
    np.testing.assert_array_equal(Lattice.named("A2", 0.05).steps(np.zeros_like(v), v), hexagons)
    np.testing.assert_array_equal(Lattice.named("Z2", 0.05).steps(np.zeros_like(v), v), np.abs(v).sum(axis=1))
    v = rng.integers(-5000, 5000, (2000, 3))
    np.testing.assert_array_equal(Lattice.named("Z3", 0.05).steps(np.zeros_like(v), v), np.abs(v).sum(axis=1))
    even, parity = DYADIC[2].lattice, DYADIC[3].lattice
    x = np.abs(np.rint(even.centres(v))).astype(int)
    np.testing.assert_array_equal(even.steps(np.zeros_like(v), v), np.maximum(x.max(axis=1), x.sum(axis=1) // 2))
    x = np.abs(np.rint(parity.centres(v))).astype(int)
    np.testing.assert_array_equal(parity.steps(np.zeros_like(v), v), x.max(axis=1))


@pytest.mark.parametrize("k", [0, 1, 2, 7, 20])
def test_disks_of_hexagons(k: int) -> None:
    lattice = Lattice.named("A2", 0.1)
    assert len(lattice.disk([3, 4], k)) == 1 + 3 * k * (k + 1)
    assert len(lattice.ring([3, 4], k)) == (6 * k if k else 1)


@each
def test_lines_connect_by_neighbours_in_the_fewest_steps(case: Case) -> None:
    lattice = case.lattice
    rng = np.random.default_rng(13)
    moves = {tuple(v) for v in lattice.neighbours.tolist()}
    for a, b in rng.integers(-12, 12, (20, 2, case.dim)):
        line = lattice.line(a, b)
        assert len(line) == lattice.steps(a[None], b[None])[0] + 1
        np.testing.assert_array_equal(line[[0, -1]], [a, b])
        assert all(tuple(v) in moves for v in np.diff(line.astype(int), axis=0).tolist())
        np.testing.assert_array_equal(lattice.line(a + 5, b + 5), line + 5)
    np.testing.assert_array_equal(lattice.line(a, a), [a])


@each
def test_steps_is_a_distance(case: Case) -> None:
    lattice = case.lattice
    rng = np.random.default_rng(14)
    a, b, c = rng.integers(-50, 50, (3, 300, case.dim))
    np.testing.assert_array_equal(lattice.steps(a, b), lattice.steps(b, a))
    assert (lattice.steps(a, c) <= lattice.steps(a, b) + lattice.steps(b, c)).all()
    assert (lattice.steps(a, a) == 0).all()
    for M in lattice.point_group[:8]:
        np.testing.assert_array_equal(lattice.steps(a @ M.T, b @ M.T), lattice.steps(a, b))
    assert lattice.steps(np.empty((0, case.dim), int), np.empty((0, case.dim), int)).shape == (0,)


def test_disks_at_the_edge_of_the_range_raise() -> None:
    lattice = Lattice.named("D3")
    with pytest.raises(BoundsError):
        lattice.disk([lattice.limit - 1, 0, 0], 1)
    with pytest.raises(BoundsError):
        lattice.ring([0, -lattice.limit + 1, 0], 2)
    with pytest.raises(ArgumentError):
        lattice.disk([0, 0, 0], -1)
    with pytest.raises(ArgumentError):
        lattice.line([0, 0], [1, 1, 1])
    with pytest.raises(ArgumentError):
        lattice.steps([[0, 0]], [[1, 1]])


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_neighbours_generate_the_lattice(case: Case) -> None:
    """A skewed basis has two nearest points only, and the graph of those would fall apart."""
    assert len(reference.steps_from_origin(case.lattice.neighbours, 6)) >= 1 + 2 * 6 * 7
    flat = Lattice(np.diag([1.0, 3.0]))
    assert len(flat.nearest) == 2 and len(flat.neighbours) == 4


def test_equal_resolutions_are_one_call() -> None:
    assert len({round(named(name, 0.1).lattice.cell_volume ** (1 / d), 12) for name, d in
                [("Z2", 2), ("A2", 2), ("Z3", 3), ("D3", 3), ("D3*", 3), ("A2xZ", 3)]}) == 1  # fmt: skip
