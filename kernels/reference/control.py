"""Loops and recorded work: here the host is the device, so that there is nothing to record."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
from numpy.typing import NDArray


def kernel_cache() -> None:
    return None


def repeat(body: Callable[[], None], go_on: NDArray[np.float64], most: int, *, at_once: int = 1) -> None:
    for _ in range(most):
        if go_on[0] <= 0:
            return
        body()


def capture(work: Callable[[], None], device: str) -> Callable[[], None] | None:
    return None


def asking(device: str) -> AbstractContextManager[object]:
    return nullcontext()  # nothing is captured here


def is_deterministic(device: str) -> bool:
    return True


def prepare(work: Callable[[], None], device: str) -> None:
    work()
