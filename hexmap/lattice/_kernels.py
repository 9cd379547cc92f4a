"""Numba kernels of the lattices: the nearest lattice point of many points.

One method serves every lattice, so that ties are settled in one place. The kernels work in an
obtuse superbase (Selling's reduction), in which the nearest lattice point of x is almost always a
corner of the unit cube around its coordinates; the few other candidates that a lattice may need
are found when it is made and passed as ``extra``. With f the fractional coordinates and G the Gram
matrix, |f - c|^2 = f G f + (c G c - 2 f G c), and the bracket is *linear* in f: with f a multiple
of 2^-32 and G a small integer matrix (every named lattice) it is exact in float64. ``constants``
holds c G c plus the candidate's rank times 2^-38, which puts candidates that are exactly as near
in the lexicographic order of their index, and changes nothing else.

The work goes block by block through contiguous scratch columns, because only then does the
compiler turn the loop into vector instructions (measured: 5 ns a point against 23).
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit

# Coordinates are rounded to 2^-32 of a cell before anything is decided: this absorbs the rounding
# of the change of basis, so that ties are seen as ties.
SCALE = 4294967296.0
INVERSE_SCALE = 1.0 / 4294967296.0
BLOCK = 512


@njit(cache=True, nogil=True, inline="always")
def _nearest_corner_2d(h0, h1, q0, q1, q2, q3):
    """Return the corner of the unit square nearest to a point, and its distance less f G f.

    ``h0``, ``h1`` are 2 G f; ``q0`` to ``q3`` belong to the corners 00, 01, 10, 11.
    """
    # c G c - 2 f G c for each corner c, with the rank of its index far below the last bit that counts.
    s00 = q0
    s01 = q1 - h1
    s10 = q2 - h0
    s11 = q3 - h0 - h1
    # A tournament without branches: the better second coordinate for each first one, then the first.
    k0 = 1.0 if s01 < s00 else 0.0
    m0 = s01 if s01 < s00 else s00
    k1 = 1.0 if s11 < s10 else 0.0
    m1 = s11 if s11 < s10 else s10
    c0 = 1.0 if m1 < m0 else 0.0
    c1 = k1 if m1 < m0 else k0
    return c0, c1, m1 if m1 < m0 else m0


@njit(cache=True, nogil=True, inline="always")
def _nearest_corner_3d(h0, h1, h2, q0, q1, q2, q3, q4, q5, q6, q7):
    """Return the corner of the unit cube nearest to a point, and its distance less f G f.

    ``h0`` to ``h2`` are 2 G f; ``q0`` to ``q7`` belong to the corners 000, 001, 010, ... 111.
    """
    # c G c - 2 f G c for each corner c, with the rank of its index far below the last bit that counts.
    h01 = h0 + h1
    s000 = q0
    s001 = q1 - h2
    s010 = q2 - h1
    s011 = q3 - h1 - h2
    s100 = q4 - h0
    s101 = q5 - h0 - h2
    s110 = q6 - h01
    s111 = q7 - h01 - h2
    # A tournament without branches: last coordinate, then the middle one, then the first.
    k00 = 1.0 if s001 < s000 else 0.0
    m00 = s001 if s001 < s000 else s000
    k01 = 1.0 if s011 < s010 else 0.0
    m01 = s011 if s011 < s010 else s010
    k10 = 1.0 if s101 < s100 else 0.0
    m10 = s101 if s101 < s100 else s100
    k11 = 1.0 if s111 < s110 else 0.0
    m11 = s111 if s111 < s110 else s110
    j0 = 1.0 if m01 < m00 else 0.0
    k0 = k01 if m01 < m00 else k00
    n0 = m01 if m01 < m00 else m00
    j1 = 1.0 if m11 < m10 else 0.0
    k1 = k11 if m11 < m10 else k10
    n1 = m11 if m11 < m10 else m10
    c0 = 1.0 if n1 < n0 else 0.0
    c1 = j1 if n1 < n0 else j0
    c2 = k1 if n1 < n0 else k0
    return c0, c1, c2, n1 if n1 < n0 else n0


@njit(cache=True, nogil=True)
def quantise_2d(points, inverse, gram2, constants, extra, extra_constants, to_public, limit, out):
    """Nearest lattice points of ``points`` (N, 2); returns the number of rows out of range."""
    # The matrices as local numbers, which stay in registers in the loops. Scaling by a power of two is exact.
    a00, a01 = inverse[0, 0] * SCALE, inverse[0, 1] * SCALE
    a10, a11 = inverse[1, 0] * SCALE, inverse[1, 1] * SCALE
    g00, g01, g11 = gram2[0, 0], gram2[0, 1], gram2[1, 1]
    q0, q1, q2, q3 = constants[0], constants[1], constants[2], constants[3]
    t00, t01, t10, t11 = to_public[0, 0], to_public[0, 1], to_public[1, 0], to_public[1, 1]
    n_extra = extra.shape[0]
    # Scratch columns of a block. X, Y(, Z): the point, later the best index; I: the corner of the unit cube below it;
    # H = 2 G f of the fraction f; M: the distance of the best candidate, less f G f, which all candidates share.
    X = np.empty(BLOCK)
    Y = np.empty(BLOCK)
    I0 = np.empty(BLOCK)
    I1 = np.empty(BLOCK)
    H0 = np.empty(BLOCK)
    H1 = np.empty(BLOCK)
    M = np.empty(BLOCK)
    bad = 0
    n = points.shape[0]
    for start in range(0, n, BLOCK):
        m = min(BLOCK, n - start)
        # Rows to columns, for the loops below to read without gaps.
        for i in range(m):
            X[i] = points[start + i, 0]
            Y[i] = points[start + i, 1]
        # The nearest of the corners of the unit cube. No branch and no call: the compiler makes vectors of this loop.
        for i in range(m):
            x = X[i]
            y = Y[i]
            # Coordinates, rounded so that ties are seen; then the corner below and the fraction above it.
            u0 = np.rint(a00 * x + a01 * y) * INVERSE_SCALE
            u1 = np.rint(a10 * x + a11 * y) * INVERSE_SCALE
            i0 = np.floor(u0)
            i1 = np.floor(u1)
            f0 = u0 - i0
            f1 = u1 - i1
            h0 = g00 * f0 + g01 * f1
            h1 = g01 * f0 + g11 * f1
            c0, c1, best = _nearest_corner_2d(h0, h1, q0, q1, q2, q3)
            I0[i] = i0
            I1[i] = i1
            H0[i] = h0
            H1[i] = h1
            M[i] = best
            X[i] = i0 + c0
            Y[i] = i1 + c1
        # The few candidates beyond the cube, none on most lattices; the rank in ``q`` settles ties here too.
        for k in range(n_extra):
            e0 = extra[k, 0]
            e1 = extra[k, 1]
            q = extra_constants[k]
            for i in range(m):
                s = q - (e0 * H0[i] + e1 * H1[i])
                better = s < M[i]
                M[i] = s if better else M[i]
                X[i] = I0[i] + e0 if better else X[i]
                Y[i] = I1[i] + e1 if better else Y[i]
        # From the reduced basis to the public one; small integers in float64, so exact.
        for i in range(m):
            c0 = X[i]
            c1 = Y[i]
            X[i] = t00 * c0 + t01 * c1
            Y[i] = t10 * c0 + t11 * c1
        # What is not a number fails both comparisons, so that it is counted as well.
        for i in range(m):
            bad += 0 if (np.abs(X[i]) < limit) & (np.abs(Y[i]) < limit) else 1
        # In a loop of its own: writing rows of integers would keep the ones above from being vectors.
        for i in range(m):
            out[start + i, 0] = np.int32(X[i])
            out[start + i, 1] = np.int32(Y[i])
    return bad


@njit(cache=True, nogil=True)
def quantise_3d(points, inverse, gram2, constants, extra, extra_constants, to_public, limit, out):
    """Nearest lattice points of ``points`` (N, 3); returns the number of rows out of range."""
    # The matrices as local numbers, which stay in registers in the loops. Scaling by a power of two is exact.
    a00, a01, a02 = inverse[0, 0] * SCALE, inverse[0, 1] * SCALE, inverse[0, 2] * SCALE
    a10, a11, a12 = inverse[1, 0] * SCALE, inverse[1, 1] * SCALE, inverse[1, 2] * SCALE
    a20, a21, a22 = inverse[2, 0] * SCALE, inverse[2, 1] * SCALE, inverse[2, 2] * SCALE
    g00, g01, g02 = gram2[0, 0], gram2[0, 1], gram2[0, 2]
    g11, g12, g22 = gram2[1, 1], gram2[1, 2], gram2[2, 2]
    q0, q1, q2, q3 = constants[0], constants[1], constants[2], constants[3]
    q4, q5, q6, q7 = constants[4], constants[5], constants[6], constants[7]
    t00, t01, t02 = to_public[0, 0], to_public[0, 1], to_public[0, 2]
    t10, t11, t12 = to_public[1, 0], to_public[1, 1], to_public[1, 2]
    t20, t21, t22 = to_public[2, 0], to_public[2, 1], to_public[2, 2]
    n_extra = extra.shape[0]
    # Scratch columns of a block. X, Y(, Z): the point, later the best index; I: the corner of the unit cube below it;
    # H = 2 G f of the fraction f; M: the distance of the best candidate, less f G f, which all candidates share.
    X = np.empty(BLOCK)
    Y = np.empty(BLOCK)
    Z = np.empty(BLOCK)
    I0 = np.empty(BLOCK)
    I1 = np.empty(BLOCK)
    I2 = np.empty(BLOCK)
    H0 = np.empty(BLOCK)
    H1 = np.empty(BLOCK)
    H2 = np.empty(BLOCK)
    M = np.empty(BLOCK)
    bad = 0
    n = points.shape[0]
    for start in range(0, n, BLOCK):
        m = min(BLOCK, n - start)
        # Rows to columns, for the loops below to read without gaps.
        for i in range(m):
            X[i] = points[start + i, 0]
            Y[i] = points[start + i, 1]
            Z[i] = points[start + i, 2]
        # The nearest of the corners of the unit cube. No branch and no call: the compiler makes vectors of this loop.
        for i in range(m):
            x = X[i]
            y = Y[i]
            z = Z[i]
            # Coordinates, rounded so that ties are seen; then the corner below and the fraction above it.
            u0 = np.rint(a00 * x + a01 * y + a02 * z) * INVERSE_SCALE
            u1 = np.rint(a10 * x + a11 * y + a12 * z) * INVERSE_SCALE
            u2 = np.rint(a20 * x + a21 * y + a22 * z) * INVERSE_SCALE
            i0 = np.floor(u0)
            i1 = np.floor(u1)
            i2 = np.floor(u2)
            f0 = u0 - i0
            f1 = u1 - i1
            f2 = u2 - i2
            h0 = g00 * f0 + g01 * f1 + g02 * f2
            h1 = g01 * f0 + g11 * f1 + g12 * f2
            h2 = g02 * f0 + g12 * f1 + g22 * f2
            c0, c1, c2, best = _nearest_corner_3d(h0, h1, h2, q0, q1, q2, q3, q4, q5, q6, q7)
            I0[i] = i0
            I1[i] = i1
            I2[i] = i2
            H0[i] = h0
            H1[i] = h1
            H2[i] = h2
            M[i] = best
            X[i] = i0 + c0
            Y[i] = i1 + c1
            Z[i] = i2 + c2
        # The few candidates beyond the cube, none on most lattices; the rank in ``q`` settles ties here too.
        for k in range(n_extra):
            e0 = extra[k, 0]
            e1 = extra[k, 1]
            e2 = extra[k, 2]
            q = extra_constants[k]
            for i in range(m):
                s = q - (e0 * H0[i] + e1 * H1[i] + e2 * H2[i])
                better = s < M[i]
                M[i] = s if better else M[i]
                X[i] = I0[i] + e0 if better else X[i]
                Y[i] = I1[i] + e1 if better else Y[i]
                Z[i] = I2[i] + e2 if better else Z[i]
        # From the reduced basis to the public one; small integers in float64, so exact.
        for i in range(m):
            c0 = X[i]
            c1 = Y[i]
            c2 = Z[i]
            X[i] = t00 * c0 + t01 * c1 + t02 * c2
            Y[i] = t10 * c0 + t11 * c1 + t12 * c2
            Z[i] = t20 * c0 + t21 * c1 + t22 * c2
        # What is not a number fails all comparisons, so that it is counted as well.
        for i in range(m):
            inside = (np.abs(X[i]) < limit) & (np.abs(Y[i]) < limit) & (np.abs(Z[i]) < limit)
            bad += 0 if inside else 1
        # In a loop of its own: writing rows of integers would keep the ones above from being vectors.
        for i in range(m):
            out[start + i, 0] = np.int32(X[i])
            out[start + i, 1] = np.int32(Y[i])
            out[start + i, 2] = np.int32(Z[i])
    return bad
