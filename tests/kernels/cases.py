"""The cases of the kernel matrix, as data, and the random inputs that are made of them.

Disparities, offsets and shears have so few binary digits that their products are exact in float32: every backend lands
at the same place, so that what differs is its arithmetic. `exact=False` leaves that out and says by how much the place
may differ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import load
from lfgpu.contract import half_window
from lfgpu.methods.sections import LocalConfig
from lfgpu.methods.structure_tensor import structure_filters

FLOAT32_STEP = 2.0**-24  # half the distance of neighbouring float32 numbers around 1


def grid(rows: int, columns: int) -> tuple[tuple[float, float], ...]:
    """Offsets (du, dv) of a grid of views from its middle one, which is among them."""
    return tuple((float(u - columns // 2), float(v - rows // 2)) for v in range(rows) for u in range(columns))


IRREGULAR = ((0.328125, -1.0), (-1.71875, 0.40625), (2.015625, 1.140625), (-0.046875, -2.28125))


@dataclass(frozen=True)
class SplatCase:
    """A reference image, a disparity map in `disparities`, and views at `offsets` recorded as `dtype`."""

    name: str
    size: tuple[int, int] = (11, 14)
    channels: int = 3
    dtype: str = "float32"
    offsets: tuple[tuple[float, float], ...] = grid(3, 3)
    disparities: tuple[float, float] = (-1.5, 1.5)
    masked: bool = False
    softness: float = 0.125
    exact: bool = True

    def __str__(self) -> str:
        return self.name.replace(" ", "-")

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
        image=_float32(rng.random((*shape, case.channels))),
        disparity=_coarse(disparity, 2.0**-10) if case.exact else _float32(disparity),
        tangent=_float32(rng.normal(size=shape)),
        offsets=_float32(np.array(case.offsets)),
        views=_float32(rng.normal(size=(n, *shape, case.channels))),
        recorded=stored(rng.random((n, *shape, case.channels)), case.dtype),
        valid=_float32(rng.random((n, *shape)) < 0.7) if case.masked else None,
        scale=scale_of(case.dtype),
        softness=case.softness,
    )


SEEN_CASES = tuple(case for case in SPLAT_CASES if case.exact)  # a place just beside a pixel's edge is another pixel


def seen_inputs(case: SplatCase, rng: np.random.Generator) -> SimpleNamespace:
    """Disparities of which many are whole or half, so that places lie on edges, and masks of both views."""
    i = splat_inputs(case, rng)
    halves = np.round(2 * i.disparity) / 2
    i.disparity = np.where(rng.random(case.size) < 0.5, halves, i.disparity)
    i.known = _float32(rng.random(case.size) < 0.7)
    i.valid = _float32(rng.random((len(case.offsets), *case.size)) < 0.7)
    return i


@dataclass(frozen=True)
class ViewsCase:
    """`count` views stored as `dtype`, of which a line is taken, and what their normalisation is stored as."""

    name: str
    size: tuple[int, int] = (11, 14)
    count: int = 3
    channels: int = 3
    dtype: str = "float32"
    detail_dtype: str = "float32"
    masked: bool = False
    valid_share: float = 0.7
    sigma: float = 1.5
    floor: float = 0.05
    line: tuple[int, ...] = (2, 0)
    vertical: bool = False

    def __str__(self) -> str:
        return self.name.replace(" ", "-")

    @property
    def tolerance(self) -> float:
        """Relative error of a float32 backend, and half a step of what the outputs are stored as."""
        return 1e-5 + (2.0**-11 if self.detail_dtype == "float16" else 0.0)


VIEWS_CASES = (
    ViewsCase("colour float32"),
    ViewsCase("grey float32", channels=1, vertical=True),
    ViewsCase("colour uint8 masked", dtype="uint8", masked=True),
    ViewsCase("grey uint8", channels=1, dtype="uint8", vertical=True),
    ViewsCase("colour uint16", dtype="uint16", vertical=True),
    ViewsCase("grey uint16 masked", channels=1, dtype="uint16", masked=True),
    ViewsCase("colour float16", dtype="float16", masked=True),
    ViewsCase("grey float16", channels=1, dtype="float16", vertical=True),
    ViewsCase("detail as float16", detail_dtype="float16", dtype="uint8", masked=True),
    ViewsCase("grey detail as float16", detail_dtype="float16", channels=1),
    ViewsCase("float16 all along", dtype="float16", detail_dtype="float16"),
    ViewsCase("raw intensities", sigma=0.0, dtype="uint8", masked=True),
    ViewsCase("raw intensities as float16", sigma=0.0, dtype="uint16", detail_dtype="float16", channels=1),
    ViewsCase("narrow", sigma=0.4),
    ViewsCase("fractional reach", sigma=2.2, masked=True),
    ViewsCase("half a pixel of reach", sigma=0.2),  # 2.5 * 0.2 is 0.5: rounded up, and wider still than 0
    ViewsCase("wider than the view", sigma=6.0, size=(4, 5), masked=True),
    ViewsCase("few valid pixels", sigma=0.8, masked=True, valid_share=0.02, size=(19, 17)),
    ViewsCase("no valid pixel", masked=True, valid_share=0.0),
    ViewsCase("all valid", masked=True, valid_share=2.0, channels=1),
    ViewsCase("one pixel wide", size=(13, 1), vertical=True),
    ViewsCase("one pixel high", size=(1, 13), channels=1, masked=True),
    ViewsCase("one pixel", size=(1, 1), vertical=True),
    ViewsCase("one view", count=1, line=(0,)),
    ViewsCase("a view twice", line=(1, 1, 2, 0)),
    ViewsCase("high floor", floor=0.5, channels=1),
    ViewsCase("work for several threads", size=(61, 38), count=9, dtype="uint8", line=(8, 1, 4, 0, 7), vertical=True),
)


def views_inputs(case: ViewsCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random views with soft structure, so that contrast differs from place to place, and masks."""
    height, width = case.size
    y, x = np.mgrid[:height, :width]
    contrast = 0.5 + 0.45 * np.sin(0.5 * x + 0.3 * y)
    noise = rng.uniform(-0.5, 0.5, (case.count, height, width, case.channels))
    valid = _float32(rng.random((case.count, height, width)) < case.valid_share)
    return SimpleNamespace(
        views=stored(0.5 + contrast[..., None] * noise, case.dtype),
        valid=valid * np.float32(0.75) if case.masked else None,  # not 0 is valid, whatever it is
        index=case.count - 1,
        fill=10.0,
        line=case.line,
        vertical=case.vertical,
        detail_dtype=np.dtype(case.detail_dtype).type,
        scale=scale_of(case.dtype),
        sigma=case.sigma,
        floor=case.floor,
    )


@dataclass(frozen=True)
class NlmCase:
    """An image and the window and patch of its weights."""

    name: str
    size: tuple[int, int] = (11, 14)
    channels: int = 3
    window: int = 5
    patch: int = 3
    sigma_color: float = 0.25
    sigma_gradient: float = 0.15
    floor: float = 1e-3
    over_patch: str = "mean"
    gradients: str = "central"
    tolerance: float = 1e-5

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


NLM_CASES = (
    NlmCase("colour"),
    NlmCase("grey", channels=1),
    NlmCase("window of the paper", window=11, size=(17, 19)),
    NlmCase("single pixel patch", patch=1),
    NlmCase("patch wider than window", window=3, patch=5),
    NlmCase("one pixel wide", size=(13, 1)),
    NlmCase("one pixel high", size=(1, 13), channels=1),
    NlmCase("one pixel", size=(1, 1), channels=1),
    NlmCase("window wider than image", size=(4, 3), window=11),
    NlmCase("weights at their floor", sigma_color=0.01, sigma_gradient=0.01, floor=0.05),
    NlmCase("alike everywhere", sigma_color=10.0, sigma_gradient=10.0),
    NlmCase("work for several threads", size=(61, 53), window=7),
    NlmCase("sums over patches", over_patch="sum", sigma_color=0.75),
    NlmCase("gradients from the middle", gradients="patch", window=7),
    NlmCase("the paper's", over_patch="sum", gradients="patch", sigma_color=1.5, sigma_gradient=1.5, floor=0.0),
    NlmCase("the paper's in grey", over_patch="sum", gradients="patch", floor=0.0, channels=1, patch=5, size=(4, 9)),
)


def nlm_inputs(case: NlmCase, rng: np.random.Generator) -> SimpleNamespace:
    """A random image, random weights (as a backend would make them: 0 where the neighbour is outside) and values."""
    height, width = case.size
    weights = rng.random((len(half_window(case.window)), height, width))
    y, x = np.mgrid[:height, :width]
    for k, (dy, dx) in enumerate(half_window(case.window)):
        weights[k][(y + dy >= height) | (x + dx < 0) | (x + dx >= width)] = 0
    return SimpleNamespace(
        image=_float32(rng.random((height, width, case.channels))),
        weights=_float32(weights),
        values=_float32(rng.normal(size=case.size)),
        other_values=_float32(rng.normal(size=case.size)),
        options={
            "window": case.window,
            "patch": case.patch,
            "sigma_color": case.sigma_color,
            "sigma_gradient": case.sigma_gradient,
            "floor": case.floor,
            "over_patch": case.over_patch,
            "gradients": case.gradients,
        },
        window=case.window,
    )


@dataclass(frozen=True)
class EpiCase:
    """EPIs of one line of views at `offsets`, with a true disparity around `shear`."""

    name: str
    size: tuple[int, int] = (5, 24)
    channels: int = 3
    dtype: str = "float32"
    offsets: tuple[float, ...] = (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)
    shear: float = 0.0
    floor: float = 1e-3
    tolerance: float = 1e-5

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


EPI_CASES = (
    EpiCase("colour"),
    EpiCase("grey", channels=1),
    EpiCase("colour uint8", dtype="uint8", shear=1.0),
    EpiCase("grey uint8", channels=1, dtype="uint8", shear=-1.0),
    EpiCase("colour uint16", dtype="uint16"),
    EpiCase("grey uint16", channels=1, dtype="uint16", shear=2.0),
    EpiCase("colour float16", dtype="float16"),
    EpiCase("fractional shear", shear=-1.375),
    EpiCase("shear of many digits", shear=-0.7310585),
    EpiCase("shear beyond the image", shear=16.0),
    EpiCase("reference at the left end", offsets=(0.0, 1.0, 2.0, 3.0, 4.0), shear=1.0),
    EpiCase("irregular offsets", offsets=(-2.25, -0.875, 0.0, 1.109375, 3.5), shear=0.5),
    EpiCase("two views", offsets=(0.0, 1.0), channels=1),
    EpiCase("one pixel wide", size=(9, 1)),
    EpiCase("one pixel high", size=(1, 17), shear=-0.5),
    EpiCase("high floor", floor=0.25),
    EpiCase("a view missing", offsets=(-2.0, -1.0, 0.0, 2.0, 3.0), dtype="uint8"),
    EpiCase("work for several threads", size=(41, 67), dtype="uint8", shear=0.5),
)


def epi_inputs(case: EpiCase, rng: np.random.Generator) -> SimpleNamespace:
    """Random patterns that move by about `shear` a view, with noise: coherent here, less so there."""
    y, x = np.mgrid[: case.size[0], : case.size[1]]
    disparity = case.shear + rng.uniform(-0.6, 0.6)
    epis = np.empty((len(case.offsets), *case.size, case.channels))
    for c in range(case.channels):
        waves = rng.uniform(0.3, 1.2, 3), rng.uniform(-0.5, 0.5, 3), rng.uniform(0, 6.3, 3)
        for epi, offset in zip(epis, case.offsets, strict=True):
            phases = (a * (x + disparity * offset) + b * y + phase for a, b, phase in zip(*waves, strict=True))
            epi[..., c] = 0.5 + sum(np.sin(phase) for phase in phases) / 7
    epis += rng.uniform(-0.06, 0.06, epis.shape) * (y[..., None] % 3)
    filters = structure_filters(np.array(case.offsets), LocalConfig())
    return SimpleNamespace(
        epis=stored(epis.clip(0, 1), case.dtype),
        offsets=_float32(np.array(case.offsets)),
        filters=type(filters)(*map(_float32, filters)),
        scale=scale_of(case.dtype),
        shear=case.shear,
        floor=case.floor,
    )


@dataclass(frozen=True)
class CoherenceCase:
    """An estimate and the best so far; disparities and coherences that tie and lie on bounds as often as not."""

    name: str
    size: tuple[int, int] = (11, 14)
    shear: float = 0.5
    reach: float = 1.0
    unit: float = 1.0
    bounds: tuple[float, float] = (-0.25, 1.75)
    trusted: bool = True
    vertical: bool = False
    tolerance: float = 1e-6

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


COHERENCE_CASES = (
    CoherenceCase("trusted here and there"),
    CoherenceCase("bounds within reach", bounds=(-0.25, 1.25)),
    CoherenceCase("trusted everywhere", trusted=False),
    CoherenceCase("vertical", vertical=True),
    CoherenceCase("vertical trusted everywhere", vertical=True, trusted=False),
    CoherenceCase("wide views", unit=2.0, shear=-1.5, bounds=(-1.0, 0.0)),
    CoherenceCase("narrow views", unit=0.5, vertical=True, bounds=(-1.0, 2.0)),
    CoherenceCase("views at thirds", unit=3.0, shear=2.0, bounds=(0.3, 0.9)),
    CoherenceCase("out of bounds", bounds=(5.0, 6.0)),
    CoherenceCase("one pixel", size=(1, 1)),
    CoherenceCase("one row", size=(1, 13), vertical=True),
    CoherenceCase("work for several threads", size=(61, 38), vertical=True),
)


def coherence_inputs(case: CoherenceCase, rng: np.random.Generator) -> SimpleNamespace:
    """Two estimates one after the other, and the best so far, which has other sides than they where `vertical`."""
    shape = case.size[::-1] if case.vertical else case.size
    estimates = [
        SimpleNamespace(
            disparity=_coarse(case.shear + rng.uniform(-1.5, 1.5, shape) * case.reach, 0.125),
            coherence=_coarse(rng.random(shape), 0.125),
            trusted=_float32(rng.random(shape) < 0.7) * np.float32(0.5) if case.trusted else None,
        )
        for _ in range(2)
    ]
    return SimpleNamespace(
        estimates=estimates,
        best_disparity=_float32(rng.normal(size=case.size)),
        best_coherence=_coarse(rng.random(case.size), 0.125),
        options={
            "shear": case.shear,
            "reach": case.reach,
            "unit": case.unit,
            "low": case.bounds[0],
            "high": case.bounds[1],
            "vertical": case.vertical,
        },
    )


@dataclass(frozen=True)
class VectorCase:
    """Fields of one shape."""

    name: str
    shape: tuple[int, ...]
    tolerance: float = 1e-6

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


VECTOR_CASES = (
    VectorCase("map", (11, 14)),
    VectorCase("one pixel", (1, 1)),
    VectorCase("line", (1, 1000)),
    VectorCase("stack", (3, 7, 5)),
    VectorCase("work for several threads", (301, 257)),
)


def vector_inputs(case: VectorCase, rng: np.random.Generator) -> SimpleNamespace:
    """Fields, of which `ties` and `holes` have many an element that is 0, and two numbers."""
    x, y, condition = _float32(rng.normal(size=(3, *case.shape)))
    alpha, beta = (float(number) for number in _float32(rng.normal(size=2)))
    ties = np.where(rng.random(case.shape) < 0.3, np.float32(0), condition)
    holes = np.where(rng.random(case.shape) < 0.3, np.float32(0), np.float32(0.1) * np.sign(y) + y)
    return SimpleNamespace(x=x, y=y, ties=ties, holes=holes, alpha=alpha, beta=beta, low=-0.5, high=0.75)


@dataclass(frozen=True)
class ResidualsCase:
    """The residuals that a linear solver finds one after the other, and when it is to stop."""

    name: str
    norm: float = 2.5
    residuals: tuple[float, ...] = (2.5, 1.0, 0.125, 1e-3, 1e-6, 1e-9)
    tolerance: float = 1e-2
    most: int = 20

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


RESIDUALS_CASES = (
    ResidualsCase("small enough at last"),
    ResidualsCase("small enough at once", residuals=(1e-9,)),
    ResidualsCase("as small as the tolerance", norm=4.0, residuals=(4.0, 1.0), tolerance=0.5),
    ResidualsCase("as many as may be", residuals=(3.0, 2.0, 1.0, 0.5), most=3),
    ResidualsCase("none may be", residuals=(3.0,), most=0),
    ResidualsCase("nothing to solve", norm=0.0, residuals=(0.0,)),
    ResidualsCase("relative to 1", norm=0.0, residuals=(0.25, 1e-2), tolerance=0.2),
    ResidualsCase("rounded below 0", residuals=(1.0, -1e-12)),
    ResidualsCase("up and down", residuals=(1.0, 4.0, 0.5, 8.0, 1e-5)),
    ResidualsCase("beyond float32", norm=1e-60, residuals=(1e-60, 1e-62), tolerance=1e-3),
)


def residuals_inputs(case: ResidualsCase, rng: np.random.Generator) -> SimpleNamespace:
    return SimpleNamespace(norm=case.norm, residuals=case.residuals, tolerance=case.tolerance, most=case.most)


@dataclass(frozen=True)
class LbfgsCase:
    """A function of a field within bounds, where a solver starts, and how many values it judges."""

    name: str
    function: str = "quadratic"
    size: tuple[int, int] = (5, 6)
    bounds: tuple[float, float] = (-1.0, 1.0)
    start: float | None = None  # everywhere; None is anywhere within the bounds
    values: int = 8
    memory: int = 4
    first_step: float = 0.1
    flat: float = 1e-9
    patience: int = 3
    most: int = 50
    curvature: bool = False
    """Whether the solver is told one for each pixel."""
    tolerance: float = 1e-4

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


LBFGS_CASES = (
    LbfgsCase("quadratic"),
    LbfgsCase("no bound near", bounds=(-100.0, 100.0), first_step=1.0),
    LbfgsCase("bounds everywhere", bounds=(-0.0625, 0.0625)),
    LbfgsCase("memory of one pair", memory=1),
    LbfgsCase("memory not full", memory=20),
    LbfgsCase("first step too long", first_step=50.0, bounds=(-1000.0, 1000.0), start=0.25),
    LbfgsCase("curved valley", function="rosenbrock", size=(2, 3), bounds=(-2.0, 2.0), start=-1.25, values=7),
    LbfgsCase("start on a bound", bounds=(-2.0, 0.5), start=0.5),
    LbfgsCase("start at the minimum", function="bowl", start=0.0),
    LbfgsCase("start in the corner where it ends", function="slope", start=-1.0),
    LbfgsCase("straight slope", function="slope", start=0.75, values=12),
    LbfgsCase("hill", function="hill", values=6),
    LbfgsCase("stairs", function="stairs", size=(2, 2), bounds=(-50.0, 50.0), start=-30.0, memory=1, values=20),
    LbfgsCase("wall", function="wall", bounds=(-100.0, 100.0), start=1.0, first_step=12.0, values=10),
    LbfgsCase("nothing lower", function="lie", values=25),
    LbfgsCase("flat at last", flat=0.02, patience=2, values=20),
    LbfgsCase("as many steps as may be", most=3),
    LbfgsCase("no step may be", most=0),
    LbfgsCase("one pixel", size=(1, 1), function="waves", values=4),
    LbfgsCase("waves", function="waves", bounds=(-3.0, 3.0), values=10),
    LbfgsCase("work for several threads", size=(61, 53), function="waves", bounds=(-3.0, 3.0)),
    LbfgsCase("curvature", curvature=True),
    LbfgsCase("curvature and bounds everywhere", bounds=(-0.0625, 0.0625), curvature=True),
)


@dataclass(frozen=True)
class Trial:
    """What a solver is told about one trial, all in numbers that float32 can hold, but for the value."""

    x: NDArray[np.float32]
    gradient: NDArray[np.float32]
    value: float


def lbfgs_inputs(case: LbfgsCase, rng: np.random.Generator) -> SimpleNamespace:
    """What the reference asks for on its way and is told there: every backend is told the same, whatever it asks for.

    So one that differs a little does not go another way after some steps.
    """
    function = bounded_function(case, rng)
    low, high = case.bounds
    start = rng.uniform(low, high, case.size) if case.start is None else np.full(case.size, case.start)
    options = {
        "memory": case.memory,
        "low": low,
        "high": high,
        "first_step": case.first_step,
        "tolerance": case.flat,
        "patience": case.patience,
        "most": case.most,
    }
    first, curvature = _trial(function, start), None
    if case.curvature:
        curvature = 4.0 ** rng.integers(-2, 3, case.size)
    trials = _trials(case, function, first, options, curvature)
    return SimpleNamespace(first=first, curvature=curvature, trials=trials, options=options)


Function = Callable[[NDArray[np.float64]], tuple[float, NDArray[np.float64]]]
"""Value and gradient at x."""


def bounded_function(case: LbfgsCase, rng: np.random.Generator) -> Function:
    """The function that a case names, of the fields of its size."""
    count = case.size[0] * case.size[1]
    matrix, aim = quadratic(count, rng) if case.function == "quadratic" else (np.eye(1), np.zeros(1))
    phase = rng.uniform(0, 6, case.size)

    def value_and_gradient(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        if case.function == "quadratic":
            product = (matrix @ x.ravel() - aim).reshape(x.shape)
            return float(0.5 * x.ravel() @ matrix @ x.ravel() - aim @ x.ravel()), product
        if case.function == "rosenbrock":
            return _rosenbrock(x)
        if case.function == "waves":
            return float((np.sin(2 * x + phase) + 0.1 * x**2).sum()), 2 * np.cos(2 * x + phase) + 0.2 * x
        if case.function == "wall":  # before it everything falls, at it and beyond it nothing is finite
            return float(-x.sum()) if x.max() < 8 else np.inf if x.max() < 14 else np.nan, -np.ones_like(x)
        value, gradient = {
            "bowl": ((x**2).sum(), 2 * x),
            "slope": (x.sum(), np.ones_like(x)),
            "stairs": ((0.3 * np.cos(3 * x) - x).sum(), -0.9 * np.sin(3 * x) - 1),  # convex and concave by turns
            "hill": (-(x**2).sum(), -2 * x),
            "lie": ((x**2).sum(), -2 * x),
        }[case.function]
        return float(value), gradient

    return value_and_gradient


def quadratic(count: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A random symmetric matrix with eigenvalues from 1 to 30, and a vector: A and b of xᵀ A x / 2 - bᵀ x.

    Without bounds all of the minimum lies more than 0.6 from 0.
    """
    basis, _ = np.linalg.qr(rng.normal(size=(count, count)))
    values = np.geomspace(1, 30, count)
    matrix = basis * values @ basis.T
    return matrix, matrix @ (rng.choice([-1, 1], count) * rng.uniform(0.6, 1.5, count))


def _rosenbrock(x: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    a = x.ravel()
    beside = a[1:] - a[:-1] ** 2
    gradient = np.zeros_like(a)
    gradient[1:] += 20 * beside
    gradient[:-1] -= 40 * beside * a[:-1] + 2 * (1 - a[:-1])
    return float((10 * beside**2 + (1 - a[:-1]) ** 2).sum()), gradient.reshape(x.shape)


def _trial(function: Function, x: NDArray[np.float64]) -> Trial:
    x = _float32(x)
    value, gradient = function(x.astype(np.float64))
    return Trial(x, _float32(gradient), value)


def _trials(
    case: LbfgsCase,
    function: Function,
    first: Trial,
    options: dict[str, Any],
    curvature: NDArray[np.float64] | None,
) -> list[Trial]:
    solver = load("reference").lbfgs(case.size, "cpu", **options)
    x, gradient = first.x.astype(np.float64), first.gradient.astype(np.float64)
    value, proposed = np.array([first.value]), np.empty(case.size)
    solver.begin(x, gradient, value, curvature)
    trials: list[Trial] = []
    while solver.go_on[0] and len(trials) < case.values:
        solver.propose(x, proposed)
        trial = _trial(function, proposed)
        trials.append(trial)
        solver.judge(value, np.array([trial.value]))
        solver.learn(x, gradient, trial.x.astype(np.float64), trial.gradient.astype(np.float64))
    return trials


def stored(intensities: NDArray[np.float64], dtype: str) -> NDArray[Any]:
    """Intensities in [0, 1] as a file of that dtype holds them."""
    if dtype.startswith("float"):
        return intensities.astype(dtype)
    return np.rint(intensities * np.iinfo(dtype).max).astype(dtype)


def scale_of(dtype: str) -> float:
    return 1.0 if dtype.startswith("float") else 1.0 / np.iinfo(dtype).max


def _float32(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def _coarse(values: NDArray[Any], step: float) -> NDArray[np.float32]:
    return _float32(np.round(values / step) * step)
