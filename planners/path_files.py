"""Paths as files: CSV for any spreadsheet and any robot, JSON for programs, GeoJSON for map viewers."""

from __future__ import annotations

import csv
import json
import math
import os
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexmap.base.atomic_files import atomic_write
from hexmap.base.errors import ArgumentError, FileAccessError, FormatError
from hexmap.base.values import one_line

if TYPE_CHECKING:
    from planners.path import Path

__all__ = ["ENDINGS", "PathTable", "check_path_file", "is_path_file", "path_headings", "read_path", "write_path"]

ENDINGS = (".csv", ".json", ".geojson")
_POINT = {2: ("x", "y"), 3: ("x", "y", "z")}
_CELL = {2: ("a", "b"), 3: ("a", "b", "c")}
_ANGLES = {2: ("heading",), 3: ("heading", "pitch")}
_COLUMNS = {n: (*_POINT[n], *_CELL[n], "length", *_ANGLES[n]) for n in (2, 3)}
_FRAME = {
    2: "metres in the frame of the map: x and y, not WGS84 longitude and latitude",
    3: "metres in the frame of the map: x, y and z, not WGS84 longitude, latitude and altitude",
}


@dataclass(frozen=True, eq=False)
class PathTable:
    """What a file says of a path.

    Attributes:
        points: (M, n) float64, metres, in the frame of the map.
        cells: (M, n) int32 index of the cells; None of a GeoJSON, which has none.
        length: (M,) float64 metres from the start to each point along the path.
        heading: (M,) float64 radians, see :func:`path_headings`; NaN where there is none.
        pitch: (M,) float64 radians in space, None in the plane.
    """

    points: NDArray[np.float64]
    cells: NDArray[np.int32] | None
    length: NDArray[np.float64]
    heading: NDArray[np.float64]
    pitch: NDArray[np.float64] | None = None

    __repr__ = one_line


def path_headings(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where a robot looks along a polyline (M, n): (M, 1) its heading in the plane, (M, 2) with pitch in space.

    Radians. The heading is counter-clockwise from x, in (-pi, pi]; the pitch is the climb above the horizon, in
    [-pi/2, pi/2]. Both are those of the leg that leaves the point, at the last point those of the leg that arrives. A
    leg without length turns nothing, and a vertical one has no heading: the one before stays, or the first that there
    is. NaN where the whole path has none.
    """
    n = points.shape[1]
    legs = np.diff(points, axis=0)
    flat = np.hypot(legs[:, 0], legs[:, 1])
    out = np.full((len(points), n - 1), np.nan)
    # Coordinates carry some rounding: what is a billionth of its leg is none.
    whole = np.sqrt((legs**2).sum(axis=1))
    out[:, 0] = _carried(np.arctan2(legs[:, 1], legs[:, 0]), (whole > 0.0) & (flat > 1e-9 * whole), len(points))
    if n == 3:
        out[:, 1] = _carried(np.arctan2(legs[:, 2], flat), whole > 0.0, len(points))
    return out


def _carried(angles: NDArray[np.float64], known: NDArray[np.bool_], count: int) -> NDArray[np.float64]:
    """Return an angle a point (count,) of those of the legs (count - 1,), of which some are known."""
    if not known.any():
        return np.full(count, np.nan)
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    last[last < 0] = int(np.argmax(known))
    at = angles[np.append(last, last[-1])]
    return np.asarray(np.where(at == -math.pi, math.pi, at) + 0.0)  # no -0.0, and one name for due west


def check_path_file(file: str | os.PathLike[str]) -> str:
    """Return the ending of a path's file, in small letters.

    Raises:
        ArgumentError: it is none that a path is written as.
    """
    ending = FilePath(file).suffix.lower()
    if ending not in ENDINGS:
        found = f"as {FilePath(file).suffix}" if ending else "to a file without an ending"
        raise ArgumentError(f"{os.fspath(file)}: a path is written as {', '.join(ENDINGS)}, not {found}")
    return ending

def write_path(file: str | os.PathLike[str], path: Path) -> None:
    """Write a path, as the ending of the file says.

    - ``.csv``: ``x,y,a,b,length,heading`` (``x,y,z,a,b,c,length,heading,pitch`` in space) and a row a point: metres,
      the cell's index in the lattice's basis, the metres so far, and where the robot looks, see :func:`path_headings`.
    - ``.json``: the same by name, with what was measured of the whole path.
    - ``.geojson``: a feature whose LineString (Point, where there is one point) is in metres of the map. Its member
      ``coordinates_are`` says so: RFC 7946 means degrees, which a map without a place on the globe has not.

    Angles are in radians. Numbers are written with all their digits: :func:`read_path` gives the same ones.

    Raises:
        ArgumentError: another ending.
        FileAccessError: the file cannot be written.
    """
    ending = check_path_file(file)
    if ending == ".csv":
        _write_csv(file, path)
        return
    content = _as_json(path) if ending == ".json" else _as_geojson(path)
    with atomic_write(file, "w") as handle:
        handle.write(json.dumps(content, indent=1, allow_nan=False) + "\n")


def _along(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the metres (M,) from the start to each point."""
    legs = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1))
    return np.concatenate([[0.0], np.cumsum(legs)])


def _write_csv(file: str | os.PathLike[str], path: Path) -> None:
    angles = path_headings(path.points)
    rows = zip(
        path.points.tolist(), path.cells.tolist(), _along(path.points).tolist(), angles.tolist(), strict=True
    )  # fmt: skip
    with atomic_write(file, "w") as handle:
        handle.write(",".join(_COLUMNS[path.points.shape[1]]) + "\n")
        for point, cell, metres, looks in rows:
            words = [repr(v) for v in (*point, *cell, metres)] + ["" if math.isnan(v) else repr(v) for v in looks]
            handle.write(",".join(words) + "\n")


def _number(value: float | None) -> float | None:
    """Return a number as JSON can hold it."""
    return None if value is None or not math.isfinite(value) else float(value)


def _measures(path: Path) -> dict[str, Any]:
    """Return what was measured of the whole path."""
    return {
        "length": _number(path.length),
        "cost": _number(path.cost),
        "turning": _number(path.turning),
        "clearance": _number(path.clearance),
        "goal_reached": path.goal_reached,
    }


def _as_json(path: Path) -> dict[str, Any]:
    n = path.points.shape[1]
    looks = path_headings(path.points).tolist()
    points = []
    for point, cell, metres, angles in zip(
        path.points.tolist(), path.cells.tolist(), _along(path.points).tolist(), looks, strict=True
    ):
        row: dict[str, Any] = dict(zip(_POINT[n], point, strict=True))
        row |= {"cell": cell, "length": metres} | dict(zip(_ANGLES[n], map(_number, angles), strict=True))
        points.append(row)
    return {"kind": "hexmap path", "lengths": "metres", "angles": "radians", **_measures(path), "points": points}


def _as_geojson(path: Path) -> dict[str, Any]:
    n = path.points.shape[1]
    positions = path.points.tolist()
    line = len(positions) > 1
    angles = [[_number(v) for v in column] for column in path_headings(path.points).T.tolist()]
    return {
        "type": "Feature",
        "coordinates_are": _FRAME[n],
        "geometry": {
            "type": "LineString" if line else "Point",
            "coordinates": positions if line else positions[0],
        },
        "properties": {"lengths": "metres", "angles": "radians", **_measures(path)}
        | dict(zip(_ANGLES[n], angles, strict=True)),
    }


def is_path_file(file: str | os.PathLike[str]) -> bool:
    """Tell by how a file begins whether it is a path that :func:`write_path` wrote."""
    name = FilePath(file)
    heads = [",".join(columns) for columns in _COLUMNS.values()]
    try:
        with name.open(encoding="utf-8") as handle:
            begin = handle.read(400)
    except (OSError, UnicodeDecodeError):
        return False
    if name.suffix.lower() in (".json", ".geojson"):
        return '"hexmap path"' in begin or '"coordinates_are"' in begin
    return begin.partition("\n")[0].rstrip("\r") in heads


def read_path(file: str | os.PathLike[str]) -> PathTable:
    """Read what :func:`write_path` wrote, as the ending of the file says: ``.json``, ``.geojson``, else CSV.

    Raises:
        FileAccessError: the file cannot be read.
        FormatError: it is no such path; the text names the file, of a CSV also the line.
    """
    name = FilePath(file)
    try:
        text = name.read_text(encoding="utf-8")
    except OSError as error:
        raise FileAccessError(f"{name}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise FormatError(f"{name}: not a path: not text") from error
    ending = name.suffix.lower()
    if ending in (".json", ".geojson"):
        return _read_json(name, text, ending)
    return _read_csv(name, text.splitlines())


def _read_json(name: FilePath, text: str, ending: str) -> PathTable:
    """Return the path of a JSON or GeoJSON file."""
    try:
        content = json.loads(text)
        cells: NDArray[np.int32] | None = None
        if ending == ".json":
            rows = content["points"]
            n = 3 if "z" in rows[0] else 2
            points = np.array([[row[axis] for axis in _POINT[n]] for row in rows], np.float64)
            cells = np.array([row["cell"] for row in rows], np.int32)
            length = np.array([row["length"] for row in rows], np.float64)
            angles = [[row[angle] for row in rows] for angle in _ANGLES[n]]
        else:
            shape = content["geometry"]
            positions = shape["coordinates"]
            points = np.array(positions if shape["type"] == "LineString" else [positions], np.float64)
            n = points.shape[1]
            length = _along(points)
            angles = [content["properties"][angle] for angle in _ANGLES[n]]
        looks = np.array([[math.nan if v is None else v for v in column] for column in angles], np.float64)
        sound = points.shape == (len(length), n) and looks.shape == (n - 1, len(length))
        if not (sound and np.isfinite(points).all() and np.isfinite(length).all()) or (
            cells is not None and cells.shape != points.shape
        ):
            raise ValueError
    except (ValueError, KeyError, IndexError, TypeError, OverflowError) as error:
        raise FormatError(f"{name}: not a path that hexmap wrote as {ending}") from error
    return PathTable(points, cells, length, looks[0], looks[1] if n == 3 else None)


def _read_csv(name: FilePath, lines: list[str]) -> PathTable:
    head = tuple(lines[0].split(",")) if lines else ()
    n = next((k for k in _POINT if head == _COLUMNS[k]), 0)
    if n == 0:
        either = " or ".join(",".join(columns) for columns in _COLUMNS.values())
        raise FormatError(f"{name}, line 1: not a path: the columns must be {either}")
    values = []
    for number, row in enumerate(csv.reader(lines[1:]), start=2):
        try:
            point, cell, metres = [float(v) for v in row[:n]], [int(v) for v in row[n : 2 * n]], float(row[2 * n])
            angles = [float(v) if v else math.nan for v in row[2 * n + 1 :]]
            finite = [*point, metres, *(a for a, v in zip(angles, row[2 * n + 1 :], strict=True) if v)]
            if len(row) != len(head) or not np.isfinite(finite).all() or max(map(abs, cell)) >= 2**31:
                raise ValueError
        except (ValueError, IndexError) as error:
            raise FormatError(
                f"{name}, line {number}: a point takes {len(head)} numbers, not {','.join(row)!r}"
            ) from error
        values.append((point, cell, metres, angles))
    if not values:
        raise FormatError(f"{name}: a path without a point")
    points, cells, length, looks = zip(*values, strict=True)
    turned = np.array(looks, np.float64)
    return PathTable(
        np.array(points, np.float64), np.array(cells, np.int32), np.array(length, np.float64),
        turned[:, 0], turned[:, 1] if n == 3 else None,
    )  # fmt: skip
