"""What each worker process of a local cluster begins with (Dask calls this a preload)."""

from __future__ import annotations

import signal
from typing import Any


def dask_setup(_: Any) -> None:
    """Leave Ctrl-C, which a terminal sends to all processes, to the one that ends the batch."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
