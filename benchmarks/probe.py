"""Which devices a backend sees, found in a process of its own: `python -m benchmarks.probe BACKEND OUT`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from lfgpu._backends import load
from lfgpu.errors import BackendError


def main() -> None:
    """Write {"devices": [...]} or {"reason": "..."} to the file OUT."""
    backend, out = sys.argv[1:]
    try:
        found: dict[str, object] = {"devices": load(backend).devices()}
    except BackendError as error:
        found = {"reason": str(error)}
    Path(out).write_text(json.dumps(found))


main()
