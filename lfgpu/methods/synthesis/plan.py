"""Synthesis: the method of the paper (Sajjadi et al. 2016), in three stages.

`local` estimates disparity by structure tensors on epipolar plane images, where these are coherent. `propagate` fills
the gaps from similar pixels nearby. `refine` changes the map until it predicts all recorded views best, under the same
prior; with `refinement.acceptance` "by-pixel" each pixel takes of that what makes the views agree better.
"""

from dataclasses import replace

import numpy as np

from lfgpu.contract import Array, Device, Float32Array, OverPatch, PatchGradients
from lfgpu.data.layout import ViewLayout
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.base import Callback, Work
from lfgpu.methods.measured import Measured
from lfgpu.methods.prior import UNLIKE_ANY, NonLocalMeans
from lfgpu.methods.structure_tensor import LocalEstimator
from lfgpu.methods.synthesis.acceptance import Acceptance
from lfgpu.methods.synthesis.config import SynthesisConfig, SynthesisPriorConfig
from lfgpu.methods.synthesis.energy import Energy
from lfgpu.methods.synthesis.model import ForwardModel
from lfgpu.methods.synthesis.propagation import Propagation
from lfgpu.solvers.lbfgs import BoundedLbfgs
from lfgpu.solvers.lbfgsb import ScipyLbfgsb
from lfgpu.solvers.solution import Solution

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
        refinement = refinement.within(
            contrast_floor=times * refinement.contrast_floor, longest_change=times * refinement.longest_change
        )
    prior = prior.within(sigma_color=colour * prior.sigma_color, sigma_gradient=gradient * prior.sigma_gradient)
    return replace(config, prior=prior, refinement=refinement)


def noise_in_units(measured: Measured) -> float:
    """Return the noise in units of the usual one, 1 to 5; 1 if it was not measured."""
    return min(max((measured.noise or 0.0) / USUAL_NOISE, 1.0), _MOST_NOISE)


_SOLVERS: dict[str, type[BoundedLbfgs] | type[ScipyLbfgsb]] = {"lbfgs": BoundedLbfgs, "lbfgsb": ScipyLbfgsb}


def planned_prior(shape: tuple[int, int, int], config: SynthesisPriorConfig, device: Device) -> NonLocalMeans:
    """Plan the prior in the forms that the parameters name, for images of `shape` [y, x, c]."""
    over_patch: OverPatch = "sum" if config.over_patch == "sum" else "mean"
    gradients: PatchGradients = "patch" if config.gradients == "patch" else "central"
    return NonLocalMeans(shape, config, device, over_patch=over_patch, gradients=gradients)


class SynthesisPlan:
    """The method of the presets "paper" and "paper-exact", allocated for light fields of one kind."""

    decided = "propagate"

    def __init__(self, layout: ViewLayout, measured: Measured, config: SynthesisConfig, device: Device) -> None:
        kernels = device.kernels
        config, bounds = in_units_of(measured, config), measured.disparity_range
        shape = (*layout.size, layout.channels)
        self._kernels, self._reference, self._scale = kernels, layout.reference, layout.scale
        self._model = ForwardModel(layout, config.refinement, device)
        self._valid, self._known = self._model.valid, self._model.known
        self._unknown = None if layout.masks is None else device.field(np.full(layout.size, np.nan))
        self._image = device.zeros_image(shape)
        self._local = LocalEstimator(layout, bounds, config.local, device)
        self._prior = planned_prior(shape, config.prior, device)
        self._propagation = Propagation(layout.size, bounds, self._prior, config.propagation)
        self.trust = self._propagation.trusted
        """A number on the device: 0 if the last run found no estimate."""
        self.disparity, self.confidence = (device.zeros(layout.size) for _ in range(2))
        """The results, fields [y, x]."""
        start = self._propagation.filled if config.refinement.smooths == "change" else None
        local = self._propagation if config.refinement.smooths == "local" else None
        self._energy = Energy(self._model, self._prior, config.refinement.smoothness, start, local)
        self._acceptance = None
        if config.refinement.acceptance == "by-pixel":
            longest, noise = config.refinement.longest_change, noise_in_units(measured)
            self._acceptance = Acceptance(layout, self._prior, longest, noise, device)
        self._refinement = _SOLVERS[config.refinement.solver](
            layout.size,
            bounds,
            device,
            tolerance=config.refinement.tolerance,
            max_iterations=config.refinement.max_iterations,
        )

    def follow(self, measured: Measured) -> bool:
        """Return False: its numbers are constants of its operations."""
        return False

    def stages(self, views: Array) -> dict[str, Work]:
        """Return the work of each stage on `views` [n, y, x, c], as stored, by name and in order."""
        return {
            "local": lambda _: self._local.run(views),
            "propagate": lambda callback: self._fill(views, callback),
            "refine": lambda callback: self._refine(views, callback),
        }

    def check(self, name: str, trust: float) -> None:
        """Raise LightFieldError, which names `name`, if that number says that the last run found no estimate."""
        if trust == 0:
            raise LightFieldError(
                f"{name}: no pixel has a coherent estimate within the disparity range: the views have no texture, are "
                "masked, or the range is wrong; give another range, or lower local.coherence_threshold."
            )

    def is_finite(self) -> bool:
        """Tell whether all numbers of the last run were finite; waits for the device."""
        return bool(np.isfinite(self._refinement.report().trace[0]))

    def maps(self, *stages: str) -> dict[str, Float32Array]:
        """Copy the map after each stage to the host, float32 [y, x], NaN where it is undefined; waits for the device.

        Before them stand the local estimates from the row and from the column of views alone, each with its coherence,
        0 to 1 (paper, figure 1).
        """
        found: dict[str, Float32Array] = {}
        for line, maps in self._local.by_line.items():
            disparity, coherence = map(self._map, maps)
            found[f"local_{line}"] = np.where(coherence > 0, disparity, np.float32(np.nan))
            found[f"coherence_{line}"] = self._where_known(coherence)
        local, coherence = self._map(self._local.disparity), self._map(self._local.coherence)
        found["local"] = np.where(coherence > 0, local, np.float32(np.nan))
        found["propagate"] = self._where_known(self._map(self._propagation.filled))
        found["refine"] = self._map(self.disparity)
        return {stage: found[stage] for stage in stages or found}

    def _map(self, field: Array) -> Float32Array:
        return self._kernels.numpy(field).astype(np.float32, copy=False)

    def _where_known(self, values: Float32Array) -> Float32Array:
        if self._known is None:
            return values
        return np.where(self._kernels.numpy(self._known) > 0, values, np.float32(np.nan))

    def uncertainty(self) -> None:
        """None: the method does not tell."""

    def solution(self) -> Solution:
        """Report the outcome of the solvers in the last run; the trace is the energy of the refinement."""
        refined = self._refinement.report()
        status = f"Propagation: {self._propagation.report().status} Refinement: {refined.status}"
        return replace(refined, status=status)

    def _fill(self, views: Array, callback: Callback | None) -> None:
        self._kernels.intensities(
            views, self._reference, self._valid, scale=self._scale, fill=UNLIKE_ANY, image_out=self._image
        )
        self._prior.load(self._image)
        self._propagation.run(self._local.disparity, self._local.coherence, callback)
        self._prior.mean(self._local.coherence, self.confidence)
        if self._known is not None:
            self._kernels.multiply(self.confidence, self._known, self.confidence)

    def _refine(self, views: Array, callback: Callback | None) -> None:
        self._model.load(views, self._propagation.filled)
        self._kernels.copy(self._propagation.filled, self.disparity)
        self._energy.load()
        self._refinement.minimize(self._energy, self.disparity, callback, curvature=self._energy.curvature)
        if self._acceptance is not None:
            self._acceptance.run(self._image, views, self._valid, self._propagation.filled, self.disparity)
            self._acceptance.judge(self.disparity, self.confidence)
            if self._known is not None:
                self._kernels.multiply(self.confidence, self._known, self.confidence)
        if self._known is not None:  # what the reference did not record is not known
            self._kernels.select(self._known, self.disparity, self._unknown, self.disparity)
