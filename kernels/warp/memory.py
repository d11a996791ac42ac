"""Arrays of the Warp backend: fields are scalars, images are vectors of their channels, so that a pixel is one load."""

import os
import sys
import tempfile
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .asking import asking, started
from .cache import cache_is_closed
from .sharing import take
from .staging import WORTHWHILE, staging
from .threads import in_slices, once

_LARGE = 2**22  # bytes

_SCALARS: dict[type, Any] = {
    np.uint8: wp.uint8,
    np.uint16: wp.uint16,
    np.float16: wp.float16,
    np.float32: wp.float32,
}


@once
def start() -> None:
    """Start Warp once, at first use, without its banner and its notes on each module that it compiles."""
    if wp.config.log_level == wp.LOG_INFO:  # its default: whoever chose another level keeps it
        wp.config.log_level = wp.LOG_WARNING
    # That a machine has no CUDA driver is no news to its owner, but is printed past Python's streams.
    with tempfile.TemporaryFile() as caught:
        sys.stderr.flush()
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            wp.init()
            started.extend(device.alias for device in wp.get_devices())
        except OSError as error:
            raise cache_is_closed(error) from error
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
        caught.seek(0)
        for line in caught:
            if b"find or load the NVIDIA CUDA driver" not in line:
                os.write(2, line)


@once
def pixel_type(channels: int, scalar: Any = wp.float32) -> Any:
    """Return the Warp vector of `channels` values that one pixel is."""
    return wp.types.vector(length=channels, dtype=scalar)


def devices() -> tuple[str, ...]:
    start()
    return tuple(device.alias for device in sorted(wp.get_devices(), key=lambda device: device.is_cpu))


def field(values: NDArray[Any], device: str) -> Any:
    start()
    with asking(device):
        return _read(wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.float32, device=device, copy=True))


def image(values: NDArray[Any], device: str) -> Any:
    start()
    pixel = pixel_type(values.shape[-1], _SCALARS[values.dtype.type])
    contiguous = np.ascontiguousarray(values)
    with asking(device):
        return _read(wp.array(contiguous, dtype=pixel, shape=values.shape[:-1], device=device, copy=True))


def zeros(shape: Sequence[int], device: str) -> Any:
    start()
    return _zeros(shape, wp.float32, device)


def zeros_image(shape: Sequence[int], device: str, stored: Any = np.float32) -> Any:
    start()
    return _zeros(shape[:-1], pixel_type(shape[-1], _SCALARS[np.dtype(stored).type]), device)


def _zeros(shape: Sequence[int], dtype: Any, device: str) -> Any:
    """Return zeros; all threads of a CPU write many: pages of memory come when they are first written to."""
    return clear(wp.empty(tuple(shape), dtype=dtype, device=device))


def clear(array_out: Any) -> Any:
    if array_out.device.is_cuda or array_out.size * wp.types.type_size_in_bytes(array_out.dtype) < _LARGE:
        array_out.zero_()
    else:
        flat = array_out.flatten()
        in_slices(flat.device, flat.size, lambda _, first, last: flat[first:last].zero_())
    return array_out


def scalar(value: float, device: str) -> Any:
    start()
    with asking(device):
        return wp.array([value], dtype=wp.float64, device=device)


def upload(values: Any, array_out: Any, *, chosen: Sequence[int] | None = None) -> None:
    if not isinstance(values, np.ndarray):
        take(values, array_out, chosen=chosen)
        return
    if array_out.dtype is wp.float32:
        values = np.asarray(values, np.float32)
    runs = [slice(None)] if chosen is None else _runs(chosen)
    parts = [np.ascontiguousarray(values[run]) for run in runs]
    with asking(array_out.device.alias):
        if array_out.device.is_cuda and sum(part.nbytes for part in parts) >= WORTHWHILE:
            staging(array_out.device.alias).send([part.reshape(-1).view(np.uint8) for part in parts], _bytes(array_out))
            return
        first = 0
        for part in parts:
            target = array_out if chosen is None else array_out[first : first + len(part)]
            wp.copy(target, wp.array(part, dtype=target.dtype, shape=target.shape, device="cpu", copy=False))
            first += len(part) if chosen is not None else 0
        _read(array_out)


def _runs(chosen: Sequence[int]) -> list[slice]:
    """Indices in order as slices of neighbours, which lie side by side in memory."""
    indices = np.asarray(chosen)
    pieces = np.split(indices, np.flatnonzero(np.diff(indices) != 1) + 1)
    return [slice(int(piece[0]), int(piece[-1]) + 1) for piece in pieces]


def numpy(array: Any) -> NDArray[Any]:
    vector = array.dtype is not wp.float32
    shape = (*array.shape, array.dtype._length_) if vector else array.shape
    if not array.device.is_cuda:
        return np.array(array.numpy()).reshape(shape)
    with asking(array.device.alias):
        if array.is_contiguous and array.size * wp.types.type_size_in_bytes(array.dtype) >= WORTHWHILE:
            scalar = array.dtype._wp_scalar_type_ if vector else array.dtype
            return staging(array.device.alias).receive(_bytes(array)).view(wp.dtype_to_numpy(scalar)).reshape(shape)
        return array.numpy().reshape(shape)  # from a GPU it is a copy


def number(scalar: Any) -> float:
    with asking(scalar.device.alias):
        return float(scalar.numpy()[0])


def _bytes(array: Any) -> Any:
    """Return the bytes of a contiguous array on a GPU."""
    count = array.size * wp.types.type_size_in_bytes(array.dtype)
    return wp.array(ptr=array.ptr, dtype=wp.uint8, shape=count, device=array.device, copy=False)


def _read(array: Any) -> Any:
    """Return the array, when all that was read for it has been: a GPU still reads what its owner pinned."""
    if array.device.is_cuda:
        wp.synchronize_stream(array.device.stream)
    return array
