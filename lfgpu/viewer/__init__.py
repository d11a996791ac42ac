"""The viewer in the browser: `lfgpu view`, `lfgpu.Viewer`; needs the extra `lfgpu[viewer]`.

Importing it loads no web server; that is loaded when `Viewer` is first used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfgpu.viewer.server import Viewer

__all__ = ["Viewer"]


def __getattr__(name: str) -> Any:
    if name != "Viewer":
        raise AttributeError(f"module 'lfgpu.viewer' has no attribute {name!r}")
    from lfgpu.viewer.server import Viewer

    return Viewer
