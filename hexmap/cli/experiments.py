"""``hexmap experiment``: the paper's evaluation on one's own scans."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from hexmap.cli import clouds
from hexmap.cli.console import first_run_note, progress_line, say, warn
from hexmap.cli.fleet import Cluster
from hexmap.cli.lattice_options import Bases, parse_basis
from hexmap.cli.usage import Command

app = typer.Typer(
    help="The paper's evaluation, on your own scans.", no_args_is_help=True, rich_markup_mode=None, add_completion=False
)

Folder = Annotated[Path, typer.Option("--output", "-o", help="Folder of the report.")]


@app.command(cls=Command, short_help="Count the cells of a scan as it turns: Table II.")
def rotation(
    points: Annotated[
        Path, typer.Argument(help="PCD, PLY, text, KITTI .bin, NPY; a log with --poses; a LiDAR's log; a map.")
    ],
    output: Folder,
    volume: clouds.Volume = None,
    area: clouds.Area = None,
    resolution: clouds.Resolution = None,
    poses: Annotated[Path | None, typer.Option(help="Poses (TUM) of a log; a LiDAR's without them is mapped.")] = None,
    lattice: Annotated[
        list[str] | None, typer.Option(help="A lattice to compare; again for more.", show_default="all")
    ] = None,
    basis: Bases = None,
    axis: Annotated[str, typer.Option(help="Axis of the rotations: x, y or z.")] = "z",
    start: Annotated[float, typer.Option(help="First angle, degrees.")] = 0.0,
    stop: Annotated[float, typer.Option(help="End of the angles, degrees; left out.")] = 180.0,
    step: Annotated[float, typer.Option(help="Angle between rotations, degrees.")] = 5.0,
    random: Annotated[int, typer.Option(help="Random rotations with shifts.")] = 200,
    workers: Annotated[int, typer.Option(help="Processes; the numbers do not depend on it.")] = 1,
    cluster: Cluster = None,
    seed: clouds.Seed = 0,
    format: clouds.Format = None,
    units: clouds.Units = "m",
    axes: clouds.Axes = "xyz",
    columns: clouds.ColumnNames = None,
    offset: clouds.Offset = "auto",
    min_range: clouds.MinRange = 0.0,
    max_range: clouds.MaxRange = None,
    crop: clouds.Crop = None,
    unique: clouds.Unique = False,
    sample: clouds.Sample = None,
) -> None:
    """Rotate a scan and count the cells of every lattice: Table II, Figs 2 to 7, verdicts on the paper's claims."""
    from hexmap.base.errors import ArgumentError
    from hexmap.experiments.cluster import cluster_executor
    from hexmap.io.lidar.open_lidar import is_lidar_log
    from hexmap.paper.rotation import rotation_experiment
    from hexmap.paper.rotation_settings import RotationSettings

    check_folder(output)
    planar = area is not None or (poses is not None and not is_lidar_log(points))
    dim = 2 if planar else 3
    wanted = clouds.cell_size(resolution, volume, area, dim)
    cloud, notes, warnings = clouds.read_cloud(
        points, poses, reading=clouds.Reading(format, units, axes, columns, offset), min_range=min_range,
        max_range=max_range, crop=crop, unique=unique, sample=sample, seed=seed, cells=wanted,
    )  # fmt: skip
    dim = cloud.shape[1]
    size = clouds.cell_size(resolution, volume, area, dim)
    if size is None:
        raise ArgumentError(f"say how large the cells are: {'--area' if dim == 2 else '--volume'} or --resolution")
    settings = RotationSettings(
        resolution=size, axis=axis, start=start, stop=stop, step=step, random=random, seed=seed,
        lattices=tuple(lattice) if lattice else None, own=tuple(parse_basis(text) for text in basis or ()),
    )  # fmt: skip
    settings.make_lattices(dim)
    for text in warnings:
        warn(text)
    say_if_resumed(output)
    first_run_note()
    fraction_done = [0.0]
    with (
        cluster_executor(cluster) as executor,
        progress_line("rotating", lambda: fraction_done[0], "cases") as update,
    ):

        def progress(done: int, total: int) -> None:
            fraction_done[0] = done / total
            update(done)

        report = rotation_experiment(
            cloud, settings, source=points.name, command=command_line(), notes=notes, folder=make_folder(output),
            workers=workers, executor=executor, progress=progress,
        )  # fmt: skip
    write_report(report, output)


@app.command(cls=Command, short_help="Compare lattices as quantisers of uniform data.")
def quantiser(
    output: Folder,
    count: Annotated[int, typer.Option(help="Points a lattice and measurement.")] = 1_000_000,
    seed: clouds.Seed = 0,
) -> None:
    """Uniform data, cell volumes by sampling, cost: every lattice as a quantiser."""
    from hexmap.paper.quantiser import quantiser_experiment

    check_folder(output)
    first_run_note()
    write_report(quantiser_experiment(count=count, seed=seed, command=command_line()), output)


def command_line() -> str:
    """Return the command line without the folders of this machine."""
    return " ".join(["hexmap", *(shlex.quote(Path(a).name if "/" in a else a) for a in sys.argv[1:])])


def check_folder(output: Path) -> None:
    """Check before the work begins that a report can be written there."""
    from hexmap.base.errors import FileAccessError

    if output.exists() and not output.is_dir():
        raise FileAccessError(f"{output}: the report needs a folder, and this is a file")
    parent = next((p for p in (output, *output.parents) if p.exists()), Path())
    if not parent.is_dir():
        raise FileAccessError(f"{output}: cannot be made: {parent} is not a folder")


def make_folder(output: Path) -> Path:
    """Make the folder of a report."""
    from hexmap.base.errors import FileAccessError

    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FileAccessError(f"{output}: cannot be made: {error.strerror}") from error
    return output


def say_if_resumed(output: Path) -> None:
    """Say that cases which an earlier run has finished are not computed again."""
    if any(output.glob("cases-*.jsonl")):
        say(
            f"{output}: finished cases of an earlier run are kept, with their times; "
            "remove the files cases-*.jsonl to compute all of them again"
        )


def write_report(report: object, output: Path) -> None:
    """Write a report and say where its files are."""
    from hexmap.experiments.report.report import Report

    assert isinstance(report, Report)
    for path in report.write(make_folder(output)):
        say(f"wrote {path}")
