"""What goes wrong, said in one sentence that a person can act on."""

from lfgpu.printable import message


class LfgpuError(Exception):
    """Base of every error that lfgpu raises on purpose; its text is one sentence for the user, safe to be shown."""

    def __init__(self, text: str = "") -> None:
        super().__init__(message(text))


class LightFieldError(LfgpuError, ValueError):
    """A light field, file, map or parameter is not what it has to be."""


class BackendError(LfgpuError, RuntimeError):
    """A kernel backend or a device that was asked for is not there."""
