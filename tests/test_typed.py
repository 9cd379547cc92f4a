"""What a user's type checker sees of the three packages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

SCRIPT = """\
import numpy as np

from hexmap import CellState, Lattice, LatticeGraph, Map, MapBuilder, Pose, Scan, VoxelList
from localisation import MappingSettings, match_anywhere
from planners import astar, dijkstra

blocked = np.zeros((4, 4), dtype=bool)
graph = LatticeGraph.from_array(blocked, "A2", 0.1)
reveal_type(astar(graph, [0, 0], [3, 3]))
reveal_type(dijkstra(graph, [0, 0]).distance)
builder = MapBuilder(np.eye(2) * 0.1)
builder.fuse(Scan(stamp=0.0, points=np.zeros((1, 2))), Pose.identity(2))
made: Map = builder.build()
reveal_type(made.state_at([[0.0, 0.0]]))
match = match_anywhere(made, np.zeros((1, 2)))
assert match is not None
reveal_type(match.pose)
reveal_type(VoxelList.from_points([[0.0, 0.0]], [[0.1, 0.0], [0.0, 0.2]]).lattice)
settings = MappingSettings(lattice=Lattice.named("Z2", 0.1))
graph.no_such_name
VoxelList.from_points([[0.0, 0.0]])
"""


@pytest.mark.parametrize("package", ["hexmap", "planners", "localisation"])
def test_a_package_says_that_it_is_typed(package: str) -> None:
    """That the file goes into the wheel, tests/experiments/test_package_data.py checks."""
    assert (ROOT / package / "py.typed").is_file()


@pytest.mark.long
def test_the_types_of_a_users_script_are_known_and_its_mistakes_are_found(tmp_path: Path) -> None:
    """From folders that are packages of another's environment: mypy reads them for their py.typed only."""
    pytest.importorskip("mypy")
    site = tmp_path / "site"
    site.mkdir()
    for package in ("hexmap", "planners", "localisation"):
        (site / package).symlink_to(ROOT / package)
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(tmp_path / "cache"), "--config-file", os.devnull]
    done = subprocess.run(
        [*command, str(script)],
        env={**os.environ, "PYTHONPATH": str(site), "MYPYPATH": ""},
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    lines = done.stdout.splitlines()
    revealed = [line.partition("Revealed type is ")[2] for line in lines if "Revealed type" in line]
    assert [text.strip('"') for text in revealed if "Any" in text and "ndarray" not in text] == []
    kinds = ("planners.path.Path", "ndarray", "ndarray", "Pose", "Lattice")
    assert len(revealed) == len(kinds) and all(kind in text for kind, text in zip(kinds, revealed, strict=True)), lines
    errors = [line for line in lines if "error:" in line]
    assert len(errors) == 2, lines
    assert "no_such_name" in errors[0] and "lattice" in errors[1]
