"""Time to rectify raw frames on the device, by itself and within a frame of a stream's method."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks import cases, clock
from benchmarks.cases import Case
from benchmarks.options import Backends, Cases, DeviceName, Out, Preset, Row, Seconds, collected, listed, places, say
from benchmarks.tables import Table
from lfgpu import DepthPipeline, LightField, Rectifier
from lfgpu._backends import backend_named, open_device
from lfgpu.calibration import Calibration, Misalignment, disturb, rectify
from lfgpu.contract import Device
from lfgpu.methods import method_of
from lfgpu.pipelines.rectifier import DeviceViews

RIG = Misalignment(shift=1.0, roll=0.1, scale=0.002, distortion=0.02, gain=0.05, vignetting=0.05)
"""The misalignment of the cameras that are rectified."""

_RANGE = (-2.0, 2.0)
_REPEATS = 25


COLUMNS = {
    "case": "{case}",
    "backend": "{backend} {device}",
    "all views, ms": "{all_ms:.3f}",
    "used views, ms": "{used}: {used_ms:.3f}",
    "frame, ms": "{frame_ms:.2f}",
    "added, ms": "{added_ms:.3f}",
    "host, ms": "{host_ms:.0f}",
    "error": "{error:.2f}",
}


def command(
    case_names: Cases = "7x7x375x375,9x9x512x512",
    preset: Preset = "accurate",
    backends: Backends = "warp",
    seconds: Seconds = 5.0,
    device: DeviceName = None,
    out: Out = None,
) -> None:
    """Time the rectification of raw frames on the device, by itself and as a part of a frame."""
    rows = run([cases.parse(name) for name in listed(case_names)], preset, listed(backends), device, seconds)
    Table.of("", 2, collected(rows, out, benchmark="rectify", about={"rig": asdict(RIG)}), COLUMNS).show()


def run(
    chosen: Sequence[Case], preset: str, backends: Sequence[str], device: str | None, seconds: float
) -> Iterator[Row]:
    """Measure all cases on all backends that have the device, each time for so many seconds at most.

    Times of a row are medians in milliseconds. `all_ms` rectifies all views, `used_ms` those that the preset uses.
    `frame_ms` is a whole estimate of views that are resident, without the way of the frame to the device,
    `rectified_ms` the same from raw pictures, in one graph where there are graphs, `added_ms` their difference.
    `host_ms` is `Rig.light_field`, by splines, on the host. `error` is the largest difference from the reference
    backend in one view, stored values.
    """
    for case in chosen:
        say(f"{case.name}: casting a scene and disturbing its cameras")
        scene = case.make("boxes", seed=0, noise=0.005)
        pictures, rectifier, host_ms = raw(scene)
        for place in places(backends, device):
            say(f"{case.name} {place.kernels.name} {place.name}")
            yield _measured(case, preset, place, pictures, rectifier, host_ms, seconds)


def raw(lf: LightField) -> tuple[LightField, Rectifier, float]:
    """Take pictures of a scene with `RIG`; return them, their rectifier, and the milliseconds of a host to rectify."""
    wrong = disturb(lf, RIG)
    made = rectify(wrong.light_field, calibration=Calibration(wrong.cameras, "rig", "lfgpu"))
    assert made.rig is not None
    start = time.perf_counter()
    made.rig.light_field(wrong.light_field)
    host_ms = 1000 * (time.perf_counter() - start)
    rectifier = made.rectifier()
    rectifier = rectifier.with_tones(np.stack([wrong.gain, wrong.offset, 0 * wrong.gain], axis=1))
    return rectifier.pictures(wrong.light_field.views), rectifier, host_ms


def _measured(
    case: Case,
    preset: str,
    device: Device,
    pictures: LightField,
    rectifier: Rectifier,
    host_ms: float,
    seconds: float,
) -> Row:
    rectified = rectifier.rectified(pictures, device)
    used = method_of(preset).used_views(rectified.offsets)

    def timed(**options: Any) -> float:
        work = DeviceViews(rectifier, pictures, device, **options).work
        return 1000 * clock.measure_on(device, work, repeats=_REPEATS, budget=seconds).seconds.median

    def frame(pipeline: DepthPipeline) -> float:
        for _ in range(2):  # the second one captures
            pipeline.run()
        found = clock.measure(pipeline.run, clock.stopper(device), repeats=_REPEATS, budget=seconds)
        return 1000 * found.seconds.median

    backend = backend_named(device.kernels.name)
    options: dict[str, Any] = {"config": preset, "disparity_range": _RANGE, "backend": backend, "device": device.name}
    plain = DepthPipeline(rectified, **options)
    whole = DepthPipeline(pictures, rectifier=rectifier, measured=plain.measured, **options)
    plain_ms, whole_ms = frame(plain), frame(whole)
    return {
        "case": case.name,
        "preset": preset,
        "backend": backend,
        "device": device.name,
        "views": len(pictures.views),
        "used": len(used),
        "all_ms": timed(),
        "used_ms": timed(used=used),
        "frame_ms": plain_ms,
        "rectified_ms": whole_ms,
        "added_ms": whole_ms - plain_ms,
        "host_ms": host_ms,
        "error": _error(pictures, rectifier, rectified),
    }


def _error(pictures: LightField, rectifier: Rectifier, rectified: LightField) -> float:
    """Compare with the reference in the last view."""
    reference = open_device("reference")
    found = DeviceViews(rectifier, pictures, reference, used=[len(pictures.views) - 1])
    found.work()
    return float(np.abs(reference.kernels.numpy(found.views)[0] - rectified.views[-1]).max())
