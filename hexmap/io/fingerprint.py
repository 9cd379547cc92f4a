"""What tells one log from another whatever it is called: a checksum of its content."""

from __future__ import annotations

import hashlib
from pathlib import Path

from hexmap.io.file_kinds import GZIP
from hexmap.io.read_file import CHUNK, GzipError, inflated

__all__ = ["fingerprint"]


def fingerprint(path: Path) -> str | None:
    """Return a checksum of a file, of what is inside gzip, or of all files of a folder; None where none can be read."""
    digest = hashlib.sha256()
    try:
        files = sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]
        if not all(p.is_file() for p in files):
            return None
        for file in files:
            if len(files) > 1:
                digest.update(file.name.encode("utf-8", "surrogateescape") + b"\0")
            with open(file, "rb") as handle:
                packed = GZIP.begins(handle.read(4))
                handle.seek(0)
                pieces = iter(lambda: handle.read(16 * CHUNK), b"")
                for piece in inflated(pieces) if packed else pieces:
                    digest.update(piece)
    except GzipError:
        pass  # all that is sound has been counted
    except (OSError, ValueError):
        return None
    return digest.hexdigest()[:32]
