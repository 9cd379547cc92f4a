"""What is asked of the C library changes no result and is no error on any system."""

from __future__ import annotations

import platform
import subprocess
import sys

import pytest

from hexmap.base.memory import return_free_memory, return_freed_arrays

MEASURE = """
import sys
import numpy as np
from hexmap.base.memory import return_freed_arrays

def resident():
    return int(open("/proc/self/statm").read().split()[1]) * 4096

if sys.argv[1] == "asked":
    return_freed_arrays()
np.ones(16 << 20, np.uint8)  # the first large array that is freed
begin = resident()
arrays = [np.ones(2 << 20, np.uint8) for _ in range(20)]
kept = arrays.pop()
arrays.clear()
print((resident() - begin) >> 20)
"""


def test_it_may_be_asked_at_any_time() -> None:
    return_free_memory()
    return_freed_arrays()
    return_free_memory()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library")
def test_large_arrays_are_returned_when_they_are_freed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MALLOC_MMAP_THRESHOLD_", raising=False)
    run = subprocess.run([sys.executable, "-c", MEASURE, "asked"], capture_output=True, text=True, check=True)
    assert int(run.stdout) <= 8, "of 40 MiB the one array of 2 that is kept, and little more"
