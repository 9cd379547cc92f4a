"""Options of all commands that read a laser log: how its readings are understood."""

from __future__ import annotations

import math
from typing import Annotated, Any, TypeAlias

import typer

__all__ = [
    "AngleMin",
    "AngleStep",
    "LaserName",
    "Mount",
    "NoReturn",
    "OdometryTopic",
    "ScanFrame",
    "ScanTopic",
    "log_values",
]

AngleMin: TypeAlias = Annotated[float | None, typer.Option(help="Direction of the first beam, degrees.")]
AngleStep: TypeAlias = Annotated[float | None, typer.Option(help="Angle between beams, degrees.")]
NoReturn: TypeAlias = Annotated[float | None, typer.Option(help="Ranges from here on mean no return, m.")]
LaserName: TypeAlias = Annotated[str | None, typer.Option(help="front or rear, where a log has both.")]
ScanTopic: TypeAlias = Annotated[str | None, typer.Option(help="Topic of the laser in a bag.")]
ScanFrame: TypeAlias = Annotated[
    str | None,
    typer.Option(help="Frame of the scans in a bag, where a topic has several lasers.", show_default="the first"),
]
OdometryTopic: TypeAlias = Annotated[str | None, typer.Option(help="Topic of the odometry in a bag.")]
Mount: TypeAlias = Annotated[
    tuple[float, float, float] | None, typer.Option(help="Laser on the robot: x m, y m, heading degrees.")
]


def log_values(
    angle_min: float | None,
    angle_step: float | None,
    no_return: float | None,
    laser: str | None,
    scan_topic: str | None,
    odometry_topic: str | None,
    scan_frame: str | None = None,
) -> dict[str, Any]:
    """Return the options, None where they were not given, by the names and in the units of ``LogSettings``."""
    return {
        "angle_min": None if angle_min is None else math.radians(angle_min),
        "angle_step": None if angle_step is None else math.radians(angle_step),
        "no_return": no_return,
        "laser": laser,
        "scan_topic": scan_topic,
        "odometry_topic": odometry_topic,
        "scan_frame": scan_frame,
    }
