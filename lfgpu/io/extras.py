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
            f"reading {path} needs {module.partition('.')[0]}, which is not installed; {how_to_install(extra)}."
        ) from error


def how_to_install(extra: str) -> str:
    """Say how to install the libraries of an extra, as the last part of a sentence."""
    return f"install it from the folder of lfgpu's source: pip install -e '.[{extra}]'"
