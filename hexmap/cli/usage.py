"""How the usage of a command is written: ``hexmap build [OPTIONS] LOG...``."""

from __future__ import annotations

import re
from typing import Any

from typer.core import TyperCommand

__all__ = ["Command"]


class Command(TyperCommand):
    """A command whose usage names arguments in capitals, without braces and second dots as some versions do."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words after the command's name: options, then arguments."""
        return [_plain(piece) for piece in super().collect_usage_pieces(ctx)]


def _plain(piece: str) -> str:
    """Return ``LOG...`` of ``{log...}...``; what may be left out stays in its brackets."""
    found = re.fullmatch(r"\{?([^\[\]{}]+?)(\.\.\.)?\}?(\.\.\.)?", piece)
    return piece if found is None else found[1].upper() + ("..." if found[2] or found[3] else "")
