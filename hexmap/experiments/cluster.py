"""Work on a cluster: a Dask scheduler's workers as an executor, in place of processes of this machine."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from concurrent.futures import Executor

from hexmap.base.errors import ArgumentError, FileAccessError, MissingDependencyError
from hexmap.base.text import quoted, reason

__all__ = ["cluster_executor"]

_ADDRESS = re.compile(r"[a-z]+://\S+:\d+")
_SECONDS = 10  # that a scheduler may take to answer


@contextlib.contextmanager
def cluster_executor(address: str | None) -> Iterator[Executor | None]:
    """Give the executor of a Dask cluster, or None where no address is given.

    The workers need this version of hexmap, and see files under the same paths as this machine does.

    Args:
        address: of the scheduler, such as ``tcp://scheduler:8786``.

    Raises:
        MissingDependencyError: Dask is not installed.
        ArgumentError: not an address.
        FileAccessError: no scheduler answers there, or it has no worker.
    """
    if address is None:
        yield None
        return
    if not _ADDRESS.fullmatch(address):
        raise ArgumentError(f"--cluster takes the address of a scheduler, tcp://HOST:PORT, not {quoted(address)}")
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingDependencyError(
            "--cluster needs Dask: install the extra, pip install 'hexmap[cluster]'"
        ) from error
    try:
        client = Client(address, timeout=_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise FileAccessError(f"{address}: no Dask scheduler answers: {reason(error)}") from error
    with client:
        if not client.scheduler_info(n_workers=-1)["workers"]:
            raise FileAccessError(f"{address}: the Dask scheduler has no workers")
        executor = client.get_executor(pure=False)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)
