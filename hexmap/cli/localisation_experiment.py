"""``hexmap experiment localisation``: which lattice localises better, on one's own log."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from hexmap.cli import clouds
from hexmap.cli.console import first_run_note, progress_line, say, warn, wrote
from hexmap.cli.experiments import Folder, check_folder, command_line, make_folder, say_if_resumed
from hexmap.cli.fleet import Cluster
from hexmap.cli.lattice_options import Bases, parse_basis

if TYPE_CHECKING:
    from hexmap.io.lidar.lidar_log import LidarLog
    from hexmap.io.logs.log import Log
    from localisation.experiments.settings import ExperimentSettings

__all__ = ["localisation"]

Number = TypeVar("Number", int, float)


def localisation(
    log: Annotated[
        Path, typer.Argument(help="CARMEN log (plain or .gz), ROS bag or MCAP; of a LiDAR also a folder of scans.")
    ],
    output: Folder,
    lattices: Annotated[
        str | None,
        typer.Option(
            help="Names; the others are compared with the first.", show_default="Z2,A2; of a LiDAR Z3,D3,D3*"
        ),
    ] = None,
    basis: Bases = None,
    resolutions: Annotated[
        str | None, typer.Option(help="Resolutions, m.", show_default="0.05,0.1,0.2; of a LiDAR 0.1,0.2")
    ] = None,
    poses: Annotated[Path | None, typer.Option(help="Reference poses (TUM); without them the log is mapped.")] = None,
    test: Annotated[
        Path | None, typer.Option(help="Another run of the same place, whose scans are looked for.")
    ] = None,
    test_poses: Annotated[Path | None, typer.Option(help="Its poses (TUM), in the frame of --poses.")] = None,
    associate: Annotated[str | None, typer.Option(help="How poses go with scans: order or time.")] = None,
    split: Annotated[str, typer.Option(help="Held-out scans: every (k-th), or half (the second).")] = "every",
    hold_out: Annotated[int, typer.Option(help="The k of every k-th.")] = 4,
    tasks: Annotated[
        str | None,
        typer.Option(
            help="Some of global, local, localise, mapping, rotation, learning.",
            show_default="all; of a LiDAR all but mapping",
        ),
    ] = None,
    scans: Annotated[
        int | None, typer.Option(help="Scans that are looked for in each task.", show_default="40; of a LiDAR 24")
    ] = None,
    starts: Annotated[
        int | None, typer.Option(help="Starts without a pose along the log.", show_default="12; of a LiDAR 6")
    ] = None,
    max_range: Annotated[float | None, typer.Option(help="Leave out points farther than this, m.")] = None,
    points: Annotated[
        int | None, typer.Option(help="Of a LiDAR's scan, at most so many points at random.", show_default="20000")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer of everything, no mapping: a minute; of a LiDAR longer.")
    ] = False,
    workers: Annotated[int, typer.Option(help="Processes; the numbers do not depend on it, times aside.")] = 1,
    cluster: Cluster = None,
    seed: clouds.Seed = 0,
) -> None:
    """Held-out scans found, matched, localised and mapped on every lattice, with intervals, baselines and verdicts.

    An interrupted run goes on where it stopped. Times are in a report of their own, in the folder times.
    """
    from hexmap.experiments.cluster import cluster_executor
    from hexmap.io.lidar.open_lidar import is_lidar_log
    from hexmap.io.trajectories import read_trajectory
    from localisation.experiments.run import localisation_experiment

    check_folder(output)
    given = {
        "lattices": None if lattices is None else tuple(_words(lattices)), "scans": scans, "starts": starts,
        "resolutions": None if resolutions is None else _numbers(resolutions, "--resolutions", float),
        "tasks": None if tasks is None else tuple(_words(tasks)), "points": points,
    }  # fmt: skip
    in_space = is_lidar_log(log)
    settings = _settings(
        in_space, quick, [_own(text) for text in basis or ()], split=split, hold_out=hold_out, max_range=max_range,
        seed=seed, **{name: value for name, value in given.items() if value is not None},
    )  # fmt: skip
    settings.check_dim(3 if in_space else 2)
    source, other = _opened(log), None if test is None else _opened(test)
    reference, other_reference = (None if path is None else read_trajectory(path) for path in (poses, test_poses))
    say_if_resumed(output)
    first_run_note(45)
    fraction = [0.0]
    with (
        cluster_executor(cluster) as executor,
        progress_line("localising", lambda: fraction[0], "cases") as update,
    ):

        def progress(done: int, total: int) -> None:
            fraction[0] = done / total
            update(done)

        with _removed_if_empty(output):
            outcome = localisation_experiment(
                source, settings, poses=reference, test=other, test_poses=other_reference, associate=associate,
                command=command(), folder=make_folder(output), workers=workers, executor=executor,
                progress=progress,
            )  # fmt: skip
    for text in [*source.warnings, *(other.warnings if other is not None else [])]:
        warn(text)
    *files, rows, times = outcome.write(output)
    for path in files:
        say(f"wrote {path}")
    wrote(rows, f"{len(outcome.results.rows):,} rows, one a scan, lattice and method")
    wrote(times, "what each cost")


@contextmanager
def _removed_if_empty(folder: Path) -> Iterator[None]:
    """Leave no folder behind that was made for nothing."""
    there = folder.exists()
    try:
        yield
    except BaseException:
        if not there:
            with suppress(OSError):
                folder.rmdir()
        raise


def command() -> str:
    """Return the command line as it was typed, without the workers, on which no number depends."""
    words = shlex.split(command_line())
    out: list[str] = []
    skip = False
    for word in words:
        name, _, value = word.partition("=")
        if skip:
            skip = False
        elif name in ("--workers", "--cluster"):
            skip = not value
        else:
            out.append(word)
    return shlex.join(out)


def _opened(path: Path) -> Log | LidarLog:
    """Open a log of a LiDAR or of a planar laser."""
    from hexmap.io.lidar.open_lidar import is_lidar_log, open_lidar
    from hexmap.io.logs.open_log import open_log

    return open_lidar(path) if is_lidar_log(path) else open_log(path)


def _settings(in_space: bool, quick: bool, own: list[Any], **values: Any) -> ExperimentSettings:
    """Return the settings; what was asked for by number stands, also in a quick run.

    ``own`` are bases that join the lattices, those asked for or the default ones.
    """
    from dataclasses import replace

    from localisation.experiments.settings import ExperimentSettings, in_space_settings
    from localisation.experiments.settings import quick as quicker

    settings = in_space_settings() if in_space else ExperimentSettings()
    values["lattices"] = (*values.get("lattices", settings.lattices), *own)
    if values.get("points") is not None and not in_space:
        from hexmap.base.errors import ArgumentError

        raise ArgumentError("--points is for a LiDAR's log; leave it out for a planar one")
    settings = replace(settings, **values)
    if not quick:
        return settings
    kept = ("scans", "starts", "resolutions", "tasks")
    return replace(quicker(settings), **{name: values[name] for name in kept if name in values})


def _own(text: str) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in parse_basis(text))


def _words(text: str) -> list[str]:
    return [word.strip() for word in text.split(",") if word.strip()]


def _numbers(text: str, option: str, kind: Callable[[str], Number]) -> tuple[Number, ...]:
    """Return the numbers of an option.

    Raises:
        ArgumentError: one of them is not a number.
    """
    from hexmap.base.errors import ArgumentError

    try:
        return tuple(kind(word) for word in _words(text))
    except ValueError:
        raise ArgumentError(f"{option} takes numbers separated by commas, not {text!r}") from None
