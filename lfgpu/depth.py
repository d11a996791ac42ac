"""The whole method on one page: from a light field to a disparity map."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

import numpy as np

from lfgpu._backends import DEFAULT, load, package_of, pick_device
from lfgpu.config import Config, preset
from lfgpu.energy import Energy
from lfgpu.errors import LightFieldError
from lfgpu.initial import find_disparity_range, local_estimate, propagate
from lfgpu.lightfield import LightField
from lfgpu.model import ForwardModel
from lfgpu.prior import NonLocalMeans
from lfgpu.result import DepthResult
from lfgpu.solvers.lbfgsb import minimize_lbfgsb

STAGES = ("local", "propagate", "refine")


def estimate_depth(
    lf: LightField,
    *,
    config: Config | str = "paper",
    disparity_range: tuple[float, float] | None = None,
    backend: str = DEFAULT,
    device: str | None = None,
    on_progress: Callable[[str, int, float], None] | None = None,
) -> DepthResult:
    """Estimate the disparity of the reference view of a light field (Sajjadi et al. 2016).

    Structure tensors on epipolar plane images give a first map where the views are coherent; a non-local-means
    propagation fills the rest; the refinement makes the map predict all recorded views best, under the same prior.

    Parameters
    ----------
    lf
        The light field; its `reference` is the view that is estimated.
    config
        All parameters, or the name of a preset. Default "paper".
    disparity_range
        (low, high) bounds of the disparity in pixels per view step, larger is nearer. Default: found from the views.
    backend
        "warp" (default), "taichi" or "reference".
    device
        "cpu", "cuda", "cuda:1"; default is the backend's best.
    on_progress
        Called as on_progress(stage, iteration, value): stage is one of STAGES, value the energy (refine), the relative
        residual (propagate) or 0 (local).

    Returns
    -------
    DepthResult
        Disparity, confidence and depth, all [y, x] of the reference view at full size.

    Raises
    ------
    LightFieldError
        If the range or a parameter is wrong or the views allow no estimate.
    BackendError
        If the backend or the device is not there.
    """
    parameters = preset(config) if isinstance(config, str) else config
    if not isinstance(parameters, Config):
        raise LightFieldError(f"config must be a Config or the name of a preset, not {type(config).__name__}.")
    bounds = None if disparity_range is None else _checked_range(disparity_range, lf)
    kernels = load(backend)
    where = pick_device(kernels, device)
    timings: dict[str, float] = {}

    @contextmanager
    def timed(stage: str) -> Iterator[None]:
        start = perf_counter()
        yield
        timings[stage] = perf_counter() - start

    def report(stage: str) -> Callable[[int, float], None] | None:
        return None if on_progress is None else lambda iteration, value: on_progress(stage, iteration, value)

    with timed("total"):
        with timed("local"):
            if on_progress is not None:
                on_progress("local", 0, 0.0)
            if bounds is None:
                bounds = find_disparity_range(lf, parameters.local, kernels, where)
            local = local_estimate(lf, bounds, parameters.local, kernels, where)
        with timed("propagate"):
            reference = lf.reference_index
            valid = None if lf.valid is None else lf.valid[reference]
            prior = NonLocalMeans(lf.image(reference), parameters.prior, kernels, where, valid=valid)
            filled = propagate(local, prior, parameters.propagation, report("propagate"))
            confidence = prior.mean(local.coherence)
        with timed("refine"):
            model = ForwardModel(lf, parameters.refinement, kernels, where, start=filled.values)
            energy = Energy(model, prior, parameters.refinement.smoothness)
            refined = minimize_lbfgsb(
                energy,
                filled.values,
                bounds,
                tolerance=parameters.refinement.tolerance,
                max_iterations=parameters.refinement.max_iterations,
                callback=report("refine"),
            )
    position = lf.positions[reference]
    return DepthResult(
        disparity=refined.values,
        confidence=confidence,
        stages={
            "local": np.where(local.coherence > 0, local.disparity, np.float32(np.nan)),
            "propagated": filled.values,
            "refined": refined.values,
        },
        position=(float(position[0]), float(position[1])),
        disparity_range=bounds,
        config=parameters,
        status=f"Propagation: {filled.status} Refinement: {refined.status}",
        converged=refined.converged,
        trace=refined.trace,
        timings=timings,
        backend=backend,
        device=where,
        versions={name: importlib.metadata.version(name) for name in ("lfgpu", "numpy", "scipy", package_of(backend))},
        geometry=lf.geometry,
        name=lf.name,
    )


def _checked_range(disparity_range: tuple[float, float], lf: LightField) -> tuple[float, float]:
    try:
        low, high = (float(bound) for bound in disparity_range)
    except (TypeError, ValueError):
        low = high = np.nan
    if not (np.isfinite(low) and np.isfinite(high) and low < high):
        raise LightFieldError(
            "disparity range must be two finite numbers, low < high, in pixels per view step; found "
            f"{disparity_range!r}."
        )
    distances = np.abs(lf.offsets).max(1)
    nearest, size = distances[distances > 0].min(), max(lf.size)
    if max(abs(low), abs(high)) * nearest >= size:
        raise LightFieldError(
            f"disparity range {low:g}, {high:g} is in pixels per view step: already the nearest view would be shifted "
            f"by {max(abs(low), abs(high)) * nearest:g} px, out of views of {size} px; give smaller disparities."
        )
    return low, high
