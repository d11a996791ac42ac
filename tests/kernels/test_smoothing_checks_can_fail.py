"""The checks of smoothed and reduced views can fail: the reference with one single fault is caught by them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import checks
import numpy as np
import programs
import smoothing_checks
from lfgpu.kernels.reference import smoothing
from single_faults import Check, Fault, single_fault_tests
from smoothing_cases import STEP, SmoothingCase, smoothing_inputs
from ways_to_be_wrong import argument, changing_its_input, option, rewritten

from lfgpu.contract import KernelSet

CASE = SmoothingCase("any", size=(26, 31), count=2, masked=True)
BEYOND = SmoothingCase("beyond", size=(14, 17), count=2, dtype="float32", gain=1.7)


def value_of(operation: checks.Operation, case: SmoothingCase = CASE) -> Check:
    return lambda kernels, rng: checks.check_value(kernels, "cpu", operation, smoothing_inputs(case, rng), STEP)


SMOOTH, REDUCE = map(value_of, smoothing_checks.OPERATIONS)
SMOOTH_BRIGHT, REDUCE_BRIGHT = (value_of(operation, BEYOND) for operation in smoothing_checks.OPERATIONS)


def PROGRAM(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    make = smoothing_checks.showing_less_noise
    programs.check_program(kernels, "cpu", make, programs.program_inputs(make, rng))


CONSTANT: Check = lambda kernels, _: smoothing_checks.check_constant_stays(kernels, "cpu")  # noqa: E731
NOISE: Check = lambda kernels, rng: smoothing_checks.check_noise_falls(kernels, "cpu", rng)  # noqa: E731
EDGE: Check = lambda kernels, _: smoothing_checks.check_edge_stays(kernels, "cpu")  # noqa: E731
APART: Check = lambda kernels, rng: smoothing_checks.check_regions_stay_apart(kernels, "cpu", rng)  # noqa: E731
MASKED: Check = lambda kernels, rng: smoothing_checks.check_masked_pixels_say_nothing(  # noqa: E731
    kernels, "cpu", rng
)
CHANNELS: Check = lambda kernels, rng: smoothing_checks.check_channels_are_alike_together(  # noqa: E731
    kernels, "cpu", rng
)


def of_all(views: np.ndarray) -> np.ndarray:
    """Every view is the first one."""
    return views[:1].repeat(len(views), 0)


def text(old: str, new: str) -> Callable[..., Any]:
    return rewritten(smoothing, old, new)


GUIDE, LIKENESS = "guide = _sum_around(image) / ", "((guide[there] - guide) ** 2).mean(2)"
SHARE, OWN = "_sum_around(counts[..., None])", "* inside * counts[there]"
ROUNDED, BLOCKS = "np.floor(WHITE * np.clip(intensities, 0, 1) + 0.5)", "np.where(counts, blocks, 0).sum((2, 4))"
VIEWS, MASK = "views[:, :rows, :columns]", "known[:, :rows, :columns]"
FAULTS = (
    Fault("mask ignored", "smooth_views", argument(1, lambda _: None), SMOOTH),
    Fault("mask ignored, seen without a truth", "smooth_views", argument(1, lambda _: None), APART),
    Fault("mask of another view", "smooth_views", argument(1, of_all), SMOOTH),
    Fault("only 1 is valid", "smooth_views", argument(1, np.floor), SMOOTH),
    Fault("scale ignored", "smooth_views", option("scale", lambda _: 1.0), SMOOTH),
    Fault("scale ignored, seen in a program", "smooth_views", option("scale", lambda _: 1.0), PROGRAM),
    Fault("one less rows", "smooth_views", text("for dy in range(-SMOOTHING_REACH,", "for dy in range(-2,"), SMOOTH),
    Fault("one more column", "smooth_views", text("for dx in range(-SMOOTHING_REACH,", "for dx in range(-4,"), SMOOTH),
    Fault("reach of one less", "smooth_views", text("SMOOTHING_REACH, WHITE", "WHITE; SMOOTHING_REACH = 2"), SMOOTH),
    Fault(
        "reach of one less, noise", "smooth_views", text("SMOOTHING_REACH, WHITE", "WHITE; SMOOTHING_REACH = 2"), NOISE
    ),
    Fault("wider", "smooth_views", text("_SPREAD = 8.0", "_SPREAD = 8.1"), SMOOTH),
    Fault("narrower, seen in the noise", "smooth_views", text("_SPREAD = 8.0", "_SPREAD = 4.0"), NOISE),
    Fault("guide without mean", "smooth_views", text(GUIDE, "guide = image + 0 * "), SMOOTH),
    Fault(
        "guide of masked pixels",
        "smooth_views",
        text("image, counts = np.where(known", "image, counts = np.where(1 | known"),
        SMOOTH,
    ),
    Fault(
        "guide of masked pixels, without a truth",
        "smooth_views",
        text("image, counts = np.where(known", "image, counts = np.where(1 | known"),
        MASKED,
    ),
    Fault("guide over all nine pixels", "smooth_views", text(SHARE, "9"), SMOOTH),
    Fault("likeness to what is not valid", "smooth_views", text("unlike = counts * ", "unlike = "), SMOOTH),
    Fault("border of the guide mirrored", "smooth_views", text('mode="edge"', 'mode="reflect"'), SMOOTH),
    Fault("border of the guide around", "smooth_views", text('mode="edge"', 'mode="wrap"'), SMOOTH),
    Fault("border repeated in the mean", "smooth_views", text("** 2 * inside", "** 2"), SMOOTH),
    Fault("border black", "smooth_views", text('mode="edge"', 'mode="constant"'), SMOOTH),
    Fault("deviation doubled", "smooth_views", option("deviation", lambda d: 2 * d), SMOOTH),
    Fault("deviation ten times, edges", "smooth_views", option("deviation", lambda d: 10 * d), EDGE),
    Fault("deviation a tenth, noise", "smooth_views", option("deviation", lambda d: d / 20), NOISE),
    Fault("channels added", "smooth_views", text(LIKENESS, LIKENESS.replace("mean", "sum")), SMOOTH),
    Fault("channels added, without a truth", "smooth_views", text(LIKENESS, LIKENESS.replace("mean", "sum")), CHANNELS),
    Fault("first channel alone", "smooth_views", text(LIKENESS, LIKENESS.replace("mean(2)", "T[0].T")), SMOOTH),
    Fault("weights not squared", "smooth_views", text("(1 + unlike) ** 2", "(1 + unlike)"), SMOOTH),
    Fault("weights not squared, edges", "smooth_views", text("(1 + unlike) ** 2", "(1 + unlike)"), EDGE),
    Fault("own pixel counts if not valid", "smooth_views", text(OWN, OWN + " ** (dy != 0 or dx != 0)"), SMOOTH),
    Fault("own pixel left out", "smooth_views", text(OWN, OWN + " * (dy != 0 or dx != 0)"), SMOOTH),
    Fault("sums", "smooth_views", text("np.where(weights > 0, weights, 1)", "np.ones_like(weights)"), CONSTANT),
    Fault("rounded down", "smooth_views", text(ROUNDED, ROUNDED.replace(" + 0.5", "")), SMOOTH),
    Fault("white of another power of two", "smooth_views", text(ROUNDED, ROUNDED.replace("WHITE", "65536")), SMOOTH),
    Fault("beyond white", "smooth_views", text(ROUNDED, ROUNDED.replace("0, 1", "0, 2")), SMOOTH_BRIGHT),
    Fault("below black", "smooth_views", text(ROUNDED, ROUNDED.replace("0, 1", "-1, 1")), SMOOTH_BRIGHT),
    Fault("first view only", "smooth_views", argument(0, of_all), SMOOTH),
    Fault("its input changes", "smooth_views", changing_its_input, SMOOTH),
    Fault("mask ignored", "reduce_views", argument(1, np.ones_like), REDUCE),
    Fault("mask ignored, without a truth", "reduce_views", argument(1, np.ones_like), MASKED),
    Fault("means of masked pixels", "reduce_views", text("np.where(counts,", "np.where(1 | counts,"), REDUCE),
    Fault("over all pixels", "reduce_views", text("np.maximum(counts.sum((2, 4)), 1)", "REDUCTION**2"), REDUCE),
    Fault("mask of another view", "reduce_views", argument(1, of_all), REDUCE),
    Fault("only 1 is valid", "reduce_views", argument(1, np.floor), REDUCE),
    Fault("any valid", "reduce_views", text("counts.all((2, 4, 5))", "counts.any((2, 4, 5))"), REDUCE),
    Fault("mask not written", "reduce_views", argument(1, lambda _: None), REDUCE),
    Fault("mask not written, seen in a program", "reduce_views", text("valid_out[:]", "_"), PROGRAM),
    Fault("last rows instead of those left over", "reduce_views", text(VIEWS, "views[:, -rows:, :columns]"), REDUCE),
    Fault("columns left over", "reduce_views", text(VIEWS, "views[:, :rows, -columns:]"), REDUCE),
    Fault("mask of rows left over", "reduce_views", text(MASK, "valid[:, -rows:, :columns]"), REDUCE),
    Fault("mask of columns left over", "reduce_views", text(MASK, "valid[:, :rows, -columns:]"), REDUCE),
    Fault("scale ignored", "reduce_views", option("scale", lambda _: 1.0), REDUCE),
    Fault("every fourth pixel", "reduce_views", text(BLOCKS, "16 * blocks[:, :, 0, :, 0]"), REDUCE),
    Fault("every fourth pixel, noise", "reduce_views", text(BLOCKS, "16 * blocks[:, :, 0, :, 0]"), NOISE),
    Fault("sums", "reduce_views", text("np.maximum(counts.sum((2, 4)), 1)", "1"), CONSTANT),
    Fault("rounded down", "reduce_views", text(ROUNDED, ROUNDED.replace(" + 0.5", "")), REDUCE),
    Fault("beyond white", "reduce_views", text(ROUNDED, ROUNDED.replace("0, 1", "0, 2")), REDUCE_BRIGHT),
    Fault("first view only", "reduce_views", argument(0, of_all), REDUCE),
    Fault("its input changes", "reduce_views", changing_its_input, REDUCE),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)


def test_every_operation_has_a_fault_that_its_check_catches() -> None:
    assert {fault.operation for fault in FAULTS} == {str(operation) for operation in smoothing_checks.OPERATIONS}
