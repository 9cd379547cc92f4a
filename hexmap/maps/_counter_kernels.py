"""Numba kernels of the growing grid: dense tiles of counts, found by an open-addressing hash table.

Scans hit the same few thousand cells again and again; adding them to a tile is one array access, where merging sorted
lists would touch the whole map for every scan. A tile holds ``1 << (n * bits)`` cells, hits and passes of a cell side
by side: whoever changes one of them asks for both, to see whether the cell's state has changed.

The quantiser and the walk along a ray are the lattice's (``hexmap/lattice/_kernels.py`` and ``_ray_kernels.py``). Numba
does not notice when those are edited: delete the caches then (``make clean``).
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from hexmap.lattice._kernels import quantise_2d, quantise_3d
from hexmap.lattice._ray_kernels import LANES, count_bound, empty_signs, face_pairs, traverse, walk_keys

EMPTY = np.int64(-(2**63))
# Rays that are walked before their cells are counted: few, so that the cells are still in the processor's cache.
CHUNK = LANES
SCALE = 4294967296.0


class TileArrays(NamedTuple):
    """The tiles of a counter.

    Attributes:
        table: (K,) int64 keys of tiles, ``EMPTY`` where there is none; K is a power of two.
        numbers: (K,) int64 which tile has that key.
        corners: (T, 3) int64 the coordinates of each tile.
        tiles: (T, cells, 2) int32 or int64, hits and passes.
        journal: (J,) int64 room for the cells (tile * cells + cell) that have hits and were changed; (0,) where nobody
            wants to know.
        bits: a tile has 2^bits cells along each axis.
    """

    table: np.ndarray
    numbers: np.ndarray
    corners: np.ndarray
    tiles: np.ndarray
    journal: np.ndarray
    bits: int


@njit(cache=True, nogil=True)
def slot(table, key):
    """Return the slot of ``key`` in the table, or the free one where it belongs."""
    # Fibonacci hashing: the product spreads neighbouring tiles, whose keys differ in a few bits of each field, over the
    # table. Its high bits are taken: the lower ones know nothing of the first coordinate.
    # At most half of the slots are taken, so that the walk to a free one is short and always ends.
    mask = np.uint64(table.shape[0] - 1)
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    at = (h >> np.uint64(40)) & mask
    while table[at] != key and table[at] != EMPTY:
        at = (at + np.uint64(1)) & mask
    return at


@njit(cache=True, nogil=True)
def cell_key(a, b, c, n):
    """Return the packed key of a cell or a tile, as :func:`hexmap.lattice.keys.pack` packs cells."""
    if n == 2:
        return (a << np.int64(32)) + b + np.int64(2147483648)
    return ((a + 1048576) << np.int64(42)) | ((b + 1048576) << np.int64(21)) | (c + 1048576)


@njit(cache=True, nogil=True)
def rehash(table, numbers, new_table, new_numbers):
    """Copy all entries into a larger table."""
    # The mask is part of the hash, so every key has another slot there; tiles stay where they are.
    for i in range(table.shape[0]):
        if table[i] != EMPTY:
            at = slot(new_table, table[i])
            new_table[at] = table[i]
            new_numbers[at] = numbers[i]


@njit(cache=True, nogil=True)
def add(arrays, index, begin, stop, channel, used, noted, most):
    """Count the cells ``index[begin:stop]`` into ``channel``; stops where a tile, a count or a note does not fit.

    Returns:
        The row it stopped at, the number of tiles in use and the number of notes in the journal; the caller makes room
        and calls again. ``most`` is the largest count that a cell can hold.
    """
    table, numbers, corners, tiles, journal = arrays.table, arrays.numbers, arrays.corners, arrays.tiles, arrays.journal
    bits = arrays.bits
    n = index.shape[1]
    cells = tiles.shape[1]
    side = np.int64(1) << bits
    low = side - 1
    room = min(tiles.shape[0], table.shape[0] // 2)
    last_key = EMPTY
    last = np.int64(-1)
    c = np.int64(0)
    for i in range(begin, stop):
        a = np.int64(index[i, 0])
        b = np.int64(index[i, 1])
        # The lower bits of an index say where in its tile the cell is, the upper ones which tile; below zero, too.
        inner = ((a & low) << bits) | (b & low)
        tc = np.int64(0)
        if n == 3:
            c = np.int64(index[i, 2])
            inner = (inner << bits) | (c & low)
            tc = c >> bits
        key = cell_key(a >> bits, b >> bits, tc, n)
        # Beams and walls stay in a tile for several cells: most cells need no look-up.
        if key != last_key:
            at = slot(table, key)
            if table[at] == EMPTY:
                # Nothing of this cell is counted yet, so the caller can make room and begin with it again.
                if used >= room:
                    return i, used, noted
                table[at] = key
                numbers[at] = used
                corners[used, 0] = a >> bits
                corners[used, 1] = b >> bits
                corners[used, 2] = tc
                used += 1
            last = numbers[at]
            last_key = key
        if tiles[last, inner, channel] >= most:
            return i, used, noted
        # A cell without hits is not occupied, whatever passes through it: nothing to note.
        if journal.shape[0] > 0 and (channel == 0 or tiles[last, inner, 0] > 0):
            if noted >= journal.shape[0]:
                return i, used, noted
            journal[noted] = last * cells + inner
            noted += 1
        tiles[last, inner, channel] += 1
    return stop, used, noted


@njit(cache=True, nogil=True)
def add_keys(arrays, keys, begin, stop, channel, used, noted, most):
    """Count the cells in space with the packed ``keys[begin:stop]``, as :func:`add` does."""
    table, numbers, corners, tiles, journal = arrays.table, arrays.numbers, arrays.corners, arrays.tiles, arrays.journal
    cells = tiles.shape[1]
    room = min(tiles.shape[0], table.shape[0] // 2)
    # All bits of a key but the lowest three of each field: which tile it is in.
    outer = ~((np.int64(7) << 42) | (np.int64(7) << 21) | np.int64(7))
    # Flat, with unsigned places: the compiler then neither multiplies nor asks whether an index counts from the end.
    flat = tiles.reshape(-1)
    following = journal.shape[0] > 0
    last_tile = EMPTY
    last = np.int64(-1)
    base = np.uint64(0)
    for i in range(np.uint64(begin), np.uint64(stop)):
        packed = keys[i]
        inner = ((packed >> 36) & 0x1C0) | ((packed >> 18) & 0x38) | (packed & 7)
        if packed & outer != last_tile:
            # Fields are not negative: the index of the tile is that of the cell, shifted.
            ta = ((packed >> 42) - 1048576) >> 3
            tb = (((packed >> 21) & 0x1FFFFF) - 1048576) >> 3
            tc = ((packed & 0x1FFFFF) - 1048576) >> 3
            key = cell_key(ta, tb, tc, 3)
            at = slot(table, key)
            if table[at] == EMPTY:
                if used >= room:
                    return np.int64(i), used, noted
                table[at] = key
                numbers[at] = used
                corners[used, 0] = ta
                corners[used, 1] = tb
                corners[used, 2] = tc
                used += 1
            last = numbers[at]
            base = np.uint64(2 * cells * last + channel)
            last_tile = packed & outer
        place = base + np.uint64(inner + inner)
        before = flat[place]
        if before >= most:
            return np.int64(i), used, noted
        if following and (channel == 0 or tiles[last, inner, 0] > 0):
            if noted >= journal.shape[0]:
                return np.int64(i), used, noted
            journal[noted] = last * cells + inner
            noted += 1
        flat[place] = before + 1
    return stop, used, noted


@njit(cache=True, nogil=True)
def find(arrays, index, channel, out):
    """Write the counts of the cells ``index`` (M, n); ``out`` (M,) holds zeros."""
    bits = arrays.bits
    n = index.shape[1]
    low = (np.int64(1) << bits) - 1
    for m in range(index.shape[0]):
        a = np.int64(index[m, 0])
        b = np.int64(index[m, 1])
        c = np.int64(index[m, 2]) if n == 3 else np.int64(0)
        key = cell_key(a >> bits, b >> bits, c >> bits, n)
        at = slot(arrays.table, key)
        if arrays.table[at] == key:
            inner = ((a & low) << bits) | (b & low)
            if n == 3:
                inner = (inner << bits) | (c & low)
            out[m] = arrays.tiles[arrays.numbers[at], inner, channel]


@njit(cache=True, nogil=True)
def put(arrays, index, channel, counts):
    """Write counts (M,) of the cells ``index`` (M, n), whose tiles exist."""
    bits = arrays.bits
    n = index.shape[1]
    low = (np.int64(1) << bits) - 1
    for m in range(index.shape[0]):
        a = np.int64(index[m, 0])
        b = np.int64(index[m, 1])
        c = np.int64(index[m, 2]) if n == 3 else np.int64(0)
        at = slot(arrays.table, cell_key(a >> bits, b >> bits, c >> bits, n))
        inner = ((a & low) << bits) | (b & low)
        if n == 3:
            inner = (inner << bits) | (c & low)
        arrays.tiles[arrays.numbers[at], inner, channel] = counts[m]


@njit(cache=True, nogil=True)
def _quantise(points, q, out):
    """Write the nearest lattice points; returns how many are out of range."""
    if points.shape[1] == 2:
        return quantise_2d(
            points, q.inverse, q.gram2, q.constants, q.extra, q.extra_constants, q.to_public, q.limit, out
        )
    return quantise_3d(points, q.inverse, q.gram2, q.constants, q.extra, q.extra_constants, q.to_public, q.limit, out)


@njit(cache=True, nogil=True)
def _coordinate(points, r, i, inverse):
    """Return a reduced coordinate, as :meth:`hexmap.lattice.lattice.Lattice.coordinates` does, bit for bit."""
    u = points[r, 0] * inverse[i, 0]
    for k in range(1, points.shape[1]):
        u += points[r, k] * inverse[i, k]
    return np.rint(u * SCALE) / SCALE


class Rays(NamedTuple):
    """The rays of a scan, ready to be walked.

    Attributes:
        first: (R, n) int32 the cells of their starts.
        last: (R, n) int32 those of their ends.
        start: (R, n) float64 reduced coordinates.
        end: (R, n) the same.
        offset: (R, n) of the starts from their cells.
        room: (R,) int64 at most so many cells each.
    """

    first: np.ndarray
    last: np.ndarray
    start: np.ndarray
    end: np.ndarray
    offset: np.ndarray
    room: np.ndarray


@njit(cache=True, nogil=True)
def prepare(quantiser, faces, origin, ends):
    """Make the rays of a scan ready.

    Args:
        quantiser: :class:`hexmap.lattice.lattice.QuantiserTables`.
        faces: :class:`hexmap.lattice.lattice.RayTables`.
        origin: (1, n) where the rays begin, metres.
        ends: (R, n) metres.

    Returns:
        Rows out of range, and the :class:`Rays`, which are of no use if there are any.
    """
    n = origin.shape[1]
    rays = ends.shape[0]
    first = np.empty((rays + 1, n), np.int32)
    last = np.empty((rays, n), np.int32)
    # The traversal takes a start for each ray; all of ours are the same.
    start = np.empty((rays, n))
    end = np.empty((rays, n))
    offset = np.empty((rays, n))
    bad = _quantise(ends, quantiser, last) + _quantise(origin, quantiser, first[rays:])
    if bad > 0:
        return bad, Rays(first[:rays], last, start, end, offset, np.empty(0, np.int64))
    for i in range(n):
        reduced = np.int64(0)
        for k in range(n):
            reduced += quantiser.to_reduced[i, k] * np.int64(first[rays, k])
        u = _coordinate(origin, 0, i, quantiser.inverse)
        for r in range(rays):
            first[r, i] = first[rays, i]
            start[r, i] = u
            offset[r, i] = u - reduced
            end[r, i] = _coordinate(ends, r, i, quantiser.inverse)
    return 0, Rays(first[:rays], last, start, end, offset, count_bound(start, end, faces))


@njit(cache=True, nogil=True)
def fuse(arrays, rays, faces, hits, chunk, row, used, noted, most):
    """Count the prepared rays of a scan: a hit at each of the first ``hits`` ends, a pass in all cells before it.

    The other rays ended in nothing: all their cells are passed.

    Args:
        arrays: the tiles.
        rays: of :func:`prepare`.
        faces: :class:`hexmap.lattice.lattice.RayTables`.
        hits: how many of them were hit.
        chunk: the first ray of the chunk to go on with, 0 at the beginning.
        row: how many cells of that chunk are counted already.
        used: tiles in use.
        noted: notes in the journal.
        most: the largest count that a cell can hold.

    Returns:
        Chunk, row, used and noted to go on with, once there is room; chunk is R when all is done.
    """
    count = rays.end.shape[0]
    n = rays.end.shape[1]
    largest = np.int64(0)
    for begin in range(0, count, CHUNK):
        largest = max(largest, rays.room[begin : begin + CHUNK].sum())
    if n == 3:
        return _count_in_space(arrays, rays, faces, largest, hits, chunk, row, used, noted, most)
    cells = np.empty((largest, n), np.int32)
    stops = np.empty(CHUNK, np.int64)
    while chunk < count:
        stop = min(chunk + CHUNK, count)
        traverse(
            rays.start[chunk:stop], rays.end[chunk:stop], rays.offset[chunk:stop], rays.first[chunk:stop],
            rays.last[chunk:stop], faces, rays.room[chunk:stop], cells, stops,
        )  # fmt: skip
        # ``row`` counts what of this chunk was counted before there was no room: the walk is the same every time.
        begin = np.int64(0)
        for r in range(stop - chunk):
            hit = 1 if chunk + r < hits else 0
            edge = stops[r] - hit
            if row < edge:
                row, used, noted = add(arrays, cells, max(row, begin), edge, 1, used, noted, most)
                if row < edge:
                    return chunk, row, used, noted
            if hit == 1 and row < stops[r]:
                row, used, noted = add(arrays, cells, edge, stops[r], 0, used, noted, most)
                if row < stops[r]:
                    return chunk, row, used, noted
            begin = stops[r]
        chunk, row = stop, np.int64(0)
    return chunk, row, used, noted


@njit(cache=True, nogil=True)
def _count_in_space(arrays, rays, faces, largest, hits, chunk, row, used, noted, most):
    """Count rays in space, whose cells are known by packed keys, as :func:`fuse` does.

    ``largest`` cells are the most of a chunk; ``row`` counts keys from the first of a chunk on, those between two rays
    that none is written to included.
    """
    count = rays.end.shape[0]
    pairs = face_pairs(faces)
    signs = empty_signs(pairs.shape[0])
    keys = np.empty(largest, np.int64)
    cells = np.empty((rays.room.max() if count > 0 else 0, 3), np.int32)
    first, last = np.empty(CHUNK, np.int64), np.empty(CHUNK, np.int64)
    begins, stops, one = np.empty(CHUNK, np.int64), np.empty(CHUNK, np.int64), np.empty(1, np.int64)
    while chunk < count:
        stop = min(chunk + CHUNK, count)
        total = np.int64(0)
        for r in range(chunk, stop):
            i = r - chunk
            begins[i] = total
            total += rays.room[r]
            first[i] = cell_key(np.int64(rays.first[r, 0]), np.int64(rays.first[r, 1]), np.int64(rays.first[r, 2]), 3)
            last[i] = cell_key(np.int64(rays.last[r, 0]), np.int64(rays.last[r, 1]), np.int64(rays.last[r, 2]), 3)
        walk_keys(
            rays.start[chunk:stop], rays.end[chunk:stop], rays.offset[chunk:stop], first, last, faces, pairs, signs,
            rays.room[chunk:stop], keys, begins, stops,
        )  # fmt: skip
        for r in range(chunk, stop):
            begin, edge = begins[r - chunk], stops[r - chunk]
            if edge < 0:
                m = traverse(
                    rays.start[r : r + 1], rays.end[r : r + 1], rays.offset[r : r + 1], rays.first[r : r + 1],
                    rays.last[r : r + 1], faces, rays.room[r : r + 1], cells, one,
                )  # fmt: skip
                for i in range(m):
                    keys[begin + i] = cell_key(np.int64(cells[i, 0]), np.int64(cells[i, 1]), np.int64(cells[i, 2]), 3)
                edge = begin + m
            passed = edge - 1 if r < hits else edge
            if row < passed:
                row, used, noted = add_keys(arrays, keys, max(row, begin), passed, 1, used, noted, most)
                if row < passed:
                    return chunk, row, used, noted
            if row < edge:
                row, used, noted = add_keys(arrays, keys, passed, edge, 0, used, noted, most)
                if row < edge:
                    return chunk, row, used, noted
        chunk, row = stop, np.int64(0)
    return chunk, row, used, noted


@njit(cache=True, nogil=True)
def count_cells(channel, tiles, used):
    """Return how many cells of ``channel`` are not zero."""
    m = 0
    for t in range(used):
        for i in range(tiles.shape[1]):
            if tiles[t, i, channel] > 0:
                m += 1
    return m


@njit(cache=True, nogil=True)
def _end_of_group(order, corners, begin, stop, axis):
    """Return where the tiles that share a coordinate with the one at ``begin`` end."""
    end = begin
    while end < stop and corners[order[end], axis] == corners[order[begin], axis]:
        end += 1
    return end


@njit(cache=True, nogil=True)
def sorted_cells(channel, arrays, order, n, keys, counts):
    """Write the keys and the counts of all cells of ``channel`` that are not zero, in ascending order.

    ``order`` (T,) are the tiles by their coordinates. No sorting: the cells of tiles that share the first coordinate
    are visited row by row across all of them.
    """
    corners, tiles, bits = arrays.corners, arrays.tiles, arrays.bits
    side = np.int64(1) << bits
    depth = side if n == 3 else np.int64(1)
    m = 0
    begin = 0
    while begin < order.shape[0]:
        # All tiles of one first coordinate; in them one layer of cells after the other.
        end = _end_of_group(order, corners, begin, order.shape[0], 0)
        for i in range(side):
            a = begin
            while a < end:
                # Of those all of one second coordinate; in the plane there is only one.
                b = _end_of_group(order, corners, a, end, 1)
                for j in range(side):
                    for s in range(a, b):
                        t = order[s]
                        for k in range(depth):
                            inner = (i << bits) | j
                            if n == 3:
                                inner = (inner << bits) | k
                            count = tiles[t, inner, channel]
                            if count > 0:
                                x = (corners[t, 0] << bits) + i
                                y = (corners[t, 1] << bits) + j
                                z = (corners[t, 2] << bits) + k if n == 3 else np.int64(0)
                                keys[m] = cell_key(x, y, z, n)
                                counts[m] = count
                                m += 1
                a = b
        begin = end
    return m


@njit(cache=True, nogil=True)
def sorted_rows(arrays, order, first, stop, n, keys, hits, passes):
    """Write the key, hits and passes of all cells that were hit or passed, in ascending order.

    ``order`` are the tiles of one first coordinate by the others; of their layers of cells along the first index those
    from ``first`` to ``stop`` are taken. Returns how many rows there are.
    """
    corners, tiles, bits = arrays.corners, arrays.tiles, arrays.bits
    side = np.int64(1) << bits
    depth = side if n == 3 else np.int64(1)
    m = 0
    for i in range(first, stop):
        a = 0
        while a < order.shape[0]:
            # As in ``sorted_cells``: row by row across all tiles of a second coordinate.
            b = _end_of_group(order, corners, a, order.shape[0], 1)
            for j in range(side):
                for s in range(a, b):
                    t = order[s]
                    for k in range(depth):
                        inner = (i << bits) | j
                        if n == 3:
                            inner = (inner << bits) | k
                        hit = tiles[t, inner, 0]
                        passed = tiles[t, inner, 1]
                        if hit > 0 or passed > 0:
                            x = (corners[t, 0] << bits) + i
                            y = (corners[t, 1] << bits) + j
                            z = (corners[t, 2] << bits) + k if n == 3 else np.int64(0)
                            keys[m] = cell_key(x, y, z, n)
                            hits[m] = hit
                            passes[m] = passed
                            m += 1
            a = b
    return m


@njit(cache=True, nogil=True)
def noted_cells(arrays, noted, n, index, counts):
    """Write index, hits and passes of the cells in the journal; returns how many, each once."""
    cells = arrays.tiles.shape[1]
    bits = arrays.bits
    mask = (1 << bits) - 1
    # Sorted, so that a cell that was changed many times stands together.
    order = np.sort(arrays.journal[:noted])
    m = 0
    for r in range(noted):
        if r > 0 and order[r] == order[r - 1]:
            continue
        t = order[r] // cells
        i = order[r] % cells
        for a in range(n):
            index[m, a] = (arrays.corners[t, a] << bits) + ((i >> (bits * (n - 1 - a))) & mask)
        counts[m, 0] = arrays.tiles[t, i, 0]
        counts[m, 1] = arrays.tiles[t, i, 1]
        m += 1
    return m
