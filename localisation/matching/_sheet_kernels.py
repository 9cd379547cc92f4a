"""Numba kernels that bound all blocks of shifts of a level at once, for one cell of rotations after the other.

For one point and one cell of rotations, the entries for all blocks lie side by side in a sheet, so that a point is
added to all bounds by one loop over bytes, which the compiler turns into vector instructions. Nothing stops early here:
it is the regular way through memory that makes it fast.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _places(sheet, first, kind, weights, shift, begin, end, at, heavy):
    """Write where in the sheet the entry for the first block stands, and the weight, of those of the points ``begin``
    to ``end`` that find anything in it; return how many do.
    """
    n = first.shape[1]
    step_bits = np.int64(0)
    while (1 << step_bits) < sheet.step:
        step_bits += 1
    block_bits = sheet.level
    phase_bits = block_bits - step_bits
    mask = (np.int64(1) << phase_bits) - 1
    used = np.int64(0)
    for p in range(begin, end):
        phase = np.int64(kind[p])
        place = sheet.front
        inside = True
        for a in range(n):
            # Shifts to the right round down, also below zero.
            index = np.int64(first[p, a]) + shift[a] - sheet.low[a]
            phase = (phase << phase_bits) | ((index >> step_bits) & mask)
            block = index >> block_bits
            # A row that begins farther away than it is long, or behind the map, is zero.
            inside &= block >= -sheet.margin[a] and block < sheet.blocks[a]
            place += block * sheet.strides[a]
        if inside:
            at[used] = phase * sheet.size + place
            heavy[used] = weights[p]
            used += 1
    return used


@njit(cache=True, nogil=True)
def _add_points(values, at, weights, points, start, count, sums):
    """Add the entries of so many points to ``sums[start : start + count]``, four points at a time."""
    held = sums[start : start + count]
    p = 0
    while p + 4 <= points:
        a = values[at[p] + start : at[p] + start + count]
        b = values[at[p + 1] + start : at[p + 1] + start + count]
        c = values[at[p + 2] + start : at[p + 2] + start + count]
        d = values[at[p + 3] + start : at[p + 3] + start + count]
        wa, wb, wc, wd = weights[p], weights[p + 1], weights[p + 2], weights[p + 3]
        # Sixteen bits are enough, see ``stops``; a sum read and written once takes four points along.
        for i in range(count):
            held[i] = np.uint16(
                held[i] + np.uint16(a[i]) * wa + np.uint16(b[i]) * wb + np.uint16(c[i]) * wc + np.uint16(d[i]) * wd
            )
        p += 4
    while p < points:
        a = values[at[p] + start : at[p] + start + count]
        wa = weights[p]
        for i in range(count):
            held[i] = np.uint16(held[i] + np.uint16(a[i]) * wa)
        p += 1


@njit(cache=True, nogil=True)
def add_up(sheet, first, kind, covered, weights, stops, most, shift, blocks, runs, sums, out):
    """Write the bounds of all blocks for many cells of rotations.

    Args:
        sheet: the tables of the level.
        first: (B, P, n) where the box of each point's arc begins.
        kind: (B, P) which size of box holds it.
        covered: (B,) whether one does for all points; elsewhere nothing but ``most`` is known.
        weights: (P,) uint16.
        stops: (K,) after how many points the sums are put away: before sixteen bits overflow.
        most: what all points can score.
        shift: (n,) of the first block.
        blocks: (n,) blocks along each axis.
        runs: (R, 2) start and number of the entries in a row that hold all blocks' sums.
        sums: uint16, room for them.
        out: (B, blocks) int32, receives the bounds in steps of a byte, row-major.
    """
    n = blocks.shape[0]
    values = sheet.values
    at = np.empty(first.shape[1], np.int64)
    heavy = np.empty(first.shape[1], np.uint16)
    last = blocks[n - 1]
    rows = np.int64(1)
    for a in range(n - 1):
        rows *= blocks[a]
    for b in range(first.shape[0]):
        if not covered[b]:
            out[b, :] = most
            continue
        out[b, :] = 0
        begin = np.int64(0)
        for end in stops:
            points = _places(sheet, first[b], kind[b], weights, shift, begin, end, at, heavy)
            for r in range(runs.shape[0]):
                sums[runs[r, 0] : runs[r, 0] + runs[r, 1]] = 0
                _add_points(values, at, heavy, points, runs[r, 0], runs[r, 1], sums)
            begin = end
            for row in range(rows):
                rest = row
                place = np.int64(0)
                for a in range(n - 2, -1, -1):
                    place += (rest % blocks[a]) * sheet.strides[a]
                    rest //= blocks[a]
                for i in range(last):
                    out[b, row * last + i] += np.int32(sums[place + i])


@njit(cache=True, nogil=True)
def keep_within(out, parents, parent, blocks, allowed):
    """Lower the bounds ``out`` (B, blocks) to those of the blocks twice as wide that hold them, and to 0 where no shift
    may be taken.

    ``parents`` (A, blocks / 2^n) are the bounds one level up, ``parent`` (B,) the row of each cell of rotations there,
    ``blocks`` (n,) the blocks along each axis, ``allowed`` (blocks,) where shifts may be taken.
    """
    n = blocks.shape[0]
    above = np.empty(allowed.shape[0], np.int64)
    for block in range(allowed.shape[0]):
        rest = block
        above[block] = 0
        stride = np.int64(1)
        for a in range(n - 1, -1, -1):
            above[block] += ((rest % blocks[a]) >> 1) * stride
            stride *= blocks[a] >> 1
            rest //= blocks[a]
    for b in range(out.shape[0]):
        row = parents[parent[b]]
        for block in range(allowed.shape[0]):
            out[b, block] = min(out[b, block], row[above[block]]) if allowed[block] else 0


@njit(cache=True, nogil=True)
def count_bounds(rows, counts):
    """Count how often each bound occurs in ``rows`` (B, blocks) into ``counts``, from 0 on."""
    for b in range(rows.shape[0]):
        for block in range(rows.shape[1]):
            counts[rows[b, block]] += 1


@njit(cache=True, nogil=True)
def passing(rows, least):
    """Return row, block and bound of all bounds that are more than ``least``, in their order."""
    count = np.int64(0)
    for b in range(rows.shape[0]):
        for block in range(rows.shape[1]):
            count += rows[b, block] > least
    row = np.empty(count, np.int64)
    at = np.empty(count, np.int64)
    bound = np.empty(count, np.int64)
    k = np.int64(0)
    for b in range(rows.shape[0]):
        for block in range(rows.shape[1]):
            if rows[b, block] > least:
                row[k] = b
                at[k] = block
                bound[k] = rows[b, block]
                k += 1
    return row, at, bound
