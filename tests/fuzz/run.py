"""``python -m tests.fuzz --count 10000``: damaged files given to every reader.

Each must be read or refused with a HexmapError, in less than 20 seconds and a gigabyte of memory. What is not is
printed, once a place in the code, and its file is kept in the folder of ``--keep``. Not a part of the test run.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import signal
import tempfile
import time
import traceback
import warnings
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

SECONDS = 20.0
BYTES = 1 << 30


def readers() -> dict[str, object]:
    """Return what reads each kind of seed."""
    from hexmap.io.clouds.read_points import read_points
    from hexmap.io.grids.open_grid import open_grid
    from hexmap.io.grids.scenarios import read_scenario
    from hexmap.io.logs.open_log import open_log
    from hexmap.io.map_file import load_map, read_metadata
    from hexmap.io.trajectories import read_relations, read_trajectory

    def whole_log(path: Path) -> None:
        log = open_log(path)
        for event in log:
            assert event.stamp is not None
        assert all("\n" not in text for text in log.warnings)

    def both(path: Path) -> None:
        read_metadata(path)
        load_map(path)

    def points(path: Path) -> None:
        read_points(path, offset="auto")

    return {
        "log": whole_log, "grid": open_grid, "points": points, "trajectory": read_trajectory, "map": both,
        "relations": read_relations, "scenario": read_scenario,
    }  # fmt: skip


def look(path: Path) -> None:
    """Ask what a file is, as `hexmap info` does."""
    from hexmap.io.file_kinds import is_parquet
    from hexmap.io.grids.open_grid import is_grid
    from hexmap.io.logs.open_log import is_log

    for ask in (is_parquet, is_grid, is_log):
        ask(path)


def work(pipe: Connection, folder: str, seed: int) -> None:
    """Make the cases that are asked for and read them; answers with what went wrong, if anything did."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("error", RuntimeWarning)
    from hexmap.base.errors import HexmapError
    from tests.fuzz.mutate import mutate
    from tests.fuzz.seeds import write_seeds

    with tempfile.TemporaryDirectory(dir=folder) as own:
        here = Path(own)
        (here / "seeds").mkdir()
        seeds = write_seeds(here / "seeds")
        data = [path.read_bytes() for _, path in seeds]
        read = readers()
        pipe.send("ready")
        while (number := pipe.recv()) is not None:
            rng = np.random.default_rng([seed, number])
            k, other = int(rng.integers(len(seeds))), int(rng.integers(len(seeds)))
            kind, path = seeds[k]
            case = mutate(data[k], data[other], rng)
            target = here / path.name
            if kind == "picture":
                kind, target = "grid", here / f"{path.name}.yaml"
                target.write_bytes((path.parent / target.name).read_bytes())
            elif kind == "metadata":
                kind, target = "log", here / "bag"
                target.mkdir(exist_ok=True)
                (target / "metadata.yaml").write_bytes(case)
            elif path.suffix == ".yaml" and (image := path.parent / path.name.removesuffix(".yaml")).is_file():
                (here / image.name).write_bytes(image.read_bytes())
            if target != here / "bag":
                (here / path.name).write_bytes(case)
            if rng.random() < 0.15:
                kind = str(rng.choice(sorted(read)))
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            trouble = ""
            try:
                if target.is_file():
                    look(target)
                read[kind](target)  # type: ignore[operator]
            except HexmapError as error:
                if "\n" in str(error) or not str(error).isprintable():
                    trouble = f"not one printable line: {str(error)!r}"
            except BaseException:
                trouble = traceback.format_exc()
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            if peak * 1024 > BYTES and peak > before:
                trouble += f"memory: {peak * 1024 / 1e6:.0f} MB"
            pipe.send((kind, path.name, trouble, case if trouble else b""))


class Worker:
    """A process that reads cases one by one, started anew where one hangs or dies."""

    def __init__(self, folder: str, seed: int) -> None:
        self.folder, self.seed = folder, seed
        self.start()

    def start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=work, args=(theirs, self.folder, self.seed), daemon=True)
        self.process.start()
        theirs.close()
        assert self.pipe.recv() == "ready"

    def run(self, number: int) -> tuple[str, str, str, bytes]:
        """Return the reader, the seed's name, the trouble and the case."""
        self.pipe.send(number)
        try:
            if self.pipe.poll(SECONDS):
                found: tuple[str, str, str, bytes] = self.pipe.recv()
                if "memory:" in found[2]:
                    self.stop()
                    self.start()
                return found
            trouble = f"longer than {SECONDS:.0f} s"
        except (EOFError, OSError):
            trouble = "the process died"
        self.stop()
        self.start()
        return "?", f"case {number}", trouble, b""

    def stop(self) -> None:
        self.process.kill()
        self.process.join()


def place(trouble: str) -> str:
    """Return where a trouble arose, so that each is printed once."""
    lines = [line.strip() for line in trouble.strip().splitlines()]
    inside = [line for line in lines if line.startswith("File") and ("hexmap" in line or "localisation" in line)]
    return f"{inside[-1] if inside else ''} {lines[-1][:60] if lines else ''}"


def main() -> None:
    """Run the cases and print what went wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so long")
    parser.add_argument("--keep", type=Path, help="where to keep files that are not refused as they should be")
    options = parser.parse_args()
    counts = {"tracebacks": 0, "hangs": 0, "memory": 0}
    seen: dict[str, int] = {}
    slowest = (0.0, "")
    begin = time.monotonic()
    done = 0
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        worker = Worker(folder, options.seed)
        for number in range(options.first, options.first + options.count):
            if time.monotonic() - begin > options.seconds:
                break
            at = time.monotonic()
            reader, name, trouble, case = worker.run(number)
            slowest = max(slowest, (time.monotonic() - at, f"case {number} ({name})"))
            done += 1
            if not trouble:
                continue
            kind = "hangs" if "longer than" in trouble else "memory" if trouble.startswith("memory") else "tracebacks"
            counts[kind] += 1
            where = place(trouble)
            seen[where] = seen.get(where, 0) + 1
            if seen[where] == 1:
                print(f"case {number}, {name} read as {reader}:\n{trouble}\n", flush=True)
                if options.keep is not None:
                    options.keep.mkdir(parents=True, exist_ok=True)
                    (options.keep / f"{number}-{name}").write_bytes(case)
        worker.stop()
    seconds = time.monotonic() - begin
    words = ", ".join(f"{value} {key}" for key, value in counts.items())
    print(f"{done} damaged files over all readers in {seconds:.0f} s: {words}")
    print(f"the slowest took {slowest[0]:.1f} s: {slowest[1]}")
