"""Frames of another process through shared memory: how many arrive at a rate, how late, and whether any is torn."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.errors import BenchmarkError
from lfgpu.io.ring import RingReader, RingWriter

_PLACE = Path("/dev/shm")
_START = 600.0  # seconds: no producer takes that long to start


@dataclass(frozen=True)
class Found:
    """Frames that were read, that were passed over, whose values are not all those of one frame, and copies that were
    made again; milliseconds from `publish` to the copy."""

    rate: float
    seconds: float
    frame_bytes: int
    read: int
    passed: int
    torn: int
    repeated: int
    late_p50: float
    late_p99: float


def run(grid: tuple[int, int], size: tuple[int, int], rate: float, seconds: float) -> Found:
    """Start a producer and read what it writes; every value of a frame is the number of that frame modulo 251."""
    with tempfile.TemporaryDirectory(dir=_PLACE if _PLACE.is_dir() else None) as folder:
        path = Path(folder) / "ring"
        command = [sys.executable, "-m", "benchmarks.ring", str(path), *map(str, (*grid, *size, rate, seconds))]
        with subprocess.Popen(command) as producer:
            end = time.monotonic() + _START
            while not path.exists():
                if producer.poll() is not None or time.monotonic() > end:
                    raise BenchmarkError("the producer did not start.")
                time.sleep(0.001)
            return _read(path, rate, seconds)


def _read(path: Path, rate: float, seconds: float) -> Found:
    torn, passed, late, size = 0, 0, list[float](), 0
    with RingReader(path) as reader:
        while (frame := reader.wait()) is not None:
            late.append((time.time_ns() - frame.time_ns) / 1e6)
            torn += not (frame.views == frame.number % 251).all()
            passed += frame.passed
            size = frame.views.nbytes
        p50, p99 = (float(value) for value in np.percentile(late, (50, 99)))
        return Found(rate, seconds, size, len(late), passed, torn, reader.repeated, p50, p99)


def _produce(path: str, rows: int, columns: int, height: int, width: int, rate: float, seconds: float) -> None:
    positions = [(u, v) for v in range(rows) for u in range(columns)]
    with RingWriter(path, positions, (height, width)) as ring:
        start = time.perf_counter()
        for number in range(1, round(rate * seconds) + 1):
            time.sleep(max(0.0, start + number / rate - time.perf_counter()))
            ring.begin()[:] = number % 251
            ring.publish()
        time.sleep(0.5)  # the last frame can be read


if __name__ == "__main__":
    _produce(sys.argv[1], *map(int, sys.argv[2:6]), *map(float, sys.argv[6:]))
