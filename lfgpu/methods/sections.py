"""Parameters that more than one method has."""

from dataclasses import dataclass

from lfgpu.config import Section, number


@dataclass(frozen=True)
class LocalConfig(Section):
    """Local estimate: structure tensors on epipolar plane images (paper §5, Wanner and Goldluecke 2012).

    The paper has the values of `paper-exact`. The defaults are those of `paper`, exchanged: on `cotton` and `kitchen`
    fewer pixels are wrong with them (docs/paper.md).
    """

    inner_scale: float = number(
        1.0, 0.4, 4.0, "standard deviation of the Gaussian derivative filter, pixels and view steps", symbol="τ"
    )
    outer_scale: float = number(
        0.5, 0.2, 4.0, "standard deviation of the Gaussian that smooths the tensor, pixels and view steps", symbol="σ"
    )
    shear_step: float = number(
        1.0, 0.25, 2.0, "spacing of the base disparities to which EPIs are sheared, pixels per view step"
    )
    gradient_floor: float = number(0.001, 1e-6, 0.1, "gradient magnitude that is taken for noise, intensity per pixel")
    coherence_threshold: float = number(
        0.8, 0.0, 1.0, "estimates with a lower coherence are discarded", symbol="threshold on C"
    )


@dataclass(frozen=True)
class PriorConfig(Section):
    """Prior: non-local-means weights, which say how likely two nearby pixels lie on the same surface."""

    window: int = number(11, 3, 31, "side of the square neighbourhood, pixels", symbol="N", odd=True)
    patch: int = number(3, 1, 9, "side of the square patches that are compared, pixels", symbol="patch P", odd=True)
    sigma_color: float = number(
        0.015, 1e-6, 10.0, "difference of colours at which the weight falls to 1/e: root mean square over a patch, or "
        "root of the sum with over_patch=sum; in the unit that sigma_unit names", symbol="σ_color",
    )  # fmt: skip
    sigma_gradient: float = number(
        0.015, 1e-3, 10.0, "difference of gradients at which the weight falls to 1/e, as sigma_color", symbol="σ_grad",
    )  # fmt: skip
    floor: float = number(
        1e-4, 1e-6, 1.0, "smallest weight between two pixels of a neighbourhood; it keeps every pixel connected"
    )  # fmt: skip
