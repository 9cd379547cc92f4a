"""Replanning against planning anew: after every change the path costs what A* finds, and is valid."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from hexmap.base.errors import ArgumentError
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.lattice.lattice import Lattice
from planners import NoPath, Path, astar
from planners.replanning import dstar_lite
from planners.replanning.policy import ReplanningPolicy
from planners.replanning.replanner import Replanner
from tests.lattices import CASES, EXAMPLES, JIT, Case

NEIGHBOURHOODS = (None, "nearest", "faces", "extended")
ALL = list(itertools.product(CASES, NEIGHBOURHOODS))
IDS = [f"{case}-{nb}" for case, nb in ALL]
BARS = 40 if JIT else 8  # changes a window in the bulk


def check_path(graph: LatticeGraph, path: Path, start: Any, goal: Any) -> None:
    """Hold a path to moves that are allowed, from the start to the goal, and to the cost of these."""
    assert (path.cells[0] == start).all() and (path.cells[-1] == goal).all()
    number = {tuple(move): k for k, move in enumerate(graph.moves.tolist())}
    flat = graph.index_to_flat(path.cells)
    assert (flat >= 0).all() and graph.free[flat].all()
    legs = []
    for (a, u), (b, v) in itertools.pairwise(zip(flat.tolist(), path.cells.tolist(), strict=True)):
        k = number[tuple(y - x for x, y in zip(u, v, strict=True))]  # KeyError: not a move
        assert all(graph.free[a + s] for s in graph.swept[graph.swept_starts[k] : graph.swept_starts[k + 1]])
        mean = 1.0 if graph.terrain is None else (graph.terrain[a] + graph.terrain[b]) / 2
        legs.append(graph.lengths[k] * mean)
    assert path.cost == pytest.approx(math.fsum(legs), rel=1e-12, abs=1e-15)


def check(robot: Replanner, free: np.ndarray, start: Any, goal: Any) -> Path | None:
    """Hold the replanner to what planning anew finds, errors included; return its path."""
    graph = robot.graph
    assert (graph.inner_states() == free).all()
    try:
        expected = astar(graph, start, goal)
    except NoPath as error:
        with pytest.raises(NoPath) as caught:
            robot.path()
        assert (caught.value.reason, str(caught.value)) == (error.reason, str(error))
        return None
    path = robot.path()
    if graph.terrain is None:
        assert path.cost == expected.cost  # to the last bit
    else:
        assert path.cost == pytest.approx(expected.cost, rel=1e-12, abs=1e-15)
    check_path(graph, path, start, goal)
    return path


def window(case: Case, neighbourhood: Any, rng: np.random.Generator, obstacles: float, terrain: bool) -> LatticeGraph:
    """A random window around a random index."""
    shape = rng.integers(2, 12 if case.dim == 2 else 7, case.dim)
    graph = LatticeGraph.from_states(
        case.lattice, rng.integers(-20, 20, case.dim), rng.random(shape) >= obstacles, neighbourhood=neighbourhood
    )
    if terrain:
        values = rng.integers(1, 4, shape) if rng.random() < 0.5 else rng.uniform(0.5, 9.0, shape)
        graph = graph.with_terrain(values.astype(np.float64))
    return graph


def wander(robot: Replanner, graph: LatticeGraph, start: Any, goal: Any, seed: int, changes: int) -> list[float]:
    """Change cells at random in all ways there are, drive along the path, and check every time."""
    rng = np.random.default_rng(seed)
    free = graph.inner_states().copy()
    n = graph.lattice.dim
    costs = []
    path = check(robot, free, start, goal)

    def cells(count: int) -> Any:
        return graph.first + rng.integers(0, graph.inner_shape, (count, n))

    def put(at: Any, states: Any) -> None:
        for cell, state in zip(at - graph.first, np.broadcast_to(states, len(at)), strict=True):
            free[tuple(cell)] = state

    for _ in range(changes):
        kind = rng.integers(8)
        if kind == 0 and path is not None:  # on the path, then free again
            at = path.cells[rng.integers(0, len(path), 1)].astype(np.int64)
            robot.block(at)
            put(at, 0)
            check(robot, free, start, goal)
            robot.free(at)
            put(at, 1)
        elif kind == 1:  # a wall through the whole window, with a door now and then
            axis = int(rng.integers(n))
            at = graph.first + np.indices(graph.inner_shape).reshape(n, -1).T
            at = at[at[:, axis] == graph.first[axis] + rng.integers(graph.inner_shape[axis])]
            states = rng.random(len(at)) < rng.choice([0.0, 0.1, 1.0])
            robot.set_cells(at, states)
            put(at, states)
        elif kind == 2:  # cells that toggle within the batch
            at = np.repeat(cells(3), 3, axis=0)[rng.permutation(9)]
            states = rng.random(9) < 0.6
            robot.set_cells(at, states)
            put(at, states)
        elif kind == 3:  # batches that undo one another
            at = cells(4)
            robot.block(at)
            robot.free(at)
            put(at, 1)
        elif kind == 4:  # a jump of the robot
            start = cells(1)[0]
            robot.move_to(start)
        elif kind == 5 and path is not None:  # along the path
            start = path.cells[min(int(rng.integers(1, 4)), len(path) - 1)]
            robot.move_to(start)
        elif kind == 6 and graph.terrain is not None:
            at = cells(int(rng.integers(1, 5)))
            robot.set_terrain(at, rng.choice([0.5, 1.0, 1.5, 2.0, 3.0, 7.3, 12.0], len(at)))
        else:
            at = cells(int(rng.choice([1, 1, 2, 6])))
            states = rng.random(len(at)) < 0.65
            robot.set_cells(at, states)
            put(at, states)
        path = check(robot, free, start, goal)
        costs.append(-1.0 if path is None else path.cost)
    return costs


@pytest.mark.parametrize(("case", "neighbourhood"), ALL, ids=IDS)
@pytest.mark.parametrize("terrain", [False, True], ids=["plain", "terrain"])
def test_every_change_costs_what_planning_anew_costs(case: Case, neighbourhood: Any, terrain: bool) -> None:
    for seed in range(2 if JIT else 1):
        rng = np.random.default_rng([seed, len(IDS)])
        graph = window(case, neighbourhood, rng, float(rng.choice([0.1, 0.3])), terrain)
        start, goal = graph.first + rng.integers(0, graph.inner_shape, (2, case.dim))
        before = graph.free.copy()
        robot = Replanner(graph, start, goal)
        wander(robot, graph, start, goal, seed, BARS)
        assert (graph.free == before).all()


class Impatient(ReplanningPolicy):
    """One whose searches have budgets that the test sets: none, as much as they need, or any."""

    def __init__(self, mode: str) -> None:
        super().__init__()
        self.mode = mode
        self.draw = np.random.default_rng(8)

    def search_budget(self, distance: int, *, anew: bool, severed: bool) -> int:
        self.keep_paths = self.mode == "always" or self.draw.random() < 0.3
        any_budget = int(self.draw.choice([0, 1, 2, 5, 20, 100, 2**40]))
        return {"always": 0, "never": 2**40, "at random": any_budget}[self.mode]


@pytest.mark.parametrize("mode", ["always", "never", "at random"])
@pytest.mark.parametrize(("case", "neighbourhood"), ALL, ids=IDS)
def test_searches_cut_short_are_answered_as_well(case: Case, neighbourhood: Any, mode: str) -> None:
    for seed in range(2 if JIT else 1):
        rng = np.random.default_rng([seed, 3])
        graph = window(case, neighbourhood, rng, float(rng.choice([0.1, 0.3])), terrain=seed == 1)
        start, goal = graph.first + rng.integers(0, graph.inner_shape, (2, case.dim))
        wander(Replanner(graph, start, goal, policy=Impatient(mode)), graph, start, goal, seed + 10, BARS // 2)


class Changes(RuleBasedStateMachine):
    """Any sequence of changes, moves and questions; several changes may come between two paths."""

    @initialize(
        case=st.sampled_from(CASES),
        neighbourhood=st.sampled_from(NEIGHBOURHOODS),
        seed=st.integers(0, 2**32 - 1),
        terrain=st.booleans(),
        obstacles=st.sampled_from([0.0, 0.2, 0.5]),
        mode=st.sampled_from(["always", "never", "at random"]),
    )
    def begin(self, case: Case, neighbourhood: Any, seed: int, terrain: bool, obstacles: float, mode: str) -> None:
        rng = np.random.default_rng(seed)
        self.given = window(case, neighbourhood, rng, obstacles, terrain)
        self.start, self.goal = self.given.first + rng.integers(0, self.given.inner_shape, (2, case.dim))
        self.states = self.given.inner_states().copy()
        self.robot = Replanner(self.given, self.start, self.goal, policy=Impatient(mode))
        self.route: Path | None = None

    def cells(self, seeds: list[int]) -> Any:
        return self.given.first + np.array(np.unravel_index(np.array(seeds) % self.states.size, self.states.shape)).T

    @rule(seeds=st.lists(st.integers(0, 10_000), min_size=1, max_size=12), data=st.data())
    def set_cells(self, seeds: list[int], data: st.DataObject) -> None:
        states = data.draw(st.lists(st.booleans(), min_size=len(seeds), max_size=len(seeds)))
        at = self.cells(seeds)
        self.robot.set_cells(at, np.array(states))
        for cell, state in zip(at - self.given.first, states, strict=True):
            self.states[tuple(cell)] = state

    @precondition(lambda self: self.route is not None)
    @rule(which=st.integers(0, 10_000))
    def block_on_path(self, which: int) -> None:
        at = self.route.cells[which % len(self.route)]
        self.robot.block(at[None])
        self.states[tuple(at - self.given.first)] = 0

    @precondition(lambda self: self.route is not None)
    @rule(steps=st.integers(1, 5))
    def drive(self, steps: int) -> None:
        self.start = self.route.cells[min(steps, len(self.route) - 1)]
        self.robot.move_to(self.start)

    @rule(seed=st.integers(0, 10_000))
    def jump(self, seed: int) -> None:
        self.start = self.cells([seed])[0]
        self.robot.move_to(self.start)

    @precondition(lambda self: self.given.terrain is not None)
    @rule(seeds=st.lists(st.integers(0, 10_000), min_size=1, max_size=6), value=st.sampled_from([0.5, 1.0, 2.5, 8.0]))
    def set_terrain(self, seeds: list[int], value: float) -> None:
        self.robot.set_terrain(self.cells(seeds), np.full(len(seeds), value))

    @rule()
    def path(self) -> None:
        self.route = check(self.robot, self.states, self.start, self.goal)

    @invariant()
    def given_graph_is_untouched(self) -> None:
        assert self.robot.graph.free is not self.given.free

    def teardown(self) -> None:
        if hasattr(self, "robot"):
            check(self.robot, self.states, self.start, self.goal)


TestChanges = Changes.TestCase
TestChanges.settings = settings(max_examples=EXAMPLES * 2, stateful_step_count=30, deadline=None)


def maze(side: int) -> np.ndarray:
    """Corridors one cell wide that run to and fro: every wall but its end is closed."""
    free = np.ones((side, side), np.bool_)
    free[:, 1::2] = False
    free[0, 1::4] = True
    free[-1, 3::4] = True
    return free


@pytest.mark.parametrize(("name", "neighbourhood"), [("Z2", 4), ("Z2", 8), ("A2", None), ("A2", 12)])
def test_doors_of_a_maze_change_the_whole_route(name: str, neighbourhood: int | None) -> None:
    side = 41 if JIT else 13
    graph = LatticeGraph.from_states(Lattice.named(name), [3, -5], maze(side), neighbourhood=neighbourhood)
    start, goal = graph.first, graph.first + side - 1
    robot = Replanner(graph, start, goal)
    free = graph.inner_states().copy()
    longest = check(robot, free, start, goal)
    assert longest is not None
    rng = np.random.default_rng(5)
    shortest = longest.cost
    for _ in range(60 if JIT else 10):
        door = np.array([rng.integers(side), 1 + 2 * rng.integers(side // 2)])
        state = not free[tuple(door)]
        free[tuple(door)] = state
        robot.set_cells(graph.first + door[None], np.array([state]))
        path = check(robot, free, start, goal)
        shortest = min(shortest, shortest if path is None else path.cost)
    assert shortest < longest.cost / 2


@pytest.mark.parametrize(("name", "neighbourhood"), [("A2", None), ("Z2", 8), ("D3*", 14), ("Z3", 26), ("D3", 18)])
def test_a_robot_that_discovers_its_map_arrives(name: str, neighbourhood: int | None) -> None:
    lattice = Lattice.named(name)
    rng = np.random.default_rng(7)
    side = (60 if lattice.dim == 2 else 16) if JIT else 8
    truth = LatticeGraph.from_states(
        lattice, [0] * lattice.dim, rng.random((side,) * lattice.dim) > 0.25, neighbourhood=neighbourhood
    )
    component = np.flatnonzero(truth.components() == np.bincount(truth.components()[truth.free != 0]).argmax())
    at, goal = truth.flat_to_index(component[[0, -1]])
    blank = np.ones((side,) * lattice.dim, np.bool_)
    graph = LatticeGraph.from_states(lattice, [0] * lattice.dim, blank, neighbourhood=neighbourhood)
    robot = Replanner(graph, at, goal)
    seen = blank.astype(np.uint8)
    box = np.indices((7,) * lattice.dim).reshape(lattice.dim, -1).T - 3
    expansions = anew = steps = 0
    while (at != goal).any():
        cells = at + box
        cells = cells[truth.index_to_flat(cells) >= 0]
        states = truth.free[truth.index_to_flat(cells)] != 0
        robot.move_to(at)
        robot.set_cells(cells, states)
        seen[tuple(cells.T)] = states
        path = check(robot, seen, at, goal)
        assert path is not None
        expansions += path.expansions
        anew += astar(robot.graph, at, goal).expansions
        at = path.cells[1]
        steps += 1
    assert steps >= len(astar(truth, truth.flat_to_index(component[:1])[0], goal)) - 1
    if name in ("A2", "Z2") and JIT:
        assert expansions < anew


@pytest.mark.skipif(not JIT, reason="slow")
def test_a_large_map_and_a_queue_that_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dstar_lite, "_QUEUE_SLACK", 50)
    monkeypatch.setattr(dstar_lite, "_QUEUE_FACTOR", 1)
    monkeypatch.setattr(dstar_lite, "_MOST_KM", 2**44)
    rng = np.random.default_rng(1)
    for name, neighbourhood in (("A2", None), ("Z2", 8), ("Z2", 16), ("D3", 18)):
        lattice = Lattice.named(name)
        side = 100 if lattice.dim == 2 else 22
        free = rng.random((side,) * lattice.dim) > 0.3
        graph = LatticeGraph.from_states(lattice, [0] * lattice.dim, free, neighbourhood=neighbourhood)
        start, goal = graph.flat_to_index(np.flatnonzero(graph.free)[[5, -5]])
        policy = ReplanningPolicy(few=10_000, first_look=8)
        wander(Replanner(graph, start, goal, policy=policy), graph, start, goal, 3, 150)


def test_same_calls_give_the_same_paths() -> None:
    graph = LatticeGraph.from_states(Lattice.named("A2"), [0, 0], np.random.default_rng(0).random((30, 30)) > 0.2)
    routes = []
    for _ in range(2):
        rng = np.random.default_rng(4)
        robot = Replanner(graph, [0, 0], [29, 29])
        robot.free([[0, 0], [29, 29]])
        routes.append([])
        for _ in range(20):
            robot.set_cells(rng.integers(1, 28, (5, 2)), rng.random(5) < 0.7)
            path = robot.path()
            routes[-1].append((path.cells.tolist(), path.cost, path.expansions, path.pushes))
    assert routes[0] == routes[1]


def test_what_does_not_matter_costs_no_search() -> None:
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((40, 40), np.uint8), neighbourhood=8)
    robot = Replanner(graph, [0, 0], [0, 39])
    first = robot.path()
    assert first.expansions >= 39 and first.pushes > 0 and first.bound == 1.0
    assert (robot.path().expansions, robot.path().pushes) == (0, 0)
    robot.block(first.cells[3:4])
    robot.free(first.cells[3:4])
    assert robot.path().expansions == 0
    robot.move_to(first.cells[5])
    assert robot.path().expansions == 0
    robot.block([[39, 39]])
    assert robot.path().expansions == 0
    np.testing.assert_array_equal(robot.path().cells, first.cells[5:])


def test_blocked_ends_and_ways_that_open_again() -> None:
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((3, 9), np.uint8))
    robot = Replanner(graph, [1, 0], [1, 8])
    assert robot.path().cost == 8.0
    for cell, reason in (([1, 0], "start blocked"), ([1, 8], "goal blocked")):
        robot.block([cell])
        for _ in range(2):
            with pytest.raises(NoPath) as caught:
                robot.path()
            assert caught.value.reason == reason
        robot.free([cell])
        assert robot.path().cost == 8.0
    wall = [[0, 4], [1, 4], [2, 4]]
    robot.block(wall)
    for _ in range(2):
        with pytest.raises(NoPath, match="not connected"):
            robot.path()
    robot.move_to([1, 5])
    assert robot.path().cost == 3.0
    robot.move_to([1, 0])
    robot.free(wall[:1])
    assert robot.path().cost == 10.0
    robot.move_to([1, 8])
    assert (len(robot.path()), robot.path().cost) == (1, 0.0)


class Observed(ReplanningPolicy):
    """One that counts the searches that did not come to their end and those that did."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.searches = {False: 0, True: 0}

    def note_search(self, expansions: int, distance: int, *, anew: bool, ended: bool) -> None:
        self.searches[ended] += 1
        super().note_search(expansions, distance, anew=anew, ended=ended)


@pytest.mark.skipif(not JIT, reason="slow")
@pytest.mark.parametrize("terrain", [False, True], ids=["plain", "terrain"])
def test_a_search_cut_short_goes_on_later(terrain: bool) -> None:
    graph = LatticeGraph.from_states(Lattice.named("A2"), [0, 0], np.random.default_rng(2).random((90, 90)) > 0.2)
    if terrain:
        graph = graph.with_terrain(np.random.default_rng(3).uniform(1.0, 2.0, (90, 90)))
    start, goal = graph.flat_to_index(np.flatnonzero(graph.free)[[3, -3]])
    policy = Observed(least_budget=8, patience=1e-3)
    robot = Replanner(graph, start, goal, policy=policy)
    free = graph.inner_states().copy()
    check(robot, free, start, goal)
    rng = np.random.default_rng(4)
    for _ in range(150):
        at = start + rng.integers(0, 7, (12, 2))
        at = at[graph.index_to_flat(at) >= 0]
        at = at[((at != start) & (at != goal)).any(axis=1)]
        states = rng.random(len(at)) < 0.8
        for cell, state in zip(at, states, strict=True):
            free[tuple(cell)] = state
        robot.set_cells(at, states)
        path = check(robot, free, start, goal)
        if path is not None and rng.random() < 0.3:
            start = path.cells[min(2, len(path) - 1)].astype(np.int64)
            robot.move_to(start)
    assert policy.searches[False] > 5
    assert policy.searches[True] > 5


def test_a_path_is_kept_while_nothing_makes_another_cheaper() -> None:
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((9, 20), np.uint8), neighbourhood=8)
    terrain = np.full((9, 20), 2.0)
    terrain[0, 0] = 3.0
    robot = Replanner(graph.with_terrain(terrain), [4, 0], [4, 19])
    cells = robot.path().cells
    off = [[0, 9]]
    robot.block(off)
    robot.set_terrain([[8, 3]], [2.5])
    assert robot.path().expansions == 0
    np.testing.assert_array_equal(robot.path().cells, cells)
    for change in (
        lambda: robot.set_terrain(cells[7:8], [2.4]),
        lambda: robot.free(off),
        lambda: robot.set_terrain([[8, 3]], [2.1]),
        lambda: robot.block([[3, 12], [5, 12]]),
        lambda: robot.block([[4, 12]]),
        lambda: robot.free([[4, 12]]),
    ):
        change()
        path = robot.path()
        check_path(robot.graph, path, [4, 0], [4, 19])
        assert path.cost == pytest.approx(astar(robot.graph, [4, 0], [4, 19]).cost, rel=1e-12)
        assert robot.path().expansions == 0


@pytest.mark.skipif(not JIT, reason="slow")
def test_a_robot_shut_in_does_not_search_the_whole_map() -> None:
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((300, 300), np.uint8), neighbourhood=8)
    policy = ReplanningPolicy()
    robot = Replanner(graph, [5, 5], [290, 290], policy=policy)
    whole = robot.path().cost
    ring = np.argwhere(np.pad(np.zeros((9, 9), int), 1, constant_values=1))
    robot.block(ring)
    for start in ([5, 5], [3, 4], [5, 5]):
        robot.move_to(start)
        with pytest.raises(NoPath, match="not connected"):
            robot.path()
    assert policy.effort < 10_000
    free = graph.inner_states().copy()
    free[tuple(ring.T)] = 0
    for door in ([0, 4], [10, 10], [4, 10]):
        robot.free([door])
        free[tuple(door)] = 1
        check(robot, free, [5, 5], [290, 290])
    robot.free(ring)
    assert robot.path().cost == whole


def test_empty_batches_and_an_unreached_replanner_are_fine() -> None:
    graph = LatticeGraph.from_states(Lattice.named("D3"), [0, 0, 0], np.ones((3, 3, 3), np.uint8))
    robot = Replanner(graph, [0, 0, 0], [2, 2, 2])
    robot.block([])
    robot.free(np.empty((0, 3), int))
    robot.set_cells(np.empty((0, 3), int), np.empty(0, bool))
    assert robot.path().cost == astar(graph, [0, 0, 0], [2, 2, 2], heuristic="none").cost
    robot.block([])
    assert robot.path().expansions == 0
    assert "Replanner from (0, 0, 0) to (2, 2, 2)" in repr(robot)


def test_terrain_of_freed_cells_and_beyond_the_range_so_far() -> None:
    states = np.ones((3, 7), np.uint8)
    states[1, 3] = 0
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], states).with_terrain(np.full((3, 7), 2.0))
    robot = Replanner(graph, [1, 0], [1, 6])
    assert robot.path().cost == 16.0
    robot.free([[1, 3]])
    assert robot.path().cost == 12.0  # at the least multiplier
    robot.set_terrain([[1, 3], [1, 3]], [1.0, 100.0])
    assert robot.path().cost == 16.0
    robot.set_terrain([[0, c] for c in range(7)], np.full(7, 1e-3))
    assert robot.path().cost == pytest.approx(astar(robot.graph, [1, 0], [1, 6]).cost, rel=1e-12)
    assert graph.terrain is not None and graph.terrain.max() == 2.0


@pytest.mark.parametrize("span", [1e10, 1e14, 1e17])
def test_terrain_of_any_span_costs_what_planning_anew_costs(span: float) -> None:
    rng = np.random.default_rng(2)
    values = span ** rng.uniform(0.0, 1.0, (12, 12))
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], np.ones((12, 12), np.uint8)).with_terrain(values)
    robot = Replanner(graph, [0, 0], [11, 11])
    for _ in range(12):
        at = rng.integers(0, 12, (3, 2))
        robot.set_terrain(at, span ** rng.uniform(0.0, 1.0, 3))
        now = robot.graph
        assert robot.path().cost == pytest.approx(astar(now, [0, 0], [11, 11]).cost, rel=1e-7)


def test_what_makes_no_sense_is_an_error_and_changes_nothing() -> None:
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [5, 5], np.ones((3, 3), np.uint8))
    robot = Replanner(graph, [5, 5], [7, 7])
    for wrong in ([[5, 8]], [[4, 5]], [[5, 6], [100, 100]]):
        with pytest.raises(ArgumentError, match=r"cell \(.*\) lies outside the window"):
            robot.block(wrong)
        with pytest.raises(ArgumentError, match="outside the window"):
            robot.free(wrong)
    for wrong in ([5, 6], [[5.0, 6.0]], [[5, 6, 7]]):
        with pytest.raises(ArgumentError):
            robot.block(wrong)
    with pytest.raises(ArgumentError, match="bool"):
        robot.set_cells([[5, 6]], [1])
    with pytest.raises(ArgumentError, match="bool"):
        robot.set_cells([[5, 6]], [True, False])
    with pytest.raises(ArgumentError, match="no terrain"):
        robot.set_terrain([[5, 6]], [1.0])
    hilly = Replanner(graph.with_terrain(np.ones((3, 3))), [5, 5], [7, 7])
    for values in ([0.0], [np.nan], [-1.0], [np.inf], [1.0, 2.0]):
        with pytest.raises(ArgumentError):
            hilly.set_terrain([[5, 6]], values)
    for cell in ([8, 5], [0, 0]):
        with pytest.raises(NoPath, match="start outside the map"):
            robot.move_to(cell)
        with pytest.raises(NoPath, match="goal outside the map"):
            Replanner(graph, [5, 5], cell)
    for cell in ([[5, 5]], [5.0, 5.0], [5]):
        with pytest.raises(ArgumentError):
            robot.move_to(cell)
    assert robot.path().cost == 4.0
    assert (robot.graph.free == graph.free).all()
