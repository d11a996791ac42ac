"""Arrays of other libraries: their device, dtype and shape, from DLPack or the CUDA array interface."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError

SOME_GPU = "a GPU"
"""The place of an array on a GPU that does not say which one."""

_HOST, _CUDA = (1, 3), (2, 13)  # device types of DLPack: CPU memory, pageable or pinned; GPU memory, plain or managed


def place_of(name: str, values: Any) -> str:
    """Find the device of an array called `name`: "cpu", "cuda:0" and so on, or `SOME_GPU`; others are refused."""
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        raise LightFieldError(f"{name} are masked here and there, but only a LightField takes masks; fill them first.")
    if isinstance(values, np.ndarray):
        return "cpu"
    if hasattr(values, "__dlpack_device__"):
        try:
            kind, index = values.__dlpack_device__()
        except Exception as error:  # the library of the array may raise anything
            raise LightFieldError(f"{name} cannot be read ({_said(error)}); convert them to NumPy first.") from error
        if kind not in (*_HOST, *_CUDA):
            raise LightFieldError(
                f"{name} are neither on a CPU nor on a CUDA GPU (DLPack device type {int(kind)}); copy them to the CPU "
                "first."
            )
        return "cpu" if kind in _HOST else f"cuda:{index}"
    if hasattr(values, "__cuda_array_interface__"):
        return SOME_GPU
    if hasattr(values, "__array__") or hasattr(values, "__array_interface__"):
        return "cpu"
    raise LightFieldError(f"{name} must be an array, not {type(values).__name__}.")


def kind_of(name: str, values: Any) -> tuple[str, tuple[int, ...]]:
    """(dtype, shape) of an array, with NumPy's name of the dtype; LightFieldError if it is not an array."""
    try:
        dtype, shape = values.dtype, tuple(values.shape)
    except Exception:
        raise LightFieldError(
            f"{name} must be an array with a dtype and a shape, not {type(values).__name__}."
        ) from None
    if isinstance(dtype, type):  # of Warp
        return dtype.__name__, shape
    return str(dtype).removeprefix("torch."), shape


def on_host(name: str, values: Any) -> NDArray[Any]:
    """Return a NumPy array with the same values; copy only if it is on a GPU, or if its library requires it."""
    if isinstance(values, np.ndarray):
        return values
    place = place_of(name, values)
    try:
        if place != "cpu":
            return np.from_dlpack(values, device="cpu")
        return np.from_dlpack(values) if hasattr(values, "__dlpack__") else np.asarray(values)
    except Exception as error:  # the library of the array may raise anything
        where = "" if place == "cpu" else f" on {place}"
        raise LightFieldError(f"{name}{where} cannot be read ({_said(error)}); convert them to NumPy first.") from error


def _said(error: BaseException) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
