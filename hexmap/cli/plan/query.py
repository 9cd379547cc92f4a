"""What is asked of ``hexmap plan``: positions, planners, options that go together, numbers in their range."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import typer

from hexmap.cli.usage import Command

Position = tuple[float, ...]
# Such as nan are matched too: they are rejected as positions, and not taken for the name of a file.
_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf|infinity)", re.IGNORECASE)
_SIZES = 1e-6, 1e6  # metres that options may ask for
_MOST_WEIGHT = 1e6  # beyond it costs drown the lengths of the paths


class Planner(StrEnum):
    """What looks for the path."""

    astar = "astar"
    dijkstra = "dijkstra"
    any_angle = "any-angle"
    canonical = "canonical"


class Unknown(StrEnum):
    """What to take unknown cells for."""

    blocked = "blocked"
    free = "free"


class PlanCommand(Command):
    """A command whose --from and --to take all numbers that follow, negative ones too."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the numbers after --from and --to by commas before the parser takes -8 for an option."""
        joined: list[str] = []
        seen: set[str] = set()
        rest = list(args)
        while rest:
            word = rest.pop(0)
            if word == "--":
                joined += [word, *rest]
                break
            name = word.partition("=")[0]
            if name in ("--from", "--to"):
                if name in seen:
                    raise typer.BadParameter(f"{name} is given twice", ctx=ctx)
                seen.add(name)
            if word in ("--from", "--to"):
                numbers = []
                while rest and all(_NUMBER.fullmatch(word) for word in rest[0].rstrip(",").split(",")):
                    numbers.append(rest.pop(0).rstrip(","))
                if numbers:
                    word = f"{word}={','.join(numbers)}"
            joined.append(word)
        return super().parse_args(ctx, joined)


def parse_position(text: str) -> Position:
    """Return the numbers of a position."""
    try:
        numbers = tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        numbers = ()
    if len(numbers) not in (2, 3):
        raise typer.BadParameter(f"a position takes two or three finite numbers of metres, not {text!r}")
    for word, number in zip(text.replace(",", " ").split(), numbers, strict=True):
        if not math.isfinite(number):
            raise typer.BadParameter(f"a position takes finite numbers of metres, not {word}")
    return numbers


def parse_neighbourhood(text: str) -> str | int:
    """Return a neighbourhood's name or size."""
    if text in ("nearest", "faces", "extended"):
        return text
    if not text.isdecimal():
        raise typer.BadParameter(f"a neighbourhood is nearest, faces, extended or a number of moves, not {text!r}")
    return int(text)


@dataclass(frozen=True)
class Query:
    """What is asked of a map, as the options say it.

    Attributes:
        start, goal: positions, metres.
        planner, weight, bidirectional, shortcut, nearest: how the path is looked for; no planner: see
            :func:`with_planner`.
        radius, clearance_weight, clearance_reach: how it keeps off occupied cells.
        unknown, neighbourhood: what cells and what moves it may take.
        is_default: whether the planner was chosen for the user, and other options may choose another.
    """

    start: Position
    goal: Position
    planner: Planner | None
    weight: float | None
    bidirectional: bool
    shortcut: bool
    nearest: bool
    radius: float
    clearance_weight: float | None
    clearance_reach: float | None
    unknown: Unknown
    neighbourhood: Any
    is_default: bool = False


def check_usage(query: Query) -> None:
    """Reject options that do not go together."""
    planner = query.planner
    asked = {
        "--weight": query.weight is not None, "--bidirectional": query.bidirectional, "--nearest": query.nearest,
    }  # fmt: skip
    named = [name for name, given in asked.items() if given]
    if named and planner is not None and planner is not Planner.astar:
        instead = "; in Python planners.nearest_reachable gives the cell to search to" if query.nearest else ""
        raise typer.BadParameter(f"{' and '.join(named)}: only with --planner astar, not with {planner.value}{instead}")
    if query.clearance_weight is not None and planner is not None and planner not in (Planner.astar, Planner.dijkstra):
        raise typer.BadParameter(f"--clearance-weight: only with --planner astar or dijkstra, not with {planner.value}")
    if query.bidirectional and query.weight is not None:
        raise typer.BadParameter("--bidirectional takes no --weight")
    if query.shortcut and planner is Planner.any_angle:
        raise typer.BadParameter("--shortcut: a path of any angle is straightened already")
    if query.clearance_reach is not None and query.clearance_weight is None:
        raise typer.BadParameter("--clearance-reach needs a --clearance-weight")


def with_planner(query: Query) -> Query:
    """Return the query with what looks for a straight path where no planner is named.

    In the plane that is the any-angle planner. In space, where it is slow, and with costs or options that it does not
    take it is A*, whose path is straightened by line of sight.
    """
    if query.planner is not None:
        return query
    only_astar = query.weight is not None or query.bidirectional or query.nearest or query.shortcut
    if len(query.start) == 2 and query.clearance_weight is None and not only_astar:
        return replace(query, planner=Planner.any_angle, is_default=True)
    return replace(query, planner=Planner.astar, shortcut=True, is_default=True)


def planner_words(query: Query) -> str:
    """Return what looked for the path, and what was done to it, for the report."""
    name = "A*" if query.planner is Planner.astar else str(query.planner)
    if not query.shortcut:
        return name
    where = " where that costs no more" if query.clearance_weight is not None else ""
    return f"{name}, straightened by line of sight{where},"


def check_numbers(query: Query, sizes: dict[str, float | None], min_hits: int | None, min_ratio: float | None) -> None:
    """Reject numbers out of their range.

    Raises:
        ArgumentError: naming the option and the value.
    """
    from hexmap.base.errors import ArgumentError

    low, high = _SIZES
    limits: list[tuple[str, float | None, float, float, str]] = [
        *((option, size, low, high, " m") for option, size in sizes.items()),
        ("--radius", query.radius, 0.0, high, " m"),
        ("--clearance-reach", query.clearance_reach, low, high, " m"),
        ("--weight", query.weight, 1.0, _MOST_WEIGHT, ""),
        ("--clearance-weight", query.clearance_weight, 0.0, _MOST_WEIGHT, ""),
        ("--min-hits", min_hits, 1, 2**31 - 1, ""),
        ("--min-ratio", min_ratio, 0.0, 1.0, ""),
    ]
    for option, value, least, most, unit in limits:
        if value is not None and not least <= value <= most:
            raise ArgumentError(f"{option} must be {least:.10g} to {most:.10g}{unit}, not {value:.10g}")


def in_metres(position: Any) -> str:
    """Return a position as a user reads it, such as (1.5, -2)."""
    return f"({', '.join(f'{round(float(v), 3):.10g}' for v in position)})"


def counted(number: int, one: str, many: str = "") -> str:
    """Return a number with its noun, such as "1 cell" and "2,000 cells"."""
    return f"{number:,} {one if number == 1 else many or one + 's'}"


def cell_text(cell: Any) -> str:
    """Return an index as a user reads it."""
    return f"({', '.join(str(int(v)) for v in cell)})"
