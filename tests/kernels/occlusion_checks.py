"""The operations with occlusions: cases, their random inputs and checks."""

from dataclasses import dataclass
from types import SimpleNamespace

import checks
import numpy as np
import splat_checks
from checks import Desk, Operation, Outputs


@dataclass(frozen=True)
class OcclusionCase(splat_checks.SplatCase):
    """A splat case in which `sharpness` tells who hides whom."""

    sharpness: float = 4.0


OCCLUSION_CASES = (
    OcclusionCase("colour float32"),
    OcclusionCase("grey float32", channels=1),
    OcclusionCase("one pixel wide", size=(13, 1)),
    OcclusionCase("one pixel high", size=(1, 13), channels=1),
    OcclusionCase("one pixel", size=(1, 1)),
    OcclusionCase("two by two", size=(2, 2), channels=1),
    OcclusionCase("one row of views", offsets=checks.grid(1, 5)),
    OcclusionCase("one column of views", offsets=checks.grid(5, 1)),
    OcclusionCase("one view without offset", offsets=((0.0, 0.0),)),
    OcclusionCase("irregular offsets", offsets=checks.IRREGULAR),
    OcclusionCase("many on one", disparities=(-6.0, 6.0), sharpness=1.0),
    OcclusionCase("nearest only", disparities=(-6.0, 6.0), sharpness=40.0),
    OcclusionCase("plain mean", sharpness=0.0),
    OcclusionCase("sharpest", disparities=(-50.0, 50.0), sharpness=1000.0, size=(23, 26)),
    OcclusionCase("sharpest within reach", sharpness=1000.0),
    OcclusionCase("all out of the frame", disparities=(20.0, 40.0), offsets=((1.0, 0.0), (-1.0, 1.0), (0.0, -2.0))),
    OcclusionCase("whole disparities", disparities=(2.0, 2.0), channels=1),
    OcclusionCase("sharp tent", softness=2.0**-6),
    OcclusionCase("softest tent", softness=0.5, channels=1),
    OcclusionCase("arbitrary numbers", softness=0.1, exact=False, offsets=((0.31, -1.2), (1.7, 0.9)), sharpness=2.0),
    OcclusionCase("work for several threads", size=(47, 38), offsets=checks.grid(3, 6)),
)


def occlusion_inputs(case: OcclusionCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random inputs of all operations with occlusions."""
    i = splat_checks.splat_inputs(case, rng)
    i.sharpness = case.sharpness
    return i


def splat_z_buffered(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"views": desk.image_out(i.views.shape), "coverage": desk.out(i.views.shape[:3])}
    desk.kernels.splat_z_buffered(
        desk.image(i.image),
        desk.field(i.disparity),
        desk.field(i.offsets),
        softness=i.softness,
        sharpness=i.sharpness,
        views_out=out["views"],
        coverage_out=out["coverage"],
    )
    return out


SPLAT = Operation(splat_z_buffered, "occlusion")
OPERATIONS = (SPLAT,)
