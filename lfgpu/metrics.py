"""The metrics of the HCI 4D Light Field Benchmark, those of its regions, and how far a confidence can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.data import DepthResult, DisparityMap, GroundTruth
from lfgpu.data.light_field_checks import array_of_numbers, check_number, check_whole, without_masked
from lfgpu.data.summary import view_at
from lfgpu.errors import LightFieldError

BORDER = 15
"""Width of the border that the benchmark leaves out, pixels."""

_SHARES = np.arange(20, 0, -1) / 20  # of the pixels that are kept: 1, 0.95 .. 0.05
_ROUNDING = 1e-9  # percent
_BINS = 10  # of a reliability diagram
_SAME_PLACE = 1e-6  # view steps
_FEWEST = 100  # pixels that tell that one map is another one in another unit,
_CLOSE = 0.1  # of the truth's standard deviation: how near the median pixel comes then,
_RIGHT = 0.1  # and how far from 1 the factor is
_ORDERED = 0.8  # correlation of ranks


@dataclass(frozen=True)
class Metrics:
    """The scores of a disparity map; smaller is better for all.

    BadPix is over all scored pixels and counts undefined pixels (NaN or infinite in the estimate) as bad. MSE, RMSE and
    Q25 are over the defined pixels only, NaN if there are none; so read them together with `undefined`.
    """

    mse_100: float
    """Mean squared error times 100, in pixels squared per view step squared."""
    badpix_07: float
    """Percent of pixels with an absolute error above 0.07 pixels per view step."""
    badpix_03: float
    """Percent of pixels with an absolute error above 0.03 pixels per view step."""
    badpix_01: float
    """Percent of pixels with an absolute error above 0.01 pixels per view step."""
    q25: float
    """25 % quantile of the absolute error, times 100: the accuracy of the best quarter of the pixels."""
    rmse: float
    """Root of the mean squared error, pixels per view step."""
    undefined: float
    """Percent of scored pixels where the estimate is undefined."""
    count: int
    """Number of scored pixels."""

    def __repr__(self) -> str:
        return f"<Metrics: {self}>"

    def __str__(self) -> str:
        undefined = f", {self.undefined:.2f} % undefined" if self.undefined else ""
        return (
            f"MSE x100 {self.mse_100:.3f}, BadPix(0.07) {self.badpix_07:.2f} %, BadPix(0.03) {self.badpix_03:.2f} %, "
            f"BadPix(0.01) {self.badpix_01:.2f} %, Q25 {self.q25:.3f}, RMSE {self.rmse:.4f} "
            f"over {self.count} pixels{undefined}"
        )


def evaluate(
    disparity: DepthResult | DisparityMap | ArrayLike,
    truth: GroundTruth | ArrayLike,
    *,
    mask: ArrayLike | None = None,
    border: int = BORDER,
) -> Metrics:
    """Score a disparity map.

        lfgpu.evaluate(result, lf.truth)

    Parameters
    ----------
    disparity
        The estimate: a result, a map, or an array [y, x], pixels per view step; NaN or infinite where it is undefined.
    truth
        The truth: that of a light field, or an array of the same shape and unit; pixels where it is NaN or infinite are
        left out.
    mask
        bool [y, x], True where pixels are scored. Default: that of the truth, if it has one, else everywhere.
    border
        Width of the border that is left out, pixels, >= 0; default 15, as in the benchmark.

    Raises
    ------
    LightFieldError
        If there is no truth, it is of another view, shapes differ, the border leaves nothing of the map, or no pixel is
        left to score.

    Examples
    --------
    >>> round(lfgpu.evaluate(lf.truth.disparity + 0.01, lf.truth).mse_100, 4)
    0.01
    """
    errors, _ = _errors(disparity, truth, mask, border)
    count, defined = len(errors), errors[np.isfinite(errors)]
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


@dataclass(frozen=True, eq=False)
class Sparsification:
    """A sparsification curve: how well a confidence tells which pixels are bad."""

    kept: NDArray[np.float64]
    """Percent of the scored pixels that are kept, the most confident ones: 100, 95 .. 5."""
    bad: NDArray[np.float64]
    """Percent of the kept pixels that are bad."""
    oracle: NDArray[np.float64]
    """The same if the pixels with the smallest true errors are kept: the best possible confidence."""
    ause: float
    """Area between both curves, each divided by the percentage of bad pixels, over the share kept, 0.05 to 1.

    0 is the best. A random confidence has at most 0.95, and less if many pixels are bad. NaN if no pixel is bad.
    """
    monotone: bool
    """True if `bad` never rises as less confident pixels are left out."""
    threshold: float
    """Pixels with a larger absolute error, pixels per view step, are bad."""
    count: int
    """Number of scored pixels."""

    def __repr__(self) -> str:
        bad = ", ".join(f"{self.bad[n]:.2f} % of {self.kept[n]:.0f} %" for n in (0, 10, 18))
        return (
            f"<Sparsification: AUSE {self.ause:.3f} over {self.count} pixels, "
            f"{'' if self.monotone else 'not '}monotone; bad({self.threshold:g}) of those kept: {bad}>"
        )


def other_unit(disparity: ArrayLike, truth: ArrayLike, *, mask: ArrayLike | None = None) -> str | None:
    """Say in a sentence if a map is the truth of the opposite sign or in another unit; None if it is not."""
    found, true = np.asarray(disparity, np.float64), np.asarray(truth, np.float64)
    if found.shape != true.shape or found.ndim != 2:
        return None
    known = np.isfinite(found) & np.isfinite(true) & (True if mask is None else np.asarray(mask, np.bool_))
    found, true = found[known], true[known]
    if len(found) < _FEWEST or not true.std() > 0 or not found.std() > 0:
        return None
    times = float((found * true).sum() / (true * true).sum())
    close = np.median(np.abs(found - times * true)) < _CLOSE * abs(times) * true.std()
    if close and times < 0:
        size = "" if abs(times + 1) < _RIGHT else f", and is {-times:.3g} times as large"
        return f"The map has the opposite sign of the truth{size}: turn one of them round."
    if close and abs(times - 1) > _RIGHT:
        return f"The map is {times:.3g} times as large as the truth: one of them is in another unit."
    order = np.corrcoef(found.argsort().argsort(), true.argsort().argsort())[0, 1]
    if order < -_ORDERED:
        return "The map rises where the truth falls: one of them has the opposite sign, or is depth and not disparity."
    return None


def sparsification(
    disparity: DepthResult | DisparityMap | ArrayLike,
    confidence: ArrayLike,
    truth: GroundTruth | ArrayLike,
    *,
    mask: ArrayLike | None = None,
    border: int = BORDER,
    threshold: float = 0.07,
) -> Sparsification:
    """Compute the share of bad pixels while the least confident pixels are left out step by step.

    Pixels of equal confidence are kept in proportion. Undefined disparities are bad. A confidence of NaN is lower than
    all others. The area is the "area under the sparsification error" of Ilg et al. (2018), here for the share of bad
    pixels instead of the mean error.

    Parameters
    ----------
    disparity, truth, mask, border
        As for `evaluate`.
    confidence
        The larger the surer, of the same shape; only its order counts.
    threshold
        Pixels with an absolute error above the threshold are bad; pixels per view step, >= 0, default 0.07.

    Raises
    ------
    LightFieldError
        As `evaluate`; if the confidence is of another shape, or the threshold is negative.

    Examples
    --------
    >>> curve = lfgpu.metrics.sparsification(result, result.confidence, lf.truth)
    >>> bool(curve.bad[-1] <= curve.bad[0])
    True
    """
    errors, surer = _with_confidence(disparity, confidence, truth, mask, border, threshold)
    levels, level = np.unique(-np.where(np.isnan(surer), -np.inf, surer), return_inverse=True)
    off = ~(errors <= threshold)  # undefined ones too
    pixels = np.cumsum(np.bincount(level, minlength=len(levels)))
    wrong = np.cumsum(np.bincount(level, off, minlength=len(levels)))
    count, total = len(errors), int(off.sum())
    kept = _SHARES * count
    bad = 100 * np.interp(kept, np.append(0, pixels), np.append(0, wrong)) / kept
    oracle = 100 * np.maximum(0, total - (count - kept)) / kept
    area = np.trapezoid((bad - oracle)[::-1], _SHARES[::-1])
    return Sparsification(
        kept=100 * _SHARES,
        bad=bad,
        oracle=oracle,
        ause=float(area / (100 * total / count)) if total else float("nan"),
        monotone=bool((np.diff(bad) <= _ROUNDING).all()),
        threshold=threshold,
        count=count,
    )


@dataclass(frozen=True, eq=False)
class Reliability:
    """A reliability diagram: how many pixels of each stated confidence are right. Bins without a pixel are left out."""

    said: NDArray[np.float64]  # mean confidence of the pixels of each bin, 0 to 1
    right: NDArray[np.float64]  # percent of them that are within the threshold of the truth
    share: NDArray[np.float64]  # percent of all scored pixels that are in the bin
    threshold: float  # pixels with |error| <= threshold, pixels per view step, are right
    count: int  # number of scored pixels

    def __repr__(self) -> str:
        bins = ", ".join(f"{100 * s:.0f} -> {r:.1f}" for s, r in zip(self.said, self.right, strict=True))
        return f"<Reliability over {self.count} pixels: percent said -> right({self.threshold:g}): {bins}>"


def reliability(
    disparity: DepthResult | DisparityMap | ArrayLike,
    confidence: ArrayLike,
    truth: GroundTruth | ArrayLike,
    *,
    mask: ArrayLike | None = None,
    border: int = BORDER,
    threshold: float = 0.07,
) -> Reliability:
    """Compute which share of the pixels of each confidence is right, in ten bins of equal width.

    Right are pixels with |error| <= threshold, pixels per view step. Undefined disparities are wrong. Pixels whose
    confidence is NaN are left out. LightFieldError as `sparsification`, or if the confidence is not from 0 to 1.
    """
    errors, said = _with_confidence(disparity, confidence, truth, mask, border, threshold)
    stated = np.isfinite(said)
    errors, said = errors[stated], said[stated]
    if said.size and (said.min() < 0 or said.max() > 1):
        raise LightFieldError(f"confidence must be from 0 to 1, found {said.min():g} to {said.max():g}.")
    bins = np.minimum((said * _BINS).astype(np.intp), _BINS - 1)
    pixels = np.bincount(bins, minlength=_BINS)
    there = pixels > 0
    right = np.bincount(bins, errors <= threshold, minlength=_BINS)[there] / pixels[there]
    return Reliability(
        said=np.bincount(bins, said, minlength=_BINS)[there] / pixels[there],
        right=100 * right,
        share=100 * pixels[there] / max(len(errors), 1),
        threshold=threshold,
        count=len(errors),
    )


def _with_confidence(
    disparity: DepthResult | DisparityMap | ArrayLike,
    confidence: ArrayLike,
    truth: GroundTruth | ArrayLike,
    mask: ArrayLike | None,
    border: int,
    threshold: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return |error| and confidence of the scored pixels, [p] each."""
    check_number("threshold", threshold, 0)
    errors, scored = _errors(disparity, truth, mask, border)
    surer = _numbers("confidence", "that of a result", confidence)
    if surer.shape != scored.shape:
        raise LightFieldError(f"confidence must be {scored.shape} as the disparity, found {surer.shape}.")
    return errors, surer[scored]


def _errors(
    disparity: DepthResult | DisparityMap | ArrayLike,
    truth: GroundTruth | ArrayLike | None,
    mask: ArrayLike | None,
    border: int,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return |error| of the scored pixels [p], NaN or infinite where undefined, and the mask [y, x] of these."""
    if isinstance(truth, GroundTruth):
        place = disparity.position if isinstance(disparity, DepthResult | DisparityMap) else None
        if place is not None and not np.allclose(place, truth.position, atol=_SAME_PLACE):
            raise LightFieldError(
                f"the map is of the view at {view_at(place)}, the truth of the one at {view_at(truth.position)}: "
                "estimate that view (LightField.with_reference)."
            )
        mask = truth.mask if mask is None else mask
        truth = truth.disparity
    if isinstance(disparity, DepthResult | DisparityMap):
        disparity = disparity.disparity
    if truth is None:
        raise LightFieldError("there is no ground truth (None): give lf.truth of a light field that has one, or a map.")
    estimated, true = _of_one_shape(disparity, truth)
    scored = np.isfinite(true) & _inside(true.shape, border)
    if mask is not None:
        scored &= _mask("mask", mask, true.shape)
    if not scored.any():
        raise LightFieldError(
            f"nothing to score: no pixel of the {true.shape[0]} x {true.shape[1]} map has a known truth "
            f"inside the mask and the border of {border} pixels."
        )
    return np.abs(estimated[scored] - true[scored]), scored


def _of_one_shape(disparity: object, truth: object) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    estimated = _numbers("disparity", "a DepthResult, a DisparityMap", disparity)
    true = _numbers("truth", "the GroundTruth of a light field", truth)
    if estimated.ndim != 2 or estimated.shape != true.shape:
        raise LightFieldError(
            f"disparity and truth must be [y, x] of the same shape, found {estimated.shape} and {true.shape}."
        )
    return estimated, true


def _mask(name: str, mask: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    allowed = array_of_numbers(name, mask)
    if allowed.shape != shape or allowed.dtype != np.bool_:
        raise LightFieldError(f"{name} must be bool {shape}, found {allowed.dtype} {allowed.shape}.")
    return allowed


def _numbers(name: str, others: str, values: object) -> NDArray[np.float64]:
    try:
        return np.asarray(without_masked(values), np.float64)
    except (TypeError, ValueError):
        raise LightFieldError(f"{name} must be {others} or an array [y, x], found {type(values).__name__}.") from None


def _inside(shape: tuple[int, ...], border: int) -> NDArray[np.bool_]:
    height, width = shape
    check_whole("border", border, 0)
    if 2 * border >= min(height, width):
        raise LightFieldError(
            f"border must be at least 0 and leave something of the {height} x {width} map, found {border}."
        )
    inside = np.zeros(shape, np.bool_)
    inside[border : height - border, border : width - border] = True
    return inside


def _badpix(defined: NDArray[np.float64], threshold: float, count: int) -> float:
    good = int((defined <= threshold).sum())  # the rest of `count` is worse or undefined
    return 100 * (count - good) / count


_MOST_BUMPY = 0.05  # pixels per view step and pixel squared: what counts at most
_FINE = 0.15  # pixels per view step


@dataclass(frozen=True)
class RegionMetric:
    """One measure."""

    name: str
    mask: str  # the name of the benchmark's mask
    unit: str  # "%" of the pixels of the mask, or "x100"
    values: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    """Values whose mean over the mask is the measure, [y, x], from estimate - truth; NaN of the estimate stays NaN."""


def _share(
    bad: Callable[[NDArray[np.float64]], NDArray[np.bool_]],
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the measure of a share in percent; pixels without an estimate are bad."""
    return lambda error: np.where(np.isfinite(error), 100.0 * bad(error), 100.0)


def bumpiness(error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the Frobenius norm of the second derivatives of the error times 100, cut off at 5."""
    from scipy import ndimage  # slow to import, and rarely needed

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
    disparity: ArrayLike, truth: ArrayLike, masks: Mapping[str, ArrayLike], *, border: int = BORDER
) -> dict[str, float]:
    """Score a disparity map [y, x], NaN where it is undefined, in the parts of a scene that masks name.

    Masks have the benchmark's names: "discontinuities", "planes", "smooth_surfaces", "fine_surrounding", "fine"; any
    may be missing. Returns the values of `REGION_METRICS` whose mask is there and not empty.
    """
    estimated, true = _of_one_shape(disparity, truth)
    error, inside = estimated - true, np.isfinite(true) & _inside(true.shape, border)
    scores = {}
    for metric in REGION_METRICS:
        mask = masks.get(metric.mask)
        if mask is None:
            continue
        values = metric.values(error)[_mask(f"the mask {metric.mask}", mask, error.shape) & inside]
        defined = values[np.isfinite(values)]
        if len(values):
            scores[metric.name] = float(defined.mean()) if len(defined) else float("nan")
    return scores
