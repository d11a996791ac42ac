"""The one seam between the host side and the kernels: a backend's name becomes its `KernelSet`."""

from __future__ import annotations

import importlib
from typing import cast

from lfgpu.errors import BackendError
from lfgpu.types import KernelSet

_PACKAGES = {"warp": "warp-lang", "reference": "numpy"}  # backend -> what pip calls what it needs

DEFAULT = "warp"


def list_backends() -> tuple[str, ...]:
    """Names of all backends, the default first; whether one can run here is known when it is loaded."""
    return tuple(_PACKAGES)


def load(backend: str = DEFAULT) -> KernelSet:
    """The operations of a backend; BackendError if it is unknown or what it needs is not installed."""
    if backend not in _PACKAGES:
        raise BackendError(f"unknown backend {backend!r}; there are {', '.join(_PACKAGES)}.")
    try:
        module = importlib.import_module(f"lfgpu.kernels.{backend}")
    except ImportError as error:
        raise BackendError(
            f"backend {backend!r} cannot be loaded ({error}); install it with: pip install {_PACKAGES[backend]}"
        ) from error
    return cast(KernelSet, module.KERNELS)


def pick_device(kernels: KernelSet, device: str | None) -> str:
    """The device to run on: the backend's default for None, "cuda" for the first GPU; BackendError if not there."""
    devices = kernels.devices()
    if device is None:
        return devices[0]
    wanted = "cuda:0" if device == "cuda" else device
    if wanted not in devices:
        raise BackendError(f"backend {kernels.name!r} sees no device {device!r} here; there is {', '.join(devices)}.")
    return wanted
