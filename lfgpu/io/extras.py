"""Libraries that only some formats need."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

from lfgpu.errors import LightFieldError


def require(module: str, extra: str, path: Path) -> Any:
    """Import an optional library; LightFieldError that says how to install it where it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise LightFieldError(
            f"reading {path} needs {module.partition('.')[0]}, which is not installed; install it with: "
            f"pip install 'lfgpu[{extra}]'."
        ) from error
