"""Where a map came from, as its sources say it: which logs are in it, and in which frame its coordinates are.

A source may have ``frame``, the identity of the frame in which its log was posed, and ``log_id``, that of the log and
of the laser of it. Both are texts that are equal where the same log was posed in the same way, and say nothing else;
maps of one's own have neither, and nothing is held against them.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any, TypeAlias

from hexmap.base.text import shown

__all__ = ["common_logs", "frames_of", "logs_in_words", "sources_in_frame"]

Sources: TypeAlias = Iterable[dict[str, Any]]


def frames_of(sources: Sources) -> dict[str, str]:
    """Return the identities of a map's frame and the log of each; several where frames were declared one."""
    return {s["frame"]: str(s.get("log", "unknown")) for s in sources if isinstance(s.get("frame"), str)}


def common_logs(a: Sources, b: Sources) -> list[str]:
    """Return the names of the logs that are in both of two maps, by the sources of each."""
    first = {s["log_id"] for s in a if isinstance(s.get("log_id"), str)}
    found = (s for s in b if isinstance(s.get("log_id"), str) and s["log_id"] in first)
    return sorted({str(s.get("log", "unknown")) for s in found})


def logs_in_words(names: Iterable[str]) -> str:
    """Return the names of logs as they stand in a message."""
    return ", ".join(sorted({shown(name, 60) for name in names}))


def sources_in_frame(sources: Sources, frames: Iterable[str], moved: Any = None) -> list[str]:
    """Return the texts of sources whose maps were carried into another frame.

    Args:
        sources: of the map that was moved.
        frames: identities of the frame that it is in now; none where that is not known.
        moved: what to say of how it was moved, by source.
    """
    known = sorted(frames)
    texts = []
    for source in sources:
        kept = {key: value for key, value in source.items() if key != "frame"}
        if known:
            kept["frame"] = known[0]
        if moved is not None:
            kept["moved"] = moved(source)
        texts.append(json.dumps(kept, sort_keys=True))
    return texts
