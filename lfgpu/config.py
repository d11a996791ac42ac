"""Every parameter of the method: its default, its range, its unit, what it does, and the paper's symbol for it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Any

from lfgpu.errors import LightFieldError


def _number(default: float, low: float, high: float, doc: str, *, symbol: str = "", odd: bool = False) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "doc": doc, "symbol": symbol, "odd": odd})


def _choice(default: str, choices: tuple[str, ...], doc: str, *, symbol: str = "") -> Any:
    return field(default=default, metadata={"choices": choices, "doc": doc, "symbol": symbol})


class _Checked:
    """Checks on creation that each field lies in the range that its metadata gives."""

    def __post_init__(self) -> None:
        for f in dataclasses.fields(self):  # type: ignore[arg-type]  # only dataclasses derive from this
            value, meta = getattr(self, f.name), f.metadata
            if "choices" in meta:
                if value not in meta["choices"]:
                    raise LightFieldError(f"{f.name} must be one of {', '.join(meta['choices'])}, not {value!r}.")
            elif isinstance(value, bool) or not isinstance(value, Real):
                raise LightFieldError(f"{f.name} must be a number, not {value!r}.")
            elif isinstance(f.default, int) and not isinstance(value, Integral):
                raise LightFieldError(f"{f.name} must be a whole number, not {float(value):g}.")
            elif not meta["low"] <= value <= meta["high"]:
                raise LightFieldError(f"{f.name} must lie in {meta['low']:g} to {meta['high']:g}, not {value:g}.")
            elif meta["odd"] and value % 2 == 0:
                raise LightFieldError(f"{f.name} must be odd, not {value:g}.")


@dataclass(frozen=True)
class LocalConfig(_Checked):
    """The local estimate: structure tensors on epipolar plane images (paper §4, Wanner and Goldluecke 2012)."""

    inner_scale: float = _number(
        1.0, 0.4, 4.0, "Gaussian of the gradients, pixels and view steps (standard deviation)", symbol="σ"
    )
    outer_scale: float = _number(
        0.5, 0.2, 4.0, "Gaussian of the tensor's entries, pixels and view steps (standard deviation)", symbol="τ"
    )
    shear_step: float = _number(
        1.0, 0.25, 2.0, "distance of the base disparities to which EPIs are sheared, pixels per view step"
    )
    gradient_floor: float = _number(0.001, 1e-6, 0.1, "gradients up to this are noise, intensity per pixel")
    coherence_threshold: float = _number(
        0.8, 0.0, 1.0, "estimates of lower coherence are dropped and filled by propagation", symbol="threshold on C"
    )


@dataclass(frozen=True)
class PriorConfig(_Checked):
    """The non-local-means weights of propagation and refinement."""

    window: int = _number(11, 3, 31, "side of the neighbourhood, pixels", symbol="N", odd=True)
    patch: int = _number(3, 1, 9, "side of the patches that are compared, pixels", symbol="patch P", odd=True)
    sigma_color: float = _number(
        0.015, 1e-3, 10.0, "root mean square colour difference of patches that lowers their weight to 1/e, intensity",
        symbol="σ_color / √|P|",
    )  # fmt: skip
    sigma_gradient: float = _number(
        0.015, 1e-3, 10.0, "the same for the difference of image gradients, intensity per pixel",
        symbol="σ_grad / √|P|",
    )  # fmt: skip
    floor: float = _number(
        1e-4, 1e-6, 1.0, "weight of the least similar pair in a window; keeps every pixel connected"
    )  # fmt: skip


@dataclass(frozen=True)
class PropagationConfig(_Checked):
    """Filling the gaps of the local estimate (paper §4.2): a quadratic problem."""

    solver: str = _choice("cg", ("cg", "lbfgsb"), "conjugate gradients, or L-BFGS-B as in the paper")
    tolerance: float = _number(
        1e-5, 1e-8, 1e-1, "stop at this residual (cg) or relative decrease (lbfgsb)"
    )  # fmt: skip
    max_iterations: int = _number(300, 1, 10000, "stop after as many iterations")


@dataclass(frozen=True)
class RefinementConfig(_Checked):
    """The generative model and its minimisation (paper §3)."""

    smoothness: float = _number(
        0.2, 0.0, 1e6, "weight of the prior against the mean squared error over views and channels",
        symbol="λ / (views · channels)",
    )  # fmt: skip
    softness: float = _number(0.1, 0.001, 0.5, "width of the rounded kinks of the tent, pixels", symbol="ε of Λ")
    detail_scale: float = _number(
        1.5, 0.0, 20.0, "views are compared without their local mean and contrast over this scale, pixels; "
        "0 compares raw intensities, as the paper does",
    )  # fmt: skip
    contrast_floor: float = _number(0.01, 1e-4, 1.0, "contrast that is taken for noise, intensity")
    solver: str = _choice(
        "lbfgs", ("lbfgs", "lbfgsb"), "bounded L-BFGS on the device, or scipy's L-BFGS-B on the host"
    )  # fmt: skip
    tolerance: float = _number(
        2.25e-4,
        0.0,
        1e-1,
        "stop when an iteration, five on average, lowers the energy by less than this share of the first",
    )
    max_iterations: int = _number(100, 0, 10000, "stop after as many iterations")


@dataclass(frozen=True)
class MethodConfig(_Checked):
    """Which of the two methods is used; the other parameters that belong to it alone say so."""

    name: str = _choice(
        "synthesis", ("synthesis", "matching"), "synthesis as in the paper (local, propagation, refinement), or "
        "matching with occlusions (sweep, matching, alignment, outlines, filling)"
    )  # fmt: skip


@dataclass(frozen=True)
class SweepConfig(_Checked):
    """Matching: comparing views with the reference at a row of disparities."""

    views: str = _choice(
        "full", ("full", "star", "cross"), "views that are used: all, or those in rows, columns and diagonals through "
        "the reference, or without diagonals; all where that leaves fewer than four beside it"
    )  # fmt: skip
    occlusions: str = _choice(
        "twice", ("once", "twice"), "by apertures only, or again by what the surface found first hides"
    )  # fmt: skip
    step: float = _number(0.4, 0.02, 2.0, "distance of the disparities, pixels in the farthest view")
    most_labels: int = _number(256, 3, 4096, "most disparities; a wider range makes the steps longer")
    noise: float = _number(
        0.0, 0.0, 1.0, "how much views differ where they agree, intensity; 0 measures it on the first views and makes "
        "all differences of intensity in matching as many times larger as it is larger than 0.004"
    )  # fmt: skip
    truncation: float = _number(0.1, 1e-3, 10.0, "difference in intensity beyond which views just differ")
    gradient_weight: float = _number(1.0, 0.0, 100.0, "weight of image gradients against intensities")
    gradient_truncation: float = _number(0.04, 1e-4, 10.0, "the same for image gradients, intensity per pixel")
    aperture: float = _number(
        90.0, 10.0, 180.0, "angle around the reference of the views that may see past an occluder, degrees"
    )  # fmt: skip
    preference: float = _number(
        0.2, 0.0, 10.0, "share by which the views of such an angle must agree better than all of them to be believed"
    )  # fmt: skip
    tolerance: float = _number(
        1.2, 0.0, 100.0, "what is nearer by less than this hides nothing, pixels in the farthest view"
    )  # fmt: skip
    least_share: float = _number(
        0.04, 0.0, 1.0, "share of the views that must see a pixel, but at least one, for it to be compared again"
    )  # fmt: skip


@dataclass(frozen=True)
class MatchingConfig(_Checked):
    """Matching: the best surface through the costs (semi-global matching, Hirschmüller 2008)."""

    window: int = _number(3, 3, 31, "side of the neighbourhood over which costs are averaged, pixels", odd=True)
    small_step: float = _number(0.00025, 0.0, 10.0, "cost of a change by one of the disparities", symbol="P1")
    large_step: float = _number(0.005, 0.0, 10.0, "cost of a larger change", symbol="P2")
    contrast: float = _number(2.0, 1e-3, 10.0, "difference in intensity that lowers both to 1/e")


@dataclass(frozen=True)
class AlignmentConfig(_Checked):
    """Matching: Gauss-Newton steps on what all views that see a pixel have in common."""

    iterations: int = _number(2, 1, 100, "number of steps, each over all pixels")
    gradient_weight: float = _number(2.0, 0.0, 100.0, "weight of image gradients against intensities")
    robust: float = _number(0.005, 1e-4, 10.0, "difference from the common mean that is taken for noise, intensity")
    support: float = _number(
        0.4, 1e-3, 100.0, "difference in disparity that halves the weight of a neighbour, pixels in the farthest view"
    )  # fmt: skip
    stiffness: float = _number(
        0.1, 0.0, 100.0, "curvature over robust², 1 / pixel², below which a pixel follows those around it"
    )  # fmt: skip
    longest_step: float = _number(0.4, 1e-3, 10.0, "longest step, pixels in the farthest view")


@dataclass(frozen=True)
class OutlinesConfig(_Checked):
    """Matching: pixels at outlines that are mixtures of what is nearer and what is behind it."""

    share: float = _number(
        0.4, 0.0, 1.0, "share of what is nearer in a pixel's colour below which it belongs to what is behind"
    )  # fmt: skip
    contrast: float = _number(0.02, 1e-4, 10.0, "difference in intensity of both sides that tells them apart")


@dataclass(frozen=True)
class FillingConfig(_Checked):
    """Matching: surfaces without texture between those that have some; a quadratic problem."""

    stiffness: float = _number(
        0.01, 1e-6, 100.0, "curvature over robust², 1 / pixel², that holds a pixel as a neighbour does that looks alike"
    )  # fmt: skip
    tolerance: float = _number(3e-7, 1e-8, 1e-1, "stop at this residual")
    max_iterations: int = _number(100, 0, 10000, "stop after as many iterations")


@dataclass(frozen=True)
class Config:
    """All parameters, by stage. Raises LightFieldError where a value is out of range."""

    method: MethodConfig = MethodConfig()
    local: LocalConfig = LocalConfig()
    prior: PriorConfig = PriorConfig()
    propagation: PropagationConfig = PropagationConfig()
    refinement: RefinementConfig = RefinementConfig()
    sweep: SweepConfig = SweepConfig()
    matching: MatchingConfig = MatchingConfig()
    alignment: AlignmentConfig = AlignmentConfig()
    outlines: OutlinesConfig = OutlinesConfig()
    filling: FillingConfig = FillingConfig()

    @property
    def is_on_device(self) -> bool:
        """Whether all solvers run on the device, so that a whole run can be captured."""
        return self.method.name == "matching" or (self.propagation.solver == "cg" and self.refinement.solver == "lbfgs")

    def with_values(self, values: Mapping[str, Any]) -> Config:
        """A copy with some parameters changed, named as `stage.parameter`; numbers may be given as text."""
        config, known = self, dict(parameters(self))
        for name, value in values.items():
            if name not in known:
                raise LightFieldError(f"unknown parameter {name!r}; there are {', '.join(known)}.")
            if isinstance(value, str) and "choices" not in known[name].metadata:
                try:
                    value = float(value)
                except ValueError as error:
                    raise LightFieldError(f"{name} must be a number, not {value!r}.") from error
                if value.is_integer() and isinstance(known[name].default, int):
                    value = int(value)
            stage, parameter = name.split(".")
            changed = dataclasses.replace(getattr(config, stage), **{parameter: value})
            config = dataclasses.replace(config, **{stage: changed})
        return config


def parameters(config: Config) -> Iterator[tuple[str, dataclasses.Field[Any]]]:
    """All parameters as (`stage.parameter`, field); the field's metadata holds range, meaning and paper symbol."""
    for stage in dataclasses.fields(config):
        for parameter in dataclasses.fields(getattr(config, stage.name)):
            yield f"{stage.name}.{parameter.name}", parameter


_LIKE = PriorConfig(window=9, sigma_color=0.021, sigma_gradient=10.0)  # colour only: edges of shade are no edges

PRESETS = {
    "accurate": Config(method=MethodConfig(name="matching"), prior=_LIKE),
    "fast": Config(
        method=MethodConfig(name="matching"),
        prior=_LIKE,
        sweep=SweepConfig(views="cross", occlusions="once", aperture=180.0),
        alignment=AlignmentConfig(iterations=1),
    ),
    "paper": Config(),
}
"""Complete parameter sets by name.

`accurate` matches all views, each where it sees the surface; it is the best there is. `fast` matches those in the row
and the column of the reference, and once.

`paper` is the method of Sajjadi et al. 2016, but for the local contrast normalisation of the views before they are
compared, the floor of the weights and the rim that is left out: README says why. With `refinement.detail_scale` 0 the
data term is the paper's.
"""


def preset(name: str) -> Config:
    """The parameters of a preset; LightFieldError if there is none of that name."""
    if name not in PRESETS:
        raise LightFieldError(f"unknown preset {name!r}; there is {', '.join(PRESETS)}.")
    return PRESETS[name]
