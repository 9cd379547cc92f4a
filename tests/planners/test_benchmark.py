"""The planning benchmark: maps that do not leak, a baseline check, the same numbers for any number of workers."""

from __future__ import annotations

import csv
import itertools
import json
import math
import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import label
from typer.testing import CliRunner

from hexmap.base.errors import ArgumentError
from hexmap.cli.commands import app
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.io.grids.grid_map import GridMap
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from planners import astar
from planners.benchmark.benchmark import planning_benchmark
from planners.benchmark.results import Results
from planners.benchmark.run import run_benchmark
from planners.benchmark.settings import GRIDS, BenchmarkSettings, Grid
from planners.benchmark.source_map import Pinches, Walls, grid_coordinates


def write_map(folder: Path, name: str, free: np.ndarray, seed: int = 0, count: int = 12, add: float = 0.0) -> Path:
    """Write a MovingAI map and problems on it; ``add`` falsifies the lengths."""
    width, height = free.shape
    rows = "\n".join("".join(".@"[not free[x, y]] for x in range(width)) for y in range(height))
    path = folder / name
    path.write_text(f"type octile\nheight {height}\nwidth {width}\nmap\n{rows}\n")
    graph = LatticeGraph.from_states(Lattice.named("Z2"), [0, 0], free.astype(np.uint8), neighbourhood=8)
    labels, _ = label(free)
    cells = np.argwhere(labels == np.bincount(labels[free]).argmax())
    rng = np.random.default_rng(seed)
    lines = ["version 1"]
    while len(lines) <= count:
        a, b = cells[rng.integers(0, len(cells), 2)]
        if (a != b).any():
            cost = astar(graph, a, b).cost + add
            lines.append(f"0\t{name}\t{width}\t{height}\t{a[0]}\t{a[1]}\t{b[0]}\t{b[1]}\t{cost:.8f}")
    path.with_name(name + ".scen").write_text("\n".join(lines) + "\n")
    return path


def random_map(seed: int, shape: tuple[int, ...], blocked: float = 0.3) -> np.ndarray:
    free = np.random.default_rng(seed).random(shape) >= blocked
    free[tuple([0] * len(shape))] = True
    return free


def states_of(free: np.ndarray) -> np.ndarray:
    return np.where(free, CellState.FREE, CellState.OCCUPIED).astype(np.uint8)


SMALL = BenchmarkSettings(
    queries=12, angles=(0.0, 17.0), fractions=(2,), planners=("astar",),
    planar=(Grid("Z2", 4), Grid("Z2", 8), Grid("A2", 6)),
)  # fmt: skip


# ---------------------------------------------------------------------- the source map


@pytest.mark.parametrize("grid", GRIDS[2] + GRIDS[3], ids=lambda grid: grid.label)
@pytest.mark.parametrize("fraction", [2, 4])
def test_no_lattice_leaks_through_pinches_at_any_angle(grid: Grid, fraction: int) -> None:
    lattice = grid.make()
    n = lattice.dim
    reach = max(np.linalg.norm(g.make().centres(g.make().nearest[:1])[0]) for g in GRIDS[n]) / math.sqrt(2)
    lattice = lattice.scaled(1.0 / fraction)
    rng = np.random.default_rng(fraction)
    for seed in range(6 if n == 2 else 3):
        free = random_map(seed, (14, 11) if n == 2 else (6, 5, 6), 0.45)
        source = GridMap(states_of(free), 1.0, rng.uniform(-1, 1, n))
        components, _ = label(free)
        for angle in (0.0, math.pi / 4, float(rng.uniform(0, 6))):
            turned = source.turned(angle)
            pinches = Pinches(turned, reach / fraction)
            graph = LatticeGraph.rasterise(
                lambda p, m=turned, q=pinches: m.free_at(p) & ~q.closed(p), lattice, turned.low, turned.high,
                neighbourhood=grid.moves,
            )  # fmt: skip
            nodes = np.flatnonzero(graph.free)
            cells = turned.cell_of(graph.centres(nodes))
            pairs = np.unique(np.stack([graph.components()[nodes], components[tuple(cells.T)]], axis=1), axis=0)
            # No component of the graph holds cells of two components of the source.
            assert len(np.unique(pairs[:, 0])) == len(pairs)


def test_without_closing_pinches_hexagons_do_leak() -> None:
    free = np.array([[True, False], [False, True]])
    lattice = Lattice.named("A2", 0.5)
    leaks = 0
    for angle in np.linspace(0, math.pi, 13):
        grid_map = GridMap(states_of(free), 1.0, [0.0, 0.0]).turned(float(angle))
        graph = LatticeGraph.rasterise(grid_map.free_at, lattice, grid_map.low, grid_map.high)
        leaks += len(np.unique(graph.components()[graph.free != 0])) == 1
    assert leaks > 0


@pytest.mark.parametrize("shape", [(12, 9), (6, 7, 5)])
def test_distance_to_walls_is_that_of_true_squares_and_cubes(shape: tuple[int, ...]) -> None:
    for seed in range(10):
        free = random_map(seed, shape, 0.2)
        rng = np.random.default_rng(seed)
        u = rng.uniform(0, 1, (200, len(shape))) * shape
        u = u[free[tuple(np.minimum(u.astype(int), np.array(shape) - 1).T)]]
        found = Walls(states_of(free)).distance(u)
        blocked = np.argwhere(~np.pad(free, 1)) - 1
        gap = np.maximum(np.abs(u[:, None] - (blocked + 0.5)) - 0.5, 0)
        expected = np.sqrt((gap**2).sum(axis=2)).min(axis=1)
        near = expected <= 1.0
        np.testing.assert_allclose(found[near], expected[near], atol=1e-12)
        assert (found >= expected - 1e-12).all()


def test_grid_coordinates_undo_the_turn() -> None:
    grid_map = GridMap(np.ones((5, 7, 3), np.uint8), 0.25, [1.0, -2.0, 0.5]).turned(0.7)
    cells = np.argwhere(grid_map.states == CellState.FREE)
    np.testing.assert_allclose(grid_coordinates(grid_map, grid_map.centre(cells)), cells + 0.5, atol=1e-12)


# ---------------------------------------------------------------------- the run


def plain(results: Results) -> str:
    """All numbers of a run but the times, as text."""
    runs = []
    for run in results.runs:
        about = asdict(run)
        about["answers"] = {
            name: [None if row is None else {k: v for k, v in row.items() if k != "seconds"} for row in rows]
            for name, rows in about["answers"].items()
        }
        del about["memory"]
        runs.append(about)
    optima = [None if v is None else v.lengths.tolist() for v in results.optima]
    baselines = [asdict(baseline) for baseline in results.baselines]
    free_space = [asdict(check) for check in results.free_space]
    return json.dumps([baselines, optima, runs, free_space], sort_keys=True)


def test_the_same_numbers_for_any_number_of_workers_and_after_an_interruption(tmp_path: Path) -> None:
    path = write_map(tmp_path, "random.map", random_map(1, (24, 20)))
    alone = run_benchmark([path], SMALL)
    assert plain(run_benchmark([path], SMALL, workers=2, folder=tmp_path / "two")) == plain(alone)

    class Enough(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done == 4:
            raise Enough

    with pytest.raises(Enough):
        run_benchmark([path], SMALL, folder=tmp_path / "stopped", progress=stop)
    seen: list[int] = []
    resumed = run_benchmark([path], SMALL, folder=tmp_path / "stopped", progress=lambda done, total: seen.append(done))
    assert plain(resumed) == plain(alone)


def test_lengths_lie_between_the_optimum_and_the_worst_of_the_moves(tmp_path: Path) -> None:
    path = write_map(tmp_path, "random.map", random_map(2, (24, 20), 0.15), count=10)
    results = run_benchmark([path], SMALL)
    (optimum,) = results.optima
    assert optimum is not None and np.isfinite(optimum.lengths).all()
    problems = results.problem_sets[0]
    straight = np.linalg.norm(problems.starts - problems.goals, axis=1)
    assert (optimum.lengths >= straight - 1e-9).all()
    octile = np.array(results.baselines[0].costs)
    assert (optimum.lengths <= octile + 1e-9).all()
    for run in results.runs:
        if run.fraction > 1:
            lengths = np.array([answer.length for answer in run.answers["astar"] if answer is not None])
            # Rasterising by centre cuts a corner by a fraction of a cell, no more.
            assert (lengths > 0.9 * optimum.lengths).all() and (lengths < 1.6 * optimum.lengths + 2).all()


def test_the_report_begins_with_the_baseline_check(tmp_path: Path) -> None:
    path = write_map(tmp_path, "random.map", random_map(3, (24, 20)))
    outcome = planning_benchmark([path], SMALL)
    assert outcome.failures == []
    outcome.report.write(tmp_path / "report")
    text = (tmp_path / "report" / "report.md").read_text()
    first = next(line for line in text.splitlines() if line and not line.startswith("#"))
    assert first.startswith("12 of 12 problems have the published length")
    with (tmp_path / "report" / "summary.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[1][:2] == ["problems equal to the published length", "12"]
    assert rows[2][:2] == ["problems different from it", "0"]
    for grid in SMALL.planar:
        assert any(f" {grid.label}, edge 1/2" in row[0] for row in rows)
    # Then who wins what, before any other number.
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings[:2] == ["## Verdicts", "## Win, even, lose"]
    with (tmp_path / "report" / "verdicts.csv").open() as file:
        verdicts = list(csv.DictReader(file))
    assert verdicts[0]["outcome"] == "holds" and verdicts[0]["evidence"].startswith("12 of 12")
    assert [row["claim"] for row in verdicts[1:]] == [
        "A2-6 plans shorter paths than Z2-4", "A2-6 plans shorter paths than Z2-8",
    ]  # fmt: skip
    with (tmp_path / "report" / "outcomes_2d.csv").open() as file:
        matrix = list(csv.DictReader(file))
    assert matrix[0]["first against second"] == "A2-6 against Z2-4" and matrix[0]["length, edge 1/2"] == "win"
    assert {v for row in matrix for k, v in row.items() if k != "first against second"} <= {"win", "even", "lose"}
    # Twelve queries have an interval, the three of a bin have none.
    assert "mean_low" in (tmp_path / "report" / "length_2d_2.csv").read_text()
    assert "_low" not in (tmp_path / "report" / "distance_2d_2.csv").read_text()
    assert "without intervals: each is of fewer than 8 queries" in text


def test_every_answer_is_in_one_file_and_no_cell_is_a_date(tmp_path: Path) -> None:
    path = write_map(tmp_path, "random.map", random_map(3, (24, 20)))
    results = run_benchmark([path], SMALL)
    written = planning_benchmark([path], SMALL).report.write(tmp_path / "report")
    assert tmp_path / "report" / "queries.csv" in written
    with (tmp_path / "report" / "queries.csv").open() as file:
        rows = list(csv.DictReader(file))
    with (tmp_path / "report" / "times" / "queries_times.csv").open() as file:
        times = list(csv.DictReader(file))
    assert len(rows) == len(times) == sum(len(a) for run in results.runs for a in run.answers.values())
    assert all(time[key] == row[key] for row, time in zip(rows, times, strict=True) for key in ("problem", "planner"))
    at = 0
    for run in results.runs:
        for planner, answers in run.answers.items():
            for answer in answers:
                row = rows[at]
                assert (row["planner"], float(row["cell"]), float(row["degrees"])) == (
                    planner, 1.0 / run.fraction, run.degrees,
                )  # fmt: skip
                assert row["found"] == ("false" if answer is None else "true")
                assert row["length"] == ("" if answer is None else repr(answer.length))
                at += 1
    # The mean of the report comes out of the file.
    mine = [r for r in rows if r["compared"] == "true" and (r["grid"], r["planner"]) == ("A2-6", "astar")]
    ratios = [float(r["length"]) / float(r["reference_length"]) for r in mine]
    with (tmp_path / "report" / "length_2d_2.csv").open() as file:
        mean = next(float(row["mean"]) for row in csv.DictReader(file) if row["grid"] == "A2-6")
    assert np.mean(ratios) == pytest.approx(mean, rel=1e-12)
    # But for times all of it is the same in another run.
    for file in planning_benchmark([path], SMALL).report.write(tmp_path / "again"):
        if file.parent.name != "times":
            assert file.read_bytes() == (tmp_path / "report" / file.name).read_bytes(), file.name
    for file in (tmp_path / "report").rglob("*.csv"):
        for row in csv.reader(file.open()):
            assert not any(re.fullmatch(r"\d{1,4}[/-]\d{1,2}([/-]\d{1,4})?", cell) for cell in row), file


def test_a_failed_baseline_check_fails_the_run_and_is_listed(tmp_path: Path) -> None:
    path = write_map(tmp_path, "random.map", random_map(3, (24, 20)), add=0.001)
    outcome = planning_benchmark([path], SMALL)
    assert outcome.failures == ["12 of 12 lengths differ from the published ones"]
    outcome.report.write(tmp_path / "report")
    assert len((tmp_path / "report" / "differences.csv").read_text().splitlines()) == 13


def test_maps_without_problems_and_maps_in_space(tmp_path: Path) -> None:
    free = random_map(5, (20, 16), 0.2)
    rows = "\n".join("".join(".@"[not free[x, y]] for x in range(20)) for y in range(16))
    plane = tmp_path / "bare.map"
    plane.write_text(f"type octile\nheight 16\nwidth 20\nmap\n{rows}\n")
    solid = tmp_path / "cave.3dmap"
    cells = np.argwhere(~random_map(6, (8, 7, 6), 0.15))
    solid.write_text("voxel 8 7 6\n" + "\n".join(" ".join(map(str, c)) for c in cells.tolist()) + "\n")
    settings = BenchmarkSettings(
        queries=8, angles=(0.0,), fractions=(2,), planners=("astar",), planar=SMALL.planar,
        spatial=(Grid("Z3", 6), Grid("D3*", 8), Grid(((1.0, 0.2, 0.0), (0.0, 1.0, 0.1), (0.1, 0.0, 0.9)), 26)),
    )  # fmt: skip
    results = run_benchmark([plane, solid], settings)
    assert len(results.problem_sets[0].starts) == len(results.problem_sets[1].starts) == 8
    outcome = planning_benchmark([plane, solid], settings)
    names = [path.name for path in outcome.report.write(tmp_path / "report")]
    assert {"length_2d_2.csv", "length_3d_2.csv", "free_space.csv"} <= set(names)
    assert "not checked" in (tmp_path / "report" / "report.md").read_text()


def test_free_space_agrees_with_the_exact_table(tmp_path: Path) -> None:
    path = write_map(tmp_path, "open.map", np.ones((12, 12), bool), count=8)
    known = {"Z2-4": 1.27324, "Z2-8": 1.054786, "A2-6": 1.102658}
    for check in run_benchmark([path], SMALL).free_space:
        label_of = SMALL.planar[check.lattice].label
        assert check.mean == pytest.approx(known[label_of], abs=5 * check.sd / math.sqrt(4000) + 5e-4)


@pytest.mark.parametrize(
    "wrong",
    [
        {"queries": 3}, {"angles": ()}, {"angles": (0.0, 0.0)}, {"angles": (math.nan,)}, {"fractions": ()},
        {"fractions": (1,)}, {"fractions": (2, 2)}, {"max_cells": 0}, {"seed": -1}, {"planar": (Grid("Z2", 4),) * 2},
    ],
)  # fmt: skip
def test_settings_that_make_no_sense(wrong: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError):
        BenchmarkSettings(**wrong)


def test_too_large_windows_are_left_out_and_said(tmp_path: Path) -> None:
    path = write_map(tmp_path, "random.map", random_map(1, (24, 20)))
    settings = BenchmarkSettings(
        queries=12, angles=(0.0,), fractions=(2, 4), planners=("astar",), planar=SMALL.planar, max_cells=5000
    )
    results = run_benchmark([path], settings)
    assert results.left_out and all("1/4" in text for text in results.left_out)
    nothing = planning_benchmark([path], BenchmarkSettings(queries=12, planners=("astar",), max_cells=10))
    assert any("nothing was compared" in text for text in nothing.failures)


# ---------------------------------------------------------------------- the command


def test_the_command(tmp_path: Path) -> None:
    path = write_map(tmp_path, "random.map", random_map(3, (24, 20)))
    run = CliRunner().invoke(
        app,
        ["benchmark", "planning", str(path), "-o", str(tmp_path / "r"), "--queries", "8", "--angles", "0",
         "--fractions", "2", "--planners", "astar"],
    )  # fmt: skip
    assert run.exit_code == 0, run.output
    assert (tmp_path / "r" / "report.html").is_file()
    assert str(tmp_path / "r" / "summary.csv") in run.output
    assert "earlier run" not in run.output
    assert f"{tmp_path / 'r' / 'queries.csv'}  (the answer of every planner to every query)" in run.output


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--angles 0,x", "--angles"),
        ("--fractions 1", "half"),
        ("--planners magic", "magic"),
        ("--planners dijkstra", "astar"),
        ("--queries 2", "8 queries"),
        ("--random-angles -3", "-3"),
        ("--angles 0 --random-angles 2", "both"),
        ("--seed -1", "seed"),
    ],
)
def test_wrong_options(tmp_path: Path, options: str, said: str) -> None:
    path = write_map(tmp_path, "random.map", random_map(3, (10, 10), 0.1), count=8)
    run = CliRunner().invoke(app, ["benchmark", "planning", str(path), "-o", str(tmp_path / "r"), *options.split()])
    assert run.exit_code != 0
    assert said in str(run.exception) + run.output
    assert not (tmp_path / "r").exists()


def test_two_maps_of_one_name_and_none(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    maps = [write_map(tmp_path / d, "m.map", random_map(3, (10, 10), 0.1), count=8) for d in "ab"]
    with pytest.raises(ArgumentError, match=r"m\.map"):
        run_benchmark(maps, SMALL)
    with pytest.raises(ArgumentError):
        run_benchmark([], SMALL)


def test_every_pair_of_cells_of_the_pinch_table() -> None:
    # Around one corner of four squares only the two diagonals touch in nothing but the corner.
    for pattern in itertools.product((0, 1), repeat=4):
        free = np.array(pattern, np.uint8).reshape(2, 2)
        grid_map = GridMap(states_of(free), 1.0, [0.0, 0.0])
        closed = bool(Pinches(grid_map, 0.3).closed(np.array([[1.1, 0.9]]))[0])
        assert closed == (pattern in ((1, 0, 0, 1), (0, 1, 1, 0)))


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_what_is_closed_is_what_is_near_a_corner_where_free_cells_meet_diagonally(yaw: float) -> None:
    rng = np.random.default_rng(5)
    free = rng.random((12, 10)) >= 0.4
    diagonal = (free[1:, 1:] == free[:-1, :-1]) & (free[1:, :-1] == free[:-1, 1:]) & (free[1:, 1:] != free[1:, :-1])
    corners = np.argwhere(diagonal) + 1.0
    at = rng.uniform(0.0, 1.0, (3000, 3)) * [12.0, 10.0, 4.0]
    expected = (np.linalg.norm(at[:, None, :2] - corners, axis=2) < 0.3).any(axis=1)
    assert expected.sum() > 50
    points = at * 0.5
    c, s = math.cos(yaw), math.sin(yaw)
    points[:, :2] = points[:, :2] @ np.array([[c, s], [-s, c]]) + [3.0, -1.0]
    plane = GridMap(states_of(free.astype(np.uint8)), 0.5, [3.0, -1.0], yaw)
    assert (Pinches(plane, 0.15).closed(points[:, :2]) == expected).all()
    # The same walls four cells high: the corners are edges.
    high = np.repeat(free.astype(np.uint8)[:, :, None], 4, axis=2)
    space = GridMap(states_of(high), 0.5, [3.0, -1.0, 0.0], yaw)
    assert (Pinches(space, 0.15).closed(points) == expected).all()
    assert not Pinches(GridMap(states_of(np.ones((5, 4), np.uint8)), 0.5, [0.0, 0.0]), 0.15).closed(points[:, :2]).any()
