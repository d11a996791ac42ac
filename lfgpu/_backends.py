"""The one seam between the host side and the kernels: a backend's name becomes its `KernelSet`."""

from __future__ import annotations

import importlib
import importlib.metadata
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, TypeAlias, cast

from lfgpu.errors import BackendError

if TYPE_CHECKING:
    from lfgpu.contract import KernelSet

_PACKAGES = {"warp": "warp-lang", "taichi": "taichi", "reference": "numpy"}  # backend -> what pip calls what it needs

BackendName: TypeAlias = Literal["warp", "taichi", "reference"]
"""The names of the backends, for type checkers."""

DEFAULT: Final[BackendName] = "warp"


@dataclass(frozen=True)
class BackendInfo:
    """What of a backend is here.

    Parameters
    ----------
    name
        The name under which it is asked for.
    package, version
        What pip calls what it needs, and the version that is installed; None if there is none.
    devices
        Names of the devices that it sees, its default first; none if it cannot be loaded.
    problem
        Why it cannot be loaded; None if it can.
    remedy
        The command that would install what it needs; None if nothing is missing.
    """

    name: str
    package: str
    version: str | None
    devices: tuple[str, ...] = ()
    problem: str | None = None
    remedy: str | None = None


def list_backends() -> tuple[str, ...]:
    """Names of all backends, the default first; whether one can run here is known when it is loaded."""
    return tuple(_PACKAGES)


def describe_backends() -> tuple[BackendInfo, ...]:
    """What of each backend is here, the default first. Loads them all; one that fails says why and hides no other."""
    return tuple(_describe(backend) for backend in _PACKAGES)


def package_of(backend: str) -> str:
    """What pip calls the package that a backend computes with."""
    return _PACKAGES[backend]


def backend_named(backend: str) -> BackendName:
    """The name of a backend, from text; BackendError if there is none of that name."""
    if backend not in _PACKAGES:
        raise BackendError(f"unknown backend {backend!r}; there are {', '.join(_PACKAGES)}.")
    return cast("BackendName", backend)


def load(backend: str = DEFAULT) -> KernelSet:
    """The operations of a backend; BackendError if it is unknown or what it needs is not installed or broken."""
    backend_named(backend)
    try:
        module = importlib.import_module(f"lfgpu.kernels.{backend}")
    except Exception as error:  # a broken installation raises anything: OSError, AttributeError, RuntimeError
        raise BackendError(
            f"backend {backend!r} cannot be loaded ({_said(error)}); install it with: {_remedy(backend)}"
        ) from error
    return cast("KernelSet", module.KERNELS)


def pick_device(kernels: KernelSet, device: str | None) -> str:
    """The device to run on: the backend's default for None, "cuda" for the first GPU; BackendError if not there."""
    devices = kernels.devices()
    if device is None:
        return devices[0]
    wanted = "cuda:0" if device == "cuda" else device
    if wanted not in devices:
        raise BackendError(f"backend {kernels.name!r} sees no device {device!r} here; there is {', '.join(devices)}.")
    return wanted


def _describe(backend: str) -> BackendInfo:
    package = _PACKAGES[backend]
    version = _version(package)
    try:
        kernels = load(backend)
    except BackendError as error:
        problem = f"cannot be loaded: {_said(error.__cause__ or error)}"
        return BackendInfo(backend, package, version, problem=problem, remedy=_remedy(backend))
    try:
        return BackendInfo(backend, package, version, kernels.devices())
    except Exception as error:  # a driver that fails raises anything
        return BackendInfo(backend, package, version, problem=f"cannot list its devices: {_said(error)}")


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None


def _remedy(backend: str) -> str:
    """What is there and cannot be loaded is broken: pip would leave it as it is unless it is told not to."""
    package = _PACKAGES[backend]
    return f"pip install {package}" if _version(package) is None else f"pip install --force-reinstall {package}"


def _said(error: BaseException) -> str:
    """The message of an error in one line; what kind it is where that is not plain from the message."""
    message = " ".join(str(error).split())
    return message if message and isinstance(error, ImportError) else f"{type(error).__name__}: {message}".rstrip(": ")
