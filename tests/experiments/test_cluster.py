"""A Dask cluster computes the same bits; a missing extra is one line."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexmap.base.errors import ArgumentError, FileAccessError, MissingDependencyError
from hexmap.cli import main
from hexmap.experiments import run_cases
from hexmap.experiments.case import CaseError
from hexmap.experiments.cluster import cluster_executor
from hexmap.io.tile_merge import merge_maps


def random_sum(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    return {"sum": float(rng.normal(size=100).sum() * shared["scale"][case["i"] % 3])}


def killed_once(case: dict[str, Any], rng: np.random.Generator, shared: Any) -> dict[str, Any]:
    note = Path(shared["note"])
    if case["i"] == 5 and (shared["always"] or not note.exists()):
        note.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return random_sum(case, rng, shared)


def test_what_is_wrong_with_a_cluster_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with cluster_executor(None) as executor:
        assert executor is None
    with pytest.raises(ArgumentError, match="tcp://HOST:PORT, not 'scheduler'"), cluster_executor("scheduler"):
        pass
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingDependencyError, match=r"hexmap\[cluster\]"), cluster_executor("tcp://localhost:1"):
        pass
    log = tmp_path / "room.clf"
    assert main(["simulate", "room", "-o", str(log), "--duration", "2"]) == 0
    capsys.readouterr()
    fleet = ["build", str(log), "--fleet", "-o", str(tmp_path / "maps"), "--cluster", "tcp://localhost:1"]
    assert main(fleet) == 1
    _, err = capsys.readouterr()
    assert "hexmap[cluster]" in err.splitlines()[-1]


@pytest.mark.long
def test_a_cluster_computes_the_same_bits(tmp_path: Path) -> None:
    from localisation.mapping.fleet import build_fleet

    distributed = pytest.importorskip("distributed")
    import dask

    logs = []
    for seed in range(3):
        logs.append(tmp_path / f"room-{seed}.clf.gz")
        assert main(["simulate", "room", "-o", str(logs[-1]), "--seed", str(seed), "--duration", "5"]) == 0
    cases, shared = [{"i": i} for i in range(12)], {"scale": np.array([1.0, 0.3, 7.0])}
    expected = run_cases(random_sum, cases, shared=shared, seed=3)
    build_fleet(logs, tmp_path / "one", loop_closure=False)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
    ):
        with cluster_executor(cluster.scheduler_address) as executor:
            folder = tmp_path / "cases"
            folder.mkdir()
            assert run_cases(random_sum, cases, shared=shared, seed=3, executor=executor, folder=folder) == expected
            # A worker process that is killed is replaced, and what it computed is computed again.
            mortal = {**shared, "note": str(tmp_path / "killed"), "always": False}
            found = run_cases(killed_once, cases, shared=mortal, seed=3, executor=executor, folder=folder)
            assert (tmp_path / "killed").exists() and found == run_cases(killed_once, cases, shared=mortal, seed=3)
            with pytest.raises(CaseError, match=r'^case {"i":5}: KilledWorker: '):
                run_cases(killed_once, cases[5:6], shared={**mortal, "always": True}, executor=executor, folder=folder)
            fleet = build_fleet(logs, tmp_path / "two", loop_closure=False, executor=executor)
            merge_maps(fleet.built, tmp_path / "tiles-two", 1.6, same_frame=True, executor=executor)
        merge_maps(fleet.built, tmp_path / "tiles-one", 1.6, same_frame=True)
        again = ["build", *map(str, logs), "--fleet", "-o", str(tmp_path / "two"), "--no-loop-closure"]
        assert main([*again, "--cluster", cluster.scheduler_address]) == 0
    assert len(fleet.built) == 3 and not fleet.failed
    one, two = ({p.name: p.read_bytes() for p in (tmp_path / f"tiles-{n}").iterdir()} for n in ("one", "two"))
    assert one == two and len(one) > 4
    assert [p.read_bytes() for p in fleet.built] == [(tmp_path / "one" / p.name).read_bytes() for p in fleet.built]
    with pytest.raises(FileAccessError, match="no Dask scheduler answers"), cluster_executor("tcp://127.0.0.1:1"):
        pass
