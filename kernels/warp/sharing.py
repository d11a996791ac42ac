"""Arrays of other libraries on the same GPU, taken and given where they are, in the order of everybody's streams."""

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp

from .threads import once


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
