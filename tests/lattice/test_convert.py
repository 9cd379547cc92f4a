"""A lattice, its name or its basis, wherever one is asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hexmap import LatticeGraph, MapBuilder, VoxelList
from hexmap.base.errors import LatticeError
from hexmap.graph import swept_cells
from hexmap.io.grids import GridMap
from hexmap.lattice import NAMES, Lattice, as_lattice, traverse
from hexmap.lattice.convert import plain_basis, plain_lattice
from hexmap.maps import CellCounter, distortion, voxel_count
from hexmap.paper.rotation_settings import RotationSettings
from localisation import LidarSettings, MappingSettings
from localisation.experiments.settings import ExperimentSettings
from planners.benchmark.settings import BenchmarkSettings, Grid
from tests.lattices import CASES, PLANAR, Case

each = pytest.mark.parametrize("case", CASES, ids=str)


@each
def test_a_lattice_and_its_basis_are_the_same(case: Case) -> None:
    assert as_lattice(case.lattice) is case.lattice
    assert as_lattice(case.lattice.basis) == case.lattice
    assert as_lattice(case.lattice.basis.tolist()) == case.lattice


@pytest.mark.parametrize("name", NAMES)
def test_a_name_takes_the_resolution_and_is_a_metre_wide_without(name: str) -> None:
    assert as_lattice(name) == Lattice.named(name)
    assert as_lattice(name, 0.05) == Lattice.named(name, 0.05)
    assert as_lattice(Lattice.named(name, 0.3), 0.05) == Lattice.named(name, 0.05)  # to the last bit


@each
def test_a_resolution_scales_what_has_one(case: Case) -> None:
    made = as_lattice(case.lattice.basis, 0.25)
    assert made.resolution == pytest.approx(0.25)
    np.testing.assert_allclose(made.basis / made.resolution, case.lattice.basis / case.lattice.resolution, atol=1e-12)


@pytest.mark.parametrize("given", [None, 5, 0.1, "A9", [1.0, 2.0], [[1, 0], [2, 0]], "", object()])
def test_what_is_no_lattice_is_one_error(given: Any) -> None:
    with pytest.raises(LatticeError) as error:
        as_lattice(given)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("resolution", [0.0, -1.0, float("nan"), float("inf"), True, "1"])
def test_a_resolution_is_a_positive_number(resolution: Any) -> None:
    for given in ("A2", Lattice.named("A2"), np.eye(2)):
        with pytest.raises(LatticeError, match="positive number"):
            as_lattice(given, resolution)


POINTS = np.array([[0.3, -0.2, 0.5], [1.1, 0.4, -0.7], [0.31, -0.19, 0.5]])


def grid(n: int) -> GridMap:
    return GridMap(np.ones((2,) * n, np.uint8), 0.2, np.zeros(n))


TAKE: dict[str, Callable[[Any, int], Any]] = {
    "VoxelList.from_points": lambda on, n: VoxelList.from_points(POINTS[:, :n], on),
    "VoxelList.from_cells": lambda on, n: VoxelList.from_cells([[1] * n], on),
    "VoxelList.empty": lambda on, n: VoxelList.empty(on),
    "MapBuilder": lambda on, n: MapBuilder(on).lattice,
    "CellCounter": lambda on, n: CellCounter(on).lattice,
    "voxel_count": lambda on, n: voxel_count(POINTS[:, :n], on),
    "distortion": lambda on, n: distortion(POINTS[:, :n], on),
    "LatticeGraph.from_array": lambda on, n: LatticeGraph.from_array(np.zeros((3,) * n, int), on).lattice,
    "LatticeGraph.from_states": lambda on, n: LatticeGraph.from_states(on, [0] * n, np.ones((3,) * n, bool)).lattice,
    "LatticeGraph.rasterise": lambda on, n: LatticeGraph.rasterise(
        lambda points: points[:, 0] < 0.5, on, [0.0] * n, [1.0] * n
    ).free.tolist(),
    "swept_cells": lambda on, n: swept_cells(on, [2] * n).tolist(),
    "traverse": lambda on, n: traverse(on, POINTS[:1, :n], POINTS[1:2, :n]).index.tolist(),
    "GridMap.to_graph": lambda on, n: grid(n).to_graph(on).free.tolist(),
    "GridMap.to_states": lambda on, n: grid(n).to_states(on).free,
}


@each
@pytest.mark.parametrize("taker", TAKE)
def test_a_basis_is_taken_as_the_lattice_is(taker: str, case: Case) -> None:
    take, n = TAKE[taker], case.dim
    assert take(case.lattice.basis, n) == take(case.lattice, n)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("taker", [name for name in TAKE if "GridMap" not in name])
def test_a_name_is_taken_as_the_lattice_is(taker: str, name: str) -> None:
    take, n = TAKE[taker], Lattice.named(name).dim
    assert take(name, n) == take(Lattice.named(name), n)


@pytest.mark.parametrize("name", NAMES)
def test_resolutions_beside_names(name: str) -> None:
    on = Lattice.named(name, 0.2)
    points = POINTS[:, : on.dim]
    assert VoxelList.from_points(points, name, 0.2) == VoxelList.from_points(points, on)
    assert MapBuilder(name, resolution=0.2).lattice == on
    assert voxel_count(points, name, 0.2) == voxel_count(points, on)
    assert LatticeGraph.from_array(np.zeros((2,) * on.dim, bool), name, 0.2).lattice == on


def test_a_grid_of_others_takes_a_name_at_the_size_that_hexmap_plan_takes() -> None:
    flat = GridMap(np.ones((2, 2), np.uint8), 0.5, np.zeros(2))
    solid = GridMap(np.ones((2, 2, 2), np.uint8), 0.5, np.zeros(3))
    assert flat.to_graph("A2").lattice == Lattice.named("A2", 0.25)
    assert solid.to_graph("D3").lattice == Lattice.named("D3", 0.5)


# ---------------------------------------------------------------------- settings, which are kept as plain values


@pytest.mark.parametrize("case", PLANAR, ids=str)
def test_the_settings_of_a_map_keep_any_lattice_as_plain_values(case: Case) -> None:
    for given in (case.lattice, case.lattice.basis, case.lattice.basis.tolist()):
        settings = MappingSettings(lattice=given)
        assert settings.make_lattice() == case.lattice
        assert settings.resolution == pytest.approx(case.lattice.resolution)
        assert isinstance(settings.lattice, str | list)
        assert MappingSettings.from_dict(settings.to_dict()) == settings
    with pytest.raises(ValueError, match="lattice of the plane"):
        LidarSettings(lattice=case.lattice)


@each
def test_plain_values_make_the_same_lattice(case: Case) -> None:
    plain, resolution = plain_lattice(case.lattice, 9.0)
    assert as_lattice(plain, resolution if isinstance(plain, str) else None) == case.lattice
    assert isinstance(plain_basis(case.lattice), str) == (case.lattice.name in NAMES)
    # A lattice that only claims a name is not taken for the one that has it.
    turned = Lattice(case.lattice.basis[::-1], "A2")
    assert as_lattice(plain_basis(turned)) == turned or turned == case.lattice


def test_experiments_take_lattices_and_bases() -> None:
    own = np.array([[1.0, 0.3], [0.0, 1.1]])
    experiment = ExperimentSettings(lattices=(Lattice.named("Z2", 0.3), own, Lattice(own, "mine")))
    assert experiment.lattices[0] == "Z2"
    assert experiment.lattices[1] == experiment.lattices[2] == ((1.0, 0.3), (0.0, 1.1))
    rotation = RotationSettings(resolution=0.1, lattices=(Lattice.named("A2", 2.0), own))
    assert [v.name for v in rotation.make_lattices(2)] == ["Z2", "A2", "own"]
    assert Grid(Lattice.named("D3", 0.3), 12) == Grid("D3", 12)


def test_the_benchmark_takes_own_lattices_with_neighbourhoods_that_connect_their_cells() -> None:
    own = np.array([[1.0, 0.3], [0.0, 1.1]])
    settings = BenchmarkSettings().with_own([own])
    assert [grid.label for grid in settings.planar[-2:]] == ["own-6", "own-8"]
    assert settings.spatial == BenchmarkSettings().spatial
    several = BenchmarkSettings().with_own([own, np.diag([1.0, 1.0, 3.0])])
    assert several.planar[-1].label == "own1-8"
    usual = several.spatial[-2]
    flat = np.diag([1.0, 1.0, 3.0])
    assert {tuple(v) for v in as_lattice(flat).faces.tolist()} <= {
        tuple(v) for v in as_lattice(flat).shell(usual.moves).tolist()
    }
