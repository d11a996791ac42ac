"""Smoothed and reduced views: cases, their random inputs, checks, and what holds in any case."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from checks import Case, Desk, Operation, Outputs, Values, compute, largest_error, scale_of, stored
from programs import Program

from lfgpu.contract import REDUCTION, SMOOTHING_REACH, WHITE, KernelSet

STEP = 1 / WHITE
"""What two numbers that are nearly the same may differ by once they are rounded."""


@dataclass(frozen=True)
class SmoothingCase(Case):
    """`count` views of `size` stored as `dtype`, `gain` times as bright as they are, and what is alike in them."""

    size: tuple[int, int] = (11, 14)
    count: int = 3
    channels: int = 3
    dtype: str = "uint8"
    masked: bool = False
    valid_share: float = 0.7
    gain: float = 1.0
    deviation: float = 0.05
    tolerance: float = STEP


SMOOTHING_CASES = (
    SmoothingCase("colour uint8"),
    SmoothingCase("grey uint8 masked", channels=1, masked=True),
    SmoothingCase("colour uint16 masked", dtype="uint16", masked=True),
    SmoothingCase("grey uint16", channels=1, dtype="uint16"),
    SmoothingCase("colour float32 masked", dtype="float32", masked=True),
    SmoothingCase("grey float32", channels=1, dtype="float32"),
    SmoothingCase("colour float16", dtype="float16"),
    SmoothingCase("grey float16 masked", channels=1, dtype="float16", masked=True),
    SmoothingCase("one pixel wide", size=(13, 1), masked=True),
    SmoothingCase("one pixel high", size=(1, 13), channels=1),
    SmoothingCase("one pixel", size=(1, 1)),
    SmoothingCase("two by two", size=(2, 2), channels=1, masked=True),
    SmoothingCase("smaller than the window", size=(5, 6), masked=True),
    SmoothingCase("as large as the window", size=(7, 7), channels=1),
    SmoothingCase("a tile of a GPU", size=(8, 32), dtype="float32"),
    SmoothingCase("several tiles", size=(25, 67), count=2, masked=True),
    SmoothingCase("one view", count=1, size=(9, 12)),
    SmoothingCase("few valid pixels", masked=True, valid_share=0.1, size=(19, 17)),
    SmoothingCase("no valid pixel", masked=True, valid_share=0.0),
    SmoothingCase("all valid", masked=True, valid_share=1.0, channels=1),
    SmoothingCase("all is alike", deviation=10.0),
    SmoothingCase("little is alike", deviation=0.005, dtype="uint16", masked=True),
    SmoothingCase("brighter than white", gain=1.7, masked=True),
    SmoothingCase("dark", gain=0.05, dtype="uint16", deviation=0.002),
    SmoothingCase("work for several threads", size=(61, 38), count=9, masked=True),
)
REDUCTION_CASES = (
    *(case for case in SMOOTHING_CASES if min(case.size) >= REDUCTION),
    SmoothingCase("one block", size=(4, 4), masked=True),
    SmoothingCase("one block and what is left over", size=(7, 7), channels=1, masked=True),
    SmoothingCase("nothing left over", size=(12, 20), masked=True),
    SmoothingCase("wide", size=(5, 83), dtype="uint16", masked=True),
)


def smoothing_inputs(case: SmoothingCase, rng: np.random.Generator) -> SimpleNamespace:
    """Views of tiles with soft structure and noise, and two masks: one of pixels, one of blocks and a few pixels.

    Of a block of the second one either all pixels are valid, or none, or all but a few. Views of float types go beyond
    0 and 1.
    """
    (height, width), shape = case.size, (case.count, *case.size)
    y, x = np.mgrid[:height, :width]
    tiles = 0.9 * ((y // 5 + x // 4) % 2) + 0.1 * np.sin(0.5 * x + 0.3 * y)
    views = 0.05 + tiles[..., None] + rng.normal(0, 0.04, (*shape, case.channels))
    pixels, few = rng.random(shape), rng.random(shape)
    blocks = rng.random((case.count, -(-height // REDUCTION), -(-width // REDUCTION)))
    blocks = blocks.repeat(REDUCTION, 1).repeat(REDUCTION, 2)[:, :height, :width]
    masks = pixels < case.valid_share, (blocks < case.valid_share) & (few < 1 - (1 - case.valid_share) / 16)
    # What is not 0 is valid, whatever it is.
    valid, by_block = ((mask * np.float32(0.75)).astype(np.float32) if case.masked else None for mask in masks)
    return SimpleNamespace(
        views=stored(views if case.dtype.startswith("float") else views.clip(0, 1), case.dtype),
        valid=valid,
        by_block=by_block,
        scale=case.gain * scale_of(case.dtype),
        deviation=case.deviation,
    )


MANY = 200
"""Values among which those that are rounded to another step than in the reference can be counted."""

ROUNDING = 1.5 / WHITE
"""A step, and half a one where the truth lies between two."""


def smooth_views(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.stored_out(i.views.shape, np.uint16)
    valid = None if i.valid is None else desk.field(i.valid)
    desk.kernels.smooth_views(desk.image(i.views), valid, scale=i.scale, deviation=i.deviation, views_out=out)
    return {"views": desk.stored_values(out)}


def reduce_views(desk: Desk, i: SimpleNamespace) -> Outputs:
    n, height, width, channels = i.views.shape
    shape = n, height // REDUCTION, width // REDUCTION
    views, out = desk.image(i.views), desk.stored_out((*shape, channels), np.uint16)
    if i.by_block is None:
        desk.kernels.reduce_views(views, None, scale=i.scale, views_out=out, valid_out=None)
        return {"views": desk.stored_values(out)}
    valid, valid_out = desk.field(i.by_block), desk.out(shape)
    desk.kernels.reduce_views(views, valid, scale=i.scale, views_out=out, valid_out=valid_out)
    return {"views": desk.stored_values(out), "valid": valid_out}


def rounded_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to white. Another step of it is where two nearly equal numbers are rounded: that is seldom so."""
    steps = np.abs(got["views"].astype(np.float64) - want["views"])
    if steps.size >= MANY:
        share = float((steps > 0).mean())
        assert share <= 1 / 8, f"views: {share:.0%} are rounded to another step, more than {1 / 8:.0%}"
    errors = {"views": float(steps.max()) / WHITE}
    if "valid" in want:
        errors["valid"] = largest_error(got["valid"], want["valid"], 1.0)
    return errors


OPERATIONS = (
    Operation(smooth_views, "smoothing", rounded_errors),
    Operation(reduce_views, "reduction", rounded_errors),
)
SMOOTH, REDUCE = OPERATIONS


# --- checks that know no truth but what smoothing is for ---


def smoothed(kernels: KernelSet, device: str, views: Values, deviation: float, valid: Values | None = None) -> Values:
    """Intensities [n, y, x, c] of float32 views after smoothing."""
    i = SimpleNamespace(views=views.astype(np.float32), valid=valid, scale=1.0, deviation=deviation)
    return compute(kernels, device, SMOOTH, i)["views"].astype(np.float64) / WHITE


def check_constant_stays(kernels: KernelSet, device: str) -> None:
    """Views of one intensity are what they were, up to their borders, smoothed and reduced."""
    views = np.full((2, 13, 38, 3), (0.0, 20011 / WHITE, 1.0), np.float32)
    got = smoothed(kernels, device, views, 0.01)
    assert np.abs(got - views).max() <= ROUNDING, "smoothing changes a constant view"
    i = SimpleNamespace(views=views, by_block=None, scale=1.0)
    reduced = compute(kernels, device, REDUCE, i)["views"].astype(np.float64) / WHITE
    assert np.abs(reduced - views[:, :3, :9]).max() <= ROUNDING, "reducing changes a constant view"


def check_noise_falls(kernels: KernelSet, device: str, rng: np.random.Generator) -> None:
    """Noise on a constant view falls as in means with the Gaussian's weights, as the guides differ by little.

    Along either axis that is by sqrt(sum w^2) / sum w. The reduced view averages REDUCTION^2 pixels.
    """
    deviation, noise = 0.2, 0.02
    views = 0.5 + rng.normal(0, noise, (2, 96, 96, 3))
    weights = np.exp(-(np.arange(-SMOOTHING_REACH, SMOOTHING_REACH + 1) ** 2) / 8)
    inner = np.s_[:, SMOOTHING_REACH:-SMOOTHING_REACH, SMOOTHING_REACH:-SMOOTHING_REACH]
    factor = smoothed(kernels, device, views, deviation)[inner].std() / noise
    want = (weights**2).sum() / weights.sum() ** 2
    assert abs(factor / want - 1) <= 0.12, f"smoothing leaves {factor:.3f} of the noise, not {want:.3f}"
    i = SimpleNamespace(views=views.astype(np.float32), by_block=None, scale=1.0)
    factor = (compute(kernels, device, REDUCE, i)["views"] / WHITE).std() / noise
    want = 1 / REDUCTION
    assert abs(factor / want - 1) <= 0.12, f"reducing leaves {factor:.3f} of the noise, not {want:.3f}"


def check_edge_stays(kernels: KernelSet, device: str) -> None:
    """An edge of 10 deviations stays where it is, and as high, within 1 % of its height; upright and lying."""
    deviation, low = 0.02, 0.3
    high = low + 10 * deviation
    upright = np.full((1, 18, 41, 3), low)
    upright[:, :, 20:] = high
    for name, views in (("upright", upright), ("lying", upright.transpose(0, 2, 1, 3))):
        moved = np.abs(smoothed(kernels, device, views, deviation) - views).max() / (high - low)
        assert moved <= 0.01, f"an {name} edge is off by {moved:.1%} of its height"


def check_regions_stay_apart(kernels: KernelSet, device: str, rng: np.random.Generator) -> None:
    """Two constant regions with what is not valid between them, whatever it shows, stay as they are.

    The step between them is of half a deviation, so that likeness does not keep them apart. What is not valid is a mean
    with them.
    """
    deviation, left, right = 0.1, 0.4, 0.45
    views = np.full((1, 17, 40, 3), left)
    views[:, :, 20:] = right
    valid = np.ones(views.shape[:3], np.float32)
    between = np.s_[:, :, 18 : 18 + SMOOTHING_REACH]
    valid[between] = 0
    views[between] = rng.random(views[between].shape)
    got = smoothed(kernels, device, views, deviation, valid)
    there = valid != 0
    moved = np.abs(got - views)[there].max()
    assert moved <= ROUNDING, f"what is not valid, or lies behind it, moves a valid pixel by {moved:.5f}"
    share = np.abs(got - views)[~there].mean()
    assert share >= 0.01, "what is not valid stays as it was, instead of being a mean with what is"


def check_masked_pixels_say_nothing(kernels: KernelSet, device: str, rng: np.random.Generator) -> None:
    """What stands in pixels that are not valid, NaN included, makes no difference anywhere, smoothed or reduced."""
    views = rng.random((2, 21, 45, 3)).astype(np.float32)
    valid = (rng.random(views.shape[:3]) < 0.6).astype(np.float32)
    valid[:, :9, :12] = 0
    for name, operation in (("smoothing", SMOOTH), ("reducing", REDUCE)):
        found = []
        for masked in (0.0, 1.0, np.nan):
            shown = np.where(valid[..., None] != 0, views, np.float32(masked))
            i = SimpleNamespace(views=shown, valid=valid, by_block=valid, scale=1.0, deviation=0.3)
            found.append(compute(kernels, device, operation, i)["views"])
        assert all((other == found[0]).all() for other in found), f"{name} looks at what is not valid"


def check_channels_are_alike_together(kernels: KernelSet, device: str, rng: np.random.Generator) -> None:
    """Three channels that are the same give what one of them gives alone."""
    grey = rng.random((2, 11, 14, 1))
    one = smoothed(kernels, device, grey, 0.2)
    three = smoothed(kernels, device, grey.repeat(3, 3), 0.2)
    assert np.abs(three - one).max() <= ROUNDING, "what is alike depends on how many channels there are"


# --- a program of them, for devices that can do work as a whole ---


def showing_less_noise(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """Views smoothed, and the same reduced with their mask."""
    views = kernels.image(values["recorded"], device)
    valid = kernels.field(values["mostly valid"], device)
    n, height, width, channels = values["recorded"].shape
    small = n, height // REDUCTION, width // REDUCTION
    out: dict[str, Any] = {
        "smoothed": kernels.zeros_image((n, height, width, channels), device, np.uint16),
        "reduced": kernels.zeros_image((*small, channels), device, np.uint16),
        "valid": kernels.zeros(small, device),
    }

    def work() -> None:
        kernels.smooth_views(views, valid, scale=0.9, deviation=0.1, views_out=out["smoothed"])
        kernels.reduce_views(views, valid, scale=0.9, views_out=out["reduced"], valid_out=out["valid"])

    # A step of rounding, relative to views that are at least half as bright as white.
    return Program({"recorded": views, "mostly valid": valid}, work, out, tolerance=2 / WHITE)
