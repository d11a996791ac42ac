"""Whole pipelines: every backend on every device ends where the reference ends."""

import re
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

from lfgpu import scenes
from lfgpu.data import DepthResult, LightField
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.pipelines.estimate import estimate_depth
from tests.made import masked, thorough

RANGE = (-1.5, 1.5)
CONVERGED = SynthesisConfig().with_values(
    {"prior.window": 7, "refinement.tolerance": 1e-6, "refinement.max_iterations": 500}
)
"""Minima are compared, not the iterations at which minimisations happened to stop."""
MOSTLY_NEAR = 1e-3  # pixels per view step: the 95 % quantile of the differences between two maps
SAME_CONFIDENCE = 0.02  # the largest difference: what hides what is decided by whole pixels
MOSTLY_SAME_CONFIDENCE = 2e-3  # the 98 % quantile of the differences
DEFINED = 0.005  # the share of pixels whose coherence may lie on the other side of the threshold


class Scene(NamedTuple):
    """A scene that a pipeline is tried on."""

    name: str
    options: tuple[tuple[str, Any], ...] = (("grid", (3, 5)), ("size", (32, 36)))
    damaged: bool = False  # with views missing and pixels masked

    def __str__(self) -> str:
        return f"{self.name}{'-damaged' if self.damaged else ''}"


SCENES = (
    Scene("relief"),
    Scene("boxes"),
    Scene("relief", (("grid", (3, 5)), ("size", (36, 32)), ("channels", 1), ("dtype", "uint16")), damaged=True),
)


@cache
def light_field(scene: Scene) -> LightField:
    lf = scenes.make(scene.name, **dict(scene.options))
    if not scene.damaged:
        return lf
    some = lf.subset([index for index in range(len(lf.views)) if index not in (0, 9)])
    return masked(some, np.s_[2, 10:20, 5:25], np.s_[some.reference_index, :3, :4])


@cache
def estimated(scene: Scene, backend: str, device: str) -> DepthResult:
    lf = light_field(scene)
    return estimate_depth(lf, config=CONVERGED, disparity_range=RANGE, backend=backend, device=device)


def assert_same(one: DepthResult, other: DepthResult) -> None:
    assert one.stages.keys() == other.stages.keys()
    for stage in one.stages:
        defined = [np.isfinite(result.stages[stage]) for result in (one, other)]
        assert (defined[0] != defined[1]).mean() <= DEFINED, stage
        difference = np.abs(one.stages[stage] - other.stages[stage])[defined[0] & defined[1]]
        assert np.quantile(difference, 0.95) <= MOSTLY_NEAR, stage
    apart = np.abs(one.confidence - other.confidence)
    assert apart.max() <= SAME_CONFIDENCE
    assert np.quantile(apart, 0.98) <= MOSTLY_SAME_CONFIDENCE
    assert reasons(one) == reasons(other)
    assert one.converged
    assert other.converged


def reasons(result: DepthResult) -> str:
    """The status without its numbers: the last iterations differ by what float32 rounds off."""
    return re.sub(r"\d[\d.e+-]*", "#", result.status)


@pytest.mark.parametrize("scene", [thorough(SCENES[0]), *SCENES[1:]], ids=str)
def test_pipeline_ends_where_the_reference_ends(other: Any, scene: Scene) -> None:
    result = estimated(scene, other.backend, other.device)
    assert (result.backend, result.device) == (other.backend, other.device)
    assert_same(result, estimated(scene, "reference", "cpu"))
