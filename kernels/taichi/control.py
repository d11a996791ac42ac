"""Loops that a scalar on the device decides about; Taichi cannot be given work as a whole."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from taichi.lang import impl

from .memory import DeviceArray, number
from .runtime import on_cpu


def repeat(body: Callable[[], None], go_on: DeviceArray, most: int, *, at_once: int = 1) -> None:
    for turn in range(1, most + 1):
        if (on_cpu() or turn % at_once == 0) and number(go_on) == 0:
            return
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
