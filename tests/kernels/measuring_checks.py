"""The operations that measure noise: cases, their random inputs and checks."""

from dataclasses import dataclass
from types import SimpleNamespace

import checks
import numpy as np
from checks import Desk, Operation, Outputs
from range_search_checks import known_and_values


@dataclass(frozen=True)
class MeasuringCase(checks.Case):
    """A field of values from a few, if they are `coarse`, and an image with a smooth part."""

    size: tuple[int, int] = (23, 31)
    channels: int = 3
    coarse: bool = False
    unknown: float = 0.1
    share: float = 0.5
    tolerance: float = 1e-5


MEASURING_CASES = (
    MeasuringCase("colour"),
    MeasuringCase("grey", channels=1, share=0.05),
    MeasuringCase("few values", coarse=True, share=0.3),
    MeasuringCase("all known", unknown=0.0, share=0.77),
    MeasuringCase("the least", share=0.0, coarse=True),
    MeasuringCase("the largest", share=1.0),
    MeasuringCase("nothing known", unknown=1.0),
    MeasuringCase("least size", size=(11, 11), share=0.37),
    MeasuringCase("wide", size=(12, 161), channels=1),
    MeasuringCase("work for several threads", size=(97, 101), share=0.05),
)


def measuring_inputs(case: MeasuringCase, rng: np.random.Generator) -> SimpleNamespace:
    """Values of both signs and all sizes; an image whose left part holds one of its limits, or nearly that."""
    values = rng.normal(size=case.size) * 10.0 ** rng.integers(-6, 6, case.size)
    among = rng.uniform(size=case.size).round(1)
    if case.coarse:
        values = rng.integers(-3, 4, case.size) / 4
    values[rng.uniform(size=case.size) < case.unknown] = np.nan
    among[rng.uniform(size=case.size) < case.unknown / 2] = np.nan
    image = rng.integers(1, 255, (*case.size, case.channels)) / 256
    height, width = case.size
    image[:, : width // 2] = 0.5
    image[: height // 2, : width // 4] = 0
    image[-1, -1] = np.nan if 0 < case.unknown < 1 else 0.25
    return SimpleNamespace(
        values=checks.float32(values),
        among=checks.float32(among),
        least=0.5,
        share=case.share,
        image=checks.float32(image),
        limits=checks.float32(np.stack([np.zeros(case.channels), np.full(case.channels, 0.75)])),
        least_grain=0.01,
    )


def quantile(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Find those of all values, and of those among some."""
    values, outs = desk.field(i.values), [desk.number_out(), desk.number_out()]
    desk.kernels.quantile(values, i.share, quantile_out=outs[0])
    some = {"among": desk.field(i.among), "least": desk.number(i.least)}
    desk.kernels.quantile(values, i.share, quantile_out=outs[1], **some)
    found = [desk.kernels.number(out) for out in outs]
    assert np.isnan(found).all() == np.isnan(i.values).all()
    return {"all": float(np.nan_to_num(found[0])), "some": float(np.nan_to_num(found[1]))}


def window_grain(desk: Desk, i: SimpleNamespace) -> Outputs:
    height, width, _ = i.image.shape
    outs = [desk.out((height - 4, width - 4)) for _ in range(3)]
    arrays = dict(zip(("differences_out", "limited_out", "grain_out"), outs, strict=True))
    desk.kernels.window_grain(desk.image(i.image), desk.field(i.limits), least=i.least_grain, **arrays)
    found = {name: known_and_values(desk, out) for name, out in arrays.items()}
    return {f"{name} {part}": out for name, parts in found.items() for part, out in parts.items()}


OPERATIONS = (Operation(quantile, "measuring"), Operation(window_grain, "measuring"))
QUANTILE, GRAIN = OPERATIONS
