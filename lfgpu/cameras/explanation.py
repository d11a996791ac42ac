"""Explanation of the views by a map: the quality of their prediction, and what the cameras have to do with the rest.

No truth is needed. The reference view and its map predict every other view (a z-buffered splat). A pixel that they do
not predict is hidden in the reference, or the map is wrong there, or the camera is not at its place: shifted, turned,
of another scale, brighter. A fault of the camera has the same form all over a view; a look at the cameras measures it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendName, open_device
from lfgpu.cameras.looking import FEWEST, Look, checked_map, look
from lfgpu.cameras.points import known_pixels
from lfgpu.contract import Device, Float32Array, Float64Array
from lfgpu.data import summary
from lfgpu.data.lightfield import LightField, check_light_field
from lfgpu.io.contradictions import contradictions, no_parallax

if TYPE_CHECKING:
    from lfgpu.data.result import DepthResult, DisparityMap

_SOFTNESS, _SHARPNESS = 0.1, 30.0  # of the splat
_COVERED = 0.5  # coverage from which a pixel of a view is predicted
_AT_ONCE = 8  # views that are predicted together
_WORSE = 1.03  # of the error with a constant disparity


@dataclass(frozen=True, eq=False)
class Explanation(Look, summary.InNotebooks):
    """Quality of a map and state of the cameras, from `explain`. n views, c colours.

    Parameters
    ----------
    psnr
        float64 [n], dB: recorded against predicted view where it is predicted; infinity for the reference itself, NaN
        where nothing of a view is predicted.
    predicted
        float64 [n], share of each view's pixels that are predicted.
    unexplained
        float32 [y, x], root mean square difference between a pixel of the reference and the views that see it,
        intensity; NaN where no view sees it.
    positions
        float64 [n, 2], as in `LightField.positions`.
    reference
        Index of the reference view.
    name
        Name of the light field.
    shift, shift_error
        float64 [n, 2], pixels to the right and down by which the contents of a view stand away from where the other
        views and its camera's position put them; and the standard error. Effects that views cannot tell are left out:
        all of them moved alike, or in proportion to their offsets. NaN, as all below, where fewer than 50 points have
        texture; shift, rotation, scale and brightness are NaN for views that show something else than the others.
    rotation, rotation_error
        float64 [n], degrees, clockwise.
    scale, scale_error
        float64 [n], share by which a view shows things larger: 0.01 is 1 %. Of rotations and scales the mean and the
        part in proportion to the offsets are left out: a map that is tilted as a whole explains as much.
    gain, offset
        float64 [n, c]: a view shows gain * t + offset where the reference shows t.
    brightness
        float64 [n], brightness of a view as a share of the reference's, at the median brightness of the points.
    misfit
        float64 [n], usual difference of a view from what the others show, over its usual gradient: pixels by which its
        edges seem to stand off when the effects above are taken out.
    place
        int [n], index of the camera at whose place a view fits: its own, unless names were exchanged.
    points
        Number of points with texture that the cameras are measured at.
    findings
        What stands out, one sentence each; empty if nothing does.
    moved
        The findings about places and directions of cameras.
    signs
        "v" if rows and columns of cameras are counted in opposite senses, "uv" if both are counted the wrong way,
        "transposed" if rows are taken for columns, "turned" if that and one of them is counted the wrong way; None if
        nothing speaks for that.
    """

    psnr: Float64Array
    predicted: Float64Array
    unexplained: Float32Array
    name: str

    @property
    def misalignment(self) -> float:
        """Root mean square of `shift` along an axis, pixels; NaN if no view tells."""
        known = self.shift[np.isfinite(self.shift)]
        return float(np.sqrt((known**2).mean())) if len(known) else float("nan")

    @property
    def mean_psnr(self) -> float:
        """PSNR, dB, of the mean squared error over the views other than the reference that are predicted."""
        known = np.isfinite(self.psnr)
        return float(-10 * np.log10((10 ** (-self.psnr[known] / 10)).mean())) if known.any() else float("nan")


def explain(
    lf: LightField,
    result: DepthResult | DisparityMap | NDArray[np.floating[Any]],
    *,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> Explanation:
    """Judge a map, and the cameras, by the prediction of all other views from the reference view and its map.

    Parameters
    ----------
    lf
        The light field.
    result
        A map of its reference view: a result, a map, or the disparity itself, [y, x], pixels per view step, larger is
        nearer, NaN where it is unknown.
    backend, device
        Where views are predicted, as for `estimate_depth`; the rest is done on the host.

    Raises
    ------
    LightFieldError
        If the map has another size, belongs to another view, or is undefined everywhere.
    BackendError
        If the backend or the device is missing.

    Examples
    --------
    >>> lfgpu.explain(lf, result).mean_psnr > 25
    True
    """
    prediction = _Prediction(lf, result, open_device(backend, device))
    found = look(lf, prediction.disparity, prediction.device, budget="full")
    assert found is not None  # only a screening finds nothing to measure
    errors = {n: np.sqrt((residual**2).mean(axis=2)) for n, residual in prediction.residuals()}
    psnr, predicted, unexplained = prediction.compared(errors)
    findings = found.findings
    if (against := contradictions(lf)) and (found.signs is None or no_parallax(lf) is not None):
        findings = against
    elif found.signs is None and not prediction.is_as_good_as_plane(errors):
        findings = (
            "the map predicts the views worse than a plane does: it belongs to another light field or view, or the "
            "range of disparities is wrong.",
        )
    elif found.signs is None and found.points < FEWEST:
        findings = (
            f"only {found.points} points of the reference have texture on a smooth surface: nothing can be said of the "
            "cameras.",
        )
    return Explanation(
        **{**vars(found), "findings": findings},
        psnr=psnr,
        predicted=predicted,
        unexplained=unexplained,
        name=lf.name,
    )


def residual_pictures(
    lf: LightField,
    result: DepthResult | DisparityMap | NDArray[np.floating[Any]],
    *,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> Iterator[tuple[int, Float32Array]]:
    """Yield (index, recorded less predicted view) of each view but the reference: [y, x, c], NaN where not predicted.

    Arguments and errors are those of `explain`.
    """
    return _Prediction(lf, result, open_device(backend, device)).residuals()


class _Prediction:
    """Views that the reference view and its map predict."""

    def __init__(self, lf: LightField, result: Any, device: Device) -> None:
        check_light_field(lf)
        self.lf, self.disparity, self.device = lf, checked_map(lf, result), device

    def views(
        self, disparity: NDArray[np.floating[Any]], chosen: NDArray[np.intp]
    ) -> tuple[Float32Array, NDArray[np.bool_]]:
        """Predict some views by a map of the reference: [k, y, x, c] in [0, 1], and where they are, [k, y, x]."""
        lf, device, kernels = self.lf, self.device, self.device.kernels
        known = known_pixels(lf, disparity)
        # Unknown pixels land outside every view: at a disparity that moves them out of the frame in all directions.
        far = float(disparity[known].min()) if known.any() else 0.0
        map_ = device.field(np.where(known, disparity, far))
        shape = (len(chosen), *lf.size, lf.channels)
        views, coverage = device.zeros_image(shape, np.float32), device.zeros(shape[:3])
        offsets = device.field(lf.offsets[chosen])

        def splat(picture: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
            kernels.splat_z_buffered(
                device.image(picture),
                map_,
                offsets,
                softness=_SOFTNESS,
                sharpness=_SHARPNESS,
                views_out=views,
                coverage_out=coverage,
            )
            return kernels.numpy(views), kernels.numpy(coverage)

        covered = np.ones(shape[:3], np.bool_)
        if not known.all():
            share, _ = splat(np.repeat(known[..., None], lf.channels, axis=2).astype(np.float32))
            covered = share[..., 0] > 0.99
        seen, coverage_ = splat(lf.image(lf.reference_index))
        return seen.astype(np.float32), covered & (coverage_ >= _COVERED)

    def residuals(self) -> Iterator[tuple[int, Float32Array]]:
        """Yield the residual of each view but the reference, as `residual_pictures`."""
        lf = self.lf
        others = np.array([n for n in range(len(lf.views)) if n != lf.reference_index])
        for first in range(0, len(others), _AT_ONCE):
            chosen = others[first : first + _AT_ONCE]
            for view, covered, n in zip(*self.views(self.disparity, chosen), chosen, strict=True):
                if lf.valid is not None:
                    covered &= lf.valid[n]
                yield int(n), np.where(covered[..., None], lf.image(int(n)) - view, np.float32(np.nan))

    def compared(self, errors: dict[int, NDArray[np.float32]]) -> tuple[Float64Array, Float64Array, Float32Array]:
        """PSNR [n], share that is predicted [n], and the root mean square error of the reference's pixels [y, x]."""
        lf, disparity = self.lf, self.disparity
        psnr, predicted = np.full(len(lf.views), np.nan), np.zeros(len(lf.views))
        psnr[lf.reference_index], predicted[lf.reference_index] = np.inf, 1.0
        height, width = lf.size
        y, x = np.mgrid[:height, :width].astype(np.float32)
        d = np.nan_to_num(disparity)
        total, times = np.zeros(lf.size, np.float32), np.zeros(lf.size, np.float32)
        for n, error in errors.items():
            known = np.isfinite(error)
            predicted[n] = known.mean()
            if known.any():
                psnr[n] = -10 * np.log10(max(float((error[known].astype(np.float64) ** 2).mean()), 1e-12))
            du, dv = lf.offsets[n]
            row, column = np.rint(y - d * np.float32(dv)), np.rint(x - d * np.float32(du))
            inside = (row >= 0) & (row < height) & (column >= 0) & (column < width) & np.isfinite(disparity)
            found = error[row.clip(0, height - 1).astype(np.intp), column.clip(0, width - 1).astype(np.intp)]
            inside &= np.isfinite(found)
            total[inside] += found[inside] ** 2
            times += inside
        with np.errstate(invalid="ignore", divide="ignore"):
            return psnr, predicted, np.where(times > 0, np.sqrt(total / times), np.float32(np.nan)).astype(np.float32)

    def is_as_good_as_plane(self, errors: dict[int, NDArray[np.float32]]) -> bool:
        """Tell whether the map predicts no worse than its median disparity would; True if it is flat itself."""
        lf = self.lf
        known = self.disparity[np.isfinite(self.disparity)]
        distance = np.hypot(*lf.offsets.T)
        if np.percentile(known, 95) - np.percentile(known, 5) < 1.0 / distance.max():
            return True
        order = np.argsort(-distance, kind="stable")[:_AT_ONCE]
        chosen = np.array([n for n in order if n != lf.reference_index])
        flat, seen = self.views(np.full(lf.size, float(np.median(known)), np.float32), chosen)
        loss, by_plane = 0.0, 0.0
        for view, covered, n in zip(flat, seen, chosen, strict=True):
            error = errors[int(n)]
            both = covered & np.isfinite(error)
            loss += float(np.minimum(error[both], 0.2).sum())
            by_plane += float(np.minimum(np.sqrt(((view - lf.image(int(n))) ** 2).mean(axis=2))[both], 0.2).sum())
        return loss <= _WORSE * by_plane
