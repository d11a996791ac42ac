"""The checks of the splat and the data term can fail: the reference with one single fault is caught by them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cases
import checks
import numpy as np
import splat_cases
import splat_checks
from single_faults import Check, Fault, single_fault_tests, values_of
from ways_to_be_wrong import (
    NO_MASK,
    accumulating,
    after,
    argument,
    changing_its_input,
    half_gradient,
    invert,
    keeping_its_mask,
    loading_once,
    method,
    mirrored,
    noisy,
    one_off,
    option,
    planned,
    remembering,
    scaled,
    swapped,
    without_last_view,
    zeroed,
)

from lfgpu.contract import KernelSet

SPLAT = splat_cases.SplatCase("splat", offsets=cases.IRREGULAR, masked=True, dtype="uint8")

value_of = values_of(
    splat_checks.OPERATIONS,
    {
        "splat": lambda rng: splat_cases.splat_inputs(SPLAT, rng),
        "seen": lambda rng: splat_cases.seen_inputs(SPLAT, rng),
    },
)


def of_splat(check: Callable[[KernelSet, str, SimpleNamespace], Any]) -> Check:
    return lambda kernels, rng: check(kernels, "cpu", splat_cases.splat_inputs(SPLAT, rng))


REPEATS = of_splat(lambda *of: checks.check_value(of[0], of[1], splat_checks.SPLAT, of[2], 1e-5, again=True))
IMAGE_ADJOINT = of_splat(splat_checks.check_image_adjoint)
DISPARITY_ADJOINT = of_splat(splat_checks.check_disparity_adjoint)
MASKED_PIXELS = of_splat(splat_checks.check_masked_pixels_do_not_count)
MASKED_VIEW = of_splat(splat_checks.check_masked_view_is_a_missing_view)
NOTHING_VALID = of_splat(splat_checks.check_nothing_valid_is_nothing_at_all)


def without_tap(right: Callable[..., Any]) -> Callable[..., Any]:
    """The tap below and to the right is left out of the image of the splat and of its transpose alike."""

    def wrong(image: Any, disparity: Any, offsets: Any, *, softness: float, **outputs: Any) -> None:
        from lfgpu.kernels.reference.splat import taps  # the fault needs a look inside

        right(image, disparity, offsets, softness=softness, **outputs)
        for n, offset in enumerate(offsets):
            *_, tap = taps(disparity, offset, softness)
            np.subtract.at(outputs["views_out"][n], tap.target, tap.weight[:, None] * image[tap.inside])

    return wrong


def half_curvature(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(curvature_out: Any) -> None:
        right(curvature_out)
        curvature_out *= 0.5

    return wrong


def down(right: Callable[..., Any]) -> Callable[..., Any]:
    """Halves are rounded down: places are moved by a little less than half a pixel."""

    def wrong(disparity: Any, offsets: Any, known: Any, valid: Any, *, seen_out: Any) -> None:
        right(disparity, offsets, None, valid, seen_out=seen_out)
        y, x = np.mgrid[: disparity.shape[0], : disparity.shape[1]]
        for seen, (du, dv) in zip(seen_out, offsets, strict=True):
            row, column = (np.ceil(place - 0.5).astype(int) for place in (y + disparity * dv, x + disparity * du))
            if known is not None:
                inside = seen != 0
                seen[inside] = known[row[inside], column[inside]] != 0

    return wrong


def UNMASKED(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return splat_cases.splat_inputs(replace(SPLAT, masked=False), rng)


FAULTS = (
    # the splat
    Fault("without one tap", "splat", without_tap, value_of("splat")),
    Fault("without one tap, seen by the adjoint", "splat", without_tap, IMAGE_ADJOINT),
    Fault("rows and columns of offsets exchanged", "splat", argument(2, swapped), value_of("splat")),
    Fault("against the convention of signs", "splat", argument(2, np.negative), value_of("splat")),
    Fault("with a sharp tent", "splat", option("softness", lambda _: 1e-3), value_of("splat")),
    Fault("last view skipped", "splat", after(zeroed(-1), "views_out", "coverage_out"), value_of("splat")),
    Fault("coverage of the last view skipped", "splat", after(zeroed(-1), "coverage_out"), value_of("splat")),
    Fault("views mirrored", "splat", after(mirrored, "views_out"), IMAGE_ADJOINT),
    Fault("last row of pixels skipped", "splat", after(zeroed(np.s_[:, -1]), "views_out"), value_of("splat")),
    Fault("first channel only", "splat", after(zeroed(np.s_[..., 1:]), "views_out"), value_of("splat")),
    Fault("adds to its output", "splat", accumulating("views_out"), value_of("splat")),
    Fault("adds to its coverage", "splat", accumulating("coverage_out"), value_of("splat")),
    Fault("other bits each time", "splat", after(noisy, "views_out"), REPEATS),
    Fault("changes its input", "splat", changing_its_input, value_of("splat")),
    Fault("wrong sign", "splat_transpose", after(scaled(-1), "image_out"), IMAGE_ADJOINT),
    Fault("one pixel off", "splat_transpose", after(one_off, "image_out"), value_of("splat_transpose")),
    Fault(
        "last view skipped",
        "splat_transpose",
        argument(0, lambda v: v * (np.arange(len(v)) < len(v) - 1)[:, None, None, None]),
        IMAGE_ADJOINT,
    ),
    Fault("wrong sign", "splat_jvp", after(scaled(-1), "views_out"), DISPARITY_ADJOINT),
    Fault("wrong sign, against the reference", "splat_jvp", after(scaled(-1), "views_out"), value_of("splat_jvp")),
    Fault("rows and columns of offsets exchanged", "splat_jvp", argument(3, swapped), DISPARITY_ADJOINT),
    Fault("wrong sign", "splat_vjp", after(scaled(-1), "gradient_out"), value_of("splat_vjp")),
    Fault("wrong sign, seen by the adjoint", "splat_vjp", after(scaled(-1), "gradient_out"), DISPARITY_ADJOINT),
    Fault("horizontal part only", "splat_vjp", argument(3, lambda o: o * (1, 0)), value_of("splat_vjp")),
    Fault("one pixel off", "splat_vjp", after(one_off, "gradient_out"), DISPARITY_ADJOINT),
    Fault("mirrored", "splat_vjp", after(mirrored, "gradient_out"), value_of("splat_vjp")),
    # the data term
    Fault("factor 2 of the gradient missing", "data_term", planned(half_gradient), value_of("data_term")),
    Fault("factor 2 of the curvature missing", "data_term", method("curvature", half_curvature), value_of("data_term")),
    Fault("remembers", "data_term", planned(remembering), value_of("data_term")),
    Fault("scale ignored", "data_term", option("scale", lambda _: 1.0), value_of("data_term")),
    Fault("mask ignored", "data_term", NO_MASK, value_of("data_term")),
    Fault("mask ignored, seen without a truth", "data_term", NO_MASK, MASKED_PIXELS),
    Fault("masked view counts", "data_term", NO_MASK, MASKED_VIEW),
    Fault("mask ignored, seen where nothing is valid", "data_term", NO_MASK, NOTHING_VALID),
    Fault(
        "mask the other way round",
        "data_term",
        method("load", argument(2, lambda v: None if v is None else 1 - v)),
        MASKED_PIXELS,
    ),
    Fault("last view skipped", "data_term", method("load", without_last_view), value_of("data_term")),
    Fault("first light field kept", "data_term", method("load", loading_once), value_of("data_term")),
    Fault("mask kept", "data_term", method("load", keeping_its_mask), value_of("data_term", UNMASKED)),
    Fault("mask kept, seen without a truth", "data_term", method("load", keeping_its_mask), MASKED_PIXELS),
    Fault("softness ignored", "data_term", option("softness", lambda _: 0.5), value_of("data_term")),
    # what the reference sees of other views
    Fault("wrong sign", "seen_by_reference", argument(1, np.negative), value_of("seen_by_reference")),
    Fault("unknown is seen", "seen_by_reference", argument(2, lambda _: None), value_of("seen_by_reference")),
    Fault("not valid is seen", "seen_by_reference", argument(3, lambda _: None), value_of("seen_by_reference")),
    Fault("other way round", "seen_by_reference", after(invert, "seen_out"), value_of("seen_by_reference")),
    Fault("halves rounded down", "seen_by_reference", down, value_of("seen_by_reference")),
    Fault(
        "rows and columns of offsets exchanged",
        "seen_by_reference",
        argument(1, swapped),
        value_of("seen_by_reference"),
    ),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)
