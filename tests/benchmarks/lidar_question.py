"""The paper's question on a whole building, the hall: cells, bytes, steadiness under rotation, planning, by lattice.

All of it by the commands that a user has: the rotation experiment on the scans of the map, then the hall as cubes of
0.4 m and the planning benchmark on grids of half of that.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

# Points are thinned at random, and what lies farther than this, metres, would make a window of mostly nothing.
POINTS, FARTHEST = 150_000, 25.0


def hexmap(*arguments: object) -> None:
    """Run a command of hexmap, quietly."""
    environment = dict(os.environ, HEXMAP_MAX_INFLATION=str(1 << 30))
    command = [sys.executable, "-m", "hexmap", *(str(a) for a in arguments)]
    subprocess.run(command, check=True, capture_output=True, env=environment)


def question(folder: Path) -> None:
    """Print the summaries of both reports, and the tables that they rest on."""
    log, poses = folder / "hall", folder / "hall.reference.tum"
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        hexmap("experiment", "rotation", log, "-o", work / "rotation", "--poses", poses, "--resolution", "0.2",
               "--sample", POINTS, "--random", "40", "--step", "10")  # fmt: skip
        hexmap("build", log, "-o", work / "hall.parquet", "--lattice", "Z3", "--resolution", "0.4", "--levels", "1",
               "--max-range", FARTHEST, "--poses", poses)  # fmt: skip
        hexmap("export", work / "hall.parquet", "-o", work / "hall.bt")
        hexmap("benchmark", "planning", work / "hall.bt", "-o", work / "planning", "--queries", "20", "--angles",
               "0,17", "--fractions", "2")  # fmt: skip
        for part, tables in (
            ("rotation", ("verdicts", "ratios_axis", "ratios_random", "dividend", "match_score")),
            ("planning", ("compare", "length_3d_2", "times/time_3d")),
        ):
            for table in tables:
                print(f"hall, {part}, {table}\n{(work / part / table).with_suffix('.csv').read_text()}")
