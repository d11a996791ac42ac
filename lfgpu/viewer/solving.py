"""The solver of the viewer: one estimate at a time in a thread, with progress and cancellation."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from lfgpu.config import Config
from lfgpu.data import DepthResult, LightField
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.methods import method_of
from lfgpu.viewer.late import import_all

_MOST = 256  # pixels along a side of a preview


@dataclass(frozen=True)
class Request:
    """A request: the light field and the settings of an estimate."""

    lf: LightField
    config: Config
    disparity_range: tuple[float, float] | None = None
    name: str = "result"
    frame: int = 0  # number of the frame of a stream, as `Contents.frame`


def preview(request: Request, left: int, top: int, right: int, bottom: int) -> NDArray[np.float32]:
    """Estimate a window [y, x] of the map alone, of at most 256 x 256 pixels."""
    import_all()
    from lfgpu.pipelines.estimate import estimate_depth

    if min(left, top) < 0 or max(right - left, bottom - top) > _MOST:
        raise LightFieldError(f"a preview has at most {_MOST} x {_MOST} pixels of the map.")
    part = request.lf.crop(slice(top, bottom), slice(left, right))
    return estimate_depth(
        part, config=request.config, disparity_range=request.disparity_range, check_cameras=False
    ).disparity


@dataclass(frozen=True)
class Progress:
    """The progress of an estimate."""

    text: str = ""
    share: float = 0.0
    busy: bool = False
    failed: bool = False


class _Stopped(Exception):  # noqa: N818 - nothing went wrong
    """Raised in the solver when its request was cancelled."""


class Solver:
    """Runs one request at a time in its own thread, from which progress, requests and results are told."""

    def __init__(
        self, on_progress: Callable[[Progress], None], on_result: Callable[[Request, DepthResult], None]
    ) -> None:
        self._on_progress, self._on_result = on_progress, on_result
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.progress = Progress()

    def start(self, request: Request) -> bool:
        """Start a request, unless another one is running. Returns whether it was started."""
        with self._lock:
            if self.progress.busy:
                return False
            self._stop.clear()
            self._say("starting; the first time, kernels are compiled", 0.0)
            self._thread = threading.Thread(target=self._work, args=(request,), name="lfgpu-solver", daemon=True)
            self._thread.start()
            return True

    def stop(self) -> None:
        """Cancel the request at the end of the current step."""
        self._stop.set()

    def close(self, timeout: float = 10.0) -> None:
        """Cancel and wait for the thread."""
        self.stop()
        if self._thread is not None:
            self._thread.join(timeout)

    def _work(self, request: Request) -> None:
        import_all()
        from lfgpu.pipelines.estimate import estimate_depth

        start = perf_counter()
        config = request.config
        method = method_of(config)
        order = {stage.name: place for place, stage in enumerate(method.stages)}

        def show(stage: str, iteration: int, _value: float) -> None:
            if self._stop.is_set():
                raise _Stopped
            within = iteration / (method.iterations(stage) or 1)
            place = order[stage]
            text = f"{method.stages[place].label}{f', iteration {iteration}' if iteration else ''}"
            self._say(f"{text}, {perf_counter() - start:.1f} s", 100 * min(1.0, (place + within) / len(order)))

        try:
            result = estimate_depth(
                request.lf,
                config=config,
                disparity_range=request.disparity_range,
                on_progress=show,
            )
        except _Stopped:
            self._say("stopped", 0.0, busy=False)
        except (LfgpuError, MemoryError) as error:
            self._say(str(error) or "the memory does not suffice.", 0.0, busy=False, failed=True)
        except Exception as error:
            self._say(f"this failed, which is a bug: {type(error).__name__}: {error}", 0.0, busy=False, failed=True)
            raise
        else:
            self._on_result(request, result)
            self._say(f"{request.name}: done in {perf_counter() - start:.1f} s", 100.0, busy=False)

    def _say(self, text: str, share: float, *, busy: bool = True, failed: bool = False) -> None:
        self.progress = Progress(text, share, busy, failed)
        self._on_progress(self.progress)
