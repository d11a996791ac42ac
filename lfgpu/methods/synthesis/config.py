"""The parameters of synthesis, and its preset."""

from dataclasses import dataclass

from lfgpu.config import Config, Section, choice, number
from lfgpu.methods.sections import LocalConfig, PriorConfig


@dataclass(frozen=True)
class SynthesisPriorConfig(PriorConfig):
    """Prior: non-local-means weights, which say how likely two nearby pixels lie on the same surface (paper, eq. 2)."""

    floor: float = number(
        1e-4, 0.0, 1.0, "smallest weight between two pixels of a neighbourhood; above 0 it keeps every pixel "
        "connected; 0, as in the paper"
    )  # fmt: skip
    over_patch: str = choice(
        "mean", ("mean", "sum"), "whether the distance of two patches is the mean or the sum over their pixels; sum, "
        "as in the paper"
    )  # fmt: skip
    gradients: str = choice(
        "central", ("central", "patch"), "gradients that are compared: central differences at each patch pixel; or the "
        "differences between each patch pixel and the middle of its patch, as in the paper"
    )  # fmt: skip
    sigma_unit: str = choice(
        "noise", ("noise", "intensity", "image"), "unit of sigma_color and sigma_gradient: intensity that grows with "
        "the noise of the views, from 0.004 on; intensity; or the standard deviation of the colours and of the "
        "gradients of the reference view, as in the paper"
    )  # fmt: skip


@dataclass(frozen=True)
class PropagationConfig(Section):
    """Propagation: gaps in the local estimate are filled by minimising a quadratic energy (paper §5)."""

    solver: str = choice("cg", ("cg", "lbfgsb"), "cg: conjugate gradients; lbfgsb: L-BFGS-B, as in the paper")
    tolerance: float = number(
        1e-5, 1e-8, 1e-1, "residual (cg) or gradient (lbfgsb), relative to the right side, at which the solver stops"
    )  # fmt: skip
    max_iterations: int = number(300, 1, 10000, "largest number of iterations of the solver")


@dataclass(frozen=True)
class RefinementConfig(Section):
    """Refinement: the map is changed until it predicts all views best, under the prior (paper §6)."""

    error: str = choice(
        "mean", ("mean", "sum"), "whether the squared error is the mean or the sum over views and channels; sum, "
        "as in the paper"
    )  # fmt: skip
    smooths: str = choice(
        "change", ("change", "local", "map"), "what the prior holds together: the change of the propagated map, so "
        "that surfaces without texture stay as they were; the map, which it also holds to the local estimate, as all "
        "of equation 1 of the paper does; or the map alone"
    )  # fmt: skip
    smoothness: float = number(
        2.0, 0.0, 1e6, "weight of the prior relative to the squared error; with error=mean that is averaged over the "
        "channels and over the views but the reference", symbol="λ; λ / ((views - 1) · channels)",
    )  # fmt: skip
    rim: str = choice(
        "masked", ("masked", "compared"), "pixels of the views that show what lies outside the reference view: masked "
        "leaves them out; compared, as in the paper"
    )  # fmt: skip
    acceptance: str = choice(
        "by-pixel", ("by-pixel", "whole"), "by-pixel: each pixel goes from the propagated map towards the refined one "
        "as far as the views that see it agree better; whole: the refined map, as in the paper"
    )  # fmt: skip
    longest_change: float = number(
        0.2, 1e-3, 100.0, "largest change of the propagated map with acceptance=by-pixel, pixels in the farthest "
        "view; it grows with the noise"
    )  # fmt: skip
    softness: float = number(
        0.1, 0.001, 0.5, "width of the rounded kinks of the triangle kernel, pixels", symbol="ε of Λ"
    )
    detail_scale: float = number(
        1.5, 0.0, 20.0, "standard deviation of the Gaussian window of local contrast normalisation, pixels; 0 compares "
        "raw intensities, as the paper does",
    )  # fmt: skip
    contrast_floor: float = number(
        0.01, 1e-4, 1.0, "local contrast that is taken for noise, intensity; it grows with the noise"
    )  # fmt: skip
    solver: str = choice(
        "lbfgs", ("lbfgs", "lbfgsb"), "lbfgs: bounded L-BFGS on the device; lbfgsb: SciPy's L-BFGS-B on the host"
    )  # fmt: skip
    tolerance: float = number(
        2.25e-4,
        0.0,
        1e-1,
        "the solver stops when the mean decrease of the energy over five iterations falls below this share of the "
        "first energy",
    )
    max_iterations: int = number(100, 0, 10000, "largest number of iterations of the solver")


@dataclass(frozen=True)
class SynthesisConfig(Config):
    """All parameters of synthesis, by stage."""

    method = "synthesis"

    local: LocalConfig = LocalConfig()
    prior: SynthesisPriorConfig = SynthesisPriorConfig()
    propagation: PropagationConfig = PropagationConfig()
    refinement: RefinementConfig = RefinementConfig()


PRESETS = {
    "paper": SynthesisConfig(),
    "paper-exact": SynthesisConfig(
        local=LocalConfig(inner_scale=0.5, outer_scale=1.0, gradient_floor=1e-6),
        prior=SynthesisPriorConfig(
            sigma_color=1.0, sigma_gradient=1.0, floor=0.0, over_patch="sum", gradients="patch", sigma_unit="image"
        ),
        propagation=PropagationConfig(solver="lbfgsb"),
        refinement=RefinementConfig(
            error="sum",
            smooths="local",
            smoothness=100.0,
            rim="compared",
            acceptance="whole",
            detail_scale=0.0,
            solver="lbfgsb",
            tolerance=1e-6,
            max_iterations=300,
        ),
    ),
}
"""`paper-exact` is the method of Sajjadi et al. 2016 in the forms that are printed there. `paper` is the same method
with changes that make it right on more light fields; docs/paper.md has them all.
"""
