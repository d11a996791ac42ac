"""The operations of the learned aggregation: cases, their random inputs and checks."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import checks
import numpy as np
from checks import Desk, Operation, Outputs

from lfgpu.contract import COMPARED, COSTS, DECISIONS, FOLD, Rows


@dataclass(frozen=True)
class Stored(checks.Case):
    """A case whose volumes are `stored` as float32 or float16."""

    stored: str = "float32"
    exact: bool = False
    """Whether results are float32, whatever volumes are stored as."""

    @property
    def tolerance(self) -> float:
        return super().tolerance if self.exact or self.stored == "float32" else 1e-3


@dataclass(frozen=True)
class SectorCase(Stored):
    """Views at `offsets` recorded as `dtype`, costs of `count` disparities that begin at a number, or at a map."""

    size: tuple[int, int] = (11, 14)
    channels: int = 3
    dtype: str = "uint8"
    offsets: tuple[tuple[float, float], ...] = checks.grid(3, 3)
    masked: bool = False
    spread: float = 0.0
    first: float = -1.5
    step: float = 0.71875
    count: int = 3
    room: int = 0
    gain: float = 1.0
    strip: int | None = None
    """So many folded rows are computed at a time, into a volume that holds no more."""


SECTOR_CASES = (
    SectorCase("colour uint8"),
    SectorCase("a map", spread=2.0, masked=True),
    SectorCase("grey uint8 masked", channels=1, masked=True),
    SectorCase("colour float32 masked", dtype="float32", masked=True, size=(12, 9)),
    SectorCase("grey float32 map", dtype="float32", channels=1, spread=1.0),
    SectorCase("colour float16", dtype="float16"),
    SectorCase("grey float16 masked", dtype="float16", channels=1, masked=True, spread=1.0),
    SectorCase("colour uint16 masked", dtype="uint16", masked=True),
    SectorCase("grey uint16", dtype="uint16", channels=1, size=(9, 12)),
    SectorCase("half precision", "float16", masked=True, spread=1.0),
    SectorCase("half precision grey", "float16", channels=1, dtype="float32"),
    SectorCase("one pixel wide", size=(13, 1)),
    SectorCase("one pixel high", size=(1, 13), channels=1, masked=True),
    SectorCase("one pixel", size=(1, 1), dtype="float32"),
    SectorCase("room beyond the border", size=(7, 5), room=6),
    SectorCase("one row of views", offsets=checks.grid(1, 5), masked=True),
    SectorCase("corner reference", offsets=tuple((u + 1, v + 1) for u, v in checks.grid(3, 3))),
    SectorCase("one view without offset", offsets=((0.0, 0.0),)),
    SectorCase("irregular offsets", offsets=checks.IRREGULAR, masked=True),
    SectorCase("partly out of the frame", first=-9.0, step=2.125, masked=True, spread=3.0),
    SectorCase("all out of the frame", first=20.0, offsets=((1.0, 0.0), (-1.0, 1.0), (0.0, -2.0))),
    SectorCase("whole shifts", first=-2.0, step=1.0, count=4),
    SectorCase("dark", gain=0.01),
    SectorCase("rows at a time", size=(19, 9), strip=3, spread=1.0, masked=True),
    SectorCase("many views", offsets=checks.grid(5, 7), size=(7, 8), channels=1, masked=True),
    SectorCase("wide", size=(5, 150), spread=0.5),
    SectorCase("work for several threads", size=(53, 67), offsets=checks.grid(3, 4), masked=True, count=2),
)


def sector_inputs(case: SectorCase, rng: np.random.Generator) -> SimpleNamespace:
    """A scene at disparity 0 but for noise."""
    shape, n = case.size, len(case.offsets)
    image = case.gain * rng.random((*shape, case.channels)).astype(np.float32)
    intensities = 0.7 * image + 0.3 * case.gain * rng.random((n, *shape, case.channels))
    folded = [-(-(side + case.room) // FOLD) for side in shape]
    return SimpleNamespace(
        image=image,
        recorded=checks.stored(intensities, case.dtype),
        valid=(rng.random((n, *shape)) < 0.7).astype(np.float32) if case.masked else None,
        offsets=np.array(case.offsets, np.float32),
        first=checks.coarse(case.first + case.spread * rng.uniform(-1, 1, shape), 2.0**-6),
        factor=1.25,
        folded=tuple(folded),
        stored=case.stored,
        scale=checks.scale_of(case.dtype),
        step=case.step,
        count=case.count,
        strip=case.strip,
    )


@dataclass(frozen=True)
class ConvolutionCase(Stored):
    """A volume of `size` with `channels` in and out; `added` has sizes that are shorter by these factors."""

    size: tuple[int, int, int] = (4, 6, 10)
    channels: tuple[int, int] = (8, 8)
    window: tuple[int, int, int] = (3, 3, 3)
    strides: tuple[int, int, int] = (1, 1, 1)
    added: tuple[int, int, int] | None = None
    rectified: bool = True
    strip: tuple[int, int, int] | None = None
    """So many rows are computed at a time, of a volume and into one that hold so many."""


_LAYERS = (
    ConvolutionCase("all around"),
    ConvolutionCase("as it is", rectified=False, channels=(16, 4), exact=True),
    ConvolutionCase("pixel by pixel", window=(1, 1, 1), channels=(64, 48)),
    ConvolutionCase("an image is added", window=(1, 1, 1), channels=(48, 24), added=(4, 1, 1)),
    ConvolutionCase("an image", size=(1, 9, 13), window=(1, 3, 3), channels=(16, 24)),
    ConvolutionCase("a coarse volume is added", window=(1, 1, 1), channels=(40, 40), added=(2, 2, 2)),
    ConvolutionCase("a coarse volume of as many slices", window=(1, 1, 1), channels=(24, 24), added=(1, 2, 2)),
    ConvolutionCase("strides", strides=(2, 2, 2), channels=(40, 56), size=(8, 10, 12)),
    ConvolutionCase("strides of odd sizes", strides=(2, 2, 2), channels=(24, 40), size=(5, 7, 13)),
    ConvolutionCase("strides in the image", strides=(1, 2, 2), window=(1, 3, 3), channels=(72, 72)),
    ConvolutionCase("stride of slices alone", strides=(2, 1, 1), window=(3, 1, 1), rectified=False),
    ConvolutionCase("wide", size=(2, 3, 70), channels=(56, 56)),
    ConvolutionCase("high", size=(2, 70, 3), channels=(40, 40)),
    ConvolutionCase("many channels", size=(3, 4, 5), channels=(72, 72)),
    ConvolutionCase("one voxel", size=(1, 1, 1)),
    ConvolutionCase("large window", size=(3, 6, 7), window=(1, 5, 7)),
    ConvolutionCase("work for several threads", size=(4, 17, 67), channels=(24, 4)),
    ConvolutionCase("rows at a time", size=(2, 14, 10), strip=(3, 6, 4)),
    ConvolutionCase("rows with strides", size=(2, 20, 9), strides=(1, 2, 1), channels=(24, 40), strip=(2, 8, 10)),
    ConvolutionCase(
        "rows to which coarse ones are added",
        size=(2, 12, 8),
        window=(1, 1, 1),
        channels=(24, 24),
        added=(1, 2, 2),
        strip=(4, 4, 5),
    ),
)
CONVOLUTION_CASES = (*_LAYERS, *(replace(case, name=f"half {case}", stored="float16") for case in _LAYERS))


def convolution_inputs(case: ConvolutionCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random numbers that float16 holds as they are."""

    def half(shape: tuple[int, ...], size: float = 1.0) -> np.ndarray:
        return (size * rng.normal(size=shape)).astype(np.float16).astype(np.float32)

    size = tuple(-(-length // stride) for length, stride in zip(case.size, case.strides, strict=True))
    inputs, outputs = case.channels
    added = None
    if case.added is not None:
        added = half((*(length // by for length, by in zip(size, case.added, strict=True)), outputs))
    return SimpleNamespace(
        volume=half((*case.size, inputs)),
        weights=half((*case.window, *case.channels), (inputs * np.prod(case.window)) ** -0.5),
        bias=half((outputs,)),
        added=added,
        shape=(*size, outputs),
        stored=case.stored,
        result=case.stored if not case.exact else "float32",
        strip=case.strip,
        options={"strides": case.strides, "rectified": case.rectified},
    )


@dataclass(frozen=True)
class PeakCase(Stored):
    """Logits of `count` disparities for a map of `size`, folded with room for more."""

    size: tuple[int, int] = (6, 10)
    count: int = 12
    room: int = 0
    sharpness: float = 3.0
    strip: int | None = None
    """So many folded rows are looked at, at a time."""
    exact: bool = True


PEAK_CASES = (
    PeakCase("peaks"),
    PeakCase("odd sizes", size=(7, 9)),
    PeakCase("high", size=(9, 4)),
    PeakCase("room beyond the border", size=(5, 6), room=5),
    PeakCase("half precision", "float16"),
    PeakCase("one disparity", count=1),
    PeakCase("few disparities", count=4),
    PeakCase("one pixel", size=(1, 1)),
    PeakCase("nothing is likely", sharpness=0.0),
    PeakCase("sharp", sharpness=400.0),
    PeakCase("rows at a time", size=(15, 10), room=4, strip=3),
    PeakCase("work for several threads", size=(33, 150), count=32),
)


def peak_inputs(case: PeakCase, rng: np.random.Generator) -> SimpleNamespace:
    folded = (-(-(side + case.room) // FOLD) for side in case.size)
    logits = case.sharpness * rng.normal(size=(case.count, *folded, FOLD**2))
    return SimpleNamespace(
        logits=logits.astype(np.float16).astype(np.float32),
        first=checks.coarse(rng.uniform(-2, 2, case.size), 2.0**-6),
        step=0.71875,
        stored=case.stored,
        strip=case.strip,
        # What float32 holds: beside 1 the odds depend on the last digits.
        probability=rng.choice([0.0, 1.0, *rng.random(8)], case.size).astype(np.float32),
        deviation=rng.choice([0.0, *rng.random(8)], case.size).astype(np.float32),
        weights_of_judge={"share": rng.normal(size=4), "spread": rng.normal(size=3), "limit": 0.28},
    )


@dataclass(frozen=True)
class ChoiceCase(Stored):
    """Two maps of `size`, `apart` by so many pixels in the farthest view, folded with room for more."""

    size: tuple[int, int] = (6, 10)
    room: int = 0
    apart: float = 1.0
    farthest: float = 4.0
    decision: float = 0.0
    """Mean of the decisions; small ones say that the first map is right to a hundredth of a pixel."""


CHOICE_CASES = (
    ChoiceCase("two maps"),
    ChoiceCase("odd sizes", size=(7, 9)),
    ChoiceCase("room beyond the border", size=(5, 6), room=5),
    ChoiceCase("half precision", "float16", apart=30.0),
    ChoiceCase("one pixel", size=(1, 1)),
    ChoiceCase("close", apart=0.01, farthest=1.0),
    ChoiceCase("small decisions", decision=-12.0),
    ChoiceCase("work for several threads", size=(33, 150), apart=0.5),
)


def choice_inputs(case: ChoiceCase, rng: np.random.Generator) -> SimpleNamespace:
    folded = [-(-(side + case.room) // FOLD) for side in case.size]
    first = rng.uniform(-2, 2, case.size)
    second = first + case.apart / case.farthest * rng.normal(size=case.size)
    return SimpleNamespace(
        maps=[
            [
                disparity,
                rng.choice([0.0, 1.0, *rng.random(8)], case.size),
                rng.choice([0.0, 1e4, *rng.random(8)], case.size),
                *(disparity + 0.3 * rng.normal(size=case.size) for _ in range(2)),
            ]
            for disparity in (first, second)
        ],
        decisions=rng.normal(case.decision, 3, (1, *folded, FOLD**2 * DECISIONS)).astype(np.float32),
        farthest=case.farthest,
        folded=folded,
        stored=case.stored,
    )


def compare_maps(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.stored_out((1, *i.folded, FOLD**2 * COMPARED), i.stored)
    first, second = ([desk.field(values) for values in some] for some in i.maps)
    desk.kernels.compare_maps(first, second, farthest=i.farthest, span=2.5, features_out=out)
    return {"features": desk.stored_values(out)}


def choose(desk: Desk, i: SimpleNamespace) -> Outputs:
    names = ("disparity", "confidence", "variance")
    out = {f"{name}_out": desk.out(i.maps[0][0].shape) for name in names}
    first, second = (desk.field(some[0]) for some in i.maps)
    desk.kernels.choose(desk.image(i.decisions), first, second, farthest=i.farthest, **out)
    return {name: out[f"{name}_out"] for name in names}


@dataclass(frozen=True)
class FacetCase(checks.Case):
    """A map of two planes beside each other, with `noise`."""

    size: tuple[int, int] = (13, 17)
    noise: float = 0.125
    level: float = 0.0
    ties: bool = False
    """Whether several planes fit equally well."""


FACET_CASES = (
    FacetCase("two planes"),
    FacetCase("ties", ties=True),
    FacetCase("far from 0", level=64.0),
    FacetCase("noise alone", noise=4.0),
    FacetCase("one row", size=(1, 12)),
    FacetCase("one column", size=(12, 1)),
    FacetCase("two rows", size=(2, 9)),
    FacetCase("smaller than a window", size=(3, 4)),
    FacetCase("one pixel", size=(1, 1)),
    FacetCase("work for several threads", size=(41, 150)),
)


def facet_inputs(case: FacetCase, rng: np.random.Generator) -> SimpleNamespace:
    y, x = np.indices(case.size)
    slopes = rng.uniform(-0.5, 0.5, (2, 3))
    left, right = (level + by_x * x + by_y * y for level, by_x, by_y in slopes)
    map_ = case.level + np.where(x + 2 * y < sum(case.size), left, 3 + right) + case.noise * rng.normal(size=case.size)
    found = rng.normal(size=(*case.size, 4))
    found[..., 3] = rng.integers(0, 3, case.size) if case.ties else np.abs(found[..., 3])
    return SimpleNamespace(map_=checks.float32(map_), planes=checks.float32(found))


def planes(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.image_out((*i.map_.shape, 4))
    desk.kernels.planes(desk.field(i.map_), planes_out=out)
    found = desk.kernels.numpy(out)
    return {name: desk.kernels.field(found[..., n], desk.device) for n, name in enumerate(("level", "x", "y", "rest"))}


def facets(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.map_.shape)
    desk.kernels.facets(desk.image(i.planes), facets_out=out)
    return {"facets": out}


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
    plan(first, factor, out["other"], step=i.step)
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan(first, factor, out["costs"], step=i.step)
    found = {name: desk.stored_values(volume) for name, volume in out.items()}
    if i.strip is not None:
        whole, few = np.empty((i.count, *i.folded, COSTS * FOLD**2)), (i.count, i.strip, *i.folded[1:], COSTS * FOLD**2)
        for rows in strips(i.folded[0], i.strip):
            volume = desk.stored_out(few, i.stored)
            plan(first, factor, volume, step=i.step, rows=rows)
            collect(desk, volume, rows, whole)
        found["in strips"] = desk.kernels.field(whole, desk.device)
    return found


def strips(rows: int, some: int) -> Iterator[Rows]:
    """Cut rows into strips of some."""
    for first in range(0, rows, some):
        yield Rows(first, min(first + some, rows), rows)


def collect(desk: Desk, volume: Any, rows: Rows, whole_out: np.ndarray) -> None:
    """Copy rows of a volume that holds few to where they are among all."""
    there = np.arange(rows.first, rows.last)
    whole_out[:, there] = desk.kernels.numpy(volume)[:, there % volume.shape[1]]


def of_rows(values: np.ndarray, held: int, first: int, last: int) -> np.ndarray:
    """Return a volume that holds few rows, and those of `values` from `first` to before `last`; others are NaN."""
    some = np.full((len(values), held, *values.shape[2:]), np.nan, values.dtype)
    there = np.arange(max(first, 0), min(last, values.shape[1]))
    assert len(there) <= held
    some[:, there % held] = values[:, there]
    return some


def convolution(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Twice with one plan, or a few rows at a time."""

    def volume(values: np.ndarray) -> object:
        return desk.image(values.astype(i.stored))

    plan = desk.kernels.convolution(i.weights, i.bias, desk.device, **i.options)
    if i.strip is not None:
        return {"result": in_strips(desk, plan, i)}
    added = None if i.added is None else volume(i.added)
    out = {"other": -i.volume, "result": i.volume}
    for name, values in out.items():
        target = desk.stored_out(i.shape, i.result)
        plan(volume(values), added, target)
        out[name] = desk.stored_values(target)
    return out


def in_strips(desk: Desk, plan: Any, i: SimpleNamespace) -> Any:
    """Compute a convolution a few rows at a time, of volumes that hold few."""
    some, held, held_out = i.strip
    (labels, rows, *others), stride, reach = i.shape, i.options["strides"][1], i.weights.shape[1] // 2
    whole, target = np.empty(i.shape), desk.stored_out((labels, held_out, *others), i.result)
    for strip in strips(rows, some):
        begin, end = stride * strip.first - reach, stride * (strip.last - 1) + reach + 1
        volume, added = of_rows(i.volume, held, begin, end), None
        if i.added is not None:
            high = rows // i.added.shape[1]
            coarse = of_rows(i.added, held // high, strip.first // high, (strip.last - 1) // high + 1)
            added = desk.image(coarse.astype(i.stored))
        plan(desk.image(volume.astype(i.stored)), added, target, rows=strip)
        collect(desk, target, strip, whole)
    return desk.kernels.field(whole, desk.device)


def peak(desk: Desk, i: SimpleNamespace) -> Outputs:
    names = ("disparity", "probability", "deviation")
    out = {f"{name}_out": desk.out(i.first.shape) for name in names}
    first, rows = desk.field(i.first), i.logits.shape[1]
    for strip in [None] if i.strip is None else strips(rows, i.strip):
        logits = i.logits if strip is None else of_rows(i.logits, i.strip + 1, strip.first, strip.last)
        desk.kernels.peak(desk.image(logits.astype(i.stored)), first, step=i.step, rows=strip, **out)
    return {name: out[f"{name}_out"] for name in names}


def judge_peak(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {f"{name}_out": desk.out(i.first.shape) for name in ("confidence", "variance")}
    maps = desk.field(i.probability), desk.field(i.deviation)
    desk.kernels.judge_peak(*maps, step=i.step, **i.weights_of_judge, **out)
    return {"confidence": out["confidence_out"], "variance": out["variance_out"]}


PEAK_ERRORS = checks.relative_to_terms(
    disparity=lambda i: checks.size(i.first) + i.step * len(i.logits),
    deviation=lambda i: i.step,  # sharp peaks are next to no pixel wide
)
OPERATIONS = (
    Operation(brightness, "sectors"),
    Operation(fold, "sectors"),
    Operation(sector_costs, "sectors"),
    Operation(convolution, "convolution"),
    Operation(peak, "peak", PEAK_ERRORS),
    Operation(judge_peak, "peak"),
    Operation(compare_maps, "choice"),
    Operation(choose, "choice"),
    Operation(planes, "facets"),
    Operation(facets, "facets"),
)
BRIGHTNESS, FOLDING, SECTOR_COSTS, CONVOLUTION, PEAK, JUDGE_PEAK, COMPARE_MAPS, CHOOSE, PLANES, FACETS = OPERATIONS
