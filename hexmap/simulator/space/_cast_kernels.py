"""Numba kernel of rays in a building of boxes and cylinders, found through a uniform grid.

Each ray walks the cells of the grid that it passes (Amanatides and Woo 1987) and is cut with the solids listed in each:
boxes of any attitude by the slab method (Kay and Kajiya 1986), upright cylinders with their ends. The walk ends once
the nearest hit lies before the end of the cell, because no solid of a later cell can be nearer.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _slab(near, far, position, speed, half):
    """Narrow the span [near, far] of a ray to where |position + t speed| <= half; an empty span has near > far."""
    if speed == 0.0:
        if abs(position) > half:
            return math.inf, -math.inf
        return near, far
    a = (-half - position) / speed
    b = (half - position) / speed
    if a > b:
        a, b = b, a
    return max(near, a), min(far, b)


@njit(cache=True, nogil=True)
def _box(origin, direction, centre, rotation, half):
    """Return the distance at which a ray enters a box, 0 from inside, inf where it misses."""
    near, far = -math.inf, math.inf
    for i in range(3):
        # The ray in the frame of the box, whose axes are the columns of the rotation.
        position = 0.0
        speed = 0.0
        for k in range(3):
            position += rotation[k, i] * (origin[k] - centre[k])
            speed += rotation[k, i] * direction[k]
        near, far = _slab(near, far, position, speed, half[i])
        if near > far:
            return math.inf
    return max(near, 0.0) if far >= 0.0 else math.inf


@njit(cache=True, nogil=True)
def _cylinder(origin, direction, x, y, radius, bottom, top):
    """Return the distance at which a ray enters an upright cylinder, 0 from inside, inf where it misses."""
    near, far = -math.inf, math.inf
    px, py = origin[0] - x, origin[1] - y
    a = direction[0] * direction[0] + direction[1] * direction[1]
    c = px * px + py * py - radius * radius
    if a == 0.0:
        if c > 0.0:
            return math.inf
    else:
        b = px * direction[0] + py * direction[1]
        root = b * b - a * c
        if root < 0.0:
            return math.inf
        root = math.sqrt(root)
        near, far = (-b - root) / a, (-b + root) / a
    near, far = _slab(near, far, origin[2] - 0.5 * (bottom + top), direction[2], 0.5 * (top - bottom))
    if near > far or far < 0.0:
        return math.inf
    return max(near, 0.0)


@njit(cache=True, nogil=True)
def _solid(scene, s, origin, direction):
    """Return the distance at which a ray enters solid ``s``: the boxes come first, then the cylinders."""
    boxes = scene.centres.shape[0]
    if s < boxes:
        return _box(origin, direction, scene.centres[s], scene.rotations[s], scene.halves[s])
    c = scene.cylinders[s - boxes]
    return _cylinder(origin, direction, c[0], c[1], c[2], c[3], c[4])


@njit(cache=True, nogil=True)
def _nearest(scene, origin, direction, limit, cell, step, leave, pace):
    """Return the nearest hit of one ray up to ``limit`` and the solid that it hit; inf and -1 for none.

    ``cell``, ``step``, ``leave`` and ``pace`` (3,) are room for the walk: the cell, which way the ray crosses cells on
    each axis, when it leaves the cell on each axis, and how long it takes from one side of a cell to the other.
    """
    # Where the ray is inside the grid at all.
    near, far = 0.0, limit
    for i in range(3):
        half = 0.5 * scene.shape[i] * scene.size
        near, far = _slab(near, far, origin[i] - scene.low[i] - half, direction[i], half)
    best, hit = math.inf, -1
    if near > far:
        return best, hit
    for i in range(3):
        at = (origin[i] + near * direction[i] - scene.low[i]) / scene.size
        cell[i] = min(max(np.int64(math.floor(at)), 0), scene.shape[i] - 1)
        if direction[i] == 0.0:
            step[i], leave[i], pace[i] = 0, math.inf, math.inf
            continue
        step[i] = 1 if direction[i] > 0.0 else -1
        pace[i] = scene.size / abs(direction[i])
        side = cell[i] + 1 if direction[i] > 0.0 else cell[i]
        leave[i] = (scene.low[i] + side * scene.size - origin[i]) / direction[i]
    while True:
        flat = (cell[0] * scene.shape[1] + cell[1]) * scene.shape[2] + cell[2]
        for item in range(scene.first[flat], scene.first[flat + 1]):
            s = scene.items[item]
            t = _solid(scene, s, origin, direction)
            # Of two solids at one distance the first of the list is the one that was hit.
            if t < best or (t == best and s < hit):
                best, hit = t, s
        axis = 0
        for i in range(1, 3):
            if leave[i] < leave[axis]:
                axis = i
        if best <= leave[axis] or leave[axis] > far:
            break
        cell[axis] += step[axis]
        if cell[axis] < 0 or cell[axis] >= scene.shape[axis]:
            break
        leave[axis] += pace[axis]
    return (best, hit) if best <= limit else (math.inf, -1)


@njit(cache=True, nogil=True)
def cast_rays(scene, origins, directions, limit, ranges, hits):
    """Write into ``ranges`` and ``hits`` (R,) how far each ray goes and which solid it hits; inf and -1 for none.

    ``scene`` is a :class:`hexmap.simulator.space.building.Scene`, ``origins`` (R, 3) and ``directions`` (R, 3) unit
    vectors, in its frame.
    """
    cell = np.empty(3, dtype=np.int64)
    step = np.empty(3, dtype=np.int64)
    leave = np.empty(3)
    pace = np.empty(3)
    for r in range(origins.shape[0]):
        ranges[r], hits[r] = _nearest(scene, origins[r], directions[r], limit, cell, step, leave, pace)


@njit(cache=True, nogil=True)
def cast_people(places, size, clear, origins, directions, ranges):
    """Shorten ``ranges`` (A, H) to the people that stand in the rays; returns which rays end on one, (A, H).

    ``places`` (A, P, 3) are where their feet are as each column of rays is fired, ``size`` their radius and height; one
    whose middle is nearer than ``clear`` to the origin is left out. ``origins`` (A, 3) and ``directions`` (A, H, 3).
    """
    on_person = np.zeros(ranges.shape, dtype=np.bool_)
    for a in range(ranges.shape[0]):
        for p in range(places.shape[1]):
            x, y, z = places[a, p]
            if math.hypot(origins[a, 0] - x, origins[a, 1] - y) < clear:
                continue
            for h in range(ranges.shape[1]):
                t = _cylinder(origins[a], directions[a, h], x, y, size[0], z, z + size[1])
                if t < ranges[a, h]:
                    ranges[a, h] = t
                    on_person[a, h] = True
    return on_person
