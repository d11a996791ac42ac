"""The trace of an iterative linear solver, and when it ends: NumPy, float64."""

import math

import numpy as np

from lfgpu.contract import Float64Array as Array


class residuals:
    """The relative residuals so far."""

    def __init__(self, device: str, *, tolerance: float, most: int) -> None:
        self.go_on: Array = np.zeros(1)
        self._tolerance, self._most = tolerance, most
        self._norm = 1.0
        self._trace: list[float] = []

    def begin(self, norm: Array) -> None:
        self._norm = float(norm[0]) or 1.0
        self._trace = []
        self.go_on[0] = 1

    def add(self, residual: Array) -> None:
        if self.go_on[0] <= 0:
            self.go_on[0] -= 1
            return
        self._trace.append(math.sqrt(max(float(residual[0]), 0.0) / self._norm))
        if not (self._trace[-1] > self._tolerance and len(self._trace) < self._most + 1):
            self.go_on[0] = 0

    def report(self) -> list[float]:
        return list(self._trace)
