"""The peak of the distribution of each pixel over disparities: NumPy, float64."""

from collections.abc import Sequence

import numpy as np

from lfgpu.contract import FOLD, PEAK_REACH, Float64Array as Array, Rows, peak_features


def unfolded(folded: Array, size: tuple[int, ...]) -> Array:
    """Compute an image [l, *size] of a folded one [l, y, x, FOLD^2]."""
    count, height, width, _ = folded.shape
    image = folded.reshape(count, height, width, FOLD, FOLD).transpose(0, 1, 3, 2, 4)
    return image.reshape(count, FOLD * height, FOLD * width)[:, : size[0], : size[1]]


def peak(
    logits: Array,
    first: Array,
    *,
    step: float,
    disparity_out: Array,
    probability_out: Array,
    deviation_out: Array,
    rows: Rows | None = None,
) -> None:
    lines = np.arange(logits.shape[1]) if rows is None else np.arange(rows.first, rows.last)
    there = slice(FOLD * lines[0], FOLD * (lines[-1] + 1))
    first = first[there]
    sharp = unfolded(logits[:, lines % logits.shape[1]], first.shape)
    shares = np.exp(sharp - sharp.max(0))
    shares /= shares.sum(0)
    best = shares.argmax(0)
    past = np.arange(len(shares))[:, None, None] - best  # small numbers: they lose no digits beside small shares
    near = np.where(np.abs(past) <= PEAK_REACH, shares, 0)
    probability_out[there] = probability = near.sum(0)
    place = (near * past).sum(0) / probability
    disparity_out[there] = first + step * (best + place)
    deviation_out[there] = step * np.sqrt((near * (past - place) ** 2).sum(0) / probability)


def judge_peak(
    probability: Array,
    deviation: Array,
    *,
    step: float,
    limit: float,
    share: Sequence[float],
    spread: Sequence[float],
    confidence_out: Array,
    variance_out: Array,
) -> None:
    features = peak_features(probability, deviation / step)
    log_odds = np.tensordot(share[:3], features, 1) + share[3] * np.log(limit / step)
    confidence_out[:] = 1 / (1 + np.exp(-log_odds))
    variance_out[:] = step**2 * np.exp(np.tensordot(spread, features, 1))
