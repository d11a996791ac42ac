"""Taichi's one runtime: started at first use, on one device for as long as the process lives; one thread uses it."""

import contextlib
import io
import os
import threading
from collections import deque
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cache
from math import prod
from typing import Any, TypeVar

import taichi as ti
from taichi.lang import impl
from taichi.lang._ndarray import Ndarray
from taichi.types import primitive_types
from taichi.types.ndarray_type import NdarrayType

from lfgpu.errors import BackendError
from lfgpu.threads import get_threads
from lfgpu.vulkan import choose

from .wide_loops import in_threads

TASK = 512
"""Taichi gives each thread of a CPU at least so many iterations of a loop.

Where an iteration is a whole row or view, the loop is made as much longer and all but every 512th passes at once.
"""

_ARCHES = {"cuda:0": ti.cuda, "vulkan": ti.vulkan, "metal": ti.metal, "cpu": ti.cpu}
_LOCK = threading.RLock()
_forked = False  # True in a child of a process that had started Taichi
_here = threading.local()  # `known`: CUDA knows in which context this thread works
_dropped: deque[Any] = deque()  # arrays whose memory is still to free

Kernels = TypeVar("Kernels")


@cache
def devices() -> tuple[str, ...]:
    _say_only_errors()
    there = [device for device, arch in _ARCHES.items() if ti.lang.misc.is_arch_supported(arch)]
    if "vulkan" in there:
        there.remove("vulkan")
        with contextlib.suppress(BackendError):  # a driver that computes on the CPU is the last choice
            there.insert(len(there) if choose().is_software else len(there) - 1, "vulkan")
    return tuple(there)


def start(device: str) -> None:
    """Start Taichi on `device` unless it runs there; BackendError if it runs elsewhere."""
    with _LOCK:
        if impl.get_runtime().prog is None:
            _say_only_errors()
            if device == "vulkan":
                ti._lib.core.set_vulkan_visible_device(str(choose().number))
            with contextlib.redirect_stdout(io.StringIO()):  # a line that says that it starts
                # Fast mathematics would cost digits and gain nothing where kernels wait for memory.
                ti.init(_ARCHES[device], log_level=_level(), fast_math=False, cpu_max_num_threads=get_threads())
            _here.known = True
        running = _running()
        if running != device:
            raise BackendError(
                f"backend 'taichi' is asked for {device}, but Taichi already runs on {running} in this process and can "
                f"run on one device only: use {running}, another backend, or a process of its own."
            )


def alone() -> contextlib.AbstractContextManager[bool]:
    """Return the lock that makes threads wait for each other: what Taichi does must not overlap."""
    if _forked:
        raise BackendError(
            "Taichi was started before this process was forked, and its threads did not come along: start "
            'processes by "spawn", or use another backend.'
        )
    return _LOCK


def drop(array: Any) -> None:
    """Free the memory of an array, at once if this thread may, else when a thread next allocates.

    Any thread may drop an array at any time, as Python collects garbage there. But Taichi ends the process if CUDA does
    not know the thread that frees it, or if another thread uses Taichi meanwhile.
    """
    _dropped.append(array)
    if _is_known() and _LOCK.acquire(blocking=False):
        try:
            _free()
        finally:
            _LOCK.release()


def enter() -> None:
    """Prepare this thread, which has Taichi alone, to allocate memory, and free what others dropped."""
    if not _is_known():
        _any_kernel()()  # only a launch tells CUDA in which context the thread works
        _here.known = True
    _free()


def _is_known() -> bool:
    return getattr(_here, "known", False) or _running() != "cuda:0"


def _free() -> None:
    program = impl.get_runtime().prog
    while _dropped:
        array = _dropped.popleft()
        if program is not None and not _forked:
            program.delete_ndarray(array)


def _in_child() -> None:
    global _forked
    _forked = impl.get_runtime().prog is not None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_in_child)


@dataclass(frozen=True, eq=False)
class DeviceArray:
    """A field of scalars, or an image of pixels with `channels` values each: its elements in row order.

    Those of images with more channels than colours are scalars, too: Taichi unrolls loops over vectors. One number is
    a field of one float64.
    """

    values: ti.Ndarray
    shape: tuple[int, ...]
    channels: int | None = None
    scalar: Any = ti.f32

    @property
    def size(self) -> int:
        """The number of scalars or pixels."""
        return prod(self.shape)


_prepared: dict[tuple[Hashable, ...], Callable[..., Any]] = {}


def run(kernel: Any, *arguments: Any) -> Any:
    """Launch a kernel; from the second time on without a look at the types, which takes longer than most kernels.

    Return the number that it returns, if any; that waits for the device.

    Annotations of kernels name the types of all arguments, so that there is one compiled kernel for the values of its
    templates.
    """
    primal = kernel._primal
    key = primal, *[arguments[slot] for slot in primal.template_slot_locations]
    with alone():
        if key in _prepared:
            return _prepared[key](*arguments)
        values = tuple(each.values if isinstance(each, DeviceArray) else each for each in arguments)
        with in_threads(_threads()) if _running() == "vulkan" else contextlib.nullcontext():
            number = kernel(*values)
        _prepared[key] = _prepare(primal, values)
        return number


def _prepare(primal: Any, arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """Return what launches a kernel that is compiled for arguments like these."""
    arrays: list[tuple[int, tuple[int]]] = []  # the place among the arguments, and among those that are no templates
    reals: list[tuple[int, tuple[int]]] = []
    wholes: list[tuple[int, tuple[int]]] = []
    places = (place for place in range(len(arguments)) if place not in primal.template_slot_locations)
    for index, place in enumerate(places):
        wanted = primal.arguments[place].annotation
        if isinstance(wanted, NdarrayType) and isinstance(arguments[place], Ndarray):
            kind = arrays
        elif id(wanted) in primitive_types.real_type_ids:
            kind = reals
        elif id(wanted) in primitive_types.integer_type_ids:
            kind = wholes
        else:
            return lambda *given: primal(*(each.values if isinstance(each, DeviceArray) else each for each in given))
        kind.append((place, (index,)))
    program = impl.get_runtime().prog
    compiled = primal.compiled_kernels[primal.func, primal.mapper.lookup(arguments)[0], primal.autodiff_mode]
    binary = program.compile_kernel(program.config(), program.get_device_caps(), compiled)
    begin, go, returns = compiled.make_launch_context, program.launch_kernel, bool(primal.return_type)
    waits = returns and _running() == "cuda:0"  # elsewhere a launch that returns a number waits

    def launch(*arguments: Any) -> Any:
        context = begin()
        for place, index in arrays:
            context.set_arg_ndarray(index, arguments[place].values.arr)
        for place, index in reals:
            context.set_arg_float(index, arguments[place])
        for place, index in wholes:
            context.set_arg_int(index, arguments[place])
        go(binary, context)
        if waits:
            program.synchronize()
        return context.get_struct_ret_float((0,)) if returns else None

    return launch


def once(function: Callable[..., Kernels]) -> Callable[..., Kernels]:
    """Call a function that makes kernels once for each set of arguments, and keep them."""
    kept = cache(function)

    def call(*arguments: Hashable) -> Kernels:
        with alone():
            return kept(*arguments)

    return call


@once
def _any_kernel() -> Any:
    @ti.kernel
    def any_kernel():
        pass

    return any_kernel


def on_cpu() -> bool:
    """True if the running Taichi computes on the CPU."""
    return _running() == "cpu"


def stages_arrays() -> bool:
    """True if arrays of the host go to the device through memory that Taichi takes from the driver for each launch."""
    return _running() in ("vulkan", "metal")


@cache
def double() -> Any:
    """Return the type of numbers and of sums over the whole picture: float64, or float32 where a GPU has no other."""
    running = _running()
    return ti.f32 if running == "metal" or (running == "vulkan" and not choose().has_doubles) else ti.f64


@cache
def _threads() -> int:
    """Return how many threads make a loop on Vulkan: more than a large GPU keeps, elsewhere as many as Taichi starts.

    Fewer would not do: Mesa's driver for the CPU ends the loops of a thread after 65535 turns in all.
    """
    return 2**19 if choose().has_own_memory else 2**17


@cache
def most_bytes() -> int:
    """Return the size of the largest array that the running device can hold."""
    return choose().largest if _running() == "vulkan" else 2**63


def _running() -> str:
    arch = impl.current_cfg().arch
    return {ti.x64: "cpu", ti.arm64: "cpu", ti.cuda: "cuda:0"}.get(arch, ti._lib.core.arch_name(arch))


def _level() -> str:
    return os.environ.get("TI_LOG_LEVEL") or ti.ERROR


def _say_only_errors() -> None:
    """Silence the warning about a missing CUDA driver, unless Taichi was set up before."""
    if impl.get_runtime().prog is None:
        ti.set_logging_level(_level())
