"""A lattice of one's own on the command line: its generators as rows of numbers, or a file of them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from hexmap.lattice.lattice import Lattice

__all__ = ["Bases", "Basis", "own_lattice", "parse_basis"]

_ROWS = "x,y;x,y or x,y,z;x,y,z;x,y,z"
_HOW = f"its generators, m, as {_ROWS}, or a file with one a line"
_LARGEST = 1 << 16  # bytes of such a file, which has nine numbers and some remarks

Basis = Annotated[
    str | None, typer.Option(metavar="X,Y;X,Y", help=f"A lattice of your own, in place of --lattice: {_HOW}.")
]
Bases = Annotated[
    list[str] | None,
    typer.Option(metavar="X,Y;X,Y", help=f"A lattice of your own, scaled to the others: {_HOW}; again for more."),
]


def own_lattice(lattice: str | None, basis: str | None, resolution: float | None) -> Lattice | None:
    """Return the lattice of ``--basis``, None where it is not given.

    Args:
        lattice: the name that ``--lattice`` gives, which does not go together with a basis.
        basis: what was given.
        resolution: metres that its cells are scaled to; None leaves them as they are.

    Raises:
        BadParameter: a lattice is named as well.
        HexmapError: no basis, or no lattice has it.
    """
    if basis is None:
        return None
    if lattice is not None:
        raise typer.BadParameter(f"give --lattice {lattice} or --basis, not both")
    from hexmap.lattice.convert import as_lattice
    from hexmap.lattice.lattice import Lattice

    return as_lattice(Lattice(parse_basis(basis), "own"), resolution)


def parse_basis(text: str) -> list[list[float]]:
    """Return the basis (columns are generators) of generators written as x,y;x,y, or of a file with one a line.

    In a file the numbers of a line stand between commas or blanks, and what follows a # is a remark.

    Raises:
        ArgumentError: not numbers, or not as many generators as coordinates.
        FormatError: the same of a file; its text names file and line.
        FileAccessError: the file cannot be read.
    """
    from hexmap.base.errors import ArgumentError
    from hexmap.base.text import quoted

    if ";" not in text and _is_file(text):
        return _read_basis(Path(text))
    try:
        rows = [[float(v) for v in row.split(",")] for row in text.split(";")]
    except ValueError:
        rows = []
    if len(rows) not in (2, 3) or any(len(row) != len(rows) for row in rows):
        no_file = "" if ";" in text else ", and no file is called so"
        raise ArgumentError(f"a basis is written as {_ROWS}, not {quoted(text)}{no_file}")
    return [list(column) for column in zip(*rows, strict=True)]


def _is_file(text: str) -> bool:
    try:
        return Path(text).is_file()
    except (OSError, ValueError):  # too long for a name, or with a byte that none has
        return False


def _read_basis(path: Path) -> list[list[float]]:
    """Return the basis (columns are generators) in a file."""
    from hexmap.base.errors import FileAccessError, FormatError
    from hexmap.base.text import quoted, reason

    try:
        with path.open("rb") as handle:
            content = handle.read(_LARGEST + 1)
    except OSError as error:
        raise FileAccessError(f"{path}: cannot be read: {reason(error)}") from error
    if len(content) > _LARGEST:
        raise FormatError(f"{path}: not a basis: more than {_LARGEST:,} bytes")
    rows: list[list[float]] = []
    for number, line in enumerate(content.decode("utf-8", "replace").splitlines(), 1):
        row = []
        for word in line.partition("#")[0].replace(",", " ").split():
            try:
                row.append(float(word))
            except ValueError:
                raise FormatError(f"{path}: line {number}: not a number: {quoted(word)}") from None
        if row and rows and len(row) != len(rows[0]):
            raise FormatError(f"{path}: line {number}: {len(row)} numbers, where {len(rows[0])} stand before")
        if row:
            rows.append(row)
    if len(rows) not in (2, 3) or len(rows[0]) != len(rows):
        found = f"{len(rows)} of {len(rows[0])}" if rows else "none"
        raise FormatError(f"{path}: a basis has 2 lines of 2 numbers or 3 lines of 3, and here are {found}")
    return [list(column) for column in zip(*rows, strict=True)]
