"""Source of frames in shared memory: the newest frame of a ring buffer (`lfgpu/io/ring.py`)."""

from lfgpu.data import LightField
from lfgpu.io.ring import RingReader
from lfgpu.pipelines.sources.base import Frames, Options

PREFIX = "ring:"


def recognise(source: str) -> bool:
    return source.startswith(PREFIX)


def frames(source: str, options: Options) -> Frames:
    """Yield each newest frame until the producer ends; then say how many were passed over."""
    path = source.removeprefix(PREFIX)
    passed = 0
    with RingReader(path) as ring:
        while (frame := ring.wait()) is not None:
            if frame.number == 1 + frame.passed:  # the first one that is read
                yield LightField(frame.views, ring.positions, ring.reference, name=path)
                continue
            passed += frame.passed
            yield frame.views, frame.valid
    if passed:
        options.say(f"{passed} frames of {path} were passed over, because newer ones came before they were asked for.")
