"""The operations that find the disparity range: cases, their random inputs and checks."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import checks
import numpy as np
from checks import Desk, Operation, Outputs, Values, largest_error


@dataclass(frozen=True)
class RangeSearchCase(checks.Case):
    """Views that are made smaller, and details that are compared.

    `lines` are the offsets (du, dv) of the views of each side of each line; the reference comes first of all views.
    """

    size: tuple[int, int] = (23, 31)
    channels: int = 3
    dtype: str = "uint8"
    factor: int = 2
    window: int = 5
    masked: bool = False
    lines: tuple[tuple[tuple[tuple[float, float], ...], ...], ...] = (
        (((-1, 0), (-2, 0)), ((1, 0), (2, 0))),
        (((0, -1), (0, -2)), ((0, 1), (0, 2))),
    )
    first: float = -1.5
    step: float = 0.375
    count: int = 9
    apart: int = 2
    tolerance: float = 1e-5


_DIAGONAL = ((((-1.0, -0.5), (-2.0, -1.0)), ((1.0, 0.5),)),)

RANGE_SEARCH_CASES = (
    RangeSearchCase("colour"),
    RangeSearchCase("grey", channels=1, dtype="uint16"),
    RangeSearchCase("floats", dtype="float32"),
    RangeSearchCase("half precision", dtype="float16", channels=1),
    RangeSearchCase("masked", masked=True),
    RangeSearchCase("masked grey", masked=True, channels=1, dtype="float32", factor=1),
    RangeSearchCase("as large as they are", factor=1),
    RangeSearchCase("much smaller", factor=5, size=(53, 61)),
    RangeSearchCase("wide", size=(9, 161)),
    RangeSearchCase("high", size=(121, 8), channels=1),
    RangeSearchCase("window wider than the picture", window=41),
    RangeSearchCase("window of one pixel", window=1),
    RangeSearchCase("one pixel", size=(3, 2), window=3),
    RangeSearchCase("one line", lines=((((-1, 0),), ((1, 0),)),)),
    RangeSearchCase("one view", lines=((((1, 0),),),), channels=1),
    RangeSearchCase("askew", lines=_DIAGONAL, masked=True),
    RangeSearchCase("far out of the frame", first=-40.0, step=9.0),
    RangeSearchCase("as few disparities as there can be", count=3),
    RangeSearchCase("nothing is apart", count=4, apart=4),
    RangeSearchCase("more disparities than a GPU compares at a time", first=-3.0, step=0.0625, count=97, apart=5),
    RangeSearchCase("work for several threads", size=(97, 101), count=19, masked=True),
)


def range_search_inputs(case: RangeSearchCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random views; random images and details, some unknown if masked; a random volume with some costs unseen."""
    offsets = [(0.0, 0.0), *(view for line in case.lines for side in line for view in side)]
    views = checks.stored(rng.uniform(0, 1, (len(offsets), *case.size, case.channels)), case.dtype)
    chosen = rng.permutation(len(offsets))[: max(1, len(offsets) - 1)].tolist()
    small = (case.size[0] // case.factor, case.size[1] // case.factor)
    images = rng.uniform(0, 1, (2, *case.size)).astype(np.float32)
    details = rng.uniform(-0.5, 0.5, (len(offsets), *small)).astype(np.float32)
    valid = None
    if case.masked:
        valid = (rng.uniform(size=(len(chosen), *case.size)) > 0.05).astype(np.float32)
        images[rng.uniform(size=images.shape) < 0.05] = np.nan
        details[rng.uniform(size=details.shape) < 0.1] = np.nan
    numbers = iter(range(1, len(offsets)))
    lines = [[[next(numbers) for _ in side] for side in line] for line in case.lines]
    volume = (rng.integers(0, 64, (len(lines), case.count, *small)) / 64).astype(np.float32)
    volume[rng.uniform(size=volume.shape) < 0.1] = 2.0
    volume[:, :, 0, 0] = 2.0
    found = rng.integers(0, 16, (5, *small)) / np.array([8, 16, 16, 8, 8])[:, None, None]
    return SimpleNamespace(
        views=views,
        chosen=chosen,
        valid=valid,
        scale=checks.scale_of(case.dtype),
        factor=case.factor,
        window=case.window,
        small=small,
        images=images,
        details=details,
        offsets=np.array(offsets),
        lines=lines,
        row={"first": case.first, "step": case.step, "count": case.count},
        volume=volume,
        apart=case.apart,
        found=found,
    )


def known_and_values(desk: Desk, out: Any) -> Outputs:
    """Where a field is not NaN, and what it holds there."""
    values = desk.kernels.numpy(out)
    known = ~np.isnan(values)
    return {"known": desk.held(known), "values": desk.held(np.where(known, values, 0))}


def shrink(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out((len(i.chosen), *i.small))
    valid = None if i.valid is None else desk.field(i.valid)
    desk.kernels.shrink(desk.image(i.views), i.chosen, valid, scale=i.scale, factor=i.factor, images_out=out)
    return known_and_values(desk, out)


def details(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Details after those of other images, which leave no trace."""
    plan = desk.kernels.details(i.images.shape, desk.device, factor=i.factor, window=i.window)
    out = desk.out((len(i.images), *i.small))
    plan(desk.field(1 - i.images[::-1]), out)
    plan(desk.field(i.images), out)
    return known_and_values(desk, out)


def side_costs(desk: Desk, i: SimpleNamespace) -> Outputs:
    count, shape = i.row["count"], i.details.shape
    plan = desk.kernels.side_costs(shape, i.offsets, i.lines, desk.device, reference=0, count=count)
    out = desk.out((len(i.lines), count, *shape[1:]))
    plan(desk.field(1 - i.details[::-1]), 0.25, 0.5, out)
    plan(desk.field(i.details), i.row["first"], i.row["step"], out)
    return {"volume": out}


def distinct_minimum(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Of costs whose means are exact in float32, so that which is least is beyond doubt."""
    outs = [desk.out(i.volume.shape[2:]) for _ in range(5)]
    desk.kernels.distinct_minimum(desk.field(i.volume), apart=i.apart, found_out=outs)
    spread = known_and_values(desk, outs[2])
    return {"place": outs[0], "least": outs[1], **spread, "others": outs[3], "worst": outs[4]}


def agreeing_disparity(desk: Desk, i: SimpleNamespace) -> Outputs:
    """With little noise, with much, and with one that is unknown."""
    found, both = [desk.field(values) for values in i.found], {}
    numbers = {"same": 4.0, "other": 1.5, "neighbors": 2, "first": i.row["first"], "step": i.row["step"]}
    for noise in (0.0625, 0.5, np.nan):
        out = desk.out(i.small)
        desk.kernels.agreeing_disparity(found, desk.number(noise), least_noise=0.03125, **numbers, disparity_out=out)
        both |= {f"{name} at {noise}": values for name, values in known_and_values(desk, out).items()}
    return both


def relative_to_one(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to the largest intensity that there is."""
    return {name: largest_error(got[name], want[name], 1.0) for name in want}


OPERATIONS = (
    Operation(shrink, "range search", relative_to_one),
    Operation(details, "range search", relative_to_one),
    Operation(side_costs, "range search", relative_to_one),
    Operation(distinct_minimum, "range search"),
    Operation(agreeing_disparity, "range search"),
)
SHRINK, DETAILS, COSTS, DISTINCT, AGREEING = OPERATIONS
