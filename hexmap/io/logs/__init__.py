"""Laser logs, read as a stream of scans and odometry readings.

CARMEN text and the logs of Wean Hall (plain or gzip), ROS 1 bags, ROS 2 bags (sqlite3 or MCAP, a folder or one file).

Examples:
    >>> from hexmap.io.logs import open_log
    >>> log = open_log("run.clf.gz")  # doctest: +SKIP
    >>> for event in log:  # doctest: +SKIP
    ...     ...
"""

from __future__ import annotations

from hexmap.io.logs.log import Log, LogSettings, beam_fan
from hexmap.io.logs.open_log import open_log

__all__ = ["Log", "LogSettings", "beam_fan", "open_log"]
