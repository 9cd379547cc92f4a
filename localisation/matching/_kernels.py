"""Numba kernels of a map's occupied cells: changing them, searching a window of poses and refining a pose on them.

For every cell there is a word of 64 bits that shows the box of 8 x 8 (in space 4 x 4 x 4) cells that begins there, a
bit a cell: occupied or not. One look-up tells what a point meets under 64 shifts at once, and adding the bits up under
all of them costs a few operations a word. A second kind of words, at every fourth (second) cell, shows whether there is
any occupied cell in each of the 64 boxes around: sums of them bound the scores of 64 blocks of shifts at once. Both lie
in tiles that are found by hashing, so that nothing depends on how large the map is or how far a scan sees.

The hash is the counter's, the quantiser the lattice's. Numba does not notice when those are edited: delete the caches
then (``make clean``).
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from hexmap.lattice._kernels import quantise_2d, quantise_3d
from hexmap.maps._counter_kernels import EMPTY, cell_key, slot

ZERO = np.uint64(0)
ONE = np.uint64(1)
# Words that are added up before a block is looked at again: a multiple of eight.
BATCH = 32
# Points that are turned and quantised together.
TOGETHER = 2048
# Which bit stands alone in a word, by the top bits of its product with a de Bruijn sequence.
_SEQUENCE = np.uint64(0x03F79D71B4CB0A89)
_BITS = np.zeros(64, np.int64)
for _bit in range(64):
    _BITS[(0x03F79D71B4CB0A89 << _bit & (2**64 - 1)) >> 58] = _bit


# Which bits of a word belong to the first few indices along an axis: in the plane and in space, axis, how many indices.
_FIRST = np.zeros((2, 3, 9), np.uint64)
for _bit in range(64):
    for _axis, _at in enumerate((_bit // 8, _bit % 8)):
        _FIRST[0, _axis, _at + 1 :] |= np.uint64(1 << _bit)
    for _axis, _at in enumerate((_bit // 16, _bit // 4 % 4, _bit % 4)):
        _FIRST[1, _axis, _at + 1 :] |= np.uint64(1 << _bit)


# With more blocks than this the blocks of a rotation are bounded first.
FEW_BLOCKS = 4


class BoxTiles(NamedTuple):
    """The words of the cells near occupied ones, in tiles.

    Attributes:
        table: (K,) int64 keys of tiles, ``EMPTY`` where there is none; K is a power of two.
        numbers: (K,) int64 which tile has that key.
        words: (T, cells) uint64.
        bits: a tile has 2^bits cells along each axis.
    """

    table: np.ndarray
    numbers: np.ndarray
    words: np.ndarray
    bits: int


class ShiftBlocks(NamedTuple):
    """The shifts of a window, 64 a block.

    Attributes:
        low: (B, n) int64 the lowest shift of each block.
        wide_low: (W, n) int64 the lowest shift of each group of blocks.
        members: (W, 64) int64 the blocks of each group, -1 where there is none.
        masks: (B,) uint64 which shifts of the block are in the window.
        costs: (B, 64) squared length of each shift, m^2; the same number for all shifts that are equally long.
    """

    low: np.ndarray
    wide_low: np.ndarray
    members: np.ndarray
    masks: np.ndarray
    costs: np.ndarray


class Turns(NamedTuple):
    """The rotations of a window.

    Attributes:
        rotations: (R, n, n) of the scan.
        costs: (R,) squared way of the farthest point, m^2, from the predicted rotation.
        order: (R,) the order in which they are tried: the likeliest first.
    """

    rotations: np.ndarray
    costs: np.ndarray
    order: np.ndarray


@njit(cache=True, nogil=True)
def _lowest_bit(word):
    """Return the number of the lowest bit that is set."""
    return _BITS[((word & (~word + ONE)) * _SEQUENCE) >> np.uint64(58)]


@njit(cache=True, nogil=True)
def _place(tiles, a, b, c, n):
    """Return the key of a cell's tile and where in it the cell is."""
    bits = tiles.bits
    low = (np.int64(1) << bits) - 1
    inner = ((a & low) << bits) | (b & low)
    if n == 3:
        inner = (inner << bits) | (c & low)
    return cell_key(a >> bits, b >> bits, c >> bits, n), inner


@njit(cache=True, nogil=True)
def _word(tiles, a, b, c, n):
    """Return the word of a cell; where there is no tile nothing is occupied."""
    key, inner = _place(tiles, a, b, c, n)
    at = slot(tiles.table, key)
    return tiles.words[tiles.numbers[at], inner] if tiles.table[at] == key else ZERO


@njit(cache=True, nogil=True)
def occupied(tiles, index, out):
    """Write 1 for each of the cells ``index`` (M, n) that is occupied."""
    n = index.shape[1]
    for m in range(index.shape[0]):
        out[m] = _word(tiles, index[m, 0], index[m, 1], index[m, 2] if n == 3 else np.int64(0), n) & ONE


@njit(cache=True, nogil=True)
def change(tiles, index, states, risen, begin, used):
    """Make each of the cells ``index[begin:]`` (M, n) occupied or not, as ``states`` (M,) say.

    ``risen`` (M,) receives 1 for those that were not occupied before and are now; it holds zeros.

    Returns:
        The row at which there was no room for tiles, and the number of tiles in use; the caller makes room and calls
        again.
    """
    table, numbers, words = tiles.table, tiles.numbers, tiles.words
    n = index.shape[1]
    side = np.int64(8) if n == 2 else np.int64(4)
    depth = np.int64(1) if n == 2 else side
    room = min(words.shape[0], table.shape[0] // 2)
    for m in range(begin, index.shape[0]):
        a, b = index[m, 0], index[m, 1]
        c = index[m, 2] if n == 3 else np.int64(0)
        state = np.uint64(states[m])
        if _word(tiles, a, b, c, n) & ONE == state:
            continue
        # The boxes that hold a cell begin in at most 2^n tiles. Nothing of this cell is written yet.
        if used + (1 << n) > room:
            return m, used
        risen[m] = states[m]
        for i in range(side):
            for j in range(side):
                for k in range(depth):
                    key, inner = _place(tiles, a - i, b - j, c - k, n)
                    at = slot(table, key)
                    if table[at] == EMPTY:
                        table[at] = key
                        numbers[at] = used
                        used += 1
                    bit = ONE << np.uint64((i * side + j) * depth + k)
                    word = words[numbers[at], inner]
                    words[numbers[at], inner] = (word | bit) if state == ONE else (word & ~bit)
    return index.shape[0], used


@njit(cache=True, nogil=True)
def raise_bounds(wide, index, risen, step, begin, used):
    """Set the bits of all boxes that hold one of the cells ``index[begin:]`` (M, n) that ``risen`` (M,) marks.

    The word at ``step * e`` stands for all cells from there to ``step - 1`` further along each axis; its bits are the
    boxes that begin at multiples of a box's side from any of these. No bit is ever cleared: that only loosens bounds.

    Returns:
        The row at which there was no room for tiles, and the number of tiles in use.
    """
    table, numbers, words, bits = wide.table, wide.numbers, wide.words, wide.bits
    n = index.shape[1]
    side = np.int64(8) if n == 2 else np.int64(4)
    # How many indices before a cell its farthest word stands; there is none more in the third index of the plane.
    reach = side * side + step - 2
    room = min(words.shape[0], table.shape[0] // 2)
    most = ((reach // step >> bits) + 2) ** n
    low, high = np.zeros(3, np.int64), np.zeros(3, np.int64)
    masks = np.empty((3, reach // step + 2), np.uint64)
    masks[2, 0] = ~ZERO
    for m in range(begin, index.shape[0]):
        if risen[m] == 0:
            continue
        if used + most > room:
            return m, used
        for a in range(n):
            low[a] = -((reach - index[m, a]) // step)
            high[a] = index[m, a] // step
            for e in range(low[a], high[a] + 1):
                # Boxes of side + step - 1 indices, one at each multiple of the side: this cell is in one or two.
                d = index[m, a] - e * step
                first = max(np.int64(0), -((side + step - 2 - d) // side))
                masks[a, e - low[a]] = _FIRST[n - 2, a, min(d // side, side - 1) + 1] & ~_FIRST[n - 2, a, first]
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                for k in range(low[2], high[2] + 1):
                    mask = masks[0, i - low[0]] & masks[1, j - low[1]] & masks[2, k - low[2]]
                    key, inner = _place(wide, i, j, k, n)
                    at = slot(table, key)
                    if table[at] == EMPTY:
                        table[at] = key
                        numbers[at] = used
                        used += 1
                    words[numbers[at], inner] |= mask
    return index.shape[0], used


@njit(cache=True, nogil=True)
def occupied_cells(tiles, corners, used, out):
    """Write all occupied cells (M, n), where ``out`` has room for them; returns how many there are.

    ``corners`` (T, n) are the coordinates of each tile.
    """
    n = corners.shape[1]
    mask = (np.int64(1) << tiles.bits) - 1
    m = 0
    for t in range(used):
        for i in range(tiles.words.shape[1]):
            if tiles.words[t, i] & ONE != ZERO:
                if m < out.shape[0]:
                    for a in range(n):
                        out[m, a] = (corners[t, a] << tiles.bits) + ((i >> (tiles.bits * (n - 1 - a))) & mask)
                m += 1
    return m


@njit(cache=True, nogil=True)
def _turned_cells(points, turns, begin, end, t, q, turned, index):
    """Write the cells of the points under some of the rotations; returns how many are out of range."""
    count, n = points.shape
    # In the order of numpy's columns, so that a cell is the one that Lattice.quantise gives.
    for o in range(begin, end):
        R = turns.rotations[turns.order[o]]
        base = (o - begin) * count
        for i in range(n):
            # Numbers of their own, which stay in registers.
            a, b, c = R[i, 0], R[i, 1], t[i]
            for p in range(count):
                turned[base + p, i] = a * points[p, 0] + b * points[p, 1] + c
            if n == 3:
                d = R[i, 2]
                for p in range(count):
                    turned[base + p, i] = a * points[p, 0] + b * points[p, 1] + d * points[p, 2] + c
    x, out = turned[: (end - begin) * count], index[: (end - begin) * count]
    if n == 2:
        return quantise_2d(x, q.inverse, q.gram2, q.constants, q.extra, q.extra_constants, q.to_public, q.limit, out)
    return quantise_3d(x, q.inverse, q.gram2, q.constants, q.extra, q.extra_constants, q.to_public, q.limit, out)


@njit(cache=True, nogil=True)
def _distinct(index, keys, stamps, stamp, cells):
    """Write each cell of ``index`` once; returns how many.

    ``keys`` and ``stamps`` are a hash set, empty of ``stamp``.
    """
    n = index.shape[1]
    mask = np.uint64(keys.shape[0] - 1)
    m = 0
    last = EMPTY
    for p in range(index.shape[0]):
        a, b = np.int64(index[p, 0]), np.int64(index[p, 1])
        c = np.int64(index[p, 2]) if n == 3 else np.int64(0)
        key = cell_key(a, b, c, n)
        # Neighbouring beams often end in one cell.
        if key == last:
            continue
        last = key
        at = ((np.uint64(key) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(20)) & mask
        while stamps[at] == stamp and keys[at] != key:
            at = (at + ONE) & mask
        if stamps[at] != stamp:
            stamps[at] = stamp
            keys[at] = key
            cells[m, 0], cells[m, 1] = a, b
            if n == 3:
                cells[m, 2] = c
            m += 1
    return m


@njit(cache=True, nogil=True)
def _gather(tiles, cells, begin, end, shift, log_step, batch):
    """Write the words of the cells ``begin`` to ``end``, moved by ``shift``, and zeros up to a multiple of eight.

    There is a word at every ``1 << log_step``-th cell.
    """
    table, numbers, words, bits = tiles.table, tiles.numbers, tiles.words, tiles.bits
    n = shift.shape[0]
    low = (np.int64(1) << bits) - 1
    last_key = EMPTY
    base = np.int64(-1)
    c = np.int64(0)
    for m in range(begin, end):
        a, b = (cells[m, 0] + shift[0]) >> log_step, (cells[m, 1] + shift[1]) >> log_step
        inner = ((a & low) << bits) | (b & low)
        if n == 3:
            c = (cells[m, 2] + shift[2]) >> log_step
            inner = (inner << bits) | (c & low)
        key = cell_key(a >> bits, b >> bits, c >> bits, n)
        # Walls stay in a tile for several cells: most cells need no look-up.
        if key != last_key:
            at = slot(table, key)
            base = numbers[at] if table[at] == key else np.int64(-1)
            last_key = key
        batch[m - begin] = words[base, inner] if base >= 0 else ZERO
    for m in range(end - begin, -(-(end - begin) // 8) * 8):
        batch[m] = ZERO


@njit(cache=True, nogil=True)
def _add_three(a, b, c):
    """Return the carries and the sums of three words, bit by bit: a full adder."""
    u = a ^ b
    return (a & b) | (u & c), u ^ c


@njit(cache=True, nogil=True)
def _add_batch(batch, count, planes):
    """Add ``count`` words to 64 sums at once; ``planes[k]`` holds bit k of each sum (Harley and Seal's counter)."""
    ones, twos, fours = planes[0], planes[1], planes[2]
    for m in range(0, count, 8):
        twos_a, ones = _add_three(ones, batch[m], batch[m + 1])
        twos_b, ones = _add_three(ones, batch[m + 2], batch[m + 3])
        fours_a, twos = _add_three(twos, twos_a, twos_b)
        twos_a, ones = _add_three(ones, batch[m + 4], batch[m + 5])
        twos_b, ones = _add_three(ones, batch[m + 6], batch[m + 7])
        fours_b, twos = _add_three(twos, twos_a, twos_b)
        carry, fours = _add_three(fours, fours_a, fours_b)
        k = 3
        while carry != ZERO:
            rest = planes[k] & carry
            planes[k] ^= carry
            carry = rest
            k += 1
    planes[0], planes[1], planes[2] = ones, twos, fours


@njit(cache=True, nogil=True)
def _largest(planes, mask):
    """Return the largest of the sums that ``mask`` leaves, and which of them are that large."""
    value = np.int64(0)
    for k in range(planes.shape[0] - 1, -1, -1):
        # Those with this bit beat those without, whatever the lower bits are.
        with_bit = planes[k] & mask
        if with_bit != ZERO:
            mask = with_bit
            value |= np.int64(1) << k
    return value, mask


@njit(cache=True, nogil=True)
def _lower(rotation, shift, best, n):
    """Tell whether a rotation and a shift come before those in ``best``."""
    if rotation != best[0]:
        return rotation < best[0]
    for a in range(n):
        if shift[a] != best[1 + a]:
            return shift[a] < best[1 + a]
    return False


@njit(cache=True, nogil=True)
def _add_up(tiles, cells, distinct, shift, log_step, mask, top, planes, batch):
    """Add up the words of all cells, moved by ``shift``; returns the largest sum under ``mask``, and which these are.

    Returns 0 as soon as the cells that are left cannot make it ``top`` any more.
    """
    planes[:] = ZERO
    value, equal = np.int64(0), ZERO
    done = 0
    while done < distinct:
        end = min(done + BATCH, distinct)
        _gather(tiles, cells, done, end, shift, log_step, batch)
        _add_batch(batch, -(-(end - done) // 8) * 8, planes)
        done = end
        value, equal = _largest(planes, mask)
        if value + distinct - done < top:
            return np.int64(0), ZERO
    return value, equal


@njit(cache=True, nogil=True)
def _sum_of(planes, lane):
    """Return one of 64 sums."""
    value = np.int64(0)
    for k in range(planes.shape[0]):
        value |= np.int64((planes[k] >> np.uint64(lane)) & ONE) << k
    return value


@njit(cache=True, nogil=True)
def _take_best(r, blocks, block, value, equal, cost, distinct, best, best_cost):
    """Take the best of the shifts ``equal`` of a block, which all score ``value``, if it is the best so far.

    Of equal scores the nearest to the prediction comes first, then the lowest. Returns the cost of the best.
    """
    n = blocks.low.shape[1]
    side = np.int64(8) if n == 2 else np.int64(4)
    depth = np.int64(1) if n == 2 else side
    shift = np.empty(n, np.int64)
    while equal != ZERO:
        lane = _lowest_bit(equal)
        equal &= equal - ONE
        total = cost + blocks.costs[block, lane]
        if value == best[4] and total > best_cost:
            continue
        shift[0] = blocks.low[block, 0] + lane // (side * depth)
        shift[1] = blocks.low[block, 1] + lane // depth % side
        if n == 3:
            shift[2] = blocks.low[block, 2] + lane % depth
        if value > best[4] or total < best_cost or _lower(r, shift, best, n):
            best_cost = total
            best[0], best[4], best[5] = r, value, distinct
            for a in range(n):
                best[1 + a] = shift[a]
    return best_cost


@njit(cache=True, nogil=True)
def search(tiles, wide, log_step, points, translation, turns, blocks, quantiser, above, best):
    """Find the best rotation and shift of a window; returns how many blocks of shifts were looked at.

    With 64 shifts at a time the usual window (0.5 m, three blocks a rotation) is searched exhaustively: bounds cost
    more than they save there. In wider windows each rotation's blocks are bounded first, 64 at a time, and those that
    cannot hold the best are left out. Measured on Intel, ms a scan, exhaustive against bounds: 0.42 and 0.45 in 0.5 m
    and 20 degrees, 1.2 and 0.8 in 1 m and 40, 6.6 and 1.9 in 2 m and 80. A block is given up as soon as the cells
    that are left cannot make it as good as the best so far.

    Args:
        tiles: the occupied cells.
        wide: the bounds.
        log_step: they stand at every ``1 << log_step``-th cell.
        points: (P, n) the scan in its own frame, metres.
        translation: (n,) of the prediction.
        turns: the rotations.
        blocks: the shifts.
        quantiser: of the lattice.
        above: only scores above this count.
        best: (6,) receives rotation, shift (3 numbers), score (0: there is none) and the number of distinct cells;
            where a point was out of range, -1 as score.
    """
    count, n = points.shape
    # Some rotations at a time: the quantiser takes blocks of points.
    together = max(1, TOGETHER // count)
    turned = np.empty((together * count, n))
    index = np.empty((together * count, n), np.int32)
    cells = np.empty((count, n), np.int64)
    room = 16
    while room < 2 * count:
        room *= 2
    keys = np.empty(room, np.int64)
    stamps = np.full(room, -1, np.int64)
    bits = 4
    while (np.int64(1) << bits) <= count:
        bits += 1
    planes = np.empty(bits, np.uint64)
    bounds = np.empty(bits, np.uint64)
    batch = np.empty(BATCH, np.uint64)
    bounded = blocks.low.shape[0] > FEW_BLOCKS
    # What a pose must score at least, to be the best or as good.
    floor = np.int64(above + 1)
    best_cost = np.inf
    best[4] = 0
    taken = 0
    for o in range(turns.order.shape[0]):
        r = turns.order[o]
        if o % together == 0:
            end = min(o + together, turns.order.shape[0])
            if _turned_cells(points, turns, o, end, translation, quantiser, turned, index) > 0:
                best[4] = -1
                return taken
        first = (o % together) * count
        distinct = _distinct(index[first : first + count], keys, stamps, r, cells)
        for group in range(blocks.wide_low.shape[0]):
            if bounded:
                most, _ = _add_up(
                    wide, cells, distinct, blocks.wide_low[group], log_step, ~ZERO, floor, bounds, batch
                )  # fmt: skip
                if most < floor:
                    continue
            for lane in range(64):
                block = blocks.members[group, lane]
                if block < 0 or (bounded and _sum_of(bounds, lane) < floor):
                    continue
                taken += 1
                value, equal = _add_up(
                    tiles, cells, distinct, blocks.low[block], 0, blocks.masks[block], floor, planes, batch
                )  # fmt: skip
                if value >= floor:
                    best_cost = _take_best(
                        r, blocks, block, value, equal, turns.costs[r], distinct, best, best_cost
                    )  # fmt: skip
                    floor = value
    return taken


@njit(cache=True, nogil=True)
def _solve(A, b):
    """Solve A x = b, symmetric and positive, in place by Cholesky's factors; False where A is not positive."""
    n = b.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                if total <= 0.0:
                    return False
                A[i, i] = np.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= A[i, k] * b[k]
        b[i] /= A[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= A[k, i] * b[k]
        b[i] /= A[i, i]
    return True


@njit(cache=True, nogil=True)
def _turn(R, v):
    """Turn R by v, an angle in the plane or a rotation vector (Rodrigues): R becomes exp(v) R."""
    n = R.shape[0]
    E = np.eye(n)
    if n == 2:
        c, s = np.cos(v[0]), np.sin(v[0])
        E[0, 0], E[0, 1], E[1, 0], E[1, 1] = c, -s, s, c
    else:
        angle = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if angle > 1e-12:
            x, y, z = v[0] / angle, v[1] / angle, v[2] / angle
            c, s = np.cos(angle), np.sin(angle)
            d = 1.0 - c
            E[0, 0], E[0, 1], E[0, 2] = c + x * x * d, x * y * d - z * s, x * z * d + y * s
            E[1, 0], E[1, 1], E[1, 2] = y * x * d + z * s, c + y * y * d, y * z * d - x * s
            E[2, 0], E[2, 1], E[2, 2] = z * x * d - y * s, z * y * d + x * s, c + z * z * d
    turned = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(n):
                turned[i, j] += E[i, k] * R[k, j]
    R[:] = turned


class Gaussians(NamedTuple):
    """What the refinement knows of the lattice and of its Gaussians.

    Attributes:
        basis: (n, n) of the lattice.
        inverse: (n, n) of the basis.
        lanes: (64, n) centres of the cells of a box, from that of its first cell, metres.
        sigmas: (W,) widths to refine with, one after the other, metres.
        reach: (W, n) how many indices the cells that count are from the point, at most.
        farthest: in sigmas, how far they are from it.
    """

    basis: np.ndarray
    inverse: np.ndarray
    lanes: np.ndarray
    sigmas: np.ndarray
    reach: np.ndarray
    farthest: float


@njit(cache=True, nogil=True)
def _exponential(x):
    """Return exp(x), -4 <= x <= 0, to 4e-7 of it: Taylor's series at x / 16, then four squarings.

    A weight needs no more, and half of the refinement's time would go into the library's exponential.
    """
    z = x * 0.0625
    y = 1.0 + z * (1.0 + z * (0.5 + z * (1.0 / 6.0 + z * (1.0 / 24.0 + z * (1.0 / 120.0)))))
    y *= y
    y *= y
    y *= y
    return y * y


@njit(cache=True, nogil=True)
def _ends(u, reach):
    """Return the lowest and the highest index within ``reach`` of a coordinate."""
    return np.int64(np.ceil(u - reach)), np.int64(np.floor(u + reach))


@njit(cache=True, nogil=True)
def _pull_2d(tiles, field, width, x0, x1):
    """Return the sum of the Gaussians around a point of the plane, and of their pulls on it."""
    basis, inverse, reach, lanes = field.basis, field.inverse, field.reach, field.lanes
    variance = field.sigmas[width] * field.sigmas[width]
    limit = field.farthest * field.farthest * variance
    scale = -0.5 / variance
    i0, i1 = _ends(inverse[0, 0] * x0 + inverse[0, 1] * x1, reach[width, 0])
    j0, j1 = _ends(inverse[1, 0] * x0 + inverse[1, 1] * x1, reach[width, 1])
    total, pull0, pull1 = 0.0, 0.0, 0.0
    for i in range(i0, i1 + 1, 8):
        for j in range(j0, j1 + 1, 8):
            # Of the box only those cells that can be near enough.
            word = _word(tiles, i, j, 0, 2) & _FIRST[0, 0, min(i1 + 1 - i, 8)] & _FIRST[0, 1, min(j1 + 1 - j, 8)]
            # From the point to the centre of the box's first cell.
            corner0 = basis[0, 0] * i + basis[0, 1] * j - x0
            corner1 = basis[1, 0] * i + basis[1, 1] * j - x1
            while word != ZERO:
                lane = _lowest_bit(word)
                word &= word - ONE
                d0 = corner0 + lanes[lane, 0]
                d1 = corner1 + lanes[lane, 1]
                squared = d0 * d0 + d1 * d1
                if squared <= limit:
                    w = _exponential(scale * squared)
                    total += w
                    pull0 += w * d0
                    pull1 += w * d1
    return total, pull0, pull1


@njit(cache=True, nogil=True)
def _pull_3d(tiles, field, width, x0, x1, x2):
    """Return the sum of the Gaussians around a point of space, and of their pulls on it."""
    basis, inverse, reach, lanes = field.basis, field.inverse, field.reach, field.lanes
    variance = field.sigmas[width] * field.sigmas[width]
    limit = field.farthest * field.farthest * variance
    scale = -0.5 / variance
    i0, i1 = _ends(inverse[0, 0] * x0 + inverse[0, 1] * x1 + inverse[0, 2] * x2, reach[width, 0])
    j0, j1 = _ends(inverse[1, 0] * x0 + inverse[1, 1] * x1 + inverse[1, 2] * x2, reach[width, 1])
    k0, k1 = _ends(inverse[2, 0] * x0 + inverse[2, 1] * x1 + inverse[2, 2] * x2, reach[width, 2])
    total, pull0, pull1, pull2 = 0.0, 0.0, 0.0, 0.0
    for i in range(i0, i1 + 1, 4):
        for j in range(j0, j1 + 1, 4):
            for k in range(k0, k1 + 1, 4):
                word = _word(tiles, i, j, k, 3) & _FIRST[1, 0, min(i1 + 1 - i, 4)]
                word &= _FIRST[1, 1, min(j1 + 1 - j, 4)] & _FIRST[1, 2, min(k1 + 1 - k, 4)]
                corner0 = basis[0, 0] * i + basis[0, 1] * j + basis[0, 2] * k - x0
                corner1 = basis[1, 0] * i + basis[1, 1] * j + basis[1, 2] * k - x1
                corner2 = basis[2, 0] * i + basis[2, 1] * j + basis[2, 2] * k - x2
                while word != ZERO:
                    lane = _lowest_bit(word)
                    word &= word - ONE
                    d0 = corner0 + lanes[lane, 0]
                    d1 = corner1 + lanes[lane, 1]
                    d2 = corner2 + lanes[lane, 2]
                    squared = d0 * d0 + d1 * d1 + d2 * d2
                    if squared <= limit:
                        w = _exponential(scale * squared)
                        total += w
                        pull0 += w * d0
                        pull1 += w * d1
                        pull2 += w * d2
    return total, pull0, pull1, pull2


@njit(cache=True, nogil=True)
def _normal_equations_2d(tiles, field, width, points, R, t, A, g):
    """Add up what all points of a scan of the plane pull at the pose: ``A`` (3, 3), its lower half, and ``g`` (3,)."""
    a00, a01, a10, a11, t0, t1 = R[0, 0], R[0, 1], R[1, 0], R[1, 1], t[0], t[1]
    # The columns of d(point) / d(pose) are the identity and the turn about the sensor. A point weighs as much as the
    # sum of its Gaussians, by which the mean that it is drawn to would have to be divided.
    w, w0, w1, w2, g0, g1, g2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for p in range(points.shape[0]):
        r0 = a00 * points[p, 0] + a01 * points[p, 1]
        r1 = a10 * points[p, 0] + a11 * points[p, 1]
        total, pull0, pull1 = _pull_2d(tiles, field, width, r0 + t0, r1 + t1)
        w += total
        w0 -= total * r1
        w1 += total * r0
        w2 += total * (r0 * r0 + r1 * r1)
        g0 += pull0
        g1 += pull1
        g2 += r0 * pull1 - r1 * pull0
    A[0, 0], A[1, 0], A[1, 1], A[2, 0], A[2, 1], A[2, 2] = w, 0.0, w, w0, w1, w2
    g[0], g[1], g[2] = g0, g1, g2


@njit(cache=True, nogil=True)
def _normal_equations_3d(tiles, field, width, points, R, t, A, g):
    """Add up what all points of a scan in space pull at the pose: ``A`` (6, 6), its lower half, and ``g`` (6,)."""
    A[:] = 0.0
    g[:] = 0.0
    J = np.zeros((3, 6))
    J[0, 0], J[1, 1], J[2, 2] = 1.0, 1.0, 1.0
    r = np.empty(3)
    pull = np.empty(3)
    for p in range(points.shape[0]):
        for i in range(3):
            r[i] = R[i, 0] * points[p, 0] + R[i, 1] * points[p, 1] + R[i, 2] * points[p, 2]
        total, pull[0], pull[1], pull[2] = _pull_3d(tiles, field, width, r[0] + t[0], r[1] + t[1], r[2] + t[2])
        if total == 0.0:
            continue
        J[0, 4], J[0, 5] = r[2], -r[1]
        J[1, 3], J[1, 5] = -r[2], r[0]
        J[2, 3], J[2, 4] = r[1], -r[0]
        for i in range(3):
            for a in range(6):
                g[a] += J[i, a] * pull[i]
                for b in range(a + 1):
                    A[a, b] += total * J[i, a] * J[i, b]


@njit(cache=True, nogil=True)
def refine(tiles, field, points, R, t, steps, tolerance, hessian):
    """Pull the scan onto the occupied cells around it; return how many steps were taken, -1 where nothing is near.

    Expectation maximisation on a sum of Gaussians: each point is drawn to the mean of the occupied cells near it, each
    weighted by a Gaussian of its distance; the pull of all points is one Gauss-Newton step on the pose. ``R`` (n, n)
    and ``t`` (n,) are changed in place. ``hessian`` receives the last normal matrix over sigma^2.
    """
    n = points.shape[1]
    size = 3 if n == 2 else 6
    A = np.empty((size, size))
    g = np.empty(size)
    taken = 0
    for width in range(field.sigmas.shape[0]):
        variance = field.sigmas[width] * field.sigmas[width]
        for _ in range(steps):
            if n == 2:
                _normal_equations_2d(tiles, field, width, points, R, t, A, g)
            else:
                _normal_equations_3d(tiles, field, width, points, R, t, A, g)
            trace = 0.0
            for a in range(size):
                trace += A[a, a]
            if trace <= 0.0:
                return -1
            for a in range(size):
                for b in range(a + 1):
                    hessian[a, b] = A[a, b] / variance
                    hessian[b, a] = hessian[a, b]
                # A little damping keeps directions that the scan says nothing about where they are.
                A[a, a] += 1e-6 * trace
            if not _solve(A, g):
                return -1
            taken += 1
            _turn(R, g[n:])
            largest = 0.0
            for i in range(n):
                t[i] += g[i]
            for a in range(size):
                largest = max(largest, abs(g[a]))
            if largest < tolerance:
                break
    return taken
