"""The non-local-means weights and their operators: cases and checks."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from checks import Case, Desk, Operation, Outputs, Values, float32, largest_error, relative_to_terms, size

from lfgpu.contract import half_window


@dataclass(frozen=True)
class NlmCase(Case):
    """An image and the window and patch of its weights."""

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
        image=float32(rng.random((height, width, case.channels))),
        weights=float32(weights),
        values=float32(rng.normal(size=case.size)),
        other_values=float32(rng.normal(size=case.size)),
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


def nlm_weights(desk: Desk, i: SimpleNamespace) -> Outputs:
    plan = desk.kernels.nlm_weights(i.image.shape, desk.device, **i.options)
    out = desk.out(i.weights.shape)
    plan(desk.image(1 - i.image[::-1]), out)  # what a plan did before leaves no trace
    plan(desk.image(i.image), out)
    return {"weights": out}


def nlm_neighbors(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.values.shape)
    desk.kernels.nlm_neighbors(desk.field(i.weights), desk.field(i.values), window=i.window, sums_out=out)
    return {"sums": out}


def nlm_laplacian(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Alone, and with a diagonal."""
    weights, values, diagonal = desk.field(i.weights), desk.field(i.values), desk.field(i.values[::-1, ::-1])
    alone, beside = desk.out(i.values.shape), desk.out(i.values.shape)
    desk.kernels.nlm_laplacian(weights, values, window=i.window, laplacian_out=alone)
    desk.kernels.nlm_laplacian(weights, values, window=i.window, laplacian_out=beside, diagonal=diagonal)
    return {"laplacian": alone, "and diagonal": beside}


def weights_errors(got: dict[str, Values], want: dict[str, Values], _: SimpleNamespace) -> dict[str, float]:
    """Relative to the largest w max(1, |log w|): a weight is exp(-x), and what float32 rounds is x."""
    w = want["weights"]
    return {"weights": largest_error(got["weights"], w, float((w * np.maximum(1, -np.log(w.clip(1e-300)))).max()))}


NEIGHBORS = Operation(nlm_neighbors, "nlm", relative_to_terms(sums=lambda i: size(i.values)))
LAPLACIAN = Operation(
    nlm_laplacian, "nlm", relative_to_terms(**dict.fromkeys(("laplacian", "and diagonal"), lambda i: size(i.values)))
)
WEIGHTS = Operation(nlm_weights, "nlm", weights_errors)
OPERATIONS = (WEIGHTS, NEIGHBORS, LAPLACIAN)
