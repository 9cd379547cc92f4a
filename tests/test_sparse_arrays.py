"""Arrays of searches: zeros of any size and kind, also where they get pages of their own."""

from __future__ import annotations

import numpy as np
import pytest

from hexmap.base import sparse_arrays


@pytest.mark.parametrize("size", [1, 1000, 3_000_001])
@pytest.mark.parametrize("kind", [np.uint8, np.float64, [("g", np.float64), ("seen", np.int32)]])
def test_sparse_arrays_are_zeros_that_can_be_written(size: int, kind: object, monkeypatch: pytest.MonkeyPatch) -> None:
    for large in (1, 1 << 40):
        monkeypatch.setattr(sparse_arrays, "_LARGE", large)
        array = sparse_arrays.sparse_zeros(size, kind)
        assert array.shape == (size,) and array.dtype == np.dtype(kind)
        assert not array.view(np.uint8).any()
        array[-1] = np.ones(1, kind)[0]
        assert array[-1] == np.ones(1, kind)[0]
        assert array.flags.c_contiguous and array.flags.aligned and array.flags.writeable
