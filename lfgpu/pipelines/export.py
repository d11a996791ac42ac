"""`export_pipeline`: a pipeline as files that a program runs without Python."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

from lfgpu._backends import DEFAULT, BackendName, load, open_device
from lfgpu.config import Config, as_dict
from lfgpu.contract import Array, Recording
from lfgpu.data import LightField, check_light_field
from lfgpu.errors import BackendError, LightFieldError
from lfgpu.io.about import CONVENTION
from lfgpu.io.atomic import atomic_folder, check_writable
from lfgpu.methods import PresetName, method_of
from lfgpu.methods.base import LivePlan
from lfgpu.methods.temporal_prior import TemporalPrior
from lfgpu.pipelines.pipeline import measured_on
from lfgpu.pipelines.rectifier import DeviceViews, Rectifier
from lfgpu.pipelines.stream import CUT, live_config
from lfgpu.pipelines.stream_engine import SEEN_CHANGE
from lfgpu.threads import limited_threads

_SOURCES = "lfgpu_replay.h", "lfgpu_replay.cpp", "replay.cpp", "CMakeLists.txt"

_README = """\
This folder holds an exported lfgpu pipeline. It estimates disparity for light fields of one kind, without Python.

pipeline.wrp, pipeline_modules/  the recorded operations and their compiled kernels, for {device}
{warm}pipeline.json                    shapes, types, cameras, disparity range and parameters
replay.txt                       the same for the library
lfgpu_replay.h, lfgpu_replay.cpp a C++ library that runs the pipeline
replay.cpp, CMakeLists.txt       a program that runs it on frames from a file, and how both are built

The pipeline needs Warp {version} and the same kind of processor as the one it was exported on. Install Warp's package
(its folder is {package} on the exporting machine), then build with CMake, WARP being that folder:

    cmake -S . -B build -DCMAKE_BUILD_TYPE=Release -DWARP="$WARP" && cmake --build build
    build/replay . frames.raw maps.raw --threads 8
    cmake --install build --prefix PREFIX

After the last line, other projects find the library by find_package(lfgpu_replay) and link lfgpu::lfgpu_replay.

frames.raw holds one frame after the other. Each frame has {frame_bytes} bytes: {frames}, [n, y, x, c] =
{shape}, {dtype}. For each frame, maps.raw gets {map_bytes} bytes of disparity and as many of
confidence, both float32 [y, x].
{start} The maps are bit-identical to those of lfgpu on the same
device, whatever the number of threads.
"""
_STARTS = {
    True: "A frame starts from the map before, as in a DepthStream, but the first one and those after a scene cut.",
    False: "Each frame is estimated on its own.",
}
_RAW = " It is rectified first; the tables for that are in the recorded operations."
_WARM = "warm.wrp, warm_modules/          the same for frames that start from the map before\n"


def export_pipeline(
    lf: LightField,
    out: str | os.PathLike[str],
    *,
    config: Config | PresetName | None = None,
    weights: str | os.PathLike[str] | None = None,
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = "cpu",
    prior: TemporalPrior | None = TemporalPrior(),  # noqa: B008 - it is frozen
    rectifier: Rectifier | None = None,
) -> None:
    """Write a pipeline as files that a program runs through Warp's C interface; all files or none.

    Parameters
    ----------
    lf
        A light field of the kind, as for `DepthPipeline`. Its cameras and masks become part of the files.
    out
        The folder; its README.txt explains the files. An older export is overwritten.
    config
        As for `estimate_depth`; the method must be exportable (`Method.is_recordable`), as matching is. Default None:
        "accurate", or "learned" with weights.
    weights, disparity_range
        As for `estimate_depth`.
    backend
        "warp" (default), the only backend that can export.
    device
        "cpu" (default), "cuda" or "cuda:1".
    prior
        How strongly a map follows the previous one, as for `DepthStream`; None estimates each frame independently.
        Default `TemporalPrior()`.
    rectifier
        Rectifies the raw pictures of each frame in the same work, as for `DepthStream`. Then `lf` and all frames are
        raw pictures in the order of its cameras (`Rectifier.pictures`); its tables and tones become part of the files.
        Default None: views are as they should be.

    Raises
    ------
    LightFieldError, BackendError
        As `DepthPipeline`; if the method or the backend cannot export; or if the folder cannot be written.

    Examples
    --------
    >>> lfgpu.export_pipeline(lf, "pipeline", config="fast", disparity_range=(-2, 2))
    >>> Path("pipeline/lfgpu_replay.h").exists()
    True
    """
    check_light_field(lf)
    check_writable(out)
    config = live_config(config, weights)
    method, kernels = method_of(config), load(backend)
    recording, streaming = kernels.recording, kernels.streaming
    if recording is None or streaming is None:
        raise BackendError(f"backend {backend!r} cannot export pipelines; use backend {DEFAULT!r}.")
    if not method.is_recordable:
        raise LightFieldError(
            f"the method {method.name} cannot be exported, because its number of iterations depends on the views; use "
            "another preset (`lfgpu export --help` lists them)."
        )
    place = open_device(backend, device)
    device = place.name
    pictures = lf
    if rectifier is not None:
        lf = rectifier.rectified(pictures, place)
    used = method.used_views(lf.offsets)
    with limited_threads(1):  # the work of other threads would not be recorded
        with place.asking():
            measured, _ = measured_on(
                lf, config=config, disparity_range=disparity_range, backend=backend, device=device
            )
            front = DeviceViews(rectifier, pictures, place, used=used)
            plan = method.live_plan(
                lf.layout.subset(used), measured, place, streaming=streaming, prior=prior or TemporalPrior()
            )
            cold = partial(front.feed, plan.levels[-1][1])
            warm = None if prior is None else partial(front.feed, plan.warm_levels[-1][1])
            for work in filter(None, (cold, warm)):
                work()
        with atomic_folder(out) as folder:
            save = partial(_save, plan, front.frame, recording, folder, device)
            found = save("pipeline.wrp", cold, state_in=False)
            if warm is not None:
                found |= save("warm.wrp", warm, state_in=True)
            about = {
                "convention": CONVENTION,
                "device": device,
                "warp": recording.version(),
                "views": {"shape": list(lf.views.shape), "dtype": str(lf.views.dtype), "order": "n, y, x, c"},
                "maps": {"names": ["disparity", "confidence"], "shape": list(lf.size), "dtype": "float32"},
                "offsets": lf.offsets.tolist(),
                "disparity_range": list(measured.disparity_range),
                "config": as_dict(config),
                "prior": None if prior is None else asdict(prior),
                "rectified": rectifier is not None,
            }
            (folder / "pipeline.json").write_text(json.dumps(about, indent=1), encoding="utf-8")
            state = list(plan.state) if warm is not None else []
            lines: dict[str, Any] = {
                "device": device,
                "warp": recording.version(),
                "views": lf.views.shape,
                "type": lf.views.dtype,
                "scale": lf.scale,
                "reference": lf.reference_index,
                "used": used,
                "tolerance": SEEN_CHANGE * plan.noise,
                "cut": CUT,
                "state": state,
            }
            text = [f"{name} {_words(value)}" for name, value in lines.items()]
            text += [f"kernel {_words(kernel)}" for kernel in sorted(found)]
            (folder / "replay.txt").write_text("\n".join([*text, ""]), encoding="utf-8")
            _explain(folder, pictures, device, recording, is_warm=warm is not None, is_raw=rectifier is not None)


def _save(
    plan: LivePlan,
    frames: Array,
    recording: Recording,
    folder: Path,
    device: str,
    name: str,
    work: Callable[[], None],
    *,
    state_in: bool,
) -> set[tuple[str, str, int, str]]:
    """Record one piece of work; what a frame leaves for the next one can be read and set. Returns its kernels."""
    state = plan.state
    maps = {"disparity": plan.disparity, "confidence": plan.confidence}
    inputs = {
        "views": frames,
        **({name: array for name, array in state.items() if name not in maps} if state_in else {}),
    }
    outputs = {**maps, **({} if state_in else state)}
    return set(recording.save(work, folder / name, device=device, inputs=inputs, outputs=outputs))


def _words(value: Any) -> str:
    return " ".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)


def _explain(folder: Path, lf: LightField, device: str, recording: Recording, *, is_warm: bool, is_raw: bool) -> None:
    """Write the sources of the library and the program, and what to do with them."""
    readme = _README.format(
        device=device,
        warm=_WARM if is_warm else "",
        version=recording.version(),
        package=recording.libraries()[0].parent,
        frame_bytes=lf.views.nbytes,
        shape=list(lf.views.shape),
        dtype=lf.views.dtype,
        map_bytes=4 * lf.size[0] * lf.size[1],
        frames="raw pictures of the cameras" if is_raw else "the views",
        start=_STARTS[is_warm] + (_RAW if is_raw else ""),
    )
    (folder / "README.txt").write_text(readme, encoding="utf-8")
    for name in _SOURCES:
        with files("lfgpu").joinpath("native", name).open("rb") as source, (folder / name).open("wb") as target:
            shutil.copyfileobj(source, target)
