"""The rotations of a region, cut into cells level by level: intervals of yaw, and in space patches of tilts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.errors import TooLargeError
from hexmap.poses.rotations import exponential
from localisation.matching.pyramid import most_motion
from localisation.matching.search_region import SearchRegion

__all__ = ["cut_rotations", "cut_tilts"]

_MOST_ANGLES = 1 << 26


def cut_rotations(region: SearchRegion, n: int, motion: float, top: int, step: float | None) -> Any:
    """Return the cells of rotations of a region, for the kernels.

    Args:
        region: where to look.
        n: dimension.
        motion: indices along an axis by which a radian moves the median point of the scan.
        top: the highest level.
        step: radians between the stated yaws; None: the yaw is a continuum.

    Raises:
        TooLargeError: there are too many angles.
    """
    from localisation.matching import _global_kernels as kernels

    span = 2.0 * region.yaw_range
    continuous = step is None and span > 0.0
    if continuous:
        count = max(1, math.ceil(span * motion))
        unit, first = span / count, region.yaw - region.yaw_range
    else:
        unit = step if step is not None else 1.0
        if region.yaw_range >= math.pi:
            count, first = math.ceil(span / unit - 1e-9), region.yaw
        else:
            half = math.floor(region.yaw_range / unit + 1e-9)
            count, first = 2 * half + 1, region.yaw - half * unit
    if count >= _MOST_ANGLES:
        raise TooLargeError(f"{count:,} angles are too many for a search")
    group = [1]
    for level in range(1, top + 1):
        # The arc over a group moves the median point by no more than the tables were made for.
        room = most_motion(level) / (unit * motion)
        units = room if continuous else room + 1.0
        group.append(max(group[-1], 1 << max(0, math.floor(math.log2(units) + 1e-9)) if units >= 1.0 else 1))
    tilts, radius, starts, children, child_start = cut_tilts(n, region.tilt, motion, top)
    return kernels.RotationArrays(
        float(first), float(unit), count, continuous, np.array(group), tilts, radius, starts, children, child_start
    )


def cut_tilts(n: int, tilt: float, motion: float, top: int) -> tuple[NDArray[Any], ...]:
    """Return rotations, radii, starts by level, children and their starts of the patches of tilts.

    The tilts are a square grid of rotation vectors about horizontal axes in the disc of radius ``tilt``; its step
    moves the median point of the scan by one index. A patch of a higher level holds a square of them that moves it by
    no more than the tables were made for.
    """
    half = 0 if n == 2 or tilt <= 0.0 else math.ceil(tilt * motion)
    step = tilt / half if half else 0.0
    grid = range(-half, half + 1)
    lattice_points = [(i, j) for i in grid for j in grid if math.hypot(i, j) <= half + 1e-9]
    side = 1
    levels = [{point: [point] for point in lattice_points}]
    for level in range(1, top + 1):
        wanted = 1.0 + most_motion(level) / 2.0 / max(1e-12, math.sqrt(0.5) * step * motion) if half else 1.0
        while side * 2 <= wanted:
            side *= 2
        patches: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for i, j in lattice_points:
            patches.setdefault(((i + half) // side, (j + half) // side), []).append((i, j))
        levels.append(patches)
    rotations, radius, starts, children, child_start = [], [], [0], [], [0]
    number: dict[tuple[int, int], int] = {}
    for level, patches in enumerate(levels):
        inside: dict[tuple[int, int], int] = {}
        for members in patches.values():
            vectors = np.array(members) * step
            middle = 0.5 * (vectors.min(axis=0) + vectors.max(axis=0))
            rotations.append(exponential(np.array([middle[0], middle[1], 0.0])) if n == 3 else np.eye(n))
            radius.append(float(np.linalg.norm(vectors - middle, axis=1).max()))
            if level:
                children += sorted({number[m] for m in members})
            child_start.append(len(children))
            inside.update({m: len(rotations) - 1 for m in members})
        number = inside
        starts.append(len(rotations))
    return np.array(rotations), np.array(radius), np.array(starts), np.array(children, np.int64), np.array(child_start)
