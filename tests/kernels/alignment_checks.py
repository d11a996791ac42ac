"""The checks of what comes near in each view, of the alignment, of ratios by weights and of outlines."""

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
from checks import Desk, Operation, Outputs, Values, compute, largest_error, relative_to_terms, size
from programs import Program

from lfgpu.contract import KernelSet
from lfgpu.kernels import reference as reference_package

reference = reference_package.KERNELS

CLEAR = 1e-4
"""Pixels: what is decided by less is left out of comparisons."""


def z_buffer(desk: Desk, i: SimpleNamespace) -> Outputs:
    """After that of another map, which leaves no trace."""
    plan = desk.kernels.z_buffer(i.recorded.shape, desk.field(i.offsets), reach=i.reach)
    out = desk.out(i.recorded.shape[:3])
    plan(desk.field(i.disparity[::-1, ::-1] + 1), out)
    plan(desk.field(i.disparity), out)
    return {"nearest": out}


def alignment(desk: Desk, i: SimpleNamespace) -> Outputs:
    """After that of another light field, and with another map, which leave no trace."""
    plan = desk.kernels.alignment(
        i.recorded.shape,
        desk.field(i.offsets),
        scale=i.scale,
        gradient_weight=i.gradient_weight,
        contrast=i.contrast,
        robust=i.robust,
        tolerance=i.tolerance,
    )
    disparity, nearest = desk.field(i.disparity), desk.field(i.nearest)
    out = {name: desk.out(i.disparity.shape) for name in ("curvature", "slope")}
    other_mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    plan.load(desk.image(i.image[::-1] + 1), desk.image(i.recorded[:, ::-1]), other_mask)
    plan(disparity, nearest, *out.values())
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan(desk.field(i.disparity[::-1, ::-1]), nearest, *out.values())
    plan(disparity, nearest, *out.values())
    return out


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
    out = desk.out(i.weights.shape)
    options = {name: i.options[name] for name in ("window", "support")}
    desk.kernels.nlm_on_surface(desk.field(i.weights), desk.field(i.guide), **options, weights_out=out)
    return {"weights": out}


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
    differs = got["nearest"] != want["nearest"]
    if not i.exact:
        doubtful = near_a_rounding(i)
        assert doubtful.mean() < 0.05, "too much is undecided: the check says little"
        decided = ~np.isin(want["nearest"], i.disparity[doubtful.any(0)])
        decided &= ~np.isin(got["nearest"], i.disparity[doubtful.any(0)])
        differs &= decided
    return {"nearest": float(differs.mean())}


def alignment_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to the largest; of the slope, whose terms may cancel, to a tenth of the largest curvature at least."""
    clear = np.ones(i.disparity.shape, np.bool_)
    if not i.exact:
        clear = ~near_a_decision(i)
        assert clear.mean() > 0.95, "too much is undecided: the check says little"
    largest = float(np.abs(want["curvature"]).max())
    least = {"curvature": largest, "slope": max(float(np.abs(want["slope"]).max()), 0.1 * largest)}
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


# --- checks that know no truth of the reference ---


def check_step_leads_to_the_truth(kernels: KernelSet, device: str, channels: int, rng: np.random.Generator) -> None:
    """Of slopes of brightness, seen from places around the reference: one step is all the way to their disparity.

    Away from the border, as beyond it they do not go on.
    """
    height, width = 15, 17
    offsets = np.array([(du, dv) for dv in (-1.0, 0.0, 1.0) for du in (-1.0, 0.0, 1.0)])
    truth, now = rng.uniform(-0.5, 0.5, 2)
    across, down = rng.uniform(0.02, 0.04, (2, channels)) * rng.choice([-1, 1], (2, channels))
    y, x = (place[..., None] for place in np.mgrid[:height, :width])
    views = [across * (x + truth * du) + down * (y + truth * dv) for du, dv in offsets]
    scene = SimpleNamespace(
        image=np.float32(across * x + down * y),
        recorded=np.array(views, np.float32),
        valid=None,
        offsets=offsets,
        disparity=np.full((height, width), now),
        nearest=np.full((len(offsets), height, width), -1e6),
        scale=1.0,
        gradient_weight=2.0,
        contrast=0.1,
        robust=0.05,
        tolerance=0.25,
    )
    got = compute(kernels, device, ALIGNMENT, scene)
    inner = np.s_[4:-4, 4:-4]
    step = got["slope"][inner] / got["curvature"][inner]
    np.testing.assert_allclose(step, truth - now, rtol=0, atol=1e-3, err_msg="a step does not lead to the truth")


def check_what_no_view_sees_has_no_slope(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """Where nothing is valid, and where something nearer hides all, nothing is known: curvature and slope are 0."""
    blind = SimpleNamespace(**{**vars(i), "valid": np.zeros(i.nearest.shape)})
    hidden = SimpleNamespace(**{**vars(i), "nearest": np.full_like(i.nearest, 1e3)})
    for unseen in (blind, hidden):
        for name, output in compute(kernels, device, ALIGNMENT, unseen).items():
            assert not output.any(), f"the {name} of what no view sees is not 0"


# --- a program of them, for devices that can do work as a whole ---


def stepping(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """A step of Gauss and Newton, smoothed, on a light field that is loaded each time."""
    views = values["recorded"]
    inputs: dict[str, Any] = {name: kernels.image(values[name], device) for name in ("image", "recorded")}
    inputs |= {name: kernels.field(values[name], device) for name in ("valid", "disparity")}
    offsets = kernels.field(values["offsets"], device)
    weights = kernels.field(np.full((12, *views.shape[1:3]), 0.5), device)
    surface = kernels.z_buffer(views.shape, offsets, reach=1)
    plan = kernels.alignment(
        views.shape, offsets, scale=1.0, gradient_weight=2.0, contrast=0.5, robust=0.25, tolerance=0.30078125
    )
    nearest = kernels.zeros(views.shape[:3], device)
    curvature, slope, step, plane, unmixed = (kernels.zeros(views.shape[1:3], device) for _ in range(5))
    certainty = kernels.field(np.full(views.shape[1:3], 0.5), device)
    on_surface = kernels.zeros((12, *views.shape[1:3]), device)

    def work() -> None:
        plan.load(inputs["image"], inputs["recorded"], inputs["valid"])
        surface(inputs["disparity"], nearest)
        plan(inputs["disparity"], nearest, curvature, slope)
        fields = weights, inputs["disparity"], slope, curvature
        kernels.nlm_ratio(*fields, window=5, support=0.5, floor=1e-3, ratio_out=step)
        kernels.nlm_plane(weights, step, certainty, window=5, support=0.5, ridge=1.0, plane_out=plane)
        kernels.refine_boundaries(
            inputs["image"], inputs["disparity"], step=0.25, contrast=0.01, share=0.4, disparity_out=unmixed
        )
        kernels.nlm_on_surface(weights, unmixed, window=5, support=0.5, weights_out=on_surface)

    outputs = {"curvature": curvature, "slope": slope, "step": step, "plane": plane, "on_surface": on_surface}
    return Program(inputs, work, outputs)
