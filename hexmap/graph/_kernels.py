"""Numba kernels of the graph layer: moves over a padded flat window, without bounds checks.

All take the window as plain arrays: ``free`` (size,) uint8, the flat ``offsets`` (K,) of the moves
and, one move after the other, the flat offsets ``swept`` of the cells that it sweeps. The padding
around the window is blocked, and wide enough that no offset from a free cell leaves the array.
What belongs together comes as a tuple with names: the ``layout`` of the cells in memory
(:class:`hexmap.graph.window.Layout`), the ``shape`` of a body and the ``tree`` over many of them
(:class:`hexmap.graph.bodies.BodyShape`, :class:`hexmap.graph.bodies.BodyTree`). Helpers that run for
every body are inlined: as calls they cost a twentieth of the search.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _is_open(free, at, k, offsets, swept_starts, swept):
    """Tell whether move ``k`` from the free cell ``at`` is allowed."""
    # The end first: it is the cell that is most often blocked, and many moves sweep no other.
    if free[at + offsets[k]] == 0:
        return False
    for s in range(swept_starts[k], swept_starts[k + 1]):  # noqa: SIM110 (a generator does not compile)
        if free[at + swept[s]] == 0:
            return False
    return True


@njit(cache=True, nogil=True)
def open_moves(free, at, offsets, swept_starts, swept, out):
    """Write which moves (K,) are allowed from the free cell ``at``."""
    for k in range(offsets.shape[0]):
        out[k] = _is_open(free, at, k, offsets, swept_starts, swept)


@njit(cache=True, nogil=True)
def count_edges(free, nodes, offsets, swept_starts, swept, starts):
    """Write into ``starts`` (M + 1,) where the edges of each of the ``nodes`` (M,) begin."""
    # Counted before they are filled in, because a list that grows would hold the edges twice.
    total = 0
    for i in range(nodes.shape[0]):
        starts[i] = total
        for k in range(offsets.shape[0]):
            if _is_open(free, nodes[i], k, offsets, swept_starts, swept):
                total += 1
    starts[nodes.shape[0]] = total


@njit(cache=True, nogil=True)
def fill_edges(free, nodes, offsets, swept_starts, swept, lengths, terrain, number, columns, costs):
    """Write the edges of all nodes in their order: the other end's number and the cost.

    ``number`` (size,) is the number of each free cell; ``terrain`` is empty where there is none.
    """
    w = 0
    for i in range(nodes.shape[0]):
        a = nodes[i]
        for k in range(offsets.shape[0]):
            if _is_open(free, a, k, offsets, swept_starts, swept):
                b = a + offsets[k]
                columns[w] = number[b]
                # The mean of the two ends: a move costs the same in either direction.
                costs[w] = lengths[k]
                if terrain.shape[0] > 0:
                    costs[w] = lengths[k] * (terrain[a] + terrain[b]) / 2.0
                w += 1


@njit(cache=True, nogil=True)
def _root(parent, i):
    """Return the root of ``i``, halving the path on the way; parents are never above their children."""
    # Halving keeps the paths short without a second walk, which compressing them fully would take.
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def label(free, backward, swept_starts, swept, out):
    """Write the component (size,) of each free cell, -1 for blocked ones; returns how many there are.

    Union-find in one pass: ``backward`` are the moves with negative flat offsets, which reach every
    edge once, because each move's opposite is a move as well. Roots are the lowest cells of their
    trees, so that a second pass in ascending order turns parents into labels in place.
    """
    # Forest: ``out`` holds parents. All cells below ``i`` are in it, so that a backward move finds its end there.
    for i in range(free.shape[0]):
        if free[i] == 0:
            out[i] = -1
            continue
        out[i] = i
        for k in range(backward.shape[0]):
            if _is_open(free, i, k, backward, swept_starts, swept):
                a = _root(out, i)
                b = _root(out, i + backward[k])
                # The lower root stays one, which the second pass relies on; the price is no union by rank.
                if a < b:
                    out[b] = a
                elif b < a:
                    out[a] = b
    # Labels: a parent is below its child and so has its label already when the child's turn comes.
    count = 0
    for i in range(free.shape[0]):
        if out[i] == i:
            out[i] = count
            count += 1
        elif out[i] >= 0:
            out[i] = out[out[i]]
    return count


@njit(cache=True, nogil=True)
def cells_in_box(begin, end, layout, basis, low, high, flat, points):
    """Write those of the inner cells ``begin`` to ``end`` whose centre lies in the box; returns how many.

    Inner cells are counted row by row without the padding. ``low`` and ``high`` (n,) are in metres;
    positions go to ``flat`` (N,) and centres to ``points`` (N, n).
    """
    first, inner, pad, strides = layout.first, layout.inner, layout.pad, layout.strides
    n = first.shape[0]
    last = n - 1
    at = np.empty(n, np.int64)
    before = np.empty(n, np.float64)
    centre = np.empty(n, np.float64)
    w = 0
    c = begin
    while c < end:
        # A row, or the part of it that is asked for: its place inside the padding, from the number of its first cell.
        rest = c
        for i in range(last, -1, -1):
            at[i] = rest % inner[i]
            rest //= inner[i]
        here = 0
        for i in range(n):
            here += (at[i] + pad[i]) * strides[i]
            # A centre without what the last index adds, in the order of ``Lattice.centres``: the same bits.
            before[i] = basis[i, 0] * (at[0] + first[0])
            for j in range(1, last):
                before[i] += basis[i, j] * (at[j] + first[j])
        row = min(inner[last] - at[last], end - c)
        for k in range(row):
            number = at[last] + k + first[last]
            inside = True
            for i in range(n):
                x = before[i] + basis[i, last] * number
                centre[i] = x
                inside &= (x >= low[i]) & (x <= high[i])
            if inside:
                for i in range(n):
                    points[w, i] = centre[i]
                flat[w] = here + k
                w += 1
        c += row
    return w


@njit(cache=True, nogil=True)
def mark_surface(solid, faces, layout, out):
    """Mark in ``out`` (size,) the solid cells that share a face with one that is not solid.

    No other solid cell can be the nearest one to a cell that is not solid: from inside a solid,
    some neighbour across a face is always nearer.
    """
    inner, pad, strides = layout.inner, layout.pad, layout.strides
    n = inner.shape[0]
    rows = 1
    for i in range(n - 1):
        rows *= inner[i]
    for r in range(rows):
        # Where the row begins: along the last index cells follow one another in memory.
        rest = r
        base = pad[n - 1]
        for i in range(n - 2, -1, -1):
            base += (rest % inner[i] + pad[i]) * strides[i]
            rest //= inner[i]
        for here in range(base, base + inner[n - 1]):
            # From both sides, because the padding has no turn of its own: the cells inside find its solid ones.
            if solid[here] == 0:
                for k in range(faces.shape[0]):
                    if solid[here + faces[k]] != 0:
                        out[here + faces[k]] = 1
            else:
                for k in range(faces.shape[0]):
                    if solid[here + faces[k]] == 0:
                        out[here] = 1
                        break


@njit(cache=True, nogil=True)
def block_around(cells, ball, layout, free):
    """Block all cells of the window that are one of the offsets ``ball`` (B, n) away from one of ``cells`` (M, n)."""
    first, inner, pad, strides = layout.first, layout.inner, layout.pad, layout.strides
    n = first.shape[0]
    for c in range(cells.shape[0]):
        for b in range(ball.shape[0]):
            # Obstacles may lie outside the window, and a ball may reach out of it: every cell is checked.
            here = 0
            inside = True
            for i in range(n):
                x = cells[c, i] + ball[b, i] - first[i]
                if x < 0 or x >= inner[i]:
                    inside = False
                    break
                here += (x + pad[i]) * strides[i]
            if inside:
                free[here] = 0


@njit(cache=True, nogil=True, inline="always")
def _to_centred_box(v, frame, half, grain):
    """Return the distance of the point ``v`` (n,) to a box around the origin, 0 inside and on its border."""
    n = v.shape[0]
    total = 0.0
    for i in range(n):
        s = 0.0
        for j in range(n):
            s += frame[i, j] * v[j]
        s = abs(s) - half[i]
        if s > grain:
            total += s * s
    return np.sqrt(total)


@njit(cache=True, nogil=True, inline="always")
def _to_edges(v, edges):
    """Return the distance of the point ``v`` (n,) to the nearest of ``edges`` (E, 2, n)."""
    n = v.shape[0]
    best = np.inf
    for e in range(edges.shape[0]):
        # The nearest point of the edge's line, as a fraction of the edge, and no farther than its ends.
        along = 0.0
        length = 0.0
        for j in range(n):
            d = edges[e, 1, j] - edges[e, 0, j]
            along += d * (v[j] - edges[e, 0, j])
            length += d * d
        t = min(max(along / length, 0.0), 1.0)
        total = 0.0
        for j in range(n):
            d = v[j] - edges[e, 0, j] - t * (edges[e, 1, j] - edges[e, 0, j])
            total += d * d
        best = min(best, total)
    return np.sqrt(best)


@njit(cache=True, nogil=True)
def _to_body(v, frame, half, grain, normals, heights, edges):
    """Return the distance of the point ``v`` (n,) to a convex body around the origin, 0 inside.

    The parameters are those of :class:`hexmap.graph.bodies.BodyShape`, one by one: handing the tuple on
    for every body costs a sixth of the whole search.
    """
    if half.shape[0] > 0:
        return _to_centred_box(v, frame, half, grain)
    # The nearest point of a polytope is the foot of the perpendicular on a face, if that foot is in it, or on an edge.
    n = v.shape[0]
    outside = False
    for f in range(heights.shape[0]):
        s = -heights[f]
        for j in range(n):
            s += normals[f, j] * v[j]
        if s > 0.0:
            outside = True
            foot = True
            for g in range(heights.shape[0]):
                t = -heights[g]
                for j in range(n):
                    t += normals[g, j] * (v[j] - s * normals[f, j])
                if g != f and t > 0.0:
                    foot = False
                    break
            if foot:
                return s
    return _to_edges(v, edges) if outside else 0.0


@njit(cache=True, nogil=True)
def to_body(points, shape, out):
    """Write the distance (N,) of each of ``points`` (N, n) to the body ``shape`` around the origin."""
    for i in range(points.shape[0]):
        out[i] = _to_body(points[i], shape.frame, shape.half, shape.grain, shape.normals, shape.heights, shape.edges)


@njit(cache=True, nogil=True)
def _to_box(x, boxes, node):
    """Return the squared distance of ``x`` (n,) to the box of a node, infinite where the node is empty."""
    total = 0.0
    for i in range(x.shape[0]):
        d = max(boxes[node, 0, i] - x[i], x[i] - boxes[node, 1, i])
        if d > 0.0:
            total += d * d
    return total


@njit(cache=True, nogil=True)
def nearest_body(points, tree, shape, limit, enough, out):
    """Write the distance (N,) of each of ``points`` (N, n) to the nearest of equal bodies; inf from ``limit`` on.

    The bodies have the ``shape`` and lie around the centres of the ``tree``. A distance below
    ``enough`` need only be known to be that.
    """
    n = points.shape[1]
    centres, boxes, covering, inradius, leaf = tree.centres, tree.boxes, tree.covering, tree.inradius, tree.leaf
    frame, half, grain = shape.frame, shape.half, shape.grain
    normals, heights, edges = shape.normals, shape.heights, shape.edges
    first_leaf = boxes.shape[0] // 2
    # Nodes yet to be visited and how far away they are: one a level, so 128 are more than any tree has.
    stack = np.empty(128, np.int64)
    away = np.empty(128, np.float64)
    v = np.empty(n, np.float64)
    last = -1
    for q in range(points.shape[0]):
        x = points[q]
        best = limit
        if last >= 0:
            # Neighbouring points come one after the other: the last one's body is a good bound.
            for i in range(n):
                v[i] = x[i] - centres[last, i]
            best = min(best, _to_body(v, frame, half, grain, normals, heights, edges))
        # Only centres nearer than this, squared, can have a nearer body.
        reach = (best + covering) * (best + covering)
        stack[0] = 1
        away[0] = _to_box(x, boxes, 1)
        top = 1
        while top > 0 and best >= enough and best > 0.0:
            top -= 1
            # The bound may have fallen since the node was pushed.
            if away[top] >= reach:
                continue
            node = stack[top]
            if node < first_leaf:
                # The nearer child goes on top: what is found there rules out most of the farther one.
                near, far = 2 * node, 2 * node + 1
                to_near, to_far = _to_box(x, boxes, near), _to_box(x, boxes, far)
                if to_far < to_near:
                    near, far = far, near
                    to_near, to_far = to_far, to_near
                if to_far < reach:
                    stack[top] = far
                    away[top] = to_far
                    top += 1
                if to_near < reach:
                    stack[top] = near
                    away[top] = to_near
                    top += 1
                continue
            begin = (node - first_leaf) * leaf
            for c in range(begin, min(begin + leaf, centres.shape[0])):
                squared = 0.0
                for i in range(n):
                    v[i] = x[i] - centres[c, i]
                    squared += v[i] * v[i]
                if squared >= reach:
                    continue
                # The ball inside the body is a cheap upper bound, and does where the exact distance is not asked for.
                found = np.sqrt(squared) - inradius
                if found >= enough or found < 0.0:
                    found = _to_body(v, frame, half, grain, normals, heights, edges)
                if found < best:
                    best = found
                    last = c
                    reach = (best + covering) * (best + covering)
        out[q] = best if best < limit else np.inf


@njit(cache=True, nogil=True)
def block_around_boxes(centres, at, reach, bound, columns, half, grain, layout, free):
    """Block all cells of the window that are nearer than ``bound`` to one of equal boxes.

    All has three dimensions, the first one of no extent in the plane: ``centres`` (M, 3) of the boxes
    and the basis ``columns`` (3, 3) are in the boxes' own axes, ``at`` (M, 3) are the same centres as
    multiples of the basis, and ``reach`` (3,) the indices around them that may be near.
    """
    first, inner, pad, strides = layout.first, layout.inner, layout.pad, layout.strides
    low = np.empty(3, np.int64)
    high = np.empty(3, np.int64)
    ax, ay, az = columns[0, 2], columns[1, 2], columns[2, 2]
    for c in range(centres.shape[0]):
        # The indices that may be near, as far as the window has them: no cell needs a check of its own.
        for i in range(3):
            low[i] = max(np.int64(np.ceil(at[c, i] - reach[i])), first[i])
            high[i] = min(np.int64(np.floor(at[c, i] + reach[i])), first[i] + inner[i] - 1)
        for i in range(low[0], high[0] + 1):
            for j in range(low[1], high[1] + 1):
                # Along the last index a step adds a constant vector, to a centre and to its flat position.
                x = columns[0, 0] * i + columns[0, 1] * j - centres[c, 0]
                y = columns[1, 0] * i + columns[1, 1] * j - centres[c, 1]
                z = columns[2, 0] * i + columns[2, 1] * j - centres[c, 2]
                row = (i - first[0] + pad[0]) * strides[0] + (j - first[1] + pad[1]) * strides[1] + pad[2] - first[2]
                for k in range(low[2], high[2] + 1):
                    if free[row + k] == 0:
                        continue
                    # What is within the grain of a side counts as on the box, as it does when a point is looked up.
                    dx = abs(x + ax * k) - half[0]
                    dy = abs(y + ay * k) - half[1]
                    dz = abs(z + az * k) - half[2]
                    total = 0.0
                    if dx > grain:
                        total += dx * dx
                    if dy > grain:
                        total += dy * dy
                    if dz > grain:
                        total += dz * dz
                    if np.sqrt(total) < bound:
                        free[row + k] = 0
