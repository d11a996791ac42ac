"""Helpers of tests of streams: a scene that moves, streams of it, and waiting without an end."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

import numpy as np

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.data import LightField

RANGE = (-1.5, 1.5)
FRAMES = 6
LONG = 600.0  # seconds: nothing takes that long unless it hangs


@cache
def frames() -> tuple[LightField, ...]:
    """A scene that moves slowly: the first frames of many."""
    options: dict[str, Any] = {"grid": (3, 5), "size": (40, 44), "noise": 0.01}
    return tuple(lf for lf, _ in zip(scenes.sequence("moving", frames=90, **options), range(FRAMES), strict=False))


@cache
def other_scene() -> LightField:
    return scenes.make("planes", seed=3, grid=(3, 5), size=(40, 44))


@cache
def alone(config: str, index: int) -> np.ndarray:
    """Compute the map of a later frame with a pipeline that was made for the first one."""
    pipeline = lfgpu.DepthPipeline(frames()[0], config=config, disparity_range=RANGE, device="cpu")
    pipeline.upload(frames()[index].views)
    pipeline.run()
    return pipeline.disparity()


def made(lf: LightField | None = None, **options: Any) -> lfgpu.DepthStream:
    options = {"config": "fast", "disparity_range": RANGE, "device": "cpu", "policy": "block", **options}
    return lfgpu.DepthStream(lf or frames()[0], **options)


@contextmanager
def held(stream: lfgpu.DepthStream) -> Iterator[None]:
    """The stream gets no further than the frame that it works on."""
    with load("warp").asking(stream.device):
        yield


@contextmanager
def pushing(push: Callable[[], object], every: float = 0.0) -> Iterator[None]:
    """Push frames from a thread of its own, one after the other or so many seconds apart."""
    stop = threading.Event()

    def run() -> None:
        while not stop.wait(every):
            push()

    pusher = threading.Thread(target=run)
    pusher.start()
    try:
        yield
    finally:
        stop.set()
        pusher.join()


def until(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + LONG
    while not condition():
        assert time.monotonic() < end, "it hangs"
        time.sleep(0.001)


def adds_up(stats: dict[str, Any]) -> bool:
    ends = sum(stats[f"frames_{name}"] for name in ("done", "dropped", "failed", "in_work"))
    return bool(stats["frames_pushed"] == ends)
