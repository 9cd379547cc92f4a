"""Numba kernels of merging map files: packing rows, merging two sorted runs, sorting rows by tile.

A run is three columns: packed keys (:mod:`hexmap.lattice.keys`) in ascending order, each once, and the hits and passes
of each.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

SORTED, RANGE, NEGATIVE, REPEATED, UNSORTED = range(5)


@njit(cache=True, nogil=True)
def pack_rows(a, b, c, hits, passes, bits, offset, limit, before, run):
    """Pack the rows of a file into ``run`` (keys, hits, passes), without those of neither hits nor passes.

    ``c`` is empty in the plane; ``bits`` is the width of a key's field, ``offset`` (n,) what is added to each index,
    ``before`` the last key before these rows. Returns the rows kept, the last key, what is wrong and the row that is.
    """
    keys, run_hits, run_passes = run
    space = c.shape[0] > 0
    m = 0
    last = before
    for i in range(a.shape[0]):
        ia = np.int64(a[i])
        ib = np.int64(b[i])
        ic = np.int64(c[i]) if space else np.int64(0)
        # Checked before it is packed: an index out of range would run into the field beside its own.
        if ia >= limit or ia <= -limit or ib >= limit or ib <= -limit or ic >= limit or ic <= -limit:
            return m, last, RANGE, i
        if hits[i] < 0 or passes[i] < 0:
            return m, last, NEGATIVE, i
        key = ((ia + offset[0]) << bits) + (ib + offset[1])
        if space:
            key = (key << bits) + (ic + offset[2])
        if key <= last:
            return m, last, REPEATED if key == last else UNSORTED, i
        last = key
        keys[m] = key
        run_hits[m] = hits[i]
        run_passes[m] = passes[i]
        m += hits[i] > 0 or passes[i] > 0
    return m, last, SORTED, 0


@njit(cache=True, nogil=True)
def merge_runs(first, second, out):
    """Merge two runs into ``out``, adding the counts of equal keys; returns the length, and a row that wraps or -1."""
    keys_a, hits_a, passes_a = first
    keys_b, hits_b, passes_b = second
    keys, hits, passes = out
    i = 0
    j = 0
    m = 0
    wrapped = -1
    na = keys_a.shape[0]
    nb = keys_b.shape[0]
    # Both runs ascend, so the lesser of the two heads is the next key of the union.
    while i < na and j < nb:
        ka = keys_a[i]
        kb = keys_b[j]
        if ka < kb:
            keys[m] = ka
            hits[m] = hits_a[i]
            passes[m] = passes_a[i]
            i += 1
        elif kb < ka:
            keys[m] = kb
            hits[m] = hits_b[j]
            passes[m] = passes_b[j]
            j += 1
        else:
            keys[m] = ka
            hits[m] = hits_a[i] + hits_b[j]
            passes[m] = passes_a[i] + passes_b[j]
            # Of two counts, none of them negative, a sum that wraps is.
            if hits[m] < 0 or passes[m] < 0:
                wrapped = m
            i += 1
            j += 1
        m += 1
    # What is left of one run is beyond the whole of the other.
    while i < na:
        keys[m] = keys_a[i]
        hits[m] = hits_a[i]
        passes[m] = passes_a[i]
        i += 1
        m += 1
    while j < nb:
        keys[m] = keys_b[j]
        hits[m] = hits_b[j]
        passes[m] = passes_b[j]
        j += 1
        m += 1
    return m, wrapped


@njit(cache=True, nogil=True)
def tiles_of(keys, dim, bits, offset, cells, tiles):
    """Write the tile, along every index but the first, of each of ``keys`` into ``tiles`` (M, 2); 0 beyond the plane.

    ``cells`` (n,) is how many cells a tile is wide along each index. Returns the least and greatest of both columns.
    """
    mask = (np.int64(1) << bits) - 1
    low = np.full(2, np.iinfo(np.int64).max)
    high = np.full(2, np.iinfo(np.int64).min)
    for i in range(keys.shape[0]):
        key = keys[i]
        if dim == 2:
            tb = ((key & mask) - offset[1]) // cells[1]
            tc = np.int64(0)
        else:
            tb = (((key >> bits) & mask) - offset[1]) // cells[1]
            tc = ((key & mask) - offset[2]) // cells[2]
        tiles[i, 0] = tb
        tiles[i, 1] = tc
        low[0], high[0] = min(low[0], tb), max(high[0], tb)
        low[1], high[1] = min(low[1], tc), max(high[1], tc)
    return low, high


@njit(cache=True, nogil=True)
def sort_by_tile(number, ends, run, out):
    """Sort the rows of a run by ``number`` (M,), the tile of each, keeping the order within a tile.

    ``ends`` (T + 1,) comes as zeros and leaves as where the rows of each tile begin in ``out``, and the last one ends.
    """
    keys, hits, passes = run
    out_keys, out_hits, out_passes = out
    for i in range(number.shape[0]):
        ends[number[i] + 1] += 1
    for t in range(1, ends.shape[0]):
        ends[t] += ends[t - 1]
    at = ends[:-1].copy()
    for i in range(number.shape[0]):
        j = at[number[i]]
        at[number[i]] += 1
        out_keys[j] = keys[i]
        out_hits[j] = hits[i]
        out_passes[j] = passes[i]
