"""The planning benchmark: squares against hexagons, cubes against FCC and BCC, on maps other people published."""

from __future__ import annotations

from planners.benchmark.benchmark import planning_benchmark
from planners.benchmark.run import run_benchmark
from planners.benchmark.settings import GRIDS, BenchmarkSettings, Grid

__all__ = ["GRIDS", "BenchmarkSettings", "Grid", "planning_benchmark", "run_benchmark"]
