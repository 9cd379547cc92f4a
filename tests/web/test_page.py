"""What is in a page: the cells to the last count, nothing that could be run or loaded that is not the page's own."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, BoundsError
from hexmap.cli import main
from hexmap.io.grids.grid_map import GridMap
from hexmap.io.map_file import save_map
from hexmap.lattice.keys import unpack
from hexmap.lattice.lattice import Lattice
from hexmap.maps.map import Level, Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList
from hexmap.web.page import page_html, write_page
from hexmap.web.payload import candidates, on_lattice, page_map, trajectory_runs
from tests.lattices import CASES, SPATIAL
from tests.mapping import room_in_space
from tests.web.node import needs_node, run
from tests.web.worlds import rooms

SHEARED = Lattice([[1.0, 7.0], [0.0, 1.0]], "sheared squares")
LATTICES = [*(case.lattice for case in CASES), SHEARED]
A2 = Lattice.named("A2", resolution=0.1)


class Parts(HTMLParser):
    """The scripts, styles and addresses of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.scripts: dict[str, str] = {}
        self.run: list[str] = []
        self.styles: list[str] = []
        self.addresses: list[str] = []
        self.text = ""
        self.policy = ""
        self._in: tuple[str, dict[str, Any]] = ("", {})
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        given = dict(attrs)
        self._in = tag, given
        self.addresses += [given[k] for k in ("src", "href", "action", "data", "poster") if k in given]
        assert not any(name.startswith("on") or name == "style" for name in given)
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"]

    def handle_data(self, data: str) -> None:
        tag, given = self._in
        if tag == "script":
            self.scripts[given.get("id", "")] = data
            if "type" not in given:
                self.run.append(data)
        elif tag == "style":
            self.styles.append(data)
        else:
            self.text += data

    def handle_endtag(self, tag: str) -> None:
        self._in = ("", {})


def decoded(parts: Parts, m: int = 0, k: int = 0) -> tuple[dict[str, Any], dict[tuple[int, ...], tuple[int, ...]]]:
    """Return a level's numbers, and hits and passes (or the state) of its cells, by the plainest code there is."""
    numbers = json.loads(parts.scripts["header"])["maps"][m]["levels"][k]
    raw = zlib.decompress(base64.b64decode(parts.scripts[f"cells-{m}-{k}"]), -15)
    side, tiles = numbers["side"], np.array(numbers["tiles"]).reshape(-1, len(numbers["basis"]))
    size, at = len(tiles) * side * side, 0
    values = {}
    for name, planes in numbers["planes"].items():
        joined = sum(np.frombuffer(raw, np.uint8, size, at + b * size).astype(np.int64) << 8 * b for b in range(planes))
        at += planes * size
        values[name] = joined.reshape(-1, side, side)
    assert at == len(raw)
    if "passes" in values:
        for tile in values["passes"]:
            for i in range(side) if tile.any() else ():
                for j in range(side):
                    w = int(tile[i, j - 1]) if j else 0
                    n = int(tile[i - 1, j]) if i else 0
                    c = int(tile[i - 1, j - 1]) if i and j else 0
                    guess = min(w, n) if c >= max(w, n) else max(w, n) if c <= min(w, n) else w + n - c
                    coded = int(tile[i, j])
                    tile[i, j] = guess + (coded // 2 if coded % 2 == 0 else -(coded + 1) // 2)
    some = np.any([v != 0 for v in values.values()], axis=0)
    cells = {}
    for t, i, j in np.argwhere(some):
        index = (int(tiles[t, 0]) * side + int(i), int(tiles[t, 1]) * side + int(j), *map(int, tiles[t, 2:]))
        cells[index] = tuple(int(values[n][t, i, j]) for n in ("hits", "passes", "states") if n in values)
    return numbers, cells


@pytest.fixture(scope="module")
def parts() -> Parts:
    return Parts(page_html(rooms(A2, 2), title="rooms"))


def test_a_page_holds_every_count_of_every_level(parts: Parts) -> None:
    for k, level in enumerate(rooms(A2, 2).levels):
        numbers, cells = decoded(parts, 0, k)
        keys, hits, passes = level.columns()
        index = VoxelList(level.lattice, keys, np.ones_like(keys)).index
        assert cells == {tuple(i): (h, p) for i, h, p in zip(*(v.tolist() for v in (index, hits, passes)), strict=True)}
        assert numbers["basis"] == level.lattice.basis.tolist()
        assert numbers["known"] == len(cells)
        assert numbers["low"] == index.min(axis=0).tolist() and numbers["high"] == index.max(axis=0).tolist()


def test_counts_of_many_bytes_survive_and_too_large_ones_are_refused() -> None:
    def of(count: int) -> Map:
        cells = VoxelList.from_cells(np.array([[0, 0], [0, 1]]), A2, np.array([count, 1]))
        return Map([Level(VoxelList.empty(A2), cells)])

    _, cells = decoded(Parts(page_html(of(2**40 + 3))))
    assert cells == {(0, 0): (0, 2**40 + 3), (0, 1): (0, 1)}
    with pytest.raises(BoundsError, match=str(2**60)):
        page_html(of(2**60))


@needs_node
@pytest.mark.parametrize("name", ["A2", "D3"])
def test_the_page_reads_what_is_in_it_and_knows_the_rule(name: str, tmp_path: Path) -> None:
    lattice = Lattice.named(name, 0.1)
    rng = np.random.default_rng(5)
    index = rng.integers(-40, 40, (900, lattice.dim))
    index[:, 2:] //= 20
    # Counts of one byte and of five, and shares that are exactly the rule's.
    lists = [
        VoxelList.from_cells(index[rng.random(900) < 0.7], lattice),
        VoxelList.from_cells(index[:300], lattice, rng.integers(1, 2**40, 300)),
    ]
    tens = VoxelList.from_cells(index[:50], lattice, np.full(50, 28))
    rest = VoxelList.from_cells(index[:50], lattice, np.full(50, 72))
    for hits, passes in ((lists[0], lists[1]), (lists[1], lists[0]), (tens, rest)):
        world, rule = Map([Level(hits, passes)]), StateRule(min_hits=2, min_ratio=0.28, min_passes=3)
        made = Parts(page_html(world, rule=rule, height=0.0 if lattice.dim == 3 else None))
        given = {"header": json.loads(made.scripts["header"]), "texts": [made.scripts["cells-0-0"]]}
        (cells,) = run(tmp_path, ["cells.js"], "decode.js", given)
        keys, h, p = world.levels[0].columns()
        known = unpack(keys, lattice.dim)
        want = sorted(zip(known.tolist(), world.state(rule).of(known).tolist(), h.tolist(), p.tolist(), strict=True))
        assert sorted(map(tuple, cells)) == want


def test_a_map_of_others_keeps_its_squares_where_they_are() -> None:
    states = np.array([[0, 1, 2], [1, 1, 2]], np.uint8)
    grid = GridMap(states, 0.5, np.array([10.0, -3.0]), yaw=0.3)
    numbers, cells = decoded(Parts(page_html(grid)))
    assert cells == {(0, 1): (1,), (0, 2): (2,), (1, 0): (1,), (1, 1): (1,), (1, 2): (2,)}
    centres = np.array(list(cells)) @ np.array(numbers["basis"]).T + numbers["origin"]
    np.testing.assert_allclose(centres, grid.centre(np.array(list(cells))), atol=1e-12)


@pytest.mark.parametrize("lattice", LATTICES, ids=lambda lattice: lattice.name)
def test_the_nearest_centre_is_always_among_the_candidates(lattice: Lattice) -> None:
    rng = np.random.default_rng(3)
    u = rng.uniform(-4.0, 4.0, (4000, lattice.dim))
    low = np.floor(u)
    for offsets in (candidates(lattice), candidates(lattice, touching=False)):
        away = np.linalg.norm((u - low)[:, None] @ lattice.basis.T - offsets @ lattice.basis.T, axis=2)
        found = low + offsets[away.argmin(axis=1)]
        assert (found == lattice.quantise(u @ lattice.basis.T)).all()


def test_comparing_takes_what_is_at_the_centre_of_each_cell_and_walls_whole() -> None:
    world = rooms(A2, 2)
    for other in ("Z2", Lattice([[0.131, 0.047], [-0.022, 0.088]], "skew")):
        level = on_lattice(world, page_map(world), other).levels[1]
        on = level.lattice
        assert on.resolution == pytest.approx(0.2 if other == "Z2" else 2 * other.resolution)  # type: ignore[union-attr]
        box = np.indices((70, 70)).reshape(2, -1).T - 25
        keys, hits, passes = world.levels[1].columns()
        at = VoxelList(world.levels[1].lattice, keys, np.ones_like(keys))
        counts = dict(zip(map(tuple, at.index.tolist()), zip(hits.tolist(), passes.tolist(), strict=True), strict=True))
        want = {}
        for cell, own in zip(box.tolist(), at.lattice.quantise(on.centres(box)).tolist(), strict=True):
            if tuple(own) in counts:
                want[tuple(cell)] = counts[tuple(own)]
        for number, cell in enumerate(on.quantise(at.centres()).tolist()):
            own = tuple(at.index[number].tolist())
            rivals = [
                counts[tuple(at.index[k].tolist())]
                for k in np.flatnonzero((on.quantise(at.centres()) == cell).all(axis=1)).tolist()
                if counts[tuple(at.index[k].tolist())][0]
            ]
            if counts[own][0]:
                want[tuple(cell)] = max(rivals)
        assert level.hits is not None and level.passes is not None
        got = zip(level.index.tolist(), level.hits.tolist(), level.passes.tolist(), strict=True)
        assert {tuple(i): (h, p) for i, h, p in got} == want


def test_the_same_map_gives_the_same_bytes(tmp_path: Path) -> None:
    world = rooms(A2, 1)
    one, two = (write_page(world, tmp_path / f"{k}.html", title="t", compare="Z2") for k in (1, 2))
    assert one.read_bytes() == two.read_bytes()


def test_nothing_is_loaded_and_only_the_pages_own_scripts_run(parts: Parts) -> None:
    assert parts.addresses and all(a.startswith("data:image/png;base64,") for a in parts.addresses)
    for text in (*parts.run, *parts.styles):
        assert not re.search(r"https?:|@import|url\(|\bimport\b|fetch\(|XMLHttp|\beval\b|innerHTML", text)

    def source(text: str) -> str:
        return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"

    rules = dict(rule.strip().split(" ", 1) for rule in parts.policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["script-src"].split() == [*map(source, parts.run)]
    assert rules["style-src"].split() == [*map(source, parts.styles)]


def test_texts_are_escaped() -> None:
    nasty = "</script><script>alert(1)</script><img src=x onerror=alert(2)>&amp;\"'"
    lattice = Lattice(A2.basis, nasty)
    world = rooms(lattice, 1)
    made = Parts(page_html(Map(world.levels, nasty), title=nasty))
    assert len(made.run) == 2 and nasty in made.text
    assert json.loads(made.scripts["header"])["maps"][0]["title"] == nasty


def test_a_map_in_space_is_cut_at_the_heights_of_its_cells() -> None:
    world = room_in_space(Lattice.named("D3", 0.2), 1, 3000)
    made = Parts(page_html(world, height=0.93))
    header = json.loads(made.scripts["header"])
    keys, hits, passes = world.levels[0].columns()
    cells = VoxelList(world.lattice, keys, np.ones_like(keys))
    z = np.unique(np.round(cells.centres()[:, 2], 6))
    np.testing.assert_allclose(header["heights"], z, atol=1e-6)
    assert abs(header["heights"][header["cut"]] - 0.93) == pytest.approx(np.abs(z - 0.93).min(), abs=1e-6)
    numbers, held = decoded(made)
    want = zip(cells.index.tolist(), hits.tolist(), passes.tolist(), strict=True)
    assert held == {tuple(i): (h, p) for i, h, p in want}
    assert numbers["side"] == 32


def test_a_trajectory_is_kept_to_the_millimetre_and_interrupted_where_it_is() -> None:
    positions = np.array([[0.0, 0.0], [1.0004, 2.0], [1.0, 2.001], [np.nan, 0.0], [5.0, 5.0], [5.0, 6.0]])
    assert trajectory_runs(positions, 0.1) == [[0, 0, 1000, 2000], [5000, 5000, 0, 1000]]
    assert trajectory_runs(None, 0.1) == []
    with pytest.raises(ArgumentError, match=r"\(3,\)"):
        trajectory_runs(np.zeros(3), 0.1)


def test_what_cannot_be_shown_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"a\.txt"):
        write_page(rooms(A2, 1), tmp_path / "a.txt")
    cell = VoxelList.from_cells(np.array([[1, 2, 3]]), SPATIAL[0].lattice)
    with pytest.raises(ArgumentError, match="in space"):
        page_html(Map([Level(cell, VoxelList.empty(SPATIAL[0].lattice))]))
    with pytest.raises(ArgumentError, match=r"0\.5 m"):
        page_html(rooms(A2, 1), height=0.5)
    one = VoxelList.from_cells(np.array([[3, 4]]), A2)
    with pytest.raises(ArgumentError, match="holds the centre"):  # a wall it would be, and that is kept
        page_html(Map([Level(VoxelList.empty(A2), one)]), compare=Lattice.named("Z2", 10.0))
    with pytest.raises(ArgumentError, match="no cell"):
        page_html(Map([Level(*[VoxelList.empty(A2)] * 2)]))


def test_the_command_writes_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_map(tmp_path / "m.parquet", rooms(A2, 2))
    (tmp_path / "t.tum").write_text("0 1 1 0 0 0 0 1\n1 2 1.5 0 0 0 0 1\n")
    out = tmp_path / "m.html"
    arguments = ["page", str(tmp_path / "m.parquet"), "-o", str(out), "--trajectory", str(tmp_path / "t.tum")]
    assert main([*arguments, "--compare", "Z2"]) == 0
    assert f"wrote {out}" in capsys.readouterr().out
    made = Parts(out.read_text())
    header = json.loads(made.scripts["header"])
    assert header["trajectory"] == [[1000, 1000, 1000, 500]] and len(header["maps"]) == 2
    assert "m.parquet" in made.text
    assert main([*arguments[:4], "--compare", "D3"]) == 2 and "D3" in capsys.readouterr().err
    assert main([*arguments[:4], "--cell", "2"]) == 2 and "--cell" in capsys.readouterr().err
    assert main([*arguments[:4], "--slice", "1"]) == 2 and "in the plane" in capsys.readouterr().err
    assert main([*arguments[:3], str(tmp_path / "m.txt")]) == 2 and "m.txt" in capsys.readouterr().err
    assert not (tmp_path / "m.txt").exists()


def test_a_map_makes_its_own_page_for_a_notebook() -> None:
    world = rooms(A2, 2)
    shown = world.page(pixels=300, title="a room")
    assert 'height="300"' in shown._repr_html_() and "a room" in shown.page
    with pytest.raises(ArgumentError, match="100 to 10000 pixels"):
        world.page(pixels=5)
