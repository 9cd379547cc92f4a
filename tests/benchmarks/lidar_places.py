"""LiDAR scans of the hall that are not in its map found in it, on lattices at equal cells and at equal covering radius.

The whole answer of the localiser: levelling, the search over all yaws and 2 degrees of tilt, surfaces, verdict. One
scan in five is left out of the map and looked for; every lattice looks for the same ones. How wide the cells of the
search are follows from what the sensor sees, in metres of resolution: at equal covering radius only the map's cells are
larger. The search by itself at equal covering radius is in ``hexmap experiment localisation`` and in
``python -m tests.benchmarks.localisation compare``.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.experiments.statistics import bootstrap_ratio, mean
from hexmap.io.lidar.open_lidar import open_lidar
from hexmap.io.trajectories import read_tum
from hexmap.lattice.lattice import Lattice
from hexmap.maps.builder import MapBuilder
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.experiments.geometry import geometry_of
from localisation.lidar_settings import LidarSettings
from localisation.localiser.lidar_localiser import LidarLocaliser, map_surface_lattice
from tests.benchmarks._common import table

NAMES = ("Z3", "D3", "D3*")
RESOLUTION = 0.1
HELD_OUT = 5
# What counts as found, metres and degrees.
RIGHT = (0.5, 3.0)


@dataclass(frozen=True)
class Found:
    """What became of the scans on a lattice: errors, NaN where there was no answer, and seconds of the processor."""

    cells: int
    searched: float
    metres: FloatArray
    degrees: FloatArray
    seconds: FloatArray

    @property
    def right(self) -> int:
        return int(((self.metres <= RIGHT[0]) & (self.degrees <= RIGHT[1])).sum())


def grids() -> list[tuple[str, Lattice]]:
    """Return the cubic lattice, and the others with cells as large and with the same covering radius."""
    base = Lattice.named(NAMES[0], RESOLUTION)
    out = [("", base)]
    for name in NAMES[1:]:
        same = Lattice.named(name, RESOLUTION)
        out += [("cell", same), ("radius", same.scaled(base.covering_radius / same.covering_radius))]
    return out


def find(scans: list[tuple[Scan, Pose]], lattice: Lattice, fold: int) -> Found:
    """Map the scans but those of a fold, and look for each of those."""
    settings = LidarSettings(lattice=lattice.basis.tolist(), levels=1)
    builder = settings.make_builder()
    assert isinstance(builder, MapBuilder)
    looked_for = []
    for number, (scan, pose) in enumerate(scans):
        if number % HELD_OUT == fold:
            looked_for.append((scan, pose))
        else:
            builder.fuse(scan, pose)
    states = builder.build(finish=True).state()
    localiser = LidarLocaliser(states, settings)
    # What is made once a map, and compiled once a process, is no part of an answer.
    localiser.add(looked_for[0][0])
    errors, seconds = [], []
    for scan, true in looked_for:
        localiser.forget()
        begin = time.process_time()
        pose = localiser.add(scan).pose
        seconds.append(time.process_time() - begin)
        errors.append((np.nan, np.nan) if pose is None else geometry_of(3).error(pose, true)[1:])
    metres, degrees = np.array(errors).T
    searched = map_surface_lattice(lattice, settings.in_range(looked_for[0][0].points)).resolution
    return Found(len(states.occupied), searched, metres, degrees, np.array(seconds))


def places(folder: Path, folds: int = 1) -> None:
    """Print how scans of the hall are found by lattice."""
    poses = read_tum(folder / "hall.reference.tum")
    scans = [(replace(scan, times=None), poses[k]) for k, scan in enumerate(open_lidar(folder / "hall"))]
    rows: list[list[object]] = [[
        "hall", "equal", "map m", "searched m", "cells", "found", "m", "worst", "deg", "worst", "ms", "95 %",
        "to Z3", "95 %",
    ]]  # fmt: skip
    base: list[Found] = []
    for equal, lattice in grids():
        found = [find(scans, lattice, fold) for fold in range(folds)]
        base = base or found
        metres, degrees, ms = (
            np.concatenate([getattr(f, name) for f in found]) for name in ("metres", "degrees", "seconds")
        )
        ratio: list[object] = ["", ""]
        if found is not base:
            r = bootstrap_ratio(
                ms.tolist(), np.concatenate([f.seconds for f in base]).tolist(), mean, rng=np.random.default_rng(0)
            )
            ratio = [r.value, f"{r.low:.2f} to {r.high:.2f}"]
        rows.append([
            lattice.name, equal, lattice.resolution, found[0].searched, found[0].cells,
            f"{sum(f.right for f in found)} of {len(ms)}", float(np.nanmedian(metres)), float(np.nanmax(metres)),
            float(np.nanmedian(degrees)), float(np.nanmax(degrees)), 1e3 * float(np.median(ms)),
            1e3 * float(np.percentile(ms, 95)), *ratio,
        ])  # fmt: skip
    table(rows)
