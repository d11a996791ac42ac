"""Streams and pipelines in several threads and processes: same maps, none that hangs, a sentence for the rest."""

import multiprocessing
import os
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lfgpu.kernels.warp import asking as locks

import lfgpu
from lfgpu import scenes
from lfgpu.data import LightField

pytestmark = pytest.mark.thorough

RANGE = (-1.0, 1.0)
OPTIONS: dict[str, Any] = {"config": "fast", "disparity_range": RANGE, "device": "cpu"}
LONG = 600.0  # seconds: nothing takes that long unless it hangs

_SCENE = """
import os, sys, threading, time
import numpy as np
import lfgpu
from lfgpu import scenes
lf = scenes.make("planes", grid=(3, 3), size=(32, 32), disparity_range=(-1, 1))
options = {"config": "fast", "disparity_range": (-1, 1), "device": "cpu"}
"""


@cache
def lf() -> LightField:
    return scenes.make("planes", grid=(3, 3), size=(32, 32), disparity_range=RANGE)


@cache
def alone() -> np.ndarray:
    return lfgpu.estimate_depth(lf(), **OPTIONS).disparity


def estimated() -> np.ndarray:
    return lfgpu.estimate_depth(lf(), **OPTIONS).disparity


def run(code: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    command = [sys.executable, "-c", _SCENE + code]
    return subprocess.run(command, capture_output=True, text=True, timeout=LONG, env=environment, check=False)


# --- threads ---


def test_streams_pipelines_and_exports_in_several_threads(tmp_path: Path) -> None:
    """Each gives the maps that it gives alone."""
    want = {name: lfgpu.estimate_depth(lf(), **{**OPTIONS, "config": name}).disparity for name in ("accurate", "paper")}

    def streamed(_: int) -> None:
        with lfgpu.DepthStream(lf(), prior=None, policy="block", **OPTIONS) as stream:
            for result in [stream.push(lf().views) for _ in range(8)]:
                np.testing.assert_array_equal(result.numpy(), alone())

    def piped(name: str) -> None:
        pipeline = lfgpu.DepthPipeline(lf(), **{**OPTIONS, "config": name})
        for _ in range(4):
            pipeline.run()
            np.testing.assert_array_equal(pipeline.disparity(), want[name])

    def exported(_: int) -> None:
        lfgpu.export_pipeline(lf(), tmp_path / "out", **OPTIONS)

    with ThreadPoolExecutor(5) as pool:
        jobs = [pool.submit(streamed, 0), pool.submit(piped, "accurate"), pool.submit(exported, 0)]
        jobs += [pool.submit(piped, "paper"), pool.submit(streamed, 1)]
        for job in jobs:
            job.result(LONG)
    assert (tmp_path / "out" / "pipeline.wrp").stat().st_size > 0


def test_who_holds_a_device_may_not_capture() -> None:
    """Two threads that did so with two devices would wait for each other."""
    with locks.asking("cpu"), pytest.raises(RuntimeError, match="outside of `asking`"), locks.alone():
        pass
    with locks.alone(), locks.asking("cpu"), locks.alone():  # who is alone already may
        pass


def test_devices_do_not_wait_for_each_other() -> None:
    entered = threading.Event()

    def enter() -> None:
        with locks.asking("cuda:7"):
            entered.set()

    with locks.asking("cpu"):
        thread = threading.Thread(target=enter)
        thread.start()
        assert entered.wait(LONG)
        thread.join()


# --- processes ---


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_processes_that_are_forked_while_a_stream_runs() -> None:
    """Their locks are free, whatever the threads of the parent held; the stream is the parent's."""
    done = run(
        """
want = lfgpu.estimate_depth(lf, **options).disparity
stream, stop = lfgpu.DepthStream(lf, policy="block", **options), threading.Event()
def feed():
    while not stop.is_set():
        stream.push(lf.views)
feeder = threading.Thread(target=feed)
feeder.start()
for _ in range(5):
    time.sleep(0.02)
    child = os.fork()
    if child == 0:
        try:
            stream.push(lf.views)
        except lfgpu.LfgpuError as error:
            assert "belongs to the process that made it" in str(error)
            stream.close()
            same = np.array_equal(lfgpu.estimate_depth(lf, **options).disparity, want)
            os._exit(0 if same else 3)
        os._exit(4)
    print(os.waitpid(child, 0)[1])
stop.set()
feeder.join()
stream.close()
"""
    )
    assert done.stdout.split() == ["0"] * 5, done.stderr


def test_processes_that_are_spawned() -> None:
    alone()
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        np.testing.assert_array_equal(pool.submit(estimated).result(LONG), alone())


def test_a_gpu_that_the_parent_has_used_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "_gpu_of_parent", True)
    with pytest.raises(lfgpu.BackendError, match=r"get_context\('spawn'\), or use device 'cpu'"):
        locks.asking("cuda:0")
    np.testing.assert_array_equal(estimated(), alone())


def test_children_know_that_the_parent_has_used_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """The hook of a forked child runs here without a child."""
    monkeypatch.setattr(locks, "_gpu_of_parent", False)
    monkeypatch.setattr(locks, "started", ["cpu"])
    locks._in_child()
    assert not locks._gpu_of_parent
    monkeypatch.setattr(locks, "started", ["cuda:0", "cpu"])
    locks._in_child()
    assert locks._gpu_of_parent


# --- the end ---


def test_programs_that_close_nothing_or_fail_end() -> None:
    """With frames that wait, one that is worked on, and a callback that is called."""
    done = run(
        """
stream = lfgpu.DepthStream(lf, policy="queue", waiting=50, on_result=lambda result: time.sleep(0.01), **options)
results = [stream.push(lf.views) for _ in range(40)]
results[0].wait()
print("end")
"""
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "end\n", "")
    done = run(
        """
stream = lfgpu.DepthStream(lf, policy="queue", waiting=50, **options)
results = [stream.push(lf.views) for _ in range(40)]
raise KeyError("of the program")
"""
    )
    assert done.returncode == 1
    assert done.stderr.count("Traceback") == 1
    assert done.stderr.endswith("KeyError: 'of the program'\n")
