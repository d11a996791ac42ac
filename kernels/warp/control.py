"""Loops that the device decides about, work that it repeats as a whole, and who may ask it for work."""

from collections.abc import Callable
from typing import Any

import warp as wp

from .asking import alone, asking
from .memory import number, start
from .threads import is_preparing, launch, once, prepare

__all__ = ["asking", "capture", "is_deterministic", "kernel_cache", "prepare", "repeat"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def _continue_kernel(
    go_on: wp.array(dtype=wp.float64), most: int, count: wp.array(dtype=int), more: wp.array(dtype=int)
):
    more[0] = 0
    if go_on[0] > wp.float64(0.0) and count[0] < most:
        more[0] = 1
        count[0] = count[0] + 1


@once
def _counters(pointer: int, device: str) -> tuple[Any, Any]:
    """Return the turns of a loop and whether it goes on, made in its first run: captured work must not allocate."""
    return wp.zeros(1, dtype=int, device=device), wp.zeros(1, dtype=int, device=device)


def repeat(body: Callable[[], None], go_on: Any, most: int, *, at_once: int = 1) -> None:
    device = go_on.device
    if is_preparing():
        body()
        return
    count, more = _counters(go_on.ptr, device.alias)
    if not device.is_capturing:
        for _ in range(most):
            if number(go_on) <= 0:
                return
            body()
        return

    def look() -> None:
        launch(_continue_kernel, 1, [go_on, most], [count, more], device=device)

    def turn() -> None:
        body()
        look()

    count.zero_()
    look()
    wp.capture_while(more, turn)


def capture(work: Callable[[], None], device: str) -> Callable[[], None] | None:
    if wp.get_device(device).is_cpu:
        return None
    wp.load_module(_continue_kernel.module, device=device)
    with alone(), wp.ScopedCapture(device=device) as captured:
        work()
    return lambda: wp.capture_launch(captured.graph)


def is_deterministic(device: str) -> bool:
    return True  # `splat` adds atomically on a GPU, but no estimate needs it


def kernel_cache() -> str | None:
    start()
    return str(wp.config.kernel_cache_dir)
