"""Work as a file that Warp's native libraries replay without Python (`lfgpu/contract/recording.py`)."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import warp as wp

from .asking import alone


def version() -> str:
    """The version of Warp, to which files are tied."""
    return str(wp.config.version)


def libraries() -> tuple[Path, Path]:
    """The folders of Warp's libraries and of their headers."""
    root = Path(wp.__file__).parent
    return root / "bin", root / "native"


def save(work: Callable[[], None], path: Path, *, device: str, inputs: dict[str, Any], outputs: dict[str, Any]) -> None:
    """Record `work`, which must have run once before, and write it to `path` (.wrp) and a folder of modules beside it.

    On a CPU it must ask for everything from the thread that calls this.
    """
    with alone(), wp.ScopedCapture(device=device, apic=True) as capture:
        work()
    wp.capture_save(capture.graph, str(path), inputs=inputs, outputs=outputs)
