"""The checks of the operations of the learned aggregation: how to run them."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs

from lfgpu.contract import COSTS, FOLD


def brightness(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Of an image, of a dark one and of a bright one."""
    found = {}
    for name, values in (("dark", i.image / 64), ("image", i.image), ("bright", 3 * i.image)):
        factor = desk.number_out()
        desk.kernels.brightness(desk.image(values.astype(np.float32)), factor_out=factor)
        found[name] = desk.kernels.number(factor)
    return found


def fold(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.stored_out((1, *i.folded, 4 * FOLD**2), i.stored)
    desk.kernels.fold(desk.image(i.image), desk.number(i.factor), folded_out=out)
    return {"folded": desk.stored_values(out)}


def sector_costs(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Costs of one light field, then those of another one, whose masks leave no trace."""
    out = {name: desk.stored_out((i.count, *i.folded, COSTS * FOLD**2), i.stored) for name in ("other", "costs")}
    first, factor = desk.field(i.first), desk.number(i.factor)
    plan = desk.kernels.sector_costs(i.recorded.shape, desk.field(i.offsets), scale=i.scale)
    mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    plan.load(desk.image(i.image[::-1]), desk.image(i.recorded[:, ::-1]), mask)
    plan(first, factor, out["other"], **i.options)
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan(first, factor, out["costs"], **i.options)
    return {name: desk.stored_values(volume) for name, volume in out.items()}


def convolution(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Twice with one plan; slices before those that are written stay."""

    def volume(values: np.ndarray) -> object:
        return desk.image(values.astype(i.stored))

    plan = desk.kernels.convolution(i.weights, i.bias, desk.device, **i.options)
    added = None if i.added is None else volume(i.added)
    out = {"other": -i.volume, "result": i.volume}
    for name, values in out.items():
        target = desk.stored_out(i.before.shape, i.result)
        desk.kernels.upload(i.before.astype(i.result), target)
        plan(volume(values), added, target, at=i.at)
        out[name] = desk.stored_values(target)
    return out


def peak(desk: Desk, i: SimpleNamespace) -> Outputs:
    names = ("disparity", "probability", "deviation")
    out = {f"{name}_out": desk.out(i.first.shape) for name in names}
    desk.kernels.peak(desk.image(i.logits.astype(i.stored)), desk.field(i.first), step=i.step, **out)
    return {name: out[f"{name}_out"] for name in names}


OPERATIONS = (
    Operation(brightness, "sectors"),
    Operation(fold, "sectors"),
    Operation(sector_costs, "sectors"),
    Operation(convolution, "convolution"),
    Operation(peak, "peak"),
)
BRIGHTNESS, FOLDING, SECTOR_COSTS, CONVOLUTION, PEAK = OPERATIONS
