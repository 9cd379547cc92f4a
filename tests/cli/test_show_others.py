"""Pictures of maps that others made, and what else ``hexmap show`` is given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hexmap.cli.commands import run
from hexmap.drawing import figure_layout


def call(*arguments: object) -> int:
    return run([str(a) for a in arguments])


@pytest.fixture
def ros_map(tmp_path: Path) -> Path:
    """Return a ROS map of 40 x 30 cells of 0.1 m with a wall of one cell; its corner is at no multiple of a cell."""
    pixels = np.full((30, 40), 254, np.uint8)
    pixels[:, 12] = 0
    pixels[:5, :5] = 205
    Image.fromarray(pixels).save(tmp_path / "m.pgm")
    text = "image: m.pgm\nresolution: 0.1\norigin: [-1.03, 2.06, {}]\nnegate: 0\n"
    text += "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    (tmp_path / "m.yaml").write_text(text.format(0.0))
    (tmp_path / "turned.yaml").write_text(text.format(0.5))
    return tmp_path / "m.yaml"


@pytest.mark.parametrize("name", ["m.yaml", "turned.yaml"])
@pytest.mark.parametrize("ending", ["png", "svg"])
def test_a_map_of_others_is_drawn_in_its_own_cells(
    ros_map: Path, name: str, ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    plain = figure_layout._draw_sheet
    monkeypatch.setattr(figure_layout, "_draw_sheet", lambda *a: said.append(a[3]) or plain(*a))
    monkeypatch.setattr(figure_layout._Legend, "_text", lambda self, text, gap=0.0: said.append(text))
    picture = ros_map.with_name(f"p.{ending}")
    assert call("show", ros_map.with_name(name), "-o", picture) == 0
    assert "30 occupied, 1,145 free cells" in said[0]
    assert not any("hits" in text for text in said) and "occupied" in said
    if ending == "png" and name == "m.yaml":
        # The wall is one cell in forty of the map's width, not two.
        image = np.asarray(Image.open(picture).convert("L"))[image_rows(picture)]
        dark = (image < 120).mean(axis=0)
        wall = np.flatnonzero(dark > 0.9)
        known = np.flatnonzero((image > 250).mean(axis=0) > 0.9)
        assert len(wall) == pytest.approx(1600 / 42.8, rel=0.15) and len(known) > 10 * len(wall)


def image_rows(picture: Path) -> slice:
    """Return the rows in the middle of a picture, where there is nothing but the map."""
    height = Image.open(picture).height
    return slice(int(0.35 * height), int(0.65 * height))


PATH = "x,y,a,b,length,heading\n-0.6,2.6,0,0,0.0,0.0\n0.0,3.0,1,1,0.7,0.0\n"


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("none.yaml", None, "none.yaml: no such file"),
        ("none.bt", None, "none.bt: no such file"),
        ("none.parquet", None, "none.parquet: no such file"),
        ("t.tum", "0 0 0 0 0 0 0 1\n", "a trajectory, not a map"),
        ("l.clf", "ODOM 0 0 0 0 0 0 1.0 h 1.0\n", "a log, not a map: make a map of it first"),
        ("p.csv", PATH, "a path, not a map"),
    ],
)
def test_what_is_no_map_says_what_it_is(
    tmp_path: Path, name: str, text: str | None, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    assert call("show", tmp_path / name, "-o", tmp_path / "o.png") == 1
    err = capsys.readouterr().err
    assert words in err and err.count("\n") == 1 and not (tmp_path / "o.png").exists()


def test_a_path_over_a_part_of_a_map(ros_map: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, picture = ros_map.with_name("p.csv"), ros_map.with_name("p.svg")
    path.write_text(PATH)
    assert call("show", ros_map, "-o", picture, "--trajectory", path, "--crop", "-0.95,2.2,0.2,4") == 0
    assert "10 hits" not in picture.read_text()
    capsys.readouterr()
    assert call("show", ros_map, "-o", picture, "--crop", "90,90,91,91") == 1
    assert "no cell of the map lies in the box" in capsys.readouterr().err
    assert call("show", ros_map, "-o", picture, "--crop", "0,0,0,1,1,1") == 2
    assert "--crop takes 4 numbers" in capsys.readouterr().err
    assert call("show", ros_map, "-o", picture, "--trajectory", path, "--trajectory", path) == 2
    assert "given 2 times" in capsys.readouterr().err


def test_what_a_trajectory_and_a_path_hold(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "t.tum").write_text("10 0 0 0 0 0 0 1\n12.5 3 4 0 0 0 0 1\n")
    (tmp_path / "p.csv").write_text(PATH)
    assert call("info", tmp_path / "t.tum") == 0 and call("info", tmp_path / "p.csv") == 0
    out = capsys.readouterr().out
    assert "a trajectory (TUM) of 2 poses" in out and "2.5 s" in out and "length 5.00 m" in out
    assert "a path of 2 points in the plane" in out and "length 0.72 m, from (-0.60, 2.60) to (0.00, 3.00) m" in out


def test_no_bag_is_promised_where_text_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call("simulate", "office", "-o", tmp_path / "o2.bag") == 2
    assert "a CARMEN log is written" in capsys.readouterr().err and not list(tmp_path.iterdir())
