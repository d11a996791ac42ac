"""What comes near in each view, the alignment, ratios by weights, and outlines: cases, their inputs and checks."""

import itertools
from dataclasses import dataclass
from types import SimpleNamespace

import checks
import nlm_checks
import numpy as np
import splat_checks
import sweep_checks
from checks import Desk, Operation, Outputs, Values, largest_error, relative_to_terms, size

from lfgpu.kernels import reference as reference_package

TOLERANCE = 0.25 + 2.0**-13
"""Of what is seen; between the numbers that disparities are, which are whole multiples of 2⁻¹⁰."""


@dataclass(frozen=True)
class AlignmentCase(splat_checks.SplatCase):
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
    AlignmentCase("one row of views", offsets=checks.grid(1, 5)),
    AlignmentCase("one column of views", offsets=checks.grid(5, 1), dtype="uint8"),
    AlignmentCase("no other view", offsets=((0.0, 0.0),)),
    AlignmentCase("irregular offsets", offsets=checks.IRREGULAR, masked=True),
    AlignmentCase("next to the reference", offsets=((2.0**-11, 0.0), (2.0**-9, 0.0), (1.0, 0.5))),
    AlignmentCase("partly out of the frame", disparities=(-9.0, 9.0), reach=0),
    AlignmentCase("all out of the frame", disparities=(20.0, 40.0), offsets=((1.0, 0.0), (-1.0, 1.0), (0.0, -2.0))),
    AlignmentCase("whole disparities", disparities=(2.0, 2.0)),
    AlignmentCase("gradients count beside steps, too", contrast=8.0),
    AlignmentCase("gradients count nowhere but on plain surfaces", channels=1, contrast=2.0**-6),
    AlignmentCase("colours only", gradient_weight=0.0, dtype="uint8"),
    AlignmentCase("arbitrary numbers", exact=False, offsets=((0.31, -1.2), (1.7, 0.9))),
    AlignmentCase("work for several threads", size=(47, 138), offsets=checks.grid(3, 6), masked=True, dtype="uint8"),
)


def alignment_inputs(case: AlignmentCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random views, some of whose pixels are as in the reference, and surfaces in front of some of what is seen.

    Many disparities are whole or half, so that places lie on the edges of pixels and of the frame.
    """
    i = splat_checks.splat_inputs(case, rng)
    if case.exact:
        i.disparity = np.where(rng.random(case.size) < 0.4, np.round(2 * i.disparity) / 2, i.disparity)
    alike = rng.random(i.recorded.shape[:3]) < 0.3
    exact = np.broadcast_to(checks.stored(i.image.astype(np.float64), case.dtype), i.recorded.shape)
    i.recorded = np.where(alike[..., None], exact, i.recorded)
    places = rng.uniform(*case.disparities, i.recorded.shape[:3])
    behind = rng.random(places.shape) < 0.3
    i.nearest = np.where(behind, -1e6, np.round(places * 2**10) / 2**10).astype(np.float32)
    i.gradient_weight, i.contrast = case.gradient_weight, case.contrast
    i.robust, i.tolerance = case.robust, TOLERANCE
    i.reach, i.exact = case.reach, case.exact
    return i


@dataclass(frozen=True)
class RatioCase(nlm_checks.NlmCase):
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
    i = nlm_checks.nlm_inputs(case, rng)
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


reference = reference_package.KERNELS

CLEAR = 1e-4
"""Pixels: what is decided by less is left out of comparisons."""


def z_buffer(desk: Desk, i: SimpleNamespace) -> Outputs:
    """After that of another map, which leaves no trace where views are not left out."""
    count, height, width, _ = i.recorded.shape
    plan = desk.kernels.z_buffer((height, width), desk.device, reach=max(i.reach, 2))
    offsets, out = desk.field(i.offsets), desk.out((count, height, width))
    plan(desk.field(i.disparity[::-1, ::-1] + 1), offsets, out, reach=2)
    some = desk.out((count, height, width))
    plan(desk.field(i.disparity[::-1, ::-1] + 1), offsets, some, reach=2)
    plan(desk.field(i.disparity), desk.field(sweep_checks.every_other(i.offsets)), some, reach=i.reach)
    plan(desk.field(i.disparity), offsets, out, reach=i.reach)
    return {"nearest": out, "some": some}


def alignment(desk: Desk, i: SimpleNamespace) -> Outputs:
    """After that of another light field, and with another map, which leave no trace."""
    names = "scale", "gradient_weight", "contrast", "robust", "tolerance"
    shape, options = i.recorded.shape, {name: getattr(i, name) for name in names}
    plan = desk.kernels.alignment(shape, desk.field(i.offsets), **options)
    part = desk.kernels.alignment(shape, desk.field(sweep_checks.every_other(i.offsets)), **options, shared=plan)
    disparity, nearest = desk.field(i.disparity), desk.field(i.nearest)
    out = {name: desk.out(i.disparity.shape) for name in ("curvature", "slope")}
    of_some = {f"{name} of some": desk.out(i.disparity.shape) for name in out}
    other_mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    desk.load_within(plan, i.image[::-1] + 1, i.recorded[:, ::-1], other_mask)
    plan(disparity, nearest, *out.values())
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan(desk.field(i.disparity[::-1, ::-1]), nearest, *out.values())
    plan(disparity, nearest, *out.values())
    part(disparity, nearest, *of_some.values())
    return out | of_some


def nlm_ratio(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.guide.shape)
    fields = (desk.field(values) for values in (i.weights, i.guide, i.values, i.denominator))
    desk.kernels.nlm_ratio(*fields, **i.options, ratio_out=out)
    return {"ratio": out}


def nlm_plane(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.guide.shape)
    fields = (desk.field(values) for values in (i.weights, i.guide, i.denominator + i.options["floor"]))
    options = {name: i.options[name] for name in ("window", "support")}
    desk.kernels.nlm_plane(*fields, **options, ridge=i.ridge, plane_out=out)
    return {"plane": out}


def nlm_on_surface(desk: Desk, i: SimpleNamespace) -> Outputs:
    out, changed = desk.out(i.weights.shape), desk.kernels.field(i.weights, desk.device)
    options = {name: i.options[name] for name in ("window", "support")}
    for weights, weights_out in ((desk.field(i.weights), out), (changed, changed)):
        desk.kernels.nlm_on_surface(weights, desk.field(i.guide), **options, weights_out=weights_out)
    return {"weights": out, "in place": changed}


def refine_boundaries(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.disparity.shape)
    desk.kernels.refine_boundaries(desk.image(i.image), desk.field(i.disparity), **i.options, disparity_out=out)
    return {"disparity": out}


# --- which decisions are near: places as the contract says, in float64 ---


def places(i: SimpleNamespace) -> tuple[Values, Values]:
    """Columns and rows [n, y, x] where reference pixels land."""
    height, width = i.disparity.shape
    rows, columns = np.mgrid[:height, :width]
    d, (du, dv) = i.disparity.astype(np.float64), i.offsets.astype(np.float64).T[..., None, None]
    return columns - d * du, rows - d * dv


def near_a_rounding(i: SimpleNamespace) -> Values:
    """Where [n, y, x] a place is on the edge between two pixels, which the border of the frame is, too."""
    return np.any([np.abs(place + 0.5 - np.round(place + 0.5)) < CLEAR for place in places(i)], axis=0)


def near_a_decision(i: SimpleNamespace) -> Values:
    """Pixels [y, x] for which it is in doubt whether a view takes part."""
    height, width = i.disparity.shape
    x, y = places(i)
    border = np.any([np.abs(x - edge) < CLEAR for edge in (0, width - 1)], axis=0)
    border |= np.any([np.abs(y - edge) < CLEAR for edge in (0, height - 1)], axis=0)
    column, row = (np.floor(a + 0.5).astype(int).clip(0, side - 1) for a, side in ((x, width), (y, height)))
    front = i.nearest[np.arange(len(i.offsets))[:, None, None], row, column]
    hidden = np.abs(i.disparity - front + i.tolerance) < CLEAR
    return (near_a_rounding(i) | border | hidden).any(0)


def nearest_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Disparities are copied: all must be the same bits, but for those to which a doubtful one may come near."""
    errors = {}
    for name in want:
        differs = got[name] != want[name]
        if not i.exact:
            doubtful = near_a_rounding(i)
            assert doubtful.mean() < 0.05, "too much is undecided: the check says little"
            decided = ~np.isin(want[name], i.disparity[doubtful.any(0)])
            decided &= ~np.isin(got[name], i.disparity[doubtful.any(0)])
            differs &= decided
        errors[name] = float(differs.mean())
    return errors


def alignment_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to the largest; of the slope, whose terms may cancel, to a tenth of the largest curvature at least."""
    clear = np.ones(i.disparity.shape, np.bool_)
    if not i.exact:
        clear = ~near_a_decision(i)
        assert clear.mean() > 0.95, "too much is undecided: the check says little"
    least = {}
    for views in ("", " of some"):
        largest = float(np.abs(want[f"curvature{views}"]).max())
        least[f"curvature{views}"] = largest
        least[f"slope{views}"] = max(float(np.abs(want[f"slope{views}"]).max()), 0.1 * largest)
    return {name: largest_error(got[name][clear], want[name][clear], least[name]) for name in want}


def unmix_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to the largest, where a little more or less of share and contrast makes no difference."""
    clear = np.ones(i.disparity.shape, np.bool_)
    for name, factor in itertools.product(("share", "contrast"), (1 - CLEAR, 1 + CLEAR)):
        other = np.empty_like(i.disparity, np.float64)
        options = i.options | {name: i.options[name] * factor + (factor - 1) * CLEAR * (name == "share")}
        reference.refine_boundaries(
            i.image.astype(np.float64), i.disparity.astype(np.float64), **options, disparity_out=other
        )
        clear &= np.abs(other - want["disparity"]) < CLEAR
    assert clear.mean() > 0.95, "too much is undecided: the check says little"
    return {"disparity": largest_error(got["disparity"][clear], want["disparity"][clear])}


OPERATIONS = (
    Operation(z_buffer, "alignment", nearest_errors),
    Operation(alignment, "alignment", alignment_errors),
    Operation(nlm_ratio, "ratio", relative_to_terms(ratio=lambda i: size(i.values) / i.options["floor"])),
    Operation(nlm_plane, "ratio"),
    Operation(nlm_on_surface, "ratio"),
    Operation(refine_boundaries, "outline", unmix_errors),
)
NEAREST, ALIGNMENT, RATIO, PLANE, ON_SURFACE, UNMIX = OPERATIONS
