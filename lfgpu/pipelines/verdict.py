"""Verdict on a map: notes on its range and its evidence, remarks on its cameras, and the confidence that follows.

Estimates, tiles, all views, batches, the command line and the viewer get it here, so that they say the same in the same
order. Notes: the views show nothing, or the given range excludes them; the range is so wide that few of its disparities
are compared; surfaces may lie beyond the range that was found (`lfgpu/pipelines/range_confirmation.py`); the map lies
at an end of its range; it is confident nowhere. A pipeline that runs on many frames says of each the notes that its map
alone gives (`map_notes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import DEFAULT, BackendName, open_device
from lfgpu.cameras.looking import Look, checked_map, look, seen_views
from lfgpu.cameras.points import Windows
from lfgpu.cameras.trust import trusted
from lfgpu.config import Config
from lfgpu.contract import Device, Float32Array, Float64Array
from lfgpu.data import DepthResult, LightField
from lfgpu.data.layout import in_pattern
from lfgpu.data.lightfield import check_light_field
from lfgpu.data.result import check_result
from lfgpu.errors import LightFieldError
from lfgpu.io.brightness import ask_for_white
from lfgpu.io.contradictions import no_parallax
from lfgpu.methods import method_of
from lfgpu.methods.disparity_range import find_disparity_range
from lfgpu.methods.measured import checked_range

MANY = 0.01
"""Share of the pixels at one end of a range from which on surfaces may lie beyond it."""

_END = 1e-3  # of the width of the range: distance from an end within which a pixel of a finished map lies at it
_LEAST_SHARED = 0.25  # of the narrower range; the found one has margins, and outliers may widen it
_NOTHING = 0.1  # the most confidence where views show nothing
_UNSURE = 0.95  # of the pixels: a map is doubted if so many are not more confident than that
_NEAREST = 0.9  # view steps: where all cameras stand nearer, positions have another unit, and tuned numbers do not hold
_SAMPLES = 128  # along each side of a map

_SHOW_NOTHING = (
    "Nowhere do the views look alike at one disparity only: they are noise, have no texture, or do not belong together."
)


@dataclass(frozen=True)
class Verdict:
    """Verdict of the views on the maps of a light field, whichever view these are of."""

    note: str | None = None  # sentence against the given range, or about views that show nothing
    shows_nothing: bool = False  # the views show no disparity at all
    cameras: Look | None = None  # None if nothing can be wrong, there is a `note`, or nobody looked

    def on(self, lf: LightField, result: DepthResult) -> DepthResult:
        """Add the notes and remarks to a result of the reference view of `lf`, and lower its confidence accordingly."""
        asked = ask_for_white(lf)
        if self.shows_nothing:  # then the map's own notes mean nothing
            low, high = result.disparity_range
            unknown = np.float32((high - low) / math.sqrt(12))  # of a number that may be any in the range
            return replace(
                result,
                confidence=np.minimum(result.confidence, np.float32(_NOTHING)),
                uncertainty=None if result.uncertainty is None else np.maximum(result.uncertainty, unknown),
                notes=tuple(filter(None, [asked, self.note])),
            )
        if self.cameras is not None:
            result = trusted(lf, result, self.cameras)
        own = map_notes(result.disparity, result.confidence, result.disparity_range)
        coarse = method_of(result.config).doubt(lf.layout, result.disparity_range)
        unit = None
        if (farthest := float(np.hypot(*lf.offsets.T).max())) < _NEAREST:
            unit = (
                f"The farthest camera stands {farthest:.2g} view steps from the reference, so the map and its "
                "confidence may be wrong: positions are in units of the distance of neighbours, which is baseline_m."
            )
        said = dict.fromkeys((asked, self.note, unit, coarse, *result.notes))
        earlier = [note for note in said if note is not None and note not in own]
        return replace(result, notes=(*earlier, *own))


def judged(
    lf: LightField,
    result: DepthResult,
    *,
    disparity_range: tuple[float, float] | None = None,
    backend: BackendName = DEFAULT,
    device: str | None = None,
    check_cameras: bool = True,
    in_part: bool = False,
) -> DepthResult:
    """Judge a map by the views: its range and its cameras. `estimate_depth` does it; a pipeline leaves it to you.

    Parameters
    ----------
    lf
        The light field.
    result
        A result of its reference view.
    disparity_range
        (low, high) that was given for the estimate, pixels per view step. Default None: the range was found.
    backend, device
        As for `estimate_depth`.
    check_cameras
        Look at the cameras. It takes a fraction of a second where nothing can be wrong, and a few seconds else. Default
        True.
    in_part
        Look at 33 views at most, and at their middle only, 4 million pixels in all. Default False: at all views that
        the map is made from, and at 25 at least.

    Returns
    -------
    The result with `notes` on the range and the evidence and `remarks` on the cameras. Its confidence is lower, and its
    uncertainty larger, if the views show nothing or the cameras are out of line (`lfgpu/cameras/looking.py`).

    Raises
    ------
    LightFieldError
        If the map has another size, or belongs to another view, or the range is wrong.
    BackendError
        If the backend or the device is missing.

    Examples
    --------
    >>> lfgpu.judged(lf, result).remarks
    ()
    """
    check_light_field(lf)
    check_result(result)
    options = {"disparity_range": disparity_range, "check_cameras": check_cameras, "in_part": in_part}
    return judged_on(lf, result, open_device(backend, device), **options)


def judged_on(lf: LightField, result: DepthResult, device: Device, **options: Any) -> DepthResult:
    """Judge a map on a device as `judged` does, unchecked; `options` are further keywords of `verdict_of`."""
    seen = seen_views(lf.offsets, method_of(result.config).used_views(lf.offsets))
    return verdict_of(lf, result, device, seen=seen, **options).on(lf, result)


def needed_views(config: Config, pattern: str = "full") -> Callable[[Float64Array], NDArray[np.intp]]:
    """Return the rule for `lfgpu.read` that chooses the views of a pattern that an estimate and its verdict need."""

    def rule(offsets: Float64Array) -> NDArray[np.intp]:
        kept = np.flatnonzero(in_pattern(offsets, pattern))
        return kept[seen_views(offsets[kept], method_of(config).used_views(offsets[kept]))]

    return rule


def verdict_of(
    lf: LightField,
    result: DepthResult,
    device: Device,
    *,
    disparity_range: tuple[float, float] | None,
    check_cameras: bool = True,
    seen: NDArray[np.intp] | None = None,
    in_part: bool = False,
    windows: Windows | None = None,
) -> Verdict:
    """Judge a light field by a result of its reference view, the cameras by the views `seen`, by default all.

    Other parameters, and the errors, are those of `judged`; `windows` are for `look`.
    """
    if (still := no_parallax(lf)) is not None:
        return Verdict(f"{still} The map means nothing.", shows_nothing=True)
    found = _on_range(lf, disparity_range, device)
    if found.note is not None or not check_cameras or not np.isfinite(result.disparity).any():
        return found  # by a map that is wrong everywhere, right cameras look askew
    disparity = checked_map(lf, result)
    cameras = look(lf, disparity, device, budget="screen", seen=seen, in_part=in_part, windows=windows)
    return replace(found, cameras=cameras)


def views_alone(lf: LightField, device: Device) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Judge a light field without a map: notes on the views, and remarks on all cameras together."""
    if no_parallax(lf) is not None:  # which its own notes say
        return (), ()
    try:
        find_disparity_range(lf, device)
    except LightFieldError:
        return (_SHOW_NOTHING,), ()
    found = look(lf, None, device, budget="screen")
    return (), () if found is None else found.findings


def _on_range(lf: LightField, given: tuple[float, float] | None, device: Device) -> Verdict:
    """Compare a given range with the range that the views show.

    No map tells by itself: within a wrong range some disparity is the best everywhere, often with confidence. If the
    range was found, there is nothing to compare: views that show nothing were refused.
    """
    if given is None:
        return Verdict()
    given = checked_range(given, lf.layout)
    try:
        low, high = find_disparity_range(lf, device)
    except LightFieldError:
        return Verdict(f"{_SHOW_NOTHING} The map means nothing.", shows_nothing=True)
    shared = min(high, given[1]) - max(low, given[0])
    if shared >= _LEAST_SHARED * min(high - low, given[1] - given[0]):
        return Verdict()
    return Verdict(
        f"The views show disparities from {low:.2f} to {high:.2f} px per view step, which the given range from "
        f"{given[0]:.2f} to {given[1]:.2f} mostly excludes: the map may be wrong everywhere, whatever its confidence; "
        "leave the range out, or widen it."
    )


def map_notes(disparity: Float32Array, confidence: Float32Array, bounds: tuple[float, float]) -> tuple[str, ...]:
    """Judge a map [y, x] by itself: notes if it lies at an end of its range, or is confident nowhere."""
    low, high = bounds
    found = [
        f"The disparity range from {low:.3g} to {high:.3g} px per view step may be too small: {100 * share:.0f} % of "
        f"the map lies at its {end} end; move that end further out."
        for end, share in at_ends(disparity, bounds).items()
    ]
    known = _sampled(confidence)[np.isfinite(_sampled(disparity))]
    if known.size and (known <= _NOTHING).mean() >= _UNSURE:
        found.append(
            f"The confidence is at most {_NOTHING:g} at {100 * _UNSURE:.0f} % of the pixels: the views may not belong "
            "together or show too little, or the range may leave the scene out."
        )
    return tuple(found)


def at_ends(disparity: Float32Array, bounds: tuple[float, float]) -> dict[str, float]:
    """Measure the shares of a map's pixels at the "far" and at the "near" end of the range; small ones are left out.

    Maps are clamped to the range, so surfaces beyond it lie exactly at one of its ends. In a range that holds the scene
    hardly any pixel does.
    """
    samples, (low, high) = _sampled(disparity), bounds
    close = _END * (high - low)
    shares = {"far": float((samples <= low + close).mean()), "near": float((samples >= high - close).mean())}
    return {end: share for end, share in shares.items() if share >= MANY}


def _sampled(values: Float32Array) -> Float32Array:
    return values[:: max(1, values.shape[0] // _SAMPLES), :: max(1, values.shape[1] // _SAMPLES)]
