"""Slices of work for the cores of a CPU: Warp runs each launch on one thread, so every slice is launched from its own.

How the work is cut does not depend on the number of threads, so neither do the results.
"""

import os
import threading
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import lru_cache, partial, wraps
from typing import Any, TypeVar

import warp as wp

from lfgpu.errors import BackendError
from lfgpu.threads import get_threads

from .cache import from_cache

_SLICES = 16
_MANY = 2**18  # pixels: to cut light work on fewer of them takes longer than the work
_MOST_THREADS = 2**31 - 1  # of a launch that counts them in 32 bits
LOADING = threading.RLock()
"""Held while something is made that is made once, such as a compiled kernel."""

Result = TypeVar("Result")


def once(function: Callable[..., Result]) -> Callable[..., Result]:
    """Call a function once for each set of arguments and keep what it returned; other threads wait meanwhile."""
    kept: dict[tuple[Hashable, ...], Result] = {}

    @wraps(function)
    def call(*arguments: Hashable) -> Result:
        if arguments not in kept:  # what is there is taken without waiting for others that make something else
            with LOADING:
                if arguments not in kept:
                    kept[arguments] = function(*arguments)
        return kept[arguments]

    return call


def in_slices(device: Any, count: int, work: Callable[[int, int, int], None]) -> None:
    """Call work(slice, first, last) for slices of range(count): one for all on a GPU, several at a time on a CPU.

    On a CPU `work` asks for nothing but launches: what is recorded of it runs them side by side.
    """
    cuts, threads = slices(device, count), get_threads()
    if len(cuts) == 1 or threads == 1:
        marks = len(cuts) > 1 and getattr(_marking, "on", False)
        for k, (first, last) in enumerate(cuts):
            if marks:
                wp.launch(slice_begins_kernel, 1, device=device)
            work(k, first, last)
        if marks:
            wp.launch(slices_end_kernel, 1, device=device)
        return
    for done in [_pool(threads).submit(work, k, first, last) for k, (first, last) in enumerate(cuts)]:
        done.result()


@wp.kernel(module="lfgpu_slices", enable_backward=False)
def slice_begins_kernel():
    pass


@wp.kernel(module="lfgpu_slices", enable_backward=False)
def slices_end_kernel():
    pass


MARKS = slice_begins_kernel, slices_end_kernel
"""Launched before each slice of one call, and after the last, in work that is recorded: slices may run side by side."""

_marking = threading.local()


@contextmanager
def marked_slices() -> Iterator[None]:
    """While the block runs, what this thread has done in slices of a CPU is marked."""
    _marking.on = True
    try:
        yield
    finally:
        _marking.on = False


def slices(device: Any, count: int) -> list[tuple[int, int]]:
    """Return the (first, last) of each slice that `in_slices` makes."""
    parts = min(_SLICES, count) if device.is_cpu else 1
    return [(count * k // parts, count * (k + 1) // parts) for k in range(parts)]


def launch_rows(kernel: Any, inputs: list[Any], *outputs: Any, light: bool = False) -> None:
    """Launch kernel(*inputs, row, lanes, *outputs) over rows of outputs [.., y, x], in slices of them from `row` on.

    Thread i has y = row + i / lanes and lane = i % lanes; kernels work that out themselves, in 32 bits, as the 64 bits
    of launches in two dimensions cost a GPU more than what some kernels do. What is `light` work for each pixel stays
    on one thread of a CPU unless there are many pixels.
    """
    device, height, threads = outputs[0].device, outputs[0].shape[-2], lanes(outputs[0])
    check_size(height * threads)
    load(device, kernel)

    def some_rows(_: int, first: int, last: int) -> None:
        launch(kernel, (last - first) * threads, [*inputs, first, threads], list(outputs), device=device)

    if light and outputs[0].shape[-2] * outputs[0].shape[-1] < _MANY:
        some_rows(0, 0, height)
    else:
        in_slices(device, height, some_rows)


def launch(
    kernel: Any,
    dim: Any,
    inputs: Sequence[Any],
    outputs: Sequence[Any] = (),
    *,
    device: Any,
    stream: Any = None,
    block_dim: int | None = None,
) -> None:
    """Launch a kernel; what a crash left of it in the cache of kernels is compiled again."""
    options = {"device": device, "stream": stream, "block_dim": block_dim}
    from_cache(lambda: wp.launch(kernel, dim, inputs, outputs, **options), kernel.module, device, block_dim)


def launch_tiles(
    kernel: Any, dim: list[int], inputs: list[Any], outputs: list[Any], *, device: Any, block_dim: int
) -> None:
    """Launch a kernel whose threads work together on tiles, as `launch` does."""
    options = {"dim": dim, "inputs": inputs, "outputs": outputs, "device": device, "block_dim": block_dim}
    from_cache(lambda: wp.launch_tiled(kernel, **options), kernel.module, device, block_dim)


def check_size(*threads: int) -> None:
    """Raise BackendError if a launch would have more threads than its kernel can count."""
    if max(threads) > _MOST_THREADS:
        raise BackendError(
            f"a kernel would need {max(threads)} threads (views x pixels), more than the 2^31 - 1 that it can count: "
            "use fewer or smaller views."
        )


def lanes(array: Any) -> int:
    """Return the number of threads that share a row: one for each pixel on a GPU; one for the whole row on a CPU.

    A CPU runs the threads of a launch one after the other, and a plain loop costs it less than a thread per pixel.
    """
    return 1 if array.device.is_cpu else int(array.shape[-1])


def load(device: Any, *kernels: Any) -> None:
    """Compile and load what threads are about to launch; they must not do it at the same time."""
    with LOADING:
        for module in {kernel.module for kernel in kernels}:
            from_cache(partial(wp.load_module, module, device=device), module, device, None)


def with_wide_vectors(kernel: Any) -> Any:
    """Return the kernel, whose module is compiled for the widest vectors that the CPU has.

    Compilers use 256 of 512 bits where nobody says so: the first CPUs with more were slower with them.
    """
    flags = wp.config.cpu_compiler_flags or "-march=native"  # Warp's default
    wp.set_module_options({"cpu_compiler_flags": f"{flags} -mprefer-vector-width=512"}, kernel.module)
    return kernel


@lru_cache(maxsize=1)
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="lfgpu")


if hasattr(os, "register_at_fork"):  # the threads of a pool do not live on in a forked process
    os.register_at_fork(after_in_child=_pool.cache_clear)
