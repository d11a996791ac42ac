"""Parameters that more than one method has."""

from __future__ import annotations

from dataclasses import dataclass

from lfgpu.config import Section, number


@dataclass(frozen=True)
class LocalConfig(Section):
    """Structure tensors on epipolar plane images (paper §5, Wanner and Goldluecke 2012).

    They are the local estimate of synthesis. Both methods find the disparity range with them.
    """

    inner_scale: float = number(
        1.0, 0.4, 4.0, "standard deviation of the Gaussian that takes gradients, pixels and view steps", symbol="σ"
    )
    outer_scale: float = number(
        0.5, 0.2, 4.0, "standard deviation of the Gaussian that smooths the tensor, pixels and view steps", symbol="τ"
    )
    shear_step: float = number(
        1.0, 0.25, 2.0, "distance between the base disparities to which EPIs are sheared, pixels per view step"
    )
    gradient_floor: float = number(0.001, 1e-6, 0.1, "gradients up to this count as noise, intensity per pixel")
    coherence_threshold: float = number(
        0.8, 0.0, 1.0, "estimates of lower coherence are dropped", symbol="threshold on C"
    )


@dataclass(frozen=True)
class PriorConfig(Section):
    """Non-local-means weights: how much two pixels near each other belong together."""

    window: int = number(11, 3, 31, "side of the neighbourhood, pixels", symbol="N", odd=True)
    patch: int = number(3, 1, 9, "side of the patches that are compared, pixels", symbol="patch P", odd=True)
    sigma_color: float = number(
        0.015, 1e-3, 10.0, "root mean square difference of two patches in colour that lowers the weight to 1/e, "
        "intensity", symbol="σ_color / √|P|",
    )  # fmt: skip
    sigma_gradient: float = number(
        0.015, 1e-3, 10.0, "root mean square difference of two patches in image gradients that lowers the weight to "
        "1/e, intensity per pixel", symbol="σ_grad / √|P|",
    )  # fmt: skip
    floor: float = number(
        1e-4, 1e-6, 1.0, "least weight of two pixels in a window; it keeps every pixel connected"
    )  # fmt: skip
