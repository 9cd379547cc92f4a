"""Numba kernels of the maps of others: looking points up, reading lists of voxels, walking an octree.

States come as plain integers, and arrays of them flat, row-major: one compilation for the plane and for space.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

DEPTH = 16  # of an OctoMap's tree: 2^16 voxels along each axis


@njit(cache=True, nogil=True)
def look_up(points, origin, cell, cosine, sine, shape, states, outside, out):
    """Write the state of the cell that each of ``points`` (N, n) lies in; ``states`` is flat, row-major.

    Quotients are rounded to 2^-32 of a cell first, so that ties fall the same way everywhere.
    """
    n = points.shape[1]
    d = np.empty(n, np.float64)
    turned = sine != 0.0 or cosine != 1.0
    for i in range(points.shape[0]):
        # Into the grid's own axes, whose origin is the low corner of its cell 0.
        for k in range(n):
            d[k] = points[i, k] - origin[k]
        if turned:
            x, y = d[0], d[1]
            d[0] = cosine * x + sine * y
            d[1] = cosine * y - sine * x
        # Cells are counted axis by axis, the last one fastest, so that the position grows by Horner's rule.
        at = 0
        inside = True
        for k in range(n):
            q = np.floor(np.rint(d[k] / cell * 4294967296.0) * 2.3283064365386963e-10)
            # In floats, so that what is not finite is outside too.
            if not (q >= 0.0 and q < shape[k]):
                inside = False
                break
            at = at * shape[k] + np.int64(q)
        out[i] = states[at] if inside else outside


@njit(cache=True, nogil=True)
def read_voxels(text, begin, shape, value, states):
    """Set the cells that ``text`` (bytes) lists, three integers a line, to ``value``.

    Returns where the first line begins that is not three integers within ``shape``, or -1.
    """
    end = text.shape[0]
    at = begin
    limit = max(shape[0], shape[1], shape[2])
    while at < end:
        line = at
        fields = 0
        flat = 0
        # A line: numbers with blanks around them, until its end or the end of the text.
        while True:
            while at < end and (text[at] == 32 or text[at] == 9 or text[at] == 13):
                at += 1
            if at == end or text[at] == 10:
                break
            number = 0
            digits = 0
            while at < end and 48 <= text[at] <= 57:
                # Stays small: anything beyond the limit is wrong, however long.
                if number < limit:
                    number = number * 10 + np.int64(text[at]) - 48
                digits += 1
                at += 1
            if digits == 0 or fields == 3 or number >= shape[fields]:
                return line
            flat = flat * shape[fields] + number
            fields += 1
            # What follows the digits must end the number: 1.5 and 1x are none.
            if at < end and text[at] != 32 and text[at] != 9 and text[at] != 13 and text[at] != 10:
                return line
        at += 1
        # A line without any field is blank, one with some but not three is wrong.
        if fields == 3:
            states[flat] = value
        elif fields != 0:
            return line
    return -1


@njit(cache=True, nogil=True)
def walk(data, begin, low, high, counts, fill, first, shape, occupied, free, states):
    """Walk an octree in the binary form of OctoMap: two bits a child, depth first.

    Without ``fill`` it measures: ``low`` and ``high`` (3,) become the box of the known voxels' keys,
    ``high`` beyond the last, and ``counts`` (3,) the nodes, the occupied and the free voxels. With
    ``fill`` it writes the states of the dense array ``states``, flat, whose first voxel has the key ``first``.

    Returns where the tree ends, -1 where the data end before it, -2 where it is too deep.
    """
    # The stack, an entry a level: the bits of a node's eight children, how many are done, its lowest key.
    bits = np.empty(DEPTH + 1, np.uint32)
    done = np.empty(DEPTH + 1, np.int64)
    key = np.zeros((DEPTH + 1, 3), np.int64)
    end = data.shape[0]
    at = begin
    if at + 2 > end:
        return -1
    level = 0
    bits[0] = np.uint32(data[at]) | (np.uint32(data[at + 1]) << np.uint32(8))
    done[0] = 0
    at += 2
    counts[0] += 1
    while level >= 0:
        if done[level] == 8:
            level -= 1
            continue
        child = done[level]
        kind = (bits[level] >> np.uint32(2 * child)) & np.uint32(3)
        done[level] += 1
        if kind == 0:
            continue  # unknown: no voxels, and no node of its own in the file
        # The child's block of voxels: half as wide as this node's, in the corner that its number says.
        side = 1 << (DEPTH - 1 - level)
        x = key[level, 0] + (side if child & 1 else 0)
        y = key[level, 1] + (side if child & 2 else 0)
        z = key[level, 2] + (side if child & 4 else 0)
        counts[0] += 1
        if kind == 3:
            # An inner node: its own two bytes follow here, before those of the next child.
            if level + 1 == DEPTH:
                return -2
            if at + 2 > end:
                return -1
            level += 1
            bits[level] = np.uint32(data[at]) | (np.uint32(data[at + 1]) << np.uint32(8))
            done[level] = 0
            key[level, 0], key[level, 1], key[level, 2] = x, y, z
            at += 2
        elif fill:
            # A leaf stands for its whole block, however large: pruning made one of eight like it.
            value = occupied if kind == 2 else free
            for i in range(x - first[0], x - first[0] + side):
                for j in range(y - first[1], y - first[1] + side):
                    row = (i * shape[1] + j) * shape[2] + z - first[2]
                    for k in range(row, row + side):
                        states[k] = value
        else:
            low[0], low[1], low[2] = min(low[0], x), min(low[1], y), min(low[2], z)
            high[0], high[1], high[2] = max(high[0], x + side), max(high[1], y + side), max(high[2], z + side)
            counts[1 if kind == 2 else 2] += side * side * side
    return at
