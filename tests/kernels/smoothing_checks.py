"""Smoothed and reduced views: cases, their random inputs, checks, and what holds in any case."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from checks import Case, Desk, Operation, Outputs, Values, largest_error, scale_of, stored

from lfgpu.contract import REDUCTION, WHITE

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


def smooth_views(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.stored_out(i.views.shape, np.uint16)
    valid = None if i.valid is None else desk.field(i.valid)
    desk.kernels.smooth_views(desk.image(i.views), valid, scale=i.scale, deviation=i.deviation, views_out=out)
    chosen = range(len(i.views))[::-2]
    some = desk.stored_out((len(chosen), *i.views.shape[1:]), np.uint16)
    options = {"scale": i.scale, "deviation": i.deviation, "chosen": chosen}
    desk.kernels.smooth_views(desk.image(i.views), valid, **options, views_out=some)
    return {"views": desk.stored_values(out), "chosen": desk.stored_values(some)}


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
    errors = {}
    for name in want.keys() - {"valid"}:
        steps = np.abs(got[name].astype(np.float64) - want[name])
        if steps.size >= MANY:
            share = float((steps > 0).mean())
            assert share <= 1 / 8, f"{name}: {share:.0%} are rounded to another step, more than {1 / 8:.0%}"
        errors[name] = float(steps.max()) / WHITE
    if "valid" in want:
        errors["valid"] = largest_error(got["valid"], want["valid"], 1.0)
    return errors


OPERATIONS = (
    Operation(smooth_views, "smoothing", rounded_errors),
    Operation(reduce_views, "reduction", rounded_errors),
)
SMOOTH, REDUCE = OPERATIONS
