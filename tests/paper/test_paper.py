"""The paper's experiments: the checked numbers, the same for any number of workers, and the command line."""

from __future__ import annotations

import csv
import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError
from hexmap.cli import main
from hexmap.io.clouds.read_points import read_points
from hexmap.lattice.lattice import NAMES, Lattice
from hexmap.paper.quantiser import quantiser_experiment, uniform_on_cells
from hexmap.paper.rotation import rotation_experiment
from hexmap.paper.rotation_settings import RotationSettings
from hexmap.paper.verdicts import mean_path_factor, ties
from tests.lattices import LONG


def rows(folder: Path, name: str) -> dict[str, dict[str, str]]:
    """Return a table of a report by its first column."""
    with (folder / f"{name}.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    first = next(iter(table[0]))
    return {row[first]: row for row in table}


def room3(count: int = 6000, seed: int = 0) -> np.ndarray:
    """Points on the walls and the floor of a simulated room, off centre."""
    rng = np.random.default_rng(seed)
    p = rng.uniform((-3.0, -2.0, -1.0), (4.0, 2.5, 1.5), (count, 3))
    wall = rng.integers(0, 5, count)
    p[wall == 0, 0], p[wall == 1, 0], p[wall == 2, 1], p[wall == 3, 1], p[wall == 4, 2] = -3.0, 4.0, -2.0, 2.5, -1.0
    return p + rng.normal(0.0, 0.01, p.shape)


SMALL = {"step": 15.0, "random": 12}


@pytest.fixture(autouse=True)
def small_solids(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw solids in few pixels, which is where the time goes; the long run draws them in full."""
    if not LONG:
        # The package's face has a function of the module's name.
        module = importlib.import_module("hexmap.drawing.solids.draw_solids")
        in_full = module.draw_solids

        def in_few(*arguments: Any, **options: Any) -> Path:
            return in_full(*arguments, **{**options, "size": (160, 120)})

        monkeypatch.setattr(module, "draw_solids", in_few)


@pytest.fixture
def tables_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures of a report empty, for tests that read its tables alone; the long run fills them."""
    if not LONG:
        monkeypatch.setattr("hexmap.experiments.report.report.render", lambda figure, kind: b"")


def test_a_simulated_room_is_steadier_on_every_other_lattice(tmp_path: Path) -> None:
    report = rotation_experiment(room3(), RotationSettings(resolution=0.2, **SMALL), source="room")
    written = {path.name for path in report.write(tmp_path)}
    assert {"report.html", "report.md", "table2_axis.csv", "fig6.png", "fig6.pdf", "fig7.png", "fig5.png"} <= written
    table = rows(tmp_path, "table2_axis")
    for name in ("D3", "D3*"):
        assert float(table[name]["count sigma/mu"]) < float(table["Z3"]["count sigma/mu"])
        assert float(table[name]["count sigma/mu_low"]) <= float(table[name]["count sigma/mu"])
    verdicts = rows(tmp_path, "verdicts")
    assert len(verdicts) >= 5 and "densest" in (tmp_path / "verdicts.csv").read_text()
    text = (tmp_path / "report.md").read_text()
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings[:2] == ["## Verdicts on the paper's claims", "## Win, even, lose"]
    assert "cells of 8 litres" in text and "80,000 points" in text  # what is compared with the paper's column
    outcomes, ratios = rows(tmp_path, "outcomes"), rows(tmp_path, "ratios_axis")
    for name in ("D3", "D3*"):
        # The other way round: a lattice wins where the cubic one varies more.
        assert (outcomes[f"{name} against Z3"]["cells vary, turns"] == "win") == (
            float(ratios[f"Z3 over {name}"]["count sigma/mu_low"]) > 1.0
        )


def test_the_plane_and_a_lattice_of_ones_own(tmp_path: Path) -> None:
    settings = RotationSettings(resolution=0.5, own=([[1.0, 0.3], [0.0, 0.9]],), **SMALL)
    written = {path.name for path in rotation_experiment(room3()[:, :2], settings).write(tmp_path)}
    assert {"fig4.png", "fig2_3.png", "diagonal.png", "diagonal.csv"} <= written
    assert set(rows(tmp_path, "table2_random")) == {"Z2", "A2", "own"}
    diagonal = rows(tmp_path, "diagonal")
    spread = {k: np.ptp([int(v) for c, v in row.items() if "degrees" in c]) for k, row in diagonal.items()}
    assert spread["A2"] < spread["Z2"]


@pytest.mark.usefixtures("tables_only")
def test_the_numbers_do_not_depend_on_workers_or_interruptions(tmp_path: Path) -> None:
    settings = RotationSettings(resolution=0.4, random=8, step=20.0, lattices=("Z3", "D3"))
    points = room3(1500)
    rotation_experiment(points, settings).write(tmp_path / "one")
    rotation_experiment(points, settings, workers=2).write(tmp_path / "two")

    class Stop(Exception):
        pass

    def stop_half_way(done: int, total: int) -> None:
        if done == total // 2:
            raise Stop

    with pytest.raises(Stop):
        rotation_experiment(points, settings, folder=tmp_path / "kept", progress=stop_half_way)
    rotation_experiment(points, settings, folder=tmp_path / "kept").write(tmp_path / "three")
    for name in ("table2_axis", "table2_random", "ratios_axis", "match_score", "dividend"):
        first = (tmp_path / "one" / f"{name}.csv").read_bytes()
        assert first == (tmp_path / "two" / f"{name}.csv").read_bytes()
        assert first == (tmp_path / "three" / f"{name}.csv").read_bytes()


@pytest.mark.data
@pytest.mark.usefixtures("tables_only")
def test_the_checked_numbers_of_the_stairs_hall(data_dir: Path, tmp_path: Path) -> None:
    points = read_points(data_dir / "scans3d" / "stairs_hall.pcd").points
    expected = {0.2: {"Z3": 1.69, "D3": 0.81, "D3*": 0.56}, 0.1: {"Z3": 0.76, "D3": 0.28, "D3*": 0.20}}
    error = {"Z3": 0.0035, "D3": 0.0023, "D3*": 0.0025}
    for resolution, wanted in expected.items():
        settings = RotationSettings(resolution=resolution, random=8, lattices=("Z3", "D3", "D3*"))
        folder = tmp_path / str(resolution)
        rotation_experiment(points, settings).write(folder)
        table = rows(folder, "table2_axis")
        for name, percent in wanted.items():
            assert 100 * float(table[name]["count sigma/mu"]) == pytest.approx(percent, abs=0.03)
            if resolution == 0.2:
                assert float(table[name]["distortion sigma/mu"]) == pytest.approx(error[name], abs=0.0002)


@pytest.mark.parametrize("name", NAMES)
def test_uniform_points_have_the_exact_moments(name: str) -> None:
    lattice = Lattice.named(name)
    points = uniform_on_cells(lattice, 100_000, np.random.default_rng(1))
    square = ((points - lattice.centres(lattice.quantise(points))) ** 2).sum(axis=1) / lattice.dim
    assert square.mean() == pytest.approx(lattice.cell.second_moment, abs=5 * square.std() / np.sqrt(len(square)))


def test_the_quantiser_report_holds_its_own_figures(tmp_path: Path) -> None:
    quantiser_experiment(count=20_000).write(tmp_path)
    for row in rows(tmp_path, "moments").values():
        half = 2.5 * (float(row["G measured_high"]) - float(row["G measured"]))  # five sigma
        assert abs(float(row["G measured"]) - float(row["G exact"])) < half
    for row in rows(tmp_path, "volumes").values():
        assert float(row["polytope"]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("name", "size", "mean"),
    [
        ("Z2", 4, 1.27324), ("Z2", 8, 1.054786), ("Z2", 16, 1.014379), ("A2", 6, 1.102658), ("A2", 12, 1.023491),
        ("Z3", 6, 1.5), ("Z3", 18, 1.128626), ("Z3", 26, 1.087994), ("D3", 12, 1.224745), ("D3", 18, 1.128626),
        ("D3*", 8, 1.439663), ("D3*", 14, 1.167158),
    ],
)  # fmt: skip
def test_free_paths_are_as_long_as_the_checked_table_says(name: str, size: int, mean: float) -> None:
    lattice = Lattice.named(name)
    assert mean_path_factor(lattice, lattice.shell(size)) == pytest.approx(mean, abs=2e-5)


def test_ties_are_counted() -> None:
    lattice = Lattice.named("Z2", 0.1)
    assert ties(np.array([[0.05, 0.0], [0.02, 0.01], [0.25, 0.15]]), lattice) == pytest.approx(2 / 3)
    assert ties(np.empty((0, 2)), lattice) == 0.0


def test_nonsense_is_refused() -> None:
    with pytest.raises(ArgumentError):
        RotationSettings(resolution=-1.0)
    with pytest.raises(ArgumentError):
        RotationSettings(resolution=0.1, step=0.0)
    with pytest.raises(ArgumentError):
        rotation_experiment(np.zeros((5, 3)), RotationSettings(resolution=0.1))
    with pytest.raises(ArgumentError):
        rotation_experiment(room3(100)[:, :2], RotationSettings(resolution=0.1, lattices=("D3",)))


def test_the_commands_of_the_experiments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cloud = tmp_path / "room.xyz"
    np.savetxt(cloud, room3(3000), fmt="%.3f")
    out = tmp_path / "report"
    few = ["--random", "8", "--step", "20"]
    assert main(["experiment", "rotation", str(cloud), "-o", str(out), "--volume", "0.027", *few]) == 0
    assert (out / "report.html").stat().st_size > 10_000
    assert main(["show", str(cloud), "--lattice", "D3s", "--volume", "0.008", "-o", str(tmp_path / "a.png")]) == 0
    assert main(["show", str(cloud), "--volume", "0.008", "-o", str(tmp_path / "a.glb")]) == 0
    log, truth, world = (str(tmp_path / n) for n in ("r.clf", "r.tum", "r.parquet"))
    assert main(["simulate", "room", "-o", log, "--truth", truth, "--duration", "20"]) == 0
    flat = tmp_path / "flat"
    assert main(["experiment", "rotation", log, "--poses", truth, "-o", str(flat), "--area", "0.25", *few]) == 0
    assert main(["build", log, "-o", world, "--poses", truth]) == 0
    again = ["experiment", "rotation", world, "-o", str(flat / "map"), "--area", "0.25", *few]
    assert main(again) == 0
    assert "not sensor readings" in (flat / "map" / "report.md").read_text()
    capsys.readouterr()
    for arguments, word in [
        ([*again[:5], "--area", "0.04", *few], "ten times"),
        (["experiment", "rotation", str(cloud), "-o", str(out)], "--volume"),
        (["experiment", "rotation", str(cloud), "-o", str(out), "--volume", "1", "--resolution", "1"], "same thing"),
        (["experiment", "rotation", str(tmp_path / "no.pcd"), "-o", str(out), "--volume", "1"], "no.pcd"),
        (["experiment", "rotation", log, "-o", str(out), "--volume", "1"], "CARMEN"),
        (["experiment", "rotation", str(cloud), "-o", str(cloud), "--volume", "1"], "folder"),
        (["experiment", "rotation", str(cloud), "-o", str(out), "--volume", "1", "--basis", "1,2;3"], "basis"),
        (
            ["experiment", "rotation", str(cloud), "-o", str(out), "--volume", "1", "--crop", "9,9,9,10,10,10"],
            "filters",
        ),
        (["show", str(cloud), "-o", str(tmp_path / "b.png")], "how large"),
        (["show", str(cloud), "-o", str(tmp_path / "b.bmp"), "--volume", "1"], "bmp"),
    ]:
        code = 2 if word in ("--volume", "same thing", "basis", "bmp") else 1
        assert main(arguments) == code, arguments
        err = capsys.readouterr().err
        assert word in err and err.count("\n") == 1, err
