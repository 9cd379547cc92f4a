"""Numba kernels of the voxel lists: packing, radix sort and run lengths, merging, counting.

Lists are kept sorted by a packed 64-bit key, so that union, intersection and look-up are merges
and binary searches. Points are sorted by a key relative to their own bounding box, which has far
fewer bits, by a radix sort: its time does not depend on the data and neither does its result.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

DIGIT = 12  # bits sorted a pass: 4096 counters just fill the first-level cache


@njit(cache=True, nogil=True)
def bounds(index, low, high):
    """Write the least and greatest index of each axis of ``index`` (N, n) into ``low`` and ``high``."""
    n = index.shape[1]
    for k in range(n):
        low[k] = index[0, k]
        high[k] = index[0, k]
    # A loop for each dimension, with the ends in local numbers: written to the arrays at every point they would cost
    # more than reading the points.
    if n == 2:
        l0, h0, l1, h1 = low[0], high[0], low[1], high[1]
        for i in range(index.shape[0]):
            a = np.int64(index[i, 0])
            b = np.int64(index[i, 1])
            l0, h0 = min(l0, a), max(h0, a)
            l1, h1 = min(l1, b), max(h1, b)
        low[0], high[0], low[1], high[1] = l0, h0, l1, h1
    else:
        l0, h0, l1, h1, l2, h2 = low[0], high[0], low[1], high[1], low[2], high[2]
        for i in range(index.shape[0]):
            a = np.int64(index[i, 0])
            b = np.int64(index[i, 1])
            c = np.int64(index[i, 2])
            l0, h0 = min(l0, a), max(h0, a)
            l1, h1 = min(l1, b), max(h1, b)
            l2, h2 = min(l2, c), max(h2, c)
        low[0], high[0], low[1], high[1], low[2], high[2] = l0, h0, l1, h1, l2, h2


@njit(cache=True, nogil=True)
def pack_relative(index, low, shifts, keys):
    """Pack ``index`` (N, n) minus ``low`` into ``keys`` (N,), axis k shifted left by ``shifts[k]``."""
    # Relative to the corner no field is negative, so the key's order is the index's, and few bits are in use.
    if index.shape[1] == 2:
        l0, l1, s0 = low[0], low[1], shifts[0]
        for i in range(index.shape[0]):
            keys[i] = ((np.int64(index[i, 0]) - l0) << s0) | (np.int64(index[i, 1]) - l1)
    else:
        l0, l1, l2, s0, s1 = low[0], low[1], low[2], shifts[0], shifts[1]
        for i in range(index.shape[0]):
            a = np.int64(index[i, 0]) - l0
            b = np.int64(index[i, 1]) - l1
            keys[i] = (a << s0) | (b << s1) | (np.int64(index[i, 2]) - l2)


@njit(cache=True, nogil=True)
def radix_sort(keys, scratch, bits):
    """Sort unsigned ``keys`` of at most ``bits`` bits; returns True where the result is in ``scratch``."""
    # As few passes as the bits allow, and then digits as narrow as these passes allow: smaller counters to clear.
    n = keys.shape[0]
    passes = max(1, (bits + DIGIT - 1) // DIGIT)
    width = (bits + passes - 1) // passes
    size = 1 << width
    mask = np.uint64(size - 1)
    # The digits of all passes are counted in one reading: sorting moves keys about but changes no digit.
    counts = np.zeros((passes, size), dtype=np.int64)
    for i in range(n):
        key = np.uint64(keys[i])
        for p in range(passes):
            counts[p, (key >> np.uint64(p * width)) & mask] += 1
    source = keys
    target = scratch
    swapped = False
    # From the lowest digit to the highest. Each pass keeps the order of keys of the same digit, which is why the
    # order by the lower digits survives.
    for p in range(passes):
        shift = np.uint64(p * width)
        # Counts become the position where the keys of each digit begin.
        total = 0
        for d in range(size):
            c = counts[p, d]
            counts[p, d] = total
            total += c
        row = counts[p]
        for i in range(n):
            key = source[i]
            d = (np.uint64(key) >> shift) & mask
            target[row[d]] = key
            row[d] += 1
        source, target = target, source
        swapped = not swapped
    return swapped


@njit(cache=True, nogil=True)
def count_distinct(keys):
    """Return how many distinct keys the sorted ``keys`` hold."""
    m = 1 if keys.shape[0] > 0 else 0
    for i in range(1, keys.shape[0]):
        m += keys[i] != keys[i - 1]
    return m


@njit(cache=True, nogil=True)
def run_lengths(keys, low, shifts, field, offset, unique, counts):
    """Write each distinct key of sorted relative ``keys``, packed anew for good, and how often it occurs.

    ``field`` is the width, in bits, of a field of the lasting keys and ``offset`` (n,) what is
    added to each index there.
    """
    # Repacked here, once for each distinct key, and not for each point.
    n = low.shape[0]
    m = -1
    last = np.uint64(0)
    for i in range(keys.shape[0]):
        key = np.uint64(keys[i])
        if m >= 0 and key == last:
            counts[m] += 1
            continue
        m += 1
        last = key
        rest = key  # unsigned: in the plane a key may fill all 64 bits
        packed = np.int64(0)
        for k in range(n):
            shift = np.uint64(shifts[k])
            relative = rest >> shift
            rest -= relative << shift
            packed = (packed << field) + (np.int64(relative) + low[k] + offset[k])
        unique[m] = packed
        counts[m] = 1


@njit(cache=True, nogil=True)
def merge(keys_a, counts_a, keys_b, counts_b, keys, counts):
    """Merge two sorted lists, adding the counts of equal keys; returns the length."""
    i = 0
    j = 0
    m = 0
    na = keys_a.shape[0]
    nb = keys_b.shape[0]
    # Both lists ascend, so the lesser of the two heads is the next key of the union.
    while i < na and j < nb:
        ka = keys_a[i]
        kb = keys_b[j]
        if ka < kb:
            keys[m] = ka
            counts[m] = counts_a[i]
            i += 1
        elif kb < ka:
            keys[m] = kb
            counts[m] = counts_b[j]
            j += 1
        else:
            keys[m] = ka
            counts[m] = counts_a[i] + counts_b[j]
            i += 1
            j += 1
        m += 1
    # What is left of one list is beyond the whole of the other.
    while i < na:
        keys[m] = keys_a[i]
        counts[m] = counts_a[i]
        i += 1
        m += 1
    while j < nb:
        keys[m] = keys_b[j]
        counts[m] = counts_b[j]
        j += 1
        m += 1
    return m


@njit(cache=True, nogil=True)
def count_common(keys_a, keys_b):
    """Count the keys that occur in both sorted lists."""
    # A merge that writes nothing: a search for each key would miss the cache at every step.
    i = 0
    j = 0
    m = 0
    while i < keys_a.shape[0] and j < keys_b.shape[0]:
        if keys_a[i] < keys_b[j]:
            i += 1
        elif keys_b[j] < keys_a[i]:
            j += 1
        else:
            m += 1
            i += 1
            j += 1
    return m
