"""The parameters of synthesis, and its preset."""

from __future__ import annotations

from dataclasses import dataclass

from lfgpu.config import Config, Section, choice, number
from lfgpu.methods.sections import LocalConfig, PriorConfig
from lfgpu.methods.synthesis.data_terms import NAMES


@dataclass(frozen=True)
class PropagationConfig(Section):
    """Propagation: gaps in the local estimate are filled by minimising a quadratic energy (paper §4.2)."""

    solver: str = choice("cg", ("cg", "lbfgsb"), "cg: conjugate gradients; lbfgsb: L-BFGS-B, as in the paper")
    tolerance: float = number(
        1e-5, 1e-8, 1e-1, "relative residual (cg) or relative decrease of the energy (lbfgsb) at which the solver stops"
    )  # fmt: skip
    max_iterations: int = number(300, 1, 10000, "largest number of iterations of the solver")


@dataclass(frozen=True)
class RefinementConfig(Section):
    """Refinement: the map is changed until it predicts all views best, under the prior (paper §6)."""

    data_term: str = choice(
        "additive", NAMES, "prediction of a pixel on which several surfaces land: additive sums them, as in the paper; "
        "z-buffer keeps the nearest"
    )  # fmt: skip
    smoothness: float = number(
        0.2, 0.0, 1e6, "weight of the prior relative to the squared error, which is averaged over views and channels",
        symbol="λ / (views · channels)",
    )  # fmt: skip
    softness: float = number(
        0.1, 0.001, 0.5, "width of the rounded kinks of the triangle kernel, pixels", symbol="ε of Λ"
    )
    detail_scale: float = number(
        1.5, 0.0, 20.0, "standard deviation of the Gaussian window of local contrast normalisation, pixels; 0 compares "
        "raw intensities, as the paper does",
    )  # fmt: skip
    contrast_floor: float = number(0.01, 1e-4, 1.0, "local contrast that is taken for noise, intensity")
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
    """All parameters of synthesis, by stage.

    Raises
    ------
    LightFieldError
        If a value is out of range.
    """

    method = "synthesis"

    local: LocalConfig = LocalConfig()
    prior: PriorConfig = PriorConfig()
    propagation: PropagationConfig = PropagationConfig()
    refinement: RefinementConfig = RefinementConfig()


PRESETS = {"paper": SynthesisConfig()}
"""`paper` is the method of Sajjadi et al. 2016 with three changes, which docs/how/synthesis.md explains: views are
compared after local contrast normalisation, weights have a floor, and pixels near the border of a view that the
reference view does not see are left out. With `refinement.detail_scale` 0 the data term is the paper's.
"""
