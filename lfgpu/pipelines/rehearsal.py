"""Rehearsal of a method on a small part of the views: kernels are compiled and loaded before its clock starts."""

import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from lfgpu.contract import Device
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.base import Method
from lfgpu.methods.disparity_range import find_disparity_range
from lfgpu.methods.measured import Measured

_SIDE = 48  # pixels of the part: the least that the search for a range looks at in two sizes
_RANGE = -1.0, 1.0  # pixels per view step: any will do

_known: set[tuple[object, ...]] = set()
_lock = threading.Lock()


class Rehearsal:
    """Method on the middle of the views of a light field; what it computes, if anything, is thrown away.

    Kernels are compiled when they are first used, which takes seconds to a minute, and kept on the disk. Which ones are
    used depends on the method, the stored type, channels, number and masks of the views, and a little on the range.
    """

    def __init__(
        self, method: Method[Any], lf: LightField, device: Device, *, used: Sequence[int] | None = None
    ) -> None:
        self._method, self._device = method, device
        middle = lf.crop(*(slice(max(0, (side - _SIDE) // 2), min(side, (side + _SIDE) // 2)) for side in lf.size))
        self._lf = middle if used is None else middle.subset(used)
        views = lf.views.dtype.str, lf.channels, lf.valid is None, len(self._lf.views)
        self._kind = method.config, device, *views

    def measure(self, disparity_range: tuple[float, float] | None) -> None:
        """Load the kernels that find the range and the noise."""
        if not self._is_new("found" if disparity_range is None else "given"):
            return

        def measure() -> None:
            if disparity_range is None:
                with suppress(LightFieldError):  # so little of the views may show nothing
                    find_disparity_range(self._lf, self._device)
            self._method.measured(self._lf, bounds, self._device)

        bounds = disparity_range or _RANGE
        self._device.kernels.prepare(measure, self._device.name)
        self._method.measured(self._lf, bounds, self._device)  # other kernels measure views with grain

    def run(self, measured: Measured) -> None:
        """Load the kernels of the stages; waits for the device."""
        if not self._is_new("stages"):
            return
        views = self._device.image(self._lf.views)
        waited_for = self._device.scalar(0.0)

        def follow() -> None:
            with suppress(LightFieldError):
                for work in self._method.plan(self._lf.layout, measured, self._device).stages(views).values():
                    work(None)

        if self._method.is_on_device:
            self._device.kernels.prepare(follow, self._device.name)
        else:  # a solver on the host goes by what the device computes
            follow()
        self._device.kernels.number(waited_for)

    def _is_new(self, part: str) -> bool:
        """Tell whether that part of such a kind was never loaded in this process; from now on it counts as loaded."""
        with _lock:
            before = len(_known)
            _known.add((part, *self._kind))
            return self._device.kernels.compiles and len(_known) > before
