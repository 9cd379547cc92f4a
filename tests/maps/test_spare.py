"""No beam of a scan clears a cell that another beam of the same scan hit, where that is asked for."""

from __future__ import annotations

import numpy as np
import pytest

from hexmap.lattice.lattice import Lattice
from hexmap.maps.counter import HITS, PASSES, CellCounter
from tests.lattices import CASES


@pytest.mark.parametrize("case", CASES, ids=str)
def test_cells_that_were_hit_get_no_passes_and_all_others_are_as_ever(case: object) -> None:
    lattice: Lattice = case if isinstance(case, Lattice) else case.lattice  # type: ignore[attr-defined]
    lattice = lattice.scaled(0.2 / lattice.resolution)
    rng = np.random.default_rng(3)
    n = lattice.dim
    # A floor that is seen at a grazing angle from just above.
    ends = np.concatenate([rng.uniform(-3.0, 3.0, (400, n - 1)), rng.uniform(-0.01, 0.01, (400, 1))], axis=1)
    origin = np.zeros(n)
    origin[-1] = 0.3
    plain, spared = CellCounter(lattice), CellCounter(lattice)
    for _ in range(2):
        plain.fuse(origin, ends, 350)
        spared.fuse(origin, ends, 350, spare_hits=True)
    hits = plain.to_list(HITS)
    assert (hits.index == spared.to_list(HITS).index).all()
    assert (hits.counts == spared.to_list(HITS).counts).all()
    assert (spared.find(hits.index, PASSES) == 0).all()
    assert plain.find(hits.index, PASSES).sum() > 0
    others = plain.to_list(PASSES)
    others = others.select(~hits.contains(others.index))
    assert (spared.find(others.index, PASSES) == others.counts).all()
