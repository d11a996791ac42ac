"""`export_pipeline`: a pipeline as files that a program runs without Python."""

from __future__ import annotations

import json
import os
import shutil
from importlib.resources import files
from pathlib import Path

from lfgpu._backends import DEFAULT, BackendName, load
from lfgpu.config import Config, as_dict
from lfgpu.contract import Recording
from lfgpu.data.lightfield import LightField, check_light_field
from lfgpu.errors import BackendError, LightFieldError
from lfgpu.io.about import CONVENTION
from lfgpu.io.atomic import atomic_folder, check_writable
from lfgpu.methods import PresetName, method_of
from lfgpu.pipelines.pipeline import DepthPipeline
from lfgpu.threads import limited_threads

_PROGRAM = "replay.cpp"

_README = """\
This folder holds an exported lfgpu pipeline. It estimates disparity for light fields of one kind, without Python.

pipeline.wrp, pipeline_modules/  the recorded operations and their compiled kernels, for {device}
pipeline.json                    shapes, types, cameras, disparity range and parameters
replay.cpp                       a program that runs the pipeline on frames from a file and writes the maps

The pipeline needs Warp {version} and the same kind of processor as the one it was exported on. Install Warp's package
(its folder is {package} on the exporting machine), then build and run the program with

    g++ -O2 -std=c++17 replay.cpp -o replay -L"$WARP/bin" -l:warp.so -l:warp-clang.so -Wl,-rpath,"$WARP/bin"
    ./replay . frames.raw maps.raw

where WARP is that folder. frames.raw holds one frame after the other. Each frame has {frame_bytes} bytes: the views
[n, y, x, c] = {shape}, {dtype}. For each frame, maps.raw gets {map_bytes} bytes of disparity and as many of
confidence, both float32 [y, x]. The maps are bit-identical to those of lfgpu on the same device. On a CPU the program
uses one thread.
"""


def export_pipeline(
    lf: LightField,
    out: str | os.PathLike[str],
    *,
    config: Config | PresetName = "accurate",
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = "cpu",
) -> None:
    """Write a `DepthPipeline` as files that a program runs through Warp's C interface; all files or none.

    Parameters
    ----------
    lf
        A light field of the kind, as for `DepthPipeline`. Its cameras and masks become part of the files.
    out
        The folder; its README.txt explains the files. An older export is overwritten.
    config, disparity_range
        As for `estimate_depth`. The method must be exportable (`Method.is_recordable`), as matching is.
    backend
        "warp" (default), the only backend that can export.
    device
        "cpu" (default), "cuda" or "cuda:1".

    Raises
    ------
    LightFieldError, BackendError
        As `DepthPipeline`; if the method or the backend cannot export; or if the folder cannot be written.
    """
    check_light_field(lf)
    check_writable(out)
    method, recording = method_of(config), load(backend).recording
    if recording is None:
        raise BackendError(f"backend {backend!r} cannot export pipelines; use backend {DEFAULT!r}.")
    if not method.is_recordable:
        raise LightFieldError(
            f"the method {method.name} cannot be exported, because its number of iterations depends on the views; use "
            "another preset (`lfgpu export --help` lists them)."
        )
    with limited_threads(1):  # the work of other threads would not be recorded
        pipeline = DepthPipeline(lf, config=config, disparity_range=disparity_range, backend=backend, device=device)
        pipeline.run()
        views, maps = pipeline.buffers()
        with atomic_folder(out) as folder:
            recording.save(
                pipeline.work, folder / "pipeline.wrp", device=pipeline.device, inputs={"views": views}, outputs=maps
            )
            _describe(folder, lf, pipeline, recording)


def _describe(folder: Path, lf: LightField, pipeline: DepthPipeline, recording: Recording) -> None:
    height, width = lf.size
    about = {
        "convention": CONVENTION,
        "device": pipeline.device,
        "warp": recording.version(),
        "views": {"shape": list(lf.views.shape), "dtype": str(lf.views.dtype), "order": "n, y, x, c"},
        "maps": {"names": ["disparity", "confidence"], "shape": [height, width], "dtype": "float32"},
        "offsets": lf.offsets.tolist(),
        "disparity_range": list(pipeline.bounds),
        "config": as_dict(pipeline.config),
    }
    readme = _README.format(
        device=pipeline.device,
        version=recording.version(),
        package=recording.libraries()[0].parent,
        frame_bytes=lf.views.nbytes,
        shape=list(lf.views.shape),
        dtype=lf.views.dtype,
        map_bytes=4 * height * width,
    )
    (folder / "pipeline.json").write_text(json.dumps(about, indent=1), encoding="utf-8")
    (folder / "README.txt").write_text(readme, encoding="utf-8")
    (folder / "device.txt").write_text(pipeline.device + "\n", encoding="utf-8")
    (folder / "warp-version.txt").write_text(recording.version() + "\n", encoding="utf-8")
    with files("lfgpu").joinpath("native", _PROGRAM).open("rb") as source, (folder / _PROGRAM).open("wb") as target:
        shutil.copyfileobj(source, target)
