"""Branch and bound for one scan in one map: which pose of a region scores best, and how good any other can be.

It goes in three steps. All blocks of shifts of a high level are bounded for all cells of rotations, and those of lower
levels where many are left: that is quickest done at once (``sheets``). A first quick look at the best of them finds a
good pose. With its score most of what is left can be dropped, and what cannot is searched to the bottom.
"""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import TooLargeError
from hexmap.poses.pose import Pose
from localisation.matching.pyramid import FARTHEST_PART
from localisation.matching.rotation_cells import cut_rotations
from localisation.matching.search_region import SearchRegion
from localisation.matching.search_space import SearchSpace, region_box, scan_arrays, stops_within
from localisation.matching.sheets import Sheet

__all__ = ["BranchAndBound", "Found"]

# Nodes between two looks at the clock.
_SLICE = 1 << 18
# Look-ups and blocks that the level may cost which the search begins with: some milliseconds.
_FIRST_ADDS = 1 << 27
# The same for a level below it: some tenths of a second.
_MOST_ADDS = 1 << 35
_MOST_FIRST_BLOCKS = 1 << 23
_MOST_BLOCKS = 1 << 26
# A loop over a row of a sheet costs as much to begin as so many additions of bytes, and a look-up by itself as much
# as so many of them.
_ROW = 250
_LOOK_UP = 200
# Rows of bounds that are held at once.
_BATCH_BLOCKS = 1 << 21
_MOST_NODES = 1 << 22
# How many nodes of each level, the lowest first, the first quick look keeps.
_WIDTHS = (64, 128, 256, 256, 256, 256, 256, 256, 256, 256)
# Slots for cells of rotations, and bytes that they may take.
_SLOTS = 2048
_EXACT_SLOTS = 1024
_SLOT_BYTES = 32 << 20
_EXACT_BYTES = 96 << 20


class Found(NamedTuple):
    """What one run of a search found: nothing where ``score`` is not more than the floor it began with."""

    score: int
    bound: int
    pose: Pose | None
    nodes: int
    finished: bool


class _Nodes(NamedTuple):
    """Nodes from which a search begins: bound, level, and yaw group, tilt, low corner of the shifts."""

    bound: IntArray
    level: IntArray
    node: IntArray


class BranchAndBound:
    """One scan in one region: the arrays that the kernels work on, for one run or two.

    Args:
        space: the map, and where the sensor may be.
        points: (P, n) in the sensor's frame, metres, one a cell.
        weights: (P,) how many points each stands for.
        region: where to look.
        step: radians between the stated yaws; None: the yaw is a continuum.
        node_limit: nodes after which a run stops, not counting those that are bounded at once; None: no limit.

    Raises:
        TooLargeError: the region has too many blocks and angles.
    """

    def __init__(
        self,
        space: SearchSpace,
        points: FloatArray,
        weights: IntArray,
        region: SearchRegion,
        step: float | None = None,
        node_limit: int | None = None,
    ) -> None:
        """Prepare the scan and choose the level that the search begins with."""
        from localisation.matching import _global_kernels as kernels

        self.space = space
        self.kernels = kernels
        self.node_limit = node_limit
        self.scan = scan_arrays(space, points, weights)
        self.points: FloatArray = self.scan.points
        self.weights = self.scan.weights.astype(np.int64)
        self.box, low, high = region_box(space, region)
        ranges = np.sqrt((self.points**2).sum(axis=1))
        farthest = float(ranges.max())
        radian = float(space.row_norms.max())
        self.motion = max(max(float(np.median(ranges)), farthest / FARTHEST_PART) * radian, 1e-9)
        extent = int((high - low).max()) + 1 if (high >= low).all() else 0
        highest = max(1, min(extent.bit_length() - 2, space.pyramid.levels - 1))
        self.rotations = cut_rotations(region, space.lattice.dim, self.motion, highest, step)
        self._choose_level(low, high, highest)
        self.candidates = 0 if step is None else self._candidates(low, high)
        self.reach = math.ceil(farthest * radian) + 8 + 4 * (1 << self.top)
        pyramid = space.pyramid
        self.reach += int(max((pyramid.low - self.low).max(), (high - pyramid.high).max(), 0))
        self.tables = pyramid.tables(self.reach)
        # Both runs of a search share the cells of rotations and the bounds of the first level.
        self._room = 0
        self._slots: Any = None
        self._first: NDArray[np.int32] | None = None

    # ------------------------------------------------------------------ layout

    def _choose_level(self, low: IntArray, high: IntArray, highest: int) -> None:
        """Begin with the lowest level that can be bounded as a whole in little time."""
        n = len(low)
        for level in range(1, highest + 1):
            self.top = level
            size = 1 << level
            # Blocks lie where those of the known cells do.
            self.low = self.space.low + ((low - self.space.low) >> level << level)
            self.blocks = np.maximum(0, -(-(high - self.low + 1) // size)) if (high >= low).all() else np.zeros(n, int)
            cells = self._rotation_count(level)
            blocks = math.prod(int(b) for b in self.blocks)
            if cells * blocks <= _MOST_FIRST_BLOCKS and cells * blocks * len(self.points) <= _FIRST_ADDS:
                break
        if cells * blocks > _MOST_BLOCKS:
            raise TooLargeError(f"a region of {cells * blocks:,} blocks of shifts and angles is too large for a search")

    def _groups(self, level: int) -> int:
        return -(-self.rotations.count // int(self.rotations.group[level]))

    def _rotation_count(self, level: int) -> int:
        starts = self.rotations.tilt_start
        return self._groups(level) * int(starts[level + 1] - starts[level])

    def _candidates(self, low: IntArray, high: IntArray) -> int:
        tilts = int(self.rotations.tilt_start[1])
        return math.prod(int(v) for v in np.maximum(0, high - low + 1)) * self.rotations.count * tilts

    def _arcs(self, room: int) -> Any:
        """Return empty slots; the memory is kept for the next search of the thread."""
        count, n = self.points.shape
        slots = max(64, min(_SLOTS, _SLOT_BYTES // (count * n * 4)))
        exact = max(16, min(_EXACT_SLOTS, _EXACT_BYTES // (room * (n * 4 + 20) + count * (n * 4 + 8))))
        # A narrow window has few cells of rotations: twice to four times as many slots, so that few share one; by
        # powers of two, so that the next scan finds as many.
        cells = [self._rotation_count(level) for level in range(self.top + 1)]
        slots = min(slots, max(64, 2 << sum(cells).bit_length()))
        exact = min(exact, max(16, 2 << cells[0].bit_length()))
        key = (slots, exact, count, n, room)
        scratch = self.space.scratch
        if scratch.key != key:
            shapes = {
                "tag": ((slots,), np.int64), "covered": ((slots,), np.bool_), "rows": ((slots, count, n), np.int32),
                "kind": ((count,), np.int32), "exact_tag": ((exact,), np.int64),
                "exact": ((exact, count, n), np.int32), "begin": ((exact, count + 1), np.int64),
                "entered": ((exact, room, n), np.int32), "angle": ((exact, room), np.float64),
                "owner": ((exact, room), np.int32), "order": ((exact, room), np.int64),
            }  # fmt: skip
            scratch.arcs = self.kernels.Arcs(**dict(zip(shapes, scratch.arrays(*shapes.values()), strict=True)))
            scratch.key = key
        scratch.arcs.tag[:] = -1
        scratch.arcs.exact_tag[:] = -1
        return scratch.arcs

    # ------------------------------------------------------------------ running

    def run(self, floor: int, end: float = math.inf, away: tuple[Pose, tuple[float, float]] | None = None) -> Found:
        """Find the best pose that scores more than ``floor``.

        Args:
            floor: no pose is looked for that scores no more.
            end: of the time, by ``time.monotonic``.
            away: a pose with the metres and radians around it that are left out.
        """
        room = 4 * len(self.points) + 64
        while True:
            found = self._run(floor, end, away, room)
            if found is not None:
                return found
            room *= 4  # cells so thin that arcs cross more faces than there was room for

    def _run(self, floor: int, end: float, away: tuple[Pose, tuple[float, float]] | None, room: int) -> Found | None:
        k = self.kernels
        n = self.points.shape[1]
        region = k.RegionArrays(
            self.low, self.blocks, self.top, self.box, *self.space.allowed,
            away=np.zeros(n) if away is None else np.array(away[0].translation),
            turned=np.eye(n) if away is None else np.array(away[0].rotation),
            apart=np.array([-1.0, 0.0] if away is None else away[1]),
        )  # fmt: skip
        state = np.zeros(6, np.int64)
        state[k.BEST] = floor
        best_node, best_yaw = np.zeros(1 + n, np.int64), np.zeros(2)
        if self._room != room:
            self._room, self._slots = room, self._arcs(room)
        fixed = (self.scan, self.space.lattice_arrays, self.rotations, self.tables, self._slots, region)
        if self._first is None:
            self._first = self._bound_all(region, end)
        roots = self._roots(fixed, state, best_node, best_yaw, end)
        if roots is None:
            return None
        stack = _stack(k, sum(self._most_children(level) for level in range(1, self.top + 1)) + 64, n)
        code = k.PAUSED
        while code == k.PAUSED:
            code = k.search(*fixed, roots.level, roots.bound, roots.node, stack, state, best_node, best_yaw, _SLICE)
            if code == k.FULL:
                return None
            spent = self.node_limit is not None and int(state[k.NODES]) >= self.node_limit
            if code == k.PAUSED and (spent or time.monotonic() > end):
                break
        return self._found(floor, state, best_node, best_yaw, stack, roots.bound, code == k.DONE)

    # ------------------------------------------------------------------ whole levels

    def _bounds(self, level: int, yaw: IntArray, tilt: IntArray) -> NDArray[np.int32]:
        """Return the bounds of all blocks of a level for some cells of rotations, in steps of a byte, (B, blocks)."""
        from localisation.matching import _sheet_kernels

        pyramid = self.space.pyramid
        sheet = self._sheet(level)
        count, n = self.points.shape
        blocks = self.blocks << (self.top - level)
        first = np.empty((len(yaw), count, n), np.int32)
        kind = np.empty((len(yaw), count), np.int32)
        covered = np.empty(len(yaw), np.bool_)
        windows = self.tables.windows[level]
        self.kernels.arc_boxes(
            self.scan, self.space.lattice_arrays, self.rotations, windows, level, yaw, tilt, first, kind, covered
        )
        runs = _runs(blocks, sheet.strides)
        lane = 65535 // -(-pyramid.most // pyramid.unit)
        weights = self.scan.weights.astype(np.uint16)
        out = np.empty((len(yaw), math.prod(int(b) for b in blocks)), np.int32)
        _sheet_kernels.add_up(
            sheet, first, kind, covered, weights, stops_within(self.weights, lane), self._most_steps(),
            self.low, blocks, runs, np.empty(int(runs.sum(axis=1).max()), np.uint16), out,
        )  # fmt: skip
        return out

    def _sheet(self, level: int) -> Sheet:
        return self.space.pyramid.sheet(level, self.reach, self.space.high - self.space.low)

    def _most_steps(self) -> int:
        """Return what all points can score, in steps of a byte."""
        return int(self.weights.sum()) * -(-self.space.pyramid.most // self.space.pyramid.unit)

    def _cells_of(self, level: int, numbers: IntArray) -> tuple[IntArray, IntArray]:
        """Return yaw groups and tilts of the cells of rotations of a level with these numbers."""
        groups = self._groups(level)
        return numbers % groups, numbers // groups + int(self.rotations.tilt_start[level])

    def _allowed(self, region: Any, level: int) -> NDArray[np.bool_]:
        blocks = self.blocks << (self.top - level)
        out = np.empty(math.prod(int(b) for b in blocks), np.bool_)
        self.kernels.allowed_blocks(self.space.lattice_arrays, region, level, self.low, blocks, out)
        return out

    def _bound_all(self, region: Any, end: float) -> NDArray[np.int32]:
        """Return the bounds of all blocks of the first level, (cells of rotations, blocks)."""
        count = self._rotation_count(self.top)
        blocks = math.prod(int(b) for b in self.blocks)
        out = np.empty((count, blocks), np.int32)
        if blocks == 0:
            return out
        allowed = self._allowed(region, self.top)
        batch = max(1, _BATCH_BLOCKS // (blocks + len(self.points)))
        for begin in range(0, count, batch):
            numbers = np.arange(begin, min(begin + batch, count))
            if time.monotonic() > end:
                out[begin:] = self._most_steps()
                break
            out[numbers] = self._bounds(self.top, *self._cells_of(self.top, numbers))
        out[:, ~allowed] = 0
        return out

    def _nodes(self, level: int, rows: NDArray[np.int32], cells: IntArray, floor: int) -> _Nodes:
        """Return the blocks of some cells of rotations whose bound passes ``floor``, in their order."""
        from localisation.matching import _sheet_kernels

        unit = self.space.pyramid.unit
        row, block, bound = _sheet_kernels.passing(rows, floor // unit)
        yaw, tilt = self._cells_of(level, cells[row])
        place = np.stack(np.unravel_index(block, tuple(self.blocks << (self.top - level))), axis=1)
        node = np.column_stack([yaw, tilt, self.low + (place << level)])
        return _Nodes(bound * unit, np.full(len(row), level), np.ascontiguousarray(node))

    def _roots(
        self, fixed: tuple[Any, ...], state: IntArray, best_node: IntArray, best_yaw: FloatArray, end: float
    ) -> _Nodes | None:
        """Return all nodes that may hold something better than the best pose so far, the best first.

        A quick look at the best nodes of a level finds a good pose, whose score most others cannot pass. Where many
        blocks of a cell of rotations are left even so, all its blocks one level down are bounded at once. None: the
        slots had no room.
        """
        k = self.kernels
        region = fixed[-1]
        assert self._first is not None
        level = self.top
        done: list[_Nodes] = []
        nodes = self._best_of_first(int(state[k.BEST]))
        while len(nodes.bound):
            if not self._probe(fixed, nodes, level, state, best_node, best_yaw):
                return None
            floor = int(state[k.BEST])
            if level == self.top:
                nodes = self._nodes(level, self._first, np.arange(len(self._first)), floor)
            else:
                nodes = _taken(nodes, nodes.bound > floor)
            if level == 1 or len(nodes.bound) > _MOST_NODES or time.monotonic() > end:
                break
            cells, row, count = np.unique(self._number(level, nodes), return_inverse=True, return_counts=True)
            adds = self._adds(level - 1)
            many = count * _LOOK_UP > adds
            below = self._rotation_count(level - 1) / self._rotation_count(level)
            if int(many.sum()) * below * adds * len(self.points) > _MOST_ADDS:
                break
            done.append(_taken(nodes, ~many[row]))
            nodes = self._next_level(region, level, _taken(nodes, many[row]), cells[many], floor)
            level -= 1
        return _by_bound([*done, nodes])

    def _best_of_first(self, floor: int) -> _Nodes:
        """Return the nodes of the first level with the largest bounds, as many as a quick look takes or some more."""
        from localisation.matching import _sheet_kernels

        assert self._first is not None
        unit = self.space.pyramid.unit
        counts = np.zeros(self._most_steps() + 1, np.int64)
        _sheet_kernels.count_bounds(self._first, counts)
        counts = counts[::-1].cumsum()
        enough = int(np.searchsorted(counts, _WIDTHS[self.top]))
        least = max(floor, (len(counts) - 1 - enough) * unit - 1)
        return self._nodes(self.top, self._first, np.arange(len(self._first)), least)

    def _probe(
        self,
        fixed: tuple[Any, ...],
        nodes: _Nodes,
        level: int,
        state: IntArray,
        best_node: IntArray,
        best_yaw: FloatArray,
    ) -> bool:
        """Look for a good pose below the best of some nodes of a level; False: the slots had no room."""
        k = self.kernels
        children = [1, *(self._most_children(below) for below in range(1, level + 1))]
        widths = np.minimum(np.array(_WIDTHS[: level + 1]), np.maximum(16, _MOST_NODES // 4 // np.array(children)))
        best = np.argsort(-nodes.bound, kind="stable")[: int(widths[level])]
        room = _stack(k, int((widths * children).max()), self.points.shape[1])
        return bool(
            k.probe(*fixed, level, nodes.bound[best], nodes.node[best], room, widths, state, best_node, best_yaw)
            != k.FULL
        )

    def _most_children(self, level: int) -> int:
        """Return how many children a node of a level can have."""
        r = self.rotations
        first, last = int(r.tilt_start[level]), int(r.tilt_start[level + 1])
        tilts = int(np.diff(r.child_start[first : last + 1]).max())
        return (int(r.group[level]) // int(r.group[level - 1]) + 1) * tilts << self.points.shape[1]

    def _number(self, level: int, nodes: _Nodes) -> IntArray:
        """Return the number of each node's cell of rotations."""
        yaw, tilt = nodes.node[:, 0], nodes.node[:, 1]
        return np.asarray((tilt - int(self.rotations.tilt_start[level])) * self._groups(level) + yaw)

    def _next_level(self, region: Any, level: int, nodes: _Nodes, cells: IntArray, floor: int) -> _Nodes:
        """Bound all blocks one level below ``level`` for the cells of rotations ``cells``, sorted, of some nodes."""
        unit = self.space.pyramid.unit
        blocks = self.blocks << (self.top - level)
        count = math.prod(int(b) for b in blocks)
        allowed = self._allowed(region, level - 1)
        row = np.searchsorted(cells, self._number(level, nodes))
        place = np.ravel_multi_index(tuple(((nodes.node[:, 2:] - self.low) >> level).T), tuple(blocks))
        n = self.points.shape[1]
        batch = max(1, (_BATCH_BLOCKS // count) >> (n + 1))
        found = [_taken(nodes, slice(0))]
        for begin in range(0, len(cells), batch):
            some = cells[begin : begin + batch]
            mine = (row >= begin) & (row < begin + batch)
            parents = np.zeros((len(some), count), np.int32)
            parents[row[mine] - begin, place[mine]] = nodes.bound[mine] // unit
            parent, below = self._children(level, some)
            rows = self._narrowed(level - 1, below, parents, parent, allowed)
            found.append(self._nodes(level - 1, rows, below, floor))
        return _Nodes(*(np.concatenate(arrays) for arrays in zip(*found, strict=True)))

    def _adds(self, level: int) -> int:
        """Return what it costs to bound all blocks of a level for a point, about, in additions of a byte.

        What a search does must not depend on the tables that scans before it have left: so it is reckoned as if rows
        were as far apart as they are long.
        """
        blocks = self.blocks << (self.top - level)
        strides = np.append(np.cumprod(2 * blocks[:0:-1])[::-1], 1)
        runs = _runs(blocks, strides)
        return int((runs[:, 1] + _ROW).sum())

    def _children(self, level: int, cells: IntArray) -> tuple[IntArray, IntArray]:
        """Return the rows of ``cells``, and the numbers of the cells of rotations one level down that lie in them."""
        r = self.rotations
        yaw, tilt = self._cells_of(level, cells)
        first = yaw * r.group[level] // r.group[level - 1]
        last = -(-np.minimum((yaw + 1) * r.group[level], r.count) // r.group[level - 1])
        groups, start = self._groups(level - 1), int(r.tilt_start[level - 1])
        parent: list[int] = []
        below: list[int] = []
        for row, (t, i, j) in enumerate(zip(tilt.tolist(), first.tolist(), last.tolist(), strict=True)):
            for child in r.children[r.child_start[t] : r.child_start[t + 1]].tolist():
                parent += [row] * (j - i)
                below += range((child - start) * groups + i, (child - start) * groups + j)
        return np.array(parent, np.int64), np.array(below, np.int64)

    def _narrowed(
        self, level: int, cells: IntArray, parents: NDArray[np.int32], parent: IntArray, allowed: NDArray[np.bool_]
    ) -> NDArray[np.int32]:
        from localisation.matching import _sheet_kernels

        rows = self._bounds(level, *self._cells_of(level, cells))
        _sheet_kernels.keep_within(rows, parents, parent, self.blocks << (self.top - level), allowed)
        return rows

    # ------------------------------------------------------------------ result

    def _found(
        self,
        floor: int,
        state: IntArray,
        best_node: IntArray,
        best_yaw: FloatArray,
        stack: Any,
        bound: IntArray,
        done: bool,
    ) -> Found:
        k = self.kernels
        score = int(state[k.BEST])
        most = max(score, int(state[k.CLOSED]))
        if not done:
            waiting = stack.bound[: state[k.USED]]
            most = max(most, int(waiting.max(initial=0)), int(bound[state[k.ROOT] :].max(initial=0)))
        nodes = int(state[k.NODES])
        if score <= floor:
            return Found(floor, most, None, nodes, done)
        yaw = 0.5 * (float(best_yaw[0]) + float(best_yaw[1]))
        n = self.points.shape[1]
        R = np.eye(n)
        R[:2, :2] = Pose.planar(0.0, 0.0, yaw).rotation
        tilt = self.rotations.tilts[best_node[0]]
        rotation = R if n == 2 else R @ tilt
        pose = Pose(rotation, self.space.lattice.centres(best_node[None, 1:])[0])
        # What is reported is what the quantiser says at this very pose.
        index = self.space.lattice.quantise((Pose(rotation, np.zeros(n))).apply(self.points)) + best_node[1:]
        score = int((self.space.pyramid.weights(index) * self.weights).sum())
        return Found(score, max(most, score), pose, nodes, done)


def _runs(blocks: IntArray, strides: IntArray) -> IntArray:
    """Return start and number of the entries to add up that hold all blocks.

    They are one run over all rows, or one over the last axes for each place along the first: whatever costs least.
    """
    best = np.zeros((0, 2), np.int64)
    least = math.inf
    starts = np.zeros(1, np.int64)
    for a in range(len(blocks)):
        count = int(((blocks[a:] - 1) * strides[a:]).sum()) + 1
        if len(starts) * (count + _ROW) < least:
            least = len(starts) * (count + _ROW)
            best = np.column_stack([starts, np.full(len(starts), count)])
        starts = (starts[:, None] + np.arange(int(blocks[a])) * int(strides[a])).ravel()
    return best


def _taken(nodes: _Nodes, which: NDArray[np.bool_] | slice) -> _Nodes:
    """Return some of the nodes."""
    return _Nodes(nodes.bound[which], nodes.level[which], nodes.node[which])


def _by_bound(parts: list[_Nodes]) -> _Nodes:
    """Return nodes by falling bound, equal ones as they come."""
    bound, level, node = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(-bound, kind="stable")
    return _Nodes(bound[order], level[order], np.ascontiguousarray(node[order]))


def _stack(kernels: Any, room: int, n: int) -> Any:
    """Return room for so many nodes."""
    level, yaw, tilt, bound = (np.empty(room, np.int64) for _ in range(4))
    return kernels.Stack(level, yaw, tilt, np.empty((room, n), np.int64), bound)
