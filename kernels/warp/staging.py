"""Between the host and a GPU by way of pinned memory, part by part: one is on the bus while the next one is copied.

What a program has in ordinary memory the driver copies on one core, which is slower than the bus by far.
"""

import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .threads import once

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
            for k, (_, part) in enumerate(parts):
                if k >= _PARTS:
                    self._post(k - _PARTS, filling[k - _PARTS], parts[k - _PARTS][0], target)
                filling.append(self._pool.submit(self._fill, k % _PARTS, part))
            for k in range(max(0, len(parts) - _PARTS), len(parts)):
                self._post(k, filling[k], parts[k][0], target)

    def receive(self, source: Any) -> NDArray[np.uint8]:
        """Bytes of the device, once all is done that its stream was asked for."""
        values = np.empty(source.shape[0], np.uint8)
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

    def _fill(self, place: int, values: NDArray[np.uint8]) -> int:
        if self._used[place]:
            wp.synchronize_event(self._free[place])
        self._room[place][: len(values)] = values
        return len(values)

    def _post(self, k: int, filled: Future[int], start: int, target: Any) -> None:
        place, count = k % _PARTS, filled.result()
        self._copy(target, self._parts[place], start, 0, count, place)

    def _copy(self, target: Any, source: Any, to: int, start: int, count: int, place: int) -> None:
        wp.copy(target, source, dest_offset=to, src_offset=start, count=count)
        stream = (target if target.device.is_cuda else source).device.stream
        stream.record_event(self._free[place])
        self._used[place] = True


def parts_of(pieces: Sequence[NDArray[np.uint8]], size: int) -> list[tuple[int, NDArray[np.uint8]]]:
    """Pieces cut into parts of at most `size` bytes, each with where it begins among the bytes of all."""
    parts, first = [], 0
    for piece in pieces:
        parts += [(first + k, piece[k : k + size]) for k in range(0, len(piece), size)]
        first += len(piece)
    return parts


@once
def staging(device: str) -> _Staging:
    return _Staging(device)
