"""Numba kernels around one pose: its score, its refinement below a cell, and the surface of scores around it.

All of them read the finest table of an occupancy pyramid, so that their cost does not depend on how far a scan sees.
"""

# mypy: ignore-errors
# Numba gives the kernels their types.
from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _weight(tables, cell):
    """Return the weight of a cell (n,); cells beyond the addresses have none."""
    at = np.int64(0)
    for a in range(cell.shape[0]):
        k = cell[a] - tables.low[a]
        if k < 0 or k >= tables.length:
            return np.int64(0)
        at += tables.cell_address[a * tables.length + k]
    return np.int64(tables.cells[at])


@njit(cache=True, nogil=True)
def weights_of(tables, index, out):
    """Write the weight of each of the cells ``index`` (M, n)."""
    cell = np.empty(index.shape[1], np.int64)
    for m in range(index.shape[0]):
        for a in range(index.shape[1]):
            cell[a] = index[m, a]
        out[m] = _weight(tables, cell)


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
def _turn(R, v, out):
    """Write exp(v) R, v an angle in the plane or a rotation vector (Rodrigues)."""
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
    for i in range(n):
        for j in range(n):
            total = 0.0
            for k in range(n):
                total += E[i, k] * R[k, j]
            out[i, j] = total


@njit(cache=True, nogil=True)
def _nearby(tables, lattice, x, cell):
    """Write a cell at or next to the one around ``x``: good enough to look around it."""
    n = x.shape[0]
    for a in range(n):
        u = 0.0
        for b in range(n):
            u += lattice.inverse[a, b] * x[b]
        cell[a] = np.int64(np.rint(u))


@njit(cache=True, nogil=True)
def refine(tables, lattice, points, weights, R, t, widths, offsets, ends, steps, tolerance, hessian):
    """Pull the scan onto the occupied cells around it; return how many steps were taken, -1 where nothing is near.

    Expectation maximisation on a sum of Gaussians: each point is drawn to the mean of the occupied cells near it, each
    weighted by a Gaussian of its distance; the pull of all points is one Gauss-Newton step on the pose. ``R`` (n, n) and
    ``t`` (n,) are changed in place. ``widths`` (W,) are the Gaussians' sigmas one after the other; the cells looked at for
    sigma w are ``offsets[:ends[w]]``. ``hessian`` receives the last normal matrix over sigma^2.
    """
    n = points.shape[1]
    size = 3 if n == 2 else 6
    A = np.empty((size, size))
    g = np.empty(size)
    x = np.empty(n)
    mean = np.empty(n)
    cell = np.empty(n, np.int64)
    other = np.empty(n, np.int64)
    J = np.zeros((n, size))
    turned = np.empty((n, n))
    taken = 0
    for width in range(widths.shape[0]):
        variance = widths[width] * widths[width]
        for _ in range(steps):
            A[:] = 0.0
            g[:] = 0.0
            for p in range(points.shape[0]):
                # Where the point is, and the cells around it.
                for i in range(n):
                    x[i] = t[i]
                    for k in range(n):
                        x[i] += R[i, k] * points[p, k]
                    mean[i] = 0.0
                _nearby(tables, lattice, x, cell)
                total = 0.0
                for o in range(ends[width]):
                    for a in range(n):
                        other[a] = cell[a] + offsets[o, a]
                    if _weight(tables, other) == 0:
                        continue
                    d2 = 0.0
                    for i in range(n):
                        centre = 0.0
                        for a in range(n):
                            centre += lattice.basis[i, a] * other[a]
                        d2 += (x[i] - centre) * (x[i] - centre)
                    if d2 > 6.25 * variance:
                        continue
                    w = np.exp(-0.5 * d2 / variance)
                    total += w
                    for i in range(n):
                        centre = 0.0
                        for a in range(n):
                            centre += lattice.basis[i, a] * other[a]
                        mean[i] += w * centre
                if total < 1e-12:
                    continue
                # Rows of d(point) / d(pose): the identity, then the turn about the sensor.
                for i in range(n):
                    J[i, i] = 1.0
                if n == 2:
                    J[0, 2] = t[1] - x[1]
                    J[1, 2] = x[0] - t[0]
                else:
                    J[0, 4], J[0, 5] = x[2] - t[2], t[1] - x[1]
                    J[1, 3], J[1, 5] = t[2] - x[2], x[0] - t[0]
                    J[2, 3], J[2, 4] = x[1] - t[1], t[0] - x[0]
                total *= weights[p]
                for i in range(n):
                    pull = mean[i] * weights[p] / total - x[i]
                    for a in range(size):
                        g[a] += total * J[i, a] * pull
                        for b in range(a + 1):
                            A[a, b] += total * J[i, a] * J[i, b]
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
            _turn(R, g[n:], turned)
            largest = 0.0
            for i in range(n):
                t[i] += g[i]
                for k in range(n):
                    R[i, k] = turned[i, k]
            for a in range(size):
                largest = max(largest, abs(g[a]))
            if largest < tolerance:
                break
    return taken


@njit(cache=True, nogil=True)
def surface(tables, index, weights, shifts, out):
    """Write the score of each rotation's cells ``index`` (R, P, n) under each of the ``shifts`` (K, n) into (R, K)."""
    n = shifts.shape[1]
    cell = np.empty(n, np.int64)
    for r in range(index.shape[0]):
        for k in range(shifts.shape[0]):
            total = np.int64(0)
            for p in range(index.shape[1]):
                for a in range(n):
                    cell[a] = index[r, p, a] + shifts[k, a]
                total += np.int64(weights[p]) * _weight(tables, cell)
            out[r, k] = total


@njit(cache=True, nogil=True)
def widened_surface(tables, table, back, index, weights, shifts, out):
    """Write what :func:`surface` does with every cell's weight the largest of the box around it, in whole units.

    The boxes are those of ``table``, and begin ``back`` indices before the cell along each axis: an upper bound of the
    scores of all poses that move no point out of its box.
    """
    n = shifts.shape[1]
    first = table * n * tables.length
    for r in range(index.shape[0]):
        for k in range(shifts.shape[0]):
            total = np.int64(0)
            for p in range(index.shape[1]):
                at = np.int64(0)
                inside = True
                for a in range(n):
                    # Addresses end where nothing is: cells beyond them have no box with a weight in it.
                    c = index[r, p, a] + shifts[k, a] - back - tables.low[a]
                    if c < 0 or c >= tables.length:
                        inside = False
                        break
                    at += tables.address[first + a * tables.length + c]
                if inside:
                    total += np.int64(weights[p]) * np.int64(np.uint64(tables.packed[at]) & np.uint64(255))
            out[r, k] = total * tables.unit
