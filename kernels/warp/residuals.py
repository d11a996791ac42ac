"""The residual after each iteration of a linear solver, kept on the device."""

from typing import Any

import warp as wp

from .asking import asking
from .memory import scalar
from .threads import launch

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _begin_kernel(
    norm: wp.array(dtype=wp.float64),
    norm_out: wp.array(dtype=wp.float64),
    length_out: wp.array(dtype=int),
    go_on_out: wp.array(dtype=wp.float64),
):
    norm_out[0] = wp.where(norm[0] == wp.float64(0.0), wp.float64(1.0), norm[0])
    length_out[0] = 0
    go_on_out[0] = wp.float64(1.0)


@wp.kernel
def _add_kernel(
    residual: wp.array(dtype=wp.float64),
    norm: wp.array(dtype=wp.float64),
    tolerance: wp.float64,
    length: wp.array(dtype=int),
    trace_out: wp.array(dtype=wp.float64),
    go_on_out: wp.array(dtype=wp.float64),
):
    if go_on_out[0] <= wp.float64(0.0):
        go_on_out[0] = go_on_out[0] - wp.float64(1.0)
        return
    left = wp.where(residual[0] < wp.float64(0.0), wp.float64(0.0), residual[0])  # what is not a number stays visible
    relative = wp.sqrt(left / norm[0])
    trace_out[length[0]] = relative
    length[0] = length[0] + 1
    if not (relative > tolerance and length[0] < trace_out.shape[0]):
        go_on_out[0] = wp.float64(0.0)


class residuals:
    def __init__(self, device: str, *, tolerance: float, most: int) -> None:
        self.go_on, self._norm, self._tolerance = scalar(1.0, device), scalar(1.0, device), tolerance
        self._length = wp.zeros(1, dtype=int, device=device)
        self._trace = wp.zeros(most + 1, dtype=wp.float64, device=device)

    def begin(self, norm: Any) -> None:
        outputs = [self._norm, self._length, self.go_on]
        launch(_begin_kernel, 1, [norm], outputs, device=self.go_on.device)

    def add(self, residual: Any) -> None:
        inputs = [residual, self._norm, self._tolerance, self._length]
        launch(_add_kernel, 1, inputs, [self._trace, self.go_on], device=self.go_on.device)

    def report(self) -> list[float]:
        with asking(self._trace.device.alias):
            return [float(value) for value in self._trace.numpy()[: self._length.numpy()[0]]]
