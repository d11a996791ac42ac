"""Arrays of the Taichi backend: all values in one row, since kernels spend less on indices that they work out alone."""

import inspect
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from math import prod
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import taichi as ti
from numpy.typing import NDArray
from taichi.lang._ndarray import ScalarNdarray
from taichi.lang.matrix import VectorNdarray
from taichi.lang.util import to_numpy_type

from lfgpu.contract import host_memory
from lfgpu.errors import BackendError

from .runtime import (
    DeviceArray as DeviceArray,
    alone,
    double,
    drop,
    enter,
    most_bytes,
    once,
    run,
    stages_arrays,
    start,
)

_SCALARS: dict[type, Any] = {np.uint8: ti.u8, np.uint16: ti.u16, np.float16: ti.f16, np.float32: ti.f32}
_COLOURS = 3  # channels of images whose elements are pixels
_PIECE = 4 * 2**20  # bytes of views together where the host writes to memory of a driver, which keeps little of it
_AT_ONCE = 4  # such pieces, or else views that lie together, in one launch: it waits for the device
_MOST = 2**31 - 1  # Taichi's indices have 32 bits


def flat(scalar: Any = ti.f32, channels: int | None = None) -> Any:
    """Return the type of kernel arguments that are a `DeviceArray`'s values."""
    return ti.types.ndarray(dtype=scalar if channels is None else ti.types.vector(channels, scalar), ndim=1)


class _Dropped:
    """Array that frees its memory where a thread may: Taichi frees scalars alone, in whatever thread drops them."""

    arr: Any = None
    _ends = staticmethod(sys.is_finalizing)  # Python takes modules apart at its end, and their names with them

    def __del__(self) -> None:
        if self.arr is not None and not self._ends():
            drop(self.arr)


class _Scalars(_Dropped, ScalarNdarray):  # type: ignore[misc]
    """Scalars in a row."""


class _Vectors(_Dropped, VectorNdarray):  # type: ignore[misc]
    """Vectors in a row."""


def empty(shape: Sequence[int], *, channels: int | None = None, scalar: Any = ti.f32) -> DeviceArray:
    """Allocate an array on the running device, of whatever the memory held."""
    count = prod(shape)
    size = count * (channels or 1)
    wide = size * np.dtype(to_numpy_type(scalar)).itemsize
    if size > _MOST or wide > most_bytes():
        limit = f"{_MOST} values" if size > _MOST else f"{most_bytes() / 2**20:.0f} MiB"
        raise BackendError(
            f"backend 'taichi' cannot hold an array of {size} values ({wide / 2**20:.0f} MiB), at most {limit} here: "
            "use max_memory, fewer or smaller views, or backend 'warp'."
        )
    try:
        with alone():
            enter()
            values = _Scalars(scalar, (count,)) if channels is None else _Vectors(channels, scalar, (count,))
    except RuntimeError as error:
        raise BackendError(
            f"the device has too little memory left for an array of {wide / 2**20:.0f} MiB: use max_memory, or fewer "
            "or smaller views."
        ) from error
    return DeviceArray(values, tuple(shape), channels, scalar)


_scratch: WeakKeyDictionary[DeviceArray, dict[tuple[int, ...], DeviceArray]] = WeakKeyDictionary()


def scratch(owner: DeviceArray, shape: tuple[int, ...], *, channels: int | None = None) -> DeviceArray:
    """Return memory of whatever contents that lives as long as `owner`, the output of the operation that needs it.

    A GPU waits for all its work before it has new memory.
    """
    kept, key = _scratch.setdefault(owner, {}), (*shape, channels or 0)
    if key not in kept:
        kept[key] = empty(shape, channels=channels)
    return kept[key]


def doubles(values: NDArray[Any]) -> DeviceArray:
    """Return a copy of `values` (any shape) on the running device as numbers of its type `double`."""
    array = empty(values.shape, scalar=double())
    return _filled(array, np.asarray(values, to_numpy_type(array.scalar)))


def table(values: NDArray[Any]) -> DeviceArray:
    """Return a copy of `values` (any shape) on the running device as a field, of one 0 where there are none."""
    return _filled(empty(values.shape), values.astype(np.float32)) if values.size else _nothing()


@once
def indices(values: tuple[int, ...]) -> DeviceArray:
    """Return whole numbers."""
    return _filled(empty((len(values),), scalar=ti.i32), np.array(values, np.int32))


@once
def one() -> DeviceArray:
    """Return the number 1."""
    return doubles(np.ones(1))


@once
def _nothing() -> DeviceArray:
    return _filled(empty((1,)), np.zeros(1, np.float32))


def optional(array: DeviceArray | None) -> tuple[DeviceArray, bool]:
    """Return the arguments of a kernel for an optional field: an array in any case, and whether it counts."""
    return (_nothing(), False) if array is None else (array, True)


def operation(kernel: Any, *kinds: str) -> Callable[..., None]:
    """Make an operation of the contract from a kernel whose arguments have the names of the operation's.

    Those that are given by their place come first, in the same order. Besides, a kernel may have `height` and `width`,
    the last two sizes of the last output, and has_X, whether an optional X is given. In the place of the kernel there
    may be a function that returns it, for the attributes `kinds` of the first argument.
    """
    names = cache(lambda chosen: tuple(inspect.signature(chosen._primal.func).parameters))

    def launch(*arguments: Any, **named: Any) -> None:
        chosen = kernel if hasattr(kernel, "_primal") else kernel(*(getattr(arguments[0], kind) for kind in kinds))
        given = dict(zip(names(chosen), arguments, strict=False)) | named
        for name in names(chosen):
            if name.startswith("has_"):
                given[name.removeprefix("has_")], given[name] = optional(given[name.removeprefix("has_")])
        given["height"], given["width"] = (1, *given[names(chosen)[-1]].shape)[-2:]
        run(chosen, *(given[name] for name in names(chosen)))

    return launch


def field(values: NDArray[Any], device: str) -> DeviceArray:
    start(device)
    return _filled(empty(values.shape), np.asarray(values, np.float32))


def image(values: NDArray[Any], device: str) -> DeviceArray:
    start(device)
    stored, shape, channels = _SCALARS[values.dtype.type], values.shape[:-1], values.shape[-1]
    if channels <= _COLOURS:
        return _filled(empty(shape, channels=channels, scalar=stored), np.asarray(values))
    array = empty(values.shape, scalar=stored)
    return _filled(replace(array, shape=shape, channels=channels), np.asarray(values))


def zeros(shape: Sequence[int], device: str) -> DeviceArray:
    start(device)
    return clear(empty(shape))


def within(home: DeviceArray, shape: Sequence[int], stored: Any = None) -> None:
    return None


def zeros_image(shape: Sequence[int], device: str, stored: Any = np.float32) -> DeviceArray:
    return image(np.zeros(tuple(shape), stored), device)


def scalar(value: float, device: str) -> DeviceArray:
    start(device)
    return doubles(np.array([value]))


def upload(values: NDArray[Any], array_out: DeviceArray, *, chosen: Sequence[int] | None = None) -> None:
    given = np.asarray(values)
    if array_out.channels is None or array_out.channels > _COLOURS:
        taken = given if chosen is None else given[list(chosen)]
        _filled(array_out, taken.astype(to_numpy_type(array_out.scalar), copy=False))
        return
    indices, first = np.arange(len(given)) if chosen is None else np.array(chosen), 0
    most = max(1, _PIECE // given[:1].nbytes) if stages_arrays() else len(indices)
    ends = (np.diff(indices) != 1) | (np.arange(1, len(indices)) % most == 0)
    together = np.split(indices, np.flatnonzero(ends) + 1)
    for turn in range(0, len(together), _AT_ONCE):
        parts = [
            np.ascontiguousarray(given[some[0] : some[-1] + 1], to_numpy_type(array_out.scalar)).reshape(
                -1, array_out.channels
            )
            for some in together[turn : turn + _AT_ONCE]
        ]
        padding = [parts[0][:1]] * (_AT_ONCE - len(parts))
        run(_gather_kernel(array_out.scalar, array_out.channels), *parts, *padding, first, array_out)
        first += sum(map(len, parts))


@once
def _gather_kernel(stored: Any, channels: int) -> Any:
    """Return the kernel that copies arrays of the host to the device, one behind the other as far as there is room."""
    pixels = flat(stored, channels)

    @ti.kernel
    def gather_kernel(a: pixels, b: pixels, c: pixels, d: pixels, first: int, pixels_out: pixels):
        for p in range(a.shape[0]):
            pixels_out[first + p] = a[p]
        for p in range(b.shape[0]):
            place = first + a.shape[0] + p
            if place < pixels_out.shape[0]:
                pixels_out[place] = b[p]
        for p in range(c.shape[0]):
            place = first + a.shape[0] + b.shape[0] + p
            if place < pixels_out.shape[0]:
                pixels_out[place] = c[p]
        for p in range(d.shape[0]):
            place = first + a.shape[0] + b.shape[0] + c.shape[0] + p
            if place < pixels_out.shape[0]:
                pixels_out[place] = d[p]

    return gather_kernel


@once
def _read_kernel(stored: Any, channels: int | None = None) -> Any:
    """Return the kernel that copies an array from the device to the host, and returns a number."""
    real = double()

    @ti.kernel
    def read_kernel(values: flat(stored, channels), scalar: flat(real), values_out: flat(stored, channels)) -> real:
        for p in range(values.shape[0]):
            values_out[p] = values[p]
        return scalar[0]

    return read_kernel


def shared(field: DeviceArray) -> Any:
    raise BackendError(
        "backend 'taichi' has no arrays that other libraries could take: copy the map with disparity(), or use backend "
        "'warp'."
    )


def clear(array_out: DeviceArray) -> DeviceArray:
    with alone():
        array_out.values.fill(0)
    return array_out


def numpy(array: DeviceArray) -> NDArray[Any]:
    return read(array, one())[0]


def read(array: DeviceArray, scalar: DeviceArray) -> tuple[NDArray[Any], float]:
    elements = array.values.element_shape
    values = host_memory(array.values.shape + elements, to_numpy_type(array.scalar))
    number = run(_read_kernel(array.scalar, *elements), array, scalar, values)  # Taichi's own copy waits twice
    return values.reshape(array.shape if array.channels is None else (*array.shape, array.channels)), float(number)


def number(scalar: DeviceArray) -> float:
    return float(run(_number_kernel(), scalar))


@once
def _number_kernel() -> Any:
    """Return the kernel that returns a number: the work before it and its own wait for the device once together."""
    real = double()

    @ti.kernel
    def number_kernel(scalar: flat(real)) -> real:
        return scalar[0]

    return number_kernel


def _filled(array: DeviceArray, values: NDArray[Any]) -> DeviceArray:
    elements = values.reshape(array.values.shape + array.values.element_shape)
    with alone():
        array.values.from_numpy(np.ascontiguousarray(elements))
    return array
