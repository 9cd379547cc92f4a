"""The pieces of work of the localisation experiment: functions that workers can call.

A case holds its task, the number of a grid (a lattice at a size) and the scans to look for. It returns rows: plain
numbers by name, ``cpu`` among them (seconds of this process), which are kept apart from all others later on.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import numpy as np

from hexmap.base.arrays import FloatArray, IntArray
from hexmap.base.errors import TooLargeError
from hexmap.lattice.lattice import Lattice
from hexmap.maps.voxel_list import VoxelList
from hexmap.poses.pose import Pose
from hexmap.poses.scan import Scan
from localisation.experiments.baselines.angle_set import angular_step
from localisation.experiments.baselines.particle_filter import ParticleFilter
from localisation.experiments.geometry import geometry_of
from localisation.experiments.maps import MapKind, Prepared, nearer_than, prepare, some_of
from localisation.experiments.space import drawn_in_space, found_in_space
from localisation.experiments.world import World, built_poses
from localisation.lidar_settings import LidarSettings
from localisation.localiser.estimate import TrackState
from localisation.localiser.lidar_localiser import LidarLocaliser
from localisation.localiser.localiser import Localiser
from localisation.localiser.settings import LocaliserSettings
from localisation.matching.global_matcher import GlobalMatcher, thin
from localisation.matching.information import score_covariance
from localisation.matching.local_matcher import LocalMatcher
from localisation.matching.match import Match
from localisation.matching.occupancy import Occupancy
from localisation.matching.search_region import SearchWindow
from localisation.settings import MappingSettings

__all__ = ["experiment_case"]

Row: TypeAlias = dict[str, Any]
Shared: TypeAlias = Mapping[str, Any]
# Points and a start to a pose, its covariance, how well it fits and what was looked at.
Near: TypeAlias = Callable[[FloatArray, Pose], tuple[Pose | None, FloatArray | None, float, int]]

# Scans of the map around a scan that make its surroundings in the measurement under rotation.
_AROUND = 8
# Metres: mapping searches on the level of about this resolution, as the map maker does by default, or on the finest.
_SEARCHED = 0.1
# Of a covariance, squared metres or radians: rounding.
_LEAST_VARIANCE = 1e-14


def experiment_case(case: Row, rng: np.random.Generator, shared: Shared) -> Row:
    """Compute one case of any task."""
    task = {
        "global": _global, "local": _local, "localise": _localise, "mapping": _mapping, "rotation": _rotation,
        "learning": _learning,
    }[case["task"]]  # fmt: skip
    return {"rows": task(case, rng, shared)}


def _errors(found: Pose | None, true: Pose, covariance: FloatArray | None) -> Row:
    """Return the columns of an answer: its error, and the error squared and normalised by its covariance.

    Within says of how much of a normal error with that covariance the smallest ellipsoid is that holds the error.
    """
    if found is None:
        return {"metres": None, "degrees": None, "nes": None, "within": None}
    geometry = geometry_of(true.dim)
    off, metres, degrees = geometry.error(found, true)
    nes = None
    # A single particle has no covariance.
    if covariance is not None and float(np.linalg.eigvalsh(covariance)[0]) > _LEAST_VARIANCE:
        nes = float(off @ np.linalg.solve(covariance, off))
    return {"metres": metres, "degrees": degrees, "nes": nes, "within": None if nes is None else geometry.inside(nes)}


# ---------------------------------------------------------------------- single scans


def _global(case: Row, rng: np.random.Generator, shared: Shared) -> list[Row]:
    """Find single scans in the whole map, over all angles and over a fixed set of them."""
    world, prepared = World.of_shared(shared), prepare(MapKind(case["grid"], case["turn"]), shared)
    matcher = prepared.matcher()
    rows = []
    for k in case["scans"]:
        for method in ("all angles", "angle set"):
            row = _found(world.scan(k), world.pose(k), prepared, matcher, method, int(shared["node_limit"]))
            rows.append({"scan": k, "method": method, **row})
    return rows


def _found(
    points: FloatArray, true: Pose, prepared: Prepared, matcher: GlobalMatcher, method: str, node_limit: int
) -> Row:
    begin = time.process_time()
    try:
        if true.dim == 3:
            match = found_in_space(points, prepared, matcher, method, node_limit)
        else:
            angles = "continuous" if method == "all angles" else angular_step(points, matcher.lattice)
            match = matcher.match(points, angles=angles, beams=False, node_limit=node_limit)
    except TooLargeError:
        # Too many angles for a search: this method finds nothing here.
        match = None
    cpu = time.process_time() - begin
    if match is None:
        nothing = {"margin": 0.0, "fraction": 0.0, "certified": True, "nodes": 0}
        return {**_errors(None, true, None), **nothing, "cpu": cpu}
    covariance = None if match.information is None else np.asarray(np.linalg.inv(match.information), np.float64)
    return {
        **_errors(match.pose, true, covariance),
        "margin": match.margin if match.certified else 0.0,
        "fraction": match.fraction,
        "certified": match.certified,
        "nodes": match.nodes,
        "cpu": cpu,
    }


def _local(case: Row, rng: np.random.Generator, shared: Shared) -> list[Row]:
    """Match scans from perturbed starts; the same ones on every grid."""
    world, prepared = World.of_shared(shared), prepare(MapKind(case["grid"], case["turn"]), shared)
    near = _window_matched(prepared, shared) if world.geometry.dim == 2 else _drawn(prepared)
    rows = []
    for k in case["scans"]:
        points, true = world.scan(k), world.pose(k)
        for number, (far, turned) in enumerate(shared["perturbations"]):
            draws = np.random.default_rng([int(shared["seed"]), k, number])
            start = world.geometry.perturbed(true, far, math.radians(turned), draws)
            begin = time.process_time()
            pose, covariance, fraction, nodes = near(points, start)
            cpu = time.process_time() - begin
            rows.append({
                "scan": k, "method": "local", "size": number, **_errors(pose, true, covariance), "fraction": fraction,
                "nodes": nodes, "cpu": cpu,
            })  # fmt: skip
    return rows


def _window_matched(prepared: Prepared, shared: Shared) -> Near:
    """Return how scans of the plane are matched near a start: all poses of a window are looked at."""
    metres, degrees = shared["window"]
    matcher = LocalMatcher(SearchWindow(metres, math.radians(degrees)))

    def near(points: FloatArray, start: Pose) -> tuple[Pose | None, FloatArray | None, float, int]:
        try:
            match = matcher.match(points, start, prepared.pyramid.occupancy)
        except TooLargeError:
            match = None
        if match is None:
            return None, None, 0.0, 0
        return match.pose, _covariance(prepared, points, match), match.fraction, match.nodes

    return near


def _drawn(prepared: Prepared) -> Near:
    """Return how scans of space are matched near a start: drawn onto surfaces."""
    return lambda points, start: (*drawn_in_space(points, start, prepared), 0)


def _covariance(prepared: Prepared, points: FloatArray, match: Match) -> FloatArray:
    """Return the covariance of a local match by the surface of scores around it."""
    kept, weights = thin(points, prepared.lattice)
    return score_covariance(prepared.pyramid, kept, weights, match.searched, refined=match.refined)


def _learning(case: Row, rng: np.random.Generator, shared: Shared) -> list[Row]:
    """Find single scans in a map of fewer scans, with fewer beams, of shorter range, or that has changed since."""
    axis, value = case["axis"], case["value"]
    kind = MapKind(
        case["grid"],
        case["turn"],
        scans=value if axis == "scans" else 1.0,
        farthest=value if axis == "range" else math.inf,
        changed=value if axis == "changed" else 0.0,
    )
    world, prepared = World.of_shared(shared), prepare(kind, shared)
    matcher, node_limit = prepared.matcher(), int(shared["node_limit"])
    rows = []
    for k in case["scans"]:
        points = nearer_than(world.scan(k), kind.farthest)
        if axis == "beams":
            points = points[some_of(np.arange(len(points)), value)]
        rows.append({"scan": k, "method": "all angles", "axis": axis, "value": value,
                     **_found(points, world.pose(k), prepared, matcher, "all angles", node_limit)})  # fmt: skip
    return rows


# ---------------------------------------------------------------------- runs


def _localise(case: Row, rng: np.random.Generator, shared: Shared) -> list[Row]:
    """Wake up somewhere along the log and find out where: the localiser and, in the plane, the particle filter.

    How sure the localiser is: the weight of its best hypothesis, and while it tracks one more than the overlap.
    """
    world, prepared = World.of_shared(shared), prepare(MapKind(case["grid"], case["turn"]), shared)
    first = case["scans"][0]
    mount = world.mount(first)
    localiser = _localiser(prepared, mount, shared)
    particles: ParticleFilter | None = None
    initial = 0.0
    if world.geometry.dim == 2:
        # Of the seed and the start alone: on every grid the filter draws alike.
        draws = np.random.default_rng([int(shared["seed"]), first, 1])
        begin = time.process_time()
        particles = ParticleFilter(prepared.field, draws, mount=mount)
        initial = time.process_time() - begin
    rows: list[Row] = []
    for step, k in enumerate(case["scans"]):
        points, true, odometry = world.scan(k), world.pose(k), world.odometry_pose(k)
        true_robot = true @ mount.inverse()
        row = {"start": first, "step": step, "scan": k}
        begin = time.process_time()
        estimate = localiser.add(Scan(float(step), points, odometry=odometry))
        cpu = time.process_time() - begin
        assert estimate is not None
        best = estimate.hypotheses[0] if estimate.hypotheses else None
        answered = estimate.state is TrackState.tracking
        rows.append({
            **row, "method": "localiser", "answered": answered,
            "confidence": 1.0 + estimate.overlap if answered else best.weight if best else 0.0,
            **_errors(estimate.pose or (best.pose if best else None), true_robot, estimate.covariance), "cpu": cpu,
        })  # fmt: skip
        if particles is None:
            continue
        begin = time.process_time()
        cloud = particles.add(points, odometry)
        cpu = time.process_time() - begin + (initial if step == 0 else 0.0)
        rows.append({
            **row, "method": "particle filter", "answered": cloud.weight >= shared["sure"],
            "confidence": cloud.weight, **_errors(cloud.pose, true_robot, cloud.covariance), "cpu": cpu,
        })  # fmt: skip
    return rows


def _localiser(prepared: Prepared, mount: Pose, shared: Shared) -> Localiser | LidarLocaliser:
    """Return what finds and follows a sensor in a map, of the plane or of space."""
    if prepared.lattice.dim == 2:
        return Localiser(prepared.states, LocaliserSettings(node_limit=int(shared["node_limit"])), mount=mount)
    # Points out of range are gone already.
    return LidarLocaliser(
        prepared.states, LidarSettings(lattice=prepared.lattice.basis.tolist(), min_range=0.0, max_range=None)
    )


def _mapping(case: Row, rng: np.random.Generator, shared: Shared) -> list[Row]:
    """Map the held-in scans by matching them on the grid itself, and see how well held-out scans fit into that map.

    A held-out scan is put where the scan of the map before it is, moved as the reference moved between the two (a scan
    of another run: from the nearest scan of the map), and matched from there; its overlap is what counts. Errors are
    those of the built trajectory at that scan of the map, after one rigid alignment with the reference.
    """
    world = World.of_shared(shared)
    lattice = Lattice(np.array(shared["bases"][case["grid"]][case["turn"]]))
    numbers = world.map_scans()
    level = max(0, round(math.log2(_SEARCHED / shared["sizes"][case["grid"]])))
    settings = MappingSettings(lattice=lattice.basis.tolist(), levels=level + 1, search_level=level)
    begin = time.process_time()
    result, poses = built_poses(world, numbers, settings)
    cpu = time.process_time() - begin
    occupancy = Occupancy.of_map(result.map)
    built = np.flatnonzero(~np.isnan(poses).any(axis=1))
    aligned = _aligned(world, poses, built)
    matcher = LocalMatcher(SearchWindow(*(v if i == 0 else math.radians(v) for i, v in enumerate(shared["window"]))))
    rows: list[Row] = []
    for number, k in enumerate(case["scans"]):
        before = int(built[max(0, int(np.searchsorted(built, k)) - 1)])
        if world.run[k]:
            before = int(built[((world.positions[built] - world.positions[k]) ** 2).sum(axis=1).argmin()])
        at = world.geometry.to_pose(poses[before])
        match = matcher.match(world.scan(k), at @ world.pose(before).inverse() @ world.pose(k), occupancy)
        overlap = 0.0
        if match is not None:
            cells = lattice.quantise(match.pose.apply(world.scan(k)))
            overlap = float(occupancy.contains(cells.astype(np.int64)).mean())
        _, metres, degrees = world.geometry.error(aligned @ at, world.pose(before))
        rows.append({"scan": k, "run": case["turn"], "method": "build", "overlap": overlap, "metres": metres,
                     "degrees": degrees, "cpu": cpu if number == 0 else None})  # fmt: skip
    return rows


def _aligned(world: World, poses: FloatArray, built: IntArray) -> Pose:
    """Return T_reference_built that carries the built trajectory best onto the reference."""
    from hexmap.poses.trajectory import Trajectory
    from localisation.evaluation import absolute_error

    stamps = np.arange(len(built), dtype=np.float64)
    reference, estimate = (
        Trajectory.from_poses(stamps, [world.geometry.to_pose(p[k]) for k in built])
        for p in (world.poses, poses)
    )
    return absolute_error(reference, estimate, "order").T_reference_estimate


# ---------------------------------------------------------------------- rotation


def _rotation(case: Row, rng: np.random.Generator, shared: Shared) -> list[Row]:
    """Turn scans and their surroundings together about z, and measure how much the score at the true pose varies.

    Nothing but the lattice changes under the rotation: what varies is what it does to the score. Each rotation comes
    with a random shift, the same on every grid.
    """
    world = World.of_shared(shared)
    lattice = Lattice(np.array(shared["bases"][case["grid"]][0]))
    mapped = world.map_scans()
    rows: list[Row] = []
    for k in case["scans"]:
        true = world.pose(k)
        near = mapped[np.argsort(((world.positions[mapped] - world.positions[k]) ** 2).sum(axis=1), kind="stable")]
        around = np.concatenate([
            (true.inverse() @ world.pose(m)).apply(world.scan(m)) for m in near[:_AROUND].tolist()
        ])  # fmt: skip
        draws = np.random.default_rng([int(shared["seed"]), k, 2])
        begin = time.process_time()
        scores = []
        for turn in np.arange(shared["rotations"]) * (2.0 * math.pi / shared["rotations"]):
            moved = world.geometry.about_z(float(turn), draws.uniform(-5.0, 5.0, world.geometry.dim))
            cells = VoxelList.from_points(moved.apply(around), lattice)
            scores.append(float(cells.contains(lattice.quantise(moved.apply(world.scan(k)))).mean()))
        cpu = time.process_time() - begin
        mean = float(np.mean(scores))
        rows.append({"scan": k, "method": "score", "mean": mean,
                     "variability": float(np.std(scores)) / mean if mean > 0.0 else None, "cpu": cpu})  # fmt: skip
    return rows
