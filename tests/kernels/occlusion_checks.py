"""The checks of the operations with occlusions: how to run them, and how near their outputs must be."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs, Values, compute, largest_error, size
from lfgpu.kernels.reference.occlusion import nearest, reaching_taps
from programs import Program

from lfgpu.contract import KernelSet

CLEAR = 1e-4
"""Pixels: what is decided by less is left out of comparisons."""

ROUNDING = 2.0**-23
"""Of the terms of a gradient, relative to each: twice that of float32."""


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


def z_buffered_data_term(desk: Desk, i: SimpleNamespace) -> Outputs:
    """The value and the gradient after another light field was loaded and compared, which leaves no trace."""
    plan = desk.kernels.z_buffered_data_term(
        i.recorded.shape,
        desk.field(i.offsets),
        scale=i.scale,
        softness=i.softness,
        sharpness=i.sharpness,
        least_coverage=i.least_coverage,
        loss=i.loss,
        loss_scale=i.loss_scale,
    )
    gradient, value = desk.out(i.disparity.shape), desk.number_out()
    other_mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    plan.load(desk.image(i.image[::-1] + 1), desk.image(i.recorded[:, ::-1]), other_mask)
    plan(desk.field(i.disparity[::-1, ::-1]), gradient, value)
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan(desk.field(i.disparity[::-1, ::-1]), gradient, value)
    plan(desk.field(i.disparity), gradient, value)
    return {"value": desk.kernels.number(value), "gradient": gradient}


def visible(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.recorded.shape[:3])
    desk.kernels.visible(desk.field(i.disparity), desk.field(i.offsets), tolerance=i.tolerance, visible_out=out)
    return {"visible": out}


# --- what is seen, pixel by pixel against pixel: slow, and independent of all backends ---


def seen(i: SimpleNamespace, slack: float = 0.0) -> Values:
    """What `visible` says, [n, y, x], where every decision favours being seen by `slack`."""
    height, width = i.disparity.shape
    d = i.disparity.astype(np.float64).ravel()
    rows, columns = (place.ravel() for place in np.mgrid[:height, :width])
    found = []
    for du, dv in i.offsets.astype(np.float64):
        x, y = columns - d * du, rows - d * dv
        # [p, q]: how far the landing place of p is from the centre of q
        distance = np.maximum(np.abs(x[:, None] - columns), np.abs(y[:, None] - rows))
        nearest = np.where(distance < 1 - slack, d[:, None], -np.inf).max(0)
        free = ((distance < 1 + slack) & (nearest <= d[:, None] + i.tolerance + slack)).any(1)
        in_x, in_y = ((a >= -slack) & (a <= side - 1 + slack) for a, side in ((x, width), (y, height)))
        found.append((free & in_x & in_y).reshape(height, width))
    return np.array(found)


def undecided(i: SimpleNamespace) -> Values:
    """Where a change by `CLEAR` of any place or of the tolerance may decide what is seen."""
    return seen(i, CLEAR) != seen(i, -CLEAR)


def visible_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """The share of pixels that differ; but for inputs that are not exact in float32, of those that are decided."""
    differs = got["visible"] != want["visible"]
    if not i.exact:
        doubtful = undecided(i)
        assert doubtful.mean() < 0.05, "too much is undecided: the check says little"
        differs = differs[~doubtful]
    return {"visible": float(differs.mean())}


def sizes_of_terms(i: SimpleNamespace) -> Values:
    """[y, x]: how large what is added up to a pixel's gradient can be, had I and L nothing in common.

    Where one pixel is nearly all that is seen, I - L is 0 but for its rounding. What multiplies it is large where
    little of that pixel lands: T'/T is 2 / b at a distance of b from the end of the tent.
    """
    disparity, total = i.disparity.astype(np.float64), np.zeros(i.disparity.shape)
    for offset in i.offsets.astype(np.float64):
        taps = reaching_taps(disparity, offset, i.softness)
        front, weights = nearest(disparity, taps), np.zeros(disparity.shape)
        nearness = [np.exp(i.sharpness * (disparity[tap.inside] - front[tap.target])) for tap in taps]
        for tap, near in zip(taps, nearness, strict=True):
            np.add.at(weights, tap.target, tap.weight * near)
        for tap, near in zip(taps, nearness, strict=True):
            change = np.abs(tap.slope) + i.sharpness * tap.weight
            total[tap.inside] += change * near / weights[tap.target]
    return 2 * i.image.shape[2] * size(i.image) * total  # what a residual of 1 in each channel makes of colours


def occluding_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Of the gradient as of the plain data term's, but for the rounding of terms that nearly cancel."""
    off = np.abs(got["gradient"] - want["gradient"]) - ROUNDING * sizes_of_terms(i)
    largest = max(float(np.abs(want["gradient"]).max()), 0.1 * size(i.image, i.offsets))
    return {
        "value": largest_error(got["value"], want["value"]),
        "gradient": largest_error(off.clip(0), np.zeros(1), largest),
    }


OPERATIONS = (
    Operation(splat_z_buffered, "occlusion"),
    Operation(z_buffered_data_term, "occlusion", occluding_errors),
    Operation(visible, "occlusion", visible_errors),
)
SPLAT, DATA_TERM, VISIBLE = OPERATIONS


# --- checks that know no truth ---


def check_safe_whatever_the_range(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """All is finite, and a mean of colours lies between the least and the largest of them."""
    views = compute(kernels, device, SPLAT, i)["views"]
    reached = compute(kernels, device, SPLAT, i)["coverage"] > 1e-6
    assert np.isfinite(views).all(), "views are not finite"
    low, high = i.image.min() * (1 - 1e-5), i.image.max() * (1 + 1e-5)
    assert ((views[reached] >= low) & (views[reached] <= high)).all(), "a mean lies outside of what it is of"
    for name, output in compute(kernels, device, DATA_TERM, i).items():
        assert np.isfinite(output).all(), f"the {name} is not finite"


def check_front_hides_back(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """A square at disparity 2 before a plane at 0: views show the square where it is, and the plane around it.

    What the square uncovers is covered by nothing; the pixels of the plane that it covers are not visible.
    """
    height, width = 12, 14
    square = np.zeros((height, width), np.bool_)
    square[3:8, 5:10] = True
    image = i.image[0, 0, 0] + np.arange(height * width, dtype=np.float32).reshape(height, width, 1)
    shifts = ((1.0, 0.0), (0.0, -1.0), (-1.0, 1.0))
    scene = SimpleNamespace(
        image=image,
        disparity=np.where(square, 2.0, 0.0),
        offsets=np.array(shifts),
        views=np.zeros((3, height, width, 1), np.float32),
        recorded=np.zeros((3, height, width, 1), np.float32),
        softness=0.125,
        sharpness=30.0,
        tolerance=0.5,
    )
    got = {**compute(kernels, device, SPLAT, scene), **compute(kernels, device, VISIBLE, scene)}
    for n, (du, dv) in enumerate(shifts):
        moved = tuple(int(-2 * shift) for shift in (dv, du))
        there, front = np.roll(square, moved, (0, 1)), np.roll(image, moved, (0, 1))
        covered = there | ~square
        want = np.where(covered[..., None], np.where(there[..., None], front, image), 0)
        np.testing.assert_allclose(got["views"][n], want, rtol=1e-6, atol=0, err_msg="the front does not hide the back")
        np.testing.assert_array_equal(got["coverage"][n] > 0, covered, "what is uncovered is wrong")
        np.testing.assert_array_equal(got["visible"][n] != 0, square | ~there, "what is visible is wrong")


# --- a program of it, for devices that can do work as a whole ---


def comparing_what_is_nearest(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """The data term with occlusions of a light field that is loaded each time."""
    views = values["recorded"]
    inputs = {name: kernels.image(values[name], device) for name in ("image", "recorded")}
    inputs |= {name: kernels.field(values[name], device) for name in ("valid", "disparity")}
    plan = kernels.z_buffered_data_term(
        views.shape,
        kernels.field(values["offsets"], device),
        scale=1.0,
        softness=0.125,
        sharpness=1.0,  # so that little that is near never hides all the rest: what follows from it has few digits
        least_coverage=0.4371,
        loss="charbonnier",
        loss_scale=0.1,
    )
    gradient, scaled = (kernels.zeros(views.shape[1:3], device) for _ in range(2))
    value, size = kernels.scalar(0.0, device), kernels.scalar(100.0, device)

    def work() -> None:
        plan.load(inputs["image"], inputs["recorded"], inputs["valid"])
        plan(inputs["disparity"], gradient, value)
        kernels.ratio(value, size, value)
        kernels.fill(value, scaled)

    return Program(inputs, work, {"gradient": gradient, "value": scaled})
