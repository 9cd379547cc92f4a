"""The map of Wean Hall, which other programs wrote as well."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, FormatError, TooLargeError
from hexmap.cli import main
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.logs.open_log import open_log
from hexmap.lattice.lattice import Lattice
from hexmap.maps.cell_state import CellState
from localisation.matching.global_matcher import GlobalMatcher
from localisation.matching.pyramid import OccupancyPyramid
from localisation.matching.score import coincidence
from tests.lattices import JIT
from tests.mapping import map_events

UNKNOWN, FREE, OCCUPIED = CellState
# Three along x, two along y.
ROWS = ["1.000 -1.000 ", "0.000 0.700 ", "0.804 0.349 "]
HEAD = [
    "robot_specifications->global_mapsize_x  30",
    "robot_specifications->resolution        25",
    "",
    "global_map[0]: 2 3",
]


def write(folder: Path, *lines: str, name: str = "m.dat") -> Path:
    path = folder / name
    data = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(data) if name.endswith(".gz") else data)
    return path


@pytest.mark.parametrize("name", ["m.dat", "m.dat.gz", "of_any_name"])
def test_one_is_free_and_nought_is_a_wall(tmp_path: Path, name: str) -> None:
    grid = open_grid(write(tmp_path, *HEAD, *ROWS, name=name))
    assert (grid.kind, grid.cell, grid.yaw, grid.y_down) == ("wean", 0.25, 0.0, False)
    assert grid.states.tolist() == [[FREE, UNKNOWN], [OCCUPIED, UNKNOWN], [UNKNOWN, OCCUPIED]]
    assert grid.state_at([[0.1, 0.1], [0.3, 0.1], [0.6, 0.4]]).tolist() == [FREE, OCCUPIED, OCCUPIED]
    assert grid.low.tolist() == [0.0, 0.0] and grid.high.tolist() == [0.75, 0.5]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (HEAD[:2], "no line 'global_map[0]: Y X' in the file"),
        ([HEAD[0], *HEAD[2:], *ROWS], "no line 'robot_specifications->resolution' before the map"),
        (
            [HEAD[0], "robot_specifications->resolution -1", *HEAD[2:], *ROWS],
            "line 2: the resolution must be a positive",
        ),
        ([HEAD[0], "robot_specifications->resolution", *HEAD[2:], *ROWS], "line 2: the resolution must be a positive"),
        ([HEAD[0], "robot_specifications->resolution x", *HEAD[2:], *ROWS], "positive number, not 'x'"),
        ([*HEAD[:3], "global_map[0]: 2", *ROWS], "line 4: two integers belong after global_map[0]:"),
        ([*HEAD[:3], "global_map[0]: 2 0", *ROWS], "line 4: the map is empty: 0 x 2 cells"),
        ([*HEAD, *ROWS[:2]], "line 6: the map ends after 2 lines of 3"),
        ([*HEAD, *ROWS, ROWS[0]], "line 8: the map ends after 4 lines of 3"),
        ([*HEAD, ROWS[0], "1.0", ROWS[2]], "line 6: 1 numbers, where 2 belong"),
        ([*HEAD, ROWS[0], "1.0 wall", ROWS[2]], "line 6: number 1 is 'wall'; a cell is -1, or 0 to 1"),
        ([*HEAD, ROWS[0], "1.5 0", ROWS[2]], "line 6: number 0 is '1.5'; a cell is -1, or 0 to 1"),
        ([*HEAD, ROWS[0], ROWS[1], "0 nan"], "line 7: number 1 is 'nan'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, lines: list[str], message: str) -> None:
    path = write(tmp_path, *lines)
    with pytest.raises(FormatError) as error:
        open_grid(path)
    assert str(error.value).startswith(str(path)) and message in str(error.value) and "\n" not in str(error.value)


def test_its_cell_is_in_the_file_and_its_size_is_bounded(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="the file says how large its cells are"):
        open_grid(write(tmp_path, *HEAD, *ROWS), cell=0.1)
    with pytest.raises(TooLargeError, match="90000 x 90000 cells"):
        open_grid(write(tmp_path, *HEAD[:3], "global_map[0]: 90000 90000"))


def test_info_says_what_a_map_of_others_holds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(write(tmp_path, *HEAD, *ROWS))]) == 0
    out = capsys.readouterr().out
    assert "a map of others (wean), 3 x 2 cells of 0.25 m" in out and "2 occupied, 1 free, 3 unknown" in out
    assert "0.00 to 0.75 m  0.00 to 0.50 m" in out
    text = write(tmp_path, "nothing of the kind", name="a.txt")
    assert main(["info", str(text)]) == 1 and "not a map" in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.data
def test_the_real_map_and_a_way_along_its_corridor(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = data_dir / "laser2d" / "wean" / "wean.dat.gz"
    grid = open_grid(path)
    counts = [int((grid.states == state.value).sum()) for state in (UNKNOWN, FREE, OCCUPIED)]
    assert grid.cell == 0.1 and counts == [571_514, 48_289, 20_197]
    assert main(["plan", str(path), "--from", "20", "41", "--to", "50", "39", "--planner", "any-angle"]) == 0
    assert "length 30.067" in capsys.readouterr().out
    assert main(["plan", str(path), "--from", "20", "41", "--to", "20", "60"]) == 1


@pytest.mark.long
@pytest.mark.data
@pytest.mark.skipif(not JIT, reason="takes hours without the compiler")
def test_the_axes_are_those_of_the_logs_and_not_mirrored(data_dir: Path) -> None:
    folder = data_dir / "laser2d" / "wean"
    states = open_grid(folder / "wean.dat.gz").to_states(Lattice.named("A2", 0.1))
    # The third minute of log 2 leads around corners.
    log = open_log(folder / "robotdata2.log.gz")
    builder, _ = map_events((event for event in log if 120.0 <= event.stamp < 180.0), mount=log.mount)
    points = builder.build().state(level=1).occupied.centres()
    matcher = GlobalMatcher(OccupancyPyramid(coincidence(states.occupied)), states.occupied.merge(states.free))
    right, mirrored = matcher.match(points), matcher.match(points[:, ::-1], runner_up=None)
    assert right is not None and mirrored is not None and right.gap == mirrored.gap == 0
    assert right.score > 1.2 * mirrored.score and right.margin > 0.1
    assert math.hypot(right.pose.x - 33.5, right.pose.y - 40.0) < 0.5
    # Where the robot was is free in the map.
    assert states.of(states.free.lattice.quantise(right.pose.translation[None])).tolist() == [FREE]
    assert np.isfinite(right.pose.theta)
