"""Options that commands on point clouds share: how to read them, which to keep, which cells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Volume = Annotated[float | None, typer.Option(help="Volume of a cell, m3 (0.001 is a litre).")]
Area = Annotated[float | None, typer.Option(help="Area of a cell, m2.")]
Resolution = Annotated[float | None, typer.Option(help="Side, m, of the square or cube as large as a cell.")]
Format = Annotated[str | None, typer.Option("--format", help="pcd, ply, ptx, text, kitti, npy.", show_default="found")]
ColumnNames = Annotated[
    str | None,
    typer.Option(
        "--columns",
        help="Columns to take as x, y, z: names, or numbers from 0, with commas. Of a .bin also the names of all "
        "numbers of a point, or how many there are.",
        show_default="found",
    ),
]
Offset = Annotated[
    str, typer.Option(help="Metres to take off the points, x,y,z; auto: the first point's, where it is beyond 100 km.")
]
Units = Annotated[str, typer.Option(help="Units of a point file: m, cm, mm or a number of metres.")]
Axes = Annotated[str, typer.Option(help="Axes of a point file as x, y, z: a signed permutation such as x,-z,y.")]
MinRange = Annotated[float, typer.Option(help="Leave out points nearer to the origin, m.")]
MaxRange = Annotated[float | None, typer.Option(help="Leave out points farther from the origin, m.")]
Crop = Annotated[str | None, typer.Option(help="Box to keep, m: x,y,z,x,y,z (two corners; x,y,x,y in the plane).")]
Unique = Annotated[bool, typer.Option(help="Leave out exact duplicates.")]
Sample = Annotated[int | None, typer.Option(help="Keep so many points, drawn at random.")]
Seed = Annotated[int, typer.Option(help="Seed of everything random.")]


@dataclass(frozen=True)
class Reading:
    """How a point file is read, as the options of the commands say it."""

    format: str | None
    units: str
    axes: str
    columns: str | None
    offset: str


def cell_size(resolution: float | None, volume: float | None, area: float | None, dim: int) -> float | None:
    """Return the resolution that was asked for, one way or another; None where it was not.

    Raises:
        ArgumentError: more than one way, an area in space or a volume in the plane, not positive.
    """
    from hexmap.base.errors import ArgumentError

    given = {"--resolution": resolution, "--volume": volume, "--area": area}
    named = [k for k, v in given.items() if v is not None]
    if len(named) > 1:
        raise ArgumentError(f"{' and '.join(named)} say the same thing; give one of them")
    if not named:
        return None
    value = given[named[0]]
    assert value is not None
    if not 0.0 < value < float("inf"):
        raise ArgumentError(f"{named[0]} must be a positive number, not {value}")
    wrong = {"--area": 3, "--volume": 2}.get(named[0])
    if wrong == dim:
        raise ArgumentError(f"{named[0]} does not go with points of dimension {dim}")
    power = {"--resolution": 1.0, "--area": 1.0 / 2.0, "--volume": 1.0 / 3.0}[named[0]]
    # A litre is a cube of 0.1 m, not of 0.10000000000000002 m.
    return float(f"{value**power:.12g}")


def corners(crop: str | None) -> tuple[tuple[float, ...] | None, tuple[float, ...] | None]:
    """Return the two corners of a box.

    Raises:
        ArgumentError: not 4 or 6 numbers.
    """
    from hexmap.base.errors import ArgumentError

    if crop is None:
        return None, None
    try:
        numbers = [float(v) for v in crop.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (4, 6):
        raise ArgumentError(f"a box takes 4 or 6 numbers with commas between them, not {crop!r}")
    half = len(numbers) // 2
    return tuple(numbers[:half]), tuple(numbers[half:])


def offset_of(text: str) -> list[float] | Literal["auto"]:
    """Return an offset that was typed.

    Raises:
        ArgumentError: neither numbers nor "auto".
    """
    from hexmap.base.errors import ArgumentError

    if text.strip().lower() == "auto":
        return "auto"
    try:
        return [float(v) for v in text.split(",")]
    except ValueError:
        raise ArgumentError(f"--offset takes two or three numbers with commas, or auto, not {text!r}") from None


def read_cloud(
    path: Path,
    poses: Path | None,
    *,
    reading: Reading,
    min_range: float,
    max_range: float | None,
    crop: str | None,
    unique: bool,
    sample: int | None,
    seed: int,
    cells: float | None,
) -> tuple[NDArray[np.float64], list[str], list[str]]:
    """Return points (N, n), notes for a report and warnings: of a point file, a log with poses, a LiDAR's log, a map.

    Raises:
        HexmapError: the file cannot be read, or a map's cells are too coarse for ``cells``.
    """
    from hexmap.base.errors import ArgumentError
    from hexmap.io.clouds.filters import PointFilter
    from hexmap.io.clouds.read_points import read_points
    from hexmap.io.file_kinds import is_own_map
    from hexmap.io.lidar.open_lidar import is_lidar_log

    notes: list[str] = []
    warnings: list[str] = []
    low, high = corners(crop)
    filtering = {"min_range": min_range, "max_range": max_range, "unique": unique, "sample": sample, "seed": seed}
    taken_off: tuple[float, ...] = ()
    chosen = PointFilter(low=low, high=high, **filtering)  # type: ignore[arg-type]
    if is_lidar_log(path):
        points, warnings = _of_lidar_log(path, poses)
        at = "that the map maker finds" if poses is None else f"of {poses.name}"
        notes.append(f"The points are those of all scans of {path.name}, from half a metre on, at the poses {at}.")
    elif poses is not None:
        points, warnings = _of_log(path, poses)
        notes.append(f"The points are those of the log {path.name} at the poses of {poses.name}.")
    elif is_own_map(path):
        points, note = _of_map(path, cells, low, high)
        notes.append(note)
    else:
        units, columns = reading.units, reading.columns
        scale = float(units) if units.replace(".", "", 1).isdigit() else units
        file = read_points(
            path, format=reading.format, units=scale, axes=reading.axes, offset=offset_of(reading.offset),
            columns=None if columns is None else columns.split(","),
        )  # fmt: skip
        points, warnings, taken_off = file.points, list(file.warnings), file.offset
    if taken_off:
        # A box is in the coordinates of the file.
        low, high = (c if c is None else tuple(map(float.__sub__, c, taken_off)) for c in (low, high))
        chosen = PointFilter(low=low, high=high, **filtering)  # type: ignore[arg-type]
        notes.append(f"The points are those of the file less {', '.join(f'{v:.10g}' for v in taken_off)} m.")
    kept, report = chosen.apply_counted(points)
    if report.kept != report.given:
        notes.append(f"Filters: {report}.")
    if len(kept) == 0:
        raise ArgumentError(f"{path}: no point is left after the filters ({report})")
    return kept, notes, warnings


def _of_map(
    path: Path, cells: float | None, low: tuple[float, ...] | None, high: tuple[float, ...] | None
) -> tuple[NDArray[np.float64], str]:
    from hexmap.base.errors import ArgumentError
    from hexmap.io.open_map import map_metadata, open_map

    fine = map_metadata(path)["resolution"]
    if cells is None or cells < 10.0 * fine * (1.0 - 1e-9):
        raise ArgumentError(
            f"{path}: the centres of a map's cells pass for points only where the cells asked for are at least ten "
            f"times its own, {10 * fine:g} m, not {cells} m"
        )
    note = (
        f"The points are the centres of the {fine:g} m cells of the map {path.name}, not sensor "
        f"readings: the experiment's cells are {cells / fine:.1f} times as wide."
    )
    boxed = low is not None and len(low) == len(map_metadata(path)["lattice"]["basis"])
    source = open_map(path, low, high) if boxed else open_map(path)
    return source.state().occupied.centres(), note


def _of_log(path: Path, poses: Path) -> tuple[NDArray[np.float64], list[str]]:
    """Return the points of a log at given poses, and what was wrong with the log."""
    import numpy as np

    from hexmap.io.logs.open_log import open_log
    from hexmap.io.trajectories import read_trajectory
    from hexmap.poses.pose import Pose
    from hexmap.poses.scan import Scan
    from localisation.mapping.fuse_log import readings_at_poses

    log = open_log(path)
    chunks = [
        (T_map_robot @ (log.mount or Pose.identity(2))).apply(scan.points)
        for scan, T_map_robot in readings_at_poses(log, read_trajectory(poses))
        if T_map_robot is not None and isinstance(scan, Scan)
    ]
    return np.concatenate(chunks) if chunks else np.empty((0, 2)), list(log.warnings)


def _of_lidar_log(path: Path, poses: Path | None) -> tuple[NDArray[np.float64], list[str]]:
    """Return the points of a LiDAR's log at given poses or those that the map maker finds, and what was wrong."""
    import numpy as np

    from hexmap.io.lidar.open_lidar import open_lidar
    from hexmap.io.trajectories import read_trajectory
    from localisation.experiments.lidar_reading import placed_scans

    log = open_lidar(path)
    given = None if poses is None else read_trajectory(poses)
    chunks = [T_map_sensor.apply(points) for points, T_map_sensor in placed_scans(log, given)]
    return np.concatenate(chunks) if chunks else np.empty((0, 3)), list(log.warnings)
