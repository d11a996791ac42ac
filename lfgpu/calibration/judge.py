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

from lfgpu._backends import DEFAULT, BackendName, backend_named, load, pick_device
from lfgpu.calibration import consensus, signs
from lfgpu.calibration.bundle import Bundle, Points, choose_points, most_points
from lfgpu.calibration.tones import match_tones
from lfgpu.contract import Float32Array, Float64Array, KernelSet
from lfgpu.data import hooks
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError

if TYPE_CHECKING:
    from lfgpu.data.result import DepthResult, DisparityMap

_POINTS, _STEPS = 5000, 5  # points, and Gauss-Newton steps of the cameras
_QUICK_POINTS, _QUICK_STEPS = 2000, 3
_FEWEST = 50  # points with texture: from fewer no camera is told
_SOFTNESS, _SHARPNESS = 0.1, 30.0  # of the splat
_COVERED = 0.5  # coverage from which a pixel of a view is predicted
_AT_ONCE = 8  # views that are predicted together

# What stands out. A single view does so against the trend of its neighbours, see `consensus.outliers`.
_MOVED = 0.1  # pixels
_TURNED = 0.15  # pixels at the half diagonal
_BRIGHTER = 0.03  # share
_OUT_OF_LINE = 0.12  # pixels, rms of all views along each axis
_OUT_OF_SHAPE = 0.2  # pixels at the half diagonal, rms
_UNEQUAL = 0.03  # share, rms
_LEVEL = 0.5  # intensity at which brightness is compared where views tell nothing else
_NAMED = 4  # views that a sentence names
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
    kernels = load(backend)
    device = pick_device(kernels, device)
    points = choose_points(lf, disparity, kernels, device, most=min(_POINTS, most_points(len(lf.views), 6)))
    errors = list(_errors(lf, disparity, kernels, device))
    psnr, predicted, unexplained = _prediction(lf, disparity, errors)
    findings: list[str] = []
    wrong = _signs(lf, disparity, points)
    cameras = _cameras(lf, points)
    if wrong is not None:
        findings.append(SIGNS[wrong])
    elif not _as_good_as_plane(lf, disparity, errors, kernels, device):
        findings.append(
            "the map predicts the views worse than a plane does: it belongs to another light field or view, or the "
            "range of disparities is wrong."
        )
    elif len(points.x) < _FEWEST:
        findings.append(
            f"only {len(points.x)} points of the reference have texture on a smooth surface: of the cameras nothing "
            "can be told."
        )
    else:
        findings += _sentences(lf, cameras)
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


def remarks(
    lf: LightField,
    result: DepthResult | DisparityMap | NDArray[np.floating[Any]],
    *,
    backend: BackendName = DEFAULT,
    device: str | None = None,
) -> tuple[str, ...]:
    """The findings of `explain` on signs and cameras, from fewer points and without predicting views: a quick look.

    Arguments and errors are those of `explain`.
    """
    disparity = checked(lf, result)
    kernels = load(backend)
    found = look(lf, disparity, kernels, pick_device(kernels, device), colours=False)
    return () if found is None else found.findings


@dataclass(frozen=True, eq=False)
class Look:
    """What a quick look at the cameras shows; n views, c colours.

    Parameters
    ----------
    findings
        What stands out, one sentence each.
    moved
        Those of them that say where cameras stand and look.
    shift
        float64 [n, 2], as in `Explanation`.
    rotation
        float64 [n], radians clockwise.
    scale
        float64 [n], as in `Explanation`.
    gain, offset
        float64 [n, c] (c = 1 without colours): a view shows gain * t + offset where the reference shows t.
    """

    findings: tuple[str, ...]
    moved: tuple[str, ...]
    shift: Float64Array
    rotation: Float64Array
    scale: Float64Array
    gain: Float64Array
    offset: Float64Array


def look(
    lf: LightField,
    disparity: NDArray[np.float32],
    kernels: KernelSet,
    device: str,
    *,
    colours: bool = True,
    axes: bool = True,
) -> Look | None:
    """A quick look at the cameras with the map of the reference view [y, x]; None where texture is too little.

    `colours` says whether tones are told apart by colour, `axes` whether the signs of the axes are looked at, too. The
    device is asked for the points only; while it is, others wait for it.
    """
    with kernels.asking(device):
        points = choose_points(lf, disparity, kernels, device, most=_QUICK_POINTS)
        if len(points.x) < _FEWEST:
            return None
    wrong = _signs(lf, disparity, points) if axes else None
    cameras = _cameras(lf, points, steps=_QUICK_STEPS, colours=colours)
    moved = tuple(_placement(lf, cameras)) if wrong is None else ()
    findings = (*moved, *_brightness(lf, cameras)) if wrong is None else (SIGNS[wrong],)
    turned = np.deg2rad(cameras["rotation"])
    return Look(findings, moved, cameras["shift"], turned, cameras["scale"], cameras["gain"], cameras["offset"])


def array_wide(lf: LightField, points: Points) -> tuple[str, ...]:
    """What stands out about the cameras at some points, those findings left out that are about single views."""
    cameras = _cameras(lf, points, steps=_QUICK_STEPS, colours=False)
    return (*_placement(lf, cameras, single=False), *_brightness(lf, cameras, single=False))


def part_of(lf: LightField, *, views: int, pixels: int) -> tuple[LightField, tuple[slice, slice]]:
    """A light field of at most so many of the views, and of their middle with at most so many pixels in all; and which
    rows and columns these are.

    The reference is among the views; the others are drawn, the same in every run, so that any fault that many views
    have is found in them.
    """
    others = np.flatnonzero(np.arange(len(lf.views)) != lf.reference_index)
    drawn = np.random.default_rng(0).permutation(others)[: views - 1]
    chosen = [int(n) for n in np.sort(np.append(drawn, lf.reference_index))]
    height, width = lf.size
    share = min(1.0, float(np.sqrt(pixels / (len(chosen) * height * width))))
    rows, columns = (max(1, round(side * share)) for side in lf.size)
    top, left = (height - rows) // 2, (width - columns) // 2
    window = slice(top, top + rows), slice(left, left + columns)
    part = lf if share == 1 else lf.crop(*window)  # first, so that of mapped views little is read
    return (part if len(chosen) == len(lf.views) else part.subset(chosen)), window


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
    kernels = load(backend)
    device = pick_device(kernels, device)
    others = np.array([n for n in range(len(lf.views)) if n != lf.reference_index])
    for first in range(0, len(others), _AT_ONCE):
        chosen = others[first : first + _AT_ONCE]
        for view, covered, n in zip(*predict(lf, disparity, chosen, kernels, device), chosen, strict=True):
            if lf.valid is not None:
                covered &= lf.valid[n]
            yield int(n), np.where(covered[..., None], lf.image(int(n)) - view, np.float32(np.nan))


def predict(
    lf: LightField,
    disparity: NDArray[np.floating[Any]],
    chosen: NDArray[np.intp],
    kernels: KernelSet,
    device: str,
) -> tuple[Float32Array, NDArray[np.bool_]]:
    """What the reference and its map predict of some views: [k, y, x, c] in [0, 1], and where they do, [k, y, x]."""
    known = np.isfinite(disparity)
    if lf.valid is not None:
        known &= lf.valid[lf.reference_index]
    # What is not known lands outside every view: at a disparity that moves it out of the frame in all directions.
    far = float(disparity[known].min()) if known.any() else 0.0
    map_ = kernels.field(np.where(known, disparity, far), device)
    image = lf.image(lf.reference_index)
    shape = (len(chosen), *lf.size, lf.channels)
    views, coverage = kernels.zeros_image(shape, device, np.float32), kernels.zeros(shape[:3], device)
    offsets = kernels.field(lf.offsets[chosen], device)

    def splat(picture: NDArray[np.float32]) -> tuple[NDArray[Any], NDArray[Any]]:
        kernels.splat_z_buffered(
            kernels.image(picture, device),
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


def checked(lf: LightField, result: Any) -> NDArray[np.float32]:
    """The disparity of a result or map; LightFieldError if it is not one of the reference view, or says nothing."""
    disparity = np.asarray(getattr(result, "disparity", result), np.float32)
    position = getattr(result, "position", None)
    if disparity.shape != lf.size:
        raise LightFieldError(
            f"the map must be {lf.size[0]} x {lf.size[1]} as the views of {lf.name} are, found shape {disparity.shape}."
        )
    here = lf.positions[lf.reference_index]
    if position is not None and np.abs(here - position).max() > 1e-6:
        raise LightFieldError(
            f"the map belongs to the view at row {position[1]:g}, column {position[0]:g}, the reference of {lf.name} "
            f"is at row {here[1]:g}, column {here[0]:g}; give the light field with that reference."
        )
    if not np.isfinite(disparity).any():
        raise LightFieldError("the map is undefined everywhere; there is nothing to judge.")
    return disparity


def _errors(
    lf: LightField, disparity: NDArray[np.float32], kernels: KernelSet, device: str
) -> Iterator[tuple[int, NDArray[np.float32]]]:
    """Of each view but the reference its root mean square difference over colours from what is predicted, [y, x]; NaN
    where nothing is."""
    for n, residual in residual_pictures(lf, disparity, backend=backend_named(kernels.name), device=device):
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


SIGNS = {
    "v": "rows and columns of cameras are counted in opposite senses (one axis has the wrong sign): read it with "
    "--flip v, or with --flip u if near comes out as far.",
    "uv": "what the map takes for far hides what it takes for near (both axes have the wrong sign): read it with "
    "--flip uv.",
    "transposed": "rows of cameras are taken for columns: swap u and v of the positions.",
}


def _signs(lf: LightField, disparity: NDArray[np.float32], points: Points) -> str | None:
    known = disparity[np.isfinite(disparity)]
    found = signs.wrong_axis(lf, points, float(np.abs(np.percentile(known, [1, 99])).max()))
    if found is None and signs.near_and_far_swapped(lf, disparity):
        return "uv"
    return found


def _as_good_as_plane(
    lf: LightField,
    disparity: NDArray[np.float32],
    errors: list[tuple[int, NDArray[np.float32]]],
    kernels: KernelSet,
    device: str,
) -> bool:
    """Whether the map predicts no worse than its median would, if it is not flat itself."""
    known = disparity[np.isfinite(disparity)]
    middle = float(np.median(known))
    if np.percentile(known, 95) - np.percentile(known, 5) < 1.0 / np.hypot(*lf.offsets.T).max():
        return True
    order = np.argsort(-np.hypot(*lf.offsets.T), kind="stable")[:_AT_ONCE]
    chosen = np.array([n for n in order if n != lf.reference_index])
    flat, seen = predict(lf, np.full(lf.size, middle, np.float32), chosen, kernels, device)
    loss, by_plane, of = 0.0, 0.0, dict(errors)
    for view, covered, n in zip(flat, seen, chosen, strict=True):
        error = of[int(n)]
        both = covered & np.isfinite(error)
        loss += float(np.minimum(error[both], 0.2).sum())
        by_plane += float(np.minimum(np.sqrt(((view - lf.image(int(n))) ** 2).mean(axis=2))[both], 0.2).sum())
    return loss <= _WORSE * by_plane


def _cameras(lf: LightField, points: Points, *, steps: int = _STEPS, colours: bool = True) -> dict[str, Any]:
    """What is wrong with each camera, as fields of `Explanation`; without `colours` all have the tones of grey."""
    count, channels = len(lf.views), lf.channels
    if len(points.x) < _FEWEST:
        nothing, per_view = np.full(count, np.nan), np.full((count, 2), np.nan)
        tones = np.full((count, channels), np.nan)
        return {
            "shift": per_view, "shift_error": per_view, "rotation": nothing, "rotation_error": nothing,
            "scale": nothing, "scale_error": nothing, "gain": tones, "offset": tones, "brightness": nothing,
        }  # fmt: skip
    bundle = Bundle(lf, points)
    bundle.run(steps)
    radius = bundle.radius
    shift = consensus.without_gauge(bundle.warps[:, :2] * radius, lf.offsets)
    influence = bundle.influence
    moved = consensus.without_gauge(influence[:, :2] * radius, lf.offsets)
    shape = [consensus.without_slope(bundle.warps[:, k], lf.offsets) for k in (2, 3)]
    error = [np.sqrt((consensus.without_slope(influence[:, k], lf.offsets) ** 2).sum(1)) for k in (2, 3)]
    gain, tone_offset = bundle.tones[:, :1], bundle.tones[:, 1:]
    if colours:
        gain, tone_offset, _ = measure_tones(lf, bundle, vignetting=False)
    level = float(np.clip(np.median(bundle.brightness), 0.02, 1.0)) if len(points.x) else _LEVEL
    return {
        "shift": shift,
        "shift_error": np.sqrt((moved**2).sum(2)),
        "rotation": np.rad2deg(shape[0]),
        "rotation_error": np.rad2deg(error[0]),
        "scale": shape[1],
        "scale_error": error[1],
        "gain": gain,
        "offset": tone_offset,
        "brightness": (gain + tone_offset / level).mean(axis=1),
    }


def measure_tones(
    lf: LightField, bundle: Bundle, *, vignetting: bool
) -> tuple[Float64Array, Float64Array, Float64Array]:
    """Gain, offset and vignetting [n, c] of each view and colour, where the bundle says that it records the points."""
    found = []
    radius2 = bundle.squared_radii()
    for channel in range(lf.channels):
        looks = [bundle.look_up(n, channel) for n in range(len(lf.views))]
        shown, weight = (np.stack(parts) for parts in zip(*looks, strict=True))
        found.append(match_tones(shown, weight, radius2, lf.reference_index, vignetting=vignetting))
    gain, offset, falloff = (np.stack(parts, axis=1) for parts in zip(*found, strict=True))
    return gain, offset, falloff


def _sentences(lf: LightField, cameras: dict[str, Any]) -> list[str]:
    """What stands out, one sentence each."""
    return [*_placement(lf, cameras), *_brightness(lf, cameras)]


def _placement(lf: LightField, cameras: dict[str, Any], *, single: bool = True) -> list[str]:
    """What stands out about where cameras stand and look, of single ones if wished."""
    offsets, radius = lf.offsets, float(np.hypot(*lf.size)) / 2
    said = []
    shift = cameras["shift"]
    rest = consensus.smooth_rest(shift, offsets)
    rms = float(np.sqrt((rest**2).mean()))
    usual = consensus.usual_rest(rest)
    if usual > _OUT_OF_LINE:
        said.append(
            f"the views are out of line by {rms:.2g} px (rms along each axis); line them up with `lfgpu rectify "
            "--refine`."
        )
    elif single:
        moved = consensus.outliers(shift, offsets, cameras["shift_error"], least=_MOVED)
        said += _single(lf, moved, lambda n: f"{_direction(*rest[n])} where it should be", "line up")
    shape = np.stack([np.deg2rad(cameras["rotation"]), cameras["scale"]], axis=1) * radius
    errors = np.stack([np.deg2rad(cameras["rotation_error"]), cameras["scale_error"]], axis=1) * radius
    rest_shape = consensus.smooth_rest(shape, offsets)
    words = (("turned", "clockwise", "anticlockwise"), ("scaled", "larger", "smaller"))
    for k, (word, more, less) in enumerate(words):
        one = slice(k, k + 1)
        if consensus.usual_rest(rest_shape[:, one]) > _OUT_OF_SHAPE:
            size = float(np.sqrt((rest_shape[:, k] ** 2).mean())) / radius
            amount = f"{np.rad2deg(size):.2g} degrees" if k == 0 else f"{100 * size:.2g} %"
            said.append(
                f"the views are {word} against each other by {amount} (rms); line them up with `lfgpu rectify "
                "--refine`."
            )
            continue
        if not single:
            continue
        out = consensus.outliers(shape[:, one], offsets, errors[:, one], least=_TURNED)

        def amount_of(n: int, k: int = k, more: str = more, less: str = less) -> str:
            value = float(rest_shape[n, k]) / radius
            size = f"{abs(np.rad2deg(value)):.2g} degrees turned" if k == 0 else f"{100 * abs(value):.2g} %"
            return f"{size} {more if value > 0 else less}"

        said += _single(lf, out, amount_of, "line up")
    return said


def _brightness(lf: LightField, cameras: dict[str, Any], *, single: bool = True) -> list[str]:
    """What stands out about how bright views are, of single ones if wished."""
    offsets, said = lf.offsets, list[str]()
    bright = np.log(np.maximum(cameras["brightness"], 1e-3))[:, None]
    rest_bright = consensus.smooth_rest(bright, offsets)[:, 0]
    if consensus.usual_rest(rest_bright[:, None]) > _UNEQUAL:
        said.append(
            f"the views differ in brightness by {100 * float(np.sqrt((rest_bright**2).mean())):.2g} % (rms); equalise "
            "them with `lfgpu rectify --equalise`."
        )
    elif single:
        unequal = consensus.outliers(bright, offsets, np.zeros_like(bright), least=_BRIGHTER)
        said += _single(
            lf,
            unequal,
            lambda n: (
                f"{100 * abs(np.expm1(rest_bright[n])):.2g} % {'brighter' if rest_bright[n] > 0 else 'darker'} "
                "than its neighbours"
            ),
            "equalise",
        )
    return said


_REMEDY = {
    "line up": "line {it} up with `lfgpu rectify --refine`.",
    "equalise": "equalise {it} with `lfgpu rectify --equalise`.",
}


def _single(lf: LightField, chosen: NDArray[np.bool_], what: Any, remedy: str) -> list[str]:
    """A sentence that names the views that are chosen, the first few of them."""
    found = np.flatnonzero(chosen)
    if not len(found):
        return []
    named = "; ".join(
        f"the view at row {lf.positions[n, 1]:g}, column {lf.positions[n, 0]:g} is {what(int(n))}"
        for n in found[:_NAMED]
    )
    more = f"; and so are {len(found) - _NAMED} more" if len(found) > _NAMED else ""
    return [f"{named}{more}: {_REMEDY[remedy].format(it='it' if len(found) == 1 else 'them')}"]


def _direction(x: float, y: float) -> str:
    """A shift in words: "0.20 px to the right of and 0.11 px below"; small parts left out."""
    parts = []
    if abs(x) >= 0.25 * abs(y):
        parts.append(f"{abs(x):.2f} px to the {'right' if x > 0 else 'left'} of")
    if abs(y) >= 0.25 * abs(x):
        parts.append(f"{abs(y):.2f} px {'below' if y > 0 else 'above'}")
    return " and ".join(parts)
