"""The checks of the operations with occlusions can fail: the reference with one single fault is caught by them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import checks
import numpy as np
import occlusion_checks
import programs
import pytest
import splat_checks
from cases import IRREGULAR
from lfgpu.kernels.reference import occlusion
from occlusion_cases import OcclusionCase, occlusion_inputs
from single_faults import Check, Fault, single_fault_tests
from ways_to_be_wrong import (
    NO_MASK,
    accumulating,
    after,
    argument,
    half_gradient,
    keeping_its_mask,
    loading_once,
    method,
    one_off,
    option,
    planned,
    remembering,
    swapped,
    without_last_view,
    zeroed,
)

from lfgpu.contract import KernelSet

CASE = OcclusionCase("any", offsets=IRREGULAR, masked=True, dtype="uint8", loss="charbonnier", disparities=(-3.0, 3.0))
UNMASKED = replace(CASE, masked=False)


def value_of(operation: checks.Operation, case: OcclusionCase = CASE) -> Check:
    return lambda kernels, rng: checks.check_value(kernels, "cpu", operation, occlusion_inputs(case, rng), 1e-5)


def of_masks(check: Callable[..., Any]) -> Check:
    return lambda kernels, rng: check(kernels, "cpu", occlusion_inputs(CASE, rng), occlusion_checks.DATA_TERM)


def FRONT(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    occlusion_checks.check_front_hides_back(kernels, "cpu", occlusion_inputs(CASE, rng))


def SAFE(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    far = replace(CASE, size=(23, 26), disparities=(-50.0, 50.0), sharpness=1000.0)
    occlusion_checks.check_safe_whatever_the_range(kernels, "cpu", occlusion_inputs(far, rng))


def PROGRAM(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    make = occlusion_checks.comparing_what_is_nearest
    programs.check_program(kernels, "cpu", make, programs.program_inputs(make, rng))


def weights_held(plan: Any) -> Any:
    """The gradient leaves out that nearness changes."""

    def wrong(disparity: Any, gradient_out: Any, value_out: Any) -> None:
        right = occlusion.Blend.gradient

        def held(blend: Any, residual: Any) -> Any:
            blend._sharpness = 0.0
            return right(blend, residual)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(occlusion.Blend, "gradient", held)
            plan(disparity, gradient_out, value_out)

    return type("Wrong", (), {"__call__": staticmethod(wrong), "load": staticmethod(plan.load)})()


def without_z_buffer(right: Callable[..., Any]) -> Callable[..., Any]:
    """Weights are not relative to the nearest: beyond the range of floats."""

    def wrong(image: Any, disparity: Any, offsets: Any, *, sharpness: float, **options: Any) -> None:
        with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
            patch.setattr(occlusion, "nearest", lambda disparity, taps: np.zeros(disparity.shape))
            right(image, disparity, offsets, sharpness=sharpness, **options)

    return wrong


def hidden_by_all(right: Callable[..., Any]) -> Callable[..., Any]:
    """Seen is only what lies free with all its taps, not with any."""

    def wrong(disparity: Any, offsets: Any, *, tolerance: float, visible_out: Any) -> None:
        right(disparity, offsets, tolerance=tolerance, visible_out=visible_out)
        for view, offset in zip(visible_out, offsets, strict=True):
            taps = occlusion.reaching_taps(disparity, offset, 0.5)
            front = occlusion.nearest(disparity, taps)
            for tap in taps:
                view[tap.inside] *= front[tap.target] <= disparity[tap.inside] + tolerance

    return wrong


SPLAT, DATA_TERM, VISIBLE = map(value_of, occlusion_checks.OPERATIONS)

FAULTS = (
    Fault("sharpness ignored", "splat_z_buffered", option("sharpness", lambda _: 0.0), SPLAT),
    Fault("the farthest is seen", "splat_z_buffered", option("sharpness", lambda s: -s), FRONT),
    Fault("a little blunt", "splat_z_buffered", option("sharpness", lambda s: 0.99 * s), SPLAT),
    Fault("with a sharp tent", "splat_z_buffered", option("softness", lambda _: 1e-3), SPLAT),
    Fault("rows and columns of offsets exchanged", "splat_z_buffered", argument(2, swapped), SPLAT),
    Fault("against the convention of signs", "splat_z_buffered", argument(2, np.negative), FRONT),
    Fault("last view skipped", "splat_z_buffered", after(zeroed(-1), "views_out"), SPLAT),
    Fault("coverage of the last row skipped", "splat_z_buffered", after(zeroed(np.s_[:, -1]), "coverage_out"), SPLAT),
    Fault("first channel only", "splat_z_buffered", after(zeroed(np.s_[..., 1:]), "views_out"), SPLAT),
    Fault("adds to its output", "splat_z_buffered", accumulating("views_out"), SPLAT),
    Fault("adds to its coverage", "splat_z_buffered", accumulating("coverage_out"), SPLAT),
    Fault("without z-buffer", "splat_z_buffered", without_z_buffer, SAFE),
    Fault("uncovered is covered", "splat_z_buffered", after(lambda c: c.clip(0.1, None, out=c), "coverage_out"), FRONT),
    Fault("factor 2 of the gradient missing", "z_buffered_data_term", planned(half_gradient), DATA_TERM),
    Fault("nearness held fixed", "z_buffered_data_term", planned(weights_held), DATA_TERM),
    Fault("one pixel off", "z_buffered_data_term", planned(lambda plan: off_at_one_pixel(plan)), DATA_TERM),
    Fault("remembers", "z_buffered_data_term", planned(remembering), DATA_TERM),
    Fault("scale ignored", "z_buffered_data_term", option("scale", lambda _: 1.0), DATA_TERM),
    Fault("softness ignored", "z_buffered_data_term", option("softness", lambda _: 0.5), DATA_TERM),
    Fault("sharpness ignored", "z_buffered_data_term", option("sharpness", lambda _: 0.0), DATA_TERM),
    Fault("sharpness ignored, seen in a program", "z_buffered_data_term", option("sharpness", lambda _: 0.0), PROGRAM),
    Fault("counts all that is covered", "z_buffered_data_term", option("least_coverage", lambda _: 1e-9), DATA_TERM),
    Fault("counts too little", "z_buffered_data_term", option("least_coverage", lambda least: 1.1 * least), DATA_TERM),
    Fault("squares", "z_buffered_data_term", option("loss", lambda _: "squares"), DATA_TERM),
    Fault("another loss", "z_buffered_data_term", option("loss", lambda _: "geman-mcclure"), DATA_TERM),
    Fault("another scale of loss", "z_buffered_data_term", option("loss_scale", lambda s: 1.01 * s), DATA_TERM),
    Fault("mask ignored", "z_buffered_data_term", NO_MASK, DATA_TERM),
    Fault(
        "mask ignored, no truth",
        "z_buffered_data_term",
        NO_MASK,
        of_masks(splat_checks.check_masked_pixels_do_not_count),
    ),
    Fault(
        "masked view counts",
        "z_buffered_data_term",
        NO_MASK,
        of_masks(splat_checks.check_masked_view_is_a_missing_view),
    ),
    Fault(
        "nothing counts", "z_buffered_data_term", NO_MASK, of_masks(splat_checks.check_nothing_valid_is_nothing_at_all)
    ),
    Fault("last view skipped", "z_buffered_data_term", method("load", without_last_view), DATA_TERM),
    Fault("first light field kept", "z_buffered_data_term", method("load", loading_once), DATA_TERM),
    Fault(
        "mask kept",
        "z_buffered_data_term",
        method("load", keeping_its_mask),
        value_of(occlusion_checks.DATA_TERM, UNMASKED),
    ),
    Fault("wrong sign", "visible", argument(1, np.negative), VISIBLE),
    Fault("rows and columns of offsets exchanged", "visible", argument(1, swapped), VISIBLE),
    Fault("no tolerance", "visible", option("tolerance", lambda _: 0.0), VISIBLE),
    Fault("twice the tolerance", "visible", option("tolerance", lambda t: 2 * t), VISIBLE),
    Fault("nothing hides", "visible", option("tolerance", lambda _: np.inf), FRONT),
    Fault("seen with all its taps", "visible", hidden_by_all, VISIBLE),
    Fault("other way round", "visible", after(lambda v: np.subtract(1, v, out=v), "visible_out"), VISIBLE),
    Fault("last view skipped", "visible", after(zeroed(-1), "visible_out"), VISIBLE),
)


def off_at_one_pixel(plan: Any) -> Any:
    def wrong(disparity: Any, gradient_out: Any, value_out: Any) -> None:
        plan(disparity, gradient_out, value_out)
        one_off(gradient_out)

    return type("Wrong", (), {"__call__": staticmethod(wrong), "load": staticmethod(plan.load)})()


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)


def test_every_operation_with_occlusions_has_a_fault_that_its_check_catches() -> None:
    assert {fault.operation for fault in FAULTS} == {str(operation) for operation in occlusion_checks.OPERATIONS}
