"""The first estimate: structure tensors on EPIs, the more coherent answer at each pixel, and its propagation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from lfgpu.config import LocalConfig, PropagationConfig
from lfgpu.errors import LightFieldError
from lfgpu.lightfield import LightField
from lfgpu.prior import NonLocalMeans
from lfgpu.solvers.cg import conjugate_gradients
from lfgpu.solvers.lbfgsb import minimize_lbfgsb
from lfgpu.solvers.solution import Solution
from lfgpu.types import Float32Array, Float64Array, KernelSet, StructureFilters

_NEGLIGIBLE = 1e-3  # filters end where their Gaussian has fallen below this
_RANGE_LEVELS = (4, 8, 16)  # the disparity range is looked for in views shrunk as many times,
_RANGE_LEAST = 16  # but not below this many pixels,
_RANGE_REACH = 4.0  # where it spans at most as many pixels between neighbouring views either way,
_RANGE_TAIL = 0.002  # without this share of the estimates at either end,
_RANGE_MARGIN = 0.3  # and with this margin, pixels between neighbouring views at full size.
_RANGE_SHARE = 0.8  # A finer level will do where it is coherent at as large a share of pixels.


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
            "needs a second camera in line with it (within 0.1 view steps); pick another reference view, or add one."
        )
    best = Local(np.zeros(lf.size, np.float32), np.zeros(lf.size, np.float32))
    for vertical in (False, True):
        for trusted, disparity, coherence in _line_estimates(lf, vertical, disparity_range, config, kernels, device):
            better = trusted & (disparity >= low) & (disparity <= high) & (coherence > best.coherence)
            best.disparity[better], best.coherence[better] = disparity[better], coherence[better]
    return Local(best.disparity, np.where(best.coherence >= config.coherence_threshold, best.coherence, np.float32(0)))


def _line_estimates(
    lf: LightField,
    vertical: bool,
    disparity_range: tuple[float, float],
    config: LocalConfig,
    kernels: KernelSet,
    device: str,
) -> Iterator[tuple[NDArray[np.bool_], Float32Array, Float32Array]]:
    """(trusted, disparity, coherence), each [y, x], from the reference's row or column of views, one for each shear.

    All is done in steps between neighbouring cameras of the line, in which aliasing sets in at a disparity of about 1.
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
    spacing = _spacing(offsets)
    offsets = offsets / spacing
    filters = structure_filters(offsets, config)
    tensor = kernels.structure_tensor(
        kernels.image(views, device),
        kernels.field(offsets, device),
        StructureFilters(*(kernels.field(f, device) for f in filters)),
        scale=lf.scale,
        floor=config.gradient_floor,
    )
    disparity_out, coherence_out = kernels.zeros(views.shape[1:3], device), kernels.zeros(views.shape[1:3], device)
    # Multiples of the step: whole shears need no interpolation on a regular grid.
    first, last = (np.round(bound * spacing / config.shear_step) for bound in disparity_range)
    for shear in np.arange(first, last + 1) * config.shear_step:
        tensor(float(shear), disparity_out, coherence_out)
        disparity = kernels.numpy(disparity_out)
        # Beyond its neighbours' places a shear aliases, however coherent it looks.
        trusted = np.abs(disparity - shear) <= config.shear_step
        if valid is not None:
            used = (filters.along_value != 0).any(0)
            trusted &= _rests_on_valid(valid[used], offsets[used], float(shear), config)
        yield turned(trusted), turned(disparity) / np.float32(spacing), turned(kernels.numpy(coherence_out))


def _spacing(offsets: Float64Array) -> float:
    """The distance of the nearest neighbours among views at `offsets`, in view steps; nearly equal ones are one."""
    gaps = np.diff(np.sort(offsets))
    return float(gaps[gaps > 1e-3 * gaps.max()].min())


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
        near, scale = np.abs(distance) <= inner, config.inner_scale
        if near.sum() < 2:  # a small scale or an uneven line: the nearest two
            near[np.argsort(np.abs(distance))[:2]] = True
            scale = max(scale, np.abs(distance[near]).max() / 3)
        weight = np.where(near, _gaussian(distance, scale), 0)
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

    Coherent structure tensor estimates on shrunk views, where disparities are small, span it; what stands alone and a
    few outliers at either end are left out and a margin is added. Views are shrunk 4 to 16 times, as it takes and as
    their size allows: up to 16 to 64 pixels between neighbouring views are found. Pixels per view step of the full-size
    views. LightFieldError where no structure is coherent or disparities reach the end of what is searched.
    """
    lines = [(lf.row(), 0), (lf.column(), 1)]
    spacing = max((_spacing(lf.offsets[line, axis]) for line, axis in lines if len(line) > 1), default=1.0)
    reach = _RANGE_REACH / spacing
    found: dict[int, Float32Array] = {}
    share: dict[int, float] = {}
    for level in _RANGE_LEVELS:
        if level == _RANGE_LEVELS[0] or min(lf.size) // level >= _RANGE_LEAST:
            level = max(1, min(level, min(lf.size) // _RANGE_LEAST))
            coarse = local_estimate(lf.downsampled(level), (-reach, reach), config, kernels, device)
            found[level] = _without_outliers(coarse)
            share[level] = found[level].size / coarse.disparity.size
    enough = _RANGE_SHARE * max(share.values())
    level = next(level for level in share if share[level] >= enough)
    if found[level].size == 0:
        raise LightFieldError(
            f"{lf.name}: the views have no structure that is coherent enough to find the disparity range (no texture, "
            "all masked, or cameras too far apart); give disparity_range, or lower local.coherence_threshold."
        )
    low, high = np.quantile(found[level], (_RANGE_TAIL, 1 - _RANGE_TAIL))
    if max(-low, high) > reach - 0.1 / spacing:
        raise LightFieldError(
            f"{lf.name}: disparities reach the end of what is searched, {reach * level:g} px per view step; give "
            "disparity_range."
        )
    return float(low * level - _RANGE_MARGIN / spacing), float(high * level + _RANGE_MARGIN / spacing)


def _without_outliers(local: Local) -> Float32Array:
    """The defined disparities as medians of the defined ones around them."""
    padded = np.pad(np.where(local.coherence > 0, local.disparity, np.nan), 1, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))[local.coherence > 0]
    return np.asarray(np.nanmedian(windows, axis=(1, 2)), np.float32)


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
    defined = local.coherence > 0
    if not defined.any():
        raise LightFieldError(
            "no pixel has a coherent estimate within the disparity range: the views have no texture, are masked, or "
            "the range is wrong; give another one, or lower local.coherence_threshold."
        )
    kernels, device, shape = prior.kernels, prior.device, local.disparity.shape
    coherence, weighted = kernels.field(local.coherence, device), kernels.zeros(shape, device)
    trust, target = kernels.zeros(shape, device), kernels.zeros(shape, device)
    kernels.multiply(coherence, kernels.field(local.disparity, device), weighted)
    prior.neighbors(coherence, trust)
    prior.neighbors(weighted, target)
    start = np.where(defined, local.disparity, np.average(local.disparity[defined], weights=local.coherence[defined]))

    def apply(m: object, result_out: object) -> None:
        """(2 L + diag(trust)) m"""
        prior.laplacian(m, result_out)
        kernels.multiply(trust, m, weighted)
        kernels.axpby(2.0, result_out, 1.0, weighted, result_out)

    if config.solver == "cg":
        diagonal = 2 * (kernels.numpy(prior.degree) - 1) + kernels.numpy(trust)
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
    across = int(_reach(config.inner_scale)) + int(_reach(config.outer_scale)) + 1  # one for the shear's rounding
    columns = np.arange(valid.shape[2])
    clean = np.ones(valid.shape[1:], np.bool_)
    for mask, offset in zip(valid, offsets, strict=True):
        clean &= mask[:, np.clip(np.round(columns - shear * offset).astype(int), 0, len(columns) - 1)]
    return np.asarray(minimum_filter1d(clean, 2 * across + 1, axis=1), np.bool_)


def _reach(scale: float) -> float:
    return float(scale * np.sqrt(-2 * np.log(_NEGLIGIBLE)))


def _gaussian(x: Float64Array | np.ndarray, scale: float) -> Float64Array:
    return np.asarray(np.exp(-0.5 * (np.asarray(x, np.float64) / scale) ** 2))
