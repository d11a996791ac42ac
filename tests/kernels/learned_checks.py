"""The checks of the operations of the learned aggregation: how to run them."""

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs, Values
from programs import Program

from lfgpu.contract import COSTS, FOLD, KernelSet


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


def judge_peak(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {f"{name}_out": desk.out(i.first.shape) for name in ("confidence", "variance")}
    maps = desk.field(i.probability), desk.field(i.deviation)
    desk.kernels.judge_peak(*maps, step=i.step, **i.weights_of_judge, **out)
    return {"confidence": out["confidence_out"], "variance": out["variance_out"]}


def finding_the_peak(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """A network of few layers on the views of a light field that is loaded each time."""
    views, stored, count = values["recorded"], np.float32, 4
    inputs = {name: kernels.image(values[name], device) for name in ("image", "recorded")}
    inputs |= {name: kernels.field(values[name], device) for name in ("valid", "disparity")}
    costs_of = kernels.sector_costs(views.shape, kernels.field(values["offsets"], device), scale=1.0)
    rng = np.random.default_rng(0)
    folded = [-(-side // FOLD) for side in views.shape[1:3]]
    shapes = (1, 1, 1, COSTS * FOLD**2, 24), (1, 3, 3, 4 * FOLD**2, 24), (3, 3, 3, 24, FOLD**2)
    mix, show, judge = (
        kernels.convolution(rng.normal(size=shape).astype(np.float32) / 8, np.zeros(shape[-1], np.float32), device)
        for shape in shapes
    )
    factor = kernels.scalar(1.0, device)
    costs = kernels.zeros_image((count, *folded, COSTS * FOLD**2), device, stored)
    image, shown = (kernels.zeros_image((1, *folded, channels), device, stored) for channels in (4 * FOLD**2, 24))
    mixed = kernels.zeros_image((count, *folded, 24), device, stored)
    logits = kernels.zeros_image((count, *folded, FOLD**2), device)
    outputs = {name: kernels.zeros(views.shape[1:3], device) for name in ("disparity", "probability", "deviation")}

    def work() -> None:
        kernels.brightness(inputs["image"], factor_out=factor)
        costs_of.load(inputs["image"], inputs["recorded"], inputs["valid"])
        kernels.fold(inputs["image"], factor, folded_out=image)
        costs_of(inputs["disparity"], factor, costs, step=0.5, label=0)
        show(image, None, shown)
        mix(costs, shown, mixed)
        judge(mixed, None, logits)
        kernels.peak(logits, inputs["disparity"], step=0.5, **{f"{name}_out": out for name, out in outputs.items()})

    return Program(inputs, work, outputs, tolerance=1e-2)


OPERATIONS = (
    Operation(brightness, "sectors"),
    Operation(fold, "sectors"),
    Operation(sector_costs, "sectors"),
    Operation(convolution, "convolution"),
    Operation(peak, "peak"),
    Operation(judge_peak, "peak"),
)
BRIGHTNESS, FOLDING, SECTOR_COSTS, CONVOLUTION, PEAK, JUDGE_PEAK = OPERATIONS
