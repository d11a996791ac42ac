"""Helpers of tests of batches: recorded light fields, settings, clusters on this machine."""

import contextlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu.batch.cluster import Cluster
from lfgpu.batch.items import Item, find_items
from lfgpu.batch.manifest import DONE, Manifest, read_manifest
from lfgpu.batch.run import Batch, Summary, _jobs
from lfgpu.batch.work import Settings, work
from lfgpu.io import load, write_hci
from lfgpu.methods import preset

pytest.importorskip("distributed", reason="a batch needs Dask: pip install -e '.[batch]'")

ROOT = Path(__file__).parents[1]
RANGE = (-1.2, 1.2)
QUICK = preset("fast").with_values({"prior.window": 3, "sweep.step": 1.0})
FAST = Settings(QUICK, RANGE)
SLOW = Settings(QUICK.with_values({"alignment.iterations": 100}), RANGE)
"""Settings with which an item takes long enough to be killed in the middle."""
COUNT = 5


def jobs(inputs: Path, out: Path, settings: Settings = FAST, *, sequence: bool = False) -> list[Any]:
    return _jobs(find_items([str(inputs)], sequence=sequence)[0], out, settings)


def done(items: list[Item], out: Path, settings: Settings) -> Summary:
    """A batch of what is left to do, in this process."""
    batch = Batch(items, out, settings)
    with Manifest(out) as manifest:
        for job in batch._todo(read_manifest(out)):
            entry = work(job, "cpu")
            batch.summary.entries[job.item.name] = entry
            if entry["status"] == DONE:
                batch.summary.computed += 1
            else:
                batch.summary.failed.append(entry)
            manifest.add([entry])
    return batch.summary


def local(**options: Any) -> Cluster:
    return Cluster(workers=1, devices=("cpu",), threads=1, **options)


def pids(cluster: Cluster) -> set[int]:
    """Those of the workers that answer.

    Not of `os.getpid` itself: Dask asks for the signature of what it calls, Python parses that of a built-in function,
    and no thread may do so while another one imports Warp, which parses its kernels (a fault of Python 3.11).
    """
    with contextlib.suppress(Exception):
        return set(cluster.client.run(lambda: os.getpid(), on_error="ignore").values())
    return set()


def assert_same_maps(a: Path, b: Path) -> None:
    names = {entry["item"] for entry in read_manifest(a).values() if entry["status"] == DONE}
    assert names
    assert names == {entry["item"] for entry in read_manifest(b).values() if entry["status"] == DONE}
    for name in names:
        assert (a / name / "disparity.pfm").read_bytes() == (b / name / "disparity.pfm").read_bytes(), name
        ours, theirs = load(a / name / "result.npz"), load(b / name / "result.npz")
        assert np.array_equal(ours.confidence, theirs.confidence), name


def assert_nothing_left_over(out: Path) -> None:
    assert not list(out.rglob(".lfgpu-*"))


def wait_for(true: Callable[[], object], seconds: float = 600) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def record(folder: Path) -> Path:
    """Write light fields into a folder; one of them cannot be read."""
    for index in range(COUNT):
        lf = scenes.make("relief", grid=(3, 3), size=(40, 48), disparity_range=(-1, 1), seed=index)
        write_hci(lf, folder / f"scene_{index}")
    damaged = folder / "scene_2" / "input_Cam004.png"
    damaged.write_bytes(damaged.read_bytes()[:200])
    return folder
