"""Numba kernels of the growing grid: dense tiles of counts, found by an open-addressing hash table.

Scans hit the same few thousand cells again and again; adding them to a tile is one array access,
where merging sorted lists would touch the whole map for every scan. A tile holds ``1 << (n * bits)``
cells of two channels (hits and passes).
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

EMPTY = np.int64(-(2**63))


@njit(cache=True, nogil=True)
def _slot(table, key):
    """Return the slot of ``key`` in the table, or the free one where it belongs."""
    # Fibonacci hashing: the product spreads neighbouring tiles, whose keys differ in a few low bits, over the table.
    # At most half of the slots are taken, so that the walk to a free one is short and always ends.
    mask = np.uint64(table.shape[0] - 1)
    h = np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)
    at = (h >> np.uint64(20)) & mask
    while table[at] != key and table[at] != EMPTY:
        at = (at + np.uint64(1)) & mask
    return at


@njit(cache=True, nogil=True)
def _tile_key(a, b, c, n):
    """Return the packed key of a tile, as :func:`hexmap.lattice.keys.pack` packs cells."""
    if n == 2:
        return (a << np.int64(32)) + b + np.int64(2147483648)
    return ((a + 1048576) << np.int64(42)) | ((b + 1048576) << np.int64(21)) | (c + 1048576)


@njit(cache=True, nogil=True)
def rehash(table, numbers, new_table, new_numbers):
    """Copy all entries into a larger table."""
    # The mask is part of the hash, so every key has another slot there; tiles stay where they are.
    for i in range(table.shape[0]):
        if table[i] != EMPTY:
            at = _slot(new_table, table[i])
            new_table[at] = table[i]
            new_numbers[at] = numbers[i]


@njit(cache=True, nogil=True)
def add(index, begin, channel, bits, table, numbers, corners, tiles, used):
    """Count the cells ``index[begin:]`` into ``channel``; stops where one more tile does not fit.

    Returns the row it stopped at and the number of tiles in use; the caller makes room and calls
    again. ``corners`` (T, 3) remembers each tile's coordinates.
    """
    n = index.shape[1]
    side = np.int64(1) << bits
    low = side - 1
    room = min(tiles.shape[0], table.shape[0] // 2)
    last_key = EMPTY
    last = np.int64(-1)
    c = np.int64(0)
    for i in range(begin, index.shape[0]):
        a = np.int64(index[i, 0])
        b = np.int64(index[i, 1])
        # The lower bits of an index say where in its tile the cell is, the upper ones which tile; below zero, too.
        inner = ((a & low) << bits) | (b & low)
        tc = np.int64(0)
        if n == 3:
            c = np.int64(index[i, 2])
            inner = (inner << bits) | (c & low)
            tc = c >> bits
        key = _tile_key(a >> bits, b >> bits, tc, n)
        # Beams and walls stay in a tile for several cells: most cells need no look-up.
        if key != last_key:
            at = _slot(table, key)
            if table[at] == EMPTY:
                # Nothing of this cell is counted yet, so the caller can make room and begin with it again.
                if used >= room:
                    return i, used
                table[at] = key
                numbers[at] = used
                corners[used, 0] = a >> bits
                corners[used, 1] = b >> bits
                corners[used, 2] = tc
                used += 1
            last = numbers[at]
            last_key = key
        tiles[last, channel, inner] += 1
    return index.shape[0], used


@njit(cache=True, nogil=True)
def window(low, shape, channel, bits, table, numbers, tiles, n, out):
    """Copy the counts of the box that begins at ``low`` into the flat array ``out`` (row-major)."""
    # The tiles that the box touches; in the plane there is one layer of one cell.
    side = np.int64(1) << bits
    s2 = shape[2] if n == 3 else 1
    a0 = low[0] >> bits
    a1 = (low[0] + shape[0] - 1) >> bits
    b0 = low[1] >> bits
    b1 = (low[1] + shape[1] - 1) >> bits
    c0 = low[2] >> bits if n == 3 else np.int64(0)
    c1 = (low[2] + shape[2] - 1) >> bits if n == 3 else np.int64(0)
    depth = side if n == 3 else np.int64(1)
    for ta in range(a0, a1 + 1):
        for tb in range(b0, b1 + 1):
            for tc in range(c0, c1 + 1):
                at = _slot(table, _tile_key(ta, tb, tc, n))
                # A tile that was never made has only zeros, which ``out`` holds already.
                if table[at] == EMPTY:
                    continue
                t = numbers[at]
                # Its cells, less those that stand out of the box.
                for i in range(side):
                    x = (ta << bits) + i - low[0]
                    if x < 0 or x >= shape[0]:
                        continue
                    for j in range(side):
                        y = (tb << bits) + j - low[1]
                        if y < 0 or y >= shape[1]:
                            continue
                        for k in range(depth):
                            z = (tc << bits) + k - low[2] if n == 3 else np.int64(0)
                            if z < 0 or z >= s2:
                                continue
                            inner = (i << bits) | j
                            if n == 3:
                                inner = (inner << bits) | k
                            out[(x * shape[1] + y) * s2 + z] = tiles[t, channel, inner]


@njit(cache=True, nogil=True)
def count_cells(channel, tiles, used):
    """Return how many cells of ``channel`` are not zero."""
    m = 0
    for t in range(used):
        for i in range(tiles.shape[2]):
            if tiles[t, channel, i] > 0:
                m += 1
    return m


@njit(cache=True, nogil=True)
def cells(channel, bits, corners, tiles, used, n, index, counts):
    """Write the index and the count of every cell of ``channel`` that is not zero, tile by tile; returns how many."""
    mask = (1 << bits) - 1
    m = 0
    for t in range(used):
        for i in range(tiles.shape[2]):
            if tiles[t, channel, i] > 0:
                # The index again: the tile's coordinates above, the bits of the place in the tile below.
                if n == 2:
                    index[m, 0] = (corners[t, 0] << bits) + (i >> bits)
                    index[m, 1] = (corners[t, 1] << bits) + (i & mask)
                else:
                    index[m, 0] = (corners[t, 0] << bits) + (i >> (2 * bits))
                    index[m, 1] = (corners[t, 1] << bits) + ((i >> bits) & mask)
                    index[m, 2] = (corners[t, 2] << bits) + (i & mask)
                counts[m] = tiles[t, channel, i]
                m += 1
    return m
