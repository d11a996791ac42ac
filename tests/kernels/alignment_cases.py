"""The cases of what comes near in each view, of the alignment, of ratios and of outlines, as data, and their inputs."""

from dataclasses import dataclass
from types import SimpleNamespace

import cases
import nlm_cases
import numpy as np
import splat_cases

TOLERANCE = 0.25 + 2.0**-13
"""Of what is seen; between the numbers that disparities are, which are whole multiples of 2⁻¹⁰."""


@dataclass(frozen=True)
class AlignmentCase(splat_cases.SplatCase):
    """A splat case, how much differences count, beside which steps they count less, and what agrees and hides."""

    gradient_weight: float = 2.0
    contrast: float = 0.5
    robust: float = 0.25
    reach: int = 1


ALIGNMENT_CASES = (
    AlignmentCase("colour float32"),
    AlignmentCase("grey float32", channels=1, reach=0),
    AlignmentCase("colour uint8 masked", dtype="uint8", size=(12, 9), masked=True),
    AlignmentCase("grey uint8", channels=1, dtype="uint8", reach=2),
    AlignmentCase("grey uint16 masked", channels=1, dtype="uint16", masked=True),
    AlignmentCase("colour uint16", dtype="uint16", robust=1.0),
    AlignmentCase("colour float16 masked", dtype="float16", masked=True, reach=0),
    AlignmentCase("grey float16", channels=1, dtype="float16"),
    AlignmentCase("one pixel wide", size=(13, 1)),
    AlignmentCase("one pixel high", size=(1, 13), channels=1, reach=3),
    AlignmentCase("surfaces that reach as far as they may", size=(7, 260), channels=1, reach=100),
    AlignmentCase("one pixel", size=(1, 1), disparities=(-0.25, 0.25)),
    AlignmentCase("two by two", size=(2, 2), channels=1, masked=True),
    AlignmentCase("one row of views", offsets=cases.grid(1, 5)),
    AlignmentCase("one column of views", offsets=cases.grid(5, 1), dtype="uint8"),
    AlignmentCase("no other view", offsets=((0.0, 0.0),)),
    AlignmentCase("irregular offsets", offsets=cases.IRREGULAR, masked=True),
    AlignmentCase("next to the reference", offsets=((2.0**-11, 0.0), (2.0**-9, 0.0), (1.0, 0.5))),
    AlignmentCase("partly out of the frame", disparities=(-9.0, 9.0), reach=0),
    AlignmentCase("all out of the frame", disparities=(20.0, 40.0), offsets=((1.0, 0.0), (-1.0, 1.0), (0.0, -2.0))),
    AlignmentCase("whole disparities", disparities=(2.0, 2.0)),
    AlignmentCase("gradients count beside steps, too", contrast=8.0),
    AlignmentCase("gradients count nowhere but on plain surfaces", channels=1, contrast=2.0**-6),
    AlignmentCase("colours only", gradient_weight=0.0, dtype="uint8"),
    AlignmentCase("arbitrary numbers", exact=False, offsets=((0.31, -1.2), (1.7, 0.9))),
    AlignmentCase("work for several threads", size=(47, 138), offsets=cases.grid(3, 6), masked=True, dtype="uint8"),
)


def alignment_inputs(case: AlignmentCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random views, some of whose pixels are as in the reference, and surfaces in front of some of what is seen.

    Many disparities are whole or half, so that places lie on the edges of pixels and of the frame.
    """
    i = splat_cases.splat_inputs(case, rng)
    if case.exact:
        i.disparity = np.where(rng.random(case.size) < 0.4, np.round(2 * i.disparity) / 2, i.disparity)
    alike = rng.random(i.recorded.shape[:3]) < 0.3
    exact = np.broadcast_to(cases.stored(i.image.astype(np.float64), case.dtype), i.recorded.shape)
    i.recorded = np.where(alike[..., None], exact, i.recorded)
    places = rng.uniform(*case.disparities, i.recorded.shape[:3])
    behind = rng.random(places.shape) < 0.3
    i.nearest = np.where(behind, -1e6, np.round(places * 2**10) / 2**10).astype(np.float32)
    i.gradient_weight, i.contrast = case.gradient_weight, case.contrast
    i.robust, i.tolerance = case.robust, TOLERANCE
    i.reach, i.exact = case.reach, case.exact
    return i


@dataclass(frozen=True)
class RatioCase(nlm_cases.NlmCase):
    """The window of weights, and how near the guide must be and what is added to denominators."""

    support: float = 0.25
    least: float = 0.125
    ridge: float = 1.0


RATIO_CASES = (
    RatioCase("default"),
    RatioCase("window of the method", window=9, size=(17, 19)),
    RatioCase("wide support", support=20.0),
    RatioCase("narrow support", support=2.0**-6, least=1e-3),
    RatioCase("hardly any ridge", ridge=0.125),
    RatioCase("one pixel wide", size=(13, 1)),
    RatioCase("one pixel high", size=(1, 13)),
    RatioCase("one pixel", size=(1, 1)),
    RatioCase("window wider than image", size=(4, 3), window=11),
    RatioCase("work for several threads", size=(61, 153), window=7),
)


def ratio_inputs(case: RatioCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random weights, two surfaces as a guide, numerators of both signs, and denominators, some of which are 0."""
    i = nlm_cases.nlm_inputs(case, rng)
    surfaces = rng.uniform(-0.1, 0.1, case.size) + (rng.random(case.size) < 0.5)
    i.guide = surfaces.astype(np.float32)
    denominator = rng.random(case.size) * (rng.random(case.size) < 0.7)
    i.denominator = denominator.astype(np.float32)
    i.options = {"window": case.window, "support": case.support, "floor": case.least}
    i.ridge = case.ridge
    return i


@dataclass(frozen=True)
class OutlineCase:
    """An image size, and what tells surfaces and their colours apart."""

    name: str
    size: tuple[int, int] = (13, 14)
    channels: int = 3
    step: float = 0.3125
    contrast: float = 0.0625
    share: float = 0.4
    tolerance: float = 1e-5

    def __str__(self) -> str:
        return self.name


OUTLINE_CASES = (
    OutlineCase("colour"),
    OutlineCase("grey", channels=1),
    OutlineCase("hardly any step", step=2.0**-6),
    OutlineCase("large step", step=0.8125, size=(17, 19)),
    OutlineCase("any contrast", contrast=1e-4, share=0.9),
    OutlineCase("much contrast", contrast=0.4),
    OutlineCase("no share", share=0.0, channels=1),
    OutlineCase("one pixel wide", size=(23, 1)),
    OutlineCase("one pixel high", size=(1, 23), channels=1),
    OutlineCase("one pixel", size=(1, 1)),
    OutlineCase("work for several threads", size=(61, 53)),
)


def outline_inputs(case: OutlineCase, rng: np.random.Generator) -> SimpleNamespace:
    """Surfaces that are larger than a window here and there, in front of each other, and random colours.

    Disparities are whole multiples of 2⁻⁴, so that no rounding decides which surface a pixel is of.
    """
    height, width = case.size
    coarse = rng.integers(-2, 3, (-(-height // 5), -(-width // 5)))
    surfaces = np.kron(coarse, np.ones((5, 5)))[:height, :width] / 2
    moved = (rng.random(case.size) < 0.1) * rng.integers(-8, 9, case.size) / 16
    image = rng.random((*case.size, case.channels)) * 0.5 + 0.25 * (surfaces[..., None] + 1)
    return SimpleNamespace(
        image=image.astype(np.float32),
        disparity=(surfaces + moved).astype(np.float32),
        options={"step": case.step, "contrast": case.contrast, "share": case.share},
    )
