"""The published optima: square and cubic grids with all neighbours, no corner cutting, on other people's maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planners.benchmark.cases import baseline_case
from planners.benchmark.problem_set import open_problem_set, print_style, publishers_roots, same_to_the_digits
from planners.benchmark.settings import BenchmarkSettings

MAPS = [
    *(f"movingai/{name}.map" for name in
      ("arena", "den520d", "AR0011SR", "Berlin_0_512", "brc202d", "maze512-8-0", "random512-25-0")),
    *(f"warframe/{name}.3dmap.gz" for name in ("Simple", "Complex")),
    pytest.param("warframe/A1.3dmap.gz", marks=pytest.mark.long),
]  # fmt: skip
# Every problem of these, that many seeded ones of the others, and few where one takes a second.
WHOLE = {"movingai/arena.map"}
SOME = 200
FEW = {"warframe/A1.3dmap.gz": 40}


@pytest.mark.data
@pytest.mark.parametrize("name", MAPS)
def test_the_published_lengths(data_dir: Path, name: str) -> None:
    some = FEW.get(name, SOME)
    queries = 10**6 if name in WHOLE else some
    problems = open_problem_set(data_dir / "planning" / name, BenchmarkSettings(queries=queries))
    grid_map = problems.grid_map
    shared = {
        "states": grid_map.states, "cell": 1.0, "origin": np.full(grid_map.dim, -0.5), "yaw": 0.0,
        "starts": problems.starts, "goals": problems.goals, "threads": 2,
    }  # fmt: skip
    found = baseline_case({"first": 0, "last": len(problems.texts)}, np.random.default_rng(0), shared)
    assert len(found["cost"]) == (len(problems.texts) if name in WHOLE else some)
    _, equal = publishers_roots(found["steps"], problems.texts, problems.style)
    listed = [(int(problems.problem[k]), problems.texts[k], found["cost"][k]) for k in np.flatnonzero(~equal)]
    assert listed == []
    # The roots that a publisher used change no length by more than this.
    ours, theirs = np.array(found["cost"]), np.array([float(text) for text in problems.texts])
    assert np.abs(ours / theirs - 1).max() < 1e-5 or problems.style == ("f", 2)


@pytest.mark.parametrize(
    ("texts", "style"),
    [
        (["244.95", "1.00"], ("f", 2)),
        (["2", "2.82843", "12.2426"], ("g", 6)),
        (["1.00000000", "2.41421356"], ("f", 8)),
    ],
)
def test_the_publishers_way_of_printing(texts: list[str], style: tuple[str, int]) -> None:
    assert print_style(texts) == style


def test_equal_to_the_published_digits() -> None:
    root = 2.0**0.5
    assert same_to_the_digits(2 * root, "2.82843", ("g", 6))
    assert same_to_the_digits(2.0, "2", ("g", 6))
    assert same_to_the_digits(1000 + 100 * root, "1141.42", ("g", 6))
    assert not same_to_the_digits(1000 + 100 * root, "1141.43", ("g", 6))
    assert same_to_the_digits(1 + root, "2.41421356", ("f", 8))
    assert not same_to_the_digits(1 + root, "2.41421357", ("f", 8))


def test_the_roots_that_a_publisher_used() -> None:
    steps = [[3, 500], [0, 7], None]
    texts = [f"{3 + 500 * 1.414213562:.8f}", f"{7 * 1.414213562:.8f}", "1.00000000"]
    roots, equal = publishers_roots(steps, texts, ("f", 8))
    assert roots == "roots of 9 decimals" and equal.tolist() == [True, True, False]
