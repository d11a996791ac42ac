"""The cases of the operations with occlusions, as data, and the random inputs that are made of them."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import cases
import numpy as np
import splat_cases
from numpy.typing import NDArray

from lfgpu._backends import load
from lfgpu.contract import Loss

REFERENCE = load("reference")
LOSSES: tuple[Loss, ...] = ("squares", "charbonnier", "geman-mcclure")
TOLERANCE = 0.25 + 2.0**-13
"""Of what is seen; between the numbers that disparities are, which are whole multiples of 2⁻¹⁰."""


@dataclass(frozen=True)
class OcclusionCase(splat_cases.SplatCase):
    """A splat case in which `sharpness` tells who hides whom, and a loss with its scale."""

    sharpness: float = 4.0
    loss: Loss = "squares"
    loss_scale: float = 0.25


OCCLUSION_CASES = (
    OcclusionCase("colour float32"),
    OcclusionCase("grey float32", channels=1, loss="charbonnier"),
    OcclusionCase("colour uint8 masked", dtype="uint8", size=(12, 9), masked=True, loss="geman-mcclure"),
    OcclusionCase("grey uint16 masked", channels=1, dtype="uint16", masked=True, loss="charbonnier"),
    OcclusionCase("grey geman-mcclure", channels=1, loss="geman-mcclure"),
    OcclusionCase("colour float16 masked", dtype="float16", masked=True, loss="charbonnier", loss_scale=0.02),
    OcclusionCase("large scale of loss", loss="geman-mcclure", loss_scale=8.0),
    OcclusionCase("one pixel wide", size=(13, 1)),
    OcclusionCase("one pixel high", size=(1, 13), channels=1, loss="geman-mcclure"),
    OcclusionCase("one pixel", size=(1, 1)),
    OcclusionCase("two by two", size=(2, 2), channels=1, masked=True),
    OcclusionCase("one row of views", offsets=cases.grid(1, 5), loss="charbonnier"),
    OcclusionCase("one column of views", offsets=cases.grid(5, 1)),
    OcclusionCase("one view without offset", offsets=((0.0, 0.0),)),
    OcclusionCase("irregular offsets", offsets=cases.IRREGULAR, masked=True),
    OcclusionCase("many on one", disparities=(-6.0, 6.0), sharpness=1.0, loss="charbonnier"),
    OcclusionCase("nearest only", disparities=(-6.0, 6.0), sharpness=40.0),
    OcclusionCase("plain mean", sharpness=0.0),
    OcclusionCase("sharpest", disparities=(-50.0, 50.0), sharpness=1000.0, size=(23, 26)),
    OcclusionCase("sharpest within reach", sharpness=1000.0, loss="geman-mcclure", masked=True),
    OcclusionCase("all out of the frame", disparities=(20.0, 40.0), offsets=((1.0, 0.0), (-1.0, 1.0), (0.0, -2.0))),
    OcclusionCase("whole disparities", disparities=(2.0, 2.0), channels=1),
    OcclusionCase("sharp tent", softness=2.0**-6),
    OcclusionCase("softest tent", softness=0.5, channels=1, loss="charbonnier"),
    OcclusionCase("arbitrary numbers", softness=0.1, exact=False, offsets=((0.31, -1.2), (1.7, 0.9)), sharpness=2.0),
    OcclusionCase("work for several threads", size=(47, 38), offsets=cases.grid(3, 6), masked=True, dtype="uint8"),
)


def occlusion_inputs(case: OcclusionCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random inputs of all operations with occlusions; no pixel's coverage is near the least that counts."""
    return with_loss(splat_cases.splat_inputs(case, rng), case)


def with_loss(i: SimpleNamespace, case: OcclusionCase) -> SimpleNamespace:
    """The inputs of a splat and what occlusions need besides."""
    i.sharpness, i.loss, i.loss_scale, i.tolerance, i.exact = (
        case.sharpness,
        case.loss,
        case.loss_scale,
        TOLERANCE,
        case.exact,
    )
    i.least_coverage = far_from_any(coverage_of(i), 0.3, 0.6)
    return i


def coverage_of(i: SimpleNamespace) -> NDArray[Any]:
    """What lands on each pixel of each view, as the plain splat of the reference says."""
    views, coverage = np.empty(i.recorded.shape), np.empty(i.recorded.shape[:3])
    image, disparity, offsets = (a.astype(np.float64) for a in (i.image, i.disparity, i.offsets))
    REFERENCE.splat(image, disparity, offsets, softness=i.softness, views_out=views, coverage_out=coverage)
    return coverage


def far_from_any(values: NDArray[Any], low: float, high: float) -> float:
    """The middle of the widest gap between values in [low, high]: who lies on which side of it is beyond doubt."""
    inside = np.sort(np.concatenate([[low, high], values[(values > low) & (values < high)]]))
    widest = int(np.diff(inside).argmax())
    assert inside[widest + 1] - inside[widest] > 2e-5, "values are too many to be told apart in float32"
    return float(inside[widest] + inside[widest + 1]) / 2
