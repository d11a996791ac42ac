"""The cases of the operations that find the disparity range, as data, and the random inputs that are made of them."""

from dataclasses import dataclass
from types import SimpleNamespace

import cases
import numpy as np


@dataclass(frozen=True)
class RangeSearchCase(cases.Case):
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
    views = cases.stored(rng.uniform(0, 1, (len(offsets), *case.size, case.channels)), case.dtype)
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
    return SimpleNamespace(
        views=views,
        chosen=chosen,
        valid=valid,
        scale=cases.scale_of(case.dtype),
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
    )
