"""Numba kernels of the any-angle planner: line of sight on any lattice, and making paths taut.

Which cells a segment from 0 to v touches depends on v alone. The Voronoi cell V of every lattice of
the plane and of space is a zonotope, the sum of the segments z_e / 2 to -z_e / 2 (Fedorov), and the cell around
c != 0, v is touched exactly if

* c lies in the shadow of V along v: |det(c, z_e, v)| <= sum over d of |det(z_d, z_e, v)| / 2 for all e (in the
  plane |det(c, v)| <= sum over d of |det(z_d, v)| / 2), and
* 0 < c G v < v G v: a point t v of the closed cell of c is no nearer to 0 than to c, so that
  2 t (c G v) >= c G c, and the same from the other end.

So the touched cells of a layer across v are the lattice points of one polygon that moves along, and a
row of them is an interval. There are no ties to break and no steps that add up rounding errors.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Entries of the counts.
EXPANSIONS, PUSHES, LINES, SCANNED = range(4)

SHIFT = 2  # blocks are 4 cells wide
CHECK = 4  # layers until the distance is looked up again where a block had none
FARTHEST = 254  # blocks: as far as a distance is told
SLIDES = 1000  # of one turning cell in a row
BETTER = 1.0 - 1e-12  # a smaller gain is a rounding error


class View(NamedTuple):
    """What the line of sight needs to know of a lattice and a window, as plain arrays.

    Attributes:
        strides: (n,) int64 of the window.
        shape: (n,) int64 cells along each index.
        block_strides: (n,) int64 of the blocks of 4 cells a side.
        basis: (n, n) float64, metres.
        gram: (n, n) float64 of the basis.
        generators: (E, n) float64, the edges of the cell, one of each direction, in index coordinates.
        reach: (n,) float64, how far the cell reaches along each index.
        least: a cell between the two ends of a line has a product, by ``gram``, with the line of more than this.
        touch: the cell is taken larger by this fraction.
        guard: whether cells touched by a line in the window may lie outside it.
        strips: (2, E) float64 scratch of :func:`walk`.
    """

    strides: NDArray[np.int64]
    shape: NDArray[np.int64]
    block_strides: NDArray[np.int64]
    basis: NDArray[np.float64]
    gram: NDArray[np.float64]
    generators: NDArray[np.float64]
    reach: NDArray[np.float64]
    least: float
    touch: float
    guard: bool
    strips: NDArray[np.float64]


class Cells(NamedTuple):
    """What lines run through.

    Attributes:
        free: (size,) states; 0 is blocked.
        distances: (blocks,) what :func:`block_distances` returned, or empty: then every cell is looked at.
        terrain: (size,) float64, or empty: then lines may cross any of it.
    """

    free: NDArray[np.uint8]
    distances: NDArray[np.uint8]
    terrain: NDArray[np.float64]


class Segment(NamedTuple):
    """A line between two cells of the window.

    Attributes:
        at: (n,) int64 its first cell, in window coordinates.
        v: (n,) int64 the displacement to its last.
        touched: (N,) int64, where :func:`walk` lists the flat cells that it touches; empty: nowhere.
    """

    at: NDArray[np.int64]
    v: NDArray[np.int64]
    touched: NDArray[np.int64]


class Shadow(NamedTuple):
    """The cell's shadow along a segment, seen in the layers across the segment's longest index.

    Attributes:
        major: the index along which the segment is longest; a layer has one value of it.
        middle: the index that numbers the rows of a layer (in the plane there is one row).
        inner: the index along a row.
        slope_middle: how far the segment moves along ``middle`` a layer.
        slope_inner: the same along ``inner``.
        reach_middle: how far the shadow reaches along ``middle``.
        strips: how many of the view's strips bound a row.
        spread: whole cells by which a touched cell may be off the segment along ``middle`` and ``inner``.
    """

    major: int
    middle: int
    inner: int
    slope_middle: float
    slope_inner: float
    reach_middle: float
    strips: int
    spread: int


# ---------------------------------------------------------------------- places and lengths


@njit(cache=True, nogil=True)
def write_position(strides, flat, out):
    """Write the window coordinates of a flat cell."""
    rest = flat
    for i in range(strides.shape[0] - 1):
        x = rest // strides[i]
        out[i] = x
        rest -= x * strides[i]
    out[strides.shape[0] - 1] = rest


@njit(cache=True, nogil=True)
def norm(basis, v):
    """Return the length of the displacement ``v`` (n,) in index coordinates, metres."""
    n = v.shape[0]
    total = 0.0
    for r in range(n):
        x = 0.0
        for c in range(n):
            x += basis[r, c] * v[c]
        total += x * x
    return np.sqrt(total)


@njit(cache=True, nogil=True)
def span(strides, basis, a, b, at, v):
    """Return the distance of two flat cells, metres; write the position of ``a`` and the displacement to ``b``.

    Called for every cell that a search reaches, and therefore with plain arrays: a NamedTuple would have its
    references counted at every call.
    """
    write_position(strides, b, v)
    write_position(strides, a, at)
    for i in range(strides.shape[0]):
        v[i] -= at[i]
    return norm(basis, v)


@njit(cache=True, nogil=True)
def join(view, a, b, segment):
    """Return the distance of the flat cells ``a`` and ``b``, metres; the segment becomes the line between them."""
    return span(view.strides, view.basis, a, b, segment.at, segment.v)


@njit(cache=True, nogil=True)
def empty_segment(n):
    """Return a segment of ``n`` indices for :func:`join` to fill, which lists no cells."""
    return Segment(np.empty(n, np.int64), np.empty(n, np.int64), np.empty(0, np.int64))


@njit(cache=True, nogil=True)
def plain_cells(free):
    """Return cells without terrain, every one of which is looked at."""
    return Cells(free, np.empty(0, np.uint8), np.empty(0, np.float64))


# ---------------------------------------------------------------------- line of sight
#
# The helpers of walk are inlined into it: many lines end after a few cells, and a call that hands over arrays and
# brings back many numbers would be felt.


@njit(cache=True, nogil=True, inline="always")
def _shadow_across(generators, v, major, inner):
    """Return how wide the cell's shadow along ``v`` is, measured along ``inner`` in a layer across ``major``."""
    slope = v[inner] / v[major]
    total = 0.0
    for e in range(generators.shape[0]):
        total += abs(generators[e, inner] - generators[e, major] * slope)
    return total


@njit(cache=True, nogil=True, inline="always")
def _cast_shadow(generators, touch, v, strips):
    """Return the :class:`Shadow` along ``v`` (n,), which is not 0, and write what bounds its rows into ``strips``.

    A generator is moved along v into the layer through 0: what is left of it are its coordinates along the
    middle and the inner index. The shadow is the zonotope of these. It is the intersection of one strip for each
    pair of its sides; the row y of a strip is the interval y * strips[0] -+ strips[1].
    """
    n = v.shape[0]
    count = generators.shape[0]
    # Layers across the longest index: no other order has fewer of them, and slopes are at most 1.
    major = 0
    for i in range(n):
        if abs(v[i]) > abs(v[major]):
            major = i
    inner = n - 1 if major != n - 1 else n - 2
    grow = 1.0 + touch
    width = _shadow_across(generators, v, major, inner)
    slope_inner = v[inner] / v[major]
    if n == 2:
        # The layer is a row, and the shadow an interval.
        strips[0, 0] = 0.0
        strips[1, 0] = 0.5 * width * grow
        return Shadow(major, inner, inner, 0.0, slope_inner, 0.0, 1, np.int64(np.ceil(0.5 * width + 0.51)))
    middle = 3 - major - inner
    slope_middle = v[middle] / v[major]
    reach_middle = 0.5 * _shadow_across(generators, v, major, middle) * grow
    used = 0
    for e in range(count):
        # The two sides of the shadow along z_e.
        z_middle = generators[e, middle] - generators[e, major] * slope_middle
        z_inner = generators[e, inner] - generators[e, major] * slope_inner
        if abs(z_middle) <= 1e-9 * reach_middle:
            continue  # along the row, where reach_middle bounds, or along v
        total = 0.0
        for d in range(count):
            y = generators[d, middle] - generators[d, major] * slope_middle
            x = generators[d, inner] - generators[d, major] * slope_inner
            total += abs(x * z_middle - y * z_inner)
        strips[0, used] = z_inner / z_middle
        strips[1, used] = 0.5 * total * grow / abs(z_middle)
        used += 1
    # Half a cell more, because positions on the segment are rounded to cells.
    spread = np.int64(np.ceil(max(reach_middle, 0.5 * width) + 0.51))
    return Shadow(major, middle, inner, slope_middle, slope_inner, reach_middle, used, spread)


@njit(cache=True, nogil=True, inline="always")
def _rates(gram, v, major, inner):
    """Return G v (n,) along the major, the middle and the inner index, 0 where there is no middle, and v G v."""
    vgv = 0.0
    along_major = 0.0
    along_middle = 0.0
    along_inner = 0.0
    for i in range(v.shape[0]):
        rate = 0.0
        for k in range(v.shape[0]):
            rate += gram[i, k] * v[k]
        vgv += rate * v[i]
        if i == major:
            along_major = rate
        elif i == inner:
            along_inner = rate
        else:
            along_middle = rate
    return along_major, along_middle, along_inner, vgv


@njit(cache=True, nogil=True)
def walk(view, cells, segment, alike):
    """Look at the cells that a segment touches, the ends included, and list them in ``segment.touched`` if it has room.

    Args:
        view: the lattice and the window.
        cells: what is free. Where ``cells.distances`` says that blocks around the line are free, cells are not
            looked at one by one, unless they are listed or compared.
        segment: both its ends lie in the window; where it lists cells, ``touched`` must have room enough.
        alike: with terrain, a cell is as good as blocked where its terrain is another.

    Returns:
        the number of cells (and distances of blocks) looked at, negative where the last of them is not free.
    """
    strides, strips = view.strides, view.strips
    free, distances, terrain = cells
    at, v, out = segment
    n = strides.shape[0]
    listing = out.shape[0] > 0
    compare = terrain.shape[0] > 0
    base = np.int64(0)
    still = True
    for i in range(n):
        base += at[i] * strides[i]
        still = still and v[i] == 0
    if still:
        if listing:
            out[0] = base
        return -1 if free[base] == 0 or (compare and terrain[base] != alike) else 1

    # The polygon of the touched cells: the same in every layer, moved along.
    shadow = _cast_shadow(view.generators, view.touch, v, strips)
    major, middle, inner = shadow.major, shadow.middle, shadow.inner
    slope_middle, slope_inner, reach_middle = shadow.slope_middle, shadow.slope_inner, shadow.reach_middle
    used = shadow.strips
    stride_major, stride_inner = strides[major], strides[inner]
    stride_middle = strides[middle] if n == 3 else np.int64(0)
    at_major, at_middle, at_inner = at[major], at[middle], at[inner]
    block_major, block_inner = view.block_strides[major], view.block_strides[inner]
    block_middle = view.block_strides[middle]

    # c G v, which tells on which side of an end a cell lies, as a sum over the indices of c.
    rate_major, rate_middle, rate_inner, vgv = _rates(view.gram, v, major, inner)

    # Layer by layer from one end to the other. The cells around an end reach beyond it by ``margin`` layers, and
    # only so near to an end can the polygon hold cells that the segment does not touch.
    long = v[major]
    step = 1 if long > 0 else -1
    length = abs(long)
    margin = np.int64(np.floor(view.reach[major] + 1e-6))
    skipping = distances.shape[0] > 0 and not listing and not compare
    check = np.int64(0)
    seen = 0
    layer = -margin
    while layer <= length + margin:
        i = layer * step
        if skipping and check <= layer <= length:
            # All cells that the distance of this block promises, along each index, are free. The segment advances
            # fastest along its longest index: for as many layers, less the shadow's spread, it stays among them.
            block = ((at_major + i) >> SHIFT) * block_major
            block += ((at_inner + np.int64(np.floor(i * slope_inner + 0.5))) >> SHIFT) * block_inner
            if n == 3:
                block += ((at_middle + np.int64(np.floor(i * slope_middle + 0.5))) >> SHIFT) * block_middle
            seen += 1
            skip = ((np.int64(distances[block]) - 1) << SHIFT) - shadow.spread
            if skip >= 0:
                layer += skip + 1
                continue
            check = layer + CHECK  # the next few would fail too
        layer += 1
        near_end = layer <= margin + 1 or layer > length - margin
        centre_middle = i * slope_middle
        centre_inner = i * slope_inner
        first = np.int64(np.ceil(centre_middle - reach_middle))
        for j in range(first, np.int64(np.floor(centre_middle + reach_middle)) + 1):
            # The row is where the strips meet.
            y = j - centre_middle
            low = -np.inf
            high = np.inf
            for s in range(used):
                x = strips[0, s] * y
                low = max(low, x - strips[1, s])
                high = min(high, x + strips[1, s])
            flat = base + i * stride_major + j * stride_middle
            start = np.int64(np.ceil(centre_inner + low))
            for k in range(start, np.int64(np.floor(centre_inner + high)) + 1):
                if near_end and not (i == 0 and k == 0 and j == 0):
                    q = i * rate_major + j * rate_middle + k * rate_inner
                    end = i == long and k == v[inner] and (n == 2 or j == v[middle])
                    if (q < view.least or q > vgv - view.least) and not end:
                        continue
                if view.guard:
                    # The window's padding is too thin for this cell: outside nothing is free.
                    inside = (
                        0 <= at_major + i < view.shape[major]
                        and 0 <= at_inner + k < view.shape[inner]
                        and (n == 2 or 0 <= at_middle + j < view.shape[middle])
                    )
                    if not inside:
                        return -seen - 1
                cell = flat + k * stride_inner
                if listing:
                    out[seen] = cell
                seen += 1
                if free[cell] == 0 or (compare and terrain[cell] != alike):
                    return -seen
    return seen


@njit(cache=True, nogil=True)
def counted(seen, counts):
    """Tell whether a :func:`walk` that returned ``seen`` found the line free; count the line and its cells."""
    counts[LINES] += 1
    counts[SCANNED] += abs(seen)
    return seen > 0


@njit(cache=True, nogil=True)
def sees(view, cells, a, b, segment, counts):
    """Tell whether the flat cell ``a`` sees ``b``; count the line and its cells."""
    join(view, a, b, segment)
    return counted(walk(view, cells, segment, 0.0), counts)


@njit(cache=True, nogil=True)
def sights(view, free, distances, starts, ends, inside, out):
    """Write for each pair of ``starts`` and ``ends`` (M, n), window coordinates, whether one sees the other.

    Pairs that are not ``inside`` (M,) the window are left as they are. ``distances`` are those of :class:`Cells`.

    Returns:
        the number of cells looked at.
    """
    cells = Cells(free, distances, np.empty(0, np.float64))
    segment = empty_segment(starts.shape[1])
    scanned = 0
    for m in range(starts.shape[0]):
        if not inside[m]:
            continue
        for i in range(starts.shape[1]):
            segment.at[i] = starts[m, i]
            segment.v[i] = ends[m, i] - starts[m, i]
        seen = walk(view, cells, segment, 0.0)
        scanned += abs(seen)
        out[m] = seen > 0
    return scanned


@njit(cache=True, nogil=True)
def touched(view, free, a, b):
    """Return the flat cells that the segment between the flat cells ``a`` and ``b`` touches; it is free."""
    cells = plain_cells(free)
    segment = empty_segment(view.strides.shape[0])
    join(view, a, b, segment)
    # Once to count them, once to list them.
    out = np.empty(abs(walk(view, cells, segment, 0.0)), np.int64)
    walk(view, cells, Segment(segment.at, segment.v, out), 0.0)
    return out


# ---------------------------------------------------------------------- blocks that are far from anything blocked


@njit(cache=True, nogil=True)
def block_distances(view, free):
    """Return for each block of cells, 4 along each index, how far the nearest block with a cell that is not free is.

    Counted in blocks, diagonal steps as one, 254 at most, 0 for such a block itself; in ``view.block_strides``
    the blocks lie in memory.
    """
    n = view.strides.shape[0]
    layers = view.shape[0] if n == 3 else np.int64(1)
    rows = view.shape[n - 2]
    columns = view.shape[n - 1]
    deep = (layers + 3) >> SHIFT
    high = (rows + 3) >> SHIFT
    wide = (columns + 3) >> SHIFT
    out = np.full(deep * high * wide, FARTHEST, np.uint8)
    for x in range(layers):
        for y in range(rows):
            line = ((x >> SHIFT) * high + (y >> SHIFT)) * wide
            begin = (x * rows + y) * columns
            for z in range(columns):
                if free[begin + z] == 0:
                    out[line + (z >> SHIFT)] = 0
    # Two sweeps make the distances final: each block learns from the neighbours that lie before it in the order of
    # memory, then from those that lie behind it (Rosenfeld and Pfaltz, 1968).
    for sweep in range(2):
        for m in range(out.shape[0]):
            at = m if sweep == 0 else out.shape[0] - 1 - m
            out[at] = _distance_by_neighbours(out, at, sweep, deep, high, wide, n)
    return out


@njit(cache=True, nogil=True)
def _distance_by_neighbours(out, at, sweep, deep, high, wide, n):
    """Return the distance of the block ``at`` from those of its neighbours that this sweep has been to."""
    least = np.int64(out[at])
    if least == 0:
        return least
    z = at % wide
    y = (at // wide) % high
    x = at // (wide * high)
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            for dz in range(-1, 2):
                other = (dx * high + dy) * wide + dz
                if (other >= 0) != (sweep == 1) or other == 0:
                    continue
                if 0 <= x + dx < deep and 0 <= y + dy < high and 0 <= z + dz < wide:
                    least = min(least, np.int64(out[at + other]) + 1)
                elif n == 3 or dx == 0:
                    least = min(least, 1)  # outside nothing is free
    return least


# ---------------------------------------------------------------------- taut paths


@njit(cache=True, nogil=True)
def tighten(view, free, path, near, rounds, window, counts):
    """Return ``path`` (M,) made shorter: cells left out, moved to neighbours, and corners cut, until nothing helps.

    Args:
        view: the lattice and the window.
        free: (size,) the graph's cells.
        path: flat turning cells, each of which sees the next.
        near: flat offsets of the cells that a turning cell may slide to.
        rounds: at most.
        window: cells left out in a row are fewer.
        counts: as of :func:`search`; raised.
    """
    cells = plain_cells(free)
    segment = empty_segment(view.strides.shape[0])
    path = _pull(view, cells, path, window, segment, counts)
    for _ in range(rounds):
        if path.shape[0] < 3:
            break
        before = _length(view, path, segment)
        path = _cut(view, cells, path, segment, counts)
        _slide(view, cells, path, near, segment, counts)
        path = _pull(view, cells, path, window, segment, counts)
        if _length(view, path, segment) >= before * BETTER:
            break
    return path


@njit(cache=True, nogil=True)
def _length(view, path, segment):
    """Return the length of the straight lines along ``path`` (M,), metres."""
    total = 0.0
    for i in range(path.shape[0] - 1):
        total += join(view, path[i], path[i + 1], segment)
    return total


@njit(cache=True, nogil=True)
def _pull(view, cells, path, window, segment, counts):
    """Return the shortest path through a subset of ``path`` (M,) that leaves out less than ``window`` in a row."""
    m = path.shape[0]
    cost = np.empty(m, np.float64)
    last = np.empty(m, np.int64)
    cost[0] = 0.0
    last[0] = 0
    # The least cost to each cell, in their order, over all cells from which it may be reached.
    for j in range(1, m):
        cost[j] = cost[j - 1] + join(view, path[j - 1], path[j], segment)
        last[j] = j - 1
        for i in range(max(j - window, 0), j - 1):
            straight = cost[i] + join(view, path[i], path[j], segment)
            if straight < cost[j] * BETTER and counted(walk(view, cells, segment, 0.0), counts):
                cost[j] = straight
                last[j] = i
    # Back from the end, once to count and once to write.
    count = 1
    j = m - 1
    while j > 0:
        j = last[j]
        count += 1
    out = np.empty(count, np.int64)
    j = m - 1
    for i in range(count - 1, -1, -1):
        out[i] = path[j]
        j = last[j]
    return out


@njit(cache=True, nogil=True)
def _slide(view, cells, path, near, segment, counts):
    """Move each inner cell of ``path`` (M,) by the flat offsets ``near`` (K,) as long as that shortens."""
    for i in range(1, path.shape[0] - 1):
        p = path[i - 1]
        r = path[i + 1]
        for _ in range(SLIDES):
            q = path[i]
            least = (join(view, p, q, segment) + join(view, q, r, segment)) * BETTER
            best = q
            for k in range(near.shape[0]):
                b = q + near[k]
                # Two steps may lead out of the array, or around into another row: then to a cell that is far off.
                if not 0 <= b < cells.free.shape[0] or cells.free[b] == 0 or b in (p, q, r):
                    continue
                length = join(view, p, b, segment) + join(view, b, r, segment)
                # Lengths first: they cost less than looks.
                if (
                    length < least
                    and sees(view, cells, p, b, segment, counts)
                    and sees(view, cells, b, r, segment, counts)
                ):
                    least = length
                    best = b
            if best == q:
                break
            path[i] = best


@njit(cache=True, nogil=True)
def _cell_along(view, a, b, fraction, segment):
    """Return the flat cell whose index is nearest to the point at a ``fraction`` of the line from ``a`` to ``b``."""
    join(view, a, b, segment)
    cell = a
    for i in range(segment.v.shape[0]):
        cell += np.int64(np.floor(fraction * segment.v[i] + 0.5)) * view.strides[i]
    return cell


@njit(cache=True, nogil=True)
def _cut(view, cells, path, segment, counts):
    """Return ``path`` (M,) with its corners cut, by two cells on the legs for one, where that is free and shorter."""
    out = np.empty(2 * path.shape[0], np.int64)
    out[0] = path[0]
    count = 1
    for i in range(1, path.shape[0] - 1):
        # From the last cell that was kept, so that a cut may begin where the one before it ended.
        x, y = _cut_corner(view, cells, out[count - 1], path[i], path[i + 1], segment, counts)
        out[count] = x
        count += 1
        if x != y:
            out[count] = y
            count += 1
    out[count] = path[path.shape[0] - 1]
    return out[: count + 1].copy()


@njit(cache=True, nogil=True)
def _cut_corner(view, cells, p, q, r, segment, counts):
    """Return the flat cells x and y for which p, x, y, r is shorter than p, q, r, and free; twice ``q`` if none are."""
    length = join(view, p, q, segment) + join(view, q, r, segment)
    fraction = 0.5
    # Large cuts first: x on the leg before, y on the leg after, or one of them the corner itself.
    while fraction > 0.01:
        for variant in range(3):
            x = q if variant == 2 else _cell_along(view, q, p, fraction, segment)
            y = q if variant == 1 else _cell_along(view, q, r, fraction, segment)
            if cells.free[x] == 0 or cells.free[y] == 0 or x in (y, p) or y == r:
                continue
            new = join(view, p, x, segment) + join(view, x, y, segment) + join(view, y, r, segment)
            if new >= length * BETTER:
                continue
            # The new leg is the likeliest to be blocked; the others are near lines that are free.
            if (
                sees(view, cells, x, y, segment, counts)
                and sees(view, cells, p, x, segment, counts)
                and sees(view, cells, y, r, segment, counts)
            ):
                return x, y
        fraction *= 0.5
    return q, q


# ---------------------------------------------------------------------- shortcuts of a path of moves


@njit(cache=True, nogil=True)
def farthest(view, free, terrain, path, so_far, first):
    """Return the last cell of ``path`` (M,) up to which the cell ``first`` sees every one, and the length to it.

    With terrain, (size,) or empty, it counts as seen only across its own kind, and a line only where it
    costs no more than the path, whose cost up to each cell is ``so_far`` (M,).
    """
    cells = Cells(free, np.empty(0, np.uint8), terrain)
    segment = empty_segment(view.strides.shape[0])
    alike = terrain[path[first]] if terrain.shape[0] > 0 else 1.0
    best = first + 1
    best_cost = so_far[first + 1] - so_far[first]
    for j in range(first + 2, path.shape[0]):
        straight = join(view, path[first], path[j], segment) * alike
        if walk(view, cells, segment, alike) < 0:
            break
        if straight <= (so_far[j] - so_far[first]) * (1.0 + 1e-12):
            best = j
            best_cost = straight
    return best, best_cost
