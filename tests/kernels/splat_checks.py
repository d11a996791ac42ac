"""The splat, the data term, and what the reference sees of other views: cases and checks."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from checks import (
    FLOAT32_STEP,
    IRREGULAR,
    Case,
    Desk,
    Operation,
    Outputs,
    coarse,
    float32,
    grid,
    relative_to_terms,
    scale_of,
    size,
    stored,
)


@dataclass(frozen=True)
class SplatCase(Case):
    """A reference image, a disparity map in `disparities`, and views at `offsets` recorded as `dtype`."""

    size: tuple[int, int] = (11, 14)
    channels: int = 3
    dtype: str = "float32"
    offsets: tuple[tuple[float, float], ...] = grid(3, 3)
    disparities: tuple[float, float] = (-1.5, 1.5)
    masked: bool = False
    softness: float = 0.125
    exact: bool = True

    @property
    def tolerance(self) -> float:
        """Relative error of a float32 backend, see the module's text."""
        farthest = max(map(abs, self.disparities)) * np.abs(self.offsets).max()
        return 1e-5 if self.exact else 1e-5 + 8 * FLOAT32_STEP * farthest / self.softness


SPLAT_CASES = (
    SplatCase("colour float32"),
    SplatCase("grey float32", channels=1),
    SplatCase("colour uint8", dtype="uint8", size=(12, 9)),
    SplatCase("grey uint8 masked", channels=1, dtype="uint8", masked=True),
    SplatCase("colour uint16 masked", dtype="uint16", masked=True),
    SplatCase("grey uint16", channels=1, dtype="uint16"),
    SplatCase("colour float16 masked", dtype="float16", masked=True),
    SplatCase("grey float16", channels=1, dtype="float16", size=(9, 12)),
    SplatCase("one pixel wide", size=(13, 1)),
    SplatCase("one pixel high", size=(1, 13), channels=1),
    SplatCase("one pixel", size=(1, 1)),
    SplatCase("two by two", size=(2, 2), channels=1, masked=True),
    SplatCase("one row of views", offsets=grid(1, 5)),
    SplatCase("one column of views", offsets=grid(5, 1), dtype="uint8"),
    SplatCase("corner reference", offsets=tuple((u + 1, v + 1) for u, v in grid(3, 3))),
    SplatCase("one view without offset", offsets=((0.0, 0.0),)),
    SplatCase("irregular offsets", offsets=IRREGULAR, masked=True),
    SplatCase("many views", offsets=grid(5, 7), size=(7, 8), channels=1),
    SplatCase("partly out of the frame", disparities=(-9.0, 9.0), offsets=grid(3, 3)),
    SplatCase("all out of the frame", disparities=(20.0, 40.0), offsets=((1.0, 0.0), (-1.0, 1.0), (0.0, -2.0))),
    SplatCase("whole disparities", disparities=(2.0, 2.0)),
    SplatCase("sharp tent", softness=2.0**-6),
    SplatCase("softest tent", softness=0.5, channels=1),
    SplatCase("arbitrary numbers", softness=0.1, exact=False, offsets=((0.31, -1.2), (1.7, 0.9))),
    SplatCase("grid with holes", offsets=tuple(grid(3, 3)[k] for k in (0, 1, 3, 5, 8)), dtype="uint8"),
    SplatCase("work for several threads", size=(61, 38), offsets=grid(5, 5), masked=True),
    SplatCase("views of a benchmark", size=(5, 6), offsets=grid(9, 9), masked=True),
    SplatCase("several tiles of a GPU", size=(37, 131), offsets=grid(2, 2), channels=1, masked=True),
    SplatCase(
        "more strips than a GPU lists at a time",
        size=(121, 157),
        channels=1,
        disparities=(-60.0, 60.0),
        offsets=((1.0, -0.5), (-0.75, 0.25)),
    ),
)


def splat_inputs(case: SplatCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random inputs of all splat operations and the data term, as NumPy arrays of the values that backends get."""
    shape, n = case.size, len(case.offsets)
    low, high = case.disparities
    disparity = rng.uniform(low, high, shape)
    return SimpleNamespace(
        image=float32(rng.random((*shape, case.channels))),
        disparity=coarse(disparity, 2.0**-10) if case.exact else float32(disparity),
        tangent=float32(rng.normal(size=shape)),
        offsets=float32(np.array(case.offsets)),
        views=float32(rng.normal(size=(n, *shape, case.channels))),
        recorded=stored(rng.random((n, *shape, case.channels)), case.dtype),
        valid=float32(rng.random((n, *shape)) < 0.7) if case.masked else None,
        scale=scale_of(case.dtype),
        softness=case.softness,
    )


SEEN_CASES = tuple(case for case in SPLAT_CASES if case.exact)  # a place just beside a pixel's edge is another pixel


def seen_inputs(case: SplatCase, rng: np.random.Generator) -> SimpleNamespace:
    """Disparities of which many are whole or half, so that places lie on edges, and masks of both views."""
    i = splat_inputs(case, rng)
    halves = np.round(2 * i.disparity) / 2
    i.disparity = np.where(rng.random(case.size) < 0.5, halves, i.disparity)
    i.known = float32(rng.random(case.size) < 0.7)
    i.valid = float32(rng.random((len(case.offsets), *case.size)) < 0.7)
    return i


def data_term(desk: Desk, i: SimpleNamespace) -> Outputs:
    """The value and the gradient after another light field was loaded and compared, which leaves no trace."""
    plan = desk.kernels.data_term(i.recorded.shape, desk.field(i.offsets), scale=i.scale, softness=i.softness)
    gradient, value = desk.out(i.disparity.shape), desk.number_out()
    other_mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    plan.load(desk.image(i.image[::-1] + 1), desk.image(i.recorded[:, ::-1]), other_mask)
    plan(desk.field(i.disparity[::-1, ::-1]), gradient, value)
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan(desk.field(i.disparity[::-1, ::-1]), gradient, value)
    plan(desk.field(i.disparity), gradient, value)
    curvature = desk.out(i.disparity.shape)
    plan.curvature(curvature)
    return {"value": desk.kernels.number(value), "gradient": gradient, "curvature": curvature}


def seen_by_reference(desk: Desk, i: SimpleNamespace) -> Outputs:
    known, valid = desk.field(i.known), desk.field(i.valid)
    masks = {"anything": (None, None), "known": (known, None), "valid": (None, valid), "both": (known, valid)}
    out = {name: desk.out(i.valid.shape) for name in masks}
    disparity, offsets = desk.field(i.disparity), desk.field(i.offsets)
    for name, given in masks.items():
        desk.kernels.seen_by_reference(disparity, offsets, *given, seen_out=out[name])
    return out


def share_of_a_view(i: SimpleNamespace) -> float:
    """The size of what a view adds to a pixel of the gradient: 2 Σ image · residual over channels, times its offset."""
    return 2 * i.image.shape[-1] * size(i.image, i.offsets)


DATA_TERM = Operation(data_term, "splat", relative_to_terms(gradient=share_of_a_view))
SEEN_BY_REFERENCE = Operation(seen_by_reference, "seen")
OPERATIONS = (DATA_TERM, SEEN_BY_REFERENCE)
