"""Maps in the formats of others: ROS map_server images, OctoMap, tables of cells (CSV) and points (PLY, PCD).

Each function writes one level of a map, whole files only. What is occupied and free is the map's
own rule, :meth:`hexmap.maps.Map.state`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.atomic_files import PathLike, atomic_write
from hexmap.base.errors import ArgumentError
from hexmap.io.octomap_export import export_octomap
from hexmap.io.ros_map import export_ros, export_ros_band
from hexmap.lattice.keys import unpack
from hexmap.maps.cell_state import CellState
from hexmap.maps.map import Map
from hexmap.maps.state_rule import StateRule
from hexmap.maps.voxel_list import VoxelList

__all__ = ["export", "export_csv", "export_octomap", "export_pcd", "export_ply", "export_ros", "export_ros_band"]


def export(
    map: Map,
    path: PathLike,
    level: int = 0,
    rule: StateRule | None = None,
    *,
    heights: tuple[float, float] | None = None,
    report: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write a level of a map in the format that the suffix of ``path`` names.

    Args:
        map: the map.
        path: ``.yaml`` or ``.yml`` for ROS map_server (with a ``.pgm`` beside it), ``.bt`` for OctoMap, ``.csv`` for
            a table of cells, ``.ply`` or ``.pcd`` for the occupied centres as points.
        level: which level, 0 is the finest.
        rule: what makes a cell occupied or free; the default rule where none is given.
        heights: the lowest and the highest height, metres, of the cells of a map in space that go into a ROS map.
        report: called with a line that says what of the map the format cannot hold, if there is anything.

    Returns:
        The files written.

    Raises:
        ArgumentError: a suffix that is not known, a level that the map does not have, a map in space for ROS without
            heights, heights for another format, or a map in the plane for OctoMap.
        FileAccessError: a file cannot be written.
    """
    formats: dict[str, Callable[[Map, PathLike, int, StateRule | None], list[Path]]] = {
        ".csv": export_csv,
        ".ply": export_ply,
        ".pcd": export_pcd,
    }
    suffix = Path(path).suffix.lower()
    say = report or (lambda _: None)
    if suffix in (".yaml", ".yml"):
        if heights is None:
            return export_ros(map, path, level, rule)
        written, words = export_ros_band(map.state(rule, level), path, heights)
        say(words)
        return written
    if heights is not None:
        raise ArgumentError(f"{path}: a band of heights is for a ROS map (.yaml), not for {suffix or 'this file'}")
    if suffix == ".bt":
        say(export_octomap(map.state(rule, level), path).words())
        return [Path(path)]
    if suffix not in formats:
        known = ", ".join((".yaml", ".yml", ".bt", *formats))
        raise ArgumentError(f"{path}: cannot export to {suffix or 'a file without a suffix'}; known are {known}")
    return formats[suffix](map, path, level, rule)


def export_csv(map: Map, path: PathLike, level: int = 0, rule: StateRule | None = None) -> list[Path]:
    """Write the cells of a level as a table, one line a cell that was hit or passed.

    Columns: ``level,a,b(,c),x,y(,z),hits,passes,state``; x, y, z is the cell's centre in metres, with
    all digits, and state is ``occupied``, ``free`` or ``unknown``.

    Args:
        map: the map.
        path: the file.
        level: which level, 0 is the finest.
        rule: what makes a cell occupied or free.

    Returns:
        The file written.

    Raises:
        ArgumentError: there is no such level.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    states = map.state(rule, level)
    keys, hits, passes = map.level(level).columns()
    lattice = map.level(level).lattice
    index = unpack(keys, lattice.dim)
    # The lists of occupied and free cells are sorted as the keys are: no need to look each cell up.
    state = np.full(len(keys), CellState.UNKNOWN, np.uint8)
    state[np.searchsorted(keys, states.free.keys)] = CellState.FREE
    state[np.searchsorted(keys, states.occupied.keys)] = CellState.OCCUPIED
    names = [known.name.lower() for known in CellState]
    columns: list[list[object]] = [*index.T.tolist(), *lattice.centres(index).T.tolist()]
    columns += [hits.tolist(), passes.tolist(), [names[s] for s in state.tolist()]]
    line = f"{level}," + ",".join(["%s"] * len(columns)) + "\n"
    axes, places = ("a", "b", "c")[: lattice.dim], ("x", "y", "z")[: lattice.dim]
    with atomic_write(path, "w") as handle:
        handle.write(",".join(("level", *axes, *places, "hits", "passes", "state")) + "\n")
        handle.writelines(line % row for row in zip(*columns, strict=True))
    return [path]


def export_ply(map: Map, path: PathLike, level: int = 0, rule: StateRule | None = None) -> list[Path]:
    """Write the centres of the occupied cells of a level as points: binary little-endian PLY.

    Each vertex has ``double x y z`` in metres (z is 0 for a map in the plane) and ``uint hits``, which
    stays at 2^32 - 1 where a cell was hit more often than that.

    Args:
        map: the map.
        path: the file.
        level: which level, 0 is the finest.
        rule: what makes a cell occupied.

    Returns:
        The file written.

    Raises:
        ArgumentError: there is no such level.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    vertices = _points(map.state(rule, level).occupied, "<f8")
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\nproperty uint hits\nend_header\n"
    )
    return _write_points(path, header, vertices)


def export_pcd(map: Map, path: PathLike, level: int = 0, rule: StateRule | None = None) -> list[Path]:
    """Write the centres of the occupied cells of a level as points: binary PCD, as PCL reads it.

    Each point has ``x y z`` (float32, metres; z is 0 for a map in the plane) and ``hits`` (uint32), which
    stays at 2^32 - 1 where a cell was hit more often than that.

    Args:
        map: the map.
        path: the file.
        level: which level, 0 is the finest.
        rule: what makes a cell occupied.

    Returns:
        The file written.

    Raises:
        ArgumentError: there is no such level.
        FileAccessError: the file cannot be written.
    """
    path = Path(path)
    points = _points(map.state(rule, level).occupied, "<f4")
    header = (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z hits\nSIZE 4 4 4 4\nTYPE F F F U\n"
        f"COUNT 1 1 1 1\nWIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\nDATA binary\n"
    )
    return _write_points(path, header, points)


def _points(occupied: VoxelList, real: str) -> NDArray[Any]:
    """Return the centres of cells and their hits as rows x, y, z of the type ``real``, and hits of 32 bits."""
    rows = np.zeros(len(occupied), np.dtype([("x", real), ("y", real), ("z", real), ("hits", "<u4")]))
    for axis, column in zip("xyz", occupied.centres().T, strict=False):
        rows[axis] = column
    rows["hits"] = np.minimum(occupied.counts, 2**32 - 1)
    return rows


def _write_points(path: Path, header: str, rows: NDArray[Any]) -> list[Path]:
    with atomic_write(path) as handle:
        handle.write(header.encode("ascii"))
        handle.write(rows.tobytes())
    return [path]
