"""Trust in a map whose cameras are off: lower confidence and larger uncertainty, after a look at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfgpu.cameras import consensus
from lfgpu.cameras.looking import Look
from lfgpu.contract import Float32Array
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.methods import method_of

_WITHIN = 0.07  # pixels per view step: the confidence is the share of pixels that are nearer to the truth
_ALONE = 2.0  # pixels: a view that stands out by more fits at no disparity near by, so it no longer draws the map


def trusted(lf: LightField, result: DepthResult, found: Look) -> DepthResult:
    """Add the findings to a result as its remarks, and take them into account in its confidence and uncertainty.

    Cameras that are off by random shifts of σ pixels along each axis move a disparity that all of them are matched for
    by σ_d = σ / √(Σ ‖o‖² / 2), with the offsets o of the views that are used: a view tells of the disparity along the
    direction of the texture only, on average half of its offset. Rotations and scales do the same, and more so away
    from the middle. The uncertainty grows by σ_d; the confidence is multiplied by the share of errors of that size that
    stay within 0.07 pixels per view step.
    """
    result = replace(result, remarks=found.findings)
    if not found.moved:
        return result
    from scipy.special import erf  # slow to import, and rarely needed

    spread = _spread(lf, found, method_of(result.config).used_views(lf.offsets))
    uncertainty = None if result.uncertainty is None else np.hypot(result.uncertainty, spread)
    share = erf(_WITHIN / (np.sqrt(2) * np.maximum(spread, 1e-9))).astype(np.float32)
    return replace(result, confidence=result.confidence * share, uncertainty=uncertainty)


def _spread(lf: LightField, found: Look, used: list[int]) -> Float32Array:
    """Standard deviation of the disparity [y, x] because cameras stand and look elsewhere, pixels per view step."""
    height, width = lf.size
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = x - (width - 1) / 2, y - (height - 1) / 2
    known = np.flatnonzero(np.isfinite(found.shift).all(axis=1))
    shift, error, offsets = (each[known] for each in (found.shift, found.shift_error, found.offsets))
    near = known[~consensus.outliers(shift, offsets, error, least=_ALONE)]
    shift, turn, scale = found.shift[near], np.deg2rad(found.rotation[near]), found.scale[near]
    # Mean over the views of |shift + scale r + turn r'|², with r' the place turned by 90 degrees.
    square = (shift**2).sum(1).mean() + (x**2 + y**2) * float((scale**2 + turn**2).mean())
    square = square + 2 * (x * (scale * shift[:, 0]).mean() + y * (scale * shift[:, 1]).mean())
    square = square + 2 * (x * (turn * shift[:, 1]).mean() - y * (turn * shift[:, 0]).mean())
    told = float((lf.offsets[used] ** 2).sum())
    return np.asarray(np.sqrt(np.maximum(square, 0) / told), np.float32)
