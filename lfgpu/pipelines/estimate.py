"""From a light field to a disparity map: in one piece, or in tiles where memory is short."""

from __future__ import annotations

from lfgpu._backends import DEFAULT, BackendName
from lfgpu.config import Config
from lfgpu.data.lightfield import LightField, check_light_field
from lfgpu.data.result import DepthResult
from lfgpu.methods import PresetName, configured
from lfgpu.methods.footprint import parse_memory
from lfgpu.pipelines.pipeline import DepthPipeline, Progress
from lfgpu.pipelines.tiles import estimate_in_tiles


def estimate_depth(
    lf: LightField,
    *,
    config: Config | PresetName = "accurate",
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = None,
    deterministic: bool = False,
    max_memory: str | float | None = None,
    on_progress: Progress | None = None,
) -> DepthResult:
    """Estimate the disparity of the reference view of a light field.

    "accurate" and "fast" match: they find the surface on which the views agree, each as far as nothing hides it.
    "paper" synthesises: it finds the map from which the reference view predicts all others best (Sajjadi et al. 2016).

    Parameters
    ----------
    lf
        The light field; its `reference` is the view that is estimated.
    config
        All parameters, or the name of a preset: "accurate" (default), "fast" or "paper".
    disparity_range
        (low, high) bounds of the disparity in pixels per view step, larger is nearer. Default: found from the views.
    backend
        "warp" (default), "taichi" or "reference".
    device
        "cpu", "cuda", "cuda:1"; default is the backend's best.
    deterministic
        Whether the map must have the same bits each time on the same device, whatever the number of threads. So it has
        with "warp" and "reference" anyway, and with "taichi" on a CPU; elsewhere BackendError. Default False.
    max_memory
        What the estimate may take, as "8GiB", "500MB" or bytes: of the process on a CPU, of each GPU there. Light
        fields that do not fit are estimated in tiles that overlap, on all GPUs unless `device` names one. Read them
        with `lfgpu.read(..., lazy=True)`. Default None: in one piece.
    on_progress
        Called as on_progress(stage, iteration, value): with iteration 0 and value 0 when a stage begins, and after each
        iteration of those that have some: value is the root mean square step in pixels per view step (align), the
        relative residual (propagate) or the energy (refine).

    Returns
    -------
    DepthResult
        Disparity, confidence and depth, all [y, x] of the reference view at full size.

    Raises
    ------
    LightFieldError
        If the range or a parameter is wrong or the views allow no estimate.
    BackendError
        If the backend or the device is not there, or is not deterministic when it must be.
    """
    check_light_field(lf)
    if max_memory is not None:
        return estimate_in_tiles(
            lf,
            config=configured(config),
            disparity_range=disparity_range,
            backend=backend,
            device=device,
            deterministic=deterministic,
            on_progress=on_progress,
            max_memory=parse_memory(max_memory),
        )
    pipeline = DepthPipeline(
        lf,
        config=config,
        disparity_range=disparity_range,
        backend=backend,
        device=device,
        deterministic=deterministic,
    )
    return pipeline.estimate(on_progress=on_progress)
