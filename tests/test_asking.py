"""A pipeline and a stream on one GPU at once: what one captures holds nothing of the other's work."""

import threading
from typing import Any

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load

GPU = "cuda:0"
OPTIONS: dict[str, Any] = {"config": "fast", "disparity_range": (-1.2, 1.2), "device": GPU}
FRAMES = 90

pytestmark = pytest.mark.skipif(GPU not in load("warp").devices(), reason=f"no {GPU} here")


def test_pipelines_capture_while_a_stream_runs() -> None:
    """All results are held, so that the stream asks for memory while pipelines capture."""
    lf = scenes.make("boxes", grid=(5, 5), size=(96, 128), disparity_range=(-1, 1), noise=0.01, seed=1)
    other = scenes.make("planes", grid=(5, 5), size=(96, 128), disparity_range=(-1, 1), noise=0.01, seed=2)
    want = lfgpu.estimate_depth(lf, **OPTIONS).disparity
    streamed = lfgpu.estimate_depth(other, **OPTIONS).disparity
    stop, results = threading.Event(), []

    with lfgpu.DepthStream(other, **OPTIONS, prior=None, policy="block") as stream:

        def feed() -> None:
            while not stop.is_set():
                results.append(stream.push(other.views))

        feeder = threading.Thread(target=feed)
        feeder.start()
        try:
            for _ in range(FRAMES // 3):
                pipeline = lfgpu.DepthPipeline(lf, **OPTIONS)
                for _ in range(3):  # the second run captures, the third replays
                    pipeline.run()
                    np.testing.assert_array_equal(pipeline.disparity(), want)
        finally:
            stop.set()
            feeder.join()
    assert len(results) > 3
    for result in results:
        np.testing.assert_array_equal(result.numpy(), streamed)
