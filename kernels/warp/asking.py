"""Who may ask a device for work, and when.

Warp has one current stream for each device, whatever the thread. It changes it for a moment in `wp.array` and in
`.numpy()`, and a capture concerns the whole process. So threads take turns.
"""

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import warp as wp

from .threads import once

_CAPTURING = threading.RLock()


@once
def asking(device: str) -> Any:
    """One lock for each device: threads take turns to ask it, and devices do not wait for each other."""
    return threading.RLock()


@contextmanager
def alone() -> Iterator[None]:
    """Held while work is captured: nobody else may ask any device meanwhile.

    Whoever captures must not hold `asking` of one device while another thread captures with that of another device.
    """
    with _CAPTURING, ExitStack() as held:
        for device in wp.get_devices():
            held.enter_context(asking(device.alias))
        yield
