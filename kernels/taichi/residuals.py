"""The residual after each iteration of a linear solver, kept on the device."""

from types import SimpleNamespace

import numpy as np
import taichi as ti

from .memory import DeviceArray, doubles, flat, numpy, scalar
from .runtime import double, once, run

_NORM, _LENGTH = range(2)  # places in the state; the length is that of the trace


@once
def _kernels() -> SimpleNamespace:
    real = double()
    numbers = flat(real)

    @ti.kernel
    def begin_kernel(norm: numbers, state_out: numbers, go_on_out: numbers):
        state_out[_NORM] = norm[0]
        if norm[0] == 0.0:
            state_out[_NORM] = 1.0
        state_out[_LENGTH] = 0.0
        go_on_out[0] = 1.0

    @ti.kernel
    def add_kernel(residual: numbers, tolerance: real, state: numbers, trace_out: numbers, go_on_out: numbers):
        if go_on_out[0] > 0.0:
            last = ti.cast(state[_LENGTH], ti.i32)
            relative = ti.sqrt(ti.max(residual[0], ti.cast(0.0, real)) / state[_NORM])
            trace_out[last] = relative
            state[_LENGTH] = ti.cast(last + 1, real)
            if not (relative > tolerance and last + 1 < trace_out.shape[0]):
                go_on_out[0] = 0.0
        else:
            go_on_out[0] = go_on_out[0] - 1.0

    return SimpleNamespace(begin=begin_kernel, add=add_kernel)


class residuals:
    def __init__(self, device: str, *, tolerance: float, most: int) -> None:
        self.go_on, self._tolerance = scalar(1.0, device), tolerance
        self._state, self._trace = doubles(np.array([1.0, 0.0])), doubles(np.zeros(most + 1))

    def begin(self, norm: DeviceArray) -> None:
        run(_kernels().begin, norm, self._state, self.go_on)

    def add(self, residual: DeviceArray) -> None:
        run(_kernels().add, residual, self._tolerance, self._state, self._trace, self.go_on)

    def report(self) -> list[float]:
        return [float(value) for value in numpy(self._trace)[: int(numpy(self._state)[_LENGTH])]]
