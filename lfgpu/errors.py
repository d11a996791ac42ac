"""The errors of lfgpu. Each message is one sentence for the user."""

from lfgpu.printable import message


class LfgpuError(Exception):
    """Base of every error that lfgpu raises on purpose; its text is one sentence for the user, safe to be shown."""

    def __init__(self, text: str = "") -> None:
        super().__init__(message(text))


class LightFieldError(LfgpuError, ValueError):
    """A light field, file, map or parameter is wrong."""


class BackendError(LfgpuError, RuntimeError):
    """A backend or a device is missing, or cannot do what was asked."""
