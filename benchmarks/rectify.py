"""What rectifying raw frames on the device costs, by itself and within a frame of a stream's method."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks import clock
from benchmarks.cases import Case
from lfgpu import DepthPipeline, LightField, Rectifier, scenes
from lfgpu._backends import backend_named, load, pick_device
from lfgpu.calibration import Calibration, Misalignment, disturb, rectify
from lfgpu.errors import BackendError
from lfgpu.methods import method_of
from lfgpu.pipelines.rectifier import Rectification

Say = Callable[[str], None]
RIG = Misalignment(shift=1.0, roll=0.1, scale=0.002, distortion=0.02, gain=0.05, vignetting=0.05)
"""What is wrong with the cameras that are rectified."""

_RANGE = (-2.0, 2.0)
_REPEATS = 25


@dataclass(frozen=True)
class Row:
    """One case on one backend and device; times are medians in milliseconds.

    `all_ms` rectifies all views, `used_ms` those that the preset uses. `frame_ms` is a whole estimate of views that are
    resident, without the way of the frame to the device, `rectified_ms` the same from raw pictures, in one graph where
    there are graphs. `host_ms` is `Rig.light_field`, by splines, on the host. `error` is the largest difference from
    the reference backend in one view, stored values.
    """

    case: str
    preset: str
    backend: str
    device: str
    views: int
    used: int
    all_ms: float
    used_ms: float
    frame_ms: float
    rectified_ms: float
    host_ms: float
    error: float

    @property
    def added_ms(self) -> float:
        """What rectification adds to a frame, all views of which are rectified."""
        return self.rectified_ms - self.frame_ms


def run(
    cases: tuple[Case, ...],
    preset: str,
    backends: tuple[str, ...],
    device: str | None,
    say: Say,
    *,
    seconds: float = 5.0,
) -> Iterator[Row]:
    """Measure all cases on all backends that have the device, each time for so many seconds at most."""
    for case in cases:
        say(f"{case.name}: casting a scene and disturbing its cameras")
        scene = scenes.make("boxes", grid=case.grid, size=case.size, seed=0, noise=0.005)
        pictures, rectifier, host_ms = raw(scene)
        for backend in backends:
            try:
                place = pick_device(load(backend), device)
            except BackendError as error:
                say(f"{case.name} {backend}: {error}")
                continue
            say(f"{case.name} {backend} {place}")
            yield _measured(case, preset, backend, place, pictures, rectifier, host_ms, seconds)


def raw(lf: LightField) -> tuple[LightField, Rectifier, float]:
    """Pictures that `RIG` takes of a scene, their rectifier, and milliseconds that the host takes to rectify them."""
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
    backend: str,
    device: str,
    pictures: LightField,
    rectifier: Rectifier,
    host_ms: float,
    seconds: float,
) -> Row:
    kernels = load(backend)
    rectified = rectifier.rectified(pictures, kernels, device)
    used = method_of(preset).used_views(rectified.layout)

    def timed(work: Callable[[], None]) -> float:
        stop, capture = clock.stopper(kernels, device), clock.capturer(kernels, device)
        found = clock.measure(work, stop, repeats=_REPEATS, budget=seconds, capture=capture)
        return 1000 * found.seconds.median

    def frame(pipeline: DepthPipeline) -> float:
        stop = clock.stopper(kernels, device)
        for _ in range(2):  # the second one captures
            pipeline.run()
        found = clock.measure(pipeline.run, stop, repeats=_REPEATS, budget=seconds)
        return 1000 * found.seconds.median

    options = {"config": preset, "disparity_range": _RANGE, "backend": backend_named(backend), "device": device}
    plain = DepthPipeline(rectified, **options)  # type: ignore[arg-type]
    whole = DepthPipeline(pictures, rectifier=rectifier, measured=plain.measured, **options)  # type: ignore[arg-type]
    return Row(
        case.name,
        preset,
        backend,
        device,
        len(pictures.views),
        len(used),
        timed(Rectification(rectifier, pictures, kernels, device).work),
        timed(Rectification(rectifier, pictures, kernels, device, used=used).work),
        frame(plain),
        frame(whole),
        host_ms,
        _error(pictures, rectifier, rectified),
    )


def _error(pictures: LightField, rectifier: Rectifier, rectified: LightField) -> float:
    """Against the reference in the last view."""
    reference = load("reference")
    found = Rectification(rectifier, pictures, reference, "cpu", used=[len(pictures.views) - 1])
    found.work()
    return float(np.abs(reference.numpy(found.views)[0] - rectified.views[-1]).max())


def show(rows: list[Row]) -> None:
    """A table."""
    table = Table()
    for name in ("case", "backend", "all views, ms", "used views, ms", "frame, ms", "added, ms", "host, ms", "error"):
        table.add_column(name, justify="right")
    for row in rows:
        numbers = [
            f"{row.all_ms:.3f}",
            f"{row.used}: {row.used_ms:.3f}",
            f"{row.frame_ms:.2f}",
            f"{row.added_ms:.3f}",
            f"{row.host_ms:.0f}",
            f"{row.error:.2f}",
        ]
        table.add_row(row.case, f"{row.backend} {row.device}", *numbers)
    Console().print(table)
