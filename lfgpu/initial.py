"""The first estimate: structure tensors on EPIs, the more coherent answer at each pixel, and its propagation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, minimum_filter1d

from lfgpu.config import LocalConfig, PropagationConfig
from lfgpu.errors import LightFieldError
from lfgpu.lightfield import LightField
from lfgpu.prior import NonLocalMeans
from lfgpu.solvers.cg import conjugate_gradients
from lfgpu.solvers.lbfgsb import minimize_lbfgsb
from lfgpu.solvers.solution import Solution
from lfgpu.types import Float32Array, Float64Array, KernelSet, StructureFilters

_NEGLIGIBLE = 1e-3  # filters end where their Gaussian has fallen below this
_RANGE_LEVEL = 4  # the disparity range is looked for in views shrunk as many times,
_RANGE_REACH = 4  # where it spans at most as many pixels per view step either way,
_RANGE_TAIL = 0.002  # without this share of the estimates at either end,
_RANGE_MARGIN = 0.3  # and with this margin, pixels per view step at full size.


@dataclass(frozen=True, eq=False)
class Local:
    """A disparity and its coherence (0 where undefined to 1) at each pixel, both float32 [y, x]."""

    disparity: Float32Array
    coherence: Float32Array


def local_estimate(
    lf: LightField, disparity_range: tuple[float, float], config: LocalConfig, kernels: KernelSet, device: str
) -> Local:
    """Disparity by structure tensors on the EPIs of the reference's row and column of views (DESIGN §5, steps 1, 2).

    EPIs are sheared to base disparities over `disparity_range` (pixels per view step); each answers for the disparities
    around it, the most coherent one is kept. LightFieldError where neither row nor column has a second view.
    """
    low, high = disparity_range
    if max(len(lf.row()), len(lf.column())) < 2:
        raise LightFieldError(
            f"{lf.name}: the reference view is alone in its row and in its column of views, but the local estimate "
            "needs a second view in one of them; pick another reference view."
        )
    # Multiples of the step: whole shears need no interpolation on a regular grid.
    steps = np.arange(np.round(low / config.shear_step), np.round(high / config.shear_step) + 1)
    best = Local(np.zeros(lf.size, np.float32), np.full(lf.size, -1, np.float32))
    for vertical in (False, True):
        for shear, disparity, coherence in _line_estimates(
            lf, vertical, steps * config.shear_step, config, kernels, device
        ):
            # Beyond its neighbours' places a shear aliases, however coherent it looks.
            trusted = (np.abs(disparity - shear) <= config.shear_step) & (disparity >= low) & (disparity <= high)
            better = trusted & (coherence > best.coherence)
            best.disparity[better], best.coherence[better] = disparity[better], coherence[better]
    if (best.coherence < 0).all():
        raise LightFieldError(
            f"{lf.name}: no estimate lies in the disparity range {low:g} to {high:g}; give a wider one."
        )
    defined = (best.coherence > 0) & (best.coherence >= config.coherence_threshold)
    return Local(best.disparity, np.where(defined, best.coherence, np.float32(0)))


def _line_estimates(
    lf: LightField, vertical: bool, shears: Float64Array, config: LocalConfig, kernels: KernelSet, device: str
) -> Iterator[tuple[float, Float32Array, Float32Array]]:
    """(shear, disparity [y, x], coherence [y, x]) from the reference's row or column of views, for each shear.

    Coherence is -1 where the estimate rests on invalid pixels.
    """
    line = lf.column() if vertical else lf.row()
    if len(line) < 2:
        return

    def turned(a: Any) -> Any:
        """A column of views lies like a row once x and y change places."""
        return np.ascontiguousarray(a.swapaxes(-2, -1)) if vertical else a

    views, offsets = lf.views[line], lf.offsets[line, int(vertical)]
    if vertical:
        views = np.ascontiguousarray(views.swapaxes(1, 2))
    valid = None if lf.valid is None else turned(lf.valid[line])
    tensor = kernels.structure_tensor(
        kernels.image(views, device),
        kernels.field(offsets, device),
        StructureFilters(*(kernels.field(f, device) for f in structure_filters(offsets, config))),
        scale=lf.scale,
        floor=config.gradient_floor,
    )
    disparity, coherence = kernels.zeros(views.shape[1:3], device), kernels.zeros(views.shape[1:3], device)
    for shear in shears:
        tensor(float(shear), disparity, coherence)
        trust = kernels.numpy(coherence)
        if valid is not None:
            trust[~_rests_on_valid(valid, offsets, float(shear), config)] = -1
        yield float(shear), turned(kernels.numpy(disparity)), turned(trust)


def structure_filters(offsets: Float64Array, config: LocalConfig) -> StructureFilters:
    """The filters of a structure tensor at offset 0 of views at `offsets` [u], which need not be evenly spaced.

    Along the views value and slope are those of a line fitted with Gaussian weights. On an even grid these are the
    Gaussian and its derivative; at the end of a row of views they stay unbiased.
    """
    inner, outer = _reach(config.inner_scale), _reach(config.outer_scale)
    places = offsets[np.abs(offsets) <= outer]
    value, slope = np.zeros((2, len(places), len(offsets)))
    for m, place in enumerate(places):
        distance = offsets - place
        near = np.abs(distance) <= inner
        if near.sum() < 2:  # far apart cameras: the nearest two
            near[np.argsort(np.abs(distance))[:2]] = True
        weight = np.where(near, _gaussian(distance, max(config.inner_scale, np.abs(distance[near]).max() / 3)), 0)
        weight /= weight.sum()
        mean = (weight * distance).sum()
        centred = weight * (distance - mean)
        slope[m] = centred / (centred * distance).sum()
        value[m] = weight - mean * slope[m]
    across = np.arange(-int(inner), int(inner) + 1)
    weight = _gaussian(across, config.inner_scale)
    smooth = _gaussian(np.arange(-int(outer), int(outer) + 1), config.outer_scale)
    along = _gaussian(places, config.outer_scale)
    return StructureFilters(
        along_value=value,
        along_slope=slope,
        along_outer=along / along.sum(),
        across_value=weight / weight.sum(),
        across_slope=weight * across / (weight * across**2).sum(),
        across_outer=smooth / smooth.sum(),
    )


def find_disparity_range(lf: LightField, config: LocalConfig, kernels: KernelSet, device: str) -> tuple[float, float]:
    """The range of disparities in the scene, found from the views alone.

    Coherent structure tensor estimates on shrunk views, where disparities are small, span it; a few outliers at
    either end are left out and a margin is added. Pixels per view step of the full-size views.
    """
    level = max(1, min(_RANGE_LEVEL, min(lf.size) // 16))
    coarse = local_estimate(lf.downsampled(level), (-_RANGE_REACH, _RANGE_REACH), config, kernels, device)
    # What stands alone among its neighbours is taken for an outlier.
    found = median_filter(coarse.disparity, 3)[coarse.coherence > 0]
    if found.size == 0:
        raise LightFieldError(
            f"{lf.name}: no structure is coherent enough to find the disparity range; give disparity_range yourself, "
            "or lower local.coherence_threshold."
        )
    low, high = np.quantile(found, (_RANGE_TAIL, 1 - _RANGE_TAIL)) * level
    return float(low) - _RANGE_MARGIN, float(high) + _RANGE_MARGIN


def propagate(
    local: Local,
    prior: NonLocalMeans,
    config: PropagationConfig,
    callback: Callable[[int, float], None] | None = None,
) -> Solution:
    """Fill the undefined pixels: argmin_m Σ_p Σ_{q∈N(p)} w_pq [(m_p - m_q)² + C_p (m0_p - m_q)²] (DESIGN §5, step 3).

    With L the Laplacian and W the neighbour sums of the weights the normal equations are
    (2 L + diag(W C)) m = W (C m0). The minimum lies within the range of the defined m0.
    """
    kernels, device = prior.kernels, prior.device
    shape = local.disparity.shape
    coherence, weighted = kernels.zeros(shape, device), kernels.zeros(shape, device)
    trust, target = kernels.zeros(shape, device), kernels.zeros(shape, device)
    kernels.copy(kernels.field(local.coherence, device), coherence)
    kernels.multiply(coherence, kernels.field(local.disparity, device), weighted)
    prior.neighbors(coherence, trust)
    prior.neighbors(weighted, target)
    defined = local.coherence > 0
    if not defined.any():
        raise LightFieldError("no pixel is coherent enough to start from; lower local.coherence_threshold.")
    start = np.where(defined, local.disparity, np.average(local.disparity[defined], weights=local.coherence[defined]))

    def apply(m: object, result_out: object) -> None:
        """(2 L + diag(trust)) m"""
        prior.laplacian(m, result_out)
        kernels.multiply(trust, m, weighted)
        kernels.axpby(2.0, result_out, 1.0, weighted, result_out)

    if config.solver == "cg":
        degree = kernels.zeros(shape, device)
        prior.neighbors(kernels.field(np.ones(shape), device), degree)
        diagonal = 2 * (kernels.numpy(degree) - 1) + kernels.numpy(trust)
        return conjugate_gradients(
            apply,
            target,
            start,
            1 / np.maximum(diagonal, np.finfo(np.float32).tiny),
            kernels=kernels,
            device=device,
            tolerance=config.tolerance,
            max_iterations=config.max_iterations,
            callback=callback,
        )

    product = kernels.zeros(shape, device)

    def energy(m: Float64Array) -> tuple[float, Float64Array]:
        """mᵀ A m - 2 bᵀ m: the energy up to a constant."""
        field = kernels.field(m, device)
        apply(field, product)
        value = kernels.dot(field, product) - 2 * kernels.dot(field, target)
        kernels.axpby(2.0, product, -2.0, target, product)
        return value, kernels.numpy(product).astype(np.float64)

    values = local.disparity[defined]
    return minimize_lbfgsb(
        energy,
        start,
        (float(values.min()), float(values.max())),
        tolerance=config.tolerance,
        max_iterations=config.max_iterations,
        callback=callback,
    )


def _rests_on_valid(
    valid: NDArray[np.bool_], offsets: Float64Array, shear: float, config: LocalConfig
) -> NDArray[np.bool_]:
    """Where nothing that the filters reach is invalid: [y, x] from masks [u, y, x], sheared as the EPIs are."""
    reach = _reach(config.inner_scale) + _reach(config.outer_scale)
    columns = np.arange(valid.shape[2])
    clean = np.ones(valid.shape[1:], np.bool_)
    for mask, offset in zip(valid, offsets, strict=True):
        if abs(offset) <= reach:
            clean &= mask[:, np.clip(np.round(columns - shear * offset).astype(int), 0, len(columns) - 1)]
    return np.asarray(minimum_filter1d(clean, 2 * int(reach) + 3, axis=1), np.bool_)  # and one for the shear's rounding


def _reach(scale: float) -> float:
    return float(scale * np.sqrt(-2 * np.log(_NEGLIGIBLE)))


def _gaussian(x: Float64Array | np.ndarray, scale: float) -> Float64Array:
    return np.asarray(np.exp(-0.5 * (np.asarray(x, np.float64) / scale) ** 2))
