"""Frames of a camera array through shared memory: a ring buffer in a file that a producer maps and readers read.

The producer never waits for a reader, and a reader never gets a frame that is half old and half new: each slot has a
sequence number, which is odd while a frame is being written, and a reader takes a frame only if the number of that
frame stands there before and after its copy. docs/live.md has the layout, `lfgpu/native/lfgpu_ring.h` a producer in C.
"""

import math
import mmap
import os
import secrets
import struct
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfgpu.data import LightField
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.io.folders import not_waited_for

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

MAGIC, VERSION = b"LFGPURNG", 1

_HEADER = struct.Struct("<8sIIQIIIIIIIIQ")
_PAGE, _LINE = 4096, 64  # bytes; slots begin at pages, views at cache lines
_CLOSED_AT, _NEWEST_AT = 52, 56  # bytes from the start of the file
_TYPES: dict[int, np.dtype[Any]] = {1: np.dtype(np.uint8), 2: np.dtype(np.uint16), 3: np.dtype(np.float32)}
_FEWEST, _MOST = 3, 1024  # slots
_MOST_VIEWS = 100_000
_POLL = 0.0005  # seconds between two looks
_TRIES = 20  # to become the only producer, while readers look whether there is one; and to read a frame in time

_barrier = threading.Lock()


@dataclass(frozen=True)
class RingFrame:
    """A frame that a reader copied."""

    number: int  # of the frame, from 1
    views: NDArray[Any]  # [n, y, x, c], a copy
    valid: NDArray[np.bool_]  # bool [n], False for cameras without a picture
    time_ns: int  # what the producer gave, nanoseconds
    passed: int  # frames between the one that was read before and this one


@dataclass(frozen=True)
class _Kind:
    """The properties that all frames of a ring have in common."""

    positions: NDArray[np.float64]
    size: tuple[int, int]
    channels: int
    dtype: np.dtype[Any]
    reference: int
    slots: int

    @property
    def shape(self) -> tuple[int, int, int, int]:
        return (len(self.positions), *self.size, self.channels)

    @property
    def header_bytes(self) -> int:
        return _up(_HEADER.size + 16 * len(self.positions), _PAGE)

    @property
    def views_at(self) -> int:
        """Offset of the views in a slot: after the sequence number, the time and a byte for each camera."""
        return _up(16 + len(self.positions), _LINE)

    @property
    def slot_bytes(self) -> int:
        return _up(self.views_at + math.prod(self.shape) * self.dtype.itemsize, _PAGE)

    @property
    def total(self) -> int:
        return self.header_bytes + self.slots * self.slot_bytes


class _Slot:
    """One slot of a mapped ring."""

    def __init__(self, memory: mmap.mmap, kind: _Kind, index: int) -> None:
        at = kind.header_bytes + index * kind.slot_bytes
        self.numbers = np.frombuffer(memory, np.uint64, 2, at)  # sequence, time
        self.valid = np.frombuffer(memory, np.uint8, len(kind.positions), at + 16)
        count = math.prod(kind.shape)
        self.views = np.frombuffer(memory, kind.dtype, count, at + kind.views_at).reshape(kind.shape)


class RingWriter:
    """The producer's side of a ring buffer.

        with RingWriter("/dev/shm/rig", positions, (480, 640)) as ring:
            while recording:
                views = ring.begin()        # [n, y, x, c] in the shared memory, to be filled
                ...
                ring.publish()              # or, with an array: ring.write(views)

    Parameters
    ----------
    path
        The file, best in memory: /dev/shm on Linux. It is removed by `close`.
    positions, reference
        As for `LightField`: [n, 2], (u, v) of each camera in view steps.
    size
        (height, width) of the views, pixels.
    dtype, channels
        uint8 (default), uint16 or float32 on [0, 1]; 1 or 3 (default).
    slots
        Frames that the ring holds, 3 to 1024; default 4. A reader has as long as it takes to fill all but one of them.

    Raises
    ------
    LightFieldError
        If an argument is wrong, the file cannot be made, or another producer writes to it.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        positions: ArrayLike,
        size: tuple[int, int],
        *,
        dtype: DTypeLike = np.uint8,
        channels: int = 3,
        reference: int | None = None,
        slots: int = 4,
    ) -> None:
        _check_system()
        places = np.asarray(positions, np.float64)
        if not _FEWEST <= slots <= _MOST:
            raise LightFieldError(f"slots must be {_FEWEST} to {_MOST}, not {slots}.")
        # It refuses what no light field can be, without taking memory for the views.
        like = LightField(np.broadcast_to(np.zeros((), dtype), (len(places), *size, channels)), places, reference)
        self._kind = _Kind(places, like.size, channels, like.views.dtype, like.reference_index, slots)
        self.path = named(path)
        """The file."""
        self._file = self._create()
        self._memory = mmap.mmap(self._file.fileno(), self._kind.total)
        self._slots = [_Slot(self._memory, self._kind, index) for index in range(slots)]
        self._newest = np.frombuffer(self._memory, np.uint64, 1, _NEWEST_AT)
        self._frame = 0
        self._begun = False

    def begin(self) -> NDArray[Any]:
        """Return the views [n, y, x, c] of the next frame in the shared memory, to be filled before `publish`."""
        if self._file.closed:
            raise LfgpuError("the ring is closed; create a new one.")
        if not self._begun:
            self._begun = True
            self._slot.numbers[0] = 2 * (self._frame + 1) - 1
            _fence()
        return self._slot.views

    def publish(self, *, valid: Sequence[bool] | NDArray[np.bool_] | None = None, time_ns: int | None = None) -> int:
        """Hand over the frame that was begun; returns its number, from 1.

        Parameters
        ----------
        valid
            bool [n], False for cameras without a picture. Default None: all have one.
        time_ns
            When it was taken, nanoseconds; default None: now, by `time.time_ns`.
        """
        if not self._begun:
            raise LfgpuError("no frame was begun; call begin() and fill its views first.")
        there = np.ones(len(self._kind.positions), bool) if valid is None else np.asarray(valid)
        if there.shape != (len(self._kind.positions),) or there.dtype != np.bool_:
            raise LightFieldError(
                f"valid must be bool [{len(self._kind.positions)}]; found {there.dtype} {list(there.shape)}."
            )
        slot = self._slot
        slot.valid[:] = there
        slot.numbers[1] = time.time_ns() if time_ns is None else time_ns
        _fence()
        self._frame += 1
        slot.numbers[0] = 2 * self._frame
        _fence()
        self._newest[0] = self._frame
        self._begun = False
        return self._frame

    def write(
        self,
        views: ArrayLike,
        *,
        valid: Sequence[bool] | NDArray[np.bool_] | None = None,
        time_ns: int | None = None,
    ) -> int:
        """Copy views [n, y, x, c] of the ring's type into it and publish them; returns the number of the frame."""
        found = np.asarray(views)
        if found.shape != self._kind.shape or found.dtype != self._kind.dtype:
            raise LightFieldError(
                f"views must be {self._kind.dtype} {list(self._kind.shape)}; found {found.dtype} {list(found.shape)}."
            )
        np.copyto(self.begin(), found)
        return self.publish(valid=valid, time_ns=time_ns)

    def close(self) -> None:
        """Tell readers that there are no more frames, and remove the file. May be called more than once."""
        if self._file.closed:
            return
        struct.pack_into("<I", self._memory, _CLOSED_AT, 1)
        with suppress(OSError):
            if os.path.samestat(self.path.stat(), os.fstat(self._file.fileno())):
                self.path.unlink()
        del self._slots, self._newest  # the mapping stays as long as somebody holds views of it
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _slot(self) -> _Slot:
        return self._slots[self._frame % self._kind.slots]

    def _create(self) -> BinaryIO:
        """Create the file, whole before it has its name; readers of an older one of that name keep theirs."""
        kind, path = self._kind, self.path
        try:
            with suppress(FileNotFoundError), path.open("rb") as old:
                if not _lock(old):
                    raise LightFieldError(f"{path} has a producer already; close that one, or choose another name.")
            temporary = path.with_name(f".{path.name}-{secrets.token_hex(8)}")
            file = temporary.open("x+b")
        except OSError as error:
            raise LightFieldError(f"{path} cannot be written: {error.strerror}.") from error
        try:
            header = _HEADER.pack(
                MAGIC,
                VERSION,
                kind.header_bytes,
                kind.slot_bytes,
                kind.slots,
                *(len(kind.positions), *kind.size, kind.channels),
                next(number for number, dtype in _TYPES.items() if dtype == kind.dtype),
                kind.reference,
                0,
                0,
            )
            file.write(header + np.ascontiguousarray(kind.positions, "<f8").tobytes())
            file.flush()
            if hasattr(os, "posix_fallocate"):  # a full memory is found now, not by a signal later
                os.posix_fallocate(file.fileno(), 0, kind.total)
            file.truncate(kind.total)
            _lock(file)
            temporary.replace(path)
        except OSError as error:
            file.close()
            temporary.unlink(missing_ok=True)
            raise LightFieldError(f"{path} cannot be written: {error.strerror}.") from error
        return file


class RingReader:
    """A reader's side of the ring buffer in a file that its producer has made; any number may read at once."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        _check_system()
        self.path = named(path)
        """The file."""
        not_waited_for(self.path)
        try:
            self._file = self.path.open("rb", buffering=0)
        except OSError as error:
            raise LightFieldError(
                f"{self.path} cannot be read: {error.strerror}; start the producer first, or give its file."
            ) from error
        try:
            self._kind = _kind_of(self.path, self._file)
        except BaseException:
            self._file.close()
            raise
        self._last = 0
        self.repeated = 0
        """Copies that were thrown away, because the producer began to write there meanwhile."""

    @property
    def positions(self) -> NDArray[np.float64]:
        """[n, 2], (u, v) of each camera in view steps."""
        return self._kind.positions

    @property
    def reference(self) -> int:
        """Index of the reference view."""
        return self._kind.reference

    def read(self) -> RingFrame | None:
        """Return the newest frame, if it is newer than the one that was read before; else None. Does not wait.

        None also if the producer overtook the reader each time. LightFieldError if the file was cut short meanwhile, or
        is damaged: a slot loses the newest frame only to one that is newer.
        """
        kind, before = self._kind, self._last
        for _ in range(_TRIES):
            newest = self._numbers(_NEWEST_AT, 1)[0]
            if newest <= self._last:
                break
            if newest == before:
                raise LightFieldError(
                    f"{self.path} is damaged: it says that frame {newest} is its newest, and does not hold that frame; "
                    "start the producer again."
                )
            before = newest
            _fence()
            at = kind.header_bytes + (newest - 1) % kind.slots * kind.slot_bytes
            sequence, taken = self._numbers(at, 2)
            if sequence == 2 * newest:
                _fence()
                views, valid = np.empty(kind.shape, kind.dtype), np.empty(len(kind.positions), np.uint8)
                self._fill(views, at + kind.views_at)
                self._fill(valid, at + 16)
                _fence()
                if self._numbers(at, 1)[0] == 2 * newest:
                    passed, self._last = newest - self._last - 1, newest
                    return RingFrame(newest, views, valid != 0, taken, passed)
            self.repeated += 1
        return None

    def _numbers(self, at: int, count: int) -> list[int]:
        found = np.empty(count, np.uint64)
        self._fill(found, at)
        return [int(number) for number in found]

    def _fill(self, array: NDArray[Any], at: int) -> None:
        """Copy a part of the file; a mapping that is cut short meanwhile would end the process."""
        room, done = array.reshape(-1).view(np.uint8), 0
        while done < len(room):
            got = os.preadv(self._file.fileno(), [room[done:].data], at + done)
            if not got:
                raise LightFieldError(f"{self.path} was cut short while it was read; start the producer again.")
            done += got

    def wait(self) -> RingFrame | None:
        """Wait for the next newest frame; None when the producer has ended."""
        while True:
            ended = self.ended()
            if (frame := self.read()) is not None:
                return frame
            if ended:
                return None
            time.sleep(_POLL)

    def ended(self) -> bool:
        """Tell whether the producer has closed the ring, or is not there any more."""
        closed = np.empty(1, np.uint32)
        self._fill(closed, _CLOSED_AT)
        return bool(closed[0]) or _lock(self._file, shared=True)

    def close(self) -> None:
        """Close the file. May be called more than once."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _kind_of(path: Path, file: FileIO) -> _Kind:
    """Read the properties of a ring from its header; LightFieldError if it is none."""
    head = file.read(_HEADER.size)
    if len(head) < _HEADER.size or head[:8] != MAGIC:
        raise LightFieldError(f"{path} is no ring buffer of frames; give the file that its producer made.")
    _, version, header, slot, slots, n, height, width, channels, dtype, reference, _, _ = _HEADER.unpack(head)
    if version != VERSION:
        raise LightFieldError(f"{path} is a ring buffer of version {version}, and this lfgpu reads version {VERSION}.")
    places = file.read(16 * min(n, _MOST_VIEWS))
    kind = None
    if dtype in _TYPES and len(places) == 16 * n and _FEWEST <= slots <= _MOST:
        positions = np.frombuffer(places, "<f8").reshape(n, 2).astype(np.float64)
        kind = _Kind(positions, (height, width), channels, _TYPES[dtype], reference, slots)
    size = os.fstat(file.fileno()).st_size
    if kind is None or (kind.header_bytes, kind.slot_bytes) != (header, slot) or kind.total > size or reference >= n:
        raise LightFieldError(f"{path} is damaged: its header does not fit its size; start the producer again.")
    return kind


def _lock(file: BinaryIO | FileIO, *, shared: bool = False) -> bool:
    """Tell whether nobody produces into a file; if not `shared`, the caller is the producer from now on.

    The system takes the lock away from a process that ends, however it ends.
    """
    for _ in range(1 if shared else _TRIES):
        try:
            fcntl.flock(file, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
        except OSError:
            time.sleep(0 if shared else _POLL)
            continue
        if shared:
            fcntl.flock(file, fcntl.LOCK_UN)
        return True
    return False


def _fence() -> None:
    """Keep reads and writes of memory on their side of this call: neither compiler nor processor reorder them.

    x86 keeps the order anyway; others do at a release of a lock that an acquisition follows.
    """
    for _ in range(2):
        with _barrier:
            pass


def _check_system() -> None:
    if fcntl is None:
        raise LightFieldError("ring buffers of frames need a POSIX system, such as Linux or macOS; use another source.")


def _up(value: int, unit: int) -> int:
    """Return the next multiple."""
    return -(-value // unit) * unit
