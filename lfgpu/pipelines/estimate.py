"""`estimate_depth`: the disparity map of a light field, in one piece or in tiles."""

from __future__ import annotations

import os
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

from lfgpu._backends import DEFAULT, BackendName, open_device
from lfgpu.cameras.points import Windows
from lfgpu.config import Config
from lfgpu.data import DepthResult, LightField, check_light_field
from lfgpu.methods import PresetName, configured
from lfgpu.methods.footprint import TooLittleMemoryError, parse_memory
from lfgpu.pipelines.pipeline import Progress
from lfgpu.pipelines.resident import KEPT
from lfgpu.pipelines.tiles import estimate_in_tiles
from lfgpu.pipelines.verdict import judged_on
from lfgpu.threads import meanwhile


def estimate_depth(
    lf: LightField,
    *,
    config: Config | PresetName | None = None,
    weights: str | os.PathLike[str] | None = None,
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = None,
    deterministic: bool = False,
    max_memory: str | float | None = None,
    check_cameras: bool = True,
    on_progress: Progress | None = None,
) -> DepthResult:
    """Estimate the disparity of the reference view of a light field.

    All presets but "paper" and "paper-exact" use matching: they find the surface on which the views agree, and handle
    occlusions. These two use synthesis: they find the map with which the reference view predicts all other views best
    (Sajjadi et al. 2016).

    Parameters
    ----------
    lf
        The light field; the map is that of its reference view.
    config
        All parameters, or the name of a preset: "surest", "accurate", "fast", "learned", "paper" or "paper-exact".
        Default None: "surest", or "learned" with weights.
    weights
        A file that `lfgpu train` wrote: the weights of the network. Default None: those that lfgpu comes with.
    disparity_range
        (low, high) of the disparities in pixels per view step; larger is nearer. Default None: found from the views.
    backend
        "warp" (default), "taichi" or "reference".
    device
        "cpu", "cuda" or "cuda:1", with backend "taichi" also "vulkan" or "metal". Default None: the first GPU that the
        backend can use, else the CPU.
    deterministic
        True: refuse a backend whose maps are not bit-identical from run to run on the same device. "warp" and
        "reference" are always deterministic, "taichi" on a CPU only. Default False.
    max_memory
        Memory limit, as "8GiB", "500MB" or a number of bytes. It applies to the process on a CPU, and to each GPU.
        Light fields that do not fit are estimated in overlapping tiles, on all GPUs unless `device` names one. Read
        large light fields with `lfgpu.read(..., lazy=True)`. Default None: the memory that is free, or that of the GPU;
        then a note tells of tiles.
    check_cameras
        Look, with the map, whether the cameras stand and look where they should. It takes a fraction of a second where
        nothing can be wrong, and a few seconds else. With tiles it looks at some of the views. Default True.
    on_progress
        Called as on_progress(stage, iteration, value): with iteration 0 and value 0 when a stage begins, and after each
        iteration of those that have some: value is the root mean square step in pixels per view step (align), the
        relative residual (propagate) or the energy (refine).

    Returns
    -------
    DepthResult
        Disparity, confidence and depth of the reference view, each [y, x] at full resolution. Its `notes` tell if the
        given range excludes the scene, if the views show nothing, if surfaces may lie beyond the range, or if the map
        is confident nowhere. Its `remarks` tell what stands out about the cameras; then the confidence is lower
        (`lfgpu.judged`).

    Raises
    ------
    LightFieldError
        If the range, a parameter or the file of weights is wrong, or if the views show too little to estimate anything.
    BackendError
        If the backend or the device is missing, or if `deterministic` is set and the backend is not.

    Examples
    --------
    >>> found = lfgpu.estimate_depth(lf, config="fast", disparity_range=(-1.6, 1.6))
    >>> found.disparity.shape, found.disparity.dtype.name
    ((64, 80), 'float32')
    """
    check_light_field(lf)
    options: dict[str, Any] = {
        "config": configured(config, weights),
        "disparity_range": disparity_range,
        "backend": backend,
        "device": device,
        "deterministic": deterministic,
        "on_progress": on_progress,
    }
    limit = None if max_memory is None else parse_memory(max_memory)
    notes: tuple[str, ...] = ()
    windows = Windows(lf)
    if limit is None:
        try:
            with meanwhile(windows.rank) if check_cameras else nullcontext():
                result = KEPT.estimate(lf, **options)
        except TooLittleMemoryError as error:
            limit = error.limit
            notes = (f"The map was made in tiles: in one piece it takes about {error.sizes}.",)
    if limit is not None:
        KEPT.free()
        result = estimate_in_tiles(lf, **options, max_memory=limit)
        result = replace(result, notes=(*notes, *result.notes))
    return judged_on(
        lf,
        result,
        open_device(backend, result.device),
        disparity_range=disparity_range,
        check_cameras=check_cameras,
        in_part=limit is not None,
        windows=windows,
    )
