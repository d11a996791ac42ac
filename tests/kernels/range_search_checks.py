"""The checks of the operations that find the disparity range: how to run them, and how near outputs must be."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from checks import Desk, Operation, Outputs, Values, largest_error
from programs import Program

from lfgpu.contract import KernelSet


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
    plan = desk.kernels.side_costs(i.details.shape, i.offsets, i.lines, desk.device, reference=0, **i.row)
    out = desk.out((len(i.lines), i.row["count"], *i.details.shape[1:]))
    plan(desk.field(1 - i.details[::-1]), out)
    plan(desk.field(i.details), out)
    return {"volume": out}


def distinct_minimum(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Of costs whose means are exact in float32, so that which is least is beyond doubt."""
    out = desk.out((5, *i.volume.shape[2:]))
    desk.kernels.distinct_minimum(desk.field(i.volume), apart=i.apart, found_out=out)
    return {"found": out}


def relative_to_one(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to the largest intensity that there is."""
    return {name: largest_error(got[name], want[name], 1.0) for name in want}


OPERATIONS = (
    Operation(shrink, "range search", relative_to_one),
    Operation(details, "range search", relative_to_one),
    Operation(side_costs, "range search", relative_to_one),
    Operation(distinct_minimum, "range search"),
)
SHRINK, DETAILS, COSTS, DISTINCT = OPERATIONS


# --- a program of them, for devices that can do work as a whole ---


def finding_what_is_distinct(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """From views to where they are alike."""
    views, valid = kernels.image(values["recorded"], device), kernels.field(values["valid"], device)
    shape, offsets = values["recorded"].shape[:3], values["offsets"]
    plan = kernels.details(shape, device, factor=1, window=3)
    row = {"first": -1.0, "step": 0.5, "count": 5}
    compare = kernels.side_costs(shape, offsets, [[[1], [2]]], device, reference=0, **row)
    images, details = (kernels.zeros(shape, device) for _ in range(2))
    costs, found = kernels.zeros((1, 5, *shape[1:]), device), kernels.zeros((5, *shape[1:]), device)

    def work() -> None:
        kernels.shrink(views, (0, 1, 2), valid, scale=1.0, factor=1, images_out=images)
        plan(images, details)
        compare(details, costs)
        kernels.distinct_minimum(costs, apart=1, found_out=found)

    return Program({"recorded": views, "valid": valid}, work, {"costs": costs, "found": found})
