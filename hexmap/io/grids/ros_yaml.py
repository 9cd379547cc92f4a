"""The YAML file of a ROS map: its entries as text, each with the line that it stands in.

Values stay text, as in yaml-cpp, with which map_server reads them: what a number or a boolean is, is for
the reader of an entry to say, not for a schema of YAML (in which "1:30" and "0o17" may be numbers).
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hexmap.base.errors import FormatError
from hexmap.base.text import quoted, reason
from hexmap.base.values import one_line

__all__ = ["Entry", "read_entries"]

_NUMBER = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?")
# 0 and 1 are what map_saver writes; the words are those of yaml-cpp, in any case.
_BOOLEANS = {
    "0": False, "false": False, "no": False, "n": False, "off": False,
    "1": True, "true": True, "yes": True, "y": True, "on": True,
}  # fmt: skip
# The parser takes seconds for more, and a map's file has some hundred bytes.
_MOST_BYTES = 1 << 16
# Quotes begin a text only where a value begins: "it's" has none.
_QUOTED_OR_TAB = re.compile(r"""(?<![^\s\[{,:-])(?:'(?:[^'\n]|'')*'|"(?:[^"\\\n]|\\.)*")|\t""")


@dataclass(frozen=True)
class Entry:
    """A value of the file: a text, a list of texts, or None where it is nested deeper; and its key and line."""

    path: Path
    key: str
    line: int
    value: str | list[str] | None

    __repr__ = one_line

    @property
    def text(self) -> str:
        """The value if it is one text, else an empty one."""
        return self.value if isinstance(self.value, str) else ""

    def number(self) -> float:
        """Return the value as a finite number.

        Raises:
            FormatError: it is none.
        """
        out = _number(self.text)
        if out is None:
            raise self.error(f"{self.key!r} must be a finite number, not {self.shown()}")
        return out

    def numbers(self, count: int, names: str) -> list[float]:
        """Return the value as a list of ``count`` finite numbers, which ``names`` describes in the message.

        Raises:
            FormatError: it is none.
        """
        out = [_number(text) for text in self.value] if isinstance(self.value, list) else []
        found = [value for value in out if value is not None]
        if len(out) != count or len(found) != count:
            raise self.error(f"{self.key!r} must be {names}, not {self.shown()}")
        return found

    def boolean(self) -> bool:
        """Return the value as a truth value.

        Raises:
            FormatError: it is none.
        """
        value = _BOOLEANS.get(self.text.lower())
        if value is None:
            raise self.error(f"{self.key!r} must be 0 or 1, not {self.shown()}")
        return value

    def error(self, text: str) -> FormatError:
        """Return an error that names the file and the line."""
        return FormatError(f"{self.path}, line {self.line}: {text}")

    def shown(self) -> str:
        """Return the value as it stands in a message."""
        if self.value is None:
            return "a nested value"
        return quoted(self.value if isinstance(self.value, str) else f"[{', '.join(self.value)}]")


def _number(text: str) -> float | None:
    value = float(text) if _NUMBER.fullmatch(text) else math.inf
    return value if math.isfinite(value) else None


def read_entries(path: Path, data: bytes, unique: Collection[str] = ()) -> dict[str, Entry]:
    """Return the entries of the first document of a YAML file, in block or in flow style, by their keys.

    Args:
        path: the file, for messages.
        data: its content, UTF-8, or with a byte-order mark UTF-16.
        unique: keys that may not come twice with different values; of others the first counts.

    Raises:
        FormatError: naming the line and what is wrong with it.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.nodes import MappingNode, ScalarNode

    if len(data) > _MOST_BYTES:
        raise FormatError(f"{path}: {len(data)} bytes are too many for the YAML file of a ROS map")
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError as error:
        at = data.count(b"\n", 0, error.start) + 1
        raise FormatError(f"{path}, line {at}: not text (byte {data[error.start]:#04x})") from None
    # In YAML a tab may separate as a space does; the parser takes none outside quotes.
    text = _QUOTED_OR_TAB.sub(lambda found: " " if found[0] == "\t" else found[0], text)
    try:
        # map_server reads the first document, too.
        root = next(iter(YAML(typ="safe", pure=True).compose_all(text)), None)
    except Exception as error:  # beside its own errors the parser has others, of deep nesting for example
        raise _complaint(path, text, error) from error
    if root is None:
        return {}
    if not isinstance(root, MappingNode):
        raise _no_entry(path, text, root.start_mark.line)
    found: dict[str, Entry] = {}
    for key, node in root.value:
        line = key.start_mark.line + 1
        if not isinstance(key, ScalarNode):
            continue  # a list or a mapping is no key of ours
        entry = Entry(path, key.value, line, _value(node))
        first = found.setdefault(key.value, entry)
        if first.value != entry.value and key.value in unique:
            raise FormatError(f"{path}, line {line}: {key.value!r} stands in line {first.line} already")
    return found


def _value(node: Any) -> str | list[str] | None:
    """Return a text or a list of texts of a node, None for what is nested deeper."""
    if isinstance(node.value, str):
        return node.value
    texts = [item.value for item in node.value if node.id == "sequence"]
    flat = node.id == "sequence" and all(isinstance(text, str) for text in texts)
    return texts if flat else None


def _complaint(path: Path, text: str, error: Exception) -> FormatError:
    """Return the parser's error in our words: with the line, and with what stands there."""
    problem = getattr(error, "problem", None)
    begin, mark = getattr(error, "context_mark", None), getattr(error, "problem_mark", None)
    context = getattr(error, "context", None) or ""
    if problem is None or mark is None:
        return FormatError(f"{path}: not YAML: {reason(error)}")
    # Where something was opened and not closed, the parser notices only lines later.
    if begin is not None and "quoted scalar" in context and "end of stream" in problem:
        what = quoted(_line(text, begin.line)[begin.column :])
        return FormatError(f"{path}, line {begin.line + 1}: the quotes of {what} do not match")
    if begin is not None and "flow" in context:
        what = f"the {'list' if 'sequence' in context else 'mapping'} {quoted(_line(text, begin.line)[begin.column :])}"
        return FormatError(f"{path}, line {begin.line + 1}: {what} does not end in this line ({problem})")
    return _no_entry(path, text, begin.line if begin is not None and "simple key" in context else mark.line, problem)


def _no_entry(path: Path, text: str, line: int, problem: str = "") -> FormatError:
    why = f" ({problem})" if problem else ""
    return FormatError(f"{path}, line {line + 1}: not 'key: value': {quoted(_line(text, line))}{why}")


def _line(text: str, number: int) -> str:
    lines = text.splitlines()
    return lines[number] if number < len(lines) else ""
