"""Ask on a log of your own whether hexagons localise better than squares.

python examples/which_lattice_localises.py
"""

import tempfile
from pathlib import Path

from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import read_tum
from hexmap.simulator import Laser, make_building, write_log
from localisation.experiments import ExperimentSettings, localisation_experiment

settings = ExperimentSettings(
    lattices=("Z2", "A2"), resolutions=(0.2,), scans=20, tasks=("global", "rotation"), rotations=12
)
with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    write_log(folder / "room.clf", make_building("room"), folder / "room.tum", laser=Laser(beams=91, rate=2.0))
    poses = read_tum(folder / "room.tum")
    outcome = localisation_experiment(open_log(folder / "room.clf"), settings, poses=poses)
    outcome.write(folder / "report")
    print((folder / "report" / "report.md").read_text()[:1200])

for grid in outcome.results.grids:
    rows = outcome.results.select(task="rotation", grid=grid.number)
    print(grid.label, f"sigma / mu of the score under rotation {sum(r['variability'] for r in rows) / len(rows):.2%}")
