"""The checks of alignment, nearest surfaces, ratios and outlines can fail: the reference with one fault is caught."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import alignment_checks
import checks
import numpy as np
import programs
import pytest
from alignment_cases import AlignmentCase, OutlineCase, RatioCase, alignment_inputs, outline_inputs, ratio_inputs
from cases import IRREGULAR
from lfgpu.kernels.reference import alignment, boundaries
from single_faults import Check, Fault, single_fault_tests
from ways_to_be_wrong import (
    NO_MASK,
    accumulating,
    after,
    argument,
    called,
    keeping_its_mask,
    loading_once,
    method,
    one_off,
    option,
    planned,
    swapped,
    zeroed,
)

from lfgpu.contract import KernelSet

CASE = AlignmentCase("any", offsets=IRREGULAR, masked=True, dtype="uint8")
UNMASKED = replace(CASE, masked=False)
EDGES = replace(CASE, offsets=((1.0, 0.0), (0.0, -1.0), (-1.0, 1.0)))  # many places lie on edges
FEW = AlignmentCase("few", size=(23, 26), disparities=(-9.0, 9.0), reach=0)  # that leave holes of a few pixels


def value_of(operation: checks.Operation, case: AlignmentCase = CASE) -> Check:
    return lambda kernels, rng: checks.check_value(kernels, "cpu", operation, alignment_inputs(case, rng), 1e-5)


def RATIO(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    inputs = ratio_inputs(RatioCase("any", size=(17, 19)), rng)
    checks.check_value(kernels, "cpu", alignment_checks.RATIO, inputs, 1e-5)


def PLANE(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    inputs = ratio_inputs(RatioCase("any", size=(17, 19)), rng)
    checks.check_value(kernels, "cpu", alignment_checks.PLANE, inputs, 1e-5)


def ON_SURFACE(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    inputs = ratio_inputs(RatioCase("any", size=(17, 19)), rng)
    checks.check_value(kernels, "cpu", alignment_checks.ON_SURFACE, inputs, 1e-5)


def UNMIX(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    inputs = outline_inputs(OutlineCase("any", size=(31, 33)), rng)
    checks.check_value(kernels, "cpu", alignment_checks.UNMIX, inputs, 1e-5)


def with_constant(name: str, value: float) -> Callable[..., Any]:
    """Another number under a name of the reference's module."""

    def broken(_: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> None:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(boundaries, name, value)
                boundaries.refine_boundaries(*args, **options)

        return wrong

    return broken


def STEP(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    alignment_checks.check_step_leads_to_the_truth(kernels, "cpu", 3, rng)


def UNSEEN(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    inputs = alignment_inputs(CASE, rng)
    alignment_checks.check_what_no_view_sees_has_no_slope(kernels, "cpu", inputs)


def PROGRAM(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    make = alignment_checks.stepping
    programs.check_program(kernels, "cpu", make, programs.program_inputs(make, rng))


NEAREST, ALIGNMENT = value_of(alignment_checks.NEAREST), value_of(alignment_checks.ALIGNMENT)


def calling(change: Callable[[tuple[Any, ...]], Any]) -> Callable[..., Any]:
    """Of the plan that an operation makes the outputs of each call are changed."""

    def made(right: Any) -> Any:
        def wrong(*arguments: Any) -> None:
            right(*arguments)
            change(arguments)

        return called(right, wrong)

    return planned(made)


def patched(where: Any, name: str, broken: Any) -> Callable[..., Any]:
    """While the plan is called, the reference has another part."""

    def made(right: Any) -> Any:
        def wrong(*arguments: Any) -> None:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(where, name, broken)
                right(*arguments)

        return called(right, wrong)

    return planned(made)


def farthest(right: Callable[..., Any]) -> Callable[..., Any]:
    """Of all that come near, the farthest: what turns round all signs leaves them where they are."""

    def made(shape: Any, offsets: Any, **options: Any) -> Any:
        plan = right(shape, -offsets, **options)

        def wrong(disparity: Any, nearest_out: Any) -> None:
            plan(-disparity, nearest_out)
            nearest_out[nearest_out > alignment.NOWHERE] *= -1

        return wrong

    return made


def adding_to_its_output(right: Any) -> Any:
    def wrong(disparity: Any, nearest: Any, curvature_out: Any, slope_out: Any) -> None:
        held = np.nan_to_num(slope_out)
        right(disparity, nearest, curvature_out, slope_out)
        slope_out += held

    return called(right, wrong)


def counting_all(right: Any) -> Any:
    """The reference view is one of those that are counted."""
    count = len(right._others)

    def wrong(disparity: Any, nearest: Any, curvature_out: Any, slope_out: Any) -> None:
        right(disparity, nearest, curvature_out, slope_out)
        curvature_out *= count / (count + 1)
        slope_out *= count / (count + 1)

    return called(right, wrong)


def up(a: Any) -> Any:
    return np.ceil(a - 0.5).astype(np.int64)


def only_near(values: Any, radius: int, right: Any = alignment.largest_around) -> Any:
    """What is one pixel farther fills no hole."""
    return right(values[1:-1, 1:-1], radius - 1) if radius == FEW.reach + 1 else right(values, radius)


def always_far(values: Any, radius: int, right: Any = alignment.largest_around) -> Any:
    """What is one pixel farther counts everywhere."""
    return right(values, radius) if radius != CASE.reach else np.full_like(right(values, radius), alignment.NOWHERE)


def without_weights(self: Any, residual: Any) -> Any:
    return np.ones(residual.shape[:2])


def without_square(self: Any, residual: Any) -> Any:
    return 1 / (1 + (residual**2).mean(2) / self._robust**2)


def counting_the_same(own: Any, of_views: Any, weights: Any, right: Any = alignment.mean_of) -> Any:
    """Views that take part count the same in all means."""
    return right(own, of_views, [np.ones(own.shape[:2]) * (k > 0) for k in weights])


def looking_farther(right: Any) -> Any:
    """Steps in brightness count a pixel farther."""

    def wrong(*light_field: Any) -> None:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(alignment, "GRADIENT_REACH", alignment.GRADIENT_REACH + 1)
            right(*light_field)

    return wrong


def one_sided(values: Any) -> Any:
    """Differences to the next pixel."""
    padded = np.pad(values, ((0, 1), (0, 1), (0, 0)), mode="edge")
    return np.diff(padded, axis=1)[:-1], np.diff(padded, axis=0)[:, :-1]


def against_the_reference(right: Any) -> Any:
    """What views are compared with is the reference view, not their mean."""

    def wrong(disparity: Any, nearest: Any, curvature_out: Any, slope_out: Any) -> None:
        weigh, image, calls = alignment.Alignment._weight, right._image, []
        count = len(right._others)

        def counted(self: Any, residual: Any) -> Any:
            calls.append(0)
            return np.zeros(residual.shape[:2]) if len(calls) <= count else weigh(self, residual)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(alignment.Alignment, "_weight", counted)
            right(disparity, nearest, curvature_out, slope_out)
        assert right._image is image

    return called(right, wrong)


FAULTS = (
    Fault("against the convention of signs", "z_buffer", argument(1, np.negative), NEAREST),
    Fault("rows and columns of offsets exchanged", "z_buffer", argument(1, swapped), NEAREST),
    Fault("reaches farther", "z_buffer", option("reach", lambda r: r + 1), NEAREST),
    Fault("reaches less far", "z_buffer", option("reach", lambda r: r - 1), NEAREST),
    Fault("farthest", "z_buffer", farthest, NEAREST),
    Fault(
        "halves rounded up",
        "z_buffer",
        patched(alignment, "rounded", up),
        value_of(alignment_checks.NEAREST, EDGES),
    ),
    Fault(
        "holes stay",
        "z_buffer",
        patched(alignment, "largest_around", only_near),
        value_of(alignment_checks.NEAREST, FEW),
    ),
    Fault("holes everywhere", "z_buffer", patched(alignment, "largest_around", always_far), NEAREST),
    Fault("last view skipped", "z_buffer", calling(lambda out: zeroed(-1)(out[-1])), NEAREST),
    Fault("one pixel off", "z_buffer", calling(lambda out: one_off(out[-1])), NEAREST),
    Fault("seen in a program", "z_buffer", argument(1, np.negative), PROGRAM),
    Fault("against the convention of signs", "alignment", argument(1, np.negative), ALIGNMENT),
    Fault("away from the truth", "alignment", calling(lambda out: np.negative(out[-1], out=out[-1])), STEP),
    Fault("twice the way", "alignment", calling(lambda out: np.multiply(out[-1], 2, out=out[-1])), STEP),
    Fault("rows and columns of offsets exchanged", "alignment", argument(1, swapped), ALIGNMENT),
    Fault("scale ignored", "alignment", option("scale", lambda _: 1.0), ALIGNMENT),
    Fault("colours only", "alignment", option("gradient_weight", lambda _: 0.0), ALIGNMENT),
    Fault("gradients weigh a little less", "alignment", option("gradient_weight", lambda w: 0.99 * w), ALIGNMENT),
    Fault("gradients count beside steps", "alignment", option("contrast", lambda _: 1e6), ALIGNMENT),
    Fault("steps count a little less", "alignment", option("contrast", lambda c: 1.01 * c), ALIGNMENT),
    Fault("steps a pixel farther count", "alignment", method("load", looking_farther), ALIGNMENT),
    Fault(
        "all that take part count the same in means",
        "alignment",
        patched(alignment, "mean_of", counting_the_same),
        ALIGNMENT,
    ),
    Fault("as if all agreed", "alignment", option("robust", lambda _: 1e6), ALIGNMENT),
    Fault("a little less robust", "alignment", option("robust", lambda r: 1.01 * r), ALIGNMENT),
    Fault("weights forgotten", "alignment", patched(alignment.Alignment, "_weight", without_weights), ALIGNMENT),
    Fault("weights not squared", "alignment", patched(alignment.Alignment, "_weight", without_square), ALIGNMENT),
    Fault("differences to one side", "alignment", patched(alignment, "differences", one_sided), ALIGNMENT),
    Fault("compared with the reference view", "alignment", planned(against_the_reference), ALIGNMENT),
    Fault("reference counted", "alignment", planned(counting_all), ALIGNMENT),
    Fault("no tolerance", "alignment", option("tolerance", lambda _: 0.0), ALIGNMENT),
    Fault("twice the tolerance", "alignment", option("tolerance", lambda t: 2 * t), ALIGNMENT),
    Fault("nothing hides", "alignment", option("tolerance", lambda _: np.inf), UNSEEN),
    Fault("mask ignored", "alignment", NO_MASK, ALIGNMENT),
    Fault("mask ignored, no truth", "alignment", NO_MASK, UNSEEN),
    Fault(
        "pixels of the mask rounded up",
        "alignment",
        patched(alignment, "rounded", up),
        value_of(alignment_checks.ALIGNMENT, EDGES),
    ),
    Fault("first light field kept", "alignment", method("load", loading_once), ALIGNMENT),
    Fault(
        "mask kept",
        "alignment",
        method("load", keeping_its_mask),
        value_of(alignment_checks.ALIGNMENT, UNMASKED),
    ),
    Fault("adds to its output", "alignment", planned(adding_to_its_output), ALIGNMENT),
    Fault("one pixel off", "alignment", calling(lambda out: one_off(out[-1])), ALIGNMENT),
    Fault("scale ignored, seen in a program", "alignment", option("scale", lambda _: 2.0), PROGRAM),
    Fault("support ignored", "nlm_ratio", option("support", lambda _: 1e6), RATIO),
    Fault("support a little larger", "nlm_ratio", option("support", lambda s: 1.01 * s), RATIO),
    Fault("floor ignored", "nlm_ratio", option("floor", lambda _: 1e-9), RATIO),
    Fault("weights skewed", "nlm_ratio", argument(0, lambda w: np.roll(w, 1, axis=2)), RATIO),
    Fault("guide is the numerator", "nlm_ratio", argument(1, lambda g: -g + 1e-3 * np.arange(g.shape[1])), RATIO),
    Fault("adds to its output", "nlm_ratio", accumulating("ratio_out"), RATIO),
    Fault("one pixel off", "nlm_ratio", after(one_off, "ratio_out"), RATIO),
    Fault("level", "nlm_plane", option("ridge", lambda _: 1e6), PLANE),
    Fault("ridge a little larger", "nlm_plane", option("ridge", lambda r: 1.01 * r), PLANE),
    Fault("support ignored", "nlm_plane", option("support", lambda _: 1e6), PLANE),
    Fault("all are as certain", "nlm_plane", argument(2, np.ones_like), PLANE),
    Fault("weights skewed", "nlm_plane", argument(0, lambda w: np.roll(w, 1, axis=2)), PLANE),
    Fault("adds to its output", "nlm_plane", accumulating("plane_out"), PLANE),
    Fault("one pixel off", "nlm_plane", after(one_off, "plane_out"), PLANE),
    Fault("level, seen in a program", "nlm_plane", option("ridge", lambda _: 1e6), PROGRAM),
    Fault("no smoothing, seen in a program", "nlm_ratio", option("support", lambda _: 1e-6), PROGRAM),
    Fault("support a little larger", "nlm_on_surface", option("support", lambda s: 1.01 * s), ON_SURFACE),
    Fault("weights skewed", "nlm_on_surface", argument(0, lambda w: np.roll(w, 1, axis=2)), ON_SURFACE),
    Fault("last neighbour left out", "nlm_on_surface", after(zeroed(-1), "weights_out"), ON_SURFACE),
    Fault("adds to its output", "nlm_on_surface", accumulating("weights_out"), ON_SURFACE),
    Fault("support ignored, seen in a program", "nlm_on_surface", option("support", lambda _: 1e6), PROGRAM),
    Fault("nothing done", "refine_boundaries", option("share", lambda _: -1e6), UNMIX),
    Fault("share a little larger", "refine_boundaries", option("share", lambda s: 1.2 * s), UNMIX),
    Fault("contrast ignored", "refine_boundaries", option("contrast", lambda _: 0.0), UNMIX),
    Fault("step larger", "refine_boundaries", option("step", lambda s: 1.5 * s), UNMIX),
    Fault("one channel only", "refine_boundaries", argument(0, lambda image: image[..., :1]), UNMIX),
    Fault("what is in front is behind", "refine_boundaries", argument(1, lambda d: -d), UNMIX),
    Fault("mixtures count in full", "refine_boundaries", with_constant("BESIDE", 1.0), UNMIX),
    Fault("distant pixels count as much", "refine_boundaries", with_constant("SPREAD", 1e6), UNMIX),
    Fault("only what touches", "refine_boundaries", with_constant("REACH", 1), UNMIX),
    Fault("one pixel less far", "refine_boundaries", with_constant("REACH", 2), UNMIX),
    Fault("the mean in front, no plane", "refine_boundaries", with_constant("RIDGE", 1e6), UNMIX),
    Fault("intensities for light", "refine_boundaries", argument(0, np.sqrt), UNMIX),
    Fault("adds to its output", "refine_boundaries", accumulating("disparity_out"), UNMIX),
    Fault("one pixel off", "refine_boundaries", after(one_off, "disparity_out"), UNMIX),
    Fault("nothing done, seen in a program", "refine_boundaries", option("share", lambda _: -1e6), PROGRAM),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)


def test_every_operation_of_these_has_a_fault_that_its_check_catches() -> None:
    assert {fault.operation for fault in FAULTS} == {str(operation) for operation in alignment_checks.OPERATIONS}
