"""Numba kernels of the pictures of solids: a z-buffer over convex cells, light from depth maps, the final pixels.

All cells of a lattice are the same polytope, so a scene is a list of centres, one template and a
bit mask of exposed faces; no mesh is needed. A sample of the picture knows what it shows by one
number, ``cell * F + face``, and its depth by the reciprocal of the distance along the view, which
is linear on the page.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import math

import numpy as np
from numba import njit

NOTHING = -1


@njit(cache=True, nogil=True)
def rasterise(centres, exposed, corners, rings, sizes, normals, half, focal, cx, cy, shown, depth):
    """Draw the exposed front faces of all cells into ``shown`` and ``depth`` (H, W), nearest first.

    ``centres`` (M, 3), ``corners`` (V, 3) and ``normals`` (F, 3) are in the camera's frame: x right,
    y down, z along the view. A face is where x . normal = half around its own centre.
    """
    height, width = shown.shape
    u = np.empty(corners.shape[0])
    v = np.empty(corners.shape[0])
    faces = normals.shape[0]
    for m in range(centres.shape[0]):
        mask = exposed[m]
        if mask == 0:
            continue
        x = centres[m, 0]
        y = centres[m, 1]
        z = centres[m, 2]
        behind = False
        for k in range(corners.shape[0]):
            w = z + corners[k, 2]
            if w <= 1e-9:
                behind = True
                break
            u[k] = focal * (x + corners[k, 0]) / w + cx
            v[k] = focal * (y + corners[k, 1]) / w + cy
        if behind:
            continue
        for f in range(faces):
            if (mask >> f) & 1 == 0:
                continue
            # The plane of the face is n . X = d; the eye, at zero, sees it from outside where d < 0.
            d = normals[f, 0] * x + normals[f, 1] * y + normals[f, 2] * z + half[f]
            if d >= 0.0:
                continue
            a = normals[f, 0] / (focal * d)
            b = normals[f, 1] / (focal * d)
            c = normals[f, 2] / d
            n = sizes[f]
            low = v[rings[f, 0]]
            high = low
            for k in range(1, n):
                low = min(low, v[rings[f, k]])
                high = max(high, v[rings[f, k]])
            first = max(math.ceil(low - 0.5), 0)
            last = min(math.ceil(high - 0.5), height)
            for row in range(first, last):
                at = row + 0.5
                left = 1e300
                right = -1e300
                for k in range(n):
                    i = rings[f, k]
                    j = rings[f, k + 1 if k + 1 < n else 0]
                    if v[i] > v[j]:
                        i, j = j, i
                    if v[i] <= at < v[j]:
                        cut = u[i] + (at - v[i]) * (u[j] - u[i]) / (v[j] - v[i])
                        left = min(left, cut)
                        right = max(right, cut)
                if left > right:
                    continue
                start = max(math.ceil(left - 0.5), 0)
                end = min(math.ceil(right - 0.5), width)
                near = b * (at - cy) + c - a * cx
                for column in range(start, end):
                    nearness = np.float32(near + a * (column + 0.5))
                    if nearness > depth[row, column]:
                        depth[row, column] = nearness
                        shown[row, column] = m * faces + f


@njit(cache=True, nogil=True)
def light_points(shown, depth, n, focal, cx, cy, rotation, eye, write, what, places):
    """Find for each pixel the different faces in its n x n samples: one place each whose light is computed.

    With ``write`` the faces go to ``what`` (N,), the places to ``places`` (N, 3), and ``shown``
    then holds the number of the place for each sample instead of the face.

    Returns:
        The number of places.
    """
    height, width = shown.shape
    found = np.empty(n * n, np.int64)
    total = 0
    for row in range(0, height, n):
        for column in range(0, width, n):
            many = 0
            for i in range(row, row + n):
                for j in range(column, column + n):
                    face = shown[i, j]
                    if face == NOTHING:
                        continue
                    known = many
                    for k in range(many):
                        if found[k] == face:
                            known = k
                            break
                    if write:
                        shown[i, j] = total + known
                    if known < many:
                        continue
                    if write:
                        # A ray through the sample, as long as it takes to reach the depth.
                        far = 1.0 / depth[i, j]
                        x = far * (j + 0.5 - cx) / focal
                        y = far * (i + 0.5 - cy) / focal
                        what[total + many] = face
                        for axis in range(3):
                            there = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis] * far
                            places[total + many, axis] = eye[axis] + there
                    found[many] = face
                    many += 1
            total += many
    return total


@njit(cache=True, nogil=True)
def stamp(centres, exposed, frame, low, texel, shape, tops):
    """Fill ``tops`` (A, B) with the greatest height of all cells along a direction.

    ``frame`` (3, 3) holds two axes across the direction and the direction itself; ``shape`` (K, K)
    is how high the cell is above its centre, -inf beside it.
    """
    tops[:] = -np.inf
    k = shape.shape[0]
    for m in range(centres.shape[0]):
        if exposed[m] == 0:
            continue
        x = centres[m, 0]
        y = centres[m, 1]
        z = centres[m, 2]
        a = int((frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z - low[0]) / texel) - k // 2
        b = int((frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z - low[1]) / texel) - k // 2
        h = np.float32(frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z)
        for i in range(k):
            for j in range(k):
                tops[a + i, b + j] = max(tops[a + i, b + j], h + shape[i, j])


@njit(cache=True, nogil=True)
def shine(places, what, normals, lift, frame, low, texel, tops, brightness, light):
    """Add the light of one direction to all places that nothing hides from it.

    ``normals`` (F + 1, 3), the last one that of the ground. Places are looked up ``lift`` above
    their face, so that the steps of the depth map do not shade the face itself.
    """
    faces = normals.shape[0] - 1
    slant = np.empty(faces + 1)
    moved = np.empty((faces + 1, 3))
    for f in range(faces + 1):
        slant[f] = 0.0
        for axis in range(3):
            slant[f] += normals[f, axis] * frame[2, axis]
        for row in range(3):
            total = 0.0
            for axis in range(3):
                total += frame[row, axis] * normals[f, axis] * lift
            moved[f, row] = total
    for p in range(places.shape[0]):
        f = what[p] % faces if what[p] != NOTHING else faces
        if slant[f] <= 0.0:
            continue
        x = np.float64(places[p, 0])
        y = np.float64(places[p, 1])
        z = np.float64(places[p, 2])
        a = math.floor((frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + moved[f, 0] - low[0]) / texel)
        b = math.floor((frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + moved[f, 1] - low[1]) / texel)
        h = frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z + moved[f, 2]
        if 0 <= a < tops.shape[0] and 0 <= b < tops.shape[1] and tops[a, b] > h:
            continue
        light[p] += np.float32(brightness * slant[f])


@njit(cache=True, nogil=True)
def _difference(shown, depth, what, faces, row, column, r, c):
    """Tell what lies between a sample and another: 0 the same face, 1 a fold, 2 another cell, 3 a drop."""
    if r < 0 or c < 0 or r >= shown.shape[0] or c >= shown.shape[1]:
        return 0
    other = shown[r, c]
    mine = shown[row, column]
    if other == mine:
        return 0
    if other == NOTHING:
        return 3
    if what[other] == what[mine]:
        return 0
    if what[other] // faces == what[mine] // faces:
        return 1
    # Only the nearer of two surfaces gets the line.
    here = depth[row, column]
    there = depth[r, c]
    if there < here * 0.97:
        return 3
    return 2 if there < here * 1.03 else 0


@njit(cache=True, nogil=True)
def _line(shown, depth, what, faces, row, column, wide):
    """Return how much of its light a sample keeps: less on the lines around cells ``wide`` pixels wide."""
    strength = min(max((wide - 3.0) / 9.0, 0.0), 1.0)
    if strength == 0.0:
        return 1.0
    step = 0
    reach = 1 if wide < 30.0 else (2 if wide < 100.0 else 3)
    for k in range(1, reach + 1):
        step = max(step, _difference(shown, depth, what, faces, row, column, row + k, column))
        step = max(step, _difference(shown, depth, what, faces, row, column, row - k, column))
        step = max(step, _difference(shown, depth, what, faces, row, column, row, column + k))
        step = max(step, _difference(shown, depth, what, faces, row, column, row, column - k))
    if step == 1:
        return 1.0 - 0.22 * strength
    if step == 2:
        return 1.0 - 0.62 * strength
    return 1.0 - 0.74 * strength if step == 3 else 1.0


@njit(cache=True, nogil=True)
def _ground_light(ray, eye, level, low, spacing, ground):
    """Return the light on the ground where a ray (3,) from the eye meets it, 1 where it does not."""
    if ray[2] == 0.0:
        return 1.0
    far = (level - eye[2]) / ray[2]
    if far <= 0.0:
        return 1.0
    a = (eye[0] + far * ray[0] - low[0]) / spacing
    b = (eye[1] + far * ray[1] - low[1]) / spacing
    if not (0.0 <= a < ground.shape[0] - 1 and 0.0 <= b < ground.shape[1] - 1):
        return 1.0
    i = int(a)
    j = int(b)
    a -= i
    b -= j
    near = ground[i, j] * (1.0 - b) + ground[i, j + 1] * b
    return near * (1.0 - a) + (ground[i + 1, j] * (1.0 - b) + ground[i + 1, j + 1] * b) * a


@njit(cache=True, nogil=True)
def resolve(
    shown,
    depth,
    n,
    focal,
    cx,
    cy,
    rotation,
    eye,
    what,
    light,
    colours,
    faces,
    size,
    paper,
    level,
    low,
    spacing,
    ground,
    image,
):
    """Mix the n x n samples of each pixel into ``image`` (H, W, 3), linear light, 0 to 1.

    A cell's ``colours`` (M, 3) are multiplied by the ``light`` (N,) at the sample's place and drawn
    in lines around it where the cell, ``size`` metres wide, is wide enough on the page. Elsewhere
    the ``paper`` (3,) is dimmed by the light on the ``ground`` (A, B), a grid at the height ``level``.
    """
    height, width = image.shape[:2]
    part = 1.0 / (n * n)
    ray = np.empty(3)
    for row in range(height):
        for column in range(width):
            red = 0.0
            green = 0.0
            blue = 0.0
            empty = 0
            for i in range(row * n, row * n + n):
                for j in range(column * n, column * n + n):
                    p = shown[i, j]
                    if p == NOTHING:
                        empty += 1
                        continue
                    bright = light[p] * _line(shown, depth, what, faces, i, j, focal / n * size * depth[i, j])
                    cell = what[p] // faces
                    red += min(colours[cell, 0] * bright, 1.0)
                    green += min(colours[cell, 1] * bright, 1.0)
                    blue += min(colours[cell, 2] * bright, 1.0)
            if empty:
                x = ((column + 0.5) * n - cx) / focal
                y = ((row + 0.5) * n - cy) / focal
                for axis in range(3):
                    ray[axis] = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis]
                bright = empty * _ground_light(ray, eye, level, low, spacing, ground)
                red += paper[0] * bright
                green += paper[1] * bright
                blue += paper[2] * bright
            image[row, column, 0] = red * part
            image[row, column, 1] = green * part
            image[row, column, 2] = blue * part
