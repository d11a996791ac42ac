"""Hooks to higher packages: how results are saved and shown in notebooks, and how their cameras are judged.

`lfgpu/__init__.py` attaches the functions, so that this package does not import them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_attached: dict[str, Callable[..., Any]] = {}


def attach(name: str, function: Callable[..., Any]) -> None:
    """Attach a function to a name, for `call`."""
    _attached[name] = function


def call(name: str, *arguments: Any, **options: Any) -> Any:
    """Call the function that is attached to a name."""
    return _attached[name](*arguments, **options)
