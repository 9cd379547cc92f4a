"""What every worker needs to compute cases: the function, the shared data and the seed, written once in a folder.

A worker is sent the folder and one case at a time. It reads the folder at its first case, maps large arrays from
their files, and keeps what it has read: no case carries the shared data with it.
"""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from hexmap.base.errors import FileAccessError, HexmapError
from hexmap.experiments.case import CaseError, CaseFunction, compute, failure, one_line

_MAPPED_BYTES = 1 << 20  # smaller arrays are cheaper to copy to a worker than to map


def write_payload(folder: Path, function: CaseFunction, data: Mapping[str, Any], seed: int) -> None:
    """Write what every worker needs into ``folder``: large arrays as files to map, the rest in one pickle.

    Raises:
        FileAccessError: the folder cannot be written.
    """
    small, mapped = {}, {}
    try:
        for i, (name, value) in enumerate(data.items()):
            if isinstance(value, np.ndarray) and value.nbytes >= _MAPPED_BYTES:
                mapped[name] = f"{i}.npy"
                np.save(folder / mapped[name], value, allow_pickle=False)
            else:
                small[name] = value
        # The function as bytes: a worker that cannot import it should say so, not die of it.
        payload = (pickle.dumps(function), small, mapped, list(data), seed)
        (folder / "payload").write_bytes(pickle.dumps(payload))
    except OSError as error:
        raise FileAccessError(f"{folder}: cannot be written: {error.strerror or error}") from error


@lru_cache(maxsize=1)
def _read_payload(folder: str) -> tuple[CaseFunction, dict[str, Any], int]:
    """Return the function, the read-only shared data and the seed; read once in a process."""
    function, small, mapped, names, seed = pickle.loads(Path(folder, "payload").read_bytes())
    arrays = {name: np.load(Path(folder, file), mmap_mode="r").view(np.ndarray) for name, file in mapped.items()}
    data: dict[str, Any] = {**small, **arrays}
    for value in data.values():
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
    return pickle.loads(function), {name: data[name] for name in names}, seed


def compute_from_payload(folder: str, text: str) -> str:
    """Compute one case in a worker and return its result as JSON.

    Args:
        folder: where :func:`write_payload` has written.
        text: the case as canonical JSON.

    Raises:
        CaseError: the case failed, or the payload cannot be read.
        HexmapError: what the case itself raised.
    """
    try:
        function, data, seed = _read_payload(folder)
    except Exception as error:
        reason = f"{type(error).__name__}: {one_line(str(error))}"
        raise CaseError(f"a worker could not load the experiment: {reason}") from error
    try:
        return compute(function, text, seed, data)
    except SystemExit as error:
        raise CaseError(failure(text, error)) from error  # the end of a worker is not that of the run
    except Exception as error:
        if _survives_pickling(error):
            raise
        # What cannot be sent as it is would break the worker instead of reporting the case.
        raise CaseError(str(error)) from error


def _survives_pickling(error: Exception) -> bool:
    try:
        again = pickle.loads(pickle.dumps(error))
    except Exception:
        return False
    return isinstance(again, HexmapError) and str(again) == str(error)
