"""``hexmap benchmark``: comparisons that can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from hexmap.cli import clouds
from hexmap.cli.console import first_run_note, progress_line, wrote
from hexmap.cli.experiments import check_folder, command_line, say_if_resumed, write_report
from hexmap.cli.fleet import Cluster
from hexmap.cli.lattice_options import Bases, parse_basis
from hexmap.cli.plan.map_source import found
from hexmap.cli.usage import Command

Number = TypeVar("Number", int, float)

app = typer.Typer(
    help="Compare planners on lattices, on maps with published optima.",
    no_args_is_help=True, rich_markup_mode=None, add_completion=False,
)  # fmt: skip


@app.callback()
def _group() -> None:
    """Keep ``planning`` a command of its own."""


@app.command(cls=Command, short_help="Compare grids and planners on published maps.")
def planning(
    maps: Annotated[
        list[Path],
        typer.Argument(help="MovingAI .map, Warframe .3dmap(.gz), ROS .yaml, OctoMap .bt; problems beside them."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder of the report.")],
    queries: Annotated[int, typer.Option(help="Problems per map, drawn from its file.")] = 200,
    angles: Annotated[
        str | None, typer.Option(help="Degrees by which the maps are turned.", show_default="0,17,31")
    ] = None,
    random_angles: Annotated[int | None, typer.Option(help="A number of random angles instead.")] = None,
    fractions: Annotated[
        str, typer.Option(help="Resolutions: 2 for half the edge of a source cell, and so on.")
    ] = "2,4",
    planners: Annotated[str, typer.Option(help="On every grid: astar, dijkstra, canonical.")] = "astar,canonical",
    max_cells: Annotated[int, typer.Option(help="Largest window; larger ones are left out.")] = 300_000_000,
    basis: Bases = None,
    workers: Annotated[int, typer.Option(help="Processes; the numbers do not depend on it, times aside.")] = 1,
    cluster: Cluster = None,
    seed: clouds.Seed = 0,
) -> None:
    """Square against hexagonal grids, cubic against FCC and BCC: length, turning, clearance, effort, time."""
    from hexmap.base.errors import ArgumentError, FormatError, HexmapError
    from hexmap.experiments.cluster import cluster_executor
    from hexmap.io.file_kinds import is_own_map
    from planners.benchmark.benchmark import planning_benchmark
    from planners.benchmark.report_queries import QUERIES
    from planners.benchmark.settings import BenchmarkSettings

    check_folder(output)
    paths = [found(path) for path in maps]
    for path in paths:
        if is_own_map(path):
            raise FormatError(
                f"{path}: the benchmark compares lattices on squares or cubes of others, and a map of hexmap is on one "
                "lattice already; hexmap export writes it as .yaml"
            )
    known = ("astar", "dijkstra", "canonical")
    chosen = tuple(name.strip() for name in planners.split(",") if name.strip())
    for name in chosen:
        if name not in known:
            raise ArgumentError(f"--planners takes {', '.join(known)}, not {name!r}")
    if "astar" not in chosen:
        raise ArgumentError("--planners needs astar, which the others are compared with")
    if angles is not None and random_angles is not None:
        raise typer.BadParameter("give --angles or --random-angles, not both")
    if random_angles is None:
        degrees = _numbers("0,17,31" if angles is None else angles, "--angles", float)
    else:
        degrees = _random_angles(random_angles, seed)
    settings = BenchmarkSettings(
        queries=queries,
        angles=degrees,
        fractions=_numbers(fractions, "--fractions", int),
        max_cells=max_cells, seed=seed, planners=chosen,
    ).with_own([parse_basis(text) for text in basis or ()])  # fmt: skip
    say_if_resumed(output)
    first_run_note()
    fraction = [0.0]
    with (
        cluster_executor(cluster) as executor,
        progress_line("planning", lambda: fraction[0], "cases") as update,
    ):

        def progress(done: int, total: int) -> None:
            fraction[0] = done / total
            update(done)

        outcome = planning_benchmark(
            paths, settings, command=command_line(), folder=output,
            workers=workers, executor=executor, progress=progress,
        )  # fmt: skip
    write_report(outcome.report, output)
    wrote(output / f"{QUERIES}.csv", "the answer of every planner to every query")
    wrote(output / "report.html", "to begin with")
    if outcome.failures:
        raise HexmapError("; ".join(outcome.failures))


def _numbers(text: str, option: str, kind: Callable[[str], Number]) -> tuple[Number, ...]:
    """Return the numbers of an option.

    Raises:
        ArgumentError: one of them is not a number.
    """
    from hexmap.base.errors import ArgumentError

    out = []
    for word in text.split(","):
        try:
            out.append(kind(word))
        except ValueError:
            raise ArgumentError(f"{option} takes numbers separated by commas, not {text!r}") from None
    return tuple(out)


def _random_angles(count: int, seed: int) -> tuple[float, ...]:
    """Return seeded random angles, degrees."""
    import numpy as np

    from hexmap.base.errors import ArgumentError

    if not 1 <= count <= 1000:
        raise ArgumentError(f"--random-angles takes 1 to 1000, not {count}")
    if seed < 0:
        raise ArgumentError(f"the seed must be 0 or larger, not {seed}")
    return tuple(float(a) for a in np.round(np.random.default_rng([seed, 11]).uniform(0.0, 360.0, count), 3))
