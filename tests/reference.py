"""A second implementation, slow and obvious, that the library is held against.

Everything is decided in exact numbers: coordinates are the integers that
:meth:`Lattice.coordinates` gives times 2^32, Gram matrices are the integers (or fractions) of
``lattices.py``, and all cells near enough are tried. Nothing here calls a kernel.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import Counter, deque
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tests.lattices import Case

if TYPE_CHECKING:
    from hexmap.graph.lattice_graph import LatticeGraph

ONE = 2**32
Index = tuple[int, ...]


def as_tuples(index: NDArray[np.integer]) -> list[Index]:
    return [tuple(int(v) for v in row) for row in index]


def to_public(case: Case) -> NDArray[np.int64]:
    """The unimodular matrix (n, n) that takes indices of the reduced basis to the public one."""
    to_reduced = case.lattice.reduced_index(np.eye(case.dim, dtype=np.int32)).T
    U = np.rint(np.linalg.inv(to_reduced)).astype(np.int64)
    assert (U @ to_reduced == np.eye(case.dim)).all()
    return U


def reduced_gram(case: Case) -> NDArray[np.object_]:
    """The exact Gram matrix of the basis that `Lattice.coordinates` refers to, scaled to integers."""
    U = to_public(case).astype(object)
    G = U.T @ case.gram @ U
    common = math.lcm(*[Fraction(v).denominator for v in G.ravel()])
    return np.array([[int(v * common) for v in row] for row in G], dtype=object)


def grid_coordinates(case: Case, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Reduced coordinates of points in whole 2^-32 of a cell."""
    u = case.lattice.coordinates(np.asarray(points, dtype=np.float64)) * ONE
    m = u.astype(np.int64)
    assert (m == u).all()
    return m


def _candidates(case: Case, reach: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All offsets in a box, ascending by public index, in the reduced and the public basis."""
    reduced = np.array(list(itertools.product(range(-reach, reach + 2), repeat=case.dim)), dtype=np.int64)
    public = reduced @ to_public(case).T
    order = np.lexsort(public.T[::-1])
    return reduced[order], public[order]


def scores(case: Case, points: NDArray[np.float64], reach: int = 2) -> tuple[NDArray, NDArray, NDArray]:
    """Squared distances to all candidates, less what they share, exact; the candidates; the floor (public)."""
    m = grid_coordinates(case, points)
    floor, f = m >> 32, m & (ONE - 1)
    reduced, public = _candidates(case, reach)
    G = reduced_gram(case)
    if max(abs(int(v)) for v in G.ravel()) < 4096:
        G = G.astype(np.int64)  # everything below stays under 2^53
    else:
        f, reduced = f.astype(object), reduced.astype(object)
    s = ((reduced @ G) * reduced).sum(axis=1) * ONE - 2 * (f @ G) @ reduced.T
    return s, public, floor @ to_public(case).T


def nearest(case: Case, points: NDArray[np.float64], reach: int = 2) -> NDArray[np.int64]:
    """The nearest lattice point by trying all; of several the lexicographically lowest."""
    found = []
    for part in np.array_split(np.asarray(points, dtype=np.float64), max(1, len(points) // 5000)):
        s, public, floor = scores(case, part, reach)
        # argmin takes the first of several, and the candidates ascend.
        found.append(floor + public[np.argmin(s, axis=1)])
    return np.concatenate(found) if found else np.empty((0, case.dim), np.int64)


def voxels(case: Case, points: NDArray[np.float64]) -> dict[Index, int]:
    """The occupied voxel list as a dictionary."""
    return dict(Counter(as_tuples(nearest(case, points))))


def merge(a: dict[Index, int], b: dict[Index, int]) -> dict[Index, int]:
    return {key: a.get(key, 0) + b.get(key, 0) for key in {*a, *b}}


def count_coincident(a: dict[Index, int], b: dict[Index, int]) -> int:
    return sum(1 for key in a if key in b)


def rows(a: dict[Index, int]) -> list[list[int]]:
    return [[*key, count] for key, count in sorted(a.items())]


def steps_from_origin(neighbours: NDArray[np.int64], radius: int) -> dict[Index, int]:
    """Breadth-first search: every cell within ``radius`` moves and how many it takes."""
    moves = as_tuples(neighbours)
    origin = (0,) * neighbours.shape[1]
    steps = {origin: 0}
    queue = deque([origin])
    while queue:
        cell = queue.popleft()
        if steps[cell] == radius:
            continue
        for move in moves:
            to = tuple(a + b for a, b in zip(cell, move, strict=True))
            if to not in steps:
                steps[to] = steps[cell] + 1
                queue.append(to)
    return steps


def cells_along(
    case: Case, start: NDArray[np.float64], end: NDArray[np.float64], shortest: Fraction = Fraction(0)
) -> list[tuple[Fraction, Index]]:
    """The cells that a segment passes along some length, by clipping it against every cell near it.

    Returns (where the segment enters, cell) in order. A segment that runs in a face belongs to
    the lower of the two cells. Cells with less than or exactly ``shortest`` of it are left out.
    """
    ends = grid_coordinates(case, np.array([start, end]))
    u0 = [int(v) for v in ends[0]]
    d = [int(b) - int(a) for a, b in zip(ends[0], ends[1], strict=True)]
    G = reduced_gram(case)
    U = to_public(case)
    faces = case.lattice.reduced_index(case.lattice.faces)
    planes = [(tuple(int(x) for x in U @ v), [int(x) for x in v.astype(object) @ G]) for v in faces]
    halves = [Fraction(int(v.astype(object) @ G @ v.astype(object)), 2) * ONE for v in faces]
    low = np.floor(ends.min(axis=0) / ONE).astype(int) - 2
    high = np.ceil(ends.max(axis=0) / ONE).astype(int) + 2
    box = np.array(list(itertools.product(*[range(a, b + 1) for a, b in zip(low, high, strict=True)])))
    public = box @ U.T
    x = case.lattice.centres(public)
    along = np.asarray(end, dtype=float) - start
    t = np.clip((x - start) @ along / max(along @ along, 1e-300), 0, 1)
    near = np.linalg.norm(x - start - t[:, None] * along, axis=1) < 1.001 * case.lattice.covering_radius
    found = []
    for c, name in zip(box[near], as_tuples(public[near]), strict=True):
        begin, finish = Fraction(0), Fraction(1)
        mine = True
        for (v, plane), half in zip(planes, halves, strict=True):
            rate = sum(a * b for a, b in zip(d, plane, strict=True))
            gap = half - sum((a - int(k) * ONE) * b for a, k, b in zip(u0, c, plane, strict=True))
            if rate > 0:
                finish = min(finish, gap / rate)
            elif rate < 0:
                begin = max(begin, gap / rate)
            elif gap < 0 or (gap == 0 and v < (0,) * len(v)):
                mine = False
        if mine and finish - begin > shortest:
            found.append((begin, name))
    return sorted(found)


def traversed(case: Case, start: NDArray[np.float64], end: NDArray[np.float64]) -> list[Index]:
    """The cells of a ray in order: that of its start, those it passes along some length, that of its end."""
    first, last = as_tuples(nearest(case, np.array([start, end])))
    middle = [c for _, c in cells_along(case, start, end) if c not in (first, last)]
    return [first] if first == last else [first, *middle, last]


def is_symmetry(case: Case, matrix: NDArray[np.int64]) -> bool:
    """Tell whether an integer matrix maps the lattice onto itself and keeps all lengths, exactly."""
    M = matrix.astype(object)
    return bool((M.T @ case.gram @ M == case.gram).all())


def symmetries(case: Case) -> set[tuple[int, ...]]:
    """All symmetries: every choice of images for the reduced basis among the short vectors, tried."""
    n = case.dim
    G, U = reduced_gram(case), to_public(case)
    box = np.array(list(itertools.product(range(-3, 4), repeat=n)), dtype=object)
    lengths = ((box @ G) * box).sum(axis=1)
    inverse = np.rint(np.linalg.inv(U)).astype(np.int64)
    found = set()
    for images in itertools.product(*[box[lengths == G[i, i]] for i in range(n)]):
        M = np.array(images, dtype=object).T
        if (M.T @ G @ M == G).all():
            found.add(tuple(int(v) for v in (U @ M.astype(np.int64) @ inverse).ravel()))
    return found


def state(hits: int, passes: int, min_hits: int, min_ratio: str, min_passes: int) -> int:
    """What a cell is: 2 occupied, 1 free, 0 unknown; the ratio as the decimal number a user wrote."""
    if hits >= min_hits and Fraction(hits, hits + passes) >= Fraction(min_ratio):
        return 2
    return 1 if passes >= min_passes else 0


def least_costs(graph: LatticeGraph, sources: list[int]) -> NDArray[np.float64]:
    """Return the least cost (size,) to each flat cell: every move looked at, the nearest cell first, the same sums."""
    free, terrain = graph.free.tolist(), None if graph.terrain is None else graph.terrain.tolist()
    sweeps = np.split(graph.swept, graph.swept_starts[1:-1])
    moves = list(zip(graph.offsets.tolist(), graph.lengths.tolist(), [s.tolist() for s in sweeps], strict=True))
    out = np.full(graph.size, np.inf)
    queue = [(0.0, a) for a in sources]
    while queue:
        cost, a = heapq.heappop(queue)
        if cost >= out[a]:
            continue
        out[a] = cost
        for offset, length, swept in moves:
            b = a + offset
            if free[b] and all(free[a + s] for s in swept):
                rise = length if terrain is None else length * (0.5 * (terrain[a] + terrain[b]))
                heapq.heappush(queue, (cost + rise, b))
    return out
