"""Commands around maps: demo, simulate, merge."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexmap.cli.build import Readings, build_and_report
from hexmap.cli.build_lidar import lidar_settings
from hexmap.cli.console import check_map_output, check_outputs, first_run_note, progress_line, say, wrote
from hexmap.cli.fleet import Cluster

if TYPE_CHECKING:
    from hexmap.maps.map import Map
    from hexmap.poses.pose import Pose


# Endings by which others take a file for what a CARMEN log is not.
_OTHER_LOGS = (".bag", ".db3", ".mcap", ".tum", ".parquet", ".dat", ".csv")


def simulate(
    building: Annotated[str, typer.Argument(help="office, castle or room; warehouse3d for a LiDAR on several floors.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="The CARMEN log to write (.gz: compressed); warehouse3d: the folder of a ROS 2 bag."
        ),
    ],
    truth: Annotated[Path | None, typer.Option(help="Where to write the true poses (TUM).")] = None,
    seed: Annotated[int, typer.Option(help="Seed of noise and drift; warehouse3d: of the building, too.")] = 0,
    beams: Annotated[int | None, typer.Option(help="Beams of the laser over 180 degrees (181).")] = None,
    rings: Annotated[int | None, typer.Option(help="Rings of the LiDAR (32).")] = None,
    azimuths: Annotated[int | None, typer.Option(help="Columns of a sweep of the LiDAR (1024).")] = None,
    noise: Annotated[float | None, typer.Option(help="Standard deviation of a range, m (0.01; LiDAR 0.02).")] = None,
    missing: Annotated[float | None, typer.Option(help="Share of missing returns (0.005; LiDAR 0.01).")] = None,
    people: Annotated[int | None, typer.Option(help="People who walk about in front of the LiDAR (none).")] = None,
    scans: Annotated[int | None, typer.Option(help="Stop after so many scans of the LiDAR.")] = None,
    duration: Annotated[float | None, typer.Option(help="Stop after so many seconds of the drive.")] = None,
) -> None:
    """Simulate a drive through a building: what a laser or a LiDAR saw of it, and the true poses.

    The log of a planar laser has odometry that drifts. The bag of the LiDAR has /points with a time for each point; the
    true poses are those of the LiDAR at the end of each sweep.
    """
    from hexmap.base.errors import ArgumentError
    from hexmap.simulator.buildings import BUILDINGS
    from hexmap.simulator.space.warehouse import BUILDINGS_3D

    if building not in BUILDINGS + BUILDINGS_3D:
        raise ArgumentError(f"no building is called {building!r}; known are {', '.join(BUILDINGS + BUILDINGS_3D)}")
    common = {name: value for name, value in (("noise", noise), ("missing", missing)) if value is not None}
    planar = {"beams": beams}
    space = {"rings": rings, "azimuths": azimuths, "people": people, "scans": scans}
    in_space = building in BUILDINGS_3D
    for name, value in (planar if in_space else space).items():
        if value is not None:
            raise typer.BadParameter(f"--{name}: not with {building}, only with a {'laser' if in_space else 'LiDAR'}")
    if in_space:
        given = {name: value for name, value in space.items() if value is not None}
        _simulate_in_space(building, output, truth, seed, duration, {**common, **given})
    else:
        given = {} if beams is None else {"beams": beams}
        _simulate_in_plane(building, output, truth, seed, duration, {**common, **given})


def _simulate_in_plane(
    building: str, output: Path, truth: Path | None, seed: int, duration: float | None, laser: dict[str, Any]
) -> None:
    """Write the log of a planar laser with ``laser`` as its settings."""
    from hexmap.simulator.buildings import make_building
    from hexmap.simulator.laser import Laser
    from hexmap.simulator.writer import write_log

    check_outputs({"--output": output, "--truth": truth})
    ending = output.with_suffix("").suffix if output.suffix.lower() == ".gz" else output.suffix
    if ending.lower() in _OTHER_LOGS:
        raise typer.BadParameter(f"{output}: a CARMEN log is written, whose ending is .clf or .log, not {ending}")
    summary = write_log(output, make_building(building), truth, laser=Laser(**laser), seed=seed, duration=duration)
    wrote(
        output,
        f"{summary.scans} scans, {summary.odometry} odometry readings, "
        f"{summary.metres:.1f} m in {summary.seconds:.0f} s",
    )
    if truth is not None:
        wrote(truth, "true poses, one for each reading")


def _simulate_in_space(
    building: str, output: Path, truth: Path | None, seed: int, duration: float | None, settings: dict[str, Any]
) -> None:
    """Write the bag of a ring LiDAR; ``settings`` are its own, the number of people and of scans."""
    from hexmap.base.atomic_files import replaceable_folder
    from hexmap.simulator.space.bag import bag_content, write_bag
    from hexmap.simulator.space.ring_lidar import RingLidar
    from hexmap.simulator.space.run import People
    from hexmap.simulator.space.warehouse import make_building_3d

    replaceable_folder(output, bag_content(output))
    check_outputs({"--truth": truth})
    people, scans = People(settings.pop("people", 0)), settings.pop("scans", None)
    lidar = RingLidar(**settings)
    place = make_building_3d(building, seed)
    share = 0.0
    with progress_line("simulating", lambda: share) as update:

        def on_scan(count: int, total: int) -> None:
            nonlocal share
            share = count / total
            update(count)

        run: dict[str, Any] = {"seed": seed, "people": people, "duration": duration, "scans": scans}
        summary = write_bag(output, place, truth, lidar=lidar, **run, progress=on_scan)
    wrote(
        output,
        f"{summary.scans} scans, {summary.points} points, {summary.metres:.1f} m in {summary.seconds:.0f} s",
    )
    if truth is not None:
        wrote(truth, "true poses of the LiDAR, one for each scan")


def merge(
    maps: Annotated[
        list[Path], typer.Argument(help="Two or more maps on the same lattice and in the same frame; one to move it.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The map file to write (.parquet); with --tiles, a folder.")
    ],
    align: Annotated[
        bool, typer.Option("--align", help="Find each further map in those before it first, and move it there.")
    ] = False,
    same_frame: Annotated[
        bool, typer.Option("--same-frame", help="Take maps of different logs to be in the same frame.")
    ] = False,
    transform: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            help="Where the second map lies in the frame of the first, or where the only one is moved to.",
            metavar="X Y DEGREES",
        ),
    ] = None,
    again: Annotated[bool, typer.Option("--again", help="Count a log again that is in several of the maps.")] = False,
    tiles: Annotated[
        float | None,
        typer.Option(help="Write a folder of tiles about so many metres wide; the maps may be larger than memory."),
    ] = None,
    workers: Annotated[int, typer.Option(help="With --tiles: processes; the map does not depend on it.")] = 1,
    cluster: Cluster = None,
) -> None:
    """Merge maps cell by cell; the order does not matter unless they are moved."""
    from hexmap.base.errors import AlignmentError, ArgumentError, BoundsError, LatticeError
    from hexmap.io.map_file import save_map
    from hexmap.io.open_map import open_map
    from hexmap.maps.origin import common_logs, logs_in_words

    if tiles is not None:
        if align or transform is not None:
            raise typer.BadParameter("--tiles merges maps as they lie; --align and --transform write one file")
        _merge_tiles(maps, output, tiles, same_frame, again, workers, cluster)
        return
    for name, is_set in (("--workers", workers != 1), ("--cluster", cluster is not None)):
        if is_set:
            raise typer.BadParameter(f"{name} is for maps larger than memory, with --tiles")
    _check_merge(len(maps), align, same_frame, transform)
    check_map_output(output)
    check_outputs({"--output": output}, tuple(maps))
    merged = open_map(maps[0])
    pose = _planar_or_upright(transform, merged.lattice.dim)
    if len(maps) == 1:
        save_map(output, merged.transform(pose))
        wrote(output, f"moved by {_transform_words(transform)}")
        return
    found: list[str] = []
    for path in maps[1:]:
        other = open_map(path)
        twice = common_logs(merged.sources(), other.sources())
        if twice and not again:
            raise ArgumentError(
                f"{path}: {logs_in_words(twice)} is in the other maps, too, and would count twice; --again does that"
            )
        try:
            if align:
                merged, words = _merge_aligned(merged, other)
                found.append(f"; {path.name} at {words}")
            elif transform is not None:
                from localisation.mapping.align import moved_into

                merged = merged.merge(moved_into(merged, other, pose), same_frame=True)
                found.append(f"; {path.name} at {_transform_words(transform)}")
            else:
                merged = merged.merge(other, same_frame=same_frame)
        except AlignmentError as error:
            raise AlignmentError(f"{path}: not found in {maps[0]}: {error}") from error
        except (LatticeError, ArgumentError, BoundsError) as error:
            ways = "; --align, --transform X Y DEGREES or --same-frame says how they lie"
            ways = ways if "different frames" in str(error) else ""
            raise type(error)(f"{path}: cannot be merged with {maps[0]}: {error}{ways}") from error
    save_map(output, merged)
    wrote(output, f"{len(maps)} maps merged, {len(merged.levels[0].hits)} cells hit{''.join(found)}")


def _merge_tiles(
    maps: list[Path], output: Path, tiles: float, same_frame: bool, again: bool, workers: int, cluster: str | None
) -> None:
    """Merge maps that may be larger than memory into a folder of tiles."""
    from hexmap.base.errors import FileAccessError
    from hexmap.experiments.cluster import cluster_executor
    from hexmap.io.tile_merge import merge_maps

    if output.suffix.lower() == ".parquet":
        raise FileAccessError(f"{output}: cannot be written: with --tiles the map is a folder, and this names a file")
    fraction = [0.0]
    with cluster_executor(cluster) as executor, progress_line("merging", lambda: fraction[0], "rows") as update:

        def progress(rows: int, total: int) -> None:
            fraction[0] = rows / max(1, total)
            update(rows)

        merged = merge_maps(
            maps, output, tiles, same_frame=same_frame, again=again, workers=workers, executor=executor,
            progress=progress,
        )  # fmt: skip
    count = "1 map cut" if len(maps) == 1 else f"{len(maps)} maps merged"
    wrote(output, f"{count} into {len(merged.tiles):,} tiles, {merged.totals()[0]['hit_cells']:,} cells hit")


def _check_merge(count: int, align: bool, same_frame: bool, transform: tuple[float, float, float] | None) -> None:
    """Reject options of ``merge`` that do not go together."""
    given = {"--align": align, "--same-frame": same_frame, "--transform": transform is not None}
    named = [name for name, is_given in given.items() if is_given]
    if len(named) > 1:
        raise typer.BadParameter(f"{' and '.join(named)} say different things of how the maps lie; give one of them")
    if transform is not None and not all(math.isfinite(v) for v in transform):
        raise typer.BadParameter("--transform takes finite numbers: metres, metres, degrees")
    if transform is not None and count > 2:
        raise typer.BadParameter(f"--transform says where one map lies in another, and there are {count}")
    if count < 2 and transform is None:
        raise typer.BadParameter("merging takes two maps or more; one map is moved with --transform")


def _planar_or_upright(transform: tuple[float, float, float] | None, dim: int) -> Pose:
    """Return the pose of x, y in metres and a turn about z in degrees, in the plane or in space."""
    import numpy as np

    from hexmap.poses.pose import Pose

    x, y, degrees = transform or (0.0, 0.0, 0.0)
    flat = Pose.planar(x, y, math.radians(degrees))
    if dim == 2:
        return flat
    rotation = np.eye(3)
    rotation[:2, :2] = flat.rotation
    return Pose(rotation, [x, y, 0.0])


def _transform_words(transform: tuple[float, float, float] | None) -> str:
    """Return a transform as it stands in a message."""
    x, y, degrees = transform or (0.0, 0.0, 0.0)
    return f"({x:g}, {y:g}) m, {degrees:g} degrees"


def _merge_aligned(a: Map, b: Map) -> tuple[Map, str]:
    """Find b in a and merge both; returns the map in a's frame, and where b was found."""
    from hexmap.base.errors import LatticeError
    from hexmap.cli.viewing import rule_of
    from localisation.mapping.align import align_maps, moved_into, pose_words
    from localisation.mapping.align_in_space import align_maps_in_space

    # Before the search, which takes seconds.
    if a.lattice != b.lattice:
        raise LatticeError(f"the maps are on different lattices: {a.lattice!r} and {b.lattice!r}")
    first_run_note()
    align = align_maps if a.lattice.dim == 2 else align_maps_in_space
    found = align(a, b, rules=(rule_of(None, None, a.sources()), rule_of(None, None, b.sources())))
    what = f"{pose_words(found.pose)}, {found.overlap:.0%} overlap, {found.contradicted:.0%} contradicted"
    return a.merge(moved_into(a, b, found.pose), same_frame=True), what


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="The folder to write to.")] = Path("demo"),
    lattice: Annotated[
        str | None, typer.Option(help="Z2 or A2; in space Z3, D3 or D3*.", show_default="A2, D3")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of noise and drift.")] = 0,
    space: Annotated[bool, typer.Option("--space", help="A LiDAR in a warehouse, on a lattice of space.")] = False,
) -> None:
    """Simulate an office and a drive through it, map it from the log alone, draw it and score it."""
    import numpy as np

    from hexmap.base.errors import FileAccessError
    from hexmap.drawing.map_drawing import draw_map
    from hexmap.io.logs.open_log import open_log
    from hexmap.io.map_file import load_map
    from hexmap.io.trajectories import read_trajectory
    from hexmap.poses.trajectory import Trajectory
    from hexmap.simulator.buildings import make_building
    from hexmap.simulator.writer import write_log
    from localisation.evaluation import absolute_error
    from localisation.settings import MappingSettings

    settings = replace(MappingSettings(), lattice=lattice or "A2") if not space else None
    in_space = lidar_settings({}, {"lattice": lattice or "D3"}) if space else None
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileAccessError(f"{output}: cannot be made: {error.strerror}") from error
    if settings is None or in_space is not None:
        from hexmap.cli.demo_in_space import demo_in_space

        assert in_space is not None
        demo_in_space(output, in_space, seed)
        return
    log, truth = output / "office.clf", output / "office.truth.tum"
    summary = write_log(log, make_building("office"), truth, seed=seed)
    say(f"simulated {summary.metres:.0f} m through an office in {summary.seconds:.0f} s: {summary.scans} scans")
    wrote(log, "CARMEN log")
    wrote(truth, "true poses")
    first_run_note(45)
    path, poses, picture = output / "office.parquet", output / "office.tum", output / "office.png"
    build_and_report([open_log(log)], settings, path, poses, Readings.all, picture, None, None)
    detail, coarse = output / "office-detail.png", output / "office-coarse.png"
    whole = load_map(path)
    low, high = whole.bounds() or (np.zeros(2), np.zeros(2))
    low = low + 0.35 * (high - low)
    draw_map(whole.crop(low, low + 5.0), detail, rule=settings.rule)
    wrote(detail, "5 x 5 m of it")
    draw_map(whole, coarse, level=2, rule=settings.rule)
    wrote(coarse, "the coarsest level")
    estimate, reference = read_trajectory(poses), read_trajectory(truth)
    wheels = Trajectory.from_poses(*_odometry(log))
    raw = absolute_error(reference, wheels, "order")
    matched = absolute_error(reference, estimate, "order")
    say(
        f"mean error of the poses: {matched.translation.mean:.3f} m and {matched.rotation_deg.mean:.2f} degrees "
        f"(odometry alone: {raw.translation.mean:.3f} m, {raw.rotation_deg.mean:.2f} degrees)"
    )


def _odometry(log: Path) -> tuple[list[float], list[Any]]:
    """Return stamps and poses of the odometry of every reading of a log."""
    from hexmap.io.logs.open_log import open_log
    from hexmap.poses.scan import Scan

    stamps, poses = [], []
    for event in open_log(log):
        stamps.append(event.stamp)
        poses.append(event.odometry if isinstance(event, Scan) else event.pose)
    return stamps, poses
