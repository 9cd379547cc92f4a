"""One case of an experiment: its identity, its random numbers, its result and its failure."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from hexmap.base.errors import ArgumentError, HexmapError


class CaseError(HexmapError, RuntimeError):
    """A case of an experiment failed; the text names the case and says why."""


CaseFunction = Callable[[dict[str, Any], np.random.Generator, Mapping[str, Any]], Mapping[str, Any]]


Task = tuple[str, str]  # the key of a case in the journal, and the case as canonical JSON


_TEXT = 200  # characters of a case, or of a message, that a line of an error quotes


def compute(function: CaseFunction, text: str, seed: int, data: Mapping[str, Any]) -> str:
    """Compute one case and return its result as JSON.

    Raises:
        CaseError: the case failed; what it raised is the cause.
        HexmapError: what the case itself raised.
    """
    case: dict[str, Any] = json.loads(text)
    rng = case_generator(case, seed)
    try:
        result = function(case, rng, MappingProxyType(data))
    except HexmapError:
        raise
    except Exception as error:
        raise CaseError(failure(text, error)) from error
    if not isinstance(result, Mapping):
        raise CaseError(f"case {one_line(text)}: the result is not a dictionary but {type(result).__name__}")
    try:
        return json.dumps(dict(result), separators=(",", ":"), default=plain)
    except (TypeError, ValueError, RecursionError) as error:
        reason = one_line(str(error))
        raise CaseError(f"case {one_line(text)}: the result cannot be written as JSON: {reason}") from error


def failure(text: str, error: BaseException) -> str:
    """Return one line on what a case raised."""
    message = one_line(str(error))
    return f"case {one_line(text)}: {type(error).__name__}" + (f": {message}" if message else "")


def plain(value: object) -> object:
    """Return numpy's arrays and numbers as Python's lists and numbers, which JSON has."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not plain data")


def canonical_json(value: object) -> str:
    """Return one text for one content, whatever the order of its keys."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), default=plain)


def digest(text: str) -> str:
    """Return the key of a case in the journal."""
    return hashlib.blake2b(text.encode(), digest_size=20).hexdigest()


def one_line(text: str) -> str:
    """Return a text on one line, cut where it is too long to quote."""
    line = " ".join(text.split())
    return line if len(line) <= _TEXT else line[: _TEXT - 3] + "..."


def case_text(case: Mapping[str, Any], index: int) -> str:
    """Return a case as canonical JSON, or raise ArgumentError with its number."""
    if not isinstance(case, Mapping):
        raise ArgumentError(f"case {index} is not a dictionary: {one_line(repr(case))}")
    try:
        return canonical_json(dict(case))
    except (TypeError, ValueError, RecursionError) as error:
        raise ArgumentError(f"case {index} cannot be written as JSON: {one_line(str(error))}") from error


def case_generator(case: Mapping[str, Any], seed: int = 0) -> np.random.Generator:
    """Return the random numbers that :func:`run_cases` gives to ``case``: of the seed and the case only."""
    words = np.frombuffer(hashlib.sha256(canonical_json(case).encode()).digest(), dtype="<u4")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *(int(word) for word in words)])))


def check_function(function: CaseFunction) -> None:
    """Refuse early, and for one worker too, what a spawned worker could not import."""
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", None)
    found: object = sys.modules.get(module) if isinstance(module, str) else None
    for attribute in str(name).split("."):
        found = getattr(found, attribute, None)
    if name is None or found is not function:
        raise ArgumentError(f"{name or function!r} is not a function of the top level of a module")
