"""Arrays of other libraries: where they are and what they hold, by DLPack and the CUDA array interface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError

SOME_GPU = "a GPU"
"""The place of arrays that do not say which GPU they are on."""

_HOST, _CUDA = (1, 3), (2, 13)  # DLPack's device types: memory of the CPU, pinned or not; of a GPU, managed or not


def place_of(name: str, values: Any) -> str:
    """Where an array is: "cpu", "cuda:0" and so on, or SOME_GPU; LightFieldError if it is nowhere that is known.

    `name` is what to call it in messages.
    """
    if isinstance(values, np.ndarray):
        return "cpu"
    if hasattr(values, "__dlpack_device__"):
        try:
            kind, index = values.__dlpack_device__()
        except Exception as error:  # the library of the array may raise anything
            raise LightFieldError(f"{name} cannot be read ({_said(error)}); convert them to NumPy first.") from error
        if kind not in (*_HOST, *_CUDA):
            raise LightFieldError(
                f"{name} are on a device of another kind (DLPack calls it {int(kind)}); copy them first."
            )
        return "cpu" if kind in _HOST else f"cuda:{index}"
    if hasattr(values, "__cuda_array_interface__"):
        return SOME_GPU
    if hasattr(values, "__array__") or hasattr(values, "__array_interface__"):
        return "cpu"
    raise LightFieldError(f"{name} must be an array, not {type(values).__name__}.")


def kind_of(name: str, values: Any) -> tuple[str, tuple[int, ...]]:
    """(dtype, shape) of an array, with NumPy's name of the dtype; LightFieldError if it does not say."""
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
    """An array as one of NumPy, copied only if it is not in the memory of the CPU, or its library must."""
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
