"""How files of each kind begin: one table for everything that is read, and for what is handed over by mistake."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

__all__ = [
    "BOM",
    "FOREIGN",
    "MANIFEST",
    "MANIFEST_MARK",
    "FileKind",
    "control_byte",
    "find_kind",
    "is_map_folder",
    "is_own_map",
    "is_parquet",
]

MANIFEST = "_manifest.json"  # of a map of ours that is a folder of tiles
MANIFEST_MARK = b'{"hexmap": "map of tiles"'

BOM = b"\xef\xbb\xbf"  # the byte-order mark of UTF-8, which editors of Windows put before a text


@dataclass(frozen=True)
class FileKind:
    """A kind of file.

    Attributes:
        name: with its article, as it stands in a message.
        mark: what the first bytes match.
        advice: what to do to such a file before it can be read, if that does not depend on the reader.
    """

    name: str
    mark: re.Pattern[bytes]
    advice: str = ""

    def begins(self, head: bytes) -> bool:
        """Tell whether the first bytes of a file are those of this kind."""
        return self.mark.match(head, len(BOM) if head.startswith(BOM) else 0) is not None


def _kind(name: str, mark: bytes, advice: str = "") -> FileKind:
    return FileKind(name, re.compile(mark), advice)


# Logs.
ROSBAG1 = _kind("a ROS 1 bag", rb"#ROSBAG V")
MCAP = _kind("an MCAP file", rb"\x89MCAP0\r\n")
SQLITE = _kind("a SQLite file", rb"SQLite format 3\x00")
CARMEN_LOG = _kind("a CARMEN log", rb"(?:[^\n]*\n)*?(?:ODOM|[FR]LASER|(?:ROBOT|RAW)LASER[12])[ \t]")
# Its first reading comes before any reading of a CARMEN log; other lines may stand before it.
WEAN_LOG = _kind(
    "a log of Wean Hall", rb"(?:(?!(?:ODOM|[FR]LASER|(?:ROBOT|RAW)LASER[12])[ \t])[^\n]*\n)*?[OL][ \t]+[-+.]?[0-9]"
)

# Points. A PCD file may begin with comments and blank lines.
NPY = _kind("a NumPy array", rb"\x93NUMPY")
PLY = _kind("a point cloud (PLY)", rb"ply[ \t]*[\r\n]")
PCD = _kind(
    "a point cloud (PCD)",
    rb"(?:[ \t]*(?:#[^\n]*)?\r?\n)*(?:# \.PCD|VERSION[ \t]+\.?[0-9]|(?:FIELDS|COLUMNS)[ \t]+[A-Za-z_])",
)

# Maps, ours and those of others. The marks of MovingAI and Warframe maps and of scenarios are ordinary words, which
# other texts may begin with.
PARQUET = _kind("a Parquet file", rb"PAR1")
FULL_OCTOMAP = _kind("a full OctoMap", rb"# Octomap OcTree file")
OCTOMAP = _kind("an OctoMap", rb"# Octomap")
MOVINGAI = _kind("a MovingAI map", rb"type ")
WARFRAME = _kind("a Warframe map", rb"voxel ")
WEAN_MAP = _kind("a map of Wean Hall", rb"robot_specifications->|global_map\[")
SCENARIO = _kind("a scenario", rb"version ")

# Pictures.
PNG = _kind("a PNG picture", rb"\x89PNG")
PGM = _kind("a PGM or PPM picture", rb"P[2356][\s#]")
BMP = _kind("a BMP picture", rb"(?s:BM.{4}\x00{4})")
JPEG = _kind("a JPEG picture", rb"\xff\xd8\xff")

# Packed files and texts in another encoding.
GZIP = _kind("a gzip file", rb"\x1f\x8b", "decompress it first")
ZIP = _kind("a ZIP or NPZ archive", rb"PK\x03\x04", "unpack it first")
BZIP2 = _kind("a bzip2 file", rb"BZh", "decompress it first")
XZ = _kind("an xz file", rb"\xfd7zXZ", "decompress it first")
ZSTD = _kind("a zstd file", rb"\x28\xb5\x2f\xfd", "decompress it first")
LFS = _kind("a Git LFS pointer", rb"version https://git-lfs", "fetch the file itself")
UTF16 = _kind("text in UTF-16", rb"\xff\xfe|\xfe\xff", "save it as UTF-8")

# Points and meshes in formats that nothing here reads.
LAS = _kind("a LAS file", rb"LASF")
E57 = _kind("an E57 file", rb"ASTM-E57")
GLTF = _kind("a glTF mesh", rb"glTF")
STL = _kind("an STL mesh", rb"solid ")
PDF = _kind("a PDF document", rb"%PDF")

# What people hand over by mistake; each reader takes its own kinds before it looks here.
FOREIGN = (
    ROSBAG1, MCAP, SQLITE, NPY, PLY, PCD, PARQUET, OCTOMAP, PNG, PGM, JPEG,
    ZIP, BZIP2, XZ, ZSTD, LFS, UTF16, LAS, E57, GLTF, STL, PDF,
)  # fmt: skip

_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


def find_kind(head: bytes, among: Iterable[FileKind] = FOREIGN) -> FileKind | None:
    """Return the first of some kinds that a file with these first bytes is of, or None."""
    return next((kind for kind in among if kind.begins(head)), None)


def control_byte(head: bytes) -> int | None:
    """Return the place of the first byte that no text has, or None where all might be text.

    These are the control characters but for tab, newline, vertical tab, form feed, return and escape.
    """
    found = _CONTROL.search(head)
    return found.start() if found else None


def is_parquet(path: Path) -> bool:
    """Tell whether a file begins as Parquet does: then it is a map of ours, or is meant to be one."""
    try:
        # A pipe would wait for ever to be opened, or be read by this alone.
        if not path.is_file():
            return False
        with path.open("rb") as handle:
            return PARQUET.begins(handle.read(4))
    except (OSError, ValueError):  # a ValueError: a path with a null character
        return False


def is_map_folder(path: Path) -> bool:
    """Tell whether a path is a folder with the manifest of a map of ours."""
    try:
        with (path / MANIFEST).open("rb") as handle:
            return handle.read(len(MANIFEST_MARK)) == MANIFEST_MARK
    except (OSError, ValueError):
        return False


def is_own_map(path: Path) -> bool:
    """Tell whether a path is a map of ours, or is meant to be one: a Parquet file, or a folder of tiles."""
    return is_parquet(path) or is_map_folder(path)
