"""Streams under load: frames that wait, threads that push, streams that are closed in the middle of work."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from stream_runs import FRAMES, LONG, adds_up, frames, held, made, until

import lfgpu

pytestmark = pytest.mark.thorough


def test_latest_drops_what_waits() -> None:
    with made(policy="latest") as stream:
        with held(stream):
            first = stream.push(frames()[0].views)
            until(lambda: stream.stats()["frames_waiting"] == 0)
            results = [stream.push(lf.views) for lf in frames()]
            assert [result.dropped for result in results] == [True] * (FRAMES - 1) + [False]
        assert first.wait(LONG)
        assert results[-1].wait(LONG)
        with pytest.raises(lfgpu.FrameDroppedError, match="frame 1"):
            results[0].numpy()
        stats = stream.stats()
    assert (stats["frames_done"], stats["frames_dropped"]) == (2, FRAMES - 1)


def test_queue_keeps_some() -> None:
    with made(policy="queue", waiting=3) as stream, held(stream):
        stream.push(frames()[0].views)
        until(lambda: stream.stats()["frames_waiting"] == 0)
        results = [stream.push(lf.views) for lf in frames()]
        assert [result.dropped for result in results] == [True] * (FRAMES - 3) + [False] * 3
    assert stream.stats()["frames_done"] == 4


def test_block_makes_those_who_push_wait() -> None:
    with made(policy="block", waiting=1) as stream, ThreadPoolExecutor(1) as pool:
        with held(stream):
            stream.push(frames()[0].views)
            until(lambda: stream.stats()["frames_waiting"] == 0)
            stream.push(frames()[1].views)
            waits = pool.submit(stream.push, frames()[2].views)
            time.sleep(0.05)
            assert not waits.done()
        assert waits.result(LONG).wait(LONG)
    assert stream.stats()["frames_done"] == 3


@pytest.mark.parametrize("policy", ["latest", "block", "queue"])
def test_from_several_threads(policy: str) -> None:
    def push_some(seed: int) -> list[lfgpu.StreamResult]:
        random = np.random.default_rng(seed)
        return [stream.push(frames()[random.integers(FRAMES)].views) for _ in range(12)]

    with made(policy=policy) as stream, ThreadPoolExecutor(3) as pool:
        results = [result for part in pool.map(push_some, range(3)) for result in part]
        while not all(result.done for result in results):
            assert adds_up(stream.stats())
            time.sleep(0.002)
    assert sorted(result.index for result in results) == list(range(36))
    assert all(result.dropped or np.isfinite(result.numpy()).all() for result in results)
    stats = stream.stats()
    assert stats["frames_pushed"] == 36
    assert stats["frames_in_work"] == stats["frames_waiting"] == stats["frames_failed"] == 0
    assert stats["frames_dropped"] == sum(result.dropped for result in results)


@pytest.mark.parametrize("finish", [True, False])
def test_close_in_the_middle_of_work(finish: bool) -> None:
    before = threading.active_count()
    stream = made(policy="queue", waiting=4)
    with ThreadPoolExecutor(1) as pool:
        with held(stream):
            results = [stream.push(lf.views) for lf in frames()[:4]]
            closing = pool.submit(stream.close, finish=finish)
            until(lambda: stream._inbox.closed)
            with pytest.raises(lfgpu.LfgpuError, match="closed"):
                stream.push(frames()[0].views)
        closing.result(LONG)
    stream.close()
    assert all(result.done for result in results)
    assert finish or any(result.dropped for result in results)
    assert not finish or not any(result.dropped for result in results)
    stats = stream.stats()
    assert adds_up(stats)
    assert stats["frames_in_work"] == 0
    until(lambda: threading.active_count() <= before)


def test_close_wakes_those_who_wait() -> None:
    stream = made(policy="block", waiting=1)
    with ThreadPoolExecutor(2) as pool:
        with held(stream):
            stream.push(frames()[0].views)
            until(lambda: stream.stats()["frames_waiting"] == 0)
            stream.push(frames()[1].views)
            waits = pool.submit(stream.push, frames()[2].views)
            time.sleep(0.02)
            closing = pool.submit(stream.close, finish=False)
            with pytest.raises(lfgpu.LfgpuError, match="closed"):
                waits.result(LONG)
        closing.result(LONG)
    assert adds_up(stream.stats())
    assert stream.stats()["frames_in_work"] == 0


def test_failing_block_drops_what_waits() -> None:
    with pytest.raises(KeyError), made(policy="queue") as stream:  # noqa: PT012 - the block is what is tested
        with held(stream):
            results = [stream.push(lf.views) for lf in frames()[:3]]
            stream._inbox.close(finish=False)
        raise KeyError
    assert all(result.done for result in results)
