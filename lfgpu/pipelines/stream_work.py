"""Work of a stream on its frames, in threads: one asks the device for it, one waits for the maps and hands them on."""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from time import perf_counter
from typing import Any, TypeAlias

from lfgpu.data import LightField
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.pipelines.inbox import Inbox
from lfgpu.pipelines.stream_engine import Engine, Level, fault
from lfgpu.pipelines.stream_result import FrameDroppedError, OnResult, StreamResult
from lfgpu.pipelines.stream_stats import Counters
from lfgpu.pipelines.watches import FirstErrors, RangeWatch, StampWatch

Snapshot: TypeAlias = tuple[LightField, StreamResult]
"""The views of a frame, and its result, which may be pending."""


class StreamWork:
    """Work on the frames of an inbox, one after the other, until the inbox is closed and empty.

    A third thread watches the disparity range. `on_result`, `cut` and `end_on_error` are those of `DepthStream`.
    """

    def __init__(
        self,
        engine: Engine,
        *,
        policy: str,
        waiting: int,
        cut: float,
        on_result: OnResult | None,
        end_on_error: bool,
        watch: RangeWatch,
        tolerance: float | None,
    ) -> None:
        self._engine, self._used, self.device = engine, engine.used, engine.device
        self.on_result, self._end_on_error = on_result, end_on_error
        self._cut = cut
        self._fresh = True  # True if there is no previous map to start from
        self._watch, self._stamps = watch, StampWatch(tolerance, self._used)
        self._errors, self._counters = FirstErrors(), Counters()
        self._wishes: deque[Future[Snapshot | None]] = deque()  # for snapshots
        self._has_ended = False
        slots = [engine.transport.slot() for _ in range(waiting + 2)]
        self._inbox: Inbox[StreamResult, Any] = Inbox(policy, waiting, slots, self._drop)
        self._under_way: queue.SimpleQueue[tuple[StreamResult, Any, Level] | None] = queue.SimpleQueue()
        loops: dict[str, Callable[[], None]] = {
            "solve": self._serve,
            "deliver": self._deliver,
            "range": partial(watch.run, self._next_shown, self._errors),
        }
        self._threads = [
            threading.Thread(target=loop, name=f"lfgpu-{name}", daemon=True) for name, loop in loops.items()
        ]
        for thread in self._threads:
            thread.start()

    def _end(self, *, finish: bool) -> bool:
        """End the threads; tell whether they have ended, which they have not if one of them asks for it."""
        self._inbox.close(finish=finish)
        if threading.current_thread() in self._threads:
            return False
        self._watch.close()
        for thread in self._threads:
            thread.join()
        return True

    def _next_shown(self, timeout: float | None = None) -> Snapshot | None:
        """Wait for the views of the next frame that is solved, and its result; None if none came in time."""
        wish: Future[Snapshot | None] = Future()
        self._wishes.append(wish)
        if self._has_ended:
            self._answer(None)
        with suppress(TimeoutError):
            return wish.result(timeout)
        with suppress(ValueError):  # it was answered a moment too late
            self._wishes.remove(wish)
        return None

    def _serve(self) -> None:
        """Start work on the device, frame by frame; the loop of a thread."""
        engine = self._engine
        engine.transport.enter()
        while (taken := self._inbox.get()) is not None:
            result, slot = taken
            try:
                try:
                    changed, unscaled = engine.transport.bring(slot)
                finally:
                    self._inbox.give_back(slot, filled=True)
                if unscaled > 0:
                    self._fresh = True
                    self._fail(result, LightFieldError("views have values far outside [0, 1]; scale float views."))
                    continue
                result.cut = not self._fresh and engine.has_prior and changed > self._cut
                result.cold = self._fresh or result.cut or not engine.has_prior
                level = engine.level(cold=result.cold)
                result.steps, self._fresh = level.steps, False
                maps = engine.solve(level, result.valid[self._used])
                if self._wishes:
                    self._answer((engine.shown(result.valid[self._used]), result))
            except Exception as error:  # if the device fails, the result must not stay pending
                self._fresh = True
                engine.forget_mask()
                self._fail(result, self._failed(error))
                continue
            self._under_way.put((result, maps, level))
        self._under_way.put(None)
        self._has_ended = True
        self._answer(None)

    def _answer(self, shown: Snapshot | None) -> None:
        """Give all who wait for a snapshot this one, or none."""
        with suppress(IndexError):  # until nobody waits; some may give up meanwhile
            while True:
                self._wishes.popleft().set_result(shown)

    def _deliver(self) -> None:
        """Wait for the device, frame by frame; the loop of a thread."""
        transport = self._engine.transport
        transport.enter()
        while (item := self._under_way.get()) is not None:
            result, maps, level = item
            try:
                work, trust, moved = transport.wait(maps)
            except Exception as error:
                self._fresh = True
                self._fail(result, self._failed(error))
                continue
            level.took(work)
            if (problem := fault(trust, moved)) is not None:
                self._fresh = True
                transport.give(maps)
                self._fail(result, LightFieldError(f"frame {result.index}: {problem}"))
                continue
            self._complete(result, maps, work)
            del result, maps, item  # frees the memory if nobody holds the result

    def _complete(self, result: StreamResult, maps: Any, work: float) -> None:
        result.latency, result.work = perf_counter() - result._pushed, work
        extra = {
            "frames_cold": result.cold,
            "scene_cuts": result.cut,
            "frames_with_missing_views": not result.valid.all(),
            "frames_over_budget": self._engine.is_over_budget(work),
            "frames_out_of_step": self._stamps.look(result.index, result.stamps),
        }
        self._counters.done(result.latency, work, *(name for name, counts in extra.items() if counts))
        result._finish(self._engine.transport.lease(maps))
        callback = self.on_result
        if callback is not None and not (self._end_on_error and self._inbox.reason):
            try:
                callback(result)
            except BaseException as error:  # others' mistakes must not end the thread, sys.exit() included
                self._counters.add("callback_errors")
                self._errors.log(f"on_result failed with frame {result.index}", error)
                if self._end_on_error:
                    said = f"{type(error).__name__}: {error}".rstrip(": ")
                    self._inbox.close(finish=False, reason=f"on_result failed ({said})")
        if self._watch.look(result._maps().numpy(0), is_new=result.cut):
            self._counters.add("frames_beyond_range")

    def _failed(self, error: Exception) -> LfgpuError:
        """Make the sentence about a failure of the device."""
        self._errors.log("the device failed", error)
        remedy = "" if self.device == "cpu" else "; if all frames fail from now on, start the program again"
        return LfgpuError(f"the device failed ({' '.join(str(error).split()).rstrip('.')}){remedy}.")

    def _fail(self, result: StreamResult, error: LfgpuError) -> None:
        self._counters.add("frames_failed")
        result._fail(error)

    def _drop(self, result: StreamResult) -> None:
        self._counters.add("frames_dropped")
        why = "frames came faster than maps or the stream was closed"
        result._fail(FrameDroppedError(f"frame {result.index} was dropped, because {why}."))
