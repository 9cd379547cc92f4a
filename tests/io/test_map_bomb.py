"""A small map file that would fill the memory is refused before it is read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hexmap.base.errors import TooLargeError
from hexmap.io.map_file import load_map, save_map
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan


def test_rows_that_are_all_the_same_do_not_fill_the_memory(tmp_path: Path) -> None:
    builder = MapBuilder(Lattice.named("A2", 0.1), 1)
    builder.fuse(Scan(0.0, np.array([[1.0, 0.0]])), Pose.identity(2))
    path = tmp_path / "m.parquet"
    save_map(path, builder.build())
    table = pq.read_table(path)
    rows = 3_000_000
    columns = [pa.array(np.full(rows, table.column(n)[0].as_py()), table.column(n).type) for n in table.column_names]
    pq.write_table(pa.table(columns, schema=table.schema), path)
    assert path.stat().st_size < 100_000
    with pytest.raises(TooLargeError, match="3,000,000 rows"):
        load_map(path)
