"""Helpers of tests of solvers: both solvers, and their outcome."""

from typing import NamedTuple

import numpy as np
import pytest

from lfgpu.solvers.lbfgs import BoundedLbfgs
from lfgpu.solvers.lbfgsb import ScipyLbfgsb
from lfgpu.solvers.solution import Solution

Solver = type[BoundedLbfgs] | type[ScipyLbfgsb]
both = pytest.mark.parametrize("solver", [BoundedLbfgs, ScipyLbfgsb])


class Found(NamedTuple):
    """The values that a solver left on the device, and its report."""

    values: np.ndarray
    solution: Solution


def assert_sentence(status: str) -> None:
    assert status.endswith(".")
    assert len(status.split()) >= 6
