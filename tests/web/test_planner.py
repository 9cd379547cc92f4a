"""The page's planner, run in Node, finds paths that cost what the library's do."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import planners
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from hexmap.web.payload import lattice_numbers
from tests.lattices import LONG, PLANAR
from tests.web.node import needs_node, run

pytestmark = needs_node

SHEARED = Lattice([[1.0, 3.0], [0.0, 1.0]], "sheared squares")
LATTICES = [*(case.lattice for case in PLANAR), SHEARED]
QUERIES = 1_700 if LONG else 40  # of each of three robots and two neighbourhoods: 10^4 a lattice
LOOKED_AT = 40  # of them cell by cell
SHAPE = (56, 64)
LOW = np.array([-20, -31])


def world(lattice: Lattice) -> tuple[np.ndarray, Map]:
    """Return states of a window, a fifth of it walls of a few cells, and the map that has them."""
    rng = np.random.default_rng(7)
    states = np.ones(SHAPE, np.uint8)
    states[rng.random(SHAPE) < 0.02] = 0
    for row, column in rng.integers(0, np.array(SHAPE) - 4, (60, 2)):
        tall, wide = rng.integers(1, 5, 2)
        states[row : row + tall, column : column + wide] = 2
    index = np.indices(SHAPE).reshape(2, -1).T + LOW
    lists = [VoxelList.from_cells(index[states.ravel() == state], lattice) for state in (2, 1)]
    return states, Map([Level(*lists)])


def in_node(
    folder: Path, lattice: Lattice, states: np.ndarray, name: str, settings: list[dict[str, Any]], queries: Any
) -> Any:
    """Return what the page's planner answers: a list for each setting."""
    numbers = lattice_numbers(lattice) | {"origin": [0.0, 0.0]}
    given = {
        "level": numbers,
        "neighbourhood": next(n for n in numbers["neighbourhoods"] if n["name"] == name),
        "states": base64.b64encode(states.tobytes()).decode(),
        "low": LOW.tolist(),
        "high": (LOW + SHAPE - 1).tolist(),
        "settings": settings,
        "queries": queries,
    }
    return run(folder, ["lattice.js", "planner.js", "sight.js"], "plan_many.js", given)


def answer_of(plan: Any, graph: LatticeGraph, start: list[int], goal: list[int]) -> Any:
    """Return the library's path, or why there is none."""
    try:
        return plan(graph, start, goal)
    except planners.NoPath as error:
        return error.reason


@pytest.mark.parametrize("lattice", LATTICES, ids=lambda lattice: lattice.name)
@pytest.mark.parametrize("name", ["neighbours", "extended"])
def test_costs_are_those_of_the_library(tmp_path: Path, lattice: Lattice, name: str) -> None:
    states, map_ = world(lattice)
    r = lattice.resolution
    settings = [
        {"radius": 0.0, "weight": 0.0, "reach": 1.0},
        {"radius": 0.8 * r, "weight": 0.0, "reach": 1.0},
        {"radius": 0.6 * r, "weight": 3.0, "reach": 3.5 * r},
    ]
    rng = np.random.default_rng(11)
    known = np.argwhere(states > 0) + LOW
    queries = [[known[i].tolist(), known[j].tolist()] for i, j in rng.integers(0, len(known), (QUERIES, 2))]
    answers = in_node(tmp_path, lattice, states, name, settings, queries)
    plain = LatticeGraph.from_map(map_, neighbourhood=len(getattr(lattice, name)))
    found = 0
    for setting, replies in zip(settings, answers, strict=True):
        graph = plain.with_clearance(setting["radius"], to="cell")
        if setting["weight"]:
            graph = graph.with_soft_clearance(setting["reach"], setting["weight"], to="cell")
        for k, ((start, goal), reply) in enumerate(zip(queries, replies, strict=True)):
            path = answer_of(planners.astar, graph, start, goal)
            if isinstance(path, str):
                assert reply == ({"cost": None} if path == "not connected" else {"blocked": True})
                continue
            found += 1
            assert reply["cost"] == pytest.approx(path.cost, rel=1e-12, abs=1e-12)
            if k >= LOOKED_AT:
                continue
            cells = np.array(reply["cells"])
            assert cells[0].tolist() == start and cells[-1].tolist() == goal
            if len(cells) > 1:
                assert np.all(planners.line_of_sight(graph, cells[:-1], cells[1:]))
            least = plain.clearance_at(plain.index_to_flat(cells), to="cell").min()
            assert reply["clearance"] == pytest.approx(least, abs=1e-9)
    assert found > QUERIES


@pytest.mark.parametrize("lattice", LATTICES, ids=lambda lattice: lattice.name)
def test_any_angle_paths_are_free_and_no_longer_than_those_of_moves(tmp_path: Path, lattice: Lattice) -> None:
    states, map_ = world(lattice)
    rng = np.random.default_rng(13)
    known = np.argwhere(states == 1) + LOW
    count = max(30, QUERIES // 10)
    queries = [[known[i].tolist(), known[j].tolist()] for i, j in rng.integers(0, len(known), (count, 2))]
    setting = {"radius": 0.0, "weight": 0.0, "reach": 1.0, "anyAngle": True}
    (replies,) = in_node(tmp_path, lattice, states, "neighbours", [setting], queries)
    graph = LatticeGraph.from_map(map_)
    mine = theirs = 0.0
    for (start, goal), reply in zip(queries, replies, strict=True):
        path = answer_of(planners.any_angle, graph, start, goal)
        if isinstance(path, str) or start == goal:
            continue
        cells = np.array(reply["cells"])
        assert np.all(planners.line_of_sight(graph, cells[:-1], cells[1:]))
        length = float(np.linalg.norm(np.diff(lattice.centres(cells), axis=0), axis=1).sum())
        assert length <= planners.astar(graph, start, goal).length * (1 + 1e-9)
        mine, theirs = mine + length, theirs + path.length
    assert 0 < mine <= 1.01 * theirs
