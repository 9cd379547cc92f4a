"""Words for messages: what was read, how many there are, and why something failed."""

from __future__ import annotations

import re

__all__ = ["plural", "printable", "quoted", "reason", "shown", "spreadsheet_text", "whole_number"]

_DATE = re.compile(r"\d{1,4}[/-]\d{1,2}([/-]\d{1,4})?")


def shown(token: bytes | str, length: int = 24) -> str:
    r"""Return a token of a file as it can stand in a message: short and printable, without quotes.

    Examples:
        >>> from hexmap.base.text import shown
        >>> shown(b"range_max"), shown("1.0\x00"), shown("a" * 30, 5)
        ('range_max', '1.0\\x00', 'aaaaa...')
    """
    text = token.decode("utf-8", "replace") if isinstance(token, bytes) else token
    text = text if len(text) <= length else text[:length] + "..."
    return text if text.isprintable() else ascii(text)[1:-1]


def quoted(value: object, length: int = 40) -> str:
    r"""Return a value as Python writes it, in ASCII and short: texts and bytes with quotes, numbers without.

    Examples:
        >>> from hexmap.base.text import quoted
        >>> quoted(b"type tile\r"), quoted(1.5), quoted("a" * 60, 12)
        ("'type tile\\r'", '1.5', "'aaaaaaa...'")
    """
    text = ascii(value.decode("latin-1") if isinstance(value, bytes) else value)
    if len(text) <= length:
        return text
    return text[: length - 4] + "...'" if isinstance(value, (bytes, str)) else text[: length - 3] + "..."


def printable(text: str) -> str:
    r"""Return lines of text for a terminal or a file: what is not printable, as names may hold it, is escaped.

    Names of files may hold any byte: an escape sequence would be obeyed, and what is not UTF-8 cannot be printed.

    Examples:
        >>> from hexmap.base.text import printable
        >>> printable("a\x1b[31m\u2028b\nc")
        'a\\x1b[31m\\u2028b\nc'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def spreadsheet_text(text: str) -> str:
    """Return text for a cell of a CSV file that a spreadsheet shows as it stands.

    What it would run as a formula, as a file's name may be, or take for a date, as 1/2, gets a quote. After a sign only
    a call or a link does anything: "- no list" stays as it is.

    Examples:
        >>> from hexmap.base.text import spreadsheet_text
        >>> [spreadsheet_text(text) for text in ("=1+1", "1/2", "A2-6", "1/2 of it")]
        ["'=1+1", "'1/2", 'A2-6', '1/2 of it']
    """
    runs = text.startswith(("=", "@", "\t", "\r")) or (text.startswith(("+", "-")) and any(c in text for c in "(|!"))
    return "'" + text if runs or _DATE.fullmatch(text) else text


def plural(count: int, noun: str) -> str:
    """Return "1 point", "3 points"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def reason(error: BaseException) -> str:
    """Return why something failed in one line: the system's words, or the first line of the error's text."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    lines = str(error).strip().splitlines()
    return shown(lines[0].rstrip("."), 160) if lines else type(error).__name__


def whole_number(token: bytes | str) -> int | None:
    """Return the whole number of 0 or more that a token is, None for any other token.

    At most 18 digits of ASCII: :func:`int` takes other scripts' digits, signs and underscores, too, and
    takes minutes for a million digits.
    """
    text = token.decode("latin-1") if isinstance(token, bytes) else token
    return int(text) if re.fullmatch(r"[0-9]{1,18}", text) else None
