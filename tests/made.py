"""What tests start from: results that nobody estimated, masked light fields, other arrays, failures, thorough cases."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from lfgpu.data import DepthResult, LightField
from lfgpu.methods import PRESETS


def made_result(disparity: np.ndarray, confidence: Any = 0.5, **fields: Any) -> DepthResult:
    """A result of `fast` with that map and confidence, and with `fields` in the place of what others do not look at."""
    usual = {"stages": {"sweep": disparity}, "position": (1.0, 1.0), "disparity_range": (-2.0, 2.0)}
    usual |= {"config": PRESETS["fast"], "status": "It stopped.", "converged": True, "trace": ()}
    usual |= {"timings": {"total": 1.0}, "backend": "warp", "device": "cpu", "versions": {"lfgpu": "0.1.0"}}
    confidence = np.broadcast_to(np.float32(confidence), disparity.shape).copy()
    return DepthResult(disparity, confidence, **(usual | fields))


def masked(lf: LightField, *places: Any) -> LightField:
    """The light field with the pixels at those places, of [n, y, x], masked."""
    valid = np.ones(lf.views.shape[:3], np.bool_)
    for place in places:
        valid[place] = False
    return replace(lf, valid=valid)


class Tensor:
    """An array in the CPU's memory of a library that is not NumPy: what DLPack asks for, and a type with a prefix."""

    def __init__(self, values: np.ndarray) -> None:
        self._values = values
        self.shape, self.dtype = values.shape, f"torch.{values.dtype}"

    def __dlpack__(self, **options: Any) -> Any:
        return self._values.__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self._values.__dlpack_device__()


def raising(error: BaseException) -> Callable[..., None]:
    """Make a function that fails with the error, whatever it is given."""

    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def thorough(*values: Any, **named: Any) -> Any:
    """A case of a parametrised test that `make test` leaves out."""
    return pytest.param(*values, marks=pytest.mark.thorough, **named)
