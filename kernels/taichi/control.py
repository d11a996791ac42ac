"""Loops that a scalar on the device decides about; Taichi cannot be given work as a whole."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from weakref import WeakKeyDictionary

from taichi.lang import impl

from .memory import DeviceArray, number
from .runtime import on_cpu

_turns: WeakKeyDictionary[DeviceArray, int] = WeakKeyDictionary()
"""Turns of the last loop that a number decided about: a GPU is first waited for after as many."""


def repeat(body: Callable[[], None], go_on: DeviceArray, most: int, *, at_once: int = 1) -> None:
    every = 1 if on_cpu() else at_once
    look = 0 if every == 1 else _turns.get(go_on, every - 1)
    for turn in range(most):
        if turn == look:
            left = number(go_on)
            if left <= 0:
                _turns[go_on] = turn + int(left)
                return
            look += every
        body()


def capture(work: Callable[[], None], device: str) -> None:
    return None


def asking(device: str) -> AbstractContextManager[object]:
    return nullcontext()  # nothing is captured here


def is_deterministic(device: str) -> bool:
    return device == "cpu"  # a GPU adds up the prediction atomically, in an order of its own


def kernel_cache() -> str | None:
    return str(impl.default_cfg().offline_cache_file_path)


def prepare(work: Callable[[], None], device: str) -> None:
    work()
