"""Reports of experiments: one list of elements, written as HTML, Markdown, CSV and figures."""

from __future__ import annotations

from hexmap.experiments.report.report import Report

__all__ = ["Report"]
