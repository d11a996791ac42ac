"""The whole energy, data term and prior as the refinement puts them together: its value, and its exact gradient."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import checks
import numpy as np
import pytest

from lfgpu._backends import load
from lfgpu.contract import Device, KernelSet
from lfgpu.data import LightField
from lfgpu.methods.prior import UNLIKE_ANY, NonLocalMeans
from lfgpu.methods.sections import PriorConfig
from lfgpu.methods.synthesis.config import RefinementConfig
from lfgpu.methods.synthesis.energy import Energy
from lfgpu.methods.synthesis.model import ForwardModel

REFERENCE = load("reference")


@dataclass(frozen=True)
class EnergyCase(checks.Case):
    """A light field of random views at `offsets` from its reference, and a map in `disparities`."""

    size: tuple[int, int] = (6, 7)
    channels: int = 3
    dtype: str = "float32"
    offsets: tuple[tuple[float, float], ...] = checks.grid(3, 3)
    disparities: tuple[float, float] = (-1.5, 1.5)
    masked: bool = False
    detail_scale: float = 1.5
    rim: bool = False  # is compared too, although no pixel of the reference tells what it shows


ENERGY_CASES = (
    EnergyCase("colour grid"),
    EnergyCase("grey uint8", channels=1, dtype="uint8"),
    EnergyCase("raw intensities uint16", dtype="uint16", detail_scale=0.0),
    EnergyCase("one row of views", offsets=checks.grid(1, 5)),
    EnergyCase("one column of views", offsets=checks.grid(5, 1), channels=1),
    EnergyCase("two views", offsets=((0.0, 0.0), (1.0, 0.0))),
    EnergyCase("grid with holes", offsets=tuple(checks.grid(3, 3)[k] for k in (0, 1, 3, 4, 8)), dtype="uint8"),
    EnergyCase("irregular offsets", offsets=((0.0, 0.0), *checks.IRREGULAR)),
    EnergyCase("masked", masked=True),
    EnergyCase("masked with its rim", masked=True, rim=True),
    EnergyCase("colour grid with its rim", rim=True),
    EnergyCase("mostly out of the frame", disparities=(-8.0, 8.0), rim=True),
    EnergyCase("one pixel high", size=(1, 13), channels=1),
)


def energy_inputs(case: EnergyCase, rng: np.random.Generator) -> SimpleNamespace:
    """A light field of random views, a random map, and the parameters of the two terms."""
    shape = len(case.offsets), *case.size
    return SimpleNamespace(
        lf=LightField(
            checks.stored(rng.random((*shape, case.channels)), case.dtype),
            np.array(case.offsets),
            reference=case.offsets.index((0.0, 0.0)),
            valid=rng.random(shape) < 0.8 if case.masked else None,
        ),
        disparity=np.round(rng.uniform(*case.disparities, case.size) * 2**10) / 2**10,
        start=None if case.rim else np.round(rng.uniform(*case.disparities, case.size) * 2**10) / 2**10,
        refinement=RefinementConfig(softness=0.125, detail_scale=case.detail_scale),
        prior=PriorConfig(window=5, sigma_color=0.25, sigma_gradient=0.15),
    )


_DIFFERENCE_STEP = 1e-6  # pixels per view step

Evaluate = Callable[[np.ndarray], tuple[float, np.ndarray]]


def tolerance_of(case: EnergyCase, device: str) -> float:
    """Of float32; where normalised views are stored as float16, each of them is off by 2^-11 already."""
    return 1e-5 if device == "cpu" or case.detail_scale == 0 else 1e-3


def check_energy(kernels: KernelSet, device: str, i: SimpleNamespace, tolerance: float) -> None:
    """Value and gradient are the reference's, whose gradient is that of central differences in float64."""
    value, gradient = energy_of(kernels, device, i)(i.disparity)
    true_energy = energy_of(REFERENCE, "cpu", i)
    true_value, true_gradient = true_energy(i.disparity)
    assert gradient.shape == i.disparity.shape
    errors = {
        "value": checks.largest_error(np.float64(value), np.float64(true_value)),
        "gradient": checks.largest_error(gradient, true_gradient),
    }
    if kernels is REFERENCE:
        differences = np.empty_like(true_gradient)
        for place in np.ndindex(i.disparity.shape):
            step = np.zeros_like(i.disparity)
            step[place] = _DIFFERENCE_STEP
            above, below = true_energy(i.disparity + step)[0], true_energy(i.disparity - step)[0]
            differences[place] = (above - below) / (2 * _DIFFERENCE_STEP)
        errors["gradient against central differences"] = checks.largest_error(gradient, differences)
    for name, error in errors.items():
        assert error <= tolerance, f"energy: the {name} is off by {error:.2e}, more than {tolerance:.0e}"


def energy_of(kernels: KernelSet, device: str, i: SimpleNamespace) -> Evaluate:
    """The energy that the refinement minimises, at maps in NumPy."""
    views = kernels.image(i.lf.views, device)
    prior = NonLocalMeans((*i.lf.size, i.lf.channels), i.prior, Device(kernels, device))
    prior.load(reference_image(kernels, device, i.lf))
    model = ForwardModel(i.lf.layout, i.refinement, Device(kernels, device))
    model.load(views, None if i.start is None else kernels.field(i.start, device))
    return at_maps(Energy(model, prior, i.refinement.smoothness), kernels, device)


def reference_image(kernels: KernelSet, device: str, lf: LightField) -> Any:
    """Make the image that the prior is loaded with, as `DepthPipeline` makes it."""
    image = kernels.zeros_image((*lf.size, lf.channels), device)
    kernels.intensities(
        kernels.image(lf.views, device),
        lf.reference_index,
        None if lf.valid is None else kernels.field(lf.valid, device),
        scale=lf.scale,
        fill=UNLIKE_ANY,
        image_out=image,
    )
    return image


def at_maps(energy: Callable[[Any, Any, Any], None], kernels: KernelSet, device: str) -> Evaluate:
    """`energy(disparity, gradient_out, value_out)` for maps in NumPy."""

    def evaluate(disparity: np.ndarray) -> tuple[float, np.ndarray]:
        gradient, value = kernels.field(np.full(disparity.shape, np.nan), device), kernels.scalar(np.nan, device)
        energy(kernels.field(disparity, device), gradient, value)
        return kernels.number(value), kernels.numpy(gradient)

    return evaluate


@pytest.mark.parametrize(
    "case", [*ENERGY_CASES[:3], *(pytest.param(case, marks=pytest.mark.special) for case in ENERGY_CASES[3:])], ids=str
)
def test_energy_and_its_gradient(target: Any, case: EnergyCase, rng: np.random.Generator) -> None:
    check_energy(target.kernels, target.device, energy_inputs(case, rng), tolerance_of(case, target.device))


def test_energy_of_another_light_field_is_that_of_a_fresh_one(target: Any, rng: np.random.Generator) -> None:
    """A light field that was loaded before leaves no trace: neither its views nor its rim."""
    kernels, device = target.kernels, target.device
    first, second = (energy_inputs(EnergyCase("masked", masked=True, dtype="uint8"), rng) for _ in range(2))
    second.lf = replace(second.lf, valid=first.lf.valid)  # a mask is part of what a model is made for
    model = ForwardModel(first.lf.layout, first.refinement, Device(kernels, device))
    prior = NonLocalMeans((*first.lf.size, first.lf.channels), first.prior, Device(kernels, device))
    for i in (first, second):
        prior.load(reference_image(kernels, device, i.lf))
        model.load(kernels.image(i.lf.views, device), kernels.field(i.start, device))
    value, gradient = at_maps(Energy(model, prior, second.refinement.smoothness), kernels, device)(second.disparity)
    want_value, want_gradient = energy_of(kernels, device, second)(second.disparity)
    assert value == pytest.approx(want_value, rel=1e-6)
    np.testing.assert_allclose(gradient, want_gradient, rtol=0, atol=1e-6 * np.abs(want_gradient).max())
