"""Numba kernels of the pictures of solids: a z-buffer over convex cells, light from depth maps, the final pixels.

All cells of a lattice are the same polytope, so a scene is a list of centres, one template and a
bit mask of exposed faces; no mesh is needed. A sample of the picture knows what it shows by one
number, ``cell * F + face``, and its depth by the reciprocal of the distance along the view, which
is linear in the picture. What belongs together comes as a tuple with names, see
:mod:`hexmap.drawing.solids.renderer`: the ``lens``, the ``template`` of a cell, the ``samples`` of the
picture, the depth ``map`` along one direction of light, and the ``ground``.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import math

import numpy as np
from numba import njit

NOTHING = -1


@njit(cache=True, nogil=True)
def rasterise(centres, exposed, template, samples):
    """Draw the exposed front faces of all cells into ``shown`` and ``depth`` (H, W), nearest first.

    ``centres`` (M, 3) and the template are in the camera's frame: x right, y down, z along the view.
    Bit f of ``exposed`` (M,) says whether face f is to be drawn.
    """
    corners, rings, sizes = template.corners, template.rings, template.sizes
    normals, half = template.normals, template.half
    shown, depth = samples.shown, samples.depth
    focal, cx, cy = samples.lens.focal, samples.lens.cx, samples.lens.cy
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
        # All corners onto the picture. A cell that reaches behind the eye would turn inside out: it is left out.
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
            # 1 / z of the plane is a column + b row + c: linear, so that a sample's depth takes one product.
            a = normals[f, 0] / (focal * d)
            b = normals[f, 1] / (focal * d)
            c = normals[f, 2] / d
            n = sizes[f]
            low = v[rings[f, 0]]
            high = low
            for k in range(1, n):
                low = min(low, v[rings[f, k]])
                high = max(high, v[rings[f, k]])
            # The rows whose middle is within the face, neither more nor fewer where two faces share an edge.
            first = max(math.ceil(low - 0.5), 0)
            last = min(math.ceil(high - 0.5), height)
            for row in range(first, last):
                at = row + 0.5
                # The face is convex, so a row meets it between two edges.
                left = 1e300
                right = -1e300
                for k in range(n):
                    i = rings[f, k]
                    j = rings[f, k + 1 if k + 1 < n else 0]
                    # From the upper end to the lower: both faces of an edge then round the cut alike, and no gap shows.
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
                    # Nearer is larger; of two at the same depth the first stays.
                    nearness = np.float32(near + a * (column + 0.5))
                    if nearness > depth[row, column]:
                        depth[row, column] = nearness
                        shown[row, column] = m * faces + f


@njit(cache=True, nogil=True)
def light_points(samples, write, what, points):
    """Find for each pixel the different faces in its n x n samples: one point each whose light is computed.

    With ``write`` the faces go to ``what`` (N,), the points to ``points`` (N, 3), and ``shown``
    then holds the number of the point for each sample instead of the face.

    Returns:
        The number of points.
    """
    shown, depth, lens, n = samples.shown, samples.depth, samples.lens, samples.per_pixel
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
                    # Few faces meet in a pixel: a list is searched faster than anything cleverer.
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
                        x = far * (j + 0.5 - lens.cx) / lens.focal
                        y = far * (i + 0.5 - lens.cy) / lens.focal
                        what[total + many] = face
                        for axis in range(3):
                            there = (
                                lens.rotation[0, axis] * x + lens.rotation[1, axis] * y + lens.rotation[2, axis] * far
                            )
                            points[total + many, axis] = lens.eye[axis] + there
                    found[many] = face
                    many += 1
            total += many
    return total


@njit(cache=True, nogil=True)
def stamp(centres, exposed, shape, map):
    """Fill the ``tops`` (A, B) of a depth map with the greatest height of all cells along its direction.

    ``shape`` (K, K) is how high the cell is above its centre, -inf beside it.
    """
    frame, low, texel, tops = map.frame, map.low, map.texel, map.tops
    tops[:] = -np.inf
    k = shape.shape[0]
    for m in range(centres.shape[0]):
        # What has no exposed face lies within others, which are higher.
        if exposed[m] == 0:
            continue
        x = centres[m, 0]
        y = centres[m, 1]
        z = centres[m, 2]
        # The shape is moved by whole texels, which is why light is measured a little above the faces.
        a = int((frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z - low[0]) / texel) - k // 2
        b = int((frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z - low[1]) / texel) - k // 2
        h = np.float32(frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z)
        for i in range(k):
            for j in range(k):
                tops[a + i, b + j] = max(tops[a + i, b + j], h + shape[i, j])


@njit(cache=True, nogil=True)
def shine(points, what, normals, lift, map, brightness, light):
    """Add the light of one direction to all points (N, 3) that nothing hides from it.

    ``normals`` (F + 1, 3), the last one that of the ground. Points are looked up ``lift`` above
    their face, so that the steps of the depth ``map`` do not shade the face itself.
    """
    frame, low, texel, tops = map.frame, map.low, map.texel, map.tops
    faces = normals.shape[0] - 1
    slant = np.empty(faces + 1)
    moved = np.empty((faces + 1, 3))
    # All points of a face have one normal: its slant to the light (Lambert) and its lift are computed once.
    for f in range(faces + 1):
        slant[f] = 0.0
        for axis in range(3):
            slant[f] += normals[f, axis] * frame[2, axis]
        for row in range(3):
            total = 0.0
            for axis in range(3):
                total += frame[row, axis] * normals[f, axis] * lift
            moved[f, row] = total
    for p in range(points.shape[0]):
        f = what[p] % faces if what[p] != NOTHING else faces
        if slant[f] <= 0.0:
            continue
        x = np.float64(points[p, 0])
        y = np.float64(points[p, 1])
        z = np.float64(points[p, 2])
        a = math.floor((frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + moved[f, 0] - low[0]) / texel)
        b = math.floor((frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + moved[f, 1] - low[1]) / texel)
        h = frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z + moved[f, 2]
        # Beyond the map there is nothing that could hide the light.
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
    # Only the nearer of two surfaces gets the line; depths are reciprocal, and within 3 % they count as the same.
    here = depth[row, column]
    there = depth[r, c]
    if there < here * 0.97:
        return 3
    return 2 if there < here * 1.03 else 0


@njit(cache=True, nogil=True)
def _line(shown, depth, what, faces, row, column, wide):
    """Return how much of its light a sample keeps: less on the lines around cells ``wide`` pixels wide."""
    # Lines fade in as cells grow: on cells of three pixels they would be all that is seen.
    strength = min(max((wide - 3.0) / 9.0, 0.0), 1.0)
    if strength == 0.0:
        return 1.0
    step = 0
    reach = 1 if wide < 30.0 else (2 if wide < 100.0 else 3)
    # The strongest edge within reach along the rows and the columns.
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
def _ground_light(ray, eye, level, low, spacing, light):
    """Return the light on the ground where a ray (3,) from the eye meets it, 1 where it does not."""
    if ray[2] == 0.0:
        return 1.0
    far = (level - eye[2]) / ray[2]
    if far <= 0.0:
        return 1.0
    a = (eye[0] + far * ray[0] - low[0]) / spacing
    b = (eye[1] + far * ray[1] - low[1]) / spacing
    if not (0.0 <= a < light.shape[0] - 1 and 0.0 <= b < light.shape[1] - 1):
        return 1.0
    # Bilinear between the four points of the grid around it.
    i = int(a)
    j = int(b)
    a -= i
    b -= j
    near = light[i, j] * (1.0 - b) + light[i, j + 1] * b
    return near * (1.0 - a) + (light[i + 1, j] * (1.0 - b) + light[i + 1, j + 1] * b) * a


@njit(cache=True, nogil=True)
def resolve(samples, what, light, colours, faces, size, paper, ground, image):
    """Mix the n x n samples of each pixel into ``image`` (H, W, 3), linear light, 0 to 1.

    A cell's ``colours`` (M, 3) are multiplied by the ``light`` (N,) at the sample's point and drawn
    in lines around it where the cell, ``size`` metres wide, is wide enough in the picture. Elsewhere
    the ``paper`` (3,) is dimmed by the light on the ``ground``.
    """
    shown, depth, n = samples.shown, samples.depth, samples.per_pixel
    focal, cx, cy = samples.lens.focal, samples.lens.cx, samples.lens.cy
    rotation, eye = samples.lens.rotation, samples.lens.eye
    level, low, spacing, on_ground = ground.level, ground.low, ground.spacing, ground.light
    height, width = image.shape[:2]
    share = 1.0 / (n * n)
    ray = np.empty(3)
    for row in range(height):
        for column in range(width):
            red = 0.0
            green = 0.0
            blue = 0.0
            empty = 0
            # What each sample shows, in linear light: mixed as bytes of sRGB, edges would come out too dark.
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
                # The ground's light changes slowly: one ray through the middle serves all the pixel's samples.
                x = ((column + 0.5) * n - cx) / focal
                y = ((row + 0.5) * n - cy) / focal
                for axis in range(3):
                    ray[axis] = rotation[0, axis] * x + rotation[1, axis] * y + rotation[2, axis]
                bright = empty * _ground_light(ray, eye, level, low, spacing, on_ground)
                red += paper[0] * bright
                green += paper[1] * bright
                blue += paper[2] * bright
            image[row, column, 0] = red * share
            image[row, column, 1] = green * share
            image[row, column, 2] = blue * share
