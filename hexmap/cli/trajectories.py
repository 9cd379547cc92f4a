"""Commands around trajectories: evaluate, convert."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from hexmap.cli.build import Associate
from hexmap.cli.console import check_outputs, say, warn, wrote

if TYPE_CHECKING:
    from hexmap.poses.trajectory import Trajectory
    from localisation.evaluation import AbsoluteError, ErrorStatistics, PoseErrors, RelationScore, RelativeError

    _Score: TypeAlias = RelationScore | AbsoluteError | RelativeError

__all__ = ["convert", "evaluate"]


class PoseFormat(StrEnum):
    """Formats of trajectories that are written."""

    tum = "tum"
    kitti = "kitti"


@dataclass(frozen=True, eq=False)
class _Judged:
    """What became of one trajectory; None for what was not asked for or cannot be said."""

    name: str
    relations: RelationScore | None = None
    errors: PoseErrors | None = None
    relative: RelativeError | None = None


def evaluate(
    trajectories: Annotated[
        list[Path],
        typer.Argument(
            metavar="TRAJECTORY...",
            help="The poses to judge (TUM, KITTI or EuRoC), side by side; without --reference and --relations the "
            "first is the reference of the others.",
        ),
    ],
    relations: Annotated[Path | None, typer.Option(help="True relative poses (Kuemmerle 2009).")] = None,
    reference: Annotated[Path | None, typer.Option(help="True poses (TUM, KITTI or EuRoC).")] = None,
    associate: Annotated[Associate, typer.Option(help="How poses go with the reference.")] = Associate.time,
    tolerance: Annotated[float, typer.Option(help="Seconds that associated stamps may differ.")] = 0.1,
    step: Annotated[float, typer.Option(help="Distance of the pairs for the relative error, m.")] = 1.0,
    csv: Annotated[Path | None, typer.Option(help="Where to write the error of each pose (.csv).")] = None,
    json: Annotated[Path | None, typer.Option(help="Where to write all of it (.json).")] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Where to draw the tracks and their errors over time (.png, .svg, .pdf).")
    ] = None,
) -> None:
    """Score trajectories: relations, or absolute error after rigid alignment and relative error."""
    from hexmap.base.errors import ArgumentError
    from hexmap.drawing.map_drawing import check_picture
    from hexmap.io.trajectories import read_relations, read_trajectory

    if relations is None and reference is None:
        if len(trajectories) < 2:
            raise ArgumentError("evaluate takes --relations or --reference, or both, or the reference and then others")
        reference, *trajectories = trajectories
        say(f"reference: {reference}")
    if not (math.isfinite(step) and step > 0.0):
        raise typer.BadParameter(f"--step is a positive number of metres, not {step:g}")
    outputs = {"--csv": csv, "--json": json, "--picture": picture}
    for option in ("--csv", "--picture"):
        if outputs[option] is not None and reference is None:
            raise ArgumentError(f"{option} shows the error of each pose, which takes a --reference")
    check_outputs(outputs, tuple(path for path in (*trajectories, relations, reference) if path is not None))
    if picture is not None:
        check_picture(picture)
    truth = None if reference is None else read_trajectory(reference)
    true_relations = None if relations is None else read_relations(relations)
    judged = [
        _judge(path, name, true_relations, truth, associate.value, tolerance, step)
        for path, name in zip(trajectories, _names(trajectories), strict=True)
    ]
    if len(judged) == 1:
        _say_one(judged[0], step)
    else:
        _say_table(judged, reference, step)
    if csv is not None:
        _write_csv(csv, judged)
        wrote(csv, "the error of each pose")
    if json is not None:
        setting = {"associate": associate.value, "tolerance_s": tolerance, "step_m": step}
        _write_json(json, judged, {"reference": None if reference is None else reference.name, **setting})
        wrote(json, "scores, and the error of each pose" if truth is not None else "scores")
    if picture is not None and truth is not None and reference is not None:
        _draw(picture, judged, truth, reference.name)
        wrote(picture, "tracks, and their errors over time")


def _names(paths: list[Path]) -> list[str]:
    """Return the names of files, with their folders where names alone would be the same."""
    counts = Counter(path.name for path in paths)
    return [path.name if counts[path.name] == 1 else str(path) for path in paths]


def _judge(
    path: Path, name: str, relations: Any, truth: Trajectory | None, associate: Any, tolerance: float, step: float
) -> _Judged:
    """Score one trajectory.

    Raises:
        TrajectoryError: it cannot be read, or nothing of it goes with the truth; the text names the file.
    """
    from hexmap.base.errors import TrajectoryError
    from hexmap.io.trajectories import read_trajectory
    from localisation.evaluation import evaluate_relations, pose_errors, relative_error

    poses = read_trajectory(path)
    score = errors = relative = None
    try:
        if relations is not None:
            score = evaluate_relations(poses, relations, tolerance)
        if truth is not None:
            errors = pose_errors(truth, poses, associate, tolerance)
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}: {error}") from error
    if errors is not None and errors.skipped > len(errors.estimate):
        warn(
            f"{path}: {errors.skipped} poses have no partner within {tolerance:g} s, and only {len(errors.estimate)} "
            "have one; --associate order pairs lists of the same poses, and hexmap build --trajectory-of scans writes "
            "one pose a scan"
        )
    if truth is not None:
        try:
            relative = relative_error(truth, poses, step, "metres", associate, tolerance)
        except TrajectoryError as error:  # what was asked for and is known will be said
            warn(f"no relative error: {path}: {error}")
    return _Judged(name, score, errors, relative)


# ---------------------------------------------------------------------- in the terminal


def _say_one(judged: _Judged, step: float) -> None:
    """Say what became of the only trajectory."""
    score, errors, relative = judged.relations, judged.errors, judged.relative
    if score is not None:
        say(f"relations: {score.used} used, {score.skipped} without poses near enough in time")
        _report("translation", score.translation, "m")
        _report("rotation", score.rotation_deg, "deg")
    if errors is not None:
        ate = errors.summary()
        say(f"absolute error after rigid alignment: {ate.used} poses used, {ate.skipped} left out")
        _report("translation", ate.translation, "m")
        _report("rotation", ate.rotation_deg, "deg")
    if relative is not None:
        say(f"relative error over {step:g} m: {relative.used} pairs")
        _report("translation", relative.translation, "m")
        _report("rotation", relative.rotation_deg, "deg")


def _report(what: str, s: ErrorStatistics, unit: str) -> None:
    say(f"  {what:<12} mean {s.mean:.4f}  rmse {s.rmse:.4f}  median {s.median:.4f}  max {s.max:.4f} {unit}")


def _say_table(judged: list[_Judged], reference: Path | None, step: float) -> None:
    """Say what became of several trajectories, one a line."""
    tables: list[tuple[str, str, Sequence[_Score | None]]] = [
        ("relations", "relations", [row.relations for row in judged]),
        (
            f"absolute error after rigid alignment with {reference}", "poses",
            [None if row.errors is None else row.errors.summary() for row in judged],
        ),
        (f"relative error over {step:g} m", "pairs", [row.relative for row in judged]),
    ]  # fmt: skip
    width = max(len("trajectory"), *(len(row.name) for row in judged))
    for title, unit, scores in tables:
        if all(score is None for score in scores):
            continue
        say(title)
        # Of how much of the reference the errors speak: a track that ends early may look the better one.
        absolute = unit == "poses"
        say(
            f"  {'trajectory':<{width}} {unit:>9} {'left out':>8}   mean m    rmse  median     max   mean deg    rmse  "
            f"median     max{'  time covered' if absolute else ''}"
        )
        for row, score in zip(judged, scores, strict=True):
            if score is None:
                say(f"  {row.name:<{width}} {'-':>9}")
                continue
            t, r = score.translation, score.rotation_deg
            numbers = "".join(f"{v:8.4f}" for v in (t.mean, t.rmse, t.median, t.max))
            turns = "".join(f"{v:8.3f}" for v in (r.mean, r.rmse, r.median, r.max))
            covered = f"{row.errors.covered:14.1%}" if absolute and row.errors is not None else ""
            say(f"  {row.name:<{width}} {score.used:9d} {score.skipped:8d} {numbers}   {turns}{covered}")


# ---------------------------------------------------------------------- in files


def _write_csv(path: Path, judged: list[_Judged]) -> None:
    """Write a row a pose."""
    import csv

    from hexmap.base.atomic_files import atomic_write
    from hexmap.base.text import spreadsheet_text

    with atomic_write(path, "w") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(("trajectory", *_POSE))
        for row in judged:
            for pose in _pose_rows(row.errors):
                writer.writerow((spreadsheet_text(row.name), *map(repr, pose)))


# Of a pose of the estimate: its number and that of its partner, seconds, metres in the frame of the reference, errors.
_POSE = ("pose", "reference_pose", "stamp", "x", "y", "z", "error_m", "error_deg")


def _pose_rows(errors: PoseErrors | None) -> list[tuple[Any, ...]]:
    if errors is None:
        return []
    columns = (errors.estimate, errors.reference, errors.stamps, *errors.positions.T, errors.translation)
    lists: list[list[Any]] = [c.tolist() for c in (*columns, errors.rotation_deg)]
    return list(zip(*lists, strict=True))


def _write_json(path: Path, judged: list[_Judged], about: dict[str, Any]) -> None:
    """Write scores and poses by name."""
    import json

    from hexmap.base.atomic_files import atomic_write

    content = {"kind": "hexmap evaluation", **about, "trajectories": [_as_json(row) for row in judged]}
    with atomic_write(path, "w") as handle:
        handle.write(json.dumps(content, indent=1) + "\n")


def _as_json(row: _Judged) -> dict[str, Any]:
    out: dict[str, Any] = {"file": row.name}
    ate = None if row.errors is None else row.errors.summary()
    scores: tuple[tuple[str, _Score | None], ...]
    scores = ("relations", row.relations), ("absolute", ate), ("relative", row.relative)
    for key, score in scores:
        if score is not None:
            out[key] = {
                "used": score.used, "left_out": score.skipped, "translation_m": _statistics(score.translation),
                "rotation_deg": _statistics(score.rotation_deg),
            }  # fmt: skip
    if row.errors is not None:
        out["time_covered"] = row.errors.covered
        out["T_reference_estimate"] = row.errors.T_reference_estimate.matrix().tolist()
        out["poses"] = [dict(zip(_POSE, pose, strict=True)) for pose in _pose_rows(row.errors)]
    return out


def _statistics(s: ErrorStatistics) -> dict[str, float]:
    return {**asdict(s), "rmse": s.rmse}


def _draw(picture: Path, judged: list[_Judged], truth: Trajectory, name: str) -> None:
    from hexmap.drawing.track_drawing import Track, draw_tracks

    tracks = [
        Track(row.name, row.errors.stamps, row.errors.positions, row.errors.translation, row.errors.reference)
        for row in judged
        if row.errors is not None
    ]
    draw_tracks(picture, truth.positions, tracks, name)


# ---------------------------------------------------------------------- convert


def convert(
    trajectory: Annotated[Path, typer.Argument(help="The poses (TUM, KITTI or EuRoC).")],
    output: Annotated[Path, typer.Option("--output", "-o", help="Where to write them (.tum, .kitti; any with --to).")],
    to: Annotated[
        PoseFormat | None, typer.Option(help="Format that is written.", show_default="the ending of the output")
    ] = None,
    times: Annotated[Path | None, typer.Option(help="The stamps of KITTI's poses, s, a line each.")] = None,
    write_times: Annotated[
        Path | None, typer.Option(help="Where to write the stamps, s, which KITTI's format has no room for.")
    ] = None,
) -> None:
    """Write a trajectory in another format; poses and axes stay as they are."""
    from hexmap.io.trajectories import read_trajectory, trajectory_kind, write_kitti, write_tum

    known = {f".{kind.value}": kind for kind in PoseFormat}
    kind = to or known.get(output.suffix.lower())
    if kind is None:
        raise typer.BadParameter(f"--output: {output}: ends neither in .tum nor in .kitti; --to says which is meant")
    if write_times is not None and kind is not PoseFormat.kitti:
        raise typer.BadParameter("--write-times: poses of TUM have their stamps; it is for --to kitti")
    check_outputs(
        {"--output": output, "--write-times": write_times}, tuple(p for p in (trajectory, times) if p is not None)
    )
    poses = read_trajectory(trajectory, times)
    if kind is PoseFormat.tum:
        write_tum(output, poses)
        counted = trajectory_kind(trajectory) == "KITTI" and times is None
        wrote(output, f"{len(poses)} poses, TUM{'; stamps count the poses, --times takes others' if counted else ''}")
        return
    write_kitti(output, poses, write_times)
    wrote(output, f"{len(poses)} poses, KITTI{'' if write_times else ', without stamps: --write-times keeps them'}")
    if write_times is not None:
        wrote(write_times, "stamps, s, one a line")
