"""Where the map of ``build`` goes, a file or with --tiles a folder, and the memory until then."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from hexmap.cli.console import check_map_output, check_outputs, progress_line

if TYPE_CHECKING:
    from hexmap.io.map_store import FileStore, FolderStore, StoredMap
    from hexmap.maps.map import Map

__all__ = ["check_map_outputs", "check_tiled", "map_store", "phase", "stored_words", "written"]


def check_map_outputs(output: Path, tiles: float | None, others: dict[str, Path | None], inputs: list[Path]) -> None:
    """Check before the work begins that a map and what else is asked for can be written, and where.

    Args:
        output: the map file, with ``tiles`` the folder.
        tiles: metres.
        others: option name -> path of the other outputs.
        inputs: files that are read.

    Raises:
        BadParameter: the name is not one of a map.
        ArgumentError: ``tiles`` is no positive number.
        FileAccessError: something cannot be written.
    """
    if tiles is None:
        check_outputs({"--output": output, **others}, tuple(inputs))
        check_map_output(output)
        return
    from hexmap.base.errors import FileAccessError
    from hexmap.io.tile_writer import check_folder, check_tiles

    if output.suffix.lower() == ".parquet":
        raise FileAccessError(f"{output}: cannot be written: with --tiles the map is a folder, and this names a file")
    check_tiles(tiles)
    check_folder(output)
    check_outputs(others, tuple(inputs))
    for option, path in others.items():
        if path is not None and path.absolute().parent.resolve() == output.resolve():
            raise FileAccessError(f"{option}: {path} lies in the folder of the map, which holds nothing but its tiles")


def check_tiled(tiles: float | None, several: bool, going_on: bool, grows: bool) -> None:
    """Refuse --tiles where the map must be whole in memory, so that nothing would be gained.

    Args:
        tiles: metres; None: nothing is refused.
        several: whether there are several logs.
        going_on: whether a map goes on.
        grows: whether scans are matched against the map that they are fused into.

    Raises:
        BadParameter: naming the other option.
    """
    if tiles is None:
        return
    for given, option, why in (
        (several, "several logs", "each is found in the map of those before"),
        (going_on, "--continue", "the log is found in the map"),
        (grows, "--no-loop-closure", "scans are matched against the map as it grows"),
    ):
        if given:
            raise typer.BadParameter(
                f"--tiles bounds the memory, and with {option} the map must be whole in it ({why}); write a file and "
                "cut it with hexmap merge --tiles"
            )


@contextmanager
def phase(name: str, fraction: Callable[[], float]) -> Iterator[Callable[[int], None]]:
    """Show a phase of the work, which begins with the memory that the one before has left free."""
    from hexmap.base.memory import return_free_memory

    return_free_memory()
    with progress_line(name, fraction) as update:
        yield update


def map_store(output: Path, tiles: float | None) -> FileStore | FolderStore:
    """Return what takes the map, to be entered before the work."""
    from hexmap.io.map_store import FileStore, FolderStore

    return FileStore(output) if tiles is None else FolderStore(output, tiles)


def written(made: Map | StoredMap, output: Path) -> StoredMap:
    """Return the map as it has been written, having written it where it has not been."""
    from hexmap.io.map_file import save_map
    from hexmap.io.map_store import StoredMap

    if isinstance(made, StoredMap):
        return made
    save_map(output, made)
    return StoredMap(output, made.lattice, len(made.levels), len(made.levels[0].hits))


def stored_words(stored: StoredMap) -> str:
    """Return what a map is that has been written, in words."""
    tiles = f"{stored.tiles:,} tiles, " if stored.tiles is not None else ""
    return f"{tiles}{stored.levels} levels, {stored.hit_cells} cells hit, {stored.lattice.title}"
