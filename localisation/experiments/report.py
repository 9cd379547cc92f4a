"""The report of the localisation experiment: verdicts first, then what they rest on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexmap.experiments.report.elements import Compared
from hexmap.experiments.report.numbers import format_number
from hexmap.experiments.report.report import Report
from localisation.experiments import figures
from localisation.experiments.baselines.particle_filter import FilterSettings
from localisation.experiments.comparison import Comparison, compare_all, risk_area
from localisation.experiments.results import Results, Row, column, confidence, is_right
from localisation.experiments.settings import THRESHOLDS, Grid
from localisation.experiments.space import TILT
from localisation.experiments.verdicts import interval_of, judge, summary
from localisation.experiments.world import NEAR
from localisation.matching.global_matcher import SPREAD_IN_SPACE

__all__ = ["make_report"]

# Ellipses that are looked at: of so many per cent of a normal error.
_ELLIPSES = (50, 90, 95)


def make_report(results: Results, command: str = "") -> Report:
    """Return the report of a run, without anything that differs from run to run."""
    s = results.settings
    comparisons = compare_all(results)
    report = Report(f"Localisation on lattices: {results.world.source}", command, s.table())
    report.heading("Verdicts")
    report.verdicts(judge(results, comparisons))
    if comparisons:
        report.heading("Win, even, lose")
        _add_outcomes(report, comparisons, results.world.geometry.cell)
        report.paragraph(summary(comparisons, results.world.geometry.cell))
    report.heading("What was done")
    report.paragraph(_what_was_done(results))
    report.paragraph(results.world.reference)
    if comparisons:
        _add_comparisons(report, comparisons)
    for task, add in (("global", _add_global), ("local", _add_local), ("localise", _add_runs), ("mapping", _add_maps),
                      ("rotation", _add_rotation), ("learning", _add_learning)):  # fmt: skip
        if results.select(task=task):
            add(report, results)
    _add_calibration(report, results)
    report.heading("What was set, and what that leaves open")
    for text in _limits(results):
        report.paragraph(text)
    return report


def _what_was_done(results: Results) -> str:
    s, world = results.settings, results.world
    by = {"every": f"one scan in {s.hold_out} is held out", "half": "the second half of the log is held out"}[s.split]
    if world.run.any():
        by = "the scans of the other run are held out"
    sizes = ", ".join(f"{r:g}" for r in s.resolutions)
    return (
        f"{len(world.map_scans()):,} scans make the maps and {len(world.test_scans()):,} others are there to look "
        f"for, within {NEAR:g} m of one of the map's: {by}, and no map contains a scan that is looked for in it. "
        f"Lattices at resolutions of {sizes} m: {results.grids[0].name}, and the others with cells of the same "
        f"{world.geometry.cell} and, marked (radius), with the same covering radius, which takes fewer cells. All look "
        f"for the same scans from the same starts, with the lattices turned {_TURNED[world.geometry.dim]} by "
        f"{', '.join(f'{t:g}' for t in s.turns)}° in turn, because walls along the axes of a lattice are a case of "
        f"their own.{_in_space(results)} Times are in a report of their own, in the folder times."
    )


_TURNED = {2: "against the map's frame", 3: "about z against the map's frame"}


def _in_space(results: Results) -> str:
    """Say what else is done in space, and what is not."""
    s = results.settings
    if results.world.geometry.dim == 2:
        return ""
    some = "" if s.points is None else f" At most {s.points:,} points of a scan are taken, at random, for everything."
    return (
        " A resolution is that of the finest level of a map of three levels. A scan is levelled by the floors that it "
        f"sees, searched for with {SPREAD_IN_SPACE} points on the coarsest level, four times as wide, and refined on "
        f"the finest; nodes and margins are those of the search.{some} Left out is what is compared in the plane only: "
        "the particle filter (six degrees of freedom are too many for one that begins anywhere) and whole mapping runs "
        "(the poses of a LiDAR's log come from KISS-ICP before a lattice has a say)."
    )


def _add_outcomes(report: Report, comparisons: Sequence[Comparison], cell: str) -> None:
    """Add the matrix of win, even and lose."""
    columns = list(dict.fromkeys(f"{c.rival} {c.equal} {c.resolution:g} m" for c in comparisons))
    cells: dict[str, dict[str, Compared | None]] = {}
    for c in comparisons:
        line = cells.setdefault(c.measure.label, dict.fromkeys(columns))
        text = format_number(c.interval.value, ".2f" if c.measure.ratio else "+.2f")
        line[f"{c.rival} {c.equal} {c.resolution:g} m"] = Compared(c.outcome, text)
    report.matrix(
        "outcomes", cells, "measure",
        f"Whether a lattice wins or loses against {comparisons[0].base} of the same resolution on the same scans, at "
        f"equal cell {cell} (cell) and at equal covering radius (radius). The number is the ratio or, with a sign, the "
        "difference. Even: the data do not decide it.",
    )  # fmt: skip


def _add_comparisons(report: Report, comparisons: Sequence[Comparison]) -> None:
    """Add all comparisons with their numbers."""
    base = comparisons[0].base
    report.table(
        "comparisons",
        [
            {
                "measure": c.measure.label, "m": c.resolution, "lattice": c.rival, "equal": c.equal,
                "its value": c.there,
                f"{base}'s": c.here, "ratio": c.interval if c.measure.ratio else None,
                "difference": None if c.measure.ratio else c.interval,
                "pairs": c.pairs, "outcome": {"tie": "even"}.get(c.outcome, c.outcome),
            }
            for c in comparisons
        ],
        formats={"ratio": ".3f", "difference": lambda i: f"{i.value:+.3f} [{i.low:+.3f}, {i.high:+.3f}]",
                 "its value": ".3g",
                 f"{base}'s": ".3g", "m": "g"},
        caption="All comparisons: ratio or difference of the paired values with its 95 % bootstrap interval (BCa; of "
        "stretches of the log where neighbouring scans are alike). Decided is what the interval decides and a "
        "permutation test of the pairs too (p <= 0.05). Robots and mapping runs are one pair each.",
    )  # fmt: skip


def _grid_columns(grid: Grid) -> Row:
    return {"m": grid.resolution, "grid": grid.label}


def _share(values: Any, seed: int) -> Any:
    return interval_of(np.asarray(values, dtype=np.float64), seed)


# ---------------------------------------------------------------------- sections


def _add_global(report: Report, results: Results) -> None:
    report.heading("Anywhere: single scans without a start")
    where = "The whole map and all yaws"
    if results.world.geometry.dim == 3:
        where = f"The whole map, all yaws and tilts of up to {np.degrees(TILT):g}°"
    report.paragraph(
        f"{where} are searched with a certificate, which a search may miss only where it stops at "
        f"{results.settings.node_limit:,} nodes. The angle set is that of Cartographer's matcher (the step that moves "
        "the farthest point by a resolution), with the same score, map and search over shifts."
    )
    rows = []
    for grid in results.grids:
        for method in results.methods("global"):
            mine = results.select(task="global", grid=grid.number, method=method)
            right = is_right(mine)
            row = {**_grid_columns(grid), "method": method, **_success_columns(mine, results.settings.seed)}
            row |= {
                "error m": float(np.median(column(mine, "metres")[right])) if right.any() else None,
                "error °": float(np.median(column(mine, "degrees")[right])) if right.any() else None,
                "certified": float(column(mine, "certified").mean()),
                "nodes, median": float(np.median(column(mine, "nodes"))),
                "risk area": float(risk_area(np.stack([right.astype(float), confidence(mine)], axis=1))),
            }
            rows.append(row)
    report.table(
        "global", rows, formats={**_success_formats(), "certified": ".0%", "error m": ".3f", "error °": ".2f",
                                 "risk area": ".3f", "nodes, median": ",.0f", "m": "g"},
        caption="Share of scans found within metres and degrees of the reference, median errors of those found (1 m, "
        "5°), and the area under the risk over the coverage by the certified margin (0: right answers are always the "
        "surest).",
    )  # fmt: skip
    report.figure("success", figures.success_curves(results, "global"),
                  "Share of scans whose pose is within so many metres of the reference, and 5°.")  # fmt: skip
    report.figure(
        "risk", figures.risk_curves(results, "global"),
        "Share of wrong answers (beyond 1 m or 5°) among the surest ones, over the share that is answered.",
    )  # fmt: skip


def _success_columns(rows: Sequence[Row], seed: int) -> Row:
    return {f"{m:g} m, {d:g}°": _share(is_right(rows, (m, d)), seed) for m, d in THRESHOLDS}


def _success_formats() -> dict[str, Any]:
    return {f"{m:g} m, {d:g}°": ".0%" for m, d in THRESHOLDS}


def _add_local(report: Report, results: Results) -> None:
    s = results.settings
    report.heading("Near a start: local matching")
    rows = []
    for grid in results.grids:
        for number, (metres, degrees) in enumerate(s.perturbations):
            mine = results.select(task="local", grid=grid.number, size=number)
            right = is_right(mine)
            rows.append({
                **_grid_columns(grid), "start off by": f"{metres:g} m, {degrees:g}°", **_success_columns(mine, s.seed),
                "error m": float(np.median(column(mine, "metres")[right])) if right.any() else None,
            })  # fmt: skip
    report.table(
        "local", rows, formats={**_success_formats(), "error m": ".3f", "m": "g"},
        caption="Share of scans matched from perturbed starts, " + (
            f"in a window of {s.window[0]:g} m and {s.window[1]:g}° to all sides; starts outside it cannot be mended "
            "and say what chance gives."
            if results.world.geometry.dim == 2
            else "off in a random direction and turned about a random axis: drawn onto the planes of the map's cells, "
            "as a sensor is followed in a known map. There is no window: what is nearer than half a cell of the planes "
            "is found."
        ),
    )  # fmt: skip
    report.figure(
        "local", figures.local_curves(results),
        "Share of scans matched within 0.1 m and 1° by how far off the start was.",
    )  # fmt: skip


def _add_runs(report: Report, results: Results) -> None:
    s = results.settings
    report.heading("Runs: localisation without a start")
    rows = []
    for grid in results.grids:
        for method in results.methods("localise"):
            mine = results.select(task="localise", grid=grid.number, method=method)
            runs = [[row for row in mine if row["start"] == k] for k in dict.fromkeys(row["start"] for row in mine)]
            answered = column(mine, "answered") > 0
            good = is_right(mine, THRESHOLDS[1])
            at_end = [bool(run[-1]["answered"] and is_right(run[-1:], THRESHOLDS[1])[0]) for run in runs]
            first = [
                next(
                    (i + 1 for i, row in enumerate(run) if row["answered"] and is_right([row], THRESHOLDS[1])[0]), None
                )
                for run in runs
            ]
            found = [v for v in first if v is not None]
            rows.append({
                **_grid_columns(grid), "method": method, "runs": len(runs), "right at the end": _share(at_end, s.seed),
                "scans until right, median": float(np.median(found)) if found else None,
                "scans answered": float(answered.mean()),
                "of those within 0.25 m, 2°": float(good[answered].mean()) if answered.any() else None,
                "beyond 1 m or 5°": float((~is_right(mine))[answered].mean()) if answered.any() else None,
                "risk area": float(risk_area(np.stack([is_right(mine).astype(float), confidence(mine)], axis=1))),
            })  # fmt: skip
    report.table(
        "runs", rows, formats={"right at the end": ".0%", "scans answered": ".0%", "of those within 0.25 m, 2°": ".0%",
                               "beyond 1 m or 5°": ".1%", "risk area": ".3f", "m": "g"},
        caption=f"Robots that wake up at {len(rows) and rows[0]['runs']} instants and see up to {s.length} held-out "
        f"scans each. The localiser answers once one place stands out{_filter_answers(results)}. Right at the end: "
        "answered, and within 0.25 m and 2°. Risk area: under the risk over the coverage, all scans taken as answers "
        "in the order of the weight of the best hypothesis or cluster.",
    )  # fmt: skip
    report.figure(
        "risk_runs", figures.risk_curves(results, "localise"),
        "Share of wrong answers (beyond 1 m or 5°) among the surest ones, over the share of all scans of the runs.",
    )  # fmt: skip
    report.figure(
        "runs", figures.run_curves(results), "Share of robots with a right answer (0.25 m, 2°) after so many scans."
    )


def _filter_answers(results: Results) -> str:
    if "particle filter" not in results.methods("localise"):
        return ""
    return "; the filter counts as having answered where one cluster holds 95 % of its weight"


def _add_maps(report: Report, results: Results) -> None:
    s = results.settings
    report.heading("Maps: whole mapping runs")
    rows = []
    for grid in results.grids:
        mine = results.select(task="mapping", grid=grid.number)
        runs = [[row for row in mine if row["run"] == k] for k in dict.fromkeys(row["run"] for row in mine)]
        overlap, metres, degrees = (
            [float(column(run, key).mean()) for run in runs] for key in ("overlap", "metres", "degrees")
        )
        rows.append({
            **_grid_columns(grid), "held-out points on walls": _share(overlap, s.seed), "least": min(overlap),
            "trajectory error m": _share(metres, s.seed), "largest": max(metres),
            "trajectory error °": _share(degrees, s.seed),
        })  # fmt: skip
    words = (
        "the given poses" if results.world.given
        else "the poses that the map maker found with all scans, which is not a truth"
    )  # fmt: skip
    report.table(
        "maps", rows, formats={"held-out points on walls": ".1%", "least": ".1%", "largest": ".3f", "m": "g"},
        caption=f"The log without its held-out scans, mapped on each grid by the map maker, {s.runs} times with the "
        "lattice at another angle: the share of points of held-out scans that meet its walls, and the distance from "
        f"{words}, after one rigid alignment. Means over the runs, and the worst run. Larger cells are met more "
        "often: compare within a resolution.",
    )  # fmt: skip


def _add_rotation(report: Report, results: Results) -> None:
    s = results.settings
    report.heading("Rotation: how steady the score is")
    rows = []
    for grid in results.grids:
        mine = results.select(task="rotation", grid=grid.number)
        rows.append({
            **_grid_columns(grid), "mean score": float(np.nanmean(column(mine, "mean"))),
            "sigma / mu": _share(column(mine, "variability"), s.seed),
        })  # fmt: skip
    report.table(
        "rotation", rows, formats={"mean score": ".3f", "sigma / mu": ".2%", "m": "g"},
        caption="A held-out scan and the scans around it are turned together"
        f"{' about z' if results.world.geometry.dim == 3 else ''} and shifted at random, {s.rotations} times, and the "
        "share of its points that meet a cell of theirs is taken at the true pose. Nothing but the lattice changes.",
    )  # fmt: skip


def _add_learning(report: Report, results: Results) -> None:
    s = results.settings
    report.heading("Learning curves")
    rows = []
    grids = [grid for grid in results.grids if grid.resolution == s.learning_resolution]
    for axis, value in dict.fromkeys((row["axis"], row["value"]) for row in results.select(task="learning")):
        row: Row = {"of": axis, "value": value}
        for grid in grids:
            mine = results.select(task="learning", grid=grid.number, axis=axis, value=value)
            row[grid.label] = _share(is_right(mine), s.seed)
        rows.append(row)
    blocks = {2: "squares", 3: "cubes"}[results.world.geometry.dim]
    report.table(
        "learning", rows, formats={grid.label: ".0%" for grid in grids},
        caption=f"Share of {s.learning_scans} scans found anywhere within 1 m and 5° at {s.learning_resolution:g} m: "
        "with a share of the scans in the map, a share of the beams, points up to a range (m), and after a share of "
        f"the map's walls has gone or moved ({blocks} of a metre, the same on every lattice).",
    )  # fmt: skip
    report.figure("learning", figures.learning_curves(results), "Scans found anywhere (1 m, 5°) as less is known.")


def _add_calibration(report: Report, results: Results) -> None:
    rows = []
    geometry = results.world.geometry
    for task, method in (("global", "all angles"), ("local", "local"), ("localise", "localiser"),
                         ("localise", "particle filter")):  # fmt: skip
        for grid in results.grids:
            mine = results.select(task=task, method=method, grid=grid.number)
            if task == "localise":
                mine = [row for row in mine if row["answered"]]
            right = [row for row, good in zip(mine, is_right(mine), strict=True) if good and row["nes"] is not None]
            nes, within = column(right, "nes"), column(right, "within")
            if not right:
                continue
            rows.append({
                **_grid_columns(grid), "answers of": method, "right answers": len(nes),
                "NES, median": float(np.median(nes)),
                "NES, mean": float(nes.mean()), **{f"{p} %": float((within <= 0.01 * p).mean()) for p in _ELLIPSES},
            })  # fmt: skip
    if rows:
        report.heading("Calibration")
        report.table(
            "calibration", rows,
            formats={**{f"{p} %": ".0%" for p in _ELLIPSES}, "NES, median": ".2f", "NES, mean": ".1f", "m": "g"},
            caption="Errors of right answers (1 m, 5°) squared and normalised by the covariance that came with them: "
            f"of {geometry.freedom} degrees of freedom, {geometry.freedom} on average and "
            f"{geometry.median_squared:.2f} in the median; and how many lie inside the ellipses "
            "of 50, 90 and 95 %. Errors of the reference count as errors here.",
        )  # fmt: skip


def _limits(results: Results) -> list[str]:
    s = results.settings
    out = []
    if s.split == "every" and not results.world.run.any():
        out.append(
            "Held-out scans lie between scans of the map, some decimetres from them: this is easier than to come back "
            "another day (--test takes another run)."
        )
    if results.world.geometry.dim == 2:
        out.append(_of_the_filter())
    out.append(
        "Nothing was tuned to the log. Intervals treat the scans of one log as a sample of what the robot may see in "
        "this place; they say nothing of other places. Runs share one map and may share scans."
    )
    out.append(
        "At equal covering radius a lattice has larger cells: for that alone it may win in nodes and in a steady "
        "score, and lose in precision. What larger cells win by being met more often is not compared."
    )
    return out


def _of_the_filter() -> str:
    """Say what the particle filter was."""
    f = FilterSettings()
    return (
        f"The particle filter is as AMCL's: a likelihood field on the same cells (sigma {f.sigma_hit:g} m, up to "
        f"{f.farthest:g} m, z_hit {f.z_hit:g}, z_rand {f.z_rand:g} over {f.range:g} m, {f.beams} beams that count as "
        f"{f.independent:g} independent ones), KLD-sampling (error {f.error:g}, quantile {f.quantile:g}, bins of "
        f"{f.cell_metres:g} m and {np.degrees(f.cell_radians):g}°, {f.least:,} to {f.most:,} particles), odometry "
        f"noise alpha {', '.join(f'{a:g}' for a in f.alpha)}, updates after {f.step_metres:g} m or "
        f"{np.degrees(f.step_radians):.1f}°, recovery alphas {f.slow:g} and {f.fast:g}, spread over all free cells at "
        "first. AMCL's own sum of third powers and alphas of 0.2 did worse on simulated buildings."
    )
