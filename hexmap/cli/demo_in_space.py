"""The demonstration in space: a ring LiDAR in a simulated warehouse, from its log to map, pictures and poses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hexmap.cli.build_lidar import LidarOutputs, build_lidar
from hexmap.cli.console import first_run_note, progress_line, say, wrote

if TYPE_CHECKING:
    from localisation.lidar_settings import LidarSettings

__all__ = ["demo_in_space"]

# Half a minute of the drive: once around the ground floor and some way back.
_SCANS = 150
_AZIMUTHS = 512
# Of the scans, every so many are looked for in the map.
_LOOKED_FOR = 15


def demo_in_space(output: Path, settings: LidarSettings, seed: int) -> None:
    """Simulate a run, map it on a lattice of space, draw, export, score it, and find its scans in the map."""
    from hexmap.drawing.slice_drawing import draw_slice
    from hexmap.io.map_file import load_map
    from hexmap.io.octomap_export import export_octomap
    from hexmap.io.trajectories import read_trajectory
    from hexmap.simulator.space.bag import write_bag
    from hexmap.simulator.space.ring_lidar import RingLidar
    from hexmap.simulator.space.warehouse import make_building_3d
    from localisation.evaluation import absolute_error

    run, truth = output / "warehouse", output / "warehouse.truth.tum"
    building, share = make_building_3d("warehouse3d", seed), 0.0
    first_run_note(45)
    with progress_line("simulating", lambda: share) as update:

        def on_scan(count: int, total: int) -> None:
            nonlocal share
            share = count / total
            update(count)

        lidar = RingLidar(azimuths=_AZIMUTHS)
        summary = write_bag(run, building, truth, lidar=lidar, seed=seed, scans=_SCANS, progress=on_scan)
    say(f"simulated {summary.metres:.0f} m through a warehouse in {summary.seconds:.0f} s: {summary.scans} scans")
    wrote(run, "ROS 2 bag")
    wrote(truth, "true poses")
    path, poses, picture = output / "warehouse.parquet", output / "warehouse.tum", output / "warehouse.png"
    build_lidar([run], settings, LidarOutputs(path, poses, picture), None, None, True)
    states = load_map(path).state(settings.rule)
    cut, octomap = output / "warehouse-slice.png", output / "warehouse.bt"
    draw_slice(states, 0.3, cut, trajectory=read_trajectory(poses))
    wrote(cut, "a slice 0.3 m above the sensor")
    export_octomap(states, octomap)
    wrote(octomap, "OctoMap")
    error = absolute_error(read_trajectory(truth), read_trajectory(poses), "order")
    say(
        f"mean error of the poses: {error.translation.mean:.3f} m and {error.rotation_deg.mean:.2f} degrees "
        f"over {summary.metres:.0f} m"
    )
    _find(run, path, poses)


def _find(run: Path, path: Path, poses: Path) -> None:
    """Look for some scans in the map, each without knowing anything of where it is."""
    import numpy as np

    from hexmap.io.lidar.open_lidar import open_lidar
    from hexmap.io.map_file import load_map
    from hexmap.io.trajectories import read_trajectory
    from localisation.localiser.lidar_localiser import LidarLocaliser

    localiser, known = LidarLocaliser(load_map(path).state()), read_trajectory(poses)
    found = looked = 0
    for number, scan in enumerate(open_lidar(run)):
        if number % _LOOKED_FOR or number >= len(known):
            continue
        looked += 1
        localiser.forget()
        pose = localiser.add(scan).pose
        found += pose is not None and float(np.linalg.norm(pose.translation - known[number].translation)) < 0.5
    say(f"{found} of {looked} scans found in the map again without a start pose")
