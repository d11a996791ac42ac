"""The start-up code of worker processes of a local cluster (a preload of Dask)."""

import signal
from typing import Any


def dask_setup(_: Any) -> None:
    """Ignore Ctrl-C, which a terminal sends to all processes; the main process ends the batch."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
