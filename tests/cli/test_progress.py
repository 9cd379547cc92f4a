"""The line on a terminal that shows how far a command is: it moves from the start; elsewhere there is none."""

from __future__ import annotations

import math
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import pytest

from hexmap.cli.console import progress_line
from hexmap.cli.experiments import say_if_resumed
from hexmap.cli.progress import Estimate
from hexmap.io.logs.open_log import open_log
from hexmap.simulator.buildings import make_building
from hexmap.simulator.writer import write_log


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_what_is_left_is_told_without_what_was_loaded_and_compiled() -> None:
    clock = Clock()
    estimate = Estimate(clock)
    clock.now = 20.0  # loading
    estimate.compiled(5.0)  # on the way to the first scan
    assert all(math.isnan(v) for v in estimate.of(1, 0.02))
    clock.now += 0.5
    rate, left = estimate.of(6, 0.07)
    assert rate == pytest.approx(10.0) and math.isnan(left)  # too early
    clock.now += 30.0
    estimate.compiled(30.0)
    clock.now += 1.5
    rate, left = estimate.of(21, 0.22)
    assert rate == pytest.approx(10.0) and left == pytest.approx(2.0 * 0.78 / 0.2)


def test_without_a_terminal_nothing_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_line("mapping", lambda: 0.5) as update:
        update(10)
    assert capsys.readouterr() == ("", "")


_PROGRAM = """
import sys, time
from hexmap.cli.console import progress_line
import numpy as np
done = 0.0
with progress_line("mapping", lambda: done) as update:
    time.sleep(0.25)  # nothing is done yet, and it moves all the same
    from numba import njit
    njit(lambda x: x + 1)(1)
    for k in range(22):
        time.sleep(0.06)
        done = (k + 1) / 22
        update(k + 1)
with progress_line("closing loops", lambda: 0.0):
    time.sleep(0.15)
print("end")
"""


def test_on_a_terminal_the_line_moves_and_goes(tmp_path: Path) -> None:
    control, terminal = pty.openpty()
    environment = {**os.environ, "COLUMNS": "120", "TERM": "xterm"}
    process = subprocess.Popen(
        [sys.executable, "-c", _PROGRAM], stdout=terminal, stderr=terminal, env=environment, close_fds=True
    )
    os.close(terminal)
    seen = b""
    while True:
        try:
            part = os.read(control, 1 << 16)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        seen += part
    os.close(control)
    assert process.wait() == 0
    frames = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen.decode("utf-8", "replace"))
    assert "mapping" in frames and "compiling, once" in frames and "closing loops" in frames
    shares = [int(v) for v in re.findall(r"(\d+) %", frames)]
    assert shares == sorted(shares) and len(set(shares)) > 5
    assert re.search(r"\d+ scans, \d+ a second, 0:0\d left", frames)
    # The line is taken away: what stays is the result.
    assert frames.rstrip().endswith("end")


def test_an_experiment_that_goes_on_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    say_if_resumed(tmp_path)
    assert capsys.readouterr().out == ""
    (tmp_path / "cases-0.jsonl").touch()
    say_if_resumed(tmp_path)
    assert "finished cases of an earlier run are kept" in capsys.readouterr().out


@pytest.mark.parametrize("ending", ["", ".gz"])
def test_a_small_log_is_read_in_small_steps(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a.clf{ending}"
    write_log(path, make_building("room"), seed=1, duration=20.0)
    log = open_log(path)
    shares = [log.fraction() for _ in log]
    steps = [b - a for a, b in zip([0.0, *shares], shares, strict=False)]
    assert min(steps) >= 0.0 and max(steps) < 0.15 and shares[-1] == 1.0
