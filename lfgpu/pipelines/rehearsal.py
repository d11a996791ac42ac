"""Kernels compiled and loaded before the clock of an estimate starts: a method runs once on a corner of the views."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import Any

from lfgpu.contract import Device
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.base import Method
from lfgpu.methods.measured import Measured

_SIDE = 32  # pixels of the corner

_known: set[tuple[object, ...]] = set()
_lock = threading.Lock()


class Rehearsal:
    """A method on the middle of the views of a light field, whose results nobody looks at.

    Kernels are compiled when they are first used, which takes seconds to a minute, and kept on the disk. Which ones are
    used depends on the method, the stored type, channels, number and masks of the views, and a little on the range.

    Parameters
    ----------
    method, lf, device
        What will run, and where.
    """

    def __init__(self, method: Method[Any], lf: LightField, device: Device) -> None:
        self._method, self._device = method, device
        views = lf.views.dtype.str, lf.channels, lf.valid is None, len(lf.views)
        self._kind = method.config, device, *views
        (top, bottom), (left, right) = (_middle(side) for side in lf.size)
        self._lf = lf.crop(slice(top, bottom), slice(left, right))

    def measure(self, disparity_range: tuple[float, float] | None) -> None:
        """Load what finds the range and the noise."""
        if self._is_new("found" if disparity_range is None else "given"):
            with suppress(LightFieldError):  # so little of the views may show nothing
                self._method.measure(self._lf, self._device, disparity_range=disparity_range)

    def run(self, measured: Measured) -> None:
        """Load what the stages use; waits for the device."""
        if not self._is_new("stages"):
            return
        views = self._device.image(self._lf.views)
        waited_for = self._device.scalar(0.0)
        with suppress(LightFieldError):
            for work in self._method.plan(self._lf.layout, measured, self._device).stages(views).values():
                work(None)
        self._device.kernels.number(waited_for)

    def _is_new(self, part: str) -> bool:
        """Whether that part of such a kind has not been loaded in this process; from now on it counts as loaded."""
        with _lock:
            before = len(_known)
            _known.add((part, *self._kind))
            return self._device.kernels.compiles and len(_known) > before


def _middle(side: int) -> tuple[int, int]:
    first = max(0, (side - _SIDE) // 2)
    return first, min(side, first + _SIDE)
