"""The run in space: a robot drives through the floors of a building, and its LiDAR reports what it sees."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexmap.base.arrays import FloatArray
from hexmap.base.errors import ArgumentError
from hexmap.base.values import one_line
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from hexmap.simulator.space.building import Building3D, Scene, SolidList
from hexmap.simulator.space.drive import Drive3D
from hexmap.simulator.space.ring_lidar import RingLidar

__all__ = ["People", "SimulatedScan", "lidar_poses", "scan_stamps", "simulate_lidar"]

# Streams of random numbers: one for the people, one for each scan.
_PEOPLE, _RAYS = 0, 1
# Intensity is the reflectivity of what was hit, in per cent, as common sensors calibrate it, with some noise.
_INTENSITY_NOISE = 2.0
_BODY_REFLECTIVITY = 0.1


@dataclass(frozen=True)
class People:
    """People who walk to and fro beside the path, upright cylinders.

    Attributes:
        count: how many there are in the building.
        speed: metres a second.
        radius: metres.
        height: metres.
        aside: how far beside the path they walk, metres.
        clear: one whose middle would be this near to the LiDAR has stood aside, out of sight, metres.
        reflectivity: of their clothes, 0 to 1.
    """

    count: int = 0
    speed: float = 1.2
    radius: float = 0.25
    height: float = 1.75
    aside: float = 0.7
    clear: float = 0.6
    reflectivity: float = 0.5

    def __post_init__(self) -> None:
        """Refuse settings out of their range.

        Raises:
            ArgumentError: such a setting.
        """
        if self.count < 0:
            raise ArgumentError(f"the number of people must be zero or more, not {self.count}")
        for name in ("speed", "radius", "height", "clear"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise ArgumentError(f"the {name} of people must be positive, not {value}")
        if self.clear <= self.radius:
            raise ArgumentError(f"people must keep clear by more than their radius {self.radius} m, not {self.clear}")
        if not math.isfinite(self.aside) or not 0.0 <= self.reflectivity <= 1.0:
            raise ArgumentError("the distance of people from the path and their reflectivity (0 to 1) must be finite")


@dataclass(frozen=True, eq=False)
class SimulatedScan:
    """What the LiDAR reports of one sweep, and what is true.

    Attributes:
        scan: the points in the order in which they were measured, each in the LiDAR's frame at the moment it was
            measured. The stamp is the time of the last column, the end of the sweep, and ``scan.times`` lie before it.
        T_map_lidar: the true pose of the LiDAR at the stamp. The map's frame is the building's.
        rings: (N,) uint16 which ring measured each point, the lowest is 0.
        columns: (N,) int64 in which column of the sweep.
        solids: (N,) int64 what was hit: a number of the building's solids, -1 for a person, -2 for the robot itself.
    """

    scan: Scan
    T_map_lidar: Pose
    rings: NDArray[np.uint16]
    columns: NDArray[np.int64]
    solids: NDArray[np.int64]

    __repr__ = one_line


def scan_stamps(
    drive: Drive3D, lidar: RingLidar, duration: float | None = None, scans: int | None = None
) -> FloatArray:
    """Return the stamps (N,) of the scans of a drive, seconds: the ends of the sweeps, the first as soon as it can be.

    Args:
        drive: how long there is something to see.
        lidar: its rate, and how long a sweep takes.
        duration: seconds after which to stop, if that is before the end of the drive.
        scans: how many scans at most.

    Raises:
        ArgumentError: a duration or a number of scans that is not positive, or no time for a single sweep.
    """
    if duration is not None and not (math.isfinite(duration) and duration > 0.0):
        raise ArgumentError(f"the duration of a run must be positive, not {duration}")
    if scans is not None and scans < 1:
        raise ArgumentError(f"a run must have at least one scan, not {scans}")
    seconds = drive.duration if duration is None else min(duration, drive.duration)
    if seconds < lidar.sweep:
        raise ArgumentError(f"a run of {seconds:g} s is shorter than one sweep of {lidar.sweep:g} s")
    # A rounding error must not cost the last scan of a run of whole periods.
    count = math.floor((seconds - lidar.sweep) * lidar.rate + 1e-9) + 1
    return np.arange(count if scans is None else min(count, scans)) / lidar.rate + lidar.sweep


def lidar_poses(drive: Drive3D, lidar: RingLidar, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the true positions (N, 3) and rotations (N, 3, 3) of the LiDAR in the map at ``times`` (N,) seconds."""
    positions, rotations = drive.poses(times)
    mount = lidar.mount
    return positions + _turn(rotations, mount.translation), _compose(rotations, mount.rotation)


def simulate_lidar(
    building: Building3D,
    drive: Drive3D | None = None,
    lidar: RingLidar | None = None,
    seed: int = 0,
    *,
    people: People | None = None,
    duration: float | None = None,
    scans: int | None = None,
) -> Iterator[SimulatedScan]:
    """Drive through a building and yield what the LiDAR reports, sweep by sweep.

    Every column is cast from the pose at its own time, so a robot that moves distorts the sweep as a real one does. The
    same arguments give the same numbers, bit for bit; a shorter run gives the beginning of the longer one, and every
    scan has random numbers of its own, so that none depends on those before it.

    Args:
        building: the solids and the path.
        drive: how the path is driven; at 1.2 m/s by default, swaying as the seed says.
        lidar: settings of the LiDAR.
        seed: of noise, missing returns and people, zero or more.
        people: who walks about; nobody by default.
        duration: seconds after which to stop, if that is before the end of the drive.
        scans: how many scans at most.

    Yields:
        One :class:`SimulatedScan` after the other. Rays without return, for whatever reason, are in ``scan.no_return``.

    Raises:
        ArgumentError: a setting out of its range.

    Examples:
        >>> from hexmap.simulator.space import RingLidar, make_building_3d, simulate_lidar
        >>> building = make_building_3d("warehouse3d", seed=1)
        >>> run = simulate_lidar(building, lidar=RingLidar(rings=16, azimuths=360), scans=3)
        >>> [round(simulated.scan.stamp, 3) for simulated in run]
        [0.1, 0.3, 0.5]
    """
    # Checked here rather than in the generator, so that the caller hears of it at once.
    if seed < 0:
        raise ArgumentError(f"a seed must be zero or more, not {seed}")
    drive, lidar = drive or Drive3D(building.waypoints, seed=seed), lidar or RingLidar()
    stamps = scan_stamps(drive, lidar, duration, scans)
    return _scans(building, drive, lidar, seed, people or People(), stamps)


def _scans(
    building: Building3D, drive: Drive3D, lidar: RingLidar, seed: int, people: People, stamps: FloatArray
) -> Iterator[SimulatedScan]:
    from hexmap.simulator.space._cast_kernels import cast_people

    rays, offsets = lidar.directions, lidar.column_times
    routes = _routes(building, people, np.random.Generator(np.random.PCG64((seed, _PEOPLE))))
    size = np.array([people.radius, people.height])
    body = _body_ranges(lidar)
    for number, stamp in enumerate(stamps.tolist()):
        times = stamp + offsets
        origins, rotations = lidar_poses(drive, lidar, times)
        directions = _turn(rotations[:, None], rays)
        ranges, solids = _cast_columns(building.scene, origins, directions, lidar)
        if people.count > 0:
            places = _places(routes, people, times)
            solids[cast_people(places, size, people.clear, origins, directions, ranges)] = -1
        nearer = body < ranges
        ranges[nearer], solids[nearer] = body[nearer], -2
        rng = np.random.Generator(np.random.PCG64((seed, _RAYS, number)))
        seen = lidar.measure(ranges, rng)
        hit = np.isfinite(seen)
        # The last two entries are what the numbers -2 and -1 mean.
        reflectivity = np.concatenate([building.reflectivity, [_BODY_REFLECTIVITY, people.reflectivity]])[solids]
        noise = _INTENSITY_NOISE * rng.standard_normal(hit.shape)
        intensity: FloatArray = np.clip(np.rint(100.0 * reflectivity + noise), 0.0, 100.0)
        columns, rings = np.nonzero(hit)
        scan = Scan(
            stamp,
            seen[hit][:, None] * rays[hit],
            rays[~hit],
            times=offsets[columns],
            intensity=intensity[hit],
        )
        T_map_lidar = Pose(rotations[-1], origins[-1])
        yield SimulatedScan(scan, T_map_lidar, rings.astype(np.uint16), columns, solids[hit])


def _cast_columns(
    scene: Scene, origins: FloatArray, directions: FloatArray, lidar: RingLidar
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the true ranges (A, H), inf for none, and the solids hit, of columns of rays in the map's frame."""
    from hexmap.simulator.space._cast_kernels import cast_rays

    shape = directions.shape[:2]
    ranges, solids = np.empty(shape), np.empty(shape, dtype=np.int64)
    starts = np.repeat(origins, shape[1], axis=0)
    # A little beyond the maximum range, because noise may bring a return back into it.
    limit = lidar.max_range + 10.0 * lidar.noise
    cast_rays(scene, starts, directions.reshape(-1, 3), limit, ranges.reshape(-1), solids.reshape(-1))
    return ranges, solids


def _body_ranges(lidar: RingLidar) -> FloatArray:
    """Return how far the rays (A, H) go until they meet the robot itself, inf where they do not."""
    rays = lidar.directions
    if not lidar.own_body:
        return np.full(rays.shape[:2], np.inf)
    posts = SolidList()
    for y in (-0.25, 0.25):
        posts.cylinder(-0.4, y, 0.03, -0.8, 0.3)
    body = posts.building("robot", [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    return _cast_columns(body.scene, np.zeros((len(rays), 3)), rays, lidar)[0]


def _routes(building: Building3D, people: People, rng: np.random.Generator) -> FloatArray:
    """Return where each of the people walks to and fro: (P, 2, 3) ends of the way, and of the phase (P, 1, 3).

    They walk beside the longer legs on the flat, away from the corners.
    """
    a, b = building.waypoints[:-1], building.waypoints[1:]
    length = np.linalg.norm(b - a, axis=1)
    legs = np.flatnonzero((a[:, 2] == b[:, 2]) & (length >= 4.0))
    if people.count == 0 or len(legs) == 0:
        return np.empty((0, 3, 3))
    leg = legs[rng.integers(len(legs), size=people.count)]
    along = (b[leg] - a[leg]) / length[leg, None]
    side = np.where(rng.random(people.count) < 0.5, -people.aside, people.aside)
    shift = np.column_stack([-along[:, 1], along[:, 0], np.zeros(people.count)]) * side[:, None]
    start, end = a[leg] + 1.5 * along + shift, b[leg] - 1.5 * along + shift
    phase = np.repeat(rng.random(people.count)[:, None], 3, axis=1)
    return np.stack([start, end, phase], axis=1)


def _places(routes: FloatArray, people: People, times: FloatArray) -> FloatArray:
    """Return where the feet of everyone are at ``times`` (A,), as (A, P, 3)."""
    start, end, phase = routes[:, 0], routes[:, 1], routes[:, 2, 0]
    length = np.linalg.norm(end - start, axis=1)
    turn = (phase + people.speed * times[:, None] / (2.0 * length)) % 1.0
    share = 1.0 - np.abs(1.0 - 2.0 * turn)
    return start + share[..., None] * (end - start)


def _turn(rotations: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return ``vectors`` (..., 3) turned by ``rotations`` (..., 3, 3), written out so that cutting changes no bit."""
    return np.asarray(
        rotations[..., 0] * vectors[..., :1]
        + rotations[..., 1] * vectors[..., 1:2]
        + rotations[..., 2] * vectors[..., 2:]
    )


def _compose(rotations: FloatArray, other: FloatArray) -> FloatArray:
    """Return ``rotations`` (N, 3, 3) times ``other`` (3, 3)."""
    return np.stack([_turn(rotations, np.ascontiguousarray(column)) for column in other.T], axis=-1)
