"""The backends: finding, describing and loading them. A name becomes a `KernelSet`."""

from __future__ import annotations

import importlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, TypeAlias, cast

from lfgpu.errors import BackendError
from lfgpu.machine import version_of
from lfgpu.vulkan import choose

if TYPE_CHECKING:
    from lfgpu.contract import Device, KernelSet

_PACKAGES = {"warp": "warp-lang", "taichi": "taichi", "reference": "numpy"}  # backend -> the package that it needs

BackendName: TypeAlias = Literal["warp", "taichi", "reference"]
"""The names of the backends, for type checkers."""

DEFAULT: Final[BackendName] = "warp"


@dataclass(frozen=True)
class BackendInfo:
    """Facts about a backend on this machine.

    Parameters
    ----------
    name
        Its name.
    package, version
        The package that it needs, and the installed version; None if it is not installed.
    devices
        The devices that it can use, the default first; empty if it cannot be loaded.
    problem
        Why it cannot be loaded; None if it can.
    remedy
        The command that installs the package; None if nothing is missing.
    """

    name: str
    package: str
    version: str | None
    devices: tuple[str, ...] = ()
    problem: str | None = None
    remedy: str | None = None


def list_backends() -> tuple[str, ...]:
    """Names of all backends, the default first. Some may not be installed; see `describe_backends`.

    Examples
    --------
    >>> "warp" in lfgpu.list_backends()
    True
    """
    return tuple(_PACKAGES)


def describe_backends() -> tuple[BackendInfo, ...]:
    """Describe all backends, the default first. Loads each; one that fails has a `problem`.

    Examples
    --------
    >>> sorted(info.name for info in lfgpu.describe_backends())
    ['reference', 'taichi', 'warp']
    """
    return tuple(_describe(backend) for backend in _PACKAGES)


def package_of(backend: str) -> str:
    """Return the package that a backend needs."""
    return _PACKAGES[backend]


def backend_named(backend: str) -> BackendName:
    """Return the name of a backend that a text gives; BackendError if there is none of that name."""
    if backend not in list_backends():
        raise BackendError(f"unknown backend {backend!r}; use one of {', '.join(_PACKAGES)}.")
    return cast("BackendName", backend)


def load(backend: str = DEFAULT) -> KernelSet:
    """Load a backend; BackendError if it is unknown, or if its package is missing or broken."""
    backend_named(backend)
    _forget_caches_nowhere()
    try:
        module = importlib.import_module(f"lfgpu.kernels.{backend}")
    except Exception as error:  # a broken installation raises anything: OSError, AttributeError, RuntimeError
        raise BackendError(
            f"backend {backend!r} cannot be loaded ({_said(error)}); install it with: {_remedy(backend)}"
        ) from error
    return cast("KernelSet", module.KERNELS)


def _forget_caches_nowhere() -> None:
    """Forget variables that name no folder: native code would be kept in the current one, and loaded from it."""
    if os.environ.get("WARP_CACHE_PATH") == "":
        del os.environ["WARP_CACHE_PATH"]
    caches = os.environ.get("XDG_CACHE_HOME")
    if caches is not None and not Path(caches).is_absolute():  # as its specification says
        del os.environ["XDG_CACHE_HOME"]


def pick_device(kernels: KernelSet, device: str | None) -> str:
    """Choose a device: None is the default of the backend, "cuda" the first GPU. BackendError if it is missing."""
    devices = kernels.devices()
    if device is None:
        return devices[0]
    wanted = "cuda:0" if str(device) == "cuda" else str(device)  # of PyTorch, too
    if wanted not in devices:
        raise BackendError(
            f"backend {kernels.name!r} finds no device {device!r}; use one of {', '.join(devices)}{_why_not(wanted)}."
        )
    return wanted


def alike(kernels: KernelSet, device: str) -> tuple[str, ...]:
    """Return the devices of the same kind, over which work may be spread: all CUDA devices for one of them."""
    kind = device.partition(":")[0]
    return tuple(name for name in kernels.devices() if name.partition(":")[0] == kind)


def _why_not(device: str) -> str:
    """Say how GPUs are named if `device` is no such name; else why a Metal or Vulkan device is missing."""
    if device.partition(":")[0] not in ("cuda", "metal", "vulkan"):
        return "; GPUs are named cuda (the first), cuda:1 and so on, vulkan or metal"
    if device == "metal":
        return "; Metal needs macOS on Apple silicon and the backend 'taichi'"
    if device == "vulkan":
        try:
            found = choose()
        except BackendError as error:
            return f"; {str(error).rstrip('.')}"
        return f"; the backend 'taichi' runs on {found.name}"
    return ""


def open_device(backend: str = DEFAULT, device: str | None = None) -> Device:
    """Open a device of a backend, by name; None and errors as for `load` and `pick_device`."""
    from lfgpu.contract import Device  # needs NumPy, which listing backends does not

    kernels = load(backend)
    return Device(kernels, pick_device(kernels, device))


def _describe(backend: str) -> BackendInfo:
    package = _PACKAGES[backend]
    version = version_of(package)
    try:
        kernels = load(backend)
    except BackendError as error:
        problem = f"cannot be loaded: {_said(error.__cause__ or error)}"
        return BackendInfo(backend, package, version, problem=problem, remedy=_remedy(backend))
    try:
        return BackendInfo(backend, package, version, kernels.devices())
    except Exception as error:  # a driver that fails raises anything
        return BackendInfo(backend, package, version, problem=f"cannot list its devices: {_said(error)}")


def _remedy(backend: str) -> str:
    """Return the command that repairs a backend. An installed but broken package is reinstalled by force."""
    package = _PACKAGES[backend]
    return f"pip install {package}" if version_of(package) is None else f"pip install --force-reinstall {package}"


def _said(error: BaseException) -> str:
    """Return the message of an error in one line, with its type if it is not an ImportError."""
    message = " ".join(str(error).split())
    return message if message and isinstance(error, ImportError) else f"{type(error).__name__}: {message}".rstrip(": ")
