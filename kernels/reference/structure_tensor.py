"""Structure tensors on sheared epipolar plane images: NumPy, float64 (Wanner and Goldluecke 2012, §3)."""

from collections.abc import Sequence

import numpy as np

from lfgpu.contract import Float64Array as Array, LocalEstimate, StructureFilters


def sheared(epis: Array, offsets: Array, shear: float) -> Array:
    """E(u, y, x) = epis[u, y, x - shear * u], linear between pixels, the border pixel beyond the border."""
    width = epis.shape[2]
    result = np.empty_like(epis)
    for view, out, offset in zip(epis, result, offsets, strict=True):
        x = np.clip(np.arange(width) - shear * offset, 0, width - 1)
        left = np.minimum(x.astype(np.int64), max(0, width - 2))
        right = np.minimum(left + 1, width - 1)
        share = (x - left)[:, None]
        out[:] = (1 - share) * view[:, left] + share * view[:, right]
    return result


def correlate_x(a: Array, kernel: Array) -> Array:
    """Σ_k kernel[k] a[.., x + k - r, ..] along axis 2, the border pixel beyond the border."""
    radius, width = len(kernel) // 2, a.shape[2]
    columns = np.arange(width)
    return np.asarray(sum(w * a[:, :, np.clip(columns + k - radius, 0, width - 1)] for k, w in enumerate(kernel)))


def structure_tensor(
    shape: Sequence[int], offsets: Array, filters: StructureFilters, *, scale: float, floor: float
) -> LocalEstimate:
    def smoothed(product: Array) -> Array:
        along = np.tensordot(filters.along_outer, product.sum(3), axes=(0, 0))
        return correlate_x(along[None], filters.across_outer)[0]

    def evaluate(epis: Array, shear: float, disparity_out: Array, coherence_out: Array) -> None:
        straight = sheared(epis * scale, offsets, shear)
        value = np.tensordot(filters.along_value, straight, axes=(1, 0))  # [m, y, x, c]
        slope = np.tensordot(filters.along_slope, straight, axes=(1, 0))
        e_x, e_u = correlate_x(value, filters.across_slope), correlate_x(slope, filters.across_value)
        j_xx, j_xu, j_uu = smoothed(e_x * e_x), smoothed(e_x * e_u), smoothed(e_u * e_u)
        disparity_out[:] = shear + np.tan(0.5 * np.arctan2(2 * j_xu, j_xx - j_uu))
        coherence_out[:] = ((j_xx - j_uu) ** 2 + 4 * j_xu**2) / (j_xx + j_uu + floor**2) ** 2

    return evaluate


def keep_more_coherent(
    disparity: Array,
    coherence: Array,
    trusted: Array | None,
    *,
    shear: float,
    reach: float,
    unit: float,
    low: float,
    high: float,
    vertical: bool,
    best_disparity_out: Array,
    best_coherence_out: Array,
) -> None:
    within = (np.abs(disparity - shear) <= reach) & (disparity / unit >= low) & (disparity / unit <= high)
    if trusted is not None:
        within &= trusted != 0
    if vertical:
        within, disparity, coherence = within.T, disparity.T, coherence.T
    better = within & (coherence > best_coherence_out)
    best_disparity_out[better] = disparity[better] / unit
    best_coherence_out[better] = coherence[better]
