"""The judge: how well a map predicts the views of its light field, and what the cameras have to do with the rest.

No truth is needed. The reference view and its map predict every other view (a z-buffered splat). What they cannot
predict is hidden in the reference, or the map is wrong there, or the camera is not where it was thought to be: shifted,
turned, of another scale, brighter. The latter has the same form all over a view and is measured by photometric bundle
adjustment (`lfgpu.calibration.bundle`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendName, backend_named, open_device
from lfgpu.calibration.bundle import choose_points, most_points
from lfgpu.calibration.findings import SIGNS, brightness, placement
from lfgpu.calibration.quick_look import FEWEST, cameras_of, checked, signs_of
from lfgpu.contract import Device, Float32Array, Float64Array
from lfgpu.data import hooks
from lfgpu.data.lightfield import LightField

if TYPE_CHECKING:
    from lfgpu.data.result import DepthResult, DisparityMap

_POINTS = 5000
_SOFTNESS, _SHARPNESS = 0.1, 30.0  # of the splat
_COVERED = 0.5  # coverage from which a pixel of a view is predicted
_AT_ONCE = 8  # views that are predicted together

_WORSE = 1.03  # of the error with a constant disparity


@dataclass(frozen=True, eq=False)
class Explanation:
    """How a map explains the views, from `explain`. n views, c colours.

    Parameters
    ----------
    psnr
        float64 [n], dB: recorded against predicted view where it is predicted; infinity for the reference itself, NaN
        where nothing of a view is predicted.
    predicted
        float64 [n], share of each view's pixels that are predicted.
    shift, shift_error
        float64 [n, 2], pixels to the right and down by which what a view shows stands away from where the others and
        its camera's position put it; and the standard error. What views cannot tell is left out: all moved alike, or in
        proportion to their offsets.
    rotation, rotation_error
        float64 [n], degrees, clockwise.
    scale, scale_error
        float64 [n], how much larger a view shows things: 0.01 is 1 %. Of rotations and scales the mean and what grows
        in proportion to the offsets is left out: a map that is tilted as a whole explains as much.
    gain, offset
        float64 [n, c]: a view shows gain * t + offset where the reference shows t.
    brightness
        float64 [n], how bright a view is as a share of the reference, at the mean brightness of the points compared.
    unexplained
        float32 [y, x], root mean square difference, over the views that see a pixel of the reference, between what they
        show and what it shows, intensity; NaN where no view sees it.
    points
        How many points with texture this rests on.
    findings
        What stands out, one sentence each; empty if nothing does.
    signs
        "v" if rows and columns of cameras are counted in opposite senses, "uv" if both are counted the wrong way,
        "transposed" if rows are taken for columns; None if nothing speaks for that.
    positions
        float64 [n, 2], as in `LightField.positions`.
    name
        The light field's name.
    """

    psnr: Float64Array
    predicted: Float64Array
    shift: Float64Array
    shift_error: Float64Array
    rotation: Float64Array
    rotation_error: Float64Array
    scale: Float64Array
    scale_error: Float64Array
    gain: Float64Array
    offset: Float64Array
    brightness: Float64Array
    unexplained: Float32Array
    points: int
    findings: tuple[str, ...]
    signs: str | None
    positions: Float64Array
    reference: int
    name: str

    @property
    def misalignment(self) -> float:
        """Root mean square of `shift` along an axis, pixels."""
        return float(np.sqrt((self.shift**2).mean()))

    @property
    def mean_psnr(self) -> float:
        """PSNR, dB, of the mean squared error over the views other than the reference that are predicted."""
        known = np.isfinite(self.psnr)
        return float(-10 * np.log10((10 ** (-self.psnr[known] / 10)).mean())) if known.any() else float("nan")

    def _repr_html_(self) -> str:
        """The HTML for notebooks."""
        return str(hooks.call("explanation_html", self))

    def as_dict(self) -> dict[str, Any]:
        """All numbers but the map, for JSON; NaN and infinity are None."""

        def plain(values: NDArray[Any]) -> Any:
            return [plain(row) for row in values] if values.ndim else (float(values) if np.isfinite(values) else None)

        views = [
            {
                "position": plain(self.positions[n]),
                "psnr_db": plain(self.psnr[n]),
                "predicted": plain(self.predicted[n]),
                "shift_px": plain(self.shift[n]),
                "shift_error_px": plain(self.shift_error[n]),
                "rotation_deg": plain(self.rotation[n]),
                "rotation_error_deg": plain(self.rotation_error[n]),
                "scale": plain(self.scale[n]),
                "scale_error": plain(self.scale_error[n]),
                "gain": plain(self.gain[n]),
                "offset": plain(self.offset[n]),
                "brightness": plain(self.brightness[n]),
            }
            for n in range(len(self.positions))
        ]
        return {
            "name": self.name,
            "findings": list(self.findings),
            "signs": self.signs,
            "reference": self.reference,
            "points": self.points,
            "psnr_db": plain(np.asarray(self.mean_psnr)),
            "misalignment_px": plain(np.asarray(self.misalignment)),
            "views": views,
        }


def explain(
    lf: LightField,
    result: DepthResult | DisparityMap | NDArray[np.floating[Any]],
    *,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> Explanation:
    """Judge a map, and the cameras, by how well the reference view and its map predict all other views.

    Parameters
    ----------
    lf
        The light field.
    result
        A map of its reference view: a result, a map, or the disparity itself, [y, x], pixels per view step, larger is
        nearer, NaN where it is not known.
    backend, device
        Where views are predicted, as for `estimate_depth`; the rest is done on the host.

    Raises
    ------
    LightFieldError
        If the map has another size, belongs to another view, or says nothing.
    BackendError
        If the backend or the device is not there.
    """
    disparity = checked(lf, result)
    place = open_device(backend, device)
    points = choose_points(lf, disparity, place, most=min(_POINTS, most_points(len(lf.views), 6)))
    errors = list(_errors(lf, disparity, place))
    psnr, predicted, unexplained = _prediction(lf, disparity, errors)
    findings: list[str] = []
    wrong = signs_of(lf, disparity, points)
    cameras = cameras_of(lf, points)
    if wrong is not None:
        findings.append(SIGNS[wrong])
    elif not _as_good_as_plane(lf, disparity, errors, place):
        findings.append(
            "the map predicts the views worse than a plane does: it belongs to another light field or view, or the "
            "range of disparities is wrong."
        )
    elif len(points.x) < FEWEST:
        findings.append(
            f"only {len(points.x)} points of the reference have texture on a smooth surface: of the cameras nothing "
            "can be told."
        )
    else:
        findings += [*placement(lf, cameras), *brightness(lf, cameras)]
    return Explanation(
        psnr=psnr,
        predicted=predicted,
        unexplained=unexplained,
        points=len(points.x),
        findings=tuple(findings),
        signs=wrong,
        positions=lf.positions.copy(),
        reference=lf.reference_index,
        name=lf.name,
        **cameras,
    )


def residual_pictures(
    lf: LightField,
    result: DepthResult | DisparityMap | NDArray[np.floating[Any]],
    *,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> Iterator[tuple[int, Float32Array]]:
    """(index, recorded less predicted view) of each view but the reference: [y, x, c], NaN where nothing is predicted.

    Arguments and errors are those of `explain`.
    """
    disparity = checked(lf, result)
    place = open_device(backend, device)
    others = np.array([n for n in range(len(lf.views)) if n != lf.reference_index])
    for first in range(0, len(others), _AT_ONCE):
        chosen = others[first : first + _AT_ONCE]
        for view, covered, n in zip(*predict(lf, disparity, chosen, place), chosen, strict=True):
            if lf.valid is not None:
                covered &= lf.valid[n]
            yield int(n), np.where(covered[..., None], lf.image(int(n)) - view, np.float32(np.nan))


def predict(
    lf: LightField,
    disparity: NDArray[np.floating[Any]],
    chosen: NDArray[np.intp],
    device: Device,
) -> tuple[Float32Array, NDArray[np.bool_]]:
    """What the reference and its map predict of some views: [k, y, x, c] in [0, 1], and where they do, [k, y, x]."""
    kernels = device.kernels
    known = np.isfinite(disparity)
    if lf.valid is not None:
        known &= lf.valid[lf.reference_index]
    # What is not known lands outside every view: at a disparity that moves it out of the frame in all directions.
    far = float(disparity[known].min()) if known.any() else 0.0
    map_ = device.field(np.where(known, disparity, far))
    image = lf.image(lf.reference_index)
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
    seen, coverage_ = splat(image)
    return seen.astype(np.float32), covered & (coverage_ >= _COVERED)


# --- steps ---


def _errors(
    lf: LightField, disparity: NDArray[np.float32], device: Device
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Of each view but the reference its root mean square difference over colours from what is predicted, [y, x]; NaN
    where nothing is."""
    backend = backend_named(device.kernels.name)
    for n, residual in residual_pictures(lf, disparity, backend=backend, device=device.name):
        yield n, np.sqrt((residual**2).mean(axis=2))


def _prediction(
    lf: LightField, disparity: NDArray[np.float32], errors: list[tuple[int, NDArray[np.float32]]]
) -> tuple[Float64Array, Float64Array, Float32Array]:
    """PSNR [n], share that is predicted [n], and the root mean square error of the reference's pixels [y, x]."""
    count = len(lf.views)
    psnr, predicted = np.full(count, np.nan), np.zeros(count)
    psnr[lf.reference_index], predicted[lf.reference_index] = np.inf, 1.0
    height, width = lf.size
    y, x = np.mgrid[:height, :width].astype(np.float32)
    d = np.nan_to_num(disparity)
    total, times = np.zeros(lf.size, np.float32), np.zeros(lf.size, np.float32)
    for n, error in errors:
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


def _as_good_as_plane(
    lf: LightField,
    disparity: NDArray[np.float32],
    errors: list[tuple[int, NDArray[np.float32]]],
    device: Device,
) -> bool:
    """Whether the map predicts no worse than its median would, if it is not flat itself."""
    known = disparity[np.isfinite(disparity)]
    middle = float(np.median(known))
    if np.percentile(known, 95) - np.percentile(known, 5) < 1.0 / np.hypot(*lf.offsets.T).max():
        return True
    order = np.argsort(-np.hypot(*lf.offsets.T), kind="stable")[:_AT_ONCE]
    chosen = np.array([n for n in order if n != lf.reference_index])
    flat, seen = predict(lf, np.full(lf.size, middle, np.float32), chosen, device)
    loss, by_plane, of = 0.0, 0.0, dict(errors)
    for view, covered, n in zip(flat, seen, chosen, strict=True):
        error = of[int(n)]
        both = covered & np.isfinite(error)
        loss += float(np.minimum(error[both], 0.2).sum())
        by_plane += float(np.minimum(np.sqrt(((view - lf.image(int(n))) ** 2).mean(axis=2))[both], 0.2).sum())
    return loss <= _WORSE * by_plane


__all__ = ["Explanation", "explain", "predict", "residual_pictures"]
