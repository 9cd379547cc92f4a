"""Logs that are text, a reading a line: reading the lines, plain or out of gzip, and the numbers in them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from hexmap.base.errors import FileAccessError, LogError, TooLargeError
from hexmap.base.text import reason, shown
from hexmap.io.file_kinds import BOM
from hexmap.io.logs.log import Log, LogSettings, file_size
from hexmap.io.read_file import CHUNK, GzipError, cannot_read, inflated, inflation_limit

__all__ = ["BadLine", "TextLog", "floats", "not_a_number", "numbers", "tag_of"]

# Far above any laser's line; a file without line ends must not fill the memory.
_LONGEST_LINE = 1 << 23
_PIECES, _LEAST_PIECE = 256, 1 << 12  # in which a file is read, where these are no larger than a chunk


class BadLine(Exception):
    """A line that is skipped; its text is the reason."""


class TextLog(Log):
    """A log of lines; see :class:`hexmap.io.logs.Log`.

    Attributes:
        lines_read: the number of the last line read so far.
        whole_last_line: False once a last line was met that has no end: some of it may be lost.
    """

    def __init__(self, path: Path, settings: LogSettings, compressed: bool) -> None:
        """Find out how large the file is.

        Raises:
            FileAccessError: the file cannot be read.
        """
        try:
            size = file_size(path)
        except OSError as error:
            raise cannot_read(path, error) from error
        super().__init__(path, settings, size)
        self._compressed = compressed
        self.lines_read = 0
        self.whole_last_line = True

    def lines(self) -> Iterator[tuple[int, bytes]]:
        """Yield (number, line without its end), as far as the file can be read."""
        self.position = 0
        self.lines_read = 0
        self.whole_last_line = True
        rest = b""
        number = 0
        try:
            for text in self._inflated() if self._compressed else self._chunks():
                if number == 0 and not rest:
                    text = text.removeprefix(BOM)
                if not rest and text.isspace():
                    # Nothing but line ends, millions of them perhaps.
                    number += text.count(b"\n")
                    self.lines_read = number
                    rest = text[text.rfind(b"\n") + 1 :]
                    continue
                lines = (rest + text).split(b"\n")
                rest = lines.pop()
                for line in lines:
                    number += 1
                    self.lines_read = number
                    yield number, line
                if len(rest) > _LONGEST_LINE:
                    raise LogError(f"{self.path}, line {number + 1}: longer than {_LONGEST_LINE} bytes")
        except OSError as error:
            raise FileAccessError(f"{self.path}: cannot be read after line {number}: {reason(error)}") from error
        except GzipError as error:
            self._late_notes.append(f"the gzip file is {error}; read up to line {number}, its last whole one")
            return
        if rest.strip():
            self.whole_last_line = False
            self.lines_read = number + 1
            yield number + 1, rest

    def _inflated(self) -> Iterator[bytes]:
        """Yield the text inside a gzip file.

        Raises:
            TooLargeError: it is more than the file's size can account for.
        """
        size, limit = 0, inflation_limit(self.size)
        for text in inflated(self._chunks()):
            size += len(text)
            if size > limit:
                raise TooLargeError(
                    f"{self.path}: {self.size} bytes of gzip hold more than {limit}; "
                    "HEXMAP_MAX_INFLATION raises the limit"
                )
            yield text

    def _chunks(self) -> Iterator[bytes]:
        """Yield the bytes of the file."""
        # Of a small file small pieces: whoever watches sees it move.
        piece = min(CHUNK, max(_LEAST_PIECE, self.size // _PIECES))
        with open(self.path, "rb") as handle:
            while chunk := handle.read(piece):
                self.position += len(chunk)
                yield chunk


def tag_of(line: bytes) -> bytes:
    """Return the first word of a line, if it is short enough to be one of ours."""
    words = line[:12].split(None, 1)
    return words[0] if words else b""


def numbers(tokens: list[bytes]) -> list[float]:
    """Return the numbers that tokens are, infinite and NaN ones too.

    Raises:
        BadLine: one is no number.
    """
    try:
        return list(map(float, tokens))
    except ValueError:
        raise BadLine(f"'{shown(not_a_number(tokens))}' is not a number") from None


def not_a_number(tokens: list[bytes]) -> bytes:
    """Return the first token that is no number; empty where all are."""
    for token in tokens:
        try:
            float(token)
        except ValueError:
            return token
    return b""


def floats(tokens: list[bytes], what: str) -> list[float]:
    """Return the finite numbers that tokens are.

    Raises:
        BadLine: one is no finite number; ``what`` names it.
    """
    values = numbers(tokens)
    for token, value in zip(tokens, values, strict=True):
        if not math.isfinite(value):
            raise BadLine(f"the {what} is '{shown(token)}'")
    return values
