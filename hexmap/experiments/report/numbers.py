"""How a report shows numbers, intervals, and columns of them: as many digits as say something, and no more."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hexmap.base.errors import ArgumentError
from hexmap.experiments.statistics import Interval

Format = str | Callable[[Any], str]

_MINUS, _NOTHING = "\N{MINUS SIGN}", "–"


def format_number(value: float, spec: str | None = None) -> str:
    """Return a number as it is read.

    Args:
        value: the number; one that is not finite is shown as a dash or as infinity.
        spec: a format specification such as ``".3f"`` or ``".2%"``; four significant digits where none is
            given, and all digits of a whole number.

    Raises:
        ArgumentError: the specification is not one of numbers.

    Examples:
        >>> from hexmap.experiments.report.numbers import format_number
        >>> format_number(88206), format_number(0.016914), format_number(0.016914, ".2%")
        ('88,206', '0.01691', '1.69 %')
    """
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if math.isnan(value):
        return _NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else f"{_MINUS}∞"
    if spec is None:
        return _typeset(_general(value))
    try:
        text = format(float(value) if spec.endswith(("f", "e", "g", "%")) else value, spec)
    except ValueError as error:
        raise ArgumentError(f"{spec!r} is not a format of numbers") from error
    return _typeset(text.replace("%", " %"))


def format_interval(
    interval: Interval, *, percent: bool = False, decimals: int | None = None, unit: str = "", scale: float = 1.0
) -> str:
    """Return a value and its interval, such as ``1.69 % [1.52, 1.83]``.

    Args:
        interval: the interval.
        percent: whether to show it times 100, in per cent.
        decimals: of all three numbers; as many as give half the interval's width two significant digits
            where none are given.
        unit: after the value.
        scale: by which all three are multiplied first.

    Examples:
        >>> from hexmap.experiments import Interval
        >>> from hexmap.experiments.report.numbers import format_interval
        >>> format_interval(Interval(0.0169, 0.01523, 0.01834), percent=True)
        '1.69 % [1.52, 1.83]'
    """
    factor = scale * (100.0 if percent else 1.0)
    numbers = [factor * number for number in (interval.value, interval.low, interval.high)]
    if decimals is None:
        decimals = interval_decimals(numbers)
    value, low, high = (format_number(number, f",.{decimals}f") for number in numbers)
    unit = "%" if percent and not unit else unit
    return f"{value} {unit}".rstrip() + f" [{low}, {high}]"


def interval_decimals(numbers: list[float]) -> int:
    """Return the decimals that give half the width of an interval (value, low, high) two significant digits."""
    finite = [number for number in numbers if math.isfinite(number)]
    half = 0.5 * (max(finite) - min(finite)) if finite else 0.0
    if half > 0.0:
        return min(max(1 - math.floor(math.log10(half)), 0), 9)
    # No width says nothing about the digits.
    return column_decimals(finite) or 0


def _typeset(text: str) -> str:
    """Give a negative number a true minus, and none to what is rounded to zero."""
    if not re.match(r"-[\d.]", text):
        return text
    return (_MINUS if re.search("[1-9]", text.partition("e")[0]) else "") + text[1:]


def _general(value: float) -> str:
    if isinstance(value, int | np.integer):
        return f"{value:,d}"
    decimals = column_decimals([float(value)])
    return f"{value:.3e}" if decimals is None else f"{value:,.{decimals}f}"


def column_decimals(values: Sequence[float]) -> int | None:
    """Return the decimals that suit all of a column, None where no number of them does.

    The largest value gets four significant digits, or the smallest two if that is more; zeros that all
    values would end with are left out.
    """
    sizes = [abs(value) for value in values if value != 0.0]
    if not sizes:
        return 0
    large, small = math.floor(math.log10(max(sizes))), math.floor(math.log10(min(sizes)))
    decimals = max(3 - large, 1 - small, 0)
    if large > 11 or decimals > 9 or large + decimals > 10:
        return None
    while decimals > 0 and all(f"{value:.{decimals}f}".endswith("0") for value in values):
        decimals -= 1
    return decimals


# ---------------------------------------------------------------------- columns


def scalar(value: Any) -> Any:
    """Return a cell as one of Python's own values."""
    return value.item() if isinstance(value, np.generic) else value


def is_number(value: Any) -> bool:
    """Return whether a cell is a number, which a boolean is not."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def column(cells: Sequence[Any], how: Format | None) -> list[str]:
    """Return the cells of a column as they are read."""
    floats = [cell for cell in cells if isinstance(cell, float) and math.isfinite(cell)]
    decimals = column_decimals(floats)
    intervals = [cell for cell in cells if isinstance(cell, Interval)]
    percent = isinstance(how, str) and how.endswith("%")
    fixed = re.fullmatch(r"[,+]?\.(\d+)[f%]", how) if isinstance(how, str) else None
    if fixed:
        ends = int(fixed[1])
    else:
        factor = 100.0 if percent else 1.0
        # One width a column: the decimals of the surest interval would promise too much of the others.
        each = [interval_decimals([factor * i.value, factor * i.low, factor * i.high]) for i in intervals]
        ends = sorted(each)[len(each) // 2] if each else 0
    out = []
    for cell in cells:
        if cell is None:
            text = ""
        elif callable(how):
            text = how(cell)
        elif isinstance(cell, Interval):
            text = format_interval(cell, percent=percent, decimals=ends)
        elif isinstance(cell, bool):
            text = "yes" if cell else "no"
        elif how is not None and is_number(cell):
            text = format_number(cell, how)
        elif isinstance(cell, float) and math.isfinite(cell) and decimals is not None:
            text = format_number(cell, f",.{decimals}f")
        elif is_number(cell):
            text = format_number(cell)
        else:
            text = str(cell)
        out.append(text)
    return out


_LOOKS_NUMERIC = re.compile(r"[-−+]?[\d∞][\d,.]*(e[-+−]?\d+)?(\s?%|\s\w{1,4})?(\s\[.*\])?|–|")


def is_numeric(cells: Sequence[Any], texts: Sequence[str]) -> bool:
    """Return whether a column is one of numbers, which stand on the right."""
    filled = [(cell, text) for cell, text in zip(cells, texts, strict=True) if cell is not None]
    return bool(filled) and all(
        is_number(cell) or isinstance(cell, Interval) or bool(_LOOKS_NUMERIC.fullmatch(text)) for cell, text in filled
    )
