"""Numba kernels of wedges: what one line of sight in the plane says of the lines beside it.

A wedge of a cell p is an interval of slopes, such that no ray from p with one of them touches a blocked cell down to
a certain layer (layers and slopes are those of :func:`planners.any_angle._kernels.walk`). The cell c, k along the
inner index in layer i, is touched by the rays whose slope s has ``abs(k - i s) <= r(s)``, where r, half the width of
the Voronoi cell's shadow, is convex: the greater of its values at the ends of an interval bounds it. A cell that p
sees hands its wedge on to its neighbours, which need to look at the layers that they add, not at the whole line:
in a corridor of any length a line of sight then costs a few looks.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

WEDGE = np.uint8(16)  # of a cell's marks: it has a wedge of its present parent
BESIDE = 4.0  # cells by which a wedge reaches to either side of the cell that it is made for
_CLEAR = 1e-12  # slopes this near to a touching one count as touching


@njit(cache=True, nogil=True, inline="always")
def _half_width(generators, slope, major, inner, touch):
    """Return half the width of the cell's shadow along ``inner``, for a slope per layer in direction of the index."""
    total = 0.0
    for e in range(generators.shape[0]):
        total += abs(generators[e, inner] - generators[e, major] * slope)
    return 0.5 * total * (1.0 + touch)


@njit(cache=True, nogil=True)
def sees_by_wedge(free, strides, shape, generators, gram, reach, touch, at, v, a, p, offsets, shifts, tree):
    """Tell whether a wedge shows that the cell ``p`` sees ``a``, and note the wedge of ``a`` then.

    Args:
        free: (size,) states.
        strides: (2,) of the window.
        shape: (2,) of the window.
        generators: (E, 2), see :class:`planners.any_angle._kernels.View`.
        gram: (2, 2) likewise.
        reach: (2,) likewise.
        touch: likewise.
        at: (2,) int64 position of ``p``.
        v: (2,) int64 displacement to ``a``, not zero.
        a: flat cell.
        p: flat cell, the parent of ``a``.
        offsets: (K,) flat offsets of the moves.
        shifts: (K, 2) int64 the moves.
        tree: (size,) of :data:`planners.any_angle._theta_kernels.TREE`.

    Returns:
        the number of cells looked at and one more; negative where ``p`` does not see ``a``, noted in ``tree`` as
            refused, or where only a look along the line tells.
    """
    major = 0 if abs(v[0]) >= abs(v[1]) else 1
    inner = 1 - major
    step = np.int64(1) if v[major] > 0 else np.int64(-1)
    depth = abs(v[major])
    slope = v[inner] / depth
    margin = np.int64(np.floor(reach[major] + 1e-6))
    # The wedge of a neighbour with the same parent and major index that reaches farthest to both sides.
    best = -1.0
    above = np.int64(0)
    lo = 0.0
    hi = 0.0
    hint = np.int64(-1)
    for m in range(offsets.shape[0]):
        c = a - offsets[m]
        if np.int64(tree[c]["refused"]) == p + 1 and tree[c]["blocker"] > 0:
            hint = np.int64(tree[c]["blocker"]) - 1
        if (tree[c]["mark"] & WEDGE) != 0 and np.int64(tree[c]["parent"]) == p:
            layer = step * (v[major] - shifts[m, major])
            beside = abs(v[inner] - shifts[m, inner])
            # Else its wedge is one across the other index.
            alike = layer > 0 and (beside < layer or (beside == layer and major == 0))
            sides = min(slope - tree[c]["low"], tree[c]["high"] - slope) * depth
            if alike and sides >= 0.0 and sides > best:
                best = sides
                above = layer
                lo = tree[c]["low"]
                hi = tree[c]["high"]
    # With a wedge only the layers that it has not been down to, without one, and where that fails, all of them, those
    # near the cell first. Not in functions of their own: at each call Numba would count the references of their arrays.
    looked = np.int64(1)
    r = 0.0
    inherits = best >= 0.0
    trying = True
    blocker = np.int64(-1)
    # Exactly what the line itself touches, less the tolerance: what is nearer is certain to hide the cell.
    surely = _half_width(generators, step * slope, major, inner, 0.0)
    while trying:
        direction = 1 if inherits else -1
        layer = above + margin + 1 if inherits else depth + margin
        end = depth + margin + 1 if inherits else np.int64(0)
        if not inherits:
            if hint >= 0:
                # What hides a neighbour is likely to hide this cell.
                row = hint // strides[0]
                k = (hint - row * strides[0] if inner == 1 else row) - at[inner]
                layer_of = ((row if major == 0 else hint - row * strides[0]) - at[major]) * step
                if margin < layer_of < depth - margin and abs(k - layer_of * slope) <= surely:
                    blocker = hint
                    lo, hi = 1.0, -1.0
                    break
            lo = slope - BESIDE / depth
            hi = slope + BESIDE / depth
            r = max(
                _half_width(generators, step * lo, major, inner, touch),
                _half_width(generators, step * hi, major, inner, touch),
            )
        while (end - layer) * direction > 0 and lo <= slope <= hi:
            if inherits:
                lo = max(lo, slope - BESIDE / layer)
                hi = min(hi, slope + BESIDE / layer)
                r = max(
                    _half_width(generators, step * lo, major, inner, touch),
                    _half_width(generators, step * hi, major, inner, touch),
                )
            row = at[major] + step * layer
            if row < 0 or row >= shape[major]:
                lo, hi = 1.0, -1.0
            else:
                base = row * strides[major]
                # Beyond the window's padding, which is blocked, there is nothing to look at.
                first = max(at[inner] + np.int64(np.ceil(layer * lo - r)), 0)
                last = min(at[inner] + np.int64(np.floor(layer * hi + r)), shape[inner] - 1)
                looked += last - first + 1
                for k in range(first, last + 1):
                    if free[base + k * strides[inner]] == 0:
                        q = k - at[inner]
                        if margin < layer < depth - margin and abs(q - layer * slope) <= surely:
                            blocker = base + k * strides[inner]
                        if q > layer * slope:
                            hi = min(hi, (q - r) / layer - _CLEAR)
                            break
                        lo = max(lo, (q + r) / layer + _CLEAR)
            layer += direction
        trying = inherits and blocker < 0 and not lo <= slope <= hi
        inherits = inherits and not trying
    # Beside and behind the parent slopes tell little apart: what any of the rays may touch must be free, but for cells
    # behind the parent on every ray.
    layer = np.int64(1) if inherits else -margin
    while layer <= 0 and lo <= slope <= hi:
        row = at[major] + step * layer
        first = at[inner] + np.int64(np.ceil(min(layer * lo, layer * hi) - r))
        last = at[inner] + np.int64(np.floor(max(layer * lo, layer * hi) + r))
        for k in range(first, last + 1):
            looked += 1
            i, q = layer * step, k - at[inner]
            along = (i * gram[major, major] + q * gram[inner, major]) * step
            across = i * gram[major, inner] + q * gram[inner, inner]
            if max(along + across * lo, along + across * hi) > 0.0:
                outside = row < 0 or row >= shape[major] or k < 0 or k >= shape[inner]
                if outside or free[row * strides[major] + k * strides[inner]] == 0:
                    lo, hi = 1.0, -1.0
                    break
        layer += 1
    if lo <= slope <= hi:
        tree[a]["low"] = lo
        tree[a]["high"] = hi
        tree[a]["mark"] |= WEDGE
    else:
        looked = -looked
        if blocker >= 0:
            tree[a]["refused"] = p + 1
            tree[a]["blocker"] = blocker + 1
    return looked
