"""Lattices as values: the square, hexagonal, cubic, FCC and BCC ones by name, and any other by its basis.

A lattice is the set of all integer combinations of the columns of its *basis*. In that basis
every lattice is Z^n: any integer tuple is a lattice point, neighbours are constant integer
offsets, and ``quantise(x + v) == quantise(x) + v`` for every lattice vector v. Nothing outside
this module asks a lattice for its name.

Source: Ryde and Bruenig, "Non-Cubic Occupied Voxel Lists for Robot Maps" ("the paper"), with its
misprints put right:

* Eq. 3 scales the second component by eps_x; it must be eps_y.
* Eq. 4's brackets are astray: the second rectangular sublattice of A2 is offset by half a cell,
  with index floor(x / eps) and centre (floor(x / eps) + 0.5) eps.
* D_n: the component with the largest error is rounded "further from zero" in the paper, which is
  the nearest point for only 75 % of random points; it must be rounded to the *other side of x*
  (Conway and Sloane, "Fast quantizing and decoding algorithms for lattice quantizers", 1982).
* Ties are common in real data, where the paper calls them very unlikely: sensors report whole
  centimetres. Here coordinates are widened to float64, divided, rounded to 2^-32 of a cell, and
  ties then go to the lexicographically lower index, in the same code for every lattice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from numbers import Real
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import FloatArray, IntArray, multiply
from hexmap.base.errors import ArgumentError, BoundsError, LatticeError
from hexmap.base.text import quoted
from hexmap.base.values import Immutable, integers, lossless, read_only
from hexmap.lattice import geometry as geometry
from hexmap.lattice.window import IndexBox

__all__ = ["NAMES", "Cell", "Lattice", "default_name"]

IndexArray: TypeAlias = NDArray[np.int32]

_H = math.sqrt(3.0) / 2.0
FLATTEST = 1000.0  # of the reduced basis; beyond it float64 no longer tells the faces of a cell apart

# name: (title, basis vectors as rows, in any unit, other spellings)
_NAMED: dict[str, tuple[str, list[list[float]], tuple[str, ...]]] = {
    "Z2": ("square", [[1, 0], [0, 1]], ("square",)),
    # Hexagons with two edges parallel to x, in axial coordinates q, r: steps = max(|q|, |r|, |q + r|).
    "A2": ("hexagonal", [[1.5, _H], [0, 2 * _H]], ("hexagonal", "hex")),
    "Z3": ("cubic", [[1, 0, 0], [0, 1, 0], [0, 0, 1]], ("cubic",)),
    # Integer triples of even sum. This basis packs a box with the fewest cells outside it (3 times).
    "D3": ("face-centred cubic", [[1, 0, 1], [0, 1, 1], [0, 0, 2]], ("A3", "FCC", "fcc")),
    # Z^3 and Z^3 + (1/2, 1/2, 1/2); an obtuse superbase, so that all faces are 0/1 or 0/-1 vectors.
    "D3*": ("body-centred cubic", [[-1, 1, 1], [1, -1, 1], [1, 1, -1]], ("D3s", "D3star", "A3*", "A3s", "BCC", "bcc")),
    # The hexagonal prism: A2 in x and y, layers as far apart as the hexagons.
    "A2xZ": ("hexagonal prism", [[1.5, _H, 0], [0, 2 * _H, 0], [0, 0, 2 * _H]], ("prism",)),
}
NAMES: tuple[str, ...] = tuple(_NAMED)
_ALIASES = {alias.casefold(): name for name, (_, _, spellings) in _NAMED.items() for alias in (name, *spellings)}


def default_name(dim: int) -> str:
    """Return the name of the lattice that is used where none is asked for: A2 in the plane, D3 in space."""
    return {2: "A2", 3: "D3"}[dim]


class RayTables(NamedTuple):
    """The faces of a cell as plain arrays, in units that make them integers where that is possible.

    Attributes:
        vectors: (F, n) int64, the faces' lattice vectors v in the public basis.
        planes: (F, n) float64, G v in the reduced basis: a point u lies beyond v where u.(G v) > half.
        half: (F,) float64, v G v / 2.
        products: (F, F) float64, v G w.
    """

    vectors: NDArray[np.int64]
    planes: FloatArray
    half: FloatArray
    products: FloatArray


class QuantiserTables(NamedTuple):
    """What the quantiser's kernels take (``hexmap/lattice/_kernels.py``), for kernels that quantise on their way.

    Attributes:
        inverse: (n, n) of the reduced basis.
        gram2: (n, n) twice its Gram matrix.
        constants: (2^n,) of the corners of the unit cube.
        extra: (K, n) further candidates.
        extra_constants: (K,) theirs.
        to_public: (n, n) from indices of the reduced basis to those of the public one.
        limit: indices are smaller than this in absolute value.
        to_reduced: (n, n) int64, the other way.
    """

    inverse: FloatArray
    gram2: FloatArray
    constants: FloatArray
    extra: FloatArray
    extra_constants: FloatArray
    to_public: FloatArray
    limit: float
    to_reduced: NDArray[np.int64]


class Cell(Immutable):
    """The Voronoi cell of a lattice point, around the origin.

    Attributes:
        vertices: (V, n) float64, metres; in the plane counter-clockwise.
        rings: a tuple: for each face the indices of its vertices in order (edges of two in the plane).
        faces: (F, n) int64 lattice vectors to the neighbours across the faces, in ``rings``' order.
        normals: (F, n) float64, the same vectors in metres; the face is {x : x.v = |v|^2 / 2}.
    """

    vertices: FloatArray
    rings: tuple[IntArray, ...]
    faces: IntArray
    normals: FloatArray

    def __init__(self, basis: FloatArray, faces: NDArray[np.int64]) -> None:
        """Compute the polytope of the relevant vectors ``faces`` (F, n)."""
        normals = faces @ basis.T
        vertices, rings = geometry.cell_polytope(normals)
        values = {"faces": read_only(faces), "normals": read_only(normals), "vertices": read_only(vertices)}
        self.__dict__.update(values, rings=tuple(read_only(ring) for ring in rings))

    def __repr__(self) -> str:
        """Say how many faces and corners it has."""
        return f"<Cell of {len(self.faces)} faces and {len(self.vertices)} corners>"

    @cached_property
    def second_moment(self) -> float:
        """Dimensionless second moment G = (1/n) integral |x|^2 / V^(1 + 2/n)."""
        return geometry.second_moment(self.vertices, self.rings)

    @cached_property
    def mean_error(self) -> float:
        """Mean distance from the centre for uniform points, in units of the resolution."""
        return geometry.mean_error(self.vertices, self.rings)

    @cached_property
    def volume(self) -> float:
        """Area (m^2) or volume (m^3), from the polytope and not from the determinant."""
        bases = geometry.cone_bases(self.vertices, self.rings)
        return float(np.abs(np.linalg.det(bases)).sum()) / math.factorial(self.vertices.shape[1])


class Lattice(Immutable):
    """A lattice in the plane or in space; an immutable value.

    Attributes:
        basis: (n, n) float64, columns are the generators in metres: ``centre = basis @ index``.
        name: what to call it in print; it decides nothing.

    Examples:
        >>> from hexmap import Lattice
        >>> hexagons = Lattice.named("A2", resolution=0.1)
        >>> hexagons.quantise([[0.02, 0.31]]).tolist()
        [[0, 3]]
        >>> len(hexagons.nearest), len(Lattice.named("D3*", resolution=0.1).faces)
        (6, 14)
    """

    basis: FloatArray
    name: str
    # Of the reduced basis, for the quantiser and the traversal of rays.
    _to_public: FloatArray
    _to_reduced: IntArray
    _gram_reduced: FloatArray
    _gram: FloatArray
    _relevant: IntArray
    _inverse: FloatArray
    _kernel_arguments: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]

    def __init__(self, basis: ArrayLike, name: str = "custom") -> None:
        """Make a lattice of a basis (n, n) whose *columns* are the generators, in metres.

        Raises:
            LatticeError: not a finite (2, 2) or (3, 3) matrix, or its columns are not independent.
        """
        given = lossless(basis)
        if given is None:
            raise LatticeError(f"the basis of a lattice must be numbers, not {quoted(basis)}")
        B = given.astype(np.float64) + 0.0  # a zero has no sign: equal bases have equal bytes
        if B.shape not in ((2, 2), (3, 3)):
            raise LatticeError(f"the basis of a lattice must be (2, 2) or (3, 3), not {B.shape}")
        if not np.isfinite(B).all():
            raise LatticeError("the basis of a lattice must be finite")
        with np.errstate(over="ignore"):
            lengths = np.linalg.norm(B, axis=0)
        if not np.isfinite(lengths).all() or ((lengths == 0.0) & B.any(axis=0)).any():
            longest = np.abs(B).max(axis=0).tolist()
            raise LatticeError(f"the columns of a lattice's basis are too short or too long to measure: {longest} m")
        if (lengths == 0.0).any() or abs(np.linalg.det(B / lengths)) < 1e-6:
            raise LatticeError("the columns of a lattice's basis must be independent")
        self.__dict__.update(basis=read_only(B), name=str(name))
        self._prepare()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy through the constructor: arrays that are unpickled can be written to."""
        return Lattice, (np.array(self.basis), self.name)

    @classmethod
    def named(cls, name: str, resolution: float = 1.0) -> Lattice:
        """Return Z2, A2, Z3, D3, D3* (also D3s) or A2xZ (the prism) with cells of area r^2 or volume r^3.

        Lattices of the same resolution are compared fairly: they have equally many cells.

        Raises:
            LatticeError: the name is not known, or the resolution is not a positive number.
        """
        key = _ALIASES.get(name.casefold()) if isinstance(name, str) else None
        if key is None:
            raise LatticeError(f"no lattice is called {name!r}; known are {', '.join(NAMES)}")
        try:
            number = isinstance(resolution, Real) and not isinstance(resolution, bool)
            positive = number and math.isfinite(resolution) and resolution > 0.0
        except OverflowError:  # a whole number that no float64 holds
            positive = False
        if not positive:
            raise LatticeError(f"a resolution must be a positive number of metres, not {quoted(resolution)}")
        B = np.array(_NAMED[key][1], dtype=np.float64).T
        unit = abs(np.linalg.det(B)) ** (1.0 / len(B))
        return cls(B * (float(resolution) / unit), key)

    def _prepare(self) -> None:
        """Compute what the quantiser needs; the rest is computed when it is asked for."""
        n = self.dim
        gram = self.basis.T @ self.basis
        U = np.ascontiguousarray(geometry.reduce_basis(gram))
        reduced = self.basis @ U
        sides = np.linalg.norm(reduced, axis=0)
        if sides.max() > FLATTEST * sides.min():
            raise LatticeError(
                f"the cells of a lattice may be {FLATTEST:g} times as long as wide, not {sides.max() / sides.min():.3g}"
            )
        G = np.ascontiguousarray(geometry.commensurate(reduced.T @ reduced))
        to_public = np.array(U, dtype=np.float64, order="C")
        to_reduced = np.rint(np.linalg.inv(U)).astype(np.int64)
        relevant, extra, constants = _quantiser_tables(G.tobytes(), U.tobytes(), n)
        inverse = np.ascontiguousarray(np.linalg.inv(reduced))
        tables = inverse, 2.0 * G, constants[: 2**n].copy(), extra, constants[2**n :].copy(), to_public
        self.__dict__.update(
            _to_public=to_public,
            _to_reduced=read_only(to_reduced),
            _gram_reduced=read_only(G),
            _gram=read_only(to_reduced.T @ G @ to_reduced),
            _relevant=read_only(relevant @ U.T),
            _inverse=inverse,
            _kernel_arguments=(*map(read_only, tables), float(self.limit)),
        )

    # ------------------------------------------------------------------ the value

    @property
    def dim(self) -> int:
        """2 in the plane, 3 in space."""
        return len(self.basis)

    @cached_property
    def resolution(self) -> float:
        """Side of the square or cube of the same area or volume as the cell, metres."""
        return float(abs(np.linalg.det(self.basis)) ** (1.0 / self.dim))

    @cached_property
    def cell_volume(self) -> float:
        """Area (m^2) or volume (m^3) of a cell: the determinant of the basis."""
        return float(abs(np.linalg.det(self.basis)))

    @property
    def limit(self) -> int:
        """Indices are smaller than this in absolute value: 2^20 in space, 2^31 - 1 in the plane."""
        return 2**31 - 1 if self.dim == 2 else 2**20

    @property
    def title(self) -> str:
        """A name in words, where the lattice has one."""
        return _NAMED[self.name][0] if self.name in _NAMED else self.name

    def scaled(self, factor: float) -> Lattice:
        """Return the same lattice with cells ``factor`` times as wide."""
        if not isinstance(factor, Real) or not (math.isfinite(factor) and factor > 0):
            raise LatticeError(f"a lattice is scaled by a positive number, not {quoted(factor)}")
        return Lattice(self.basis * factor, self.name)

    def to_dict(self) -> dict[str, Any]:
        """Return the lattice as plain numbers, for files."""
        return {"name": self.name, "basis": self.basis.tolist()}

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> Lattice:
        """Make the lattice that :meth:`to_dict` wrote.

        Raises:
            LatticeError: the basis is missing or not a basis.
        """
        try:
            return cls(value["basis"], str(value.get("name", "custom")))
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise LatticeError(f"not the numbers of a lattice: {error}") from error

    def __eq__(self, other: object) -> bool:
        """Tell whether two lattices have the same basis, number by number; names do not count."""
        return isinstance(other, Lattice) and np.array_equal(self.basis, other.basis)

    def __hash__(self) -> int:
        """Hash the basis."""
        return hash(self.basis.tobytes())  # of which no zero has a sign

    def __repr__(self) -> str:
        """Show name and resolution, or the basis where there is no name."""
        if self.name in _NAMED:
            return f"Lattice.named({self.name!r}, resolution={self.resolution:.9g})"
        return f"Lattice({self.basis.tolist()}, name={self.name!r})"

    # ------------------------------------------------------------------ points and cells

    def quantise(self, points: ArrayLike) -> IndexArray:
        """Return the index (N, n) int32 of the lattice point nearest to each of ``points`` (N, n), metres.

        Exact: coordinates are rounded to 2^-32 of a cell, then the nearest lattice point is found
        and ties go to the lexicographically lower index. float32 or float64, any strides.

        Raises:
            ArgumentError: the array is not (N, n).
            BoundsError: a coordinate is not finite or its index is out of range; the first row is named.
        """
        raw = lossless(points)
        if raw is None:
            raise ArgumentError(f"points must be an array of real numbers without a mask, not {quoted(points)}")
        if raw.size == 0 and raw.ndim != 2:
            raw = raw.reshape(0, self.dim)
        if raw.ndim != 2 or raw.shape[1] != self.dim:
            raise ArgumentError(f"points for a lattice of dimension {self.dim} are (N, {self.dim}), not {raw.shape}")
        p = np.ascontiguousarray(raw, dtype=np.float64)
        out = np.empty(p.shape, dtype=np.int32)
        if len(p) and self._kernel(p, *self._kernel_arguments, out):
            self._raise_bounds(p)
        return out

    @property
    def _kernel(self) -> Callable[..., int]:
        from hexmap.lattice import _kernels as kernels

        return kernels.quantise_2d if self.dim == 2 else kernels.quantise_3d

    def _raise_bounds(self, points: FloatArray) -> None:
        """Name the first row that the kernel could not quantise."""
        one = np.empty((1, self.dim), dtype=np.int32)
        for row, point in enumerate(points):
            if self._kernel(point[None], *self._kernel_arguments, one):
                where = "(" + ", ".join(f"{v:.10g}" for v in point) + ")"
                if not np.isfinite(point).all():
                    raise BoundsError(f"point {row} is not finite: {where}")
                raise BoundsError(
                    f"point {row} is out of range: {where} m at resolution {self.resolution:g} m "
                    f"needs an index of {self.limit} or more"
                )

    def centres(self, index: ArrayLike) -> FloatArray:
        """Return the centres (N, n), metres, of the cells with ``index`` (N, n)."""
        i = np.asarray(index)
        if i.ndim != 2 or i.shape[1] != self.dim:
            raise ArgumentError(f"indices of a lattice of dimension {self.dim} must be (N, {self.dim}), not {i.shape}")
        return multiply(i.astype(np.float64), self.basis)

    def check_index(self, index: NDArray[np.int64]) -> IndexArray:
        """Return integer indices (N, n) as int32, once they are known to be in range.

        Raises:
            BoundsError: naming the first row out of range.
        """
        if len(index):
            # Not by the absolute value: that of the least 64-bit integer is negative.
            out = ((index >= self.limit) | (index <= -self.limit)).any(axis=1)
            if out.any():
                row = int(np.argmax(out))
                cell = tuple(int(v) for v in index[row])
                raise BoundsError(f"index {row} is out of range: {cell}, limit {self.limit}")
        return index.astype(np.int32)

    def coordinates(self, points: FloatArray) -> FloatArray:
        """Return exact coordinates (N, n) in the reduced basis: multiples of 2^-32 of a cell, as quantised."""
        return np.asarray(np.rint(multiply(points, self._inverse) * 2.0**32) * 2.0**-32)

    def reduced_index(self, index: NDArray[np.integer[Any]]) -> NDArray[np.int64]:
        """Return indices (N, n) of the public basis in the reduced one."""
        return np.asarray(index.astype(np.int64) @ self._to_reduced.T)

    @cached_property
    def quantiser_tables(self) -> QuantiserTables:
        """What kernels need that quantise points on their way."""
        to_reduced = read_only(np.array(self._to_reduced, order="C"))
        return QuantiserTables(*self._kernel_arguments, to_reduced=to_reduced)

    @cached_property
    def ray_tables(self) -> RayTables:
        """The faces of the cell as the traversal of rays needs them."""
        vectors = self.faces
        reduced = self.reduced_index(vectors)
        planes = reduced @ self._gram_reduced
        half = 0.5 * geometry.norms(reduced, self._gram_reduced)
        tables = vectors, planes, half, planes @ reduced.T
        return RayTables(*(read_only(np.ascontiguousarray(table)) for table in tables))

    # ------------------------------------------------------------------ shells

    @cached_property
    def _shells(self) -> list[NDArray[np.int64]]:
        """Cumulative sets of primitive vectors by length, each sorted by length, then index."""
        vectors, lengths = geometry.primitive_vectors(self._gram, self._to_reduced, 26)
        ends = [k for k in range(1, len(vectors)) if lengths[k] > lengths[k - 1] * (1 + geometry.SAME_LENGTH)]
        return [read_only(vectors[:k].copy()) for k in [*ends, len(vectors)]]

    @property
    def nearest(self) -> NDArray[np.int64]:
        """Offsets (K, n) of the nearest lattice points: all equally far."""
        return self._shells[0]

    @cached_property
    def faces(self) -> NDArray[np.int64]:
        """Offsets (F, n) of the cells that share a face, by length, then index."""
        lengths = np.round(geometry.norms(self._relevant, self._gram), 8)
        return read_only(self._relevant[np.lexsort((*self._relevant.T[::-1], lengths))])

    @property
    def shell_sizes(self) -> list[int]:
        """The sizes that :meth:`shell` takes: 4, 8, 16, ... for squares, 6, 12, 18, ... for hexagons."""
        return [len(s) for s in self._shells]

    def shell(self, size: int) -> NDArray[np.int64]:
        """Return the offsets (size, n) of the ``size`` shortest primitive vectors.

        ``shell(8)`` of Z2 is the usual eight-neighbourhood; A2 has 6 and 12, Z3 6, 18 and 26,
        D3 12 and 18, D3* 8 and 14.

        Raises:
            ArgumentError: a shell would be cut in two; the sizes there are, are named.
        """
        for s in self._shells:
            if len(s) == size:
                return s
        known = ", ".join(map(str, self.shell_sizes))
        raise ArgumentError(f"{self.name} has no neighbourhood of {size}; there are {known}")

    @property
    def extended(self) -> NDArray[np.int64]:
        """Offsets of the smallest shell beyond :attr:`neighbours`: Z2-8, A2-12, Z3-18, D3-18, D3*-14."""
        return next(s for s in self._shells if len(s) > len(self.neighbours))

    @cached_property
    def neighbours(self) -> NDArray[np.int64]:
        """Offsets of the equidistant neighbours; of the faces where the nearest points do not generate the lattice."""
        return self.nearest if geometry.generates(self.nearest) else self.faces

    # ------------------------------------------------------------------ the cell

    @cached_property
    def cell(self) -> Cell:
        """The Voronoi cell."""
        return Cell(self.basis, self.faces)

    @cached_property
    def inradius(self) -> float:
        """Radius of the largest ball in the cell, metres: half the shortest vector."""
        return 0.5 * float(np.linalg.norm(self.basis @ self.nearest[0]))

    @cached_property
    def covering_radius(self) -> float:
        """Distance from the centre to the farthest corner of the cell, metres."""
        return float(np.linalg.norm(self.cell.vertices, axis=1).max())

    @property
    def packing_density(self) -> float:
        """Fraction of the plane or of space that the balls in the cells fill."""
        return _ball(self.dim) * self.inradius**self.dim / self.cell_volume

    @property
    def covering_thickness(self) -> float:
        """Mean number of balls around the cells that a point lies in."""
        return _ball(self.dim) * self.covering_radius**self.dim / self.cell_volume

    @cached_property
    def point_group(self) -> NDArray[np.int64]:
        """All integer matrices (K, n, n) that map the lattice to itself rigidly: index -> M @ index."""
        # In the reduced basis, whose vectors are short: images of a sheared basis lie in no small box.
        found = geometry.point_group(self._gram_reduced, geometry.box_vectors(self.dim, 4))
        public = np.rint(self._to_public @ found @ self._to_reduced).astype(np.int64)
        return read_only(public[np.lexsort(public.reshape(len(public), -1).T[::-1])])

    # ------------------------------------------------------------------ steps between cells

    @cached_property
    def _step_planes(self) -> FloatArray:
        """Rows p with max(p . v) = gauge of v: the facets of the hull of the neighbours."""
        from scipy.spatial import ConvexHull

        equations = ConvexHull(self.neighbours.astype(np.float64)).equations
        return np.unique(np.round(-equations[:, :-1] / equations[:, -1:], 12), axis=0)

    def steps(self, start: ArrayLike, end: ArrayLike) -> NDArray[np.int64]:
        """Return how many moves to :attr:`neighbours` it takes from each ``start`` (N, n) to ``end`` (N, n).

        The step count of a vector is its gauge in the convex hull of the neighbours, rounded up:
        every lattice vector in k times the hull is a sum of k neighbours (held against breadth
        first search in the tests).
        """
        v = np.asarray(end, dtype=np.float64) - np.asarray(start, dtype=np.float64)
        if v.ndim != 2 or v.shape[1] != self.dim:
            raise ArgumentError(f"indices of a lattice of dimension {self.dim} must be (N, {self.dim}), not {v.shape}")
        gauge = (v @ self._step_planes.T).max(axis=1) if len(v) else np.empty(0)
        return np.ceil(np.maximum(gauge, 0.0) - 1e-7).astype(np.int64)

    def _ball_offsets(self, radius: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the offsets (K, n) of up to ``radius`` steps, lexicographically, and the steps (K,) of each."""
        if not isinstance(radius, (int, np.integer)) or isinstance(radius, bool) or radius < 0:
            raise ArgumentError(f"a number of steps is a whole number of 0 or more, not {radius!r}")
        radius = int(radius)
        reach = radius * np.abs(self.neighbours).max(axis=0)
        offsets = IndexBox.of_corners(-reach, reach).cells()
        steps = self.steps(np.zeros_like(offsets), offsets)
        return offsets[steps <= radius], steps[steps <= radius]

    def _one_cell(self, cell: ArrayLike) -> NDArray[np.int64]:
        """Return one index (n,), if it is one."""
        c = integers(cell)
        if c is None or c.shape != (self.dim,):
            raise ArgumentError(f"a cell of {self.name} is {self.dim} integers, not {quoted(cell)}")
        self.check_index(c[None])
        return c

    def disk(self, centre: ArrayLike, radius: int) -> IndexArray:
        """Return the cells (K, n) at most ``radius`` steps from ``centre`` (n,), lexicographically."""
        offsets, _ = self._ball_offsets(radius)
        return self.check_index(self._one_cell(centre) + offsets)

    def ring(self, centre: ArrayLike, radius: int) -> IndexArray:
        """Return the cells (K, n) exactly ``radius`` steps from ``centre`` (n,), lexicographically."""
        offsets, steps = self._ball_offsets(radius)
        return self.check_index(self._one_cell(centre) + offsets[steps == radius])

    def line(self, start: ArrayLike, end: ArrayLike) -> IndexArray:
        """Return the cells (steps + 1, n) of a shortest chain of neighbours along the straight line.

        Of the neighbours that are one step nearer to the end, the chain takes the one nearest to
        the point at the same fraction of the straight line, ties to the lower offset.
        """
        a, b = self._one_cell(start), self._one_cell(end)
        total = int(self.steps(a[None], b[None])[0])
        cells = [a]
        offsets = self.neighbours[np.lexsort(self.neighbours.T[::-1])]
        for k in range(1, total + 1):
            options = cells[-1] + offsets
            options = options[self.steps(options, np.broadcast_to(b, options.shape)) == total - k]
            off_line = (options - (a + (b - a) * (k / total))) @ self.basis.T
            distance = np.round((off_line**2).sum(axis=1) / self.resolution**2, 9)
            cells.append(options[int(np.argmin(distance))])
        return self.check_index(np.array(cells))


@lru_cache(maxsize=256)
def _quantiser_tables(gram: bytes, to_public: bytes, n: int) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return relevant vectors (F, n), further candidates (K, n) and the constants (2^n + K,) of the kernels.

    They depend on the lattice's shape alone, so that all its resolutions share them.
    """
    G = np.frombuffer(gram).reshape(n, n)
    U = np.frombuffer(to_public, dtype=np.int64).reshape(n, n)
    relevant = geometry.relevant_vectors(G)
    extra = geometry.nearest_candidates(G, relevant, U)
    candidates = np.vstack([np.array(list(np.ndindex(*(2,) * n)), dtype=np.int64), extra])
    public = candidates @ U.T
    rank = np.empty(len(public))
    rank[np.lexsort(public.T[::-1])] = np.arange(len(public))
    constants = geometry.norms(candidates, G) + rank * 2.0**-38
    return read_only(relevant), read_only(np.array(extra, dtype=np.float64, order="C")), read_only(constants)


def _ball(n: int) -> float:
    """Return the volume of the unit ball in n dimensions."""
    return math.pi if n == 2 else 4.0 * math.pi / 3.0
