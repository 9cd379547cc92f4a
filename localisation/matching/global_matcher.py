"""Find a scan anywhere in a map, and prove that nothing better is there.

The score of a pose is the sum of the weights of the map's cells that the scan's points fall into: with weights of one
the number of coincident lattice points (Ryde and Bruenig, section III), counted once a point. Branch and bound over
intervals of angles and boxes of shifts finds the largest, over all real angles or over a stated set of them.

What is proved, and what is not. Shifts are lattice vectors, so that translations are searched at the spacing of the
cells; the refinement goes below it. The yaw is a continuum: the largest score on any open interval between the angles
at which a point lies on the face of a cell (nearer than float64 tells, those angles belong to no cell and are left
out). In space the tilts are a grid on which neighbours move no point by more than a cell.
"""

from __future__ import annotations

import math
import threading
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import ArgumentError, TooLargeError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.rotations import exponential
from localisation.matching.beams import contradicted_share
from localisation.matching.information import score_covariance
from localisation.matching.match import Match, RunnerUp
from localisation.matching.pyramid import OccupancyPyramid, cell_reach, most_motion
from localisation.matching.refinement import refine_on
from localisation.matching.score import coincidence
from localisation.matching.search_region import SearchRegion

__all__ = ["GlobalMatcher", "match_anywhere", "thin"]

# Nodes between two looks at the clock.
_SLICE = 1 << 18
_MOST_ROOTS = 1 << 23
_MOST_NODES = 1 << 20
# Lanes of 16 bits add up 257 times a byte.
_LANE = 257
# How many nodes of each level, the lowest first, the first quick look keeps.
_WIDTHS = (64, 128, 256, 1024, 2048, 4096, 4096, 4096, 4096, 4096)
# Slots for cells of rotations, and bytes that they may take.
_SLOTS = 8192
_EXACT_SLOTS = 1024
_SLOT_BYTES = 96 << 20


class _Found(NamedTuple):
    """What one run of the search found: nothing where ``score`` is not more than the floor it began with."""

    score: int
    bound: int
    pose: Pose | None
    nodes: int
    finished: bool


def thin(points: FloatArray, lattice: Lattice) -> tuple[FloatArray, IntArray]:
    """Return one point for all that fall into one cell in the sensor's frame, their mean, and how many they are.

    Returns:
        Points (P, n) in the order of the cells' indices, and weights (P,).
    """
    index = lattice.quantise(points)
    order = np.lexsort(index.T[::-1])
    ordered = index[order]
    new = np.ones(len(order), bool)
    new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    starts = np.flatnonzero(new)
    weights = np.diff(np.append(starts, len(order)))
    return np.add.reduceat(points[order], starts, axis=0) / weights[:, None], weights


def _spread_order(count: int) -> IntArray:
    """Return 0 to ``count`` - 1 so that the first few are spread over all: the bits of a counter reversed."""
    bits = max(1, (count - 1).bit_length())
    numbers = np.arange(1 << bits)
    reverse = np.zeros_like(numbers)
    for b in range(bits):
        reverse |= ((numbers >> b) & 1) << (bits - 1 - b)
    return reverse[reverse < count]


class GlobalMatcher:
    """Finds scans in one map, on any lattice, in the plane and in space; may be shared by threads.

    Args:
        pyramid: the weights of the map's cells.
        known: the cells in which the sensor may be; None: anywhere in the box around the weights.

    Examples:
        >>> import numpy as np
        >>> from hexmap import Lattice, Pose, VoxelList
        >>> from localisation.matching import GlobalMatcher, OccupancyPyramid, coincidence
        >>> wall = np.stack([np.linspace(-2, 2, 81), np.full(81, 1.5)], axis=1)
        >>> room = np.concatenate([wall, wall[:50] * [1, -1], wall[:, ::-1], [[0.5, 0.2], [0.55, 0.2], [-1.0, 0.7]]])
        >>> cells = VoxelList.from_points(room, Lattice.named("A2", resolution=0.05))
        >>> matcher = GlobalMatcher(OccupancyPyramid(coincidence(cells)))
        >>> true = Pose.planar(0.21, -0.13, 2.5)
        >>> match = matcher.match(true.inverse().apply(room))
        >>> match.gap, match.certified, match.pose.is_close(true, metres=0.05, radians=0.03)
        (0, True, True)
    """

    def __init__(self, pyramid: OccupancyPyramid, known: VoxelList | None = None) -> None:
        """Prepare the tables of the lattice and of the cells in which the sensor may be."""
        from localisation.matching import _global_kernels as kernels
        from localisation.matching import _pyramid_kernels

        self.pyramid = pyramid
        self.lattice = lattice = pyramid.lattice
        inverse = np.ascontiguousarray(np.linalg.inv(lattice.basis))
        self._row_norms = np.linalg.norm(inverse, axis=1)
        self._lattice = kernels.LatticeArrays(
            np.array(lattice.basis, order="C"),
            np.array(inverse, order="C"),
            np.concatenate([cell_reach(lattice), self._row_norms]),
            np.array(lattice.cell.faces, np.int64, order="C"),
            np.array(lattice.cell.normals, np.float64, order="C"),
        )
        n = lattice.dim
        if known is None:
            self._low, self._high = pyramid.low, pyramid.high
            self._allowed = (np.zeros(0, np.uint8), self._low, np.zeros(1, np.int64), np.zeros((1, n), np.int64))
        else:
            index = known.index.astype(np.int64)
            self._low = index.min(axis=0) if len(index) else np.zeros(n, np.int64)
            self._high = index.max(axis=0) if len(index) else np.zeros(n, np.int64)
            shapes = [((self._high - self._low) >> level) + 1 for level in range(pyramid.levels + 1)]
            marked = []
            for level, shape in enumerate(shapes):
                marked.append(np.zeros(math.prod(int(s) for s in shape), np.uint8))
                _pyramid_kernels.mark_blocks(index, self._low, level, shape, marked[-1])
            starts = np.cumsum([0, *[len(m) for m in marked[:-1]]])
            self._allowed = (np.concatenate(marked), self._low, starts, np.array(shapes))
        self._scratch = threading.local()

    @classmethod
    def of_map(
        cls, map: Map, rule: StateRule | None = None, level: int = 0, *, anywhere: bool = False
    ) -> GlobalMatcher:
        """Return a matcher on the occupied cells of a level of a map, for a sensor in its known cells.

        Args:
            map: the map.
            rule: what an occupied cell is.
            level: of the map.
            anywhere: whether the sensor may also be where the map knows nothing.
        """
        states = map.state(rule, level)
        known = None if anywhere else states.occupied.merge(states.free)
        return cls(OccupancyPyramid(coincidence(states.occupied)), known)

    def match(
        self,
        points: ArrayLike,
        region: SearchRegion | None = None,
        *,
        angles: str | float = "continuous",
        apart: tuple[float, float] = (0.5, math.radians(10.0)),
        runner_up: float | None = 0.9,
        refine: bool = True,
        beams: bool = True,
        information: bool = True,
        time_limit: float | None = None,
        node_limit: int | None = None,
    ) -> Match | None:
        """Return the best pose of a region, or None where nothing coincides.

        Args:
            points: (P, n) the scan in the sensor's frame, metres. Points of one cell are taken as one (see
                :func:`thin`).
            region: where to look; None: the whole map and all yaws.
            angles: "continuous", or a step in radians: then the yaws are its multiples, from ``region.yaw`` on.
            apart: metres and radians within which a pose is the same as the best.
            runner_up: down to which part of the best score other poses are looked for; None: not at all.
            refine: whether the pose is refined below a cell.
            beams: whether the beams that end beyond a wall are counted.
            information: whether the surface of scores around the best pose is turned into an information matrix.
            time_limit: seconds after which the search stops; what it found until then is not certified.
            node_limit: nodes after which it stops: at the same node on every run and machine.

        Raises:
            ArgumentError: points or region are not of the map's dimension, or a number is out of its range.
            BoundsError: a point is not finite or out of range.
            TooLargeError: the region has too many blocks and angles for a search.
        """
        lattice = self.lattice
        n = lattice.dim
        p = np.ascontiguousarray(points, dtype=np.float64)
        if p.ndim != 2 or p.shape[1] != n:
            raise ArgumentError(f"the map is of dimension {n}, the scan {p.shape}")
        region = region or SearchRegion()
        _check(n, region, angles, apart, runner_up)
        if len(p) == 0 or self.pyramid.most == 0:
            return None
        end = math.inf if time_limit is None else time.monotonic() + time_limit
        kept, weights = thin(p, lattice)
        search = _Search(self, kept, weights, region, None if angles == "continuous" else float(angles))
        search.node_limit = node_limit
        best = search.run(0, end)
        if best.pose is None:
            return None
        second: _Found | None = None
        floor = 0
        if runner_up is not None and best.finished:
            floor = min(best.score, math.floor(runner_up * best.score))
            second = search.run(floor, end, (best.pose, apart))
        total = int(weights.sum()) * self.pyramid.most
        pose, refined = best.pose, False
        if refine:
            result = refine_on(self.pyramid.occupancy, p, best.pose)
            pose, refined = result.pose, result.converged
        index = lattice.quantise(best.pose.apply(kept))
        met = self.pyramid.weights(index) > 0
        covariance = None
        if information:
            covariance = score_covariance(self.pyramid, kept, weights, best.pose, refined=refined)
        return Match(
            pose=pose,
            searched=best.pose,
            score=best.score,
            total=total,
            bound=best.bound,
            certified=best.finished,
            refined=refined,
            nodes=best.nodes + (second.nodes if second else 0),
            candidates=search.candidates,
            runner_up=RunnerUp(second.pose, second.score) if second and second.pose else None,
            runner_up_bound=max(second.bound, floor) if second else None,
            apart=apart if second else None,
            overlap=float(weights[met].sum() / weights.sum()),
            contradicted=contradicted_share(self.pyramid, p, pose) if beams else None,
            information=None if covariance is None else np.asarray(np.linalg.inv(covariance), np.float64),
        )


def _check(
    n: int, region: SearchRegion, angles: str | float, apart: tuple[float, float], runner_up: float | None
) -> None:
    """Check what a match is asked for in a map of dimension ``n``.

    Raises:
        ArgumentError: a value is out of its range.
    """
    if region.tilt > 0.0 and n == 2:
        raise ArgumentError("a scan of the plane cannot be tilted")
    if not (apart[0] >= 0.0 and apart[1] >= 0.0):
        raise ArgumentError(f"a neighbourhood takes metres and radians of 0 or more, not {apart}")
    if runner_up is not None and not 0.0 <= runner_up <= 1.0:
        raise ArgumentError(f"other poses are looked for down to a share of 0 to 1 of the best score, not {runner_up}")
    if angles != "continuous" and not (isinstance(angles, (int, float)) and 0.0 < angles <= math.pi):
        raise ArgumentError(f"angles are 'continuous' or a step in radians, not {angles!r}")


class _Search:
    """One scan in one region: the arrays that the kernels work on, for one run or two."""

    def __init__(
        self, matcher: GlobalMatcher, points: FloatArray, weights: IntArray, region: SearchRegion, step: float | None
    ) -> None:
        from localisation.matching import _global_kernels as kernels

        self.matcher = matcher
        self.kernels = kernels
        lattice = matcher.lattice
        n = lattice.dim
        # A lane of a sum holds 257 bytes: heavier points go in several times.
        pieces = -(-weights // _LANE)
        repeated = np.repeat(np.arange(len(points)), pieces)
        share = weights[repeated] // pieces[repeated]
        first = np.concatenate([[0], np.cumsum(pieces)[:-1]])
        share[first] += weights - (weights // pieces) * pieces
        order = _spread_order(len(repeated))
        self.points = np.ascontiguousarray(points[repeated][order])
        self.weights = share[order]
        most = matcher.pyramid.most
        rest = np.append(np.cumsum(self.weights[::-1])[::-1], 0) * most
        inverse = self.matcher._lattice.inverse
        x, y = self.points[:, :1], self.points[:, 1:2]
        # Written out: a matrix product may round a row differently when the number of rows changes.
        waves = np.stack([x * inverse[:, 0] + y * inverse[:, 1], x * inverse[:, 1] - y * inverse[:, 0]], axis=-1)
        self.scan = kernels.ScanArrays(
            self.points, waves, self.weights.astype(np.uint64), rest, _stops(self.weights)
        )
        box = region.box(lattice)
        low, high = matcher._low, matcher._high
        if box is not None:
            corners = np.stack(np.meshgrid(*np.stack(box).T, indexing="ij"), axis=-1).reshape(-1, n)
            u = corners @ self.matcher._lattice.inverse.T
            low = np.maximum(low, np.floor(u.min(axis=0) - 1e-9).astype(np.int64))
            high = np.minimum(high, np.ceil(u.max(axis=0) + 1e-9).astype(np.int64))
            self.box = np.stack(box)
        else:
            self.box = np.array([np.full(n, -np.inf), np.full(n, np.inf)])
        extent = int((high - low).max()) + 1 if (high >= low).all() else 0
        self.top = min(max(1, extent.bit_length() - 5), matcher.pyramid.levels - 1)
        size = 2 << self.top
        # Blocks lie where those of the known cells do.
        self.low = matcher._low + (low - matcher._low) // size * size
        self.blocks = np.maximum(0, -(-(high - self.low + 1) // size)) if extent else np.zeros(n, np.int64)
        farthest = math.sqrt(float((self.points**2).sum(axis=1).max()))
        self.motion = max(farthest * float(matcher._row_norms.max()), 1e-9)
        self.rotations = self._rotations(region, step)
        self.candidates = 0 if step is None else self._candidates(low, high)
        reach = math.ceil(self.motion) + 8 + 2 * size
        beyond = int(max((matcher.pyramid.low - self.low).max(), (high - matcher.pyramid.high).max(), 0))
        self.tables = matcher.pyramid.tables(reach + beyond)
        # Both runs of a search share the cells of rotations and the nodes of the top level.
        self.node_limit: int | None = None
        self._room = 0
        self._slots: Any = None
        self._roots: tuple[IntArray, IntArray] | None = None

    def _candidates(self, low: IntArray, high: IntArray) -> int:
        tilts = int(self.rotations.tilt_start[1])
        return math.prod(int(v) for v in np.maximum(0, high - low + 1)) * self.rotations.count * tilts

    def _rotations(self, region: SearchRegion, step: float | None) -> Any:
        """Return the cells of rotations, level by level."""
        n = self.matcher.lattice.dim
        span = 2.0 * region.yaw_range
        continuous = step is None and span > 0.0
        if continuous:
            count = max(1, math.ceil(span * self.motion))
            unit, first = span / count, region.yaw - region.yaw_range
        else:
            unit = step if step is not None else 1.0
            if region.yaw_range >= math.pi:
                count, first = math.ceil(span / unit - 1e-9), region.yaw
            else:
                half = math.floor(region.yaw_range / unit + 1e-9)
                count, first = 2 * half + 1, region.yaw - half * unit
        if count >= 1 << 26:
            raise TooLargeError(f"{count:,} angles are too many for a search")
        group = [1]
        for level in range(1, self.top + 1):
            # The arc over a group moves the farthest point by no more than the tables were made for.
            room = most_motion(level) / (unit * self.motion)
            units = room if continuous else room + 1.0
            group.append(max(group[-1], 1 << max(0, math.floor(math.log2(units) + 1e-9)) if units >= 1.0 else 1))
        tilts, radius, starts, children, child_start = _tilts(n, region.tilt, self.motion, self.top)
        return self.kernels.RotationArrays(
            float(first), float(unit), count, continuous, np.array(group), tilts, radius, starts, children, child_start
        )

    def _arcs(self, room: int) -> Any:
        """Return empty slots; the arrays are kept for the next scan of the thread."""
        n = self.points.shape[1]
        count = len(self.points)
        slots = max(64, min(_SLOTS, _SLOT_BYTES // (count * n * 4)))
        exact = max(16, min(_EXACT_SLOTS, _SLOT_BYTES // (room * (n * 4 + 20) + count * (n * 4 + 8))))
        key = (slots, exact, count, n, room)
        scratch = self.matcher._scratch
        if getattr(scratch, "key", None) != key:
            scratch.arcs = self.kernels.Arcs(
                tag=np.empty(slots, np.int64),
                covered=np.empty(slots, np.bool_),
                rows=np.empty((slots, count, n), np.int32),
                exact_tag=np.empty(exact, np.int64),
                exact=np.empty((exact, count, n), np.int32),
                begin=np.empty((exact, count + 1), np.int64),
                entered=np.empty((exact, room, n), np.int32),
                angle=np.empty((exact, room), np.float64),
                owner=np.empty((exact, room), np.int32),
                order=np.empty((exact, room), np.int64),
            )
            scratch.key = key
        scratch.arcs.tag[:] = -1
        scratch.arcs.exact_tag[:] = -1
        return scratch.arcs

    def run(self, floor: int, end: float, away: tuple[Pose, tuple[float, float]] | None = None) -> _Found:
        """Find the best pose that scores more than ``floor``, outside the neighbourhood of ``away`` if it is given."""
        room = 4 * len(self.points) + 64
        while True:
            found = self._run(floor, end, away, room)
            if found is not None:
                return found
            room *= 4  # cells so thin that arcs cross more faces than there was room for

    def _run(self, floor: int, end: float, away: tuple[Pose, tuple[float, float]] | None, room: int) -> _Found | None:
        k = self.kernels
        n = self.points.shape[1]
        region = k.RegionArrays(
            self.low, self.blocks, self.top, self.box, *self.matcher._allowed,
            away=np.zeros(n) if away is None else np.array(away[0].translation),
            turned=np.eye(n) if away is None else np.array(away[0].rotation),
            apart=np.array([-1.0, 0.0] if away is None else away[1]),
        )  # fmt: skip
        state = np.zeros(6, np.int64)
        state[k.BEST] = floor
        best_node, best_yaw = np.zeros(1 + n, np.int64), np.zeros(2)
        if self._room != room:
            self._room, self._slots, self._roots = room, self._arcs(room), None
        fixed = (self.scan, self.matcher._lattice, self.rotations, self.tables, self._slots, region)
        if self._roots is None:
            self._roots = self._all_roots(fixed)
        if self._roots is None:
            return None
        bound, node = self._roots
        passing = int(np.searchsorted(-bound, -floor, side="left"))
        bound, node, level = bound[:passing], node[:passing], self.top
        nodes = _stack(k, _MOST_NODES, n)
        children = k.most_children(self.rotations, self.top, n)
        widths = np.minimum(np.array(_WIDTHS[: self.top + 1]), max(16, (_MOST_NODES // 4) // children))
        if k.probe(*fixed, bound, node, nodes, widths, state, best_node, best_yaw) == k.FULL:
            return None
        taken, used, fits = k.deepen(*fixed, bound, node, 0, nodes, 0, state)
        if not fits:
            return None
        if taken == len(bound):
            order = np.argsort(-nodes.bound[:used], kind="stable")
            bound, level = nodes.bound[order], self.top - 1
            node = np.column_stack([nodes.yaw[order], nodes.tilt[order], nodes.shift[order]])
        depth = (self.top + 2) * children + 64
        stack = _stack(k, depth, n)
        code = k.PAUSED
        while code == k.PAUSED:
            code = k.search(*fixed, level, bound, node, stack, state, best_node, best_yaw, _SLICE)
            if code == k.FULL:
                return None
            spent = self.node_limit is not None and int(state[k.NODES]) >= self.node_limit
            if code == k.PAUSED and (spent or time.monotonic() > end):
                break
        return self._found(floor, state, best_node, best_yaw, stack, bound, code == k.DONE)

    def _all_roots(self, fixed: tuple[Any, ...]) -> tuple[IntArray, IntArray] | None:
        """Return bounds and nodes of the top level, the best first; None where the slots had no room."""
        k = self.kernels
        n = self.points.shape[1]
        groups = -(-self.rotations.count // int(self.rotations.group[self.top]))
        tilts = int(self.rotations.tilt_start[self.top + 1] - self.rotations.tilt_start[self.top])
        most = math.prod(int(b) for b in self.blocks) * groups * tilts << n
        if most > _MOST_ROOTS:
            raise TooLargeError(f"a region of {most:,} blocks of shifts and angles is too large for a search")
        bound, node = np.empty(most, np.int64), np.empty((most, 2 + n), np.int64)
        used = k.roots(*fixed, 0, bound, node)
        if used < 0:
            return None
        order = np.argsort(-bound[:used], kind="stable")
        return bound[:used][order], node[:used][order]

    def _found(
        self,
        floor: int,
        state: IntArray,
        best_node: IntArray,
        best_yaw: FloatArray,
        stack: Any,
        bound: IntArray,
        done: bool,
    ) -> _Found:
        k = self.kernels
        score = int(state[k.BEST])
        most = max(score, int(state[k.CLOSED]))
        if not done:
            waiting = stack.bound[: state[k.USED]]
            most = max(most, int(waiting.max(initial=0)), int(bound[state[k.ROOT] :].max(initial=0)))
        nodes = int(state[k.NODES])
        if score <= floor:
            return _Found(floor, most, None, nodes, done)
        yaw = 0.5 * (float(best_yaw[0]) + float(best_yaw[1]))
        n = self.points.shape[1]
        R = np.eye(n)
        R[:2, :2] = Pose.planar(0.0, 0.0, yaw).rotation
        tilt = self.rotations.tilts[best_node[0]]
        rotation = R if n == 2 else R @ tilt
        pose = Pose(rotation, self.matcher.lattice.centres(best_node[None, 1:])[0])
        # What is reported is what the quantiser says at this very pose.
        index = self.matcher.lattice.quantise((Pose(rotation, np.zeros(n))).apply(self.points)) + best_node[1:]
        score = int((self.matcher.pyramid.weights(index) * self.weights).sum())
        return _Found(score, max(most, score), pose, nodes, done)


def _stack(kernels: Any, room: int, n: int) -> Any:
    """Return room for so many nodes."""
    level, yaw, tilt, bound = (np.empty(room, np.int64) for _ in range(4))
    return kernels.Stack(level, yaw, tilt, np.empty((room, n), np.int64), bound)


def _stops(weights: IntArray) -> IntArray:
    """Return after how many points a sum is looked at: every 16, sooner where lanes of 16 bits would overflow."""
    stops: list[int] = []
    total = 0
    for p, w in enumerate(weights.tolist()):
        if total + w > _LANE or (stops and p - stops[-1] >= 16) or (not stops and p >= 16):
            stops.append(p)
            total = 0
        total += w
    return np.array([*stops, len(weights)])


def _tilts(n: int, tilt: float, motion: float, top: int) -> tuple[NDArray[Any], ...]:
    """Return rotations, radii, starts by level, children and their starts of the patches of tilts.

    The tilts are a square grid of rotation vectors about horizontal axes in the disc of radius ``tilt``; its step
    moves the farthest point by one index. A patch of a higher level holds a square of them that moves it by no more
    than the tables were made for.
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


def match_anywhere(map: Map, points: ArrayLike, **how: Any) -> Match | None:
    """Find a scan in a map without knowing anything of where it is.

    For many scans of one map make a :class:`GlobalMatcher` once.

    Args:
        map: the map.
        points: (P, n) the scan in the sensor's frame, metres.
        **how: what :meth:`GlobalMatcher.match` takes.

    Returns:
        The best pose of the sensor, T_map_scan, and what is known of it; None where nothing coincides.
    """
    return GlobalMatcher.of_map(map).match(points, **how)
