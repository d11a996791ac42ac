"""The local estimate: structure tensors on epipolar plane images (EPIs); each pixel keeps the most coherent one."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from lfgpu.contract import Array, Device, Float64Array, StructureFilters
from lfgpu.data.layout import ViewLayout
from lfgpu.data.light_field_checks import NEAREST
from lfgpu.errors import LightFieldError
from lfgpu.methods.sections import LocalConfig

_NEGLIGIBLE = 1e-3  # filters are cut off where their Gaussian is below this
_ANY = 1e30  # pixels per view step: no bound


class LocalEstimator:
    """Estimates disparity by structure tensors on the EPIs of the row and the column of the reference view.

    EPIs are sheared to base disparities that cover the range. A sheared EPI gives estimates near its base disparity
    only; of all estimates at a pixel the most coherent one is kept. Positions are measured in steps between
    neighbouring cameras of the line, because aliasing starts at about 1 pixel per such step. LightFieldError if neither
    row nor column has a second view.
    """

    def __init__(
        self,
        layout: ViewLayout,
        disparity_range: tuple[float, float],
        config: LocalConfig,
        device: Device,
    ) -> None:
        kernels = device.kernels
        found = {False: layout.row(), True: layout.column()}
        lines = [vertical for vertical, line in found.items() if np.ptp(layout.offsets[line, int(vertical)]) > NEAREST]
        if not lines:
            raise LightFieldError(
                f"{layout.name}: the local estimate needs a second view in the row or the column of the reference view "
                "(within 0.1 view steps), but there is none; choose another reference view, or add views."
            )
        self._kernels, self._threshold = kernels, config.coherence_threshold
        self._lines = [_Line(layout, vertical, disparity_range, config, device) for vertical in lines]
        self.disparity, self.coherence = device.zeros(layout.size), device.zeros(layout.size)
        """Fields [y, x]: the disparity, pixels per view step, and its coherence, 0 (undefined) to 1."""
        self.by_line = {line.name: (device.zeros(layout.size), device.zeros(layout.size)) for line in self._lines}
        """The same of the row and of the column of views alone, by "row" and "column"; before the threshold."""

    def run(self, views: Array) -> None:
        """Estimate disparity and coherence from views [n, y, x, c], as stored."""
        kernels = self._kernels
        for field in (self.disparity, self.coherence, *(field for fields in self.by_line.values() for field in fields)):
            kernels.fill(0.0, field)
        for line in self._lines:
            disparity, coherence = self.by_line[line.name]
            line.keep_better(views, disparity, coherence)
            kernels.keep_more_coherent(
                disparity,
                coherence,
                None,
                shear=0.0,
                reach=_ANY,
                unit=1.0,
                low=-_ANY,
                high=_ANY,
                vertical=False,
                best_disparity_out=self.disparity,
                best_coherence_out=self.coherence,
            )
        kernels.threshold(self.coherence, self._threshold, self.coherence)


class _Line:
    """A row or a column of views: its EPIs and their shears. EPIs of a column are transposed to lie along x, too."""

    def __init__(
        self,
        layout: ViewLayout,
        vertical: bool,
        disparity_range: tuple[float, float],
        config: LocalConfig,
        device: Device,
    ) -> None:
        kernels = device.kernels
        self.name = "column" if vertical else "row"
        self._kernels, self._vertical, self._range = kernels, vertical, disparity_range
        self._line = [int(index) for index in (layout.column() if vertical else layout.row())]
        offsets = layout.offsets[self._line, int(vertical)]
        self._spacing = _spacing(offsets)
        offsets = offsets / self._spacing
        filters = structure_filters(offsets, config)
        height, width = reversed(layout.size) if vertical else layout.size
        shape = (len(self._line), height, width, layout.channels)
        self._epis = device.zeros_image(shape, layout.dtype)
        self._tensor = kernels.structure_tensor(
            shape,
            device.field(offsets),
            StructureFilters(*(device.field(f) for f in filters)),
            scale=layout.scale,
            floor=config.gradient_floor,
        )
        self._disparity, self._coherence = (device.zeros((height, width)) for _ in range(2))
        # Multiples of the step, because integer shears need no interpolation on a regular grid.
        self._step = config.shear_step
        first, last = (np.round(bound * self._spacing / self._step) for bound in disparity_range)
        self._shears = [float(shear) for shear in np.arange(first, last + 1) * self._step]
        self._trusted: list[Array | None] = [None] * len(self._shears)
        if layout.masks is not None:
            valid = np.stack([layout.masks[index] for index in self._line])
            valid = valid.swapaxes(1, 2) if vertical else valid
            used = (filters.along_value != 0).any(0)
            self._trusted = [
                device.field(_rests_on_valid(valid[used], offsets[used], shear, config)) for shear in self._shears
            ]

    def keep_better(self, views: Array, best_disparity: Array, best_coherence: Array) -> None:
        """Replace the best estimates so far by those of this line, where these are more coherent."""
        kernels = self._kernels
        kernels.line_of_views(views, self._line, vertical=self._vertical, epis_out=self._epis)
        for shear, trusted in zip(self._shears, self._trusted, strict=True):
            self._tensor(self._epis, shear, self._disparity, self._coherence)
            kernels.keep_more_coherent(
                self._disparity,
                self._coherence,
                trusted,
                shear=shear,
                reach=self._step,  # estimates farther from the base disparity are aliased, even if they look coherent
                unit=self._spacing,
                low=self._range[0],
                high=self._range[1],
                vertical=self._vertical,
                best_disparity_out=best_disparity,
                best_coherence_out=best_coherence,
            )


def _spacing(offsets: Float64Array) -> float:
    """Find the smallest distance between views at `offsets`, view steps; views at nearly equal offsets count as one."""
    gaps = np.diff(np.sort(offsets))
    return float(gaps[gaps > 1e-3 * gaps.max()].min())


def structure_filters(offsets: Float64Array, config: LocalConfig) -> StructureFilters:
    """Compute the filters of a structure tensor at offset 0, for views at `offsets` [u], which may be unevenly spaced.

    Along the views, value and slope come from a line fit with Gaussian weights. On a regular grid this gives the
    Gaussian and its derivative. At the end of a row of views it stays unbiased.
    """
    inner, outer = _reach(config.inner_scale), _reach(config.outer_scale)
    places = offsets[np.abs(offsets) <= outer]
    value, slope = np.zeros((2, len(places), len(offsets)))
    for m, place in enumerate(places):
        distance = offsets - place
        near, scale = np.abs(distance) <= inner, config.inner_scale
        if near.sum() < 2:  # a small scale or an uneven line: the two nearest views
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
    """Select the pixels [y, x] under whose filters all pixels are valid, by masks [u, y, x] that are sheared like the
    EPIs."""
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
