"""Killing workers and commands at random instants: what lies there is old or new, never half, and what resumes equal.

    python -m tests.benchmarks.kills FOLDER --times 50

Three commands with two workers each, in turn: a merge into tiles, a fleet and an experiment. Every other time one of
their workers is killed (SIGKILL), and the command has to end well by itself; the other times the command is, and it is
run again. In the end the files are those of a run that nobody disturbed, byte for byte.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.atomic_files import atomic_write
from hexmap.experiments.run_cases import run_cases
from hexmap.io.map_folder import MapFolder
from hexmap.lattice.lattice import Lattice
from hexmap.maps.metrics import distortion
from hexmap.maps.voxel_list import VoxelList
from hexmap.paper.cases import about_axis
from tests.benchmarks.scale import make_maps
from tests.observing import children

HEXMAP = [sys.executable, "-m", "hexmap"]
TILE = "6.4"


@dataclass
class Subject:
    """A command that is killed.

    Attributes:
        command: what is run.
        output: the folder that it writes.
        reset: makes the folder what it was before.
        state: returns what is in the folder, in a word, or raises where something is half.
    """

    command: list[str]
    output: Path
    reset: Callable[[], None]
    state: Callable[[], str]
    seconds: float = 0.0
    whole: str = ""


def contents(folder: Path) -> dict[str, str]:
    """Return a digest of every file in a folder that is not hidden and no journal of finished cases."""
    return {
        str(path.relative_to(folder)): hashlib.blake2b(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.name.startswith((".", "cases-"))
    }


def digest(folder: Path) -> str:
    return hashlib.blake2b(repr(contents(folder)).encode()).hexdigest()


def run(command: list[str]) -> float:
    begin = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - begin


def merging(folder: Path) -> Subject:
    paths = [str(path) for path in make_maps(folder / "rows-1e7", 10**7)]
    out = folder / "killed-merge"
    options = ["-o", str(out), "--tiles", TILE]
    old = [*HEXMAP, "merge", paths[0], *options]
    command = [*HEXMAP, "merge", *paths, *options, "--workers", "2"]

    def state() -> str:
        found = MapFolder.open(out)
        for tile in found.tiles:  # which are called by their content
            content = (out / tile.file).read_bytes()
            if hashlib.blake2b(content, digest_size=8).hexdigest() != tile.file.split(".")[1]:
                raise SystemExit(f"{tile.file} is half")
        return "old" if len(found.sources()) == 1 else "new"

    def reset() -> None:
        run(old)

    return Subject(command, out, reset, state)


def fleet(folder: Path) -> Subject:
    logs = []
    for seed in range(8):
        logs.append(folder / f"office-{seed}.clf.gz")
        if not logs[-1].exists():
            run([*HEXMAP, "simulate", "office", "-o", str(logs[-1]), "--seed", str(seed), "--duration", "30"])
    out = folder / "killed-fleet"
    command = [*HEXMAP, "build", "--fleet", *map(str, logs), "-o", str(out), "--workers", "2"]
    reference: dict[str, str] = {}

    def state() -> str:
        found = contents(out) if out.exists() else {}
        if not reference and len(found) == len(logs):
            reference.update(found)
        for name, text in found.items():
            if text != reference[name]:
                raise SystemExit(f"{name} is half")
        return f"{len(found)} maps"

    return Subject(command, out, lambda: shutil.rmtree(out, ignore_errors=True), state)


def turned(case: dict[str, Any], rng: np.random.Generator, shared: Mapping[str, Any]) -> dict[str, Any]:
    """Count the cells of points that are turned and moved, a few dozen milliseconds."""
    lattice = Lattice.named(case["lattice"], 0.1)
    points = about_axis("z", case["degrees"], 3).apply(shared["points"]) + rng.random(3)
    return {"cells": len(VoxelList.from_points(points, lattice)), "distortion": distortion(points, lattice)}


def compute_cases(folder: str) -> None:
    """Compute all cases on two workers, with a journal, and write their results."""
    points = np.random.default_rng(0).normal(size=(100_000, 3)) * 5.0
    cases = [{"lattice": name, "degrees": k} for name in ("Z3", "D3", "D3*") for k in range(40)]
    found = run_cases(turned, cases, shared={"points": points}, folder=folder, workers=2)
    with atomic_write(Path(folder) / "results.json", "w") as handle:
        json.dump(found, handle)


def experiment(folder: Path) -> Subject:
    out = folder / "killed-experiment"
    program = f"from tests.benchmarks.kills import compute_cases; compute_cases({str(out)!r})"

    def state() -> str:
        return "with results" if (out / "results.json").exists() else "without results"

    return Subject([sys.executable, "-c", program], out, lambda: shutil.rmtree(out, ignore_errors=True), state)


def a_worker(pid: int) -> int | None:
    """Return a worker of a command, not what looks after its shared memory."""
    for child in sorted(children(pid)):
        try:
            if b"spawn_main" in Path(f"/proc/{child}/cmdline").read_bytes():
                return child
        except OSError:
            continue
    return None


def kill(subject: Subject, whom: str, instant: float) -> str:
    """Run a command and kill it, or one of its workers from ``instant`` on; return what lay there then."""
    with subprocess.Popen(subject.command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        time.sleep(instant)
        victim: int | None = None
        while victim is None and process.poll() is None:
            victim = process.pid if whom == "command" else a_worker(process.pid)
        if victim is None or process.poll() is not None:
            process.communicate()
            return "over"
        try:
            os.kill(victim, signal.SIGKILL)
        except ProcessLookupError:
            return "over"
        _, errors = process.communicate()
    if whom == "worker" and process.returncode:
        raise SystemExit(f"{' '.join(subject.command[2:5])} ended with {process.returncode}: {errors.decode()}")
    return subject.state()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--times", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    makers = {make.__name__: make for make in (merging, fleet, experiment)}
    parser.add_argument("--subjects", nargs="+", choices=list(makers), default=list(makers))
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    subjects = {name: makers[name](options.folder) for name in options.subjects}
    for subject in subjects.values():
        subject.reset()
        subject.seconds = run(subject.command)
        subject.state()
        subject.whole = digest(subject.output)
    rng = np.random.default_rng(options.seed)
    found: Counter[tuple[str, str, str]] = Counter()
    different = 0
    while sum(found.values()) < options.times:
        number = sum(found.values())
        print(f"\r{number}", end="", file=sys.stderr)
        name, whom = list(subjects)[number // 2 % len(subjects)], ("worker", "command")[number % 2]
        subject = subjects[name]
        subject.reset()
        state = kill(subject, whom, rng.uniform(0.05, 0.95) * subject.seconds)
        if state == "over":
            continue
        found[name, whom, state] += 1
        if whom == "command":
            run(subject.command)
        different += digest(subject.output) != subject.whole
    for (name, whom, state), count in sorted(found.items()):
        print(f"{name}, {whom} killed: {count} times {state}")
    print(f"{options.times} kills; files that differ from those of an undisturbed run: {different} times")


if __name__ == "__main__":
    main()
