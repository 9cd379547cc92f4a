"""What the experiment says of each claim: by a rule that the row prints, the same for a win as for a loss."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hexmap.base.arrays import FloatArray
from hexmap.experiments.report.elements import Outcome, Verdict
from hexmap.experiments.report.numbers import format_interval, format_number
from hexmap.experiments.statistics import Interval, bootstrap, mean
from localisation.experiments.comparison import Comparison, sign_test
from localisation.experiments.results import Results, column, is_right
from localisation.experiments.settings import THRESHOLDS, Grid

__all__ = ["equal_words", "interval_of", "judge", "summary", "verdict"]

# A claim about the rival, and by which measures it is judged.
_CLAIMS = (
    ("finds more scans without a start", ("found 0.1 m", "found 0.25 m", "found 1 m")),
    ("finds them more exactly", ("error", "turn")),
    ("tells its right answers from wrong ones better", ("risk",)),
    ("searches fewer nodes", ("nodes",)),
    ("has a score that varies less under rotation", ("score",)),
    ("matches more scans from perturbed starts", ("local ",)),
    ("matches them more exactly", ("local error ",)),
    ("localises more robots without a start, or sooner", ("localised", "until", "false")),
    ("builds maps into which held-out scans fit better", ("overlap",)),
    ("builds truer trajectories", ("trajectory",)),
)
# Shares within which a 95 % ellipse counts as one.
_COVERED = (0.90, 0.99)


def equal_words(equal: str, cell: str) -> str:
    """Say in what lattices are equal; ``cell`` is what their cells are measured by: area or volume."""
    return {"cell": f"at equal cell {cell}", "radius": "at equal covering radius"}[equal]


def judge(results: Results, comparisons: Sequence[Comparison]) -> list[Verdict]:
    """Return a verdict on each claim that the tasks at hand can decide."""
    out: list[Verdict] = []
    rivals = list(dict.fromkeys((c.rival, c.base, c.equal) for c in comparisons))
    cell = results.world.geometry.cell
    for rival, base, equal in rivals:
        mine = [c for c in comparisons if (c.rival, c.equal) == (rival, equal)]
        for claim, keys in _CLAIMS:
            about = [c for c in mine if _belongs(c.measure.key, keys)]
            if about:
                out.append(verdict(f"{rival} {claim} than {base} {equal_words(equal, cell)}", about))
    return [*out, *_against_angle_set(results), *_against_filter(results), *_calibrated(results)]


def _belongs(key: str, keys: tuple[str, ...]) -> bool:
    if any(k.endswith(" ") for k in keys):
        (start,) = keys
        return key.startswith(start) and (start != "local " or not key.startswith("local error "))
    return key in keys


def verdict(claim: str, about: Sequence[Comparison]) -> Verdict:
    """Return what becomes of a claim by the comparisons it is about."""
    won, lost = ([c for c in about if c.outcome == which] for which in ("win", "lose"))
    outcome = _outcome(len(won), len(lost), len(about))
    decided = "; ".join(_words(c) for c in [*won, *lost])
    ties = len(about) - len(won) - len(lost)
    evidence = f"{len(won)} won, {ties} even, {len(lost)} lost of {len(about)} comparisons" + (
        f": {decided}" if decided else ""
    )
    return Verdict(
        claim, _section(about[0]), outcome,
        "holds where every comparison is won, in part where more are won than lost, undecided where as many, else not",
        evidence,
    )  # fmt: skip


def _outcome(won: int, lost: int, compared: int) -> Outcome:
    """Return what becomes of a claim by how many of its comparisons are won and lost."""
    if won == lost:
        return "undecided"
    return "does not hold" if lost > won else "holds" if won == compared else "holds in part"


def _section(c: Comparison) -> str:
    return {
        "global": "Anywhere",
        "local": "Near a start",
        "localise": "Runs",
        "mapping": "Maps",
        "rotation": "Rotation",
    }[c.measure.task]


def _words(c: Comparison) -> str:
    sign = "times" if c.measure.ratio else "difference"
    return f"{c.outcome} at {c.resolution:g} m, {c.measure.label}: {sign} {format_interval(c.interval)}"


def summary(comparisons: Sequence[Comparison], cell: str = "area") -> str:
    """Return what became of all comparisons in a few sentences; ``cell`` is what cells are measured by."""
    text = []
    for rival, base, equal in dict.fromkeys((c.rival, c.base, c.equal) for c in comparisons):
        mine = [c for c in comparisons if (c.rival, c.equal) == (rival, equal)]
        counts = [sum(c.outcome == which for c in mine) for which in ("win", "tie", "lose")]
        text.append(
            f"{rival} against {base} {equal_words(equal, cell)}: {counts[0]} of {len(mine)} comparisons won, "
            f"{counts[1]} even, {counts[2]} lost; {_throughout(mine, 'win', 'won')}, "
            f"{_throughout(mine, 'lose', 'lost')}."
        )
    total = len(comparisons)
    text.append(
        f"Of {total} comparisons at the 5 % level up to {round(0.05 * total)} would be decided by chance alone where "
        "nothing differs, half of them either way, and many are about the same scans: what is decided at every "
        "resolution counts."
    )
    return " ".join(text)


def _throughout(comparisons: Sequence[Comparison], outcome: str, word: str) -> str:
    """Say which measures have an outcome at every resolution, of several."""
    labels = dict.fromkeys(c.measure.label for c in comparisons)
    every = [label for label in labels if all(c.outcome == outcome for c in comparisons if c.measure.label == label)]
    sizes = len({c.resolution for c in comparisons})
    return f"{word}{' at every resolution' if sizes > 1 else ''}: {', '.join(every) or 'nothing'}"


# ---------------------------------------------------------------------- baselines and calibration


def interval_of(values: Sequence[float] | np.ndarray, seed: int) -> Interval:
    """Return the mean of values with its interval, without width where they are all the same or too few."""
    v = np.asarray(values, dtype=np.float64)
    v = v[np.isfinite(v)]
    if len(v) < 4 or float(np.ptp(v)) == 0.0:
        at = float(v.mean()) if len(v) else float("nan")
        return Interval(at, at, at)
    return bootstrap(v, mean, rng=np.random.default_rng([seed, 6]))


def _against_angle_set(results: Results) -> list[Verdict]:
    """Compare all real angles with the fixed set, on every grid, by the strictest threshold."""

    def right(grid: Grid, method: str) -> FloatArray:
        return is_right(results.select(task="global", grid=grid.number, method=method), THRESHOLDS[0]).astype(float)

    return _better_on_every_grid(
        results, right, ("all angles", "angle set"),
        "A search over all real angles finds more scans within 0.1 m and 1° than one over Cartographer's set of "
        "angles", "Anywhere",
    )  # fmt: skip


def _against_filter(results: Results) -> list[Verdict]:
    """Compare the localiser with the particle filter, start by start."""

    def right(grid: Grid, method: str) -> FloatArray:
        rows = results.select(task="localise", grid=grid.number, method=method)
        last = {row["start"]: row for row in rows}.values()
        return np.array([row["answered"] and is_right([row], THRESHOLDS[1])[0] for row in last], float)

    return _better_on_every_grid(
        results, right, ("localiser", "particle filter"),
        "The localiser has localised more robots at the end than the particle filter, within 0.25 m and 2°", "Runs",
    )  # fmt: skip


def _better_on_every_grid(
    results: Results, right: Callable[[Grid, str], FloatArray], methods: tuple[str, str], claim: str, topic: str
) -> list[Verdict]:
    """Compare two methods pair by pair, 1 where ``right`` and else 0; nothing where they were not run."""
    won = lost = 0
    evidence = []
    for grid in results.grids:
        a, b = (right(grid, method) for method in methods)
        if not len(a) or not len(b):
            return []
        p = sign_test(a, b)
        won, lost = won + (p <= 0.05 and a.mean() > b.mean()), lost + (p <= 0.05 and a.mean() < b.mean())
        evidence.append(f"{grid.label} {grid.resolution:g} m {a.mean():.0%} and {b.mean():.0%}")
    return [
        Verdict(
            claim, topic,
            _outcome(won, lost, len(results.grids)),
            "exact sign test on every grid: holds where all have p <= 0.05, in part where more are won than lost, "
            "undecided where as many",
            "; ".join(evidence),
        )
    ]  # fmt: skip


def _calibrated(results: Results) -> list[Verdict]:
    """Tell of every method that reports covariances whether its 95 % ellipses hold about 95 %."""
    out = []
    for task, method in (("global", "all angles"), ("local", "local"), ("localise", "localiser"),
                         ("localise", "particle filter")):  # fmt: skip
        shares = []
        for grid in results.grids:
            rows = results.select(task=task, method=method, grid=grid.number)
            if task == "localise":
                rows = [row for row in rows if row["answered"]]
            within = column([row for row, good in zip(rows, is_right(rows), strict=True) if good], "within")
            within = within[np.isfinite(within)]
            if len(within):
                shares.append((f"{grid.label} {grid.resolution:g} m", float((within <= 0.95).mean()), len(within)))
        if shares:
            good = [_COVERED[0] <= share <= _COVERED[1] for _, share, _ in shares]
            name = method if task == "localise" else f"{task} match"
            out.append(Verdict(
                f"The 95 % ellipses of the {name} hold about 95 % of the errors of right answers", "Calibration",
                "holds" if all(good) else "holds in part" if any(good) else "does not hold",
                f"between {_COVERED[0]:.0%} and {_COVERED[1]:.0%} on every grid; in part on some; errors of the "
                "reference count as errors",
                "; ".join(f"{label} {format_number(share, '.0%')} of {count}" for label, share, count in shares),
            ))  # fmt: skip
    return out
