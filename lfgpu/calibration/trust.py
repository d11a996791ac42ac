"""How far a map can be trusted whose views are out of line: the confidence and the uncertainty after a look at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfgpu._backends import DEFAULT, BackendName, open_device
from lfgpu.calibration.quick_look import Look, checked, look, part_of
from lfgpu.calibration.screening import worth_a_look
from lfgpu.contract import Float32Array
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.methods import method_of

_VIEWS, _PIXELS = 33, 4_000_000  # that a quick look takes at most
_WITHIN = 0.07  # pixels per view step: the confidence is the share of pixels that are nearer to the truth


def judged(
    lf: LightField,
    result: DepthResult,
    *,
    backend: BackendName = DEFAULT,
    device: str | None = None,
    quickly: bool = False,
) -> DepthResult:
    """The result with what stands out about the cameras, and with a confidence that takes it into account.

    Cameras that are off by random shifts of σ pixels along each axis move a disparity that all of them are matched for
    by σ_d = σ / √(Σ ‖o‖² / 2), with the offsets o of the views that are used: a view tells of the disparity along the
    direction of the texture only, on average half of its offset. Rotations and scales do the same, and more so away
    from the middle. The uncertainty grows by σ_d; the confidence is multiplied by the share of errors of that size that
    stay within 0.07 pixels per view step. Without a finding the result stays as it is. A quick screening says first
    whether there may be one (`lfgpu/calibration/screening.py`).

    Parameters
    ----------
    lf
        The light field.
    result
        Its result, of the same reference view.
    backend, device
        As for `explain`.
    quickly
        Whether to look at 33 of the views and at their middle only, 4 million pixels in all. That takes a few tenths
        of a second whatever the size, and leaves out what is wrong with single views that are not among them. Default
        False: all views.

    Returns
    -------
    The result with `remarks`; the same one if nothing stands out.

    Raises
    ------
    LightFieldError, BackendError
        As `explain`.
    """
    disparity, part = checked(lf, result), lf
    if quickly:
        part, window = part_of(lf, views=_VIEWS, pixels=_PIXELS)
        disparity = disparity[window]
    if not worth_a_look(part, disparity):
        return result
    found = look(part, disparity, open_device(backend, device), colours=False)
    if found is None or not found.findings:
        return result
    if not found.moved:
        return replace(result, remarks=found.findings)
    from scipy.special import erf  # slow to import, and rarely needed

    spread = spread_of(lf, found, method_of(result.config).used_views(lf.layout))
    uncertainty = None if result.uncertainty is None else np.hypot(result.uncertainty, spread)
    share = erf(_WITHIN / (np.sqrt(2) * np.maximum(spread, 1e-9))).astype(np.float32)
    return replace(result, remarks=found.findings, confidence=result.confidence * share, uncertainty=uncertainty)


def spread_of(lf: LightField, found: Look, used: list[int]) -> Float32Array:
    """Standard deviation of the disparity [y, x] because of where cameras stand and look, pixels per view step."""
    height, width = lf.size
    y, x = np.mgrid[:height, :width].astype(np.float64)
    x, y = x - (width - 1) / 2, y - (height - 1) / 2
    shift, turn, scale = found.shift, found.rotation, found.scale
    # Mean over the views of |shift + scale r + turn r'|², with r' the place turned by 90 degrees.
    square = (shift**2).sum(1).mean() + (x**2 + y**2) * float((scale**2 + turn**2).mean())
    square = square + 2 * (x * (scale * shift[:, 0]).mean() + y * (scale * shift[:, 1]).mean())
    square = square + 2 * (x * (turn * shift[:, 1]).mean() - y * (turn * shift[:, 0]).mean())
    told = float((lf.offsets[used] ** 2).sum())
    return np.asarray(np.sqrt(np.maximum(square, 0) / told), np.float32)


__all__ = ["judged"]
