"""The measures of the HCI 4D Light Field Benchmark for parts of a scene: edges, planes, smooth surfaces, fine things.

They are computed where a mask of the benchmark says, on the truth of the size of the views.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from lfgpu.errors import LightFieldError
from lfgpu.metrics import BORDER

_MOST_BUMPY = 0.05  # pixels per view step and pixel squared: what counts at most
_FINE = 0.15  # pixels per view step


@dataclass(frozen=True)
class RegionMetric:
    """One measure."""

    name: str
    mask: str
    """The name of the benchmark's mask."""
    unit: str
    """ "%" of the pixels of the mask, or "x100"."""
    values: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """Values whose mean over the mask is the measure, [y, x], from estimate - truth; NaN of the estimate stays NaN."""


def _share(
    bad: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the measure of a share in percent; pixels without an estimate are bad."""
    return lambda error: np.where(np.isfinite(error), 100.0 * bad(error), 100.0)


def bumpiness(error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the Frobenius norm of the second derivatives of the error times 100, cut off at 5."""

    # The Scharr operator: differences along one axis, means of 3, 10 and 3 sixteenths across.
    def derivative(image: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
        difference = ndimage.correlate1d(image, [-0.5, 0.0, 0.5], axis=axis, mode="reflect")
        return np.asarray(ndimage.correlate1d(difference, [3 / 16, 10 / 16, 3 / 16], axis=1 - axis, mode="reflect"))

    second = [derivative(derivative(error, first), then) for first in (0, 1) for then in (0, 1)]
    return 100.0 * np.clip(np.sqrt(np.sum(np.square(second), axis=0)), 0.0, _MOST_BUMPY)


REGION_METRICS = (
    RegionMetric("discontinuities", "discontinuities", "%", _share(lambda error: np.abs(error) > 0.07)),
    RegionMetric("planes, bumpiness", "planes", "x100", bumpiness),
    RegionMetric("smooth surfaces, bumpiness", "smooth_surfaces", "x100", bumpiness),
    RegionMetric("fine structures, fattening", "fine_surrounding", "%", _share(lambda error: error > _FINE)),
    RegionMetric("fine structures, thinning", "fine", "%", _share(lambda error: error < -_FINE)),
)
"""All measures; smaller is better throughout (Honauer et al., ACCV 2016)."""


def evaluate_regions(
    disparity: ArrayLike, truth: ArrayLike, masks: Mapping[str, NDArray[np.bool_]], *, border: int = BORDER
) -> dict[str, float]:
    """Score a disparity map in the parts of a scene that masks name.

    Parameters
    ----------
    disparity
        The estimate, [y, x], pixels per view step; NaN where it is undefined.
    truth
        The truth, same shape and unit.
    masks
        bool [y, x] by the benchmark's names: "discontinuities", "planes", "smooth_surfaces", "fine_surrounding",
        "fine"; any of them may be missing.
    border
        Pixels at each side that are left out, >= 0.

    Returns
    -------
    The values by the names of `REGION_METRICS`, of those whose mask is there and not empty; NaN where nothing of the
    estimate is defined.

    Raises
    ------
    LightFieldError
        If shapes differ.
    """
    error = np.asarray(disparity, np.float64) - np.asarray(truth, np.float64)
    inside = np.zeros(error.shape, np.bool_)
    inside[border : error.shape[0] - border, border : error.shape[1] - border] = True
    inside &= np.isfinite(np.asarray(truth, np.float64))
    scores = {}
    for metric in REGION_METRICS:
        mask = masks.get(metric.mask)
        if mask is None:
            continue
        if mask.shape != error.shape:
            raise LightFieldError(
                f"the mask {metric.mask} is {mask.shape}, the map {error.shape}; give those of one size."
            )
        values = metric.values(error)[mask & inside]
        defined = values[np.isfinite(values)]
        if len(values):
            scores[metric.name] = float(defined.mean()) if len(defined) else float("nan")
    return scores
