"""The range of disparities in a scene, found from its views."""

from __future__ import annotations

import numpy as np

from lfgpu.contract import Float32Array, KernelSet
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.sections import LocalConfig
from lfgpu.methods.structure_tensor import LocalEstimator, spacing

_RANGE_LEVELS = (4, 8, 16)  # the disparity range is looked for in views shrunk as many times,
_RANGE_LEAST = 16  # but not below this many pixels,
_RANGE_REACH = 4.0  # where it spans at most as many pixels between neighbouring views either way,
_RANGE_TAIL = 0.002  # without this share of the estimates at either end,
_RANGE_MARGIN = 0.3  # and with this margin, pixels between neighbouring views at full size.
_RANGE_SHARE = 0.8  # A finer level will do where it is coherent at as large a share of pixels.


def find_disparity_range(lf: LightField, config: LocalConfig, kernels: KernelSet, device: str) -> tuple[float, float]:
    """The range of disparities in the scene, found from the views alone.

    Coherent structure tensor estimates on shrunk views, where disparities are small, span it; what stands alone and a
    few outliers at either end are left out and a margin is added. Views are shrunk 4 to 16 times, as it takes and as
    their size allows: up to 16 to 64 pixels between neighbouring views are found. Pixels per view step of the full-size
    views. LightFieldError where no structure is coherent or disparities reach the end of what is searched.
    """
    lines = [(lf.row(), 0), (lf.column(), 1)]
    used = "cross" if lf.pattern("cross").sum() > 1 else "full"  # no others are looked at; a lone view is refused below
    nearest = max((spacing(lf.offsets[line, axis]) for line, axis in lines if len(line) > 1), default=1.0)
    reach = _RANGE_REACH / nearest
    found: dict[int, Float32Array] = {}
    share: dict[int, float] = {}
    shrunk, done = lf, 1  # each level is made from the one before
    for level in _RANGE_LEVELS:
        if level == _RANGE_LEVELS[0] or min(lf.size) // level >= _RANGE_LEAST:
            level = max(1, min(level, min(lf.size) // _RANGE_LEAST))
            shrunk, done = shrunk.downsampled(level // done, which=used), level
            coarse = LocalEstimator(shrunk, (-reach, reach), config, kernels, device)
            coarse.run(kernels.image(shrunk.views, device))
            found[level] = _without_outliers(kernels.numpy(coarse.disparity), kernels.numpy(coarse.coherence))
            share[level] = found[level].size / (shrunk.size[0] * shrunk.size[1])
    enough = _RANGE_SHARE * max(share.values())
    level = next(level for level in share if share[level] >= enough)
    if found[level].size == 0:
        raise LightFieldError(
            f"{lf.name}: the views have no structure that is coherent enough to find the disparity range (no texture, "
            "all masked, or cameras too far apart); give disparity_range, or lower local.coherence_threshold."
        )
    low, high = np.quantile(found[level], (_RANGE_TAIL, 1 - _RANGE_TAIL))
    if max(-low, high) > reach - 0.1 / nearest:
        raise LightFieldError(
            f"{lf.name}: disparities reach the end of what is searched, {reach * level:g} px per view step; give "
            "disparity_range."
        )
    return float(low * level - _RANGE_MARGIN / nearest), float(high * level + _RANGE_MARGIN / nearest)


def _without_outliers(disparity: Float32Array, coherence: Float32Array) -> Float32Array:
    """The defined disparities as medians of the defined ones around them."""
    padded = np.pad(np.where(coherence > 0, disparity, np.nan), 1, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))[coherence > 0].reshape(-1, 9)
    windows, defined = np.sort(windows, axis=1), np.isfinite(windows).sum(1)  # NaN are sorted to the end
    middle = np.take_along_axis(windows, np.stack([(defined - 1) // 2, defined // 2], axis=1), axis=1)
    return np.asarray(middle.mean(1), np.float32)
