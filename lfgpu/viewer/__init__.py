"""The viewer in the browser: `lfgpu view`, `lfgpu.Viewer`; needs the extra `lfgpu[viewer]`."""

from lfgpu.viewer.server import Viewer

__all__ = ["Viewer"]
