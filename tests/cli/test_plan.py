"""The command ``hexmap plan`` as a user meets it, and the files it writes."""

from __future__ import annotations

import gzip
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, FileAccessError, FormatError, LatticeError
from hexmap.cli import console, main
from hexmap.cli.plan import command as planning
from hexmap.cli.plan import map_source as _plan_ground
from hexmap.graph.lattice_graph import LatticeGraph
from hexmap.io.grids.open_grid import open_grid
from hexmap.io.map_file import load_map, save_map
from hexmap.lattice._kernels import quantise_2d
from hexmap.lattice.lattice import NAMES, Lattice
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Level, Map
from hexmap.maps.voxel_list import VoxelList
from planners import astar
from planners.path_files import is_path_file, path_headings, read_path, write_path
from tests.cli.test_cli import failure
from tests.lattices import CASES, JIT, Case


def call(*arguments: object) -> int:
    return main([str(a) for a in arguments])


def wrong_usage(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    capsys.readouterr()
    assert call(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("hexmap: ") and "plan --help" in err
    return err


ASTAR = ("--planner", "astar")
is_compiled = console.is_compiled  # the fixtures replace it
PAST = ("--from", -1.5, -0.5, "--to", 1.5, -0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two rooms of 4 x 4 m about the origin with a door between them, as every kind of file."""
    here = tmp_path_factory.mktemp("plan")
    lattice = Lattice.named("A2", 0.1)
    xs, ys = np.meshgrid(np.arange(-41, 42) * 0.05, np.arange(-21, 22) * 0.05)
    points = np.stack([xs.ravel(), ys.ravel()], axis=1)
    x, y = points.T
    wall = (np.abs(x) > 1.97) | (np.abs(y) > 0.97) | ((np.abs(x) < 0.06) & (y < 0.4))
    hits, passes = VoxelList.from_points(points[wall], lattice), VoxelList.from_points(points[~wall], lattice)
    # A cell seen by both is a wall.
    passes = passes.select(~hits.contains(passes.index))
    save_map(here / "rooms.parquet", Map([Level(hits, passes)]))
    rows = ["@" * 12, *["@....@.....@"] * 3, *["@..........@"] * 2, "@" * 12]
    (here / "rooms.map").write_text(f"type octile\nheight {len(rows)}\nwidth 12\nmap\n" + "\n".join(rows) + "\n")
    states = np.full((20, 40), 254, np.uint8)
    states[:, 20] = 0
    states[:4, 20] = 254
    states[12:, 30:] = 205
    (here / "rooms.pgm").write_bytes(b"P5\n40 20\n255\n" + states.tobytes())
    (here / "rooms.yaml").write_text(
        "image: rooms.pgm\nresolution: 0.1\norigin: [-2.0, -1.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    walls = "".join(f"4 {y} {z}\n" for y in range(8) for z in range(6) if z < 4)
    (here / "rooms.3dmap.gz").write_bytes(gzip.compress(f"voxel 9 8 6\n{walls}".encode()))
    return here


def test_a_path_through_a_map_of_ones_own(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv, png = tmp_path / "path.csv", tmp_path / "path.png"
    plain = ("plan", folder / "rooms.parquet", "--from", "-1.5", "-.5", "--to", 1.5, "-0.5", "--radius", 0.15)
    arguments = (*plain, *ASTAR)
    assert call(*arguments, "-o", csv, "--picture", png) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0].startswith(f"{folder / 'rooms.parquet'}: hexagonal lattice at 0.1 m, 6 moves, window of ")
    assert (
        out[1].startswith("A* from (-1.5, -0.5) to (1.5, -0.5): length ")
        and "m from occupied cells, " in out[1]
        and out[1].endswith(" cells")
    )
    assert "expansions" in out[2] and out[-2].startswith(f"wrote {csv}") and out[-1].startswith(f"wrote {png}")
    table = read_path(csv)
    lattice = Lattice.named("A2", 0.1)
    assert np.array_equal(lattice.quantise(np.array([[-1.5, -0.5], [1.5, -0.5]])), table.cells[[0, -1]])
    assert table.points[[0, -1]].tolist() == [[-1.5, -0.5], [1.5, -0.5]]
    assert np.array_equal(lattice.centres(table.cells)[1:-1], table.points[1:-1])
    assert table.length[0] == 0.0 and f"length {table.length[-1]:.3f} m" in out[1]
    assert table.points[:, 1].max() > 0.4  # through the door
    assert png.stat().st_size > 10_000
    # The same again in other spellings, and by the other planners.
    length = table.length[-1]
    first = csv.read_bytes()
    for spelling in (("--to=1.5,-0.5", "--from=-1.5,-0.5"), ("--from", "-1.5,-5e-1", "--to", "+1.5,", "-0.5")):
        assert call("plan", *spelling, folder / "rooms.parquet", *ASTAR, "--radius", 0.15, "-o", csv) == 0
        assert csv.read_bytes() == first
    for more in (["--planner", "dijkstra"], ["--planner", "canonical"], [*ASTAR, "--bidirectional"],
                 [*ASTAR, "--weight", 1.0]):  # fmt: skip
        assert call(*plain, "-o", csv, *more) == 0
        # Of equally long ways between the cells each planner takes its own, and the end pieces differ.
        assert read_path(csv).length[-1] == pytest.approx(length, abs=0.1)
    for more in (["--planner", "any-angle"], [*ASTAR, "--shortcut"], [*ASTAR, "--neighbourhood", "extended"],
                 [*ASTAR, "--neighbourhood", 12]):  # fmt: skip
        assert call(*plain, "-o", csv, *more) == 0
        assert read_path(csv).length[-1] < length
    assert call(*arguments, "-o", csv, "--clearance-weight", 3, "--clearance-reach", 0.4) == 0
    assert read_path(csv).length[-1] >= length - 1e-9


def test_without_a_planner_the_path_is_straight(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csv = tmp_path / "path.csv"
    own = ("plan", folder / "rooms.parquet", *PAST, "-o", csv)
    assert call(*own, "--planner", "any-angle") == 0
    best = csv.read_bytes()
    least = read_path(csv).length[-1]
    capsys.readouterr()
    assert call(*own) == 0
    assert csv.read_bytes() == best
    assert capsys.readouterr().out.splitlines()[1].startswith("any-angle from (-1.5, -0.5) to ")
    straightened = "A*, straightened by line of sight, from (-1.5, -0.5) to "
    cost_kept = "A*, straightened by line of sight where that costs no more, from (-1.5, -0.5) to "
    capsys.readouterr()
    # What the any-angle planner does not take, A* does, and its path is straightened.
    for more, words in [
        (["--neighbourhood", 12], "any-angle from "), (["--weight", 2], straightened), (["--shortcut"], straightened),
        (["--bidirectional"], straightened), (["--nearest"], straightened), (["--clearance-weight", 3], cost_kept),
    ]:  # fmt: skip
        assert call(*own, *more) == 0
        assert capsys.readouterr().out.splitlines()[1].startswith(words)
        length = read_path(csv).length[-1]
        if "--shortcut" not in more:
            assert call(*own, *ASTAR, *more) == 0
            assert least - 0.01 < length < read_path(csv).length[-1]
        capsys.readouterr()
    space = ("plan", folder / "rooms.3dmap.gz", "--from", 1, 3, 1, "--to", 7, 3, 1, "-o", csv)
    assert call(*space, *ASTAR) == 0
    jagged = read_path(csv).length[-1]
    capsys.readouterr()
    assert call(*space) == 0
    assert capsys.readouterr().out.splitlines()[1].startswith("A*, straightened by line of sight, from (1, 3, 1) to ")
    assert read_path(csv).length[-1] < jagged


def test_straightening_keeps_the_cost_of_clearance(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    hall = tmp_path / "hall.map"
    hall.write_text("type octile\nheight 20\nwidth 60\nmap\n" + ("." * 60 + "\n") * 9 + "." * 30 + "@" * 30 + "\n"
                    + ("." * 60 + "\n") * 10)  # fmt: skip
    way = ("plan", hall, "--from", 2, 9, "--to", 57, 8, "--clearance-weight", 5, "--clearance-reach", 4)
    costs, lengths = [], []
    for more in (ASTAR, ()):
        assert call(*way, *more) == 0
        line = capsys.readouterr().out.splitlines()[1]
        costs.append(float(line.split("cost ")[1].split(",")[0]))
        lengths.append(float(line.split("length ")[1].split(" m")[0]))
    assert costs[1] < 0.95 * costs[0] and lengths[1] < 0.95 * lengths[0] and lengths[1] > 55.5


def test_maps_of_others(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv = tmp_path / "path.csv"
    assert call("plan", folder / "rooms.yaml", "--from", -1.5, -0.5, "--to", 1.5, 0.5, "-o", csv) == 0
    assert "hexagonal lattice at 0.05 m" in capsys.readouterr().out
    assert read_path(csv).points[:, 1].max() > 0.5
    game = ("plan", folder / "rooms.map", "--from", 2, 1, "--to", 8, 1)
    moves = (*ASTAR, "--neighbourhood", "extended")
    assert call(*game, "--lattice", "Z2", "--resolution", 1, *moves, "-o", csv) == 0
    assert read_path(csv).length[-1] == pytest.approx(4 * math.sqrt(2) + 4)  # no corner is cut
    assert (
        call(*game[:3], 1, 0.5, "--to", 4, 0.5, "--cell", 0.5, "-o", csv, "--picture", tmp_path / "p.svg", "--whole")
        == 0
    )
    assert "at 0.25 m" in capsys.readouterr().out
    for lattice in ("Z3", "D3", "D3*"):
        arguments = ("plan", folder / "rooms.3dmap.gz", "--from", 1, 3, 1, "--to", 7, 3, 1, "--lattice", lattice)
        assert call(*arguments, "--resolution", 0.5, "-o", csv, "--picture", tmp_path / "space.png") == 0
        assert csv.read_text().startswith("x,y,z,a,b,c,length,heading,pitch\n")
        assert read_path(csv).points[:, 2].max() > 3.49
    assert (tmp_path / "space.png").stat().st_size > 5_000


def test_the_nearest_cell_to_a_goal_that_cannot_be_reached(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("plan", folder / "rooms.yaml", "--from", -1.5, -0.5, "--to", 1.7, -0.8)
    text = failure(capsys, *arguments)
    assert " is unknown; " in text and text.endswith("; --nearest or --unknown free may help\n")
    assert call(*arguments, "--nearest", "--picture", tmp_path / "p.png") == 0
    out = capsys.readouterr().out
    assert "the goal was not reached: the path stops at (" in out and "m away from it" in out
    assert call(*arguments, "--unknown", "free") == 0
    assert "not reached" not in capsys.readouterr().out
    assert call(*arguments[:5], "--to", 50, 60, "--nearest", "--picture", tmp_path / "p.png") == 0
    assert "the goal was not reached" in capsys.readouterr().out.splitlines()[0]
    assert "--nearest" not in failure(capsys, *arguments[:5], "--to", 50, 60)


def test_no_path_says_why_and_what_may_help(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = ("plan", folder / "rooms.parquet")
    cases = [
        (("--from", -1.5, 0, "--to", 0, -0.5), "goal blocked: (0, -0.5) m, cell (", "; --nearest may"),
        (("--from", 0, -0.5, "--to", 1, 0), "no path: start blocked: (0, -0.5) m, cell (", "is occupied; the nearest"),
        (("--from", -1, 0, "--to", 900, 1), "goal outside the map: (900, 1) m", "x from -"),
        (("--from", -9, -9, "--to", 1, 0), "start outside the map: (-9, -9) m", "y from -"),
        (("--from", -1.5, 0, "--to", -0.3, -0.5, "--radius", 0.5), "nearer than the radius of 0.5 m", "a smaller"),
        (("--from", -1.5, 0, "--to", 1.4, 0, "--radius", 0.4), "not connected: nothing leads from (-1.5, 0) m", "or"),
    ]  # fmt: skip
    for arguments, *words in cases:
        text = failure(capsys, *own, *arguments, "-o", tmp_path / "p.csv", "--picture", tmp_path / "p.png")
        assert all(word in text for word in words), text
        assert not list(tmp_path.iterdir())


def test_a_blocked_end_names_the_nearest_cell_that_can_be_taken(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csv = tmp_path / "p.csv"
    graph = LatticeGraph.from_map(load_map(folder / "rooms.parquet"))
    centres = graph.centres(np.flatnonzero(graph.free))
    wall, other, room = (0.0, -0.5), (-1.95, 0.99), (1.0, 0.0)
    for start, goal, at, option in ((wall, room, 0, "--to"), (room, wall, 1, "--from"), (wall, other, 0, "")):
        way = ("plan", folder / "rooms.parquet", "--from", *start, "--to", *goal)
        text = failure(capsys, *way)
        connected = f" that {option} is connected with" if option else ""
        assert f"; the nearest free cell{connected} is at (" in text
        place = [float(v) for v in text.split(" is at (")[1].split(")")[0].split(",")]
        asked = np.array((start, goal)[at])
        least = np.linalg.norm(centres - asked, axis=1).min()  # all rooms are connected
        cell = graph.lattice.quantise(np.array([place]))
        assert graph.free[graph.index_to_flat(cell)[0]]
        assert np.linalg.norm(graph.lattice.centres(cell)[0] - asked) == pytest.approx(least, abs=1e-9)
        if option:  # it can be taken as it is printed
            ends: list[tuple[float, ...]] = [start, goal]
            ends[at] = tuple(place)
            assert call("plan", folder / "rooms.parquet", "--from", *ends[0], "--to", *ends[1], "-o", csv) == 0
    text = failure(capsys, "plan", folder / "rooms.parquet", "--from", *wall, "--to", *room, "--radius", 5)
    assert "nearest free" not in text
    text = failure(capsys, "plan", folder / "rooms.map", "--from", 2, 1, "--to", 40, 1)
    assert "the map has x from -0.50 to 11.50 m, y from -0.50 to 6.50 m" in text


def test_the_disc_of_the_robot_at_unknown_cells(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Unknown is what lies right of x = 1 and below y = -0.2: within 0.3 m of (x, 0) from x = 0.776 on.
    way = ("plan", folder / "rooms.yaml", "--from", 0.4, 0, "--to", 1.6, 0, "--lattice", "Z2")
    line = "the robot's disc meets unknown cells along "
    for planner in ("astar", "any-angle"):
        for radius, share in ((0.0, 0), (0.15, 0), (0.3, 100 * 17 / 25)):
            assert call(*way, "--radius", radius, "--planner", planner) == 0
            found = [text for text in capsys.readouterr().out.splitlines() if text.startswith(line)]
            told = f"{line}{share:.0f}% of the path; --radius keeps it off occupied cells only"
            assert found == ([told] if share else [])
    assert call(*way, "--radius", 0.3, "--unknown", "free") == 0
    assert line not in capsys.readouterr().out
    assert call("plan", folder / "rooms.map", "--from", 2, 2.5, "--to", 8, 2.5, "--radius", 0.5) == 0
    assert line not in capsys.readouterr().out


def test_what_the_effort_is_compared_with(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    way = ("plan", folder / "rooms.map", "--from", 2, 1, "--to", 8, 1)
    assert call(*way, "--planner", "any-angle") == 0
    out = capsys.readouterr().out
    assert " times the straight line\n" in out and "least cost" not in out
    assert call(*way, "--weight", 2) == 0
    assert re.search(r" ms, at most [12]\.?\d* times the least cost\n", capsys.readouterr().out)


def test_jagged_paths_are_told_how_to_straighten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # Hexagons of this orientation have no move along x.
    hall = tmp_path / "hall.map"
    hall.write_text("type octile\nheight 20\nwidth 60\nmap\n" + ("." * 60 + "\n") * 20)
    way = ("plan", hall, "--from", 2, 10, "--to", 55, 10, "--lattice", "A2")
    ways = "--shortcut straightens it, as does leaving out --planner"
    hint_of_astar = f"jagged: {ways}, --neighbourhood extended turns less"
    for more, hint in [
        (ASTAR, hint_of_astar),
        ((*ASTAR, "--clearance-weight", 0), hint_of_astar),
        ((*ASTAR, "--shortcut"), ""),
        ((), ""),
        ((*ASTAR, "--neighbourhood", "extended"), ""),
        ((*ASTAR, "--lattice", "Z2"), ""),
    ]:
        given = way[:-2] if "--lattice" in more else way
        assert call(*given, *more) == 0
        assert [t for t in capsys.readouterr().out.splitlines() if t.startswith("jagged")] == ([hint] if hint else [])


def test_a_planner_that_was_never_compiled_is_announced(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    way = ("plan", folder / "rooms.map", "--from", 2, 1, "--to", 8, 1)
    # On standard error, a terminal or not: a script's log should say what it waits for.
    monkeypatch.setattr(console, "is_compiled", is_compiled)
    for planner in ("astar", "dijkstra", "canonical", "any-angle"):
        assert call(*way, "--planner", planner) == 0  # compiled by now
        capsys.readouterr()
        assert call(*way, "--planner", planner) == 0
        assert capsys.readouterr().err == ""
        with monkeypatch.context() as patch:
            patch.setattr(console, "is_compiled", lambda kernel: kernel is quantise_2d)
            assert call(*way, "--planner", planner) == 0
            assert re.fullmatch(r"(compiling the planner, once, some \d+ s\n)+", capsys.readouterr().err)
            patch.setattr(console, "is_compiled", lambda kernel: False)
            assert call(*way, "--planner", planner) == 0
            assert re.match(r"compiling kernels, once, some \d+ s\n", capsys.readouterr().err)
    if JIT:
        assert is_compiled(quantise_2d)


def gap(points: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Return the least distance of points (M, n) to boxes between corners (K, n)."""
    off = np.maximum(np.maximum(low - points[:, None], points[:, None] - high), 0.0)
    return float(np.sqrt((off**2).sum(axis=2)).min())


def printed_clearance(out: str) -> float:
    return float(out.split("least clearance ")[1].split(" m from occupied cells")[0])


@pytest.mark.parametrize(
    ("name", "lattice", "ends"),
    [
        ("rooms.map", "A2", ("--from", 2, 2.5, "--to", 8, 2.5)),
        ("rooms.map", "Z2", ("--from", 2, 2.5, "--to", 8, 2.5)),
        ("rooms.yaml", "A2", ("--from", -1.5, -0.5, "--to", 0.7, -0.5)),
        ("rooms.3dmap.gz", "D3", ("--from", 1, 3, 1, "--to", 7, 3, 1)),
        ("rooms.3dmap.gz", "D3*", ("--from", 1, 3, 1, "--to", 7, 3, 1)),
    ],
)
def test_the_disc_of_the_robot_keeps_off_the_cells_of_the_source(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, lattice: str, ends: tuple[object, ...]
) -> None:
    world = open_grid(folder / name)
    blocked = np.argwhere(world.states == CellState.OCCUPIED).astype(float)
    low, high = world.centre(blocked - 0.5), world.centre(blocked + 0.5)
    csv = tmp_path / "path.csv"
    on = ("--lattice", lattice, "--resolution", 0.5 * world.cell)
    arguments = ("plan", folder / name, *ends, *on, "-o", csv, *ASTAR)
    radii = (0.0, 0.05, 0.1) if name == "rooms.yaml" else (0.0, 0.3, 0.5, 0.62)
    for radius in radii:
        assert call(*arguments, "--radius", radius) == 0
        least = gap(read_path(csv).points, low, high)
        assert least >= radius - 1e-9
        # What is printed counts the cells between as well, which a path of single moves has not.
        assert printed_clearance(capsys.readouterr().out) == pytest.approx(least, abs=0.0051)


def test_the_disc_of_the_robot_keeps_off_the_cells_of_ones_own_map(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csv = tmp_path / "path.csv"
    level = load_map(folder / "rooms.parquet").levels[0]
    walls = level.hits.centres()
    corners = level.lattice.cell.vertices
    for radius in (0.1, 0.15, 0.2):
        assert call("plan", folder / "rooms.parquet", *PAST, *ASTAR, "--radius", radius, "-o", csv) == 0
        points = read_path(csv).points
        # Edge by edge; the centres of free cells are outside of all hexagons.
        least = math.inf
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            off = points[:, None] - walls - a
            along = np.clip(off @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            least = min(least, float(np.linalg.norm(off - along[..., None] * (b - a), axis=2).min()))
        assert least >= radius - 1e-9
        assert printed_clearance(capsys.readouterr().out) == pytest.approx(least, abs=0.0051)


def test_clearance_changes_the_path_at_its_defaults(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csv = tmp_path / "path.csv"
    game = ("plan", folder / "rooms.map", "--from", 2, 1, "--to", 8, 1, "-o", csv)
    assert call(*game) == 0
    before = capsys.readouterr().out
    assert call(*game, "--clearance-weight", 5) == 0
    after = capsys.readouterr().out
    assert float(after.split("cost ")[1].split(",")[0]) > float(before.split("cost ")[1].split(",")[0]) + 0.1
    assert call(*game, "--clearance-weight", 1e6, "--clearance-reach", 5) == 0
    assert "e+06, turning" in capsys.readouterr().out


def test_the_default_resolution(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("plan", folder / "rooms.map", "--from", 2, 1, "--to", 8, 1, "--cell", 1) == 0
    assert "hexagonal lattice at 0.5 m on cells of 1 m, " in capsys.readouterr().out
    assert call("plan", folder / "rooms.3dmap.gz", "--from", 1, 3, 1, "--to", 2, 3, 1) == 0
    assert "face-centred cubic lattice at 1 m on cells of 1 m, " in capsys.readouterr().out


def test_a_lattice_too_small_or_large_for_floats_says_so() -> None:
    for resolution in (1e-300, 1e300):
        with pytest.raises(LatticeError, match=r"too short or too long to measure: \[.*e[-+](300|299)"):
            Lattice.named("A2", resolution)
    with pytest.raises(LatticeError, match="independent"):
        Lattice([[1.0, 0.0], [0.0, 0.0]])


def test_what_is_counted(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = ("plan", folder / "rooms.parquet", "--from", -1.5, -0.5)
    for more, word in ((ASTAR, "cell"), (("--shortcut",), "point"), ((), "point")):
        csv = tmp_path / "p.csv"
        assert call(*own, "--to", -1.5, -0.5, *more, "-o", csv) == 0
        out = capsys.readouterr().out.splitlines()
        assert out[1].endswith(f", 1 {word}") and "(1 point, metres)" in out[3]
        assert call(*own, "--to", 1.5, -0.5, *more, "-o", csv) == 0
        out = capsys.readouterr().out.splitlines()
        assert out[1].endswith(f", {len(read_path(csv).points)} {word}s")


def test_no_image_of_a_ros_map_is_overwritten(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from matplotlib.image import imsave

    (tmp_path / "images").mkdir()
    yaml = (folder / "rooms.yaml").read_text()
    ends = ("--from", -1.5, -0.5, "--to", 1, 0.5)
    for k, name in enumerate(("img.png", "images/other.png", str(tmp_path / "absolute.png"), '"quoted.png"  # this')):
        image = tmp_path / name.split('"')[1 if name[0] == '"' else 0]
        imsave(image, np.full((20, 40, 3), 254, np.uint8))
        kept = image.read_bytes()
        map = tmp_path / f"map{k}.yaml"
        map.write_text(yaml.replace("rooms.pgm", name))
        assert f"--picture would overwrite what is read: {image}" in failure(
            capsys, "plan", map, *ends, "--picture", image
        )
        link = tmp_path / f"link{k}.png"
        link.symlink_to(image)
        assert "--picture would overwrite" in failure(capsys, "plan", map, *ends, "--picture", link)
        assert image.read_bytes() == kept
        assert call("plan", map, *ends, "--picture", tmp_path / f"map{k}.png") == 0
        assert image.read_bytes() == kept


def test_memory(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    found = _plan_ground._available_memory()
    assert found > 2**20

    def unreadable(*arguments: object, **more: object) -> str:
        raise PermissionError

    with monkeypatch.context() as patch:
        patch.setattr(_plan_ground.Path, "read_text", unreadable)
        assert _plan_ground._available_memory() > 2**20
    monkeypatch.setattr(_plan_ground, "_available_memory", lambda: 2000.0)
    text = failure(capsys, "plan", folder / "rooms.map", "--from", 2, 1, "--to", 8, 1)
    assert "GiB of 0.0 that are available); take a coarser --resolution" in text


def test_bad_input_is_one_line_and_loses_nothing(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "path.csv"
    out.write_bytes(b"an old path")
    bad = tmp_path / "bad.map"
    bad.write_text("type octile\nheight 3\nwidth 3\nmap\n...\n")
    own, game, space = folder / "rooms.parquet", folder / "rooms.map", folder / "rooms.3dmap.gz"
    (folder / "rooms.scen").write_text("version 1\n")
    yaml = (folder / "rooms.yaml").read_text()
    (folder / "gone.yaml").write_text("# no such image\n" + yaml.replace("rooms.pgm", "gone.pgm"))
    way = ("--from", -1.5, 0, "--to", 1.5, 0)
    cases = [
        ((tmp_path / "no.map", *way), "no.map"),
        ((tmp_path / "no.parquet", *way), "no.parquet"),
        ((bad, *way), "bad.map"),
        ((folder / "rooms.pgm", *way), "yaml"),
        ((own, *way, "--lattice", "D3"), "dimension 2"),
        ((own, *way, "--resolution", 0.1, "--cell", 1), "leave out --cell"),
        ((game, *way, "--level", 1), "leave out --level"),
        ((own, *way, "--level", 7), "7"),
        ((game, *way, "--lattice", "D3"), "dimension 2"),
        ((game, *way, "--lattice", "hexagone"), "hexagone"),
        ((game, *way, "--resolution", -1), "--resolution must be 1e-06 to 1000000 m, not -1"),
        ((game, *way, "--resolution", 1e-300), "--resolution must be 1e-06 to 1000000 m, not 1e-300"),
        ((game, *way, "--cell", 0), "--cell must be 1e-06 to 1000000 m, not 0"),
        ((game, *way, "--cell", 1e-300), "--cell must be 1e-06 to 1000000 m, not 1e-300"),
        ((folder / "rooms.yaml", *way, "--cell", 1), "cells are; a cell of 1 m cannot change that; leave out --cell"),
        ((folder / "rooms.scen", *way), "name the map itself"),
        ((folder / "gone.yaml", *way), f"gone.yaml, line 2: the image {folder / 'gone.pgm'}: no such file"),
        ((game, "--from", 1, 1, "--to", 1e300, 1), "--to: (1e+300, 1) m is farther away"),
        ((own, *way, "--min-hits", 0), "--min-hits must be 1 to 2147483647, not 0"),
        ((own, *way, "--min-ratio", "nan"), "--min-ratio must be 0 to 1, not nan"),
        ((space, *way), "dimension 3; --from takes 3 numbers, not 2"),
        ((own, "--from", 0, 0, 0, "--to", 1, 1), "dimension 2; --from takes 2 numbers, not 3"),
        ((space, "--from", 1, 1, 1, "--to", 2, 2, 2, "--resolution", 1e-5), "coarser --resolution"),
        ((own, *way, "--radius", -1), "--radius must be 0 to 1000000 m, not -1"),
        ((own, *way, "--radius", "inf"), "--radius must be 0 to 1000000 m, not inf"),
        ((own, *way, "--weight", 0.5), "--weight must be 1 to 1000000, not 0.5"),
        ((own, *way, "--weight", 1e308), "--weight must be 1 to 1000000, not 1e+308"),
        ((own, *way, "--clearance-weight", -2), "--clearance-weight must be 0 to 1000000, not -2"),
        ((own, *way, "--clearance-weight", 1e308, "--clearance-reach", 3), "--clearance-weight must be 0 to 1000000"),
        ((own, *way, "--clearance-weight", 1, "--clearance-reach", 0), "--clearance-reach must be"),
        ((own, *way, "--neighbourhood", 7), "7"),
        ((own, *way, "-o", tmp_path / "p.txt"), ".txt"),
        ((own, *way, "-o", tmp_path / "no" / "p.csv"), "folder"),
        ((own, *way, "--picture", tmp_path / "p.bmp"), "bmp"),
        ((own, *way, "--picture", out), "same file"),
        ((own, *way, "--picture", own), "overwrite"),
        ((folder / "rooms.yaml", *way, "--picture", folder / "rooms.pgm"), "overwrite"),
    ]
    for arguments, word in cases:
        given = arguments if "-o" in arguments else (*arguments, "-o", out)
        wrong = word.startswith("--") and "from" not in word and "--to" not in word
        wrong = wrong or word in ("7", "hexagone", ".txt", "bmp")
        assert word in failure(capsys, "plan", *given, code=2 if wrong else 1), arguments
        assert out.read_bytes() == b"an old path"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bad.map", "path.csv"]


def test_the_help_lists_all_lattices() -> None:
    assert planning._LATTICES == NAMES


def test_wrong_usage(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    own = folder / "rooms.parquet"
    way = ("--from", -1.5, 0, "--to", 1.5, 0)
    cases = [
        ((own, "--from", 0, 0), "--to"),
        ((own, "--from", 1, "--to", 1, 1), "two or three finite numbers of metres, not '1'"),
        ((own, "--from", 1, 2, 3, 4, "--to", 1, 1), "'1,2,3,4'"),
        ((own, "--from", "here", "--to", 1, 1), "'here'"),
        ((own, "--from=nan,0", "--to", 1, 1), "'--from': a position takes finite numbers of metres, not nan"),
        ((own, "--from", 0, 0, "--to", 1, "nan"), "'--to': a position takes finite numbers of metres, not nan"),
        (
            (own, "--from", 0, "-Infinity", "--to", 1, 1),
            "'--from': a position takes finite numbers of metres, not -Inf",
        ),
        ((own, "--from", 0, 0, "--to", 1, 1e999), "'--to': a position takes finite numbers of metres, not inf"),
        ((own, *way, "--from", 1, 0), "--from is given twice"),
        ((own, "--to=1,0", *way), "--to is given twice"),
        ((own, "--from", 0, "x", "--to", 1, 1), "x"),
        ((own, *way, "--planner", "magic"), "magic"),
        ((own, *way, "--unknown", "maybe"), "maybe"),
        ((own, *way, "--neighbourhood", "all"), "'all'"),
        ((own, *way, "--weight", 2, "--bidirectional"), "--bidirectional"),
        ((own, *way, "--planner", "dijkstra", "--nearest"), "--nearest: only with --planner astar, not with dijkstra;"),
        ((own, *way, "--planner", "any-angle", "--nearest"), "in Python planners.nearest_reachable gives the cell"),
        (
            (own, *way, "--planner", "any-angle", "--shortcut"),
            "--shortcut: a path of any angle is straightened already",
        ),
        ((own, *way, "--planner", "canonical", "--clearance-weight", 1), "--clearance-weight"),
        ((own, *way, "--clearance-reach", 1), "--clearance-weight"),
        ((own, *way, "--whole"), "--picture"),
        ((own, *way, "--radius", "wide"), "--radius"),
        ((), "map"),
    ]
    for arguments, word in cases:
        assert word in wrong_usage(capsys, "plan", *arguments), arguments


# ---------------------------------------------------------------------- the file of a path


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_path_file_keeps_every_digit(case: Case, tmp_path: Path) -> None:
    shape = (7,) * case.lattice.dim
    graph = LatticeGraph.from_states(case.lattice, [-3] * case.lattice.dim, np.ones(shape, np.uint8))
    path = astar(graph, [-3] * case.lattice.dim, [3] * case.lattice.dim)
    write_path(tmp_path / "p.csv", path)
    table = read_path(tmp_path / "p.csv")
    assert np.array_equal(table.points, path.points) and np.array_equal(table.cells, path.cells)
    assert table.length[-1] == pytest.approx(path.length, rel=1e-12)
    assert len((tmp_path / "p.csv").read_text().splitlines()) == len(path) + 1
    angles = path_headings(path.points)
    legs = np.diff(path.points, axis=0)
    for k, leg in enumerate(legs):
        assert table.heading[k] == angles[k, 0]
        if np.hypot(leg[0], leg[1]) > 1e-6:
            assert table.heading[k] == pytest.approx(math.atan2(leg[1], leg[0]), abs=1e-12)
        if case.lattice.dim == 3:
            assert table.pitch is not None
            assert table.pitch[k] == pytest.approx(math.asin(leg[2] / np.linalg.norm(leg)), abs=1e-9)
    assert table.heading[-1] == table.heading[-2]  # it arrives as it came


def test_the_command_writes_what_the_ending_says(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for ending in ("csv", "json", "geojson"):
        assert call("plan", folder / "rooms.parquet", *PAST, "-o", tmp_path / f"p.{ending}") == 0
    said = capsys.readouterr().out
    whole = json.loads((tmp_path / "p.json").read_text())
    assert [p["x"] for p in whole["points"]] == read_path(tmp_path / "p.csv").points[:, 0].tolist()
    assert f"least clearance {whole['clearance']:.2f} m" in said and f"length {whole['length']:.3f} m" in said
    feature = json.loads((tmp_path / "p.geojson").read_text())
    assert feature["geometry"]["coordinates"][0] == [-1.5, -0.5] and feature["properties"]["clearance"] > 0.0
    assert "written as .csv, .json, .geojson" in wrong_usage(
        capsys, "plan", folder / "rooms.parquet", *PAST, "-o", tmp_path / "p.kml"
    )


def test_headings_of_legs_that_have_none() -> None:
    up = np.array([[0.0, 0, 0], [0, 0, 1], [1, 1, 1], [1, 1, 1], [1, 1, 0]])
    heading, pitch = path_headings(up).T
    assert heading.tolist() == pytest.approx([math.pi / 4] * 5)  # climbing turns no robot
    assert pitch.tolist() == pytest.approx([math.pi / 2, 0.0, 0.0, -math.pi / 2, -math.pi / 2])
    assert np.isnan(path_headings(np.zeros((3, 2)))).all()
    west = path_headings(np.array([[0.0, 0.0], [-1.0, -0.0]]))
    assert west.tolist() == [[math.pi], [math.pi]]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_path_as_json_and_geojson(dim: int, tmp_path: Path) -> None:
    lattice = Lattice.named({2: "A2", 3: "D3"}[dim], 0.5)
    graph = LatticeGraph.from_states(lattice, [-3] * dim, np.ones((7,) * dim, np.uint8))
    path = astar(graph, [-3] * dim, [3] * dim)
    for ending in ("json", "geojson", "csv"):
        write_path(tmp_path / f"p.{ending}", path)
    table = read_path(tmp_path / "p.csv")
    whole = json.loads((tmp_path / "p.json").read_text())
    assert whole["length"] == path.length and whole["goal_reached"] is True and whole["angles"] == "radians"
    assert [[p[axis] for axis in "xyz"[:dim]] for p in whole["points"]] == path.points.tolist()
    assert [p["heading"] for p in whole["points"]] == table.heading.tolist()
    assert [p["cell"] for p in whole["points"]] == path.cells.tolist()
    feature = json.loads((tmp_path / "p.geojson").read_text())
    assert feature["type"] == "Feature" and feature["geometry"]["type"] == "LineString"
    assert feature["geometry"]["coordinates"] == path.points.tolist()
    assert "not WGS84" in feature["coordinates_are"]  # a foreign member, at the feature itself
    assert feature["properties"]["heading"] == table.heading.tolist()
    assert ("pitch" in feature["properties"]) == (dim == 3)
    assert ("altitude" in feature["coordinates_are"]) == (dim == 3)
    for ending in ("json", "geojson"):
        again = read_path(tmp_path / f"p.{ending}")
        assert np.array_equal(again.points, table.points) and np.array_equal(again.length, table.length)
        assert np.array_equal(again.heading, table.heading)
        assert again.pitch is None if dim == 2 else np.array_equal(again.pitch, table.pitch)
        assert again.cells is None if ending == "geojson" else np.array_equal(again.cells, table.cells)
        assert is_path_file(tmp_path / f"p.{ending}")
    write_path(tmp_path / "one.geojson", astar(graph, [0] * dim, [0] * dim))
    assert read_path(tmp_path / "one.geojson").points.tolist() == [[0.0] * dim]
    one = json.loads((tmp_path / "one.geojson").read_text())
    assert one["geometry"] == {"type": "Point", "coordinates": [0.0] * dim}  # a line takes two
    assert one["properties"]["heading"] == [None]
    with pytest.raises(ArgumentError, match=r"written as \.csv, \.json, \.geojson, not as \.xml"):
        write_path(tmp_path / "p.xml", path)


def test_what_is_no_path_file(tmp_path: Path) -> None:
    file = tmp_path / "p.csv"
    with pytest.raises(FileAccessError, match=r"p\.csv"):
        read_path(file)
    head = "x,y,a,b,length,heading\n"
    for text, word in [
        ("", "line 1"), ("x,y\n1,2\n", "line 1"), (head, "without a point"), (head + "1,2,3\n", "line 2"),
        (head + "1,2,3,4,5,0\n1,2,3.5,4,5,0\n", "line 3"), (head + "nan,2,3,4,5,0\n", "line 2"),
        (head + "1,2,3,4,5,6,7\n", "line 2"), (head + "1,2,3,4,5,inf\n", "line 2"),
        (head + "1,2,3,99999999999,5,0\n", "line 2"), ("x,y,a,b,length\n1,2,3,4,5\n", "length,heading"),
    ]:  # fmt: skip
        file.write_text(text)
        with pytest.raises(FormatError, match=word):
            read_path(file)
    for text in ("{", "[]", '{"points": [{"x": 1}]}', '{"points": []}'):
        (tmp_path / "p.json").write_text(text)
        with pytest.raises(FormatError, match=r"p\.json: not a path that hexmap wrote as \.json"):
            read_path(tmp_path / "p.json")
    file.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FormatError, match="not text"):
        read_path(file)


# ---------------------------------------------------------------------- real maps


@pytest.mark.data
def test_real_maps(data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    csv, png = tmp_path / "p.csv", tmp_path / "p.png"
    ends = ("--from", 15.05, 16.95, "--to", 43, 24.45)
    willow = ("plan", data_dir / "maps" / "willow-2010-02-18-0.10.yaml", *ends, "--lattice", "A2", "--resolution", 0.1)
    assert call(*willow, "--radius", 0.3, "--shortcut", "-o", csv, "--picture", png) == 0
    table = read_path(csv)
    assert 29.0 < table.length[-1] < 36.0 and np.allclose(
        table.points[[0, -1]], [[15.05, 16.95], [43, 24.45]], atol=0.08
    )
    arena = ("plan", data_dir / "planning" / "movingai" / "arena.map", "--from", 1, 7, "--to", 47, 44)
    moves = (*ASTAR, "--neighbourhood", "extended")
    assert call(*arena, "--lattice", "Z2", "--resolution", 1, *moves, "-o", csv) == 0
    assert read_path(csv).length[-1] == pytest.approx(61.3259, abs=1e-4)  # of its scenario
    simple = ("plan", data_dir / "planning" / "warframe" / "Simple.3dmap.gz", "--from", 46, 73, 46, "--to", 75, 57, 57)
    assert call(*simple, "--resolution", 1, "-o", csv, "--picture", png) == 0
    capsys.readouterr()
    assert "coarser --resolution" in failure(capsys, *simple, "--resolution", 0.001)
