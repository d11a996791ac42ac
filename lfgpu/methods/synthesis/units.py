"""The parameters in the units of a light field: its noise, or the spread of its reference view."""

from dataclasses import fields, replace
from typing import Any

import numpy as np

from lfgpu.config import Section
from lfgpu.data.lightfield import LightField
from lfgpu.methods.measured import Measured
from lfgpu.methods.synthesis.config import SynthesisConfig

USUAL_NOISE = 0.004  # intensity: what the defaults are meant for
_MOST_NOISE = 5.0  # in units of that


def spread(lf: LightField, patch: int) -> tuple[float, float]:
    """Standard deviations of the colours and of the gradients of the reference view, intensity (paper, eq. 2).

    The gradients are the differences I(p) - I(p') between a pixel and the others of its patch of side `patch`. A
    variance is the mean over the channels of the variances of each. Masked pixels do not count. At least 1e-6.
    """
    image = lf.image(lf.reference_index).astype(np.float64)
    if lf.valid is not None:
        image = np.where(lf.valid[lf.reference_index][..., None], image, np.nan)
    radius, (height, width) = patch // 2, lf.size
    total, square, count = np.zeros(lf.channels), np.zeros(lf.channels), 0
    for dy, dx in np.ndindex(patch, patch):
        dy, dx = dy - radius, dx - radius
        if (dy, dx) == (0, 0):
            continue
        here = image[max(0, -dy) : height - max(0, dy), max(0, -dx) : width - max(0, dx)]
        beside = image[max(0, dy) : height + min(0, dy), max(0, dx) : width + min(0, dx)]
        apart = (here - beside)[np.isfinite(here - beside).all(2)]
        total, square, count = total + apart.sum(0), square + (apart**2).sum(0), count + len(apart)
    gradients = (square / max(count, 1) - (total / max(count, 1)) ** 2).mean()
    colours = np.nanvar(image, axis=(0, 1)).mean() if np.isfinite(image).any() else 0.0
    return float(max(np.sqrt(colours), 1e-6)), float(max(np.sqrt(gradients), 1e-6))


def in_units_of(measured: Measured, config: SynthesisConfig) -> SynthesisConfig:
    """Scale differences of intensity in the parameters to the units that `prior.sigma_unit` names.

    With "noise" these, and `refinement.longest_change`, grow in proportion to the noise, from 0.004 to 0.02.
    """
    prior, refinement = config.prior, config.refinement
    colour, gradient = 1.0, 1.0
    if prior.sigma_unit == "image":
        assert measured.spread is not None  # it was measured then
        colour, gradient = measured.spread
    elif prior.sigma_unit == "noise":
        assert measured.noise is not None
        times = noise_in_units(measured)
        colour = gradient = times
        refinement = _with(
            refinement,
            contrast_floor=times * refinement.contrast_floor,
            longest_change=times * refinement.longest_change,
        )
    prior = _with(prior, sigma_color=colour * prior.sigma_color, sigma_gradient=gradient * prior.sigma_gradient)
    return replace(config, prior=prior, refinement=refinement)


def noise_in_units(measured: Measured) -> float:
    """Return the noise in units of the usual one, 1 to 5; 1 if it was not measured."""
    return min(max((measured.noise or 0.0) / USUAL_NOISE, 1.0), _MOST_NOISE)


def _with(section: Any, **values: float) -> Any:
    """Parameters changed, as far as their ranges go."""
    assert isinstance(section, Section)
    ranges = {f.name: f.metadata for f in fields(section)}
    return replace(
        section, **{name: min(max(v, ranges[name]["low"]), ranges[name]["high"]) for name, v in values.items()}
    )
