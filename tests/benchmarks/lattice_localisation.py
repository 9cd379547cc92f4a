"""The localisation experiment on Intel, Belgioioso and a simulated office: its headline table.

``python -m tests.benchmarks.lattice_localisation [place ...] [--output FOLDER] [--workers N] [--quick]``. Without the
shared data the office alone is run. Reports go into the folder given; an interrupted run goes on there.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import time
from pathlib import Path

from hexmap.experiments.report.numbers import format_interval
from hexmap.io.logs.open_log import open_log
from hexmap.io.trajectories import read_tum
from hexmap.simulator.buildings import make_building
from hexmap.simulator.laser import Laser
from hexmap.simulator.writer import write_log
from localisation.experiments.comparison import compare_all
from localisation.experiments.run import localisation_experiment
from localisation.experiments.settings import ExperimentSettings, quick
from localisation.experiments.verdicts import summary
from tests.benchmarks._common import data_folder, table, versions

PLACES = ("office", "belgioioso", "intel")


def log_of(place: str, folder: Path) -> tuple[Path, Path | None]:
    """Return a log and its reference poses, if there are any."""
    if place == "office":
        log, poses = folder / "office.clf", folder / "office.tum"
        # A slower laser than usual: a run of so many scans as the real logs have.
        write_log(log, make_building("office"), poses, laser=Laser(beams=180, rate=2.0), seed=1)
        return log, poses
    log = data_folder() / "laser2d" / f"{place}.clf.gz"
    poses = log.with_name(f"{place}.rbpf.tum")
    return log, poses if poses.exists() else None


def run(place: str, folder: Path, settings: ExperimentSettings, workers: int) -> None:
    """Print what became of every comparison in a place."""
    log, poses = log_of(place, folder)
    begin = time.perf_counter()
    outcome = localisation_experiment(
        open_log(log), settings, poses=None if poses is None else read_tum(poses), folder=folder / place,
        associate="order" if place == "belgioioso" else None, workers=workers,
    )  # fmt: skip
    outcome.write(folder / place)
    comparisons = compare_all(outcome.results)
    print(f"== {place}: {outcome.results.world.reference}\n\n{summary(comparisons)}\n")
    rows: list[list[object]] = [["measure", "m", "equal", "A2", "Z2", "", "95 % interval", "pairs", "A2"]]
    for c in comparisons:
        rows.append([
            c.measure.label, c.resolution, c.equal, c.there, c.here, "times" if c.measure.ratio else "minus",
            format_interval(c.interval), c.pairs, "even" if c.outcome == "tie" else c.outcome,
        ])  # fmt: skip
    table(rows)
    print(f"({place}: {time.perf_counter() - begin:.0f} s)\n", flush=True)


def main(arguments: list[str] | None = None) -> None:
    """Run the places asked for."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.lattice_localisation")
    parser.add_argument("places", nargs="*", help=f"{', '.join(PLACES)}; all without a name")
    parser.add_argument("--output", type=Path, help="folder of the reports; none keeps nothing")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="fewer of everything")
    chosen = parser.parse_args(arguments)
    settings = ExperimentSettings(resolutions=(0.1, 0.2))
    settings = quick(settings) if chosen.quick else settings
    print(versions("hexmap", "numpy", "numba"), "\n")
    with contextlib.ExitStack() as stack:
        folder = chosen.output or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        for place in chosen.places or PLACES:
            if place not in PLACES:
                parser.error(f"no place {place!r}: {', '.join(PLACES)}")
            if place != "office" and not (data_folder() / "laser2d").is_dir():
                print(f"{place} is left out: no shared data (set HEXMAP_DATA)\n")
                continue
            run(place, folder, settings, chosen.workers)


if __name__ == "__main__":
    main()
