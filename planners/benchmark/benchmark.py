"""The planning benchmark as one call: run it, report it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING

from planners.benchmark.run import Progress, run_benchmark
from planners.benchmark.settings import BenchmarkSettings

if TYPE_CHECKING:
    from planners.benchmark.report import Outcome


def planning_benchmark(
    maps: Sequence[Path],
    settings: BenchmarkSettings | None = None,
    *,
    command: str = "",
    folder: Path | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Outcome:
    """Run the benchmark on maps and return its report, and whether the baseline check passed.

    Args:
        maps: files that :func:`hexmap.io.grids.open_grid` reads, with their problems beside them.
        settings: what to do.
        command: the command line, for the report.
        folder: where finished cases are kept; an interrupted run goes on from there.
        workers: processes; the numbers do not depend on it, times aside.
        executor: computes the cases instead of ``workers``, see :func:`~hexmap.experiments.run_cases`.
        progress: called with the cases done and their number.

    Raises:
        ArgumentError: no map, or two of the same name.
        FormatError: a file is not what it should be.
    """
    from planners.benchmark.report import make_report

    settings = settings or BenchmarkSettings()
    results = run_benchmark(maps, settings, folder=folder, workers=workers, executor=executor, progress=progress)
    return make_report(results, command)
