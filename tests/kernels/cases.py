"""The cases of the kernel matrix, as data, and the random inputs that are made of them.

Disparities, offsets and shears have so few binary digits that their products are exact in float32: every backend lands
at the same place, so that what differs is its arithmetic. `exact=False` leaves that out and says by how much the place
may differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu.config import LocalConfig, PriorConfig, RefinementConfig
from lfgpu.initial import structure_filters
from lfgpu.lightfield import LightField
from lfgpu.types import half_window

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
    EpiCase("fractional shear", shear=-1.375),
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
    """Two random fields and two numbers."""
    x, y = _float32(rng.normal(size=(2, *case.shape)))
    alpha, beta = (float(number) for number in _float32(rng.normal(size=2)))
    return SimpleNamespace(x=x, y=y, alpha=alpha, beta=beta, low=-0.5, high=0.75)


@dataclass(frozen=True)
class EnergyCase:
    """A light field of random views at `offsets` from its reference, and a map in `disparities`."""

    name: str
    size: tuple[int, int] = (6, 7)
    channels: int = 3
    dtype: str = "float32"
    offsets: tuple[tuple[float, float], ...] = grid(3, 3)
    disparities: tuple[float, float] = (-1.5, 1.5)
    masked: bool = False
    detail_scale: float = 1.5
    tolerance: float = 1e-5

    def __str__(self) -> str:
        return self.name.replace(" ", "-")


ENERGY_CASES = (
    EnergyCase("colour grid"),
    EnergyCase("grey uint8", channels=1, dtype="uint8"),
    EnergyCase("raw intensities uint16", dtype="uint16", detail_scale=0.0),
    EnergyCase("one row of views", offsets=grid(1, 5)),
    EnergyCase("one column of views", offsets=grid(5, 1), channels=1),
    EnergyCase("two views", offsets=((0.0, 0.0), (1.0, 0.0))),
    EnergyCase("grid with holes", offsets=tuple(grid(3, 3)[k] for k in (0, 1, 3, 4, 8)), dtype="uint8"),
    EnergyCase("irregular offsets", offsets=((0.0, 0.0), *IRREGULAR)),
    EnergyCase("masked", masked=True),
    EnergyCase("mostly out of the frame", disparities=(-8.0, 8.0)),
    EnergyCase("one pixel high", size=(1, 13), channels=1),
)


def energy_inputs(case: EnergyCase, rng: np.random.Generator) -> SimpleNamespace:
    """A light field of random views, a random map, and the parameters of the two terms."""
    shape = len(case.offsets), *case.size
    return SimpleNamespace(
        lf=LightField(
            stored(rng.random((*shape, case.channels)), case.dtype),
            np.array(case.offsets),
            reference=case.offsets.index((0.0, 0.0)),
            valid=rng.random(shape) < 0.8 if case.masked else None,
        ),
        disparity=_coarse(rng.uniform(*case.disparities, case.size), 2.0**-10).astype(np.float64),
        refinement=RefinementConfig(softness=0.125, detail_scale=case.detail_scale),
        prior=PriorConfig(window=5, sigma_color=0.25, sigma_gradient=0.15),
    )


def stored(intensities: NDArray[np.float64], dtype: str) -> NDArray[Any]:
    """Intensities in [0, 1] as a file of that dtype holds them."""
    if dtype == "float32":
        return _float32(intensities)
    return np.rint(intensities * np.iinfo(dtype).max).astype(dtype)


def scale_of(dtype: str) -> float:
    return 1.0 if dtype == "float32" else 1.0 / np.iinfo(dtype).max


def _float32(values: NDArray[Any]) -> NDArray[np.float32]:
    return np.asarray(values, np.float32)


def _coarse(values: NDArray[Any], step: float) -> NDArray[np.float32]:
    return _float32(np.round(values / step) * step)
