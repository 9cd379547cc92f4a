"""Whatever a user types the name of says in one line what it is."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import hexmap
import localisation
import planners
from hexmap import LatticeGraph, MapBuilder, Pose, Scan, Trajectory, VoxelList
from hexmap.io.grids import GridMap
from hexmap.lattice import traverse
from localisation import GlobalMatcher, Localiser, match_anywhere
from planners import Replanner, dijkstra
from tests.lattices import CASES, Case

_ARRAYS = ("NDArray", "FloatArray", "IntArray", "CountArray", "KeyArray", "IndexArray", "ndarray")


def public_dataclasses() -> Iterator[type]:
    for package in (hexmap, planners, localisation):
        for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
            if ".cli" in found.name or found.name.endswith("__main__"):
                continue
            module = importlib.import_module(found.name)
            for name, value in vars(module).items():
                ours = isinstance(value, type) and value.__module__ == found.name and not name.startswith("_")
                if ours and dataclasses.is_dataclass(value):
                    yield value


def test_no_dataclass_prints_arrays() -> None:
    printing = []
    for kind in public_dataclasses():
        types = [str(each.type) for each in dataclasses.fields(kind)]
        holds_arrays = any(word in text for text in types for word in _ARRAYS)
        # What a dataclass makes of itself is a wrapper of reprlib.
        if holds_arrays and hasattr(kind.__repr__, "__wrapped__"):
            printing.append(f"{kind.__module__}.{kind.__name__}")
    assert printing == []


def values_on(case: Case) -> list[Any]:
    n, lattice = case.dim, case.lattice
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (50, n))
    builder = MapBuilder(lattice)
    scan = Scan(stamp=0.0, points=points, times=np.zeros(50))
    builder.fuse(scan, Pose.identity(n))
    made = builder.build()
    graph = LatticeGraph.from_array(np.zeros((4,) * n, bool), lattice)
    field = dijkstra(graph, [0] * n)
    values = [
        lattice, lattice.cell, made, made.levels[0], made.levels[0].hits, made.state(), made.diff(made), builder,
        builder.counter(), scan, Pose.identity(n), Trajectory.from_poses([0.0], [Pose.identity(n)]), graph, field,
        field.path_to([3] * n), GridMap(np.ones((2,) * n, np.uint8), 1.0, np.zeros(n)),
        traverse(lattice, points[:1], points[1:2]), graph.box, VoxelList.empty(lattice),
        Replanner(graph, [0] * n, [3] * n), GlobalMatcher.of_map(made), match_anywhere(made, points),
    ]  # fmt: skip
    return [*values, Localiser(made)] if n == 2 else values


@pytest.mark.parametrize("case", CASES, ids=str)
def test_one_line_says_what_a_value_is(case: Case) -> None:
    for value in values_on(case):
        text = repr(value)
        assert "\n" not in text
        assert type(value).__name__ in text and "object at 0x" not in text
        assert len(text) < 500, text


def test_of_an_array_a_line_tells_the_shape() -> None:
    text = repr(Scan(stamp=0.5, points=np.zeros((181, 2))))
    assert text == "Scan(stamp=0.5, points=<(181, 2) float64>, no_return=<(0, 2) float64>)"
