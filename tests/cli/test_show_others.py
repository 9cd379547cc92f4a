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
    """Return a ROS map of 40 x 30 cells of 0.1 m with a wall of one cell, whose corner lies at no multiple of a cell."""
    pixels = np.full((30, 40), 254, np.uint8)
    pixels[:, 12] = 0
    pixels[:5, :5] = 205
    Image.fromarray(pixels).save(tmp_path / "m.pgm")
    text = "image: m.pgm\nresolution: 0.1\norigin: [-1.03, 2.06, {}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
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
