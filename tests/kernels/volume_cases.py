"""The cases of the operations on cost volumes, as data, and the random inputs that are made of them."""

from dataclasses import dataclass
from types import SimpleNamespace

import nlm_cases
import numpy as np

from lfgpu.contract import REDUCTION


@dataclass(frozen=True)
class VolumeCase(nlm_cases.NlmCase):
    """A volume of `count` slices with costs in `costs`, and what changes of the disparity cost on a path."""

    count: int = 5
    costs: tuple[float, float] = (0.0, 1.0)
    small: float = 0.125
    large: float = 0.5
    contrast: float = 0.25
    first: float = -1.0
    step: float = 0.375


VOLUME_CASES = (
    VolumeCase("colour"),
    VolumeCase("grey", channels=1),
    VolumeCase("as few slices as there can be", count=3),
    VolumeCase("slices for several threads of a path", size=(7, 9), count=35),
    VolumeCase("many slices", size=(6, 7), count=131, channels=1),
    VolumeCase("very many slices", size=(3, 5), count=300),
    VolumeCase("window of the paper", window=11, size=(17, 19), count=9),
    VolumeCase("one pixel wide", size=(13, 1)),
    VolumeCase("one pixel high", size=(1, 13), channels=1),
    VolumeCase("one pixel", size=(1, 1), channels=1),
    VolumeCase("window wider than image", size=(4, 3), window=11),
    VolumeCase("wide", size=(5, 83), window=7),
    VolumeCase("high", size=(71, 6), window=3, channels=1),
    VolumeCase("costs below 0", costs=(-3.0, -1.0)),
    VolumeCase("costs that outweigh changes", costs=(0.0, 100.0)),
    VolumeCase("changes that outweigh costs", costs=(0.0, 0.01)),
    VolumeCase("image without contrast", contrast=100.0),
    VolumeCase("edges everywhere", contrast=0.01),
    VolumeCase("large changes cost little", large=0.01),
    VolumeCase("changes cost nothing", small=0.0, large=0.0),
    VolumeCase("work for several threads", size=(61, 53), window=7, count=17),
)

REDUCED_CASES = (
    *(case for case in VOLUME_CASES if min(case.size) >= REDUCTION),
    VolumeCase("one reduced pixel", size=(4, 4)),
    VolumeCase("one reduced pixel and what is left over", size=(7, 5)),
    VolumeCase("nothing left over", size=(8, 20)),
    VolumeCase("one row of reduced pixels", size=(6, 29)),
    VolumeCase("one column of reduced pixels", size=(27, 4)),
)
"""Those whose views have a reduced pixel."""

JUDGED = ((-3.5, 2.0), (-2.0, 4.0), (-7.0, 1.0), (-4.6, 1.5), (-1.3, 0.0), (0.0, 2.5))
"""The conflict, evidence, bend and relief that are judged, and the evidence and the cost farther around."""


def volume_inputs(case: VolumeCase, rng: np.random.Generator) -> SimpleNamespace:
    """A random volume, another one of so few different costs that many are least, and the inputs of the weights."""
    i = nlm_cases.nlm_inputs(case, rng)
    shape = (case.count, *case.size)
    i.volume = rng.uniform(*case.costs, shape).astype(np.float32)
    i.alike = (rng.integers(0, 4, shape) / 4).astype(np.float32)
    i.step_costs = {"small": case.small, "large": case.large, "contrast": case.contrast}
    i.penalty_scale = rng.uniform(0.5, 4.0, case.size).astype(np.float32)
    i.row = {"first": case.first, "step": case.step}
    last = case.first + case.step * (case.count - 1)
    i.map = rng.uniform(case.first - 0.5, last + 0.5, case.size).astype(np.float32)
    i.unit = 0.5 * (case.costs[1] - case.costs[0])
    # Some of the best paths cost what the best disparity costs.
    i.path_costs = (8 * i.volume + rng.choice([0.0, 1.0], shape) * i.unit).astype(np.float32)
    i.conflict, i.sure, i.bend, i.relief, i.wide, i.dear = (
        rng.uniform(low, high, case.size).astype(np.float32) for low, high in JUDGED
    )
    i.reduced = rng.uniform(*case.costs, (case.count, *(side // REDUCTION for side in case.size))).astype(np.float32)
    i.shares = rng.uniform(0.2, 1.0, i.reduced.shape[1:]).astype(np.float32)
    i.weight, i.edge_contrast = 0.7, 0.4
    i.span = 3.3
    i.weights_of_judge = {
        "share": (0.5, -1.25, 0.75, -0.5, 0.25, 0.125),
        "spread": (-3.0, 0.5, -0.25, 1.0, -0.75, -0.25),
    }
    return i
