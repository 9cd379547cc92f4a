"""The geometry of a lattice, from its Gram matrix alone: reduction, Voronoi cell, shells, symmetries.

Everything here is small linear algebra that runs once for a lattice (dimension 2 or 3); none of
it knows a lattice by name. Lattice vectors are integer rows; ``gram`` is the Gram matrix of the
basis those integers refer to.

Sources: Conway and Sloane, "Low-dimensional lattices VI: Voronoi reduction of three-dimensional
forms" (obtuse superbase, relevant vectors); Selling 1874 (the reduction).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import LatticeError

# Two squared lengths are the same shell when they differ by less than this fraction of themselves.
SAME_LENGTH = 1e-9


def norms(vectors: IntArray, gram: FloatArray) -> FloatArray:
    """Return the squared lengths (M,) of integer vectors (M, n)."""
    return np.asarray(np.einsum("mi,ij,mj->m", vectors, gram, vectors), dtype=np.float64)


def reduce_basis(gram: FloatArray) -> IntArray:
    """Return the unimodular (n, n) matrix whose columns are an obtuse superbase less one (Selling).

    Raises:
        LatticeError: the reduction does not end, so the basis is too near to singular.
    """
    n = len(gram)
    V = np.vstack([np.eye(n, dtype=np.int64), -np.ones((1, n), dtype=np.int64)])
    tolerance = 1e-10 * float(np.trace(gram))
    for _ in range(10_000):
        products = V @ gram @ V.T
        pairs = itertools.combinations(range(n + 1), 2)
        worst = [(products[i, j], i, j) for i, j in pairs if products[i, j] > tolerance]
        if not worst:
            # An obtuse basis stays as it is; of the n + 1 choices of n vectors the first n come from the basis.
            return V[:n].T
        _, i, j = max(worst)
        vi = V[i].copy()
        if n == 2:
            k = 3 - i - j
            V[k] = vi - V[j]
            V[i] = -vi
        else:
            others = [k for k in range(4) if k not in (i, j)]
            V[i] = -vi
            for k in others:
                V[k] += vi
    raise LatticeError("the basis is too near to singular to be reduced")


def box_vectors(n: int, reach: int) -> IntArray:
    """Return all integer vectors with coordinates from -reach to reach, lexicographically, but zero."""
    vectors = np.array(list(itertools.product(range(-reach, reach + 1), repeat=n)), dtype=np.int64)
    return vectors[(vectors != 0).any(axis=1)]


def relevant_vectors(gram: FloatArray) -> IntArray:
    """Return the Voronoi relevant vectors (F, n), one per face of the cell, of a *reduced* Gram matrix.

    A vector is relevant when it and its negative are the only shortest ones of its class modulo
    twice the lattice (Voronoi); in an obtuse superbase coordinates up to 1 suffice.
    """
    vectors = box_vectors(len(gram), 2)
    lengths = norms(vectors, gram)
    parity = (vectors & 1) @ (1 << np.arange(len(gram)))
    keep: list[int] = []
    for c in range(1, 1 << len(gram)):
        members = np.flatnonzero(parity == c)
        shortest = members[lengths[members] <= lengths[members].min() * (1 + SAME_LENGTH)]
        if len(shortest) == 2:
            keep.extend(int(k) for k in shortest)
    return vectors[sorted(keep)]


def polytope_vertices(A: FloatArray, b: FloatArray) -> FloatArray:
    """Return the vertices (V, n) of the bounded polytope {x : A x <= b}, unordered, each once.

    Every n planes are intersected, so this is for a few dozen planes at the most.
    """
    n = A.shape[1]
    groups = np.array(list(itertools.combinations(range(len(A)), n)))
    planes = A[groups]
    size = np.linalg.norm(planes, axis=2).prod(axis=1)
    groups = groups[np.abs(np.linalg.det(planes)) > 1e-9 * size]
    x = np.linalg.solve(A[groups], b[groups][:, :, None])[:, :, 0]
    # Nearly parallel planes meet far away: what is near enough is a matter of each point's own size.
    slack = 1e-9 * (np.abs(b).max() + np.abs(x).max(axis=1)[:, None] * np.linalg.norm(A, axis=1))
    x = x[(x @ A.T <= b + slack).all(axis=1)]
    scale = float(np.abs(x).max(initial=0.0)) + 1e-300
    kept: list[FloatArray] = []
    for p in x:
        if all(np.abs(p - q).max() > 1e-7 * scale for q in kept):
            kept.append(p)
    return np.array(kept).reshape(-1, n)


def cell_polytope(faces: FloatArray) -> tuple[FloatArray, list[IntArray]]:
    """Return the vertices (V, n) of {x : x.f <= |f|^2 / 2} and, face by face, their indices in order.

    In the plane the faces are edges of two vertices; in space polygons, counter-clockwise from
    outside. Vertices of the planar cell are in counter-clockwise order.
    """
    n = faces.shape[1]
    half = 0.5 * (faces**2).sum(axis=1)
    scale = math.sqrt(half.max())
    vertices = polytope_vertices(faces, half)
    if n == 2:
        vertices = vertices[np.argsort(np.arctan2(vertices[:, 1], vertices[:, 0]))]
    else:
        vertices = vertices[np.lexsort(np.round(vertices / scale, 9).T[::-1])]
    rings: list[IntArray] = []
    for f, h in zip(faces, half, strict=True):
        on = np.flatnonzero(np.abs(vertices @ f - h) < 1e-7 * h)
        centre = vertices[on].mean(axis=0)
        if n == 2:
            across = np.array([-f[1], f[0]])
            order = np.argsort((vertices[on] - centre) @ across)
        else:
            e1 = vertices[on[0]] - centre
            e2 = np.cross(f, e1) / np.linalg.norm(f)
            rel = vertices[on] - centre
            order = np.argsort(np.arctan2(rel @ e2, rel @ e1))
        rings.append(on[order])
    return vertices, rings


def cone_bases(vertices: FloatArray, rings: Sequence[IntArray]) -> FloatArray:
    """Return the faces cut into simplices (K, n, n): edges in the plane, triangles in space."""
    simplices = []
    for ring in rings:
        # A face thinner than corners are told apart has fewer corners than a face needs, and holds nothing.
        if len(ring) < vertices.shape[1]:
            continue
        corners = vertices[ring]
        if vertices.shape[1] == 2:
            simplices.append(corners)
        else:
            middle = corners.mean(axis=0)
            simplices.extend(np.array([middle, corners[k - 1], corners[k]]) for k in range(len(corners)))
    return np.array(simplices)


def second_moment(vertices: FloatArray, rings: Sequence[IntArray]) -> float:
    """Return the dimensionless second moment G = (1/n) integral |x|^2 / V^(1 + 2/n), exactly.

    The integral of |x|^2 over a simplex of volume v with corners p_0 ... p_n is
    v (|sum p|^2 + sum |p|^2) / ((n + 1)(n + 2)); here p_0 is the centre of the cell.
    """
    n = vertices.shape[1]
    bases = cone_bases(vertices, rings)
    volumes = np.abs(np.linalg.det(bases)) / math.factorial(n)
    inner = ((bases.sum(axis=1)) ** 2).sum(axis=1) + (bases**2).sum(axis=(1, 2))
    total = float((volumes * inner).sum()) / ((n + 1) * (n + 2))
    return total / n / float(volumes.sum()) ** (1 + 2 / n)


def mean_error(vertices: FloatArray, rings: Sequence[IntArray]) -> float:
    """Return the mean distance from the centre over the cell, for a cell of unit volume.

    |x| is homogeneous of degree one, so the integral over the cone above a face is
    n / (n + 1) times the cone's volume times the mean of |x| over the face; that mean is taken by
    Gauss-Legendre quadrature of 24 points a direction on the simplices of the face (15 digits).
    """
    n = vertices.shape[1]
    bases = cone_bases(vertices, rings)
    volumes = np.abs(np.linalg.det(bases)) / math.factorial(n)
    nodes, weights = np.polynomial.legendre.leggauss(24)
    nodes, weights = 0.5 * (nodes + 1), 0.5 * weights
    if n == 2:
        points = bases[:, 0, None] + nodes[None, :, None] * (bases[:, 1] - bases[:, 0])[:, None]
        w = weights
    else:
        # Duffy's map of the square onto the triangle; its Jacobian, times two for the mean, is 2 s.
        s, t = (a.ravel() for a in np.meshgrid(nodes, nodes, indexing="ij"))
        w = (2 * s) * np.outer(weights, weights).ravel()
        b = (s * (1 - t))[None, :, None]
        c = (s * t)[None, :, None]
        points = bases[:, 0, None] + b * (bases[:, 1] - bases[:, 0])[:, None] + c * (bases[:, 2] - bases[:, 0])[:, None]
    means = np.linalg.norm(points, axis=2) @ w
    volume = float(volumes.sum())
    return n / (n + 1) * float((volumes * means).sum()) / volume / volume ** (1 / n)


def primitive_vectors(gram: FloatArray, to_reduced: IntArray, count: int) -> tuple[IntArray, FloatArray]:
    """Return at least ``count`` primitive vectors by length, whole shells only, and their squared lengths.

    ``to_reduced`` takes indices of the public basis to the reduced one; the search box is drawn
    in the reduced basis, where short vectors have small coordinates.
    """
    n = len(gram)
    reduced = box_vectors(n, 8)  # of 1 x 100 cells the 26 shortest reach to 7
    reduced = reduced[np.gcd.reduce(reduced, axis=1) == 1]
    public = np.rint(reduced @ np.linalg.inv(to_reduced).T).astype(np.int64)
    lengths = norms(public, gram)
    order = np.argsort(lengths, kind="stable")
    public, lengths = public[order], lengths[order]
    # A shell ends where the next length is clearly longer: lengths that are rounded would part some v from -v.
    shell = np.cumsum(np.concatenate([[False], lengths[1:] > lengths[:-1] * (1 + SAME_LENGTH)]))
    order = np.lexsort((*public.T[::-1], shell))
    starts = np.flatnonzero(np.diff(shell, prepend=-1))
    public, lengths = public[order], np.minimum.reduceat(lengths, starts)[shell]
    last = lengths[min(count, len(lengths)) - 1] * (1 + SAME_LENGTH)
    keep = lengths <= last
    return public[keep], lengths[keep]


def generates(vectors: IntArray) -> bool:
    """Tell whether integer vectors (M, n) generate the whole of Z^n: their n-minors have gcd 1."""
    n = vectors.shape[1]
    g = 0
    for group in itertools.combinations(range(len(vectors)), n):
        g = math.gcd(g, abs(round(float(np.linalg.det(vectors[list(group)])))))
        if g == 1:
            return True
    return False


def point_group(gram: FloatArray, candidates: IntArray) -> IntArray:
    """Return all integer matrices M (K, n, n) with M^T G M = G, lexicographically; columns of M are images.

    ``candidates`` must hold every lattice vector as long as a basis vector.
    """
    n = len(gram)
    lengths = norms(candidates, gram)
    size = np.sqrt(np.diag(gram))
    tolerance = 1e-8 * np.outer(size, size)
    choices = [candidates[np.abs(lengths - gram[i, i]) < tolerance[i, i]] for i in range(n)]
    found: list[IntArray] = []

    def extend(columns: list[IntArray]) -> None:
        i = len(columns)
        if i == n:
            found.append(np.array(columns).T)
            return
        for v in choices[i]:
            if all(abs(columns[j] @ gram @ v - gram[j, i]) < tolerance[j, i] for j in range(i)):
                extend([*columns, v])

    extend([])
    return np.array(sorted(found, key=lambda M: tuple(M.ravel())))


def nearest_candidates(gram: FloatArray, relevant: IntArray, to_public: IntArray) -> IntArray:
    """Return the lattice vectors (K, n) beyond the corners of the unit cube that may be nearest to a point in it.

    ``gram`` is reduced and ``relevant`` its Voronoi relevant vectors. A vector counts when its
    cell and the cube share more than a boundary, or when it wins a tie somewhere on the boundary
    they share: in a degenerate cell (squares in a sheared basis) four cells meet in a corner.
    """
    n = len(gram)
    planes = relevant @ gram
    half = 0.5 * norms(relevant, gram)
    cell = polytope_vertices(planes, half)
    low, high = cell.min(axis=0), cell.max(axis=0)
    reach = int(np.ceil(max(-low.min(), high.max()))) + 1
    boxes = np.array(list(itertools.product(range(-reach, reach + 2), repeat=n)), dtype=np.int64)
    meets = ((boxes + high > -1e-9) & (boxes + low < 1 + 1e-9)).all(axis=1)
    corner = ((boxes >= 0) & (boxes <= 1)).all(axis=1)
    cube = np.vstack([np.eye(n), -np.eye(n)])
    A = np.vstack([planes, cube])
    beyond = []
    for c in boxes[meets & ~corner]:
        b = np.concatenate([half + planes @ c, np.ones(n), np.zeros(n)])
        overlap = polytope_vertices(A, b)
        if len(overlap) > n:
            slack = (b - A @ overlap.mean(axis=0)) / np.linalg.norm(A, axis=1)
            if slack.min() > 1e-9:
                beyond.append(c)
                continue
        if len(overlap) and _wins_a_tie(c, overlap, boxes[corner], gram, to_public):
            beyond.append(c)
    return np.array(beyond, dtype=np.int64).reshape(-1, n)


def _wins_a_tie(c: IntArray, overlap: FloatArray, corners: IntArray, gram: FloatArray, to_public: IntArray) -> bool:
    """Tell whether ``c`` is before all corners that are as near, somewhere in the polytope ``overlap``.

    Which points tie changes only from face to face, so the middles of all pairs of vertices and
    of all of them are enough to look at. Where a coordinate is 1 the next cube is asked instead.
    """
    middles = (overlap[:, None] + overlap[None]).reshape(-1, len(gram)) / 2
    at = np.vstack([middles, overlap.mean(axis=0)])
    at = at[(at < 1 - 1e-9).all(axis=1)]
    mine = tuple(to_public @ c)
    for f in at:
        distance = float((f - c) @ gram @ (f - c))
        others = norms(corners - f, gram)
        tied = corners[others <= distance + 1e-9]
        if distance <= others.min() + 1e-9 and all(mine < tuple(to_public @ v) for v in tied):
            return True
    return False


def commensurate(gram: FloatArray) -> FloatArray:
    """Return the Gram matrix in units that make it small integers where that is possible.

    All named lattices are of that kind, and with integers the kernels' comparisons are exact.
    Otherwise it is divided by its smallest diagonal entry.
    """
    unit = float(np.diag(gram).min())
    for k in range(1, 25):
        scaled = gram / unit * k
        rounded = np.rint(scaled)
        if np.abs(scaled - rounded).max() < 1e-9 * k and np.abs(rounded).max() < 4096:
            return rounded
    return gram / unit
