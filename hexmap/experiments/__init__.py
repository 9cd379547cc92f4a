"""The machinery of any experiment: independent cases on one runner, intervals by bootstrap, one kind of report.

``run_cases`` computes the cases, on any number of workers and after any number of interruptions to the same bits;
``statistics`` says how sure a number is; ``report/`` writes what came out as HTML, Markdown, CSV and figures.
"""

from __future__ import annotations

from hexmap.experiments.case import CaseError, CaseFunction, case_generator
from hexmap.experiments.run_cases import run_cases
from hexmap.experiments.statistics import Interval, bootstrap, bootstrap_ratio
from hexmap.experiments.timing import median_seconds

__all__ = [
    "CaseError",
    "CaseFunction",
    "Interval",
    "bootstrap",
    "bootstrap_ratio",
    "case_generator",
    "median_seconds",
    "run_cases",
]
