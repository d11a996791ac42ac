"""The first estimate: structure tensors on EPIs, and the more coherent answer at each pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from lfgpu.contract import Array, Float64Array, KernelSet, StructureFilters
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.sections import LocalConfig

_NEGLIGIBLE = 1e-3  # filters end where their Gaussian has fallen below this


class LocalEstimator:
    """Disparity by structure tensors on the EPIs of the reference's row and column of views (DESIGN §5, steps 1, 2).

    EPIs are sheared to base disparities over the range; each answers for the disparities around it, the most coherent
    one is kept. All is done in steps between neighbouring cameras of a line, in which aliasing sets in at a disparity
    of about 1.

    Parameters
    ----------
    lf
        A light field of the kind that is estimated: its cameras, size, stored type, masks and reference view count.
    disparity_range
        (low, high) of what is looked for, pixels per view step.
    config
        Scales, shears and threshold.
    kernels, device
        Where it is done. LightFieldError where neither row nor column has a second view.
    """

    def __init__(
        self, lf: LightField, disparity_range: tuple[float, float], config: LocalConfig, kernels: KernelSet, device: str
    ) -> None:
        if max(len(lf.row()), len(lf.column())) < 2:
            raise LightFieldError(
                f"{lf.name}: the reference view is alone in its row and in its column of views, but the local estimate "
                "needs a second camera in line with it (within 0.1 view steps); pick another reference view, or add "
                "one."
            )
        self._kernels, self._threshold = kernels, config.coherence_threshold
        self._lines = [
            _Line(lf, vertical, disparity_range, config, kernels, device)
            for vertical in (False, True)
            if len(lf.column() if vertical else lf.row()) > 1
        ]
        self.disparity, self.coherence = kernels.zeros(lf.size, device), kernels.zeros(lf.size, device)
        """Fields [y, x]: the disparity, and its coherence, 0 where undefined, to 1."""

    def run(self, views: Array) -> None:
        """Estimate from views [n, y, x, c], as stored."""
        kernels = self._kernels
        kernels.fill(0.0, self.disparity)
        kernels.fill(0.0, self.coherence)
        for line in self._lines:
            line.keep_better(views, self.disparity, self.coherence)
        kernels.threshold(self.coherence, self._threshold, self.coherence)


class _Line:
    """One line of views: its EPIs, lying along x also if it is a column, and the shears that they are given."""

    def __init__(
        self,
        lf: LightField,
        vertical: bool,
        disparity_range: tuple[float, float],
        config: LocalConfig,
        kernels: KernelSet,
        device: str,
    ) -> None:
        self._kernels, self._vertical, self._range = kernels, vertical, disparity_range
        self._line = [int(index) for index in (lf.column() if vertical else lf.row())]
        offsets = lf.offsets[self._line, int(vertical)]
        self._spacing = _spacing(offsets)
        offsets = offsets / self._spacing
        filters = structure_filters(offsets, config)
        height, width = reversed(lf.size) if vertical else lf.size
        shape = (len(self._line), height, width, lf.channels)
        self._epis = kernels.zeros_image(shape, device, lf.views.dtype)
        self._tensor = kernels.structure_tensor(
            shape,
            kernels.field(offsets, device),
            StructureFilters(*(kernels.field(f, device) for f in filters)),
            scale=lf.scale,
            floor=config.gradient_floor,
        )
        self._disparity, self._coherence = (kernels.zeros((height, width), device) for _ in range(2))
        # Multiples of the step: whole shears need no interpolation on a regular grid.
        self._step = config.shear_step
        first, last = (np.round(bound * self._spacing / self._step) for bound in disparity_range)
        self._shears = [float(shear) for shear in np.arange(first, last + 1) * self._step]
        self._trusted: list[Array | None] = [None] * len(self._shears)
        if lf.valid is not None:
            valid = lf.valid[self._line]
            valid = valid.swapaxes(1, 2) if vertical else valid
            used = (filters.along_value != 0).any(0)
            self._trusted = [
                kernels.field(_rests_on_valid(valid[used], offsets[used], shear, config), device)
                for shear in self._shears
            ]

    def keep_better(self, views: Array, best_disparity: Array, best_coherence: Array) -> None:
        """Put in what is more coherent than the best so far."""
        kernels = self._kernels
        kernels.line_of_views(views, self._line, vertical=self._vertical, epis_out=self._epis)
        for shear, trusted in zip(self._shears, self._trusted, strict=True):
            self._tensor(self._epis, shear, self._disparity, self._coherence)
            kernels.keep_more_coherent(
                self._disparity,
                self._coherence,
                trusted,
                shear=shear,
                reach=self._step,  # beyond its neighbours' places a shear aliases, however coherent it looks
                unit=self._spacing,
                low=self._range[0],
                high=self._range[1],
                vertical=self._vertical,
                best_disparity_out=best_disparity,
                best_coherence_out=best_coherence,
            )


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
