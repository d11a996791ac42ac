"""Whether a map may be wrong everywhere: the range that somebody gave leaves the scene out, or there is no scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from lfgpu.contract import KernelSet
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range

_LEAST = 0.25  # share of the range that the views show; the found one has margins, and outliers may widen it
_NOTHING = 0.1  # the most confidence where views show nothing

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


def shows_nothing(lf: LightField, kernels: KernelSet, device: str) -> str | None:
    """A sentence if the views show no disparity at all; else None."""
    try:
        find_disparity_range(lf, kernels, device)
    except LightFieldError:
        return _SHOW_NOTHING
    return None


def doubt_about(lf: LightField, given: tuple[float, float] | None, kernels: KernelSet, device: str) -> Doubt | None:
    """What is to be said against a given range, pixels per view step; None if nothing is, or none was given.

    No map says so by itself: within a wrong range some disparity is the best everywhere, often with confidence.
    """
    if given is None:  # then the range is found, or the light field is refused
        return None
    try:
        low, high = find_disparity_range(lf, kernels, device)
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


def doubted(result: DepthResult, doubt: Doubt | None) -> DepthResult:
    """A result with a note of what is to be said against it. Where views show nothing, it is not confident, either."""
    if doubt is None:
        return result
    result = replace(result, notes=(*result.notes, doubt.note))
    if not doubt.is_of_nothing:
        return result
    low, high = result.disparity_range
    unknown = np.float32((high - low) / math.sqrt(12))  # of a number that may be any in the range
    return replace(
        result,
        confidence=np.minimum(result.confidence, np.float32(_NOTHING)),
        uncertainty=None if result.uncertainty is None else np.maximum(result.uncertainty, unknown),
    )
