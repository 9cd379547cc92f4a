"""Maps of simulated drives against exact truth: errors, loops found of those there were, what ellipses hold."""

from __future__ import annotations

import gc
import math
import resource
import time
from dataclasses import dataclass

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.poses.scan import Scan
from hexmap.simulator.events import simulate
from hexmap.simulator.laser import Laser
from localisation.settings import MappingSettings
from localisation.slam import planar
from localisation.slam.slam import Slam, SlamResult
from tests.benchmarks._common import table
from tests.benchmarks.buildings import KINDS, made_by_seed

__all__ = ["large_building", "simulated"]

# A loop that is farther off than this has put two places together that are not the same.
_FALSE = 0.5
# A node is a visit to an old place within so many metres of an old node, after so many metres of way.
_SAME_PLACE = 2.0
_WAY_BETWEEN = 20.0
# Squared radius of the ellipsoid that holds 95 % of a normal error of three degrees of freedom.
_HELD = 7.815


@dataclass(frozen=True, eq=False)
class Run:
    """What a drive showed.

    Attributes:
        error: (N,) metres by which every pose of a reading is off, seen from the first.
        chain: squared normalised errors of the edges from node to node.
        loops: those of the loops.
        off: (L,) metres by which each loop is off.
        poses: squared normalised errors of the nodes' poses.
        visits: how often an old place was visited again and found: found and all, in the old direction and in others.
        seconds: of the processor, without simulating.
        scans: how many.
    """

    error: FloatArray
    chain: FloatArray
    loops: FloatArray
    off: FloatArray
    poses: FloatArray
    visits: tuple[int, int, int, int]
    seconds: float
    scans: int


def simulated(seeds: int = 20, kinds: tuple[str, ...] = KINDS) -> None:
    """Print errors against exact truth, loops found and false, and how many poses their 95 % ellipses hold."""
    rows: list[list[object]] = [
        ["simulated", "runs", "mean m", "median worst m", "worst m", "loops", "false", "same way", "other way",
         "edges in 95 %", "loops in 95 %", "poses in 95 %", "s a run"],
    ]  # fmt: skip
    every: list[Run] = []
    for kind in kinds:
        runs = [run_of(kind, seed) for seed in range(seeds)]
        # A mapper and its parts know one another: without this dozens of them are in memory at a time.
        gc.collect()
        every += runs
        rows.append([kind, *_row(runs)])
    rows.append(["all", *_row(every)])
    print("visits of old places: found of all there were, in the old direction and in others\n")
    table(rows)


def _row(runs: list[Run]) -> list[object]:
    error, chain, loops, off, poses = (
        np.concatenate([getattr(run, name) for run in runs]) for name in ("error", "chain", "loops", "off", "poses")
    )
    held = [float((column < _HELD).mean()) if len(column) else math.nan for column in (chain, loops, poses)]
    same, all_same, other, all_other = np.sum([run.visits for run in runs], axis=0).tolist()
    worst = float(np.median([run.error.max() for run in runs]))
    seconds = float(np.mean([run.seconds for run in runs]))
    return [len(runs), error.mean(), worst, error.max(), len(loops), int((off > _FALSE).sum()),
            f"{same}/{all_same}", f"{other}/{all_other}", *held, seconds]  # fmt: skip


def large_building(seed: int = 0) -> None:
    """Print what a drive of two kilometres through a building of 230 x 200 m gives, with loops of 500 m."""
    run = run_of("large", seed)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    rows = [
        ["230 x 200 m", "scans", "CPU s", "ms a scan", "peak MB"],
        [f"seed {seed}", run.scans, run.seconds, 1e3 * run.seconds / run.scans, peak],
    ]
    table(rows)
    simulated_rows = [["", "runs", "mean m", "median worst m", "worst m", "loops", "false", "same way", "other way",
                       "edges in 95 %", "loops in 95 %", "poses in 95 %", "s a run"]]  # fmt: skip
    table([*simulated_rows, [f"seed {seed}", *_row([run])]])


def run_of(kind: str, seed: int) -> Run:
    """Map a drive through a building that a seed makes."""
    laser = Laser(beams=181, rate=2.0)
    slam = Slam(MappingSettings(mount=tuple(planar.of_pose(laser.mount))))
    truth, seconds = [], 0.0
    for event in simulate(made_by_seed(kind, seed), laser, seed=seed):
        truth.append(planar.of_pose(event.T_map_robot))
        begin = time.process_time()
        if isinstance(event.event, Scan):
            slam.register(event.event)
        else:
            slam.observe(event.event)
        seconds += time.process_time() - begin
    begin = time.process_time()
    result = slam.finish()
    seconds += time.process_time() - begin
    true = planar.between(np.broadcast_to(truth[0], (len(truth), 3)), np.array(truth))
    off = planar.between(true, result.poses)
    at = np.flatnonzero(result.is_scan)[result.node_scans]
    chain, loops, metres = [], [], []
    for edge, weight in zip(result.graph.edges, result.graph.weights, strict=True):
        d = planar.between(planar.between(true[at[edge.i]], true[at[edge.j]]), edge.pose)
        squared = float(d @ np.linalg.solve(edge.covariance, d))
        if not edge.loop:
            chain.append(squared)
        elif weight > 0.0:
            loops.append(squared)
            metres.append(math.hypot(d[0], d[1]))
    poses = [float(off[k] @ np.linalg.solve(result.covariances[k], off[k])) for k in at[1:]]
    error = np.hypot(off[:, 0], off[:, 1])
    visits = _visits(result, true[at])
    return Run(error, *(np.array(v) for v in (chain, loops, metres, poses)), visits, seconds, len(result.scans))


def _visits(result: SlamResult, nodes: FloatArray) -> tuple[int, int, int, int]:
    """Return how many visits of old places were found and how many there were: in the old direction, then in others.

    A visit is a row of nodes near old ones; it is found where a loop from one of them, or from a neighbour, is true.
    """
    steps = np.hypot(*np.diff(nodes[:, :2], axis=0).T)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    near = np.hypot(*(nodes[:, None, :2] - nodes[None, :, :2]).transpose(2, 0, 1)) < _SAME_PLACE
    near &= way[:, None] - way[None, :] > _WAY_BETWEEN
    turned = np.abs((nodes[:, None, 2] - nodes[None, :, 2] + math.pi) % (2.0 * math.pi) - math.pi)
    same = (near & (turned < 0.25 * math.pi)).any(axis=1)
    closed = np.zeros(len(nodes) + 2, np.bool_)
    for record in result.records:
        if record.accepted and record.j < len(nodes):
            closed[[record.j - 1, record.j, record.j + 1]] = True
    out = []
    for visited in (same, near.any(axis=1) & ~same):
        rows = np.flatnonzero(visited)
        runs = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else []
        out += [sum(bool(closed[run].any()) for run in runs), len(runs)]
    return out[0], out[1], out[2], out[3]
