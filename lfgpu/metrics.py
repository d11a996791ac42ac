"""How far a disparity map is from the truth, in the measures of the HCI 4D Light Field Benchmark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.errors import LightFieldError

BORDER = 15
"""Pixels at each side of the image that the benchmark leaves out."""


@dataclass(frozen=True)
class Metrics:
    """What `evaluate` found; smaller is better throughout.

    BadPix is over all scored pixels, and undefined ones (NaN or infinite in the estimate) are bad. The measures of
    size (MSE, RMSE, Q25) are over the defined pixels only and NaN if there are none: look at `undefined` with them.
    """

    mse_100: float
    """Mean squared error times 100, in pixels squared per view step squared."""
    badpix_07: float
    """Percent of pixels with |error| > 0.07 pixels per view step."""
    badpix_03: float
    """Percent of pixels with |error| > 0.03 pixels per view step."""
    badpix_01: float
    """Percent of pixels with |error| > 0.01 pixels per view step."""
    q25: float
    """25 % quantile of |error| times 100: how good the best quarter is."""
    rmse: float
    """Root of the mean squared error, pixels per view step."""
    undefined: float
    """Percent of scored pixels where the estimate is undefined."""
    count: int
    """Number of scored pixels."""

    def __str__(self) -> str:
        undefined = f", {self.undefined:.2f} % undefined" if self.undefined else ""
        return (
            f"MSE x100 {self.mse_100:.3f}, BadPix(0.07) {self.badpix_07:.2f} %, BadPix(0.03) {self.badpix_03:.2f} %, "
            f"BadPix(0.01) {self.badpix_01:.2f} %, Q25 {self.q25:.3f}, RMSE {self.rmse:.4f} "
            f"over {self.count} pixels{undefined}"
        )


def evaluate(disparity: ArrayLike, truth: ArrayLike, *, mask: ArrayLike | None = None, border: int = BORDER) -> Metrics:
    """Score a disparity map.

    Parameters
    ----------
    disparity
        The estimate, [y, x], pixels per view step; NaN or infinite where it is undefined.
    truth
        The truth, same shape and unit; pixels where it is NaN or infinite are left out.
    mask
        bool [y, x], True where pixels are scored; None scores everywhere.
    border
        Pixels at each side that are left out, >= 0; the benchmark's 15 by default.

    Raises
    ------
    LightFieldError
        If shapes differ, the border leaves nothing of the map, or no pixel is left to score.
    """
    estimated, true = np.asarray(disparity, np.float64), np.asarray(truth, np.float64)
    if estimated.ndim != 2 or estimated.shape != true.shape:
        raise LightFieldError(
            f"disparity and truth must be [y, x] of the same shape, found {estimated.shape} and {true.shape}."
        )
    scored = np.isfinite(true) & _inside(true.shape, border)
    if mask is not None:
        allowed = np.asarray(mask)
        if allowed.shape != true.shape or allowed.dtype != np.bool_:
            raise LightFieldError(f"mask must be bool {true.shape}, found {allowed.dtype} {allowed.shape}.")
        scored &= allowed
    count = int(scored.sum())
    if count == 0:
        raise LightFieldError(
            f"nothing to score: no pixel of the {true.shape[0]} x {true.shape[1]} map has a known truth "
            f"inside the mask and the border of {border} pixels."
        )
    errors = np.abs(estimated[scored] - true[scored])
    defined = errors[np.isfinite(errors)]
    mse = float(np.mean(defined**2)) if len(defined) else float("nan")
    return Metrics(
        mse_100=100 * mse,
        badpix_07=_badpix(defined, 0.07, count),
        badpix_03=_badpix(defined, 0.03, count),
        badpix_01=_badpix(defined, 0.01, count),
        q25=100 * float(np.quantile(defined, 0.25)) if len(defined) else float("nan"),
        rmse=float(np.sqrt(mse)),
        undefined=100 * (count - len(defined)) / count,
        count=count,
    )


def _inside(shape: tuple[int, ...], border: int) -> NDArray[np.bool_]:
    height, width = shape
    if border < 0 or 2 * border >= min(height, width):
        raise LightFieldError(
            f"border must be at least 0 and leave something of the {height} x {width} map, found {border}."
        )
    inside = np.zeros(shape, np.bool_)
    inside[border : height - border, border : width - border] = True
    return inside


def _badpix(defined: NDArray[np.float64], threshold: float, count: int) -> float:
    good = int((defined <= threshold).sum())  # the rest of `count` is worse or undefined
    return 100 * (count - good) / count
