"""Arrays of the Warp backend: how they are made, filled from pinned memory, read, and shared with other libraries.

Fields are scalars, images are vectors of their channels, so that a pixel is one load.
"""

import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from math import prod
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from lfgpu.contract import host_memory

from .asking import asking, started
from .threads import cache_is_closed, in_slices, once


class Shared:
    """A field for other libraries: no copy, and whoever reads it waits for all that was asked for before.

    Warp's own arrays do not name their stream in `__cuda_array_interface__`, without which CuPy would not wait for it,
    and their `__dlpack__` does not know what newer readers ask for.
    """

    def __init__(self, field: Any) -> None:
        self._field = field
        self.shape: tuple[int, ...] = field.shape
        self.dtype = np.dtype(np.float32)

    @property
    def __array_interface__(self) -> dict[str, Any]:
        return self._field.__array_interface__  # AttributeError on a GPU, as NumPy wants it

    @property
    def __cuda_array_interface__(self) -> dict[str, Any]:
        # A stream of 0 is not allowed: the default stream is 1.
        stream = self._field.device.stream.cuda_stream if self._field.device.is_cuda else None
        return {**self._field.__cuda_array_interface__, "version": 3, "stream": stream or 1}

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Any:
        if self._field.device.is_cuda:
            raise TypeError(f"the map is on {self._field.device}; for a copy in NumPy ask for disparity() or result().")
        return np.array(self._field.numpy(), dtype, copy=copy)

    def __dlpack__(
        self,
        *,
        stream: int | None = None,
        max_version: tuple[int, int] | None = None,  # there is one version that all readers know
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        if dl_device not in (None, self.__dlpack_device__()):
            raise BufferError(f"the map is on {self._field.device} and does not leave it by DLPack.")
        return (wp.clone(self._field) if copy else self._field).__dlpack__(stream)

    def __dlpack_device__(self) -> tuple[int, int]:
        return self._field.__dlpack_device__()


def shared(field: Any) -> Shared:
    return Shared(field)


def take(values: Any, array_out: Any, own: Any = None, *, chosen: Sequence[int] | None = None) -> None:
    """Copy an array [..., c] of another library on this GPU: after what its library was asked for, before what it will.

    With `chosen`, those of its parts along the first axis, in that order.
    The copy takes its turn on the stream `own`, by default Warp's. Where that library does not say on which stream it
    works, the host waits for the copy.
    """
    device = array_out.device
    own = own or device.stream
    vector = array_out.dtype is not wp.float32
    scalar = array_out.dtype._wp_scalar_type_ if vector else wp.float32
    shape = (*array_out.shape, array_out.dtype._length_) if vector else array_out.shape
    target = wp.array(ptr=array_out.ptr, dtype=scalar, shape=shape, device=device, copy=False)
    stream = _stream_of(values, device)
    if hasattr(values, "__dlpack__"):
        # Given our stream, their library makes it wait; 1 is the default stream, as 0 is not allowed.
        source = wp.from_dlpack(values.__dlpack__(stream=own.cuda_stream or 1), dtype=scalar)
    else:
        interface = values.__cuda_array_interface__
        if stream is None:
            wp.synchronize_device(device)
        else:
            own.wait_stream(stream)
        place, strides = interface["data"][0], interface.get("strides")
        shape = tuple(interface["shape"])
        source = wp.array(ptr=place, dtype=scalar, shape=shape, strides=strides, device=device, copy=False)
    if chosen is None:
        wp.copy(target, source, stream=own)
    else:
        for k, index in enumerate(chosen):
            wp.copy(target[k], source[index], stream=own)
    if stream is None:
        wp.synchronize_stream(own)
    else:
        stream.wait_stream(own)


def _stream_of(values: Any, device: Any) -> Any:
    """Return the stream on which the library of `values` works now, None if it does not say."""
    torch = sys.modules.get("torch")
    if torch is not None and isinstance(values, torch.Tensor):
        return _stream(device.alias, torch.cuda.current_stream(device.ordinal).cuda_stream)
    handle = getattr(values, "__cuda_array_interface__", {}).get("stream")
    return None if handle is None else _stream(device.alias, handle)


@once
def _stream(device: str, handle: int) -> Any:
    """Kept, as Warp forgets what it knows of a stream when the first of several such objects goes."""
    return wp.get_device(device).null_stream if handle in (0, 1) else wp.Stream(device, cuda_stream=handle)


WORTHWHILE = 2**18  # bytes; fewer are there before threads have begun
_LEAST_PART, _PART = 2**19, 2**22  # bytes
_PARTS = 16  # that may be on their way
_THREADS = 8  # that copy


class _Staging:
    """The pinned memory of one device."""

    def __init__(self, device: str) -> None:
        self._parts = [wp.empty(_PART, dtype=wp.uint8, device="cpu", pinned=True) for _ in range(_PARTS)]
        self._room = [part.numpy() for part in self._parts]
        self._free = [wp.Event(device) for _ in self._parts]
        self._used = [False] * _PARTS  # its event says when the bus is done with it
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="lfgpu-staging")
        self._lock = threading.Lock()

    def send(self, pieces: Sequence[NDArray[np.uint8]], target: Any) -> None:
        """Bytes, one piece after the other, into bytes on the device, in the order of its stream.

        The pieces may be changed once this returns.
        """
        with self._lock:
            size = min(max(-(-sum(map(len, pieces)) // _THREADS), _LEAST_PART), _PART)
            parts = parts_of(pieces, size)
            filling: list[Future[int]] = []
            for k, part in enumerate(parts):
                if k >= _PARTS:
                    self._post(k - _PARTS, filling[k - _PARTS], (k - _PARTS) * size, target)
                filling.append(self._pool.submit(self._fill, k % _PARTS, part))
            for k in range(max(0, len(parts) - _PARTS), len(parts)):
                self._post(k, filling[k], k * size, target)

    def receive(self, source: Any) -> NDArray[np.uint8]:
        """Bytes of the device, once all is done that its stream was asked for."""
        values: NDArray[np.uint8] = host_memory(source.shape, np.uint8)
        with self._lock:
            for first in range(0, len(values), _PART * _PARTS):
                parts = [values[k : k + _PART] for k in range(first, min(first + _PART * _PARTS, len(values)), _PART)]
                for place, part in enumerate(parts):
                    if self._used[place]:
                        source.device.stream.wait_event(self._free[place])
                    self._copy(self._parts[place], source, 0, first + place * _PART, len(part), place)
                for place, part in enumerate(parts):
                    wp.synchronize_event(self._free[place])
                    part[:] = self._room[place][: len(part)]
        return values

    def _fill(self, place: int, part: list[NDArray[np.uint8]]) -> int:
        if self._used[place]:
            wp.synchronize_event(self._free[place])
        first = 0
        for piece in part:
            self._room[place][first : first + len(piece)] = piece
            first += len(piece)
        return first

    def _post(self, k: int, filled: Future[int], start: int, target: Any) -> None:
        place, count = k % _PARTS, filled.result()
        self._copy(target, self._parts[place], start, 0, count, place)

    def _copy(self, target: Any, source: Any, to: int, start: int, count: int, place: int) -> None:
        wp.copy(target, source, dest_offset=to, src_offset=start, count=count)
        stream = (target if target.device.is_cuda else source).device.stream
        stream.record_event(self._free[place])
        self._used[place] = True


def parts_of(pieces: Sequence[NDArray[np.uint8]], size: int) -> list[list[NDArray[np.uint8]]]:
    """Cut the bytes of pieces, in their order, into parts of `size` bytes, the last one shorter: lists of slices."""
    parts: list[list[NDArray[np.uint8]]] = []
    room = 0
    for piece in pieces:
        first = 0
        while first < len(piece):
            if room == 0:
                parts.append([])
                room = size
            parts[-1].append(piece[first : first + room])
            first, room = first + len(parts[-1][-1]), room - len(parts[-1][-1])
    return parts


@once
def staging(device: str) -> _Staging:
    return _Staging(device)


_LARGE = 2**22  # bytes
_POOL = 2**29  # bytes that wait on a GPU for who allocates next, at most: to map pages anew takes milliseconds

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
    try:
        with _without_note_on_driver():
            wp.init()
            started.extend(device.alias for device in wp.get_devices())
            for device in wp.get_cuda_devices():
                if device.is_mempool_enabled:
                    wp.set_mempool_release_threshold(device, _POOL)
    except OSError as error:
        raise cache_is_closed(error) from error


@contextmanager
def _without_note_on_driver() -> Iterator[None]:
    """Hold back that a machine has no CUDA driver: no news to its owner, and printed past Python's streams."""
    if sys.stderr is None:  # closed, or a program without a console
        yield
        return
    with tempfile.TemporaryFile() as caught:
        sys.stderr.flush()
        stderr = os.dup(2)
        os.dup2(caught.fileno(), 2)
        try:
            yield
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
    return _zeros(shape[:-1], _image_type(shape, stored), device)


def _image_type(shape: Sequence[int], stored: Any) -> Any:
    return pixel_type(shape[-1], scalar_of(stored))


def within(home: Any, shape: Sequence[int], stored: Any = None) -> Any:
    if stored is None:
        return _within(home, shape, wp.float32)
    return _within(home, shape[:-1], _image_type(shape, stored))


def _within(home: Any, shape: Sequence[int], dtype: Any) -> Any:
    found = wp.array(ptr=home.ptr, dtype=dtype, shape=tuple(shape), device=home.device, copy=False)
    found.lfgpu_home = home  # whose memory it is
    return found


def floats_of(shape: Sequence[int], dtype: Any) -> int:
    """Count the floats that take as much memory as an array."""
    return -(-prod(shape) * wp.types.type_size_in_bytes(dtype) // 4)


def made_within(home: Any, shape: Sequence[int], dtype: Any, device: Any) -> Any:
    """Return an array in the memory of a field, or a new one if there is none or it is too small."""
    if home is None or home.size < floats_of(shape, dtype):
        return wp.empty(tuple(shape), dtype=dtype, device=device)
    return _within(home, shape, dtype)


def scalar_of(stored: Any) -> Any:
    """Return the type of scalars that are stored in a NumPy type."""
    return _SCALARS[np.dtype(stored).type]


def _zeros(shape: Sequence[int], dtype: Any, device: str) -> Any:
    """Return zeros; all threads of a CPU write many: pages of memory come when they are first written to."""
    with asking(device):
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


def read(array: Any, scalar: Any) -> tuple[NDArray[Any], float]:
    return numpy(array), number(scalar)  # the second one finds the device done


def _bytes(array: Any) -> Any:
    """Return the bytes of a contiguous array on a GPU."""
    count = array.size * wp.types.type_size_in_bytes(array.dtype)
    return wp.array(ptr=array.ptr, dtype=wp.uint8, shape=count, device=array.device, copy=False)


def _read(array: Any) -> Any:
    """Return the array, when all that was read for it has been: a GPU still reads what its owner pinned."""
    if array.device.is_cuda:
        wp.synchronize_stream(array.device.stream)
    return array
