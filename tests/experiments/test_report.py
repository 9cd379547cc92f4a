"""Reports: the same bytes from the same elements, whole in every format, and nothing that breaks out of its cell."""

from __future__ import annotations

import base64
import csv
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from hexmap.base.errors import ArgumentError, FileAccessError
from hexmap.experiments.report.elements import Compared, Verdict
from hexmap.experiments.report.figures import figure_style
from hexmap.experiments.report.numbers import format_interval, format_number
from hexmap.experiments.report.report import Report
from hexmap.experiments.statistics import Interval

NASTY = [
    "<script>alert('x')</script>",
    '"quoted" & &amp; <b>bold</b>',
    "a | b \\| c \\",
    "*star* _under_ `tick` ~~gone~~ [link](http://x) ![image](y) $x$",
    "# no heading",
    "- no list",
    "1. no list",
    "two\nlines\r\nand\ta tab",
    "--- {braces} {0} %s",
    "control \x00 \x1b[31m \x85, half \ud800, whole \U0001f600",
    "</td></table></figure></main>",
    "]]> --> <!--",
    "=1+1",
]
VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(HTMLParser):
    """Checks that every tag is closed in its order, and collects what a page holds."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.cells: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len(dict(attrs)) == len(attrs)
        self.tags.append((tag, dict(attrs)))
        if tag in ("td", "th"):
            self.cells.append("")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert tag in VOID or self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.texts.append(data)
        if {"td", "th"} & set(self.open):
            self.cells[-1] += data

    def handle_comment(self, data: str) -> None:
        raise AssertionError("a comment got through")


def figure(points: int = 20) -> Figure:
    with figure_style():
        drawn = Figure()
        axes = drawn.subplots()
        axes.plot(np.linspace(0, 1, points), np.sin(np.linspace(0, 9, points)), marker="o", label="σ/μ")
        axes.set_xlabel("angle, degrees")
        drawn.legend(loc="outside upper right")
    return drawn


def report() -> Report:
    made = Report(
        "Rotation & co", "hexmap experiment rotation hall.pcd -o report/", {"volume": 0.001, "angles": [0, 5]}
    )
    made.paragraph("First.\n\nSecond, of 95 %.")
    for name in ("Voxel count", "Voxel count", "Distortion", "Verdicts"):
        made.heading(name)
    rows: list[dict[str, Any]] = [
        {"lattice": "Z3", "cv": Interval(0.0169, 0.01523, 0.01834), "cells": np.int64(12034), "x": 0.1 + 0.2},
        {"lattice": "D3*", "cv": Interval(0.0056, 0.0051, 0.0062), "cells": 9, "x": np.float32(1e-3), "ok": True},
        {"lattice": "prism", "cv": None, "cells": None, "x": math.nan, "ok": np.bool_(False)},
    ]
    made.table("summary.csv", rows, formats={"cv": ".2%"}, caption="All of it.")
    made.figure("counts", figure(), "Voxel count over the angle.")
    made.verdicts(
        [
            Verdict("Ties are unlikely", "IV-A", "holds", "fewer than 1 %", "0.1 %"),
            Verdict("Three times less", "VI", "does not hold", "high < 1/3", "0.4 [0.3, 0.5]"),
            Verdict("Two", "VI", "holds in part", "a", "b"),
            Verdict("Three", "VI", "holds", "a", "b"),
            Verdict("Four", "VI", "undecided", "a", "b"),
        ]
    )
    return made


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "new" / "folder"
    report().write(folder)
    return folder


def table(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as handle:
        return list(csv.DictReader(handle))


# ---------------------------------------------------------------------- files


def test_the_same_elements_give_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    paths = report().write(tmp_path)
    names = ["report.html", "report.md", "summary.csv", "counts.png", "counts.pdf", "verdicts.csv"]
    assert [path.name for path in paths] == names and sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    for path in paths:
        assert path.read_bytes() == (folder / path.name).read_bytes(), path.name


def test_writing_again_replaces_and_leaves_the_rest(tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("what was here before")
    (tmp_path / "mine.txt").write_text("mine")
    Report("Short").write(tmp_path)
    assert "what was here before" not in (tmp_path / "report.html").read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.txt", "report.html", "report.md"]


def test_a_report_leaves_nothing_of_the_one_before(tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text("mine")
    report().write(tmp_path)
    assert (tmp_path / "counts.png").exists()
    Report("Short").write(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.csv", "report.html", "report.md"]


def test_a_report_that_cannot_be_written_whole_stays_as_it_was(tmp_path: Path) -> None:
    Report("Short").write(tmp_path)
    before = (tmp_path / "report.html").read_bytes()
    (tmp_path / "verdicts.csv").mkdir()
    with pytest.raises(FileAccessError):
        report().write(tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report.html", "report.md", "verdicts.csv"]
    assert (tmp_path / "report.html").read_bytes() == before


def test_times_are_in_files_of_their_own(tmp_path: Path) -> None:
    made = []
    for folder, ms in ((tmp_path / "a", 1.0), (tmp_path / "b", 2.0)):
        shown = report()
        shown.times.table("ms", [{"ms": ms}])
        made.append({p.name: p.read_bytes() for p in shown.write(folder) if p.parent == folder})
        assert (folder / "times" / "ms.csv").read_text() == f"ms\n{ms}\n"
    assert made[0] == made[1]


def test_no_date_and_no_path_is_written(folder: Path) -> None:
    for path in folder.iterdir():
        content = path.read_bytes()
        assert str(folder).encode() not in content
        assert b"CreationDate" not in content and b"tIME" not in content
    (picture,) = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', (folder / "report.html").read_text())
    assert b"date>" not in base64.b64decode(picture)


def test_a_folder_that_cannot_be_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for bad in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(FileAccessError, match="cannot be written"):
            Report("x").write(bad)


# ---------------------------------------------------------------------- HTML


def test_the_page_is_well_formed_and_needs_no_other_file(folder: Path) -> None:
    text = (folder / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    tags = [tag for tag, _ in page.tags]
    assert tags.count("table") == 3 and tags.count("img") == 1 and tags.count("h1") == 1
    assert "script" not in tags and "link" not in tags
    assert "@import" not in text and "url(" not in text and "http" not in re.sub(r'src="[^"]*"', "", text)
    for tag, attributes in page.tags:
        if "src" in attributes:
            assert (attributes["src"] or "").startswith("data:image/")
        if tag == "a":
            link = attributes["href"] or ""
            assert link.startswith("#") or (folder / link).is_file()
    anchors = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert anchors == ["voxel-count", "voxel-count-2", "distortion", "verdicts"]
    assert "prefers-color-scheme: dark" in text and "@media print" in text


def test_the_page_says_what_it_is_told(folder: Path) -> None:
    page = Page((folder / "report.html").read_text(encoding="utf-8"))
    assert "1.69 % [1.52, 1.83]" in page.cells and "0.56 % [0.51, 0.62]" in page.cells
    assert "12,034" in page.cells and "0.300" in page.cells and "–" in page.cells and "yes" in page.cells
    words = " ".join("".join(page.texts).split())
    assert "Claims: 2 hold, 1 holds in part, 1 undecided, 1 does not hold." in words
    assert "hexmap experiment rotation hall.pcd -o report/" in words
    assert re.search(r"hexmap \d\S+, Python 3\.\S+, numpy \S+", words)
    assert "Rule: high < 1/3" in words


def test_nasty_text_is_shown_as_it_stands(tmp_path: Path) -> None:
    made = Report(NASTY[0], NASTY[3], dict.fromkeys(NASTY, NASTY[1]))
    for text in NASTY:
        made.heading(text)
        made.paragraph(text)
    made.table("t", [{"text": text, NASTY[1]: k} for k, text in enumerate(NASTY)], caption=NASTY[4])
    made.table("u", [{"x": 1}], columns={"x": NASTY[10]}, formats={"x": lambda x: NASTY[2]})
    made.figure("f", figure(3), NASTY[1])
    made.verdicts([Verdict(text, text, "holds", text, text) for text in NASTY])
    made.write(tmp_path)
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert not {"script", "b"} & {tag for tag, attributes in page.tags if tag == "script" or attributes}
    for text in NASTY:
        if text.isprintable():
            assert text in page.cells
    assert "two lines and a tab" in page.cells
    assert any("control \ufffd \ufffd[31m" in cell and "half ?" in cell for cell in page.cells)
    for row, text in zip(table(tmp_path / "t.csv"), NASTY, strict=True):
        # A spreadsheet would run what looks like a formula.
        assert row["text"].removeprefix("'" if text.startswith("=") else "") == text or not text.isprintable()

    # The same through a reader of Markdown, where there is one.
    parser = pytest.importorskip("markdown_it").MarkdownIt("gfm-like", {"linkify": False})
    lines = (tmp_path / "report.md").read_text(encoding="utf-8")
    rendered = Page(re.sub("<!--.*?-->", "", parser.render(lines)))
    tags = [tag for tag, _ in rendered.tags]
    assert tags.count("table") == 4 and tags.count("img") == 1 and tags.count("h1") == 1
    assert tags.count("h2") == len(NASTY)
    assert not {"script", "em", "s", "ul", "ol", "b"} & set(tags)
    links = [attributes["href"] for tag, attributes in rendered.tags if tag == "a"]
    assert links == ["t.csv", "u.csv", "f.pdf", "verdicts.csv"]
    for text in NASTY:
        if text.isprintable():
            assert text in rendered.cells


def test_a_drawing_of_very_many_points_goes_in_as_an_image(tmp_path: Path) -> None:
    made = Report("x")
    made.figure("many", figure(40_000), "Many.")
    made.write(tmp_path)
    text = (tmp_path / "report.html").read_text()
    assert 'src="data:image/png;base64,' in text and len(text) < 1_500_000


# ---------------------------------------------------------------------- Markdown and CSV


def test_links_of_the_markdown_exist(folder: Path) -> None:
    text = (folder / "report.md").read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert links == ["summary.csv", "counts.png", "counts.pdf", "verdicts.csv"]
    assert all((folder / link).is_file() for link in links)
    assert "| --- | ---: | ---: | ---: | --- |" in text
    assert text.startswith("# Rotation \\& co\n") and text.endswith("\n") and "\n\n\n" not in text
    assert (folder / "counts.png").read_bytes()[:4] == b"\x89PNG"
    assert (folder / "counts.pdf").read_bytes()[:5] == b"%PDF-"


def test_csv_keeps_every_digit(folder: Path) -> None:
    rows = table(folder / "summary.csv")
    assert list(rows[0]) == ["lattice", "cv", "cv_low", "cv_high", "cells", "x", "ok"]
    assert float(rows[0]["x"]) == 0.1 + 0.2 and float(rows[0]["cv_low"]) == 0.01523
    assert float(rows[1]["x"]) == float(np.float32(1e-3))
    assert rows[0]["cells"] == "12034" and rows[2]["cells"] == "" and rows[2]["cv_high"] == ""
    assert [row["ok"] for row in rows] == ["", "true", "false"] and rows[2]["x"] == "nan"
    verdicts = table(folder / "verdicts.csv")
    assert verdicts[1] == {
        "section": "VI",
        "claim": "Three times less",
        "outcome": "does not hold",
        "evidence": "0.4 [0.3, 0.5]",
        "rule": "high < 1/3",
    }


def test_long_tables_are_shown_in_part_and_written_whole(tmp_path: Path) -> None:
    made = Report("x")
    made.table("long", [{"k": k} for k in range(1000)], shown=10)
    made.table("empty", [])
    made.table("headed", [], columns=["a", "b"])
    made.write(tmp_path)
    assert len(table(tmp_path / "long.csv")) == 1000
    page = Page((tmp_path / "report.html").read_text())
    assert page.cells == ["k", *map(str, range(10)), "a", "b"]
    assert any("The first 10 of 1,000 rows." in text for text in page.texts)


# ---------------------------------------------------------------------- numbers


def test_numbers_have_sensible_digits() -> None:
    numbers = [88206, 0.0169141, 1.0, -0.5, 1234567.891, 0.0, 1e-12, math.nan, -math.inf, True, 3e20]
    shown = ["88,206", "0.01691", "1", "−0.5", "1,234,568", "0", "1.000e-12", "–", "−∞", "yes", "3.000e+20"]
    assert [format_number(number) for number in numbers] == shown
    assert format_number(0.0169, ".2%") == "1.69 %" and format_number(-2, ".1f") == "−2.0"
    assert format_number(-0.0001, ".2f") == "0.00" and format_number(1234, ",d") == "1,234"
    with pytest.raises(ArgumentError):
        format_number(1.5, "d")


def test_intervals_are_shown_as_precisely_as_they_are_known() -> None:
    assert format_interval(Interval(0.0169, 0.01523, 0.01834), percent=True) == "1.69 % [1.52, 1.83]"
    assert format_interval(Interval(12034.4, 11950.2, 12111.9)) == "12,034 [11,950, 12,112]"
    assert format_interval(Interval(0.333, 0.3, 0.4), decimals=1) == "0.3 [0.3, 0.4]"
    assert format_interval(Interval(0.0021, 0.0020, 0.0023), scale=1000, unit="ms") == "2.10 ms [2.00, 2.30]"
    assert format_interval(Interval(0.0, 0.0, 0.0)) == "0 [0, 0]"
    assert format_interval(Interval(1.0, 0.5, math.inf)) == "1.00 [0.50, ∞]"
    assert format_interval(Interval(-1.0, -2.0, 0.0)) == "−1.0 [−2.0, 0.0]"


def test_a_column_has_one_number_of_decimals(tmp_path: Path) -> None:
    made = Report("x")
    rows = [{"a": 1.25, "b": 1, "c": "1.2 s", "d": "x"}, {"a": 1234.5, "b": 2.5, "c": "3 s", "d": 1}]
    made.table("t", rows)
    made.write(tmp_path)
    page = Page((tmp_path / "report.html").read_text())
    assert page.cells[4:] == ["1.2", "1", "1.2 s", "x", "1,234.5", "2.5", "3 s", "1"]
    sides = [attributes.get("class") for tag, attributes in page.tags if tag == "td"]
    assert sides[:4] == ["n", "n", "n", None]


# ---------------------------------------------------------------------- what is refused


def test_wrong_elements_are_refused() -> None:
    made = Report("x")
    made.table("one", [{"a": 1}])
    for name in ("one", "ONE.csv", "", "../up", "a/b", "a b", ".hidden", "ä"):
        with pytest.raises(ArgumentError):
            made.table(name, [])
    made.figure("one", figure(2), "")
    with pytest.raises(ArgumentError, match="already"):
        made.figure("one", figure(2), "")
    with pytest.raises(ArgumentError, match="level"):
        made.heading("x", 1)
    with pytest.raises(ArgumentError, match="outcome"):
        Verdict("a", "b", "perhaps", "c", "d")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="format"):
        made.table("two", [{"a": 1.5}], formats={"a": "d"})


def test_the_users_own_style_does_not_leak_in(tmp_path: Path, folder: Path) -> None:
    import matplotlib

    with matplotlib.rc_context({"savefig.facecolor": "red", "axes.grid": False, "svg.fonttype": "none"}):
        report().write(tmp_path)
        assert matplotlib.rcParams["savefig.facecolor"] == "red"
    assert (tmp_path / "counts.png").read_bytes() == (folder / "counts.png").read_bytes()
    assert (tmp_path / "report.html").read_bytes() == (folder / "report.html").read_bytes()


def test_a_matrix_tells_who_wins_with_colours_and_without(tmp_path: Path) -> None:
    report = Report("Matrix")
    cells: dict[str, dict[str, Compared | None]] = {
        "A2 against <Z2>": {"length": Compared("win", "0.95"), "time": Compared("tie", "1.00")},
        "D3 | Z3": {"length": Compared("lose", "1.20"), "time": None},
    }
    report.matrix("outcomes", cells, "first against second", "Less is better.")
    report.write(tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    page = Page(text)
    assert page.cells == [
        "first against second", "length", "time", "A2 against <Z2>", "▲ 0.95", "= 1.00", "D3 | Z3", "▼ 1.20", "",
    ]  # fmt: skip
    classes = [attributes.get("class") for tag, attributes in page.tags if tag == "td"]
    assert classes == ["win", "tie", "lose", None]
    assert all(f".{name} {{" in text for name in ("win", "tie", "lose"))  # with a colour each
    assert "1 won, 1 even, 1 lost. Less is better." in text
    markdown = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "▲ win 0.95" in markdown and "▼ lose 1.20" in markdown
    with open(tmp_path / "outcomes.csv", newline="", encoding="utf-8") as file:
        assert list(csv.reader(file))[1:] == [["A2 against <Z2>", "win", "even"], ["D3 | Z3", "lose", ""]]
    with pytest.raises(ArgumentError, match="a standing is one of"):
        Compared("draw")  # type: ignore[arg-type]


def test_a_table_that_only_its_file_holds(tmp_path: Path) -> None:
    report = Report("Long")
    report.table("rows", [{"k": k, "date": "1/2"} for k in range(3000)], shown=0, caption="All of it.")
    report.write(tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert Page(text).cells == [] and "All of it. 3,000 rows, in the file alone." in text and "rows.csv" in text
    markdown = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert "3,000 rows" in markdown and "rows.csv" in markdown and "|" not in markdown
    lines = (tmp_path / "rows.csv").read_text().splitlines()
    assert len(lines) == 3001 and lines[1] == "0,'1/2"  # which a spreadsheet takes for a date without the quote
