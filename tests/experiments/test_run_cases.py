"""The runner of experiments: same bits for any workers and after any interruption; and the intervals."""

from __future__ import annotations

import json
import math
import mmap
import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import active_children, get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, BoundsError, FileAccessError, FormatError, HexmapError
from hexmap.experiments.case import CaseError, case_generator
from hexmap.experiments.run_cases import run_cases
from hexmap.experiments.statistics import (
    Interval,
    block_length,
    bootstrap,
    bootstrap_ratio,
    cv,
    interquartile_factor,
    mean,
)
from hexmap.maps.metrics import coefficient_of_variation, interquartile_variability
from tests.observing import PATIENCE, children, wait_until

Case = dict[str, Any]
Shared = Mapping[str, Any]


# Cases that a spawned worker can import.


def turn(case: Case, rng: np.random.Generator, shared: Shared) -> dict[str, Any]:
    points = shared["points"]
    assert type(points) is np.ndarray and not points.flags.writeable and points.flags.c_contiguous
    angle = math.radians(case["angle"]) + rng.normal() * shared["jitter"]
    x = points[:, 0] * math.cos(angle) - points[:, 1] * math.sin(angle)
    return {"sum": x.sum(), "mean": np.float32(x.mean()), "cells": np.unique(np.floor(x)), "some": rng.random(3)}


def awkward(case: Case, rng: np.random.Generator, shared: Shared) -> dict[str, Any]:
    values = [0.1 + 0.2, 5e-324, -0.0, 1.7976931348623157e308, math.inf, math.nan, 2**70]
    return {"values": values, "text": "ä\n\u2028\ud800", "none": None, "yes": np.bool_(True)}


def fail(case: Case, rng: np.random.Generator, shared: Shared) -> dict[str, Any]:
    if case["k"] == 3:
        time.sleep(0.2)
        kind = case.get("kind")
        if kind == "hexmap":
            raise BoundsError("the index 9 does not fit")
        if kind == "exit":
            os._exit(7)
        if kind == "sys.exit":
            sys.exit(5)
        if kind == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if kind == "result":
            return {"set": {1, 2}}
        if kind == "list":
            return [1]  # type: ignore[return-value]
        raise ZeroDivisionError("it\nbroke")
    if case["k"] == 60:
        time.sleep(60)
    return {"k": case["k"]}


def mapped(case: Case, rng: np.random.Generator, shared: Shared) -> dict[str, Any]:
    time.sleep(0.1)
    owner: Any = shared["points"]
    while isinstance(owner, np.ndarray):
        owner = owner.base
    return {"pid": os.getpid(), "array": id(shared["points"]), "mapped": isinstance(owner, mmap.mmap)}


def spoil(case: Case, rng: np.random.Generator, shared: Shared) -> dict[str, Any]:
    case["k"] = 99
    shared["points"][0] = 1.0
    return {}


def environment(case: Case, rng: np.random.Generator, shared: Shared) -> dict[str, Any]:
    time.sleep(0.1)
    return {"pid": os.getpid(), "threads": os.environ.get("NUMBA_NUM_THREADS")}


def journals(folder: Path) -> list[Path]:
    return sorted(folder.glob("cases-*.jsonl"))


@pytest.fixture(scope="module")
def shared() -> dict[str, Any]:
    # Large enough to be mapped, and in an order that is not C's.
    return {"points": np.asfortranarray(np.random.default_rng(0).normal(size=(100_000, 2)) * 7), "jitter": 0.25}


CASES = [{"angle": 5 * k, "lattice": "D3"} for k in range(12)]


# ---------------------------------------------------------------------- the same bits


def test_workers_do_not_change_a_bit(shared: dict[str, Any], tmp_path: Path) -> None:
    steps: list[tuple[int, int]] = []
    alone = run_cases(turn, CASES, shared=shared, seed=4)
    both = run_cases(
        turn, CASES, shared=shared, seed=4, workers=2, folder=tmp_path / "a" / "b", progress=lambda *s: steps.append(s)
    )
    assert repr(alone) == repr(both)
    assert steps == [(k, 12) for k in range(13)]
    again = run_cases(turn, CASES, shared=shared, seed=4, folder=tmp_path / "a" / "b", workers=2)
    assert repr(again) == repr(alone)
    assert isinstance(alone[0]["sum"], float) and isinstance(alone[0]["cells"], list)
    assert shared["points"].flags.writeable


def test_a_case_depends_on_itself_and_the_seed_only(shared: dict[str, Any]) -> None:
    first = run_cases(turn, CASES[:4], shared=shared, seed=1)
    other = run_cases(turn, [{"lattice": "D3", "angle": 15}, *CASES[2::-1], CASES[1]], shared=shared, seed=1)
    assert other == [first[3], first[2], first[1], first[0], first[1]]
    assert other[2] is not other[4]
    assert run_cases(turn, CASES[:1], shared=shared, seed=2) != first[:1]
    a, b = case_generator({"x": 1, "y": np.float64(2)}, 3), case_generator({"y": 2.0, "x": 1}, 3)
    assert a.random() == b.random()
    draws = {case_generator({"k": k}, seed).random() for k in range(20) for seed in range(5)}
    assert len(draws) == 100


def test_the_numbers_of_a_case_stay_what_they_are() -> None:
    """A change here makes every published result another one."""
    assert case_generator({"angle": 5}, 0).integers(0, 1000, 4).tolist() == [131, 736, 15, 307]


def test_results_survive_the_journal_exactly(tmp_path: Path) -> None:
    computed = run_cases(awkward, [{}], folder=tmp_path)
    kept = run_cases(awkward, [{}], folder=tmp_path)
    assert repr(computed) == repr(kept) == repr(run_cases(awkward, [{}]))
    assert kept[0]["values"][:2] == [0.1 + 0.2, 5e-324] and math.copysign(1, kept[0]["values"][2]) == -1
    assert kept[0]["yes"] is True


def test_workers_are_single_threaded_processes() -> None:
    before = dict(os.environ)
    out = run_cases(environment, [{"k": k} for k in range(4)], workers=2)
    assert len({o["pid"] for o in out}) == 2 and os.getpid() not in {o["pid"] for o in out}
    assert {o["threads"] for o in out} == {"1"}
    assert dict(os.environ) == before
    # Neither running nor a zombie; the process that stays is Python's own, for shared resources.
    assert not {o["pid"] for o in out} & (children(os.getpid()) | {c.pid for c in active_children()})


def test_large_shared_data_is_mapped_once_by_each_worker(shared: dict[str, Any]) -> None:
    out = run_cases(mapped, [{"k": k} for k in range(6)], shared=shared, workers=2)
    assert all(o["mapped"] for o in out)
    assert len({o["pid"] for o in out}) == 2 == len({(o["pid"], o["array"]) for o in out})


# ---------------------------------------------------------------------- any executor


class Inline:
    """The least that an executor is: computes at once, and remembers what it was sent."""

    def __init__(self) -> None:
        self.sent: list[int] = []
        self.closed = False

    def submit(self, function: Callable[..., str], /, *args: Any) -> Future[str]:
        self.sent.append(len(pickle.dumps((function, args))))
        future: Future[str] = Future()
        try:
            future.set_result(function(*args))
        except Exception as error:
            future.set_exception(error)
        return future

    def shutdown(self, wait: bool = True) -> None:
        self.closed = True


def test_any_executor_gives_the_same_bits(shared: dict[str, Any], tmp_path: Path) -> None:
    alone = run_cases(turn, CASES, shared=shared, seed=4)
    inline = Inline()
    with ThreadPoolExecutor(2) as threads, ProcessPoolExecutor(2, get_context("spawn")) as processes:
        executors: list[Any] = [inline, threads, processes]
        for i, executor in enumerate(executors):
            steps: list[tuple[int, int]] = []
            folder = tmp_path / str(i)
            found = run_cases(
                turn, CASES, shared=shared, seed=4, executor=executor, folder=folder,
                progress=lambda *s, steps=steps: steps.append(s),
            )  # fmt: skip
            assert repr(found) == repr(alone)
            assert steps == [(k, 12) for k in range(13)]
            assert list(folder.iterdir()) == journals(folder)
            # It is not shut down, and serves again; what the journal has is not computed again.
            assert run_cases(turn, CASES[:3], shared=shared, executor=executor) == run_cases(
                turn, CASES[:3], shared=shared
            )
            assert run_cases(turn, CASES, shared=shared, seed=4, executor=executor, folder=folder) == alone
    assert len(inline.sent) == 15 and max(inline.sent) < 500 and not inline.closed


def test_what_fails_on_any_executor_is_named(tmp_path: Path) -> None:
    cases = [{"k": k} for k in (0, 1, 2, 3)]
    inline: Any = Inline()
    with pytest.raises(CaseError, match=r'^case {"k":3}: ZeroDivisionError: it broke$'):
        run_cases(fail, cases, executor=inline, folder=tmp_path)
    (journal,) = journals(tmp_path)
    assert len(journal.read_text().splitlines()) == 4
    with pytest.raises(BoundsError, match=r"^the index 9 does not fit$"):
        run_cases(fail, [{"k": 3, "kind": "hexmap"}], executor=inline)
    with (
        ProcessPoolExecutor(1, get_context("spawn")) as processes,
        pytest.raises(CaseError, match="the executor broke: A process in the process pool"),
    ):
        run_cases(fail, [{"k": 3, "kind": "exit"}], executor=processes)


# ---------------------------------------------------------------------- the journal


def test_only_what_is_missing_is_computed(shared: dict[str, Any], tmp_path: Path) -> None:
    run_cases(turn, CASES[:5], shared=shared, folder=tmp_path)
    steps: list[tuple[int, int]] = []
    run_cases(turn, CASES[:8], shared=shared, folder=tmp_path, progress=lambda *s: steps.append(s))
    assert steps == [(5, 8), (6, 8), (7, 8), (8, 8)]
    run_cases(turn, CASES[:8], shared=shared, folder=tmp_path, seed=1, progress=lambda *s: steps.append(s))
    assert steps[4] == (0, 8)
    assert len(journals(tmp_path)) == 1


@pytest.mark.parametrize("torn", [1, 20, 100])
def test_a_torn_last_line_is_computed_again(shared: dict[str, Any], tmp_path: Path, torn: int) -> None:
    whole = run_cases(turn, CASES[:5], shared=shared, folder=tmp_path)
    (journal,) = journals(tmp_path)
    content = journal.read_bytes()
    journal.write_bytes(content[:-torn])
    steps: list[tuple[int, int]] = []
    assert whole == run_cases(turn, CASES[:5], shared=shared, folder=tmp_path, progress=lambda *s: steps.append(s))
    assert steps == [(4, 5), (5, 5)]
    assert journal.read_bytes() == content


def test_a_journal_torn_in_its_first_line_begins_anew(tmp_path: Path) -> None:
    run_cases(awkward, [{}], folder=tmp_path)
    (journal,) = journals(tmp_path)
    content = journal.read_bytes()
    journal.write_bytes(content[:30])
    run_cases(awkward, [{}], folder=tmp_path)
    assert journal.read_bytes() == content


def test_a_damaged_line_costs_its_case_only(tmp_path: Path) -> None:
    cases = [{"k": k} for k in range(3)]
    whole = run_cases(fail, cases, folder=tmp_path)
    (journal,) = journals(tmp_path)
    lines = journal.read_bytes().splitlines(keepends=True)
    lines[2] = b"\0" * 40 + b"\n"
    journal.write_bytes(b"".join(lines))
    steps: list[tuple[int, int]] = []
    assert run_cases(fail, cases, folder=tmp_path, progress=lambda *s: steps.append(s)) == whole
    assert steps == [(2, 3), (3, 3)]


def test_the_journal_of_other_data_is_left_alone(shared: dict[str, Any], tmp_path: Path) -> None:
    first = run_cases(turn, CASES[:2], shared=shared, folder=tmp_path)
    moved = {**shared, "points": shared["points"] + 1e-9}
    second = run_cases(turn, CASES[:2], shared=moved, folder=tmp_path)
    assert second == run_cases(turn, CASES[:2], shared=moved) != first
    run_cases(turn, CASES[:2], shared=shared, folder=tmp_path, fingerprint="another rule")
    run_cases(awkward, CASES[:2], folder=tmp_path)
    assert len(journals(tmp_path)) == 4
    steps: list[tuple[int, int]] = []
    assert run_cases(turn, CASES[:2], shared=shared, folder=tmp_path, progress=lambda *s: steps.append(s)) == first
    assert steps == [(2, 2)]


def test_a_foreign_file_is_refused(tmp_path: Path) -> None:
    run_cases(awkward, [{}], folder=tmp_path)
    (journal,) = journals(tmp_path)
    journal.write_text('{"something": "else"}\n')
    with pytest.raises(FormatError, match="move it away"):
        run_cases(awkward, [{}], folder=tmp_path)
    assert journal.read_text() == '{"something": "else"}\n'


def test_a_folder_that_cannot_be_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FileAccessError, match="cannot be written"):
        run_cases(awkward, [{}], folder=tmp_path / "file")


def test_two_runs_do_not_share_a_journal(tmp_path: Path) -> None:
    pytest.importorskip("fcntl")

    def second(done: int, total: int) -> None:
        run_cases(awkward, [{}], folder=tmp_path)

    with pytest.raises(FileAccessError, match="another run"):
        run_cases(awkward, [{}], folder=tmp_path, progress=second)
    run_cases(awkward, [{}], folder=tmp_path)


# ---------------------------------------------------------------------- what fails


@pytest.mark.parametrize("workers", [1, 2])
def test_a_failing_case_is_named_and_the_others_are_kept(tmp_path: Path, workers: int) -> None:
    cases = [{"k": k} for k in (0, 1, 2, 3, 4, 5)]
    with pytest.raises(CaseError) as caught:
        run_cases(fail, cases, folder=tmp_path, workers=workers)
    assert str(caught.value) == 'case {"k":3}: ZeroDivisionError: it broke'
    assert "ZeroDivisionError" in repr(caught.value.__cause__)
    (journal,) = journals(tmp_path)
    kept = {json.loads(line)["case"]["k"] for line in journal.read_text().splitlines()[1:]}
    assert {0, 1, 2} <= kept and 3 not in kept


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_of_ours_passes_unchanged(workers: int) -> None:
    with pytest.raises(BoundsError, match=r"^the index 9 does not fit$"):
        run_cases(fail, [{"k": 3, "kind": "hexmap"}, {"k": 1}], workers=workers)


def test_a_result_that_is_not_plain_is_named() -> None:
    with pytest.raises(CaseError, match="cannot be written as JSON: set is not plain data"):
        run_cases(fail, [{"k": 3, "kind": "result"}])
    with pytest.raises(CaseError, match="not a dictionary but list"):
        run_cases(fail, [{"k": 3, "kind": "list"}])


def test_a_worker_that_dies_is_noticed() -> None:
    with pytest.raises(CaseError, match=r'case {"k":3,"kind":"exit"}|case {"k": 3.*') as caught:
        run_cases(fail, [{"k": 1}, {"k": 3, "kind": "exit"}, {"k": 2}], workers=2)
    assert "exit code 7" in str(caught.value)
    with pytest.raises(CaseError, match=r'^case {"k":3,"kind":"sys.exit"}: SystemExit: 5$'):
        run_cases(fail, [{"k": 1}, {"k": 3, "kind": "sys.exit"}], workers=2)
    with pytest.raises(CaseError, match=r"died, 3 times \(killed by signal 9\); if memory ran out, use fewer workers$"):
        run_cases(fail, [{"k": 1}, {"k": 3, "kind": "kill"}, {"k": 60}], workers=2)


def die_once(case: Case, rng: np.random.Generator, shared: Shared) -> dict[str, Any]:
    note = Path(shared["folder"]) / "died"
    if case["k"] == 5 and not note.exists():
        note.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return {"k": case["k"], "some": rng.random()}


def test_a_worker_that_is_killed_changes_nothing(tmp_path: Path) -> None:
    cases = [{"k": k} for k in range(20)]
    journal = tmp_path / "journal"
    steps: list[tuple[int, int]] = []
    killed = run_cases(
        die_once, cases, shared={"folder": str(tmp_path)}, folder=journal, workers=2,
        progress=lambda *s: steps.append(s),
    )  # fmt: skip
    assert (tmp_path / "died").exists()
    assert steps == [(k, 20) for k in range(21)]
    assert repr(killed) == repr(run_cases(die_once, cases, shared={"folder": str(tmp_path)}))
    keys = [json.loads(line)["key"] for line in journals(journal)[0].read_text().splitlines()[1:]]
    assert len(keys) == len(set(keys)) == 20


@pytest.mark.parametrize("kind", ["broken", "exit"])
def test_a_run_that_fails_does_not_wait_for_the_other_workers(kind: str) -> None:
    begin = time.monotonic()
    with pytest.raises(CaseError, match=r'case {"k":3,"kind":"(broken|exit)"}: '):
        run_cases(fail, [{"k": 60}, {"k": 3, "kind": kind}, *({"k": k} for k in range(4, 20))], workers=2)
    assert time.monotonic() - begin < 30
    assert not [child for child in active_children() if child.is_alive()]


def test_a_script_without_a_main_guard_is_told_so(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    head, _, _ = textwrap.dedent(SCRIPT).partition("if __name__")
    script.write_text(head + "run_cases(slow, [{'k': k} for k in range(4)], workers=2, shared={'seconds': 0.0})\n")
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    run = subprocess.run([sys.executable, str(script)], env=environment, capture_output=True, text=True, timeout=60)
    assert run.returncode == 1
    last = run.stderr.strip().splitlines()[-1]
    assert "CaseError: a worker died before it began (exit code 1)" in last and "__main__" in last


def test_shared_data_cannot_be_changed() -> None:
    cases = [{"k": 1}]
    with pytest.raises(CaseError, match="read-only"):
        run_cases(spoil, cases, shared={"points": np.zeros(3)})
    assert cases == [{"k": 1}]


def test_wrong_arguments_are_refused_before_any_work() -> None:
    def inner(case: Case, rng: np.random.Generator, shared: Shared) -> dict[str, Any]:
        return {}

    never: Any = lambda case, rng, shared: {}
    for function in (inner, never):
        with pytest.raises(ArgumentError, match="top level"):
            run_cases(function, [{}])
    for wrong in ({"workers": 0}, {"workers": True}, {"workers": 1.5}, {"seed": -1}, {"seed": "x"}):
        with pytest.raises(ArgumentError):
            run_cases(awkward, [{}], **wrong)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="case 1 cannot be written as JSON"):
        run_cases(awkward, [{}, {"path": Path("x")}])
    with pytest.raises(ArgumentError, match="case 0 is not a dictionary"):
        run_cases(awkward, [3])  # type: ignore[list-item]
    with pytest.raises(ArgumentError, match="neither an array"):
        run_cases(awkward, [{}], shared={"x": object()})
    assert run_cases(awkward, []) == []
    assert issubclass(CaseError, HexmapError)


# ---------------------------------------------------------------------- Ctrl-C

SCRIPT = """
    import json, os, sys, time
    from pathlib import Path
    from hexmap.experiments.run_cases import run_cases

    def slow(case, rng, shared):
        deadline = time.monotonic() + shared["seconds"]
        while time.monotonic() < deadline:
            pass
        return {"value": rng.random(), "k": case["k"]}

    if __name__ == "__main__":
        folder, workers, seconds = Path(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])

        def progress(done, total):
            (folder / "progress").write_text(f"{done} {os.getpid()}")

        try:
            out = run_cases(slow, [{"k": k} for k in range(12)], folder=folder / "journal", workers=workers,
                            shared={"seconds": seconds}, seed=5, progress=progress)
        except KeyboardInterrupt:
            (folder / "stopped").write_text("")
            sys.exit(130)
        sys.stdout.write(json.dumps(out))
"""


def runs(pid: int) -> bool:
    """Return whether a process does; one that is dead may wait for whoever adopted it to bury it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not hasattr(os, "killpg") or not Path("/proc/self/stat").exists(), reason="needs /proc")
@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_loses_nothing_and_leaves_nobody(tmp_path: Path, workers: int) -> None:
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(SCRIPT))
    command = [sys.executable, str(script), str(tmp_path), str(workers), "0.15"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    run = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    progress = tmp_path / "progress"

    def three_are_done() -> bool:
        assert run.poll() is None, run.communicate()
        return progress.exists() and int((progress.read_text() or "0").split()[0]) >= 3

    wait_until(three_are_done)
    family = children(run.pid)
    assert len(family) >= (workers if workers > 1 else 0)
    os.killpg(run.pid, signal.SIGINT)  # as a terminal does: to all processes of the group
    _, errors = run.communicate(timeout=PATIENCE)
    assert run.returncode == 130 and (tmp_path / "stopped").exists()
    assert errors == ""
    wait_until(lambda: not any(runs(pid) for pid in family))
    (journal,) = journals(tmp_path / "journal")
    finished = len(journal.read_text().splitlines()) - 1
    assert int(progress.read_text().split()[0]) <= finished < 12
    resumed = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True)
    fresh = tmp_path / "fresh"
    fresh.mkdir()
    command[2] = str(fresh)
    uninterrupted = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, check=True)
    assert resumed.stdout == uninterrupted.stdout and len(json.loads(resumed.stdout)) == 12
    keys = [json.loads(line)["key"] for line in journal.read_text().splitlines()[1:]]
    assert len(keys) == len(set(keys)) == 12


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_workers_do_not_outlive_a_killed_run(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(SCRIPT))
    command = [sys.executable, str(script), str(tmp_path), "2", "30"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2]), "TMPDIR": str(tmp_path)}
    run = subprocess.Popen(command, env=environment, start_new_session=True)

    def family_of_three() -> set[int]:  # two workers and what looks after their resources
        assert run.poll() is None
        return family if len(family := children(run.pid)) >= 3 else set()

    family = wait_until(family_of_three)
    time.sleep(1.0)
    run.kill()
    run.wait()
    wait_until(lambda: not any(runs(pid) for pid in family))


# ---------------------------------------------------------------------- intervals


def test_statistics_are_those_of_the_metrics() -> None:
    values = np.random.default_rng(0).normal(100, 3, (5, 36))
    for row, a, b, c in zip(values, cv(values), interquartile_factor(values), mean(values), strict=True):
        assert a == pytest.approx(coefficient_of_variation(row), rel=1e-14)
        assert b == pytest.approx(interquartile_variability(row), rel=1e-14)
        assert c == pytest.approx(row.mean(), rel=1e-14)


def test_intervals_follow_from_the_generator() -> None:
    values = np.random.default_rng(1).exponential(1.0, 50)
    one, two, other = (bootstrap(values, cv, rng=np.random.default_rng(s), block=3) for s in (7, 7, 8))
    assert one == two != other
    assert one.low < one.value < one.high and one.value == float(cv(values))
    assert one.value in one and one.high * 1.01 not in one
    narrow = bootstrap(values, cv, rng=np.random.default_rng(7), level=0.5)
    assert narrow.high - narrow.low < 0.6 * (one.high - one.low)
    assert one.scaled(100.0) == Interval(100 * one.value, 100 * one.low, 100 * one.high)


def coverage(sample: Any, statistic: Any, truth: float, **options: Any) -> float:
    rng = np.random.default_rng(3)
    return float(
        np.mean([truth in bootstrap(sample(rng), statistic, rng=rng, resamples=500, **options) for _ in range(200)])
    )


def autoregressive(rng: np.random.Generator) -> np.ndarray:
    noise, x = rng.normal(size=350), np.zeros(350)
    for k in range(1, 350):
        x[k] = 0.6 * x[k - 1] + noise[k]
    return x[50:]


def test_intervals_hold_the_truth_about_as_often_as_they_say() -> None:
    assert 0.89 <= coverage(lambda rng: rng.normal(10, 1, 60), mean, 10.0) <= 0.99
    assert 0.86 <= coverage(lambda rng: rng.normal(10, 1, 60), cv, 0.1) <= 0.99
    assert 0.87 <= coverage(lambda rng: rng.normal(10, 1, 60), interquartile_factor, 0.067449) <= 0.99
    assert 0.84 <= coverage(lambda rng: rng.exponential(1, 60), mean, 1.0) <= 0.99


def test_blocks_are_for_neighbours_that_are_alike() -> None:
    alone = coverage(autoregressive, mean, 0.0)
    blocks = coverage(autoregressive, mean, 0.0, block=15)
    assert alone < 0.75 and 0.85 <= blocks <= 0.99
    assert 0.84 <= coverage(autoregressive, mean, 0.0, block=15, circular=False) <= 0.99


def test_block_length_follows_the_correlation() -> None:
    rng = np.random.default_rng(5)
    assert np.mean([block_length(rng.normal(size=300)) for _ in range(20)]) < 4
    assert 6 < np.mean([block_length(autoregressive(rng)) for _ in range(20)]) < 40
    assert block_length(np.full(36, 0.1)) == block_length([1.0, 2.0, 3.0]) == 1
    assert 1 < block_length(np.sin(np.arange(36) / 36 * 2 * np.pi)) <= 12


def test_pairs_are_drawn_together() -> None:
    rng = np.random.default_rng(2)
    b = rng.normal(100, 5, 40)
    a = 100 + 0.5 * (b - 100) + rng.normal(0, 0.1, 40)
    paired = bootstrap_ratio(a, b, cv, rng=np.random.default_rng(0))
    apart = bootstrap_ratio(a, b, cv, rng=np.random.default_rng(0), paired=False)
    assert paired.value == apart.value == float(cv(a) / cv(b))
    assert 3 * (paired.high - paired.low) < apart.high - apart.low
    assert 0.5 in paired and 0.5 in apart
    exact = bootstrap_ratio(3 * b, b, mean, rng=rng)
    assert (exact.low, exact.value, exact.high) == pytest.approx((3, 3, 3))
    longer = bootstrap_ratio(np.r_[a, a], b, cv, rng=rng, paired=False, block=4)
    assert longer.low < longer.value < longer.high


def test_a_constant_has_no_width() -> None:
    assert bootstrap([3.0] * 36, cv, rng=np.random.default_rng(0)) == Interval(0.0, 0.0, 0.0)
    assert bootstrap([3.0] * 36, mean, rng=np.random.default_rng(0), block=5) == Interval(3.0, 3.0, 3.0)


def test_a_large_sample_is_cut_into_parts() -> None:
    values = np.random.default_rng(0).normal(size=60_000)
    interval = bootstrap(values, mean, rng=np.random.default_rng(0), resamples=200)
    assert interval.high - interval.low == pytest.approx(2 * 1.96 / math.sqrt(60_000), rel=0.25)


def test_what_has_no_interval_is_refused() -> None:
    rng = np.random.default_rng(0)
    good = [1.0, 2.0, 4.0, 5.0]
    for values in ([], [1.0], [1.0, math.nan], [[1.0, 2.0], [3.0, 4.0]], [math.inf, 1.0]):
        with pytest.raises(ArgumentError):
            bootstrap(values, mean, rng=rng)
        with pytest.raises(ArgumentError):
            block_length(values)
    for wrong in ({"resamples": 10}, {"level": 1.0}, {"block": 0}, {"block": 3}):
        with pytest.raises(ArgumentError):
            bootstrap(good, mean, rng=rng, **wrong)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="not defined"):
        bootstrap([-1.0, 1.0], cv, rng=rng)
    with pytest.raises(ArgumentError, match="of one length"):
        bootstrap_ratio(good, [*good, 1.0], mean, rng=rng)
    with pytest.raises(ArgumentError, match="zero"):
        bootstrap_ratio(good, [2.0] * 4, cv, rng=rng)
