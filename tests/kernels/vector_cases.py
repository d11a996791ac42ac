"""The cases of the operations on fields and numbers."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
from cases import Case, float32


@dataclass(frozen=True)
class VectorCase(Case):
    """Fields of one shape."""

    shape: tuple[int, ...]
    tolerance: float = 1e-6


VECTOR_CASES = (
    VectorCase("map", (11, 14)),
    VectorCase("one pixel", (1, 1)),
    VectorCase("line", (1, 1000)),
    VectorCase("stack", (3, 7, 5)),
    VectorCase("work for several threads", (301, 257)),
)


def vector_inputs(case: VectorCase, rng: np.random.Generator) -> SimpleNamespace:
    """Fields, of which `ties` and `holes` have many an element that is 0, and two numbers."""
    x, y, condition = float32(rng.normal(size=(3, *case.shape)))
    alpha, beta = (float(number) for number in float32(rng.normal(size=2)))
    ties = np.where(rng.random(case.shape) < 0.3, np.float32(0), condition)
    holes = np.where(rng.random(case.shape) < 0.3, np.float32(0), np.float32(0.1) * np.sign(y) + y)
    return SimpleNamespace(x=x, y=y, ties=ties, holes=holes, alpha=alpha, beta=beta, low=-0.5, high=0.75)
