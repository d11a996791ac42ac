"""A quick look at the cameras: how each view is moved, turned, scaled and brightened, told at points with texture.

`explain` does the same with more points, and predicts the views as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendName, open_device
from lfgpu.calibration import consensus, signs
from lfgpu.calibration.bundle import Bundle, Points, choose_points
from lfgpu.calibration.findings import SIGNS, brightness, placement
from lfgpu.calibration.tones import match_tones
from lfgpu.contract import Device, Float64Array
from lfgpu.data.light_field_checks import array_of_numbers
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError

if TYPE_CHECKING:
    from lfgpu.data.result import DepthResult, DisparityMap

FEWEST = 50
"""Points with texture: from fewer no camera is told."""

_STEPS = 5  # Gauss-Newton steps of the cameras
_QUICK_POINTS, _QUICK_STEPS = 2000, 3
_LEVEL = 0.5  # intensity at which brightness is compared where views tell nothing else


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
    found = look(lf, disparity, open_device(backend, device), colours=False)
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
    device: Device,
    *,
    colours: bool = True,
    axes: bool = True,
) -> Look | None:
    """A quick look at the cameras with the map of the reference view [y, x]; None where texture is too little.

    `colours` says whether tones are told apart by colour, `axes` whether the signs of the axes are looked at, too. The
    device is asked for the points only; while it is, others wait for it.
    """
    with device.asking():
        points = choose_points(lf, disparity, device, most=_QUICK_POINTS)
        if len(points.x) < FEWEST:
            return None
    wrong = signs_of(lf, disparity, points) if axes else None
    cameras = cameras_of(lf, points, steps=_QUICK_STEPS, colours=colours)
    moved = tuple(placement(lf, cameras)) if wrong is None else ()
    findings = (*moved, *brightness(lf, cameras)) if wrong is None else (SIGNS[wrong],)
    turned = np.deg2rad(cameras["rotation"])
    return Look(findings, moved, cameras["shift"], turned, cameras["scale"], cameras["gain"], cameras["offset"])


def array_wide(lf: LightField, points: Points) -> tuple[str, ...]:
    """What stands out about the cameras at some points, those findings left out that are about single views."""
    cameras = cameras_of(lf, points, steps=_QUICK_STEPS, colours=False)
    return (*placement(lf, cameras, single=False), *brightness(lf, cameras, single=False))


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


# --- steps ---


def checked(lf: LightField, result: Any) -> NDArray[np.float32]:
    """The disparity of a result or map; LightFieldError if it is not one of the reference view, or says nothing."""
    disparity = array_of_numbers("result", getattr(result, "disparity", result), np.float32)
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


def signs_of(lf: LightField, disparity: NDArray[np.float32], points: Points) -> str | None:
    known = disparity[np.isfinite(disparity)]
    found = signs.wrong_axis(lf, points, float(np.abs(np.percentile(known, [1, 99])).max()))
    if found is None and signs.near_and_far_swapped(lf, disparity):
        return "uv"
    return found


def cameras_of(lf: LightField, points: Points, *, steps: int = _STEPS, colours: bool = True) -> dict[str, Any]:
    """What is wrong with each camera, as fields of `Explanation`; without `colours` all have the tones of grey."""
    count, channels = len(lf.views), lf.channels
    if len(points.x) < FEWEST:
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


__all__ = [
    "FEWEST",
    "Look",
    "array_wide",
    "cameras_of",
    "checked",
    "look",
    "measure_tones",
    "part_of",
    "remarks",
    "signs_of",
]
