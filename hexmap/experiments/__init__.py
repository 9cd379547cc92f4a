"""Experiments: independent cases on one runner, intervals by bootstrap, and one kind of report.

:mod:`~hexmap.experiments.runner` computes the cases, on any number of workers and after any number
of interruptions to the same bits; :mod:`~hexmap.experiments.statistics` says how sure a number is;
:mod:`~hexmap.experiments.report` writes what came out as HTML, Markdown, CSV and figures.
"""
