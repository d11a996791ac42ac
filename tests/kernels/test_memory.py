"""Memory of arrays: whoever drops them, from whatever thread, it is free, and nobody else's work comes to harm."""

import gc
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

IMAGE = (8, 512, 512, 3)
PIXELS = np.zeros(IMAGE, np.uint8)


@pytest.mark.skipif(sys.platform != "linux", reason="reads how much memory the process has from /proc")
@pytest.mark.parametrize("channels", [1, 3, 7])
def test_what_was_dropped_is_used_again(target: Any, channels: int) -> None:
    if target.device != "cpu":
        pytest.skip("the memory of a GPU is not that of the process")
    pixels = np.zeros((*IMAGE[:3], channels), np.uint8)

    def used_after(count: int) -> int:
        for _ in range(count):
            target.kernels.image(pixels, "cpu")
        gc.collect()
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

    before = used_after(5)
    assert used_after(30) < before + 10 * pixels.nbytes


def test_threads_make_arrays_and_drop_those_of_others(target: Any) -> None:
    """Some lie in cycles, which Python finds in any thread that collects garbage meanwhile."""
    kernels, device, stop = target.kernels, target.device, threading.Event()

    def collect() -> None:
        while not stop.is_set():
            gc.collect()

    def make(number: int) -> list[Any]:
        cycle: list[Any] = [kernels.image(PIXELS[:1] + np.uint8(number), device)]
        cycle += [kernels.field(np.full((3, 50), number), device), cycle]
        kernels.copy(cycle[1], kernels.zeros((3, 50), device))
        return cycle

    collector = threading.Thread(target=collect)
    collector.start()
    try:
        with ThreadPoolExecutor(2) as pool:
            for first in range(0, 20, 4):
                for number, (image, field, _) in enumerate(pool.map(make, range(first, first + 4)), first):
                    assert (kernels.numpy(image) == number).all()
                    assert (kernels.numpy(field) == number).all()
    finally:
        stop.set()
        collector.join()


def test_arrays_that_outlive_modules_end_in_silence() -> None:
    """Python takes modules apart at its end, those of the backend before those that were there at its start."""
    code = (
        "import sys, numpy; from lfgpu._backends import load; kernels = load('taichi'); "
        "sys.modules['collections.abc'].kept = kernels.field(numpy.zeros((5, 5)), 'cpu')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == ""
