"""Loop that feeds a stream from a source."""

import time
from collections import deque
from collections.abc import Callable
from typing import Any

from lfgpu.data import LightField
from lfgpu.pipelines.sources.base import Frames
from lfgpu.pipelines.stream import DepthStream
from lfgpu.pipelines.stream_result import StreamResult

_ASKED_AGAIN = 0.05  # seconds between two questions whether to hold on


def feed(
    stream: DepthStream,
    frames: Frames,
    *,
    max_fps: float | None = None,
    most: int | None = None,
    hold: Callable[[], bool] = lambda: False,
    tag: Callable[[int, Any], Any] = lambda index, _: index,
    on_done: Callable[[StreamResult], None] | None = None,
) -> None:
    """Push frames into a stream until they end, and wait for the last map, also where the frames end with an error.

    A wrong frame becomes a failed result of the stream. With `max_fps`, the next frame is asked for when its time has
    come; of a live source it is then the newest one. Before each frame, `hold` is asked for a pause. `tag(index,
    views)` gives the `tag` of each result, by default the index. `on_done` takes each result in order, also failed and
    dropped ones, in the thread that feeds.
    """
    pending: deque[StreamResult] = deque()

    def look(*, wait: bool) -> None:
        while pending and (wait or pending[0].done):
            result = pending.popleft()
            result.wait()
            if on_done is not None:
                on_done(result)

    next_time = time.perf_counter()
    index = 0
    while most is None or index < most:
        if hold():
            look(wait=True)
            time.sleep(_ASKED_AGAIN)
            continue
        if max_fps is not None:
            time.sleep(max(0.0, next_time - time.perf_counter()))
            next_time = max(next_time, time.perf_counter()) + 1 / max_fps
        try:
            frame = next(frames)
        except StopIteration:
            break
        except Exception:
            look(wait=True)
            raise
        views, valid = frame if isinstance(frame, tuple) and len(frame) == 2 else (frame, None)
        views = views.views if isinstance(views, LightField) else views
        pending.append(stream.push(views, valid=valid, tag=tag(index, views)))
        look(wait=False)
        index += 1
    look(wait=True)
