"""Frames on their way to a device, and maps on their way back, while the device works on what lies between.

On a GPU there are four streams: one for frames that come to where they wait, part by part or from other libraries
there, one for those whose turn it is, Warp's own for the work, one for maps that go. Host memory is pinned. On a CPU
nothing overlaps: it is busy with the work.
"""

import time
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .asking import alone, asking
from .memory import Shared, pixel_type, take
from .threads import launch, load, once

wp.set_module_options({"enable_backward": False})

_SAMPLES = 64  # along each side of the reference view, that are looked at for cuts
_LOWEST, _HIGHEST = -0.5, 1.5  # intensities beyond these are in another unit


@once
def _change_kernel(channels: int, stored: Any) -> Any:
    stored_pixel = pixel_type(channels, stored)

    @wp.kernel(module=f"lfgpu_transport_{channels}_{stored.__name__}", enable_backward=False)
    def change_kernel(
        views: wp.array3d(dtype=stored_pixel),
        reference: int,
        scale: float,
        tolerance: float,
        stride_y: int,
        stride_x: int,
        last: wp.array2d(dtype=stored_pixel),
        counts: wp.array(dtype=int),
    ):
        """Counts the samples of the reference view that changed, and those out of scale; keeps them for the next."""
        j, i = wp.tid()
        y = j * stride_y + stride_y / 2
        x = i * stride_x + stride_x / 2
        if y >= views.shape[1] or x >= views.shape[2]:
            return
        now = views[reference, y, x]
        before = last[j, i]
        change = float(0.0)
        outside = float(0.0)
        for c in range(wp.static(channels)):
            change = change + wp.abs(float(now[c]) - float(before[c]))
            intensity = float(now[c]) * scale
            if intensity < wp.static(_LOWEST) or intensity > wp.static(_HIGHEST):
                outside = 1.0
        if not (change * scale <= tolerance * float(wp.static(channels))):
            wp.atomic_add(counts, 0, 1)
        if outside > 0.0:
            wp.atomic_add(counts, 1, 1)
        last[j, i] = now

    return change_kernel


@wp.kernel
def _mask_kernel(base: wp.array3d(dtype=float), present: wp.array(dtype=float), mask_out: wp.array3d(dtype=float)):
    n, y, x = wp.tid()
    value = present[n]
    if base:
        value = value * base[n, y, x]
    mask_out[n, y, x] = value


class Slot:
    """Memory for a frame that waits: on the way to a GPU there is memory on both sides."""

    def __init__(self, views: Any) -> None:
        on_gpu = views.device.is_cuda
        self.staged = wp.empty(views.shape, dtype=views.dtype, device="cpu", pinned=on_gpu)
        self.host: NDArray[Any] = self.staged.numpy().reshape(*views.shape, views.dtype._length_)
        self.presence = wp.ones(len(views), dtype=float, device="cpu", pinned=on_gpu)
        self.present: NDArray[np.float32] = self.presence.numpy()
        """Which views are there, 1 or 0, [n]."""
        self.resident = wp.empty_like(views) if on_gpu else self.staged
        self.copied = wp.Event(views.device) if on_gpu else None


class Maps(NamedTuple):
    """Memory for maps: fields on the device, their copies on the host, and events that tell when they are there."""

    fields: tuple[Any, Any]
    hosts: tuple[Any, Any]
    numbers: tuple[Any, Any]  # as the method left them: trust, and the first step, NaN if something was not finite
    events: tuple[Any, ...]


class Lease:
    """Maps in somebody's hands; when nobody holds them any more, they are used again."""

    def __init__(self, maps: Maps, give: Callable[[Maps], None]) -> None:
        token = _Token()
        weakref.finalize(token, give, maps)
        # What other libraries take are these, so that they hold the token as long as they hold the memory.
        self.fields = tuple(_view(field, token) for field in maps.fields)
        self.maps = maps

    def shared(self, index: int) -> Shared:
        """Disparity (0) or confidence (1) for other libraries."""
        return Shared(self.fields[index])

    def numpy(self, index: int) -> NDArray[np.float32]:
        """Copy the same to the host."""
        return np.array(self.maps.hosts[index].numpy())


def _wait_for(event: Any) -> None:
    """Wait for an event. Warp refuses while a thread captures on the device, which may begin at any moment."""
    while True:
        try:
            wp.synchronize_event(event)
            return
        except RuntimeError as error:
            if "capture" not in str(error):
                raise
        time.sleep(0.0005)


class _Token:
    pass


def _view(field: Any, token: _Token) -> Any:
    view = wp.array(ptr=field.ptr, dtype=field.dtype, shape=field.shape, device=field.device, copy=False)
    view.lfgpu_token = token
    return view


class transport:
    """One stream's traffic: views [n, y, x] of pixels to the device, `sources` (two fields, two numbers) back.

    `scale` multiplies stored values; samples of the reference change by more than `tolerance`, the mean difference over
    the channels. There is memory for `results` results at first.
    """

    def __init__(
        self,
        views: Any,
        sources: tuple[Any, Any, Any, Any],
        *,
        reference: int,
        scale: float,
        tolerance: float,
        results: int,
    ) -> None:
        self._views, self._device, self._asking = views, views.device, asking(views.device.alias)
        self._fields, self._numbers = sources[:2], sources[2:]
        _, height, width = views.shape
        strides = max(1, height // _SAMPLES), max(1, width // _SAMPLES)
        self._grid = -(-height // strides[0]), -(-width // strides[1])
        self._looking = [reference, scale, tolerance, *strides]
        self._kernel = _change_kernel(views.dtype._length_, views.dtype._wp_scalar_type_)
        self._there = wp.ones(len(views), dtype=float, device=self._device)
        self._last = wp.zeros(self._grid, dtype=views.dtype, device=self._device)
        self._counts, self._zero = (wp.zeros(2, dtype=int, device=self._device) for _ in range(2))
        load(self._device, self._kernel, _mask_kernel)
        if self._device.is_cuda:
            self._compute = self._device.stream
            self._in, self._up, self._down = (wp.Stream(self._device) for _ in range(3))
            self._incoming = wp.empty_like(views)
            self._counts_host = wp.zeros(2, dtype=int, device="cpu", pinned=True)
            self._arrived, self._taken, self._solved = (wp.Event(self._device) for _ in range(3))
            self._compute.record_event(self._taken)
        else:
            self._incoming, self._counts_host = views, self._counts
        self.made = 0
        """How many results there is memory for."""
        self._free: deque[Maps] = deque(self._new_maps() for _ in range(results))

    def slot(self) -> Slot:
        """Room for one more waiting frame."""
        with self._asking:
            return Slot(self._views)

    def enter(self) -> None:
        """Prepare a thread that asks the device, or waits for it; each must call this once."""
        self._device.make_current()

    def mask(self, base: Any, mask_out: Any) -> None:
        """mask [n, y, x] = whether view n of the frame brought last is there, times `base` unless that is None."""
        launch(_mask_kernel, mask_out.shape, [base, self._there], [mask_out], device=self._device)

    def take(self, values: Any, slot: Slot, views: list[int] | None) -> None:
        """Copy an array of another library on the same GPU into a slot, in the order of that library's stream."""
        with self._asking:
            if views is None:
                take(values, slot.resident, self._in)
            else:
                for k, n in enumerate(views):
                    take(values[n], slot.resident[k], self._in)
            self._in.record_event(slot.copied)

    def send(self, slot: Slot, first: int, last: int) -> None:
        """Let views that are on the host go to the device, in their order."""
        if not self._device.is_cuda:
            return
        size = slot.staged.size // len(slot.staged)
        part = {"dest_offset": first * size, "src_offset": first * size, "count": (last - first) * size}
        with self._asking:
            wp.copy(slot.resident, slot.staged, stream=self._in, **part)
            self._in.record_event(slot.copied)

    def bring(self, slot: Slot) -> tuple[float, float]:
        """Take a frame to the device, while it may still work on the one before.

        It returns when the slot may be used again: which share of the samples of the reference view changed, and which
        share is far outside [0, 1].
        """
        if not self._device.is_cuda:
            with self._asking:
                wp.copy(self._incoming, slot.resident)
                wp.copy(self._there, slot.presence)
                self._counts.zero_()
                launch(
                    self._kernel, self._grid, [self._incoming, *self._looking, self._last, self._counts], device="cpu"
                )
            return self._shares()
        with self._asking:
            up = self._up
            up.wait_event(self._taken)
            up.wait_event(slot.copied)
            wp.copy(self._incoming, slot.resident, stream=up)
            wp.copy(self._there, slot.presence, stream=up)
            wp.copy(self._counts, self._zero, stream=up)
            arguments = [self._incoming, *self._looking, self._last, self._counts]
            launch(self._kernel, self._grid, arguments, device=self._device, stream=up)
            wp.copy(self._counts_host, self._counts, stream=up)
            up.record_event(self._arrived)
        _wait_for(self._arrived)
        return self._shares()

    def _shares(self) -> tuple[float, float]:
        changed, outside = self._counts_host.numpy() / (self._grid[0] * self._grid[1])
        return float(changed), float(outside)

    def solve(self, work: Callable[[], None], before: Callable[[], None] | None) -> Maps:
        """Ask for a map of the frame that was brought last: `before`, if given, and `work`. The maps come later."""
        with self._asking:  # memory that is asked for while another thread captures would be that of its graph
            maps = self._free.popleft() if self._free else self._new_maps()
        if not self._device.is_cuda:
            with self._asking:
                if before is not None:
                    before()
                start = time.perf_counter()
                work()
                maps.events[0][0] = time.perf_counter() - start
                self._hand_over(maps)
            return maps
        begin, end, done = maps.events
        with self._asking, wp.ScopedStream(self._compute, sync_enter=False):
            compute, down = self._compute, self._down
            compute.wait_event(self._arrived)
            wp.copy(self._views, self._incoming, stream=compute)
            if before is not None:
                before()
            compute.record_event(self._taken)
            compute.record_event(begin)
            work()
            compute.record_event(end)
            self._hand_over(maps)
            compute.record_event(self._solved)
            down.wait_event(self._solved)
            for host, field in zip(maps.hosts, maps.fields, strict=True):
                wp.copy(host, field, stream=down)
            down.record_event(done)
        return maps

    def wait(self, maps: Maps) -> tuple[float, float, float]:
        """Wait until maps are on the host: seconds that the device worked on them, and the method's two numbers."""
        if self._device.is_cuda:
            begin, end, done = maps.events
            _wait_for(done)
            seconds = wp.get_event_elapsed_time(begin, end, synchronize=False) / 1000
        else:
            seconds = maps.events[0][0]
        trust, moved = (float(number.numpy()[0]) for number in maps.numbers)
        return seconds, trust, moved

    def lease(self, maps: Maps) -> Lease:
        """Maps for somebody to hold."""
        return Lease(maps, self._free.append)

    def give(self, maps: Maps) -> None:
        """Maps that nobody will hold."""
        self._free.append(maps)

    def captured(self, work: Callable[[], None]) -> Callable[[], None]:
        """Work as one graph of a GPU; on a CPU as it is. It must have run once before."""
        if not self._device.is_cuda:
            return work
        with alone(), wp.ScopedCapture(device=self._device, stream=self._compute) as capture:
            work()
        return lambda: wp.capture_launch(capture.graph, stream=self._compute)

    def synchronize(self) -> None:
        """Wait for all that was asked for."""
        if self._device.is_cuda:
            with self._asking:
                for stream in (self._in, self._up, self._compute, self._down):
                    wp.synchronize_stream(stream)

    def _hand_over(self, maps: Maps) -> None:
        for source, target in zip((*self._fields, *self._numbers), (*maps.fields, *maps.numbers), strict=True):
            wp.copy(target, source)

    def _new_maps(self) -> Maps:
        self.made += 1
        on_gpu = self._device.is_cuda
        fields = tuple(wp.zeros_like(field) for field in self._fields)
        hosts = (
            tuple(wp.zeros(field.shape, dtype=float, device="cpu", pinned=True) for field in fields)
            if on_gpu
            else fields
        )
        numbers = tuple(wp.zeros(1, dtype=wp.float64, device="cpu", pinned=on_gpu) for _ in self._numbers)
        events: tuple[Any, ...] = ([0.0],)
        if on_gpu:
            events = (*(wp.Event(self._device, enable_timing=True) for _ in range(2)), wp.Event(self._device))
        return Maps((fields[0], fields[1]), (hosts[0], hosts[1]), (numbers[0], numbers[1]), events)
