"""`DepthStream`: a disparity map for each frame of a camera array, in real time."""

from __future__ import annotations

import atexit
import os
import threading
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray

from lfgpu._backends import DEFAULT, load, open_device
from lfgpu.config import Config
from lfgpu.contract import Float64Array
from lfgpu.data import LightField, check_light_field
from lfgpu.data.light_field_checks import array_of_numbers, check_number, check_positive, check_whole, checked_sides
from lfgpu.errors import BackendError, LfgpuError, LightFieldError
from lfgpu.methods import configured, method_of
from lfgpu.methods.measured import Measured
from lfgpu.methods.temporal_prior import TemporalPrior
from lfgpu.pipelines.inbox import most_waiting
from lfgpu.pipelines.intake import Intake
from lfgpu.pipelines.pipeline import measured_on
from lfgpu.pipelines.rectifier import Rectifier
from lfgpu.pipelines.stream_engine import Engine
from lfgpu.pipelines.stream_result import OnResult, StreamResult
from lfgpu.pipelines.stream_work import Snapshot, StreamWork
from lfgpu.pipelines.watches import RangeWatch, checked_stamps

_USUAL_NOISE = 0.004  # intensity: the noise of cameras of which nothing is known
CUT = 0.5
"""Share of the samples whose change makes a frame start without the previous map."""


class DepthStream(StreamWork):
    """Stream of disparity maps for frames from the same cameras, in real time.

        with lfgpu.DepthStream(lf, disparity_range=(-2, 2)) as stream:
            for frame in camera:                # [n, y, x, c], like lf.views
                result = stream.push(frame)     # returns at once
                ...
                disparity = result.numpy()      # waits

    When the stream is created, all memory is allocated and, on a GPU, all work is captured. While the device works on
    one frame, the next frame is uploaded and the previous map is downloaded. A frame starts from the previous map where
    the scene has not changed (`TemporalPrior`). A frame without a previous map gets the same map as from
    `estimate_depth`.

    The result of a wrong frame (shape, type, values, missing reference view) has an `error`; the stream continues.

    Parameters
    ----------
    lf
        Gives the cameras, size, stored type, masks and reference view. The noise, and the disparity range if it is not
        given, are measured on its views. Without a first frame, use `for_cameras`.
    config
        As for `DepthPipeline`, for the presets of matching. Default None: "accurate", or "learned" with weights.
    weights, disparity_range, device, measured
        As for `DepthPipeline`.
    backend
        "warp" (default), the only backend with streams.
    prior
        Strength of the link to the previous map, default `TemporalPrior()`; None: frames are independent.
    cut
        Share of the reference view, default 0.5, whose change makes a frame start without the previous map; 0 to 1.
    policy
        Fate of frames that come too fast. "latest" (default): one frame waits, and a newer one replaces it.
        "block": `push` waits. "queue": several frames wait; if there are too many, the oldest is dropped.
    waiting
        Number of frames that may wait, >= 1. Default None: 1 for "latest" (the only value), 2 "block", 4 "queue".
    budget_ms
        Device time per frame, milliseconds, > 0. The stream reduces the work per frame to fit, judging by the times of
        earlier frames; if nothing fits, it does the least it can. Default None: all work that `config` asks for.
    on_result
        Called with each `StreamResult` that has a map, in order, from a thread of the stream. It should return quickly.
        Its exceptions are counted (`stats`) and logged by `logging`, the first one from each line of code with its
        traceback. It is also an attribute that may be set at any time. Default None.
    end_on_error
        True: an exception of `on_result` ends the stream. `on_result` is not called any more, waiting frames are
        dropped, and `push` raises an LfgpuError that names the exception. Default False.
    rectifier
        Rectifier of raw pictures, as for `DepthPipeline`: `lf` and all frames are raw pictures then.
    tolerance
        Seconds by which the `stamps` of one frame may differ, > 0; default None: any. Other frames are estimated, too,
        but they are counted (`frames_out_of_step`), and `warnings` has a sentence about the first.

    Raises
    ------
    LightFieldError, BackendError
        As `estimate_depth`; also if the method or the backend cannot run on streams, or the pictures are not those of
        the rectifier's cameras.

    Examples
    --------
    >>> with lfgpu.DepthStream(lf, config="fast", disparity_range=(-2, 2)) as stream:
    ...     stream.push(lf.views).numpy().shape
    (64, 80)
    """

    def __init__(
        self,
        lf: LightField,
        *,
        config: Config | str | None = None,
        weights: str | os.PathLike[str] | None = None,
        disparity_range: tuple[float, float] | None = None,
        backend: str = DEFAULT,
        device: str | None = None,
        prior: TemporalPrior | None = TemporalPrior(),  # noqa: B008 - it is frozen
        cut: float = CUT,
        policy: str = "latest",
        waiting: int | None = None,
        budget_ms: float | None = None,
        on_result: OnResult | None = None,
        end_on_error: bool = False,
        measured: Measured | None = None,
        rectifier: Rectifier | None = None,
        tolerance: float | None = None,
    ) -> None:
        check_light_field(lf)
        check_number("cut", cut, 0, 1)
        if prior is not None and not isinstance(prior, TemporalPrior):
            raise LightFieldError(f"prior must be a TemporalPrior or None, not {prior!r:.60}.")
        if budget_ms is not None:
            check_positive("budget_ms", budget_ms, "milliseconds")
        if tolerance is not None:
            check_positive("tolerance", tolerance, "seconds")
        most = most_waiting(policy, waiting)
        given = disparity_range is not None or measured is not None
        self.config = live_config(config, weights)
        method, kernels = method_of(self.config), load(backend)
        streaming = kernels.streaming
        if streaming is None:
            raise BackendError(f"backend {backend!r} has no streams; use backend {DEFAULT!r}.")
        place, pictures = open_device(backend, device), lf
        lf = pictures if rectifier is None else rectifier.rectified(pictures, place)
        self.geometry, self.name = lf.geometry, lf.name
        self.rectifier = rectifier
        """The rectifier of frames; None if they are views already."""
        self._notes: tuple[str, ...] = ()  # about the range that was found
        with place.asking():
            if measured is None:
                measured, self._notes = measured_on(
                    lf, config=self.config, disparity_range=disparity_range, backend=backend, device=place.name
                )
            self.measured = measured
            engine = Engine(
                lf,
                pictures,
                rectifier,
                place,
                streaming,
                method=method,
                measured=measured,
                prior=prior,
                budget_ms=budget_ms,
                results=most + 4,
            )
        engine.prepare()
        self._intake = Intake(lf, engine.used, place.name)
        self._index, self._numbering, self._process = 0, threading.Lock(), os.getpid()
        self._buffers: int | None = None  # how many there were when the memory was returned
        # A range that was found was found in these views; a stream that was made without a frame has none.
        first = engine.like if given and np.any(engine.like.views) else None
        super().__init__(
            engine,
            policy=policy,
            waiting=most,
            cut=cut,
            on_result=on_result,
            end_on_error=end_on_error,
            watch=RangeWatch(self.bounds, first),
            tolerance=tolerance,
        )
        _OPEN.add(self)

    @classmethod
    def for_cameras(
        cls,
        positions: ArrayLike,
        size: tuple[int, int],
        *,
        disparity_range: tuple[float, float],
        dtype: DTypeLike = np.uint8,
        channels: int = 3,
        reference: int | None = None,
        noise: float = _USUAL_NOISE,
        config: Config | str | None = None,
        weights: str | os.PathLike[str] | None = None,
        **options: Any,
    ) -> DepthStream:
        """Create a stream before there is any frame.

        Parameters
        ----------
        positions, reference
            As for `LightField`: [n, 2], (u, v) of each camera in view steps.
        size
            (height, width) of the views in pixels.
        dtype, channels
            uint8 (default), uint16 or float32 in [0, 1]; 1 or 3 (default).
        noise
            Root mean square difference between views that show the same point, intensity; default 0.004.
        config, weights, disparity_range, options
            As for `DepthStream`.
        """
        places = array_of_numbers("positions", positions, np.float64)
        sides = checked_sides("size", size, "(height, width)", least=2, most=2)
        check_whole("channels", channels, 1)
        check_number("noise", noise, 0, 1)
        views = np.zeros((len(places) if places.ndim else 0, *sides, channels), dtype)
        lf = LightField(views, places, reference=reference)
        config = live_config(config, weights)
        measured = method_of(config).given(lf.layout, disparity_range, noise)
        return cls(lf, config=config, measured=measured, **options)

    @property
    def bounds(self) -> tuple[float, float]:
        """(low, high) of the disparities, pixels per view step."""
        return self.measured.disparity_range

    @property
    def warnings(self) -> tuple[str, ...]:
        """Faults of the stream as a whole, a sentence each: a range that is too small, cameras not in step.

        The range is compared with the one that is found in the first views, in those after a cut, and in those of a map
        of which at least 1 % lies at one end; at most every ten seconds, beside the work on frames. Each sentence is
        also logged once by `logging`.
        """
        return (*self._notes, *self._watch.warnings, *self._stamps.warnings)

    # --- pushing frames ---

    def push(
        self,
        frame: Any,
        *,
        valid: Sequence[bool] | NDArray[np.bool_] | None = None,
        stamps: Sequence[float] | NDArray[np.floating[Any]] | None = None,
        tag: Any = None,
    ) -> StreamResult:
        """Add a frame. May be called from any thread. The array may be changed as soon as this returns.

        Parameters
        ----------
        frame
            Views [n, y, x, c] of the shape and type of the stream, with any strides: a NumPy array, or an array with
            DLPack or `__cuda_array_interface__`, on the CPU or on the stream's GPU. A full grid may be
            [v, u, y, x, c], and grey views may be [n, y, x].
        valid
            bool [n], False for cameras without a picture; their views are not read. The reference view and at least one
            other used view must be valid. Default None: all are valid.
        stamps
            [n], when each picture was taken, seconds on one clock; those of cameras without a picture are not read.
            They become `StreamResult.stamps` and are compared with the stream's `tolerance`. Default None: not known.
        tag
            Any object; it becomes `StreamResult.tag`. Default None.

        Returns
        -------
        StreamResult
            Returned at once, except that the policy "block" waits for space.

        Raises
        ------
        LfgpuError
            If the stream is closed, or was made by another process. Errors of the frame are in the result instead.
        """
        if os.getpid() != self._process:  # its threads are not here
            raise LfgpuError("the stream belongs to the process that made it; create one in this process.")
        there = np.ones(self._intake.count, bool) if valid is None else valid
        with self._numbering:
            self._inbox.refuse_if_closed()
            result = StreamResult(self._index, tag, np.asarray(there))
            self._index += 1
            self._counters.add("frames_pushed")
        slot = None
        try:
            result.valid = self._intake.checked_valid(there)
            result.stamps = None if stamps is None else checked_stamps(stamps, result.valid)
            checked, on_gpu = self._intake.checked(frame)
            slot = self._inbox.slot()
            self._intake.fill(slot, checked, result.valid, self._engine.transport, on_gpu=on_gpu)
        except Exception as error:  # the library of the frame may raise anything; only this frame fails
            if slot is not None:
                self._inbox.give_back(slot)
            elif isinstance(error, LfgpuError) and not isinstance(error, LightFieldError):  # closed meanwhile
                self._drop(result)
                raise
            if not isinstance(error, LightFieldError):
                error = LightFieldError(f"views cannot be read: {' '.join(str(error).split())}")
            self._fail(result, error)
            return result
        self._inbox.put(result, slot)
        return result

    def snapshot(self, *, timeout: float | None = None) -> Snapshot | None:
        """Take the views of the next frame that is solved, rectified, and its result; for looks at the cameras.

        Waits for that frame; the stream waits while its views are copied to the host.

        Parameters
        ----------
        timeout
            Seconds to wait at most; default None: no limit.

        Returns
        -------
        A light field of the views that are used, and the result, which may be pending; None if no frame came in time,
        or the stream was closed.
        """
        return self._next_shown(timeout)

    @property
    def used_views(self) -> tuple[int, ...]:
        """Indices of the views that maps are made from."""
        return tuple(self._used)

    def set_tones(self, tones: Float64Array) -> None:
        """Equalise the next frames with other tones [n, 3, c] (`Rectifier.tones`), of all cameras.

        LightFieldError without a rectifier, or if the shape is another one.
        """
        if self.rectifier is None:
            raise LightFieldError("the stream has no rectifier, so it cannot equalise its cameras; give it one.")
        with self._numbering:  # `close` returns the memory
            self.rectifier = self.rectifier.with_tones(tones)
            if self._buffers is None:
                self._engine.set_tones(self.rectifier.tones)

    def restart(self) -> None:
        """Forget the previous map: the next frame starts without it."""
        self._fresh = True

    def stats(self) -> dict[str, Any]:
        """Statistics as plain numbers. May be called from any thread, at any time.

        Returns
        -------
        Counts: `frames_pushed`, which is the sum of `frames_done`, `frames_dropped`, `frames_failed` and
        `frames_in_work`; `frames_cold`, `frames_with_missing_views`, `frames_over_budget`, `frames_beyond_range` (at
        least 1 % of the map lies at one end of the disparity range), `frames_out_of_step` (the stamps differ by more
        than the tolerance), `scene_cuts`, `callback_errors`, `warnings`, `frames_waiting`. Rate: `frames_per_second`
        over the last two seconds. Times over the latest 1024 results, NaN if there is none: `latency_p50_ms`,
        `latency_p95_ms`, `latency_p99_ms` from `push` to the map on the host, and `work_p50_ms` and so on for the
        device. Memory: `result_buffers`, the number of results that memory is allocated for; it grows if more results
        are held.
        """
        return {
            **self._counters.stats(),
            "warnings": len(self.warnings),
            "frames_waiting": len(self._inbox),
            "result_buffers": self._engine.transport.made if self._buffers is None else self._buffers,
        }

    def close(self, *, finish: bool = True) -> None:
        """End the stream and its threads. Waiting frames are finished if `finish` (default), else dropped.

        The memory of the device is returned; results that are still held keep theirs. May be called more than once,
        from any thread except in `on_result`.
        """
        if os.getpid() != self._process:  # a child that was forked has neither its threads nor its locks
            return
        if not self._end(finish=finish):
            return
        self._intake.close()
        _OPEN.discard(self)
        with self._numbering:
            if self._buffers is None:
                self._buffers = self._engine.transport.made
                self._inbox.forget_slots()
                del self._engine

    def __enter__(self) -> DepthStream:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        self.close(finish=kind is None)


def live_config(config: Config | str | None, weights: str | os.PathLike[str] | None) -> Config:
    """Return parameters as `methods.configured` does, those of "accurate" where neither is given."""
    return configured("accurate" if config is None and weights is None else config, weights)


_OPEN: weakref.WeakSet[DepthStream] = weakref.WeakSet()


def _close_all() -> None:
    """Close open streams when the interpreter exits, because no device work may run then."""
    for stream in list(_OPEN):
        stream.close(finish=False)


# Pools of threads end when the main thread does, before `atexit`; what is registered here ends before them.
getattr(threading, "_register_atexit", atexit.register)(_close_all)
