"""Whether a map may be wrong everywhere: the range that somebody gave leaves the scene out, or there is no scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lfgpu.contract import Device, Float32Array
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range

_LEAST = 0.25  # share of the range that the views show; the found one has margins, and outliers may widen it
_NOTHING = 0.1  # the most confidence where views show nothing
_UNSURE = 95  # per cent of the pixels: a map is doubted if so many are not more confident than that

_AT_END = 0.01  # share of the pixels at one end of the range from which on it may be too small
_END = 1e-3  # of the width of the range: what is so near to an end lies at it
_SAMPLES = 128  # along each side of a map

_SHOW_NOTHING = (
    "Nowhere do the views look alike at one disparity only: they are noise, have no texture, or do not belong together."
)


@dataclass(frozen=True)
class Doubt:
    """Why a map within a given range may be wrong everywhere."""

    note: str
    """A sentence."""
    is_of_nothing: bool = False
    """Whether the views show no disparity at all."""


def shows_nothing(lf: LightField, device: Device) -> str | None:
    """A sentence if the views show no disparity at all; else None."""
    try:
        find_disparity_range(lf, device)
    except LightFieldError:
        return _SHOW_NOTHING
    return None


def doubt_about(lf: LightField, given: tuple[float, float] | None, device: Device) -> Doubt | None:
    """What is to be said against a given range, pixels per view step; None if nothing is, or none was given.

    No map says so by itself: within a wrong range some disparity is the best everywhere, often with confidence.
    """
    if given is None:  # then the range is found, or the light field is refused
        return None
    try:
        low, high = find_disparity_range(lf, device)
    except LightFieldError:
        return Doubt(f"{_SHOW_NOTHING} The map means nothing.", is_of_nothing=True)
    shared = min(high, given[1]) - max(low, given[0])
    if shared >= _LEAST * min(high - low, given[1] - given[0]):
        return None
    return Doubt(
        f"The views show disparities from {low:.2f} to {high:.2f} px per view step, which the given range from "
        f"{given[0]:.2f} to {given[1]:.2f} mostly excludes: the map may be wrong everywhere, whatever its confidence; "
        "leave the range out, or widen it."
    )


def at_ends(disparity: Float32Array, bounds: tuple[float, float]) -> dict[str, float]:
    """The shares of a map's pixels that lie at the "far" and at the "near" end of the range, where they are many.

    Maps are clamped to the range, so surfaces beyond it lie exactly at one of its ends. In a range that holds the scene
    hardly any pixel does.
    """
    samples, (low, high) = _sampled(disparity), bounds
    close = _END * (high - low)
    shares = {"far": float((samples <= low + close).mean()), "near": float((samples >= high - close).mean())}
    return {end: share for end, share in shares.items() if share >= _AT_END}


def notes_of(disparity: Float32Array, confidence: Float32Array, bounds: tuple[float, float]) -> tuple[str, ...]:
    """Sentences about what a map itself says against it: it goes on beyond its range, or is sure of nothing."""
    low, high = bounds
    found = [
        f"The disparity range from {low:.3g} to {high:.3g} px per view step may be too small: {100 * share:.0f} % of "
        f"the map lies at its {end} end; move that end further out."
        for end, share in at_ends(disparity, bounds).items()
    ]
    known = _sampled(confidence)[np.isfinite(_sampled(disparity))]
    if known.size and np.percentile(known, _UNSURE) <= _NOTHING:
        found.append(
            f"The confidence is at most {_NOTHING:g} at {_UNSURE} % of the pixels: the views may not belong together "
            "or show too little, or the range may leave the scene out."
        )
    return tuple(found)


def with_notes_anew(result: DepthResult) -> DepthResult:
    """A result whose confidence has changed, with what its map says against itself now."""
    found = notes_of(result.disparity, result.confidence, result.disparity_range)
    return replace(result, notes=(*result.notes, *(note for note in found if note not in result.notes)))


def _sampled(values: Float32Array) -> Float32Array:
    return values[:: max(1, values.shape[0] // _SAMPLES), :: max(1, values.shape[1] // _SAMPLES)]


def doubted(result: DepthResult, doubt: Doubt | None) -> DepthResult:
    """A result with a note of what is to be said against it. Where views show nothing, it is not confident, either."""
    if doubt is None:
        return result
    if not doubt.is_of_nothing:
        return replace(result, notes=(doubt.note, *result.notes))
    result = replace(result, notes=(doubt.note,))  # what else the map says against itself means nothing, either
    low, high = result.disparity_range
    unknown = np.float32((high - low) / math.sqrt(12))  # of a number that may be any in the range
    return replace(
        result,
        confidence=np.minimum(result.confidence, np.float32(_NOTHING)),
        uncertainty=None if result.uncertainty is None else np.maximum(result.uncertainty, unknown),
    )
