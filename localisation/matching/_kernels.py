"""Numba kernels of the correlative scan matcher, for any lattice in the plane or in space.

The occupied cells around the robot are a dense window in lattice coordinates, where a lattice
vector is a constant flat offset. A node of the search is a block of 2^j shifts along every basis
axis; its bound is the sum, over the scan's cells, of the largest occupancy in the block above the
cell: a sliding maximum of the *finest* level, because coarser levels that are quantised anew
bound nothing. A bound is never less than the score of a shift in its block, so nothing is lost.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def sliding_maximum(grid, strides, shape, half, out):
    """Write max(grid[x + d]) over d in {0, half}^n into ``out``; beyond the window there is nothing."""
    n = shape.shape[0]
    if n == 2:
        s0 = strides[0]
        for i in range(shape[0]):
            more0 = i + half < shape[0]
            for j in range(shape[1]):
                at = i * s0 + j
                m = grid[at]
                more1 = j + half < shape[1]
                if more1:
                    m = max(m, grid[at + half])
                if more0:
                    m = max(m, grid[at + half * s0])
                    if more1:
                        m = max(m, grid[at + half * s0 + half])
                out[at] = m
    else:
        s0 = strides[0]
        s1 = strides[1]
        for i in range(shape[0]):
            e0 = half * s0 if i + half < shape[0] else 0
            for j in range(shape[1]):
                e1 = half * s1 if j + half < shape[1] else 0
                for k in range(shape[2]):
                    e2 = half if k + half < shape[2] else 0
                    at = i * s0 + j * s1 + k
                    m = max(max(grid[at], grid[at + e2]), max(grid[at + e1], grid[at + e1 + e2]))
                    at += e0
                    m = max(m, max(max(grid[at], grid[at + e2]), max(grid[at + e1], grid[at + e1 + e2])))
                    out[at - e0] = m


@njit(cache=True, nogil=True)
def distinct_cells(index, points, low, strides, stamp, flat, ends):
    """Write each rotation's distinct cells as flat offsets into the window; ``stamp`` must be -1 all over."""
    n = index.shape[1]
    m = 0
    for r in range(ends.shape[0]):
        for p in range(points):
            at = np.int64(0)
            for k in range(n):
                at += (np.int64(index[r * points + p, k]) - low[k]) * strides[k]
            if stamp[at] != r:
                stamp[at] = r
                flat[m] = at
                m += 1
        ends[r] = m
    return m


@njit(cache=True, nogil=True)
def _bound(grid, flat, begin, end, shift):
    total = np.int64(0)
    for i in range(begin, end):
        total += grid[flat[i] + shift]
    return total


@njit(cache=True, nogil=True)
def search(grids, flat, ends, strides, low, blocks, top, basis, radius2, turn_cost, order_out, best_out):
    """Branch and bound over all rotations and all shifts in the ball.

    ``grids`` (top + 1, window) are the occupancy and its sliding maxima; ``blocks`` (n,) the
    number of top blocks along each axis, the first beginning at the shift ``low`` (n,);
    ``turn_cost`` (R,) what a rotation adds to the squared distance that settles equal scores.
    ``order_out`` has room for R * prod(blocks) bounds. ``best_out`` receives rotation, shift
    (3 numbers) and score; returns how many nodes were scored.
    """
    n = basis.shape[0]
    rotations = ends.shape[0]
    per = np.int64(1)
    for k in range(n):
        per *= blocks[k]
    size = np.int64(1) << top
    scored = rotations * per
    for r in range(rotations):
        begin = ends[r - 1] if r > 0 else 0
        for b in range(per):
            rest = b
            shift = np.int64(0)
            for k in range(n - 1, -1, -1):
                shift += (low[k] + (rest % blocks[k]) * size) * strides[k]
                rest //= blocks[k]
            order_out[r * per + b] = _bound(grids[top], flat, begin, ends[r], shift)
    order = np.argsort(-order_out[: rotations * per], kind="mergesort")
    best = np.int64(-1)
    best_cost = np.inf
    depth = (top + 1) * (1 << n) + 2
    stack_level = np.empty(depth, dtype=np.int64)
    stack_bound = np.empty(depth, dtype=np.int64)
    stack_shift = np.empty((depth, n), dtype=np.int64)
    children = 1 << n
    child_bound = np.empty(children, dtype=np.int64)
    child_shift = np.empty((children, n), dtype=np.int64)
    for o in range(order.shape[0]):
        node = order[o]
        if order_out[node] < best:
            break
        r = node // per
        begin = ends[r - 1] if r > 0 else 0
        end = ends[r]
        rest = node % per
        for k in range(n - 1, -1, -1):
            stack_shift[0, k] = low[k] + (rest % blocks[k]) * size
            rest //= blocks[k]
        stack_level[0] = top
        stack_bound[0] = order_out[node]
        used = 1
        while used > 0:
            used -= 1
            bound = stack_bound[used]
            if bound < best:
                continue
            level = stack_level[used]
            if level == 0:
                cost = turn_cost[r]
                length = 0.0
                for i in range(n):
                    x = 0.0
                    for k in range(n):
                        x += basis[i, k] * stack_shift[used, k]
                    length += x * x
                if length > radius2:
                    continue
                cost += length
                if bound > best or cost < best_cost:
                    best = bound
                    best_cost = cost
                    best_out[0] = r
                    for k in range(n):
                        best_out[1 + k] = stack_shift[used, k]
                    best_out[4] = best
                continue
            half = np.int64(1) << (level - 1)
            for c in range(children):
                shift = np.int64(0)
                for k in range(n):
                    s = stack_shift[used, k] + (half if (c >> k) & 1 else 0)
                    child_shift[c, k] = s
                    shift += s * strides[k]
                child_bound[c] = _bound(grids[level - 1], flat, begin, end, shift)
            scored += children
            # the best child on top of the stack: insertion sort, ascending, ties in the order they came
            first = used
            for c in range(children):
                if child_bound[c] < best:
                    continue
                at = used
                while at > first and stack_bound[at - 1] > child_bound[c]:
                    stack_bound[at] = stack_bound[at - 1]
                    stack_level[at] = stack_level[at - 1]
                    for k in range(n):
                        stack_shift[at, k] = stack_shift[at - 1, k]
                    at -= 1
                stack_bound[at] = child_bound[c]
                stack_level[at] = level - 1
                for k in range(n):
                    stack_shift[at, k] = child_shift[c, k]
                used += 1
    return scored


@njit(cache=True, nogil=True)
def refine_terms(
    points, pivot, cells, occupied, low, strides, shape, offsets, centres, basis, sigma2, hessian, gradient
):
    """Accumulate the normal equations that pull ``points`` (P, n) onto the occupied cells around them.

    Each point meets the cells ``offsets`` (K, n) around its own cell, each occupied one a Gaussian
    of variance ``sigma2``; the pull is towards the weighted mean of their centres, with the
    weight of the point the sum of the Gaussians (an expectation-maximisation step). Returns the
    sum of the Gaussians, which is the smooth score.
    """
    n = points.shape[1]
    score = 0.0
    size = hessian.shape[0]
    mean = np.empty(n)
    centre = np.empty(n)
    jacobian = np.zeros((n, size))
    hessian[:] = 0.0
    gradient[:] = 0.0
    for p in range(points.shape[0]):
        for i in range(n):
            x = 0.0
            for k in range(n):
                x += basis[i, k] * cells[p, k]
            centre[i] = x
            mean[i] = 0.0
        total = 0.0
        for o in range(offsets.shape[0]):
            at = np.int64(0)
            inside = True
            for k in range(n):
                c = np.int64(cells[p, k]) + offsets[o, k] - low[k]
                if c < 0 or c >= shape[k]:
                    inside = False
                at += c * strides[k]
            if not inside or not occupied[at]:
                continue
            d2 = 0.0
            for i in range(n):
                d = points[p, i] - centre[i] - centres[o, i]
                d2 += d * d
            w = np.exp(-0.5 * d2 / sigma2)
            total += w
            for i in range(n):
                mean[i] += w * (centre[i] + centres[o, i])
        if total < 1e-12:
            continue
        score += total
        # rows of d(point)/d(pose): the identity, then the turn about the pivot
        for i in range(n):
            jacobian[i, i] = 1.0
        if n == 2:
            jacobian[0, 2] = pivot[1] - points[p, 1]
            jacobian[1, 2] = points[p, 0] - pivot[0]
        else:
            jacobian[0, 4] = points[p, 2] - pivot[2]
            jacobian[0, 5] = pivot[1] - points[p, 1]
            jacobian[1, 3] = pivot[2] - points[p, 2]
            jacobian[1, 5] = points[p, 0] - pivot[0]
            jacobian[2, 3] = points[p, 1] - pivot[1]
            jacobian[2, 4] = pivot[0] - points[p, 0]
        for i in range(n):
            residual = mean[i] / total - points[p, i]
            for a in range(size):
                gradient[a] += total * jacobian[i, a] * residual
                for b in range(size):
                    hessian[a, b] += total * jacobian[i, a] * jacobian[i, b]
    return score
