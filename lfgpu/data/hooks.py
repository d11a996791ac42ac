"""What rooms above add to light fields and results: how they are saved, and how notebooks show them.

`lfgpu/__init__.py` attaches the functions, so that nothing here imports them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

_attached: dict[str, Callable[..., Any]] = {}


def attach(name: str, function: Callable[..., Any]) -> None:
    """Let `call(name, ...)` call a function."""
    _attached[name] = function


def call(name: str, *arguments: Any, **options: Any) -> Any:
    """Call what is attached under a name."""
    return _attached[name](*arguments, **options)
