"""The checks of the plane sweep can fail: the reference with one single fault is caught by them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import checks
import numpy as np
import programs
import pytest
import sweep_checks
from cases import IRREGULAR, grid
from lfgpu.kernels.reference import plane_sweep
from single_faults import Check, Fault, single_fault_tests
from sweep_cases import SweepCase, sweep_inputs
from ways_to_be_wrong import (
    NO_MASK,
    argument,
    keeping_its_mask,
    loading_once,
    method,
    one_off,
    option,
    swapped,
    without_last_view,
    zeroed,
)

from lfgpu.contract import KernelSet

CASE = SweepCase("any", offsets=IRREGULAR, masked=True, least=2)
WITH_REFERENCE = replace(CASE, offsets=(*IRREGULAR, (0.0, 0.0)))
WHOLE = replace(CASE, offsets=((1.0, 0.0), (0.0, -1.0), (-1.0, 1.0)), first=-1.0, step=1.0, count=3)


def value_of(case: SweepCase) -> Check:
    return lambda kernels, rng: checks.check_value(
        kernels, "cpu", sweep_checks.SWEEP, sweep_inputs(case, rng), case.tolerance
    )


def of(check: Callable[..., Any]) -> Check:
    return lambda kernels, rng: check(kernels, "cpu", sweep_inputs(CASE, rng))


def PROGRAM(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    make = sweep_checks.sweeping
    programs.check_program(kernels, "cpu", make, programs.program_inputs(make, rng))


VALUE, UNMASKED, REFERENCE_THERE, ON_PIXELS = map(value_of, (CASE, replace(CASE, masked=False), WITH_REFERENCE, WHOLE))
SIDE = of(sweep_checks.check_a_side_that_sees_is_enough)
MISSING = of(sweep_checks.check_masked_view_is_a_missing_view)
NOTHING = of(sweep_checks.check_nothing_valid_costs_the_most)


def output(name: str, change: Callable[[np.ndarray], Any]) -> Callable[..., Any]:
    """What a volume holds is changed in place afterwards."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*arrays: Any, **options: Any) -> None:
            right(*arrays, **options)
            change(arrays[-1])

        return wrong

    return method(name, broken)


def adding(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(*arrays: Any, **options: Any) -> None:
        held = np.nan_to_num(arrays[-1])
        right(*arrays, **options)
        arrays[-1][:] += held

    return wrong


def seeing(change: Callable[[np.ndarray], np.ndarray]) -> Callable[..., Any]:
    """The sweep is given another surface."""
    return method("by_visibility", argument(0, change))


def truncated(change: Callable[[float | None], float | None]) -> Callable[..., Any]:
    """The sweep of what is seen is asked for another truncation of intensities alone, or for none."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arrays, truncation=None: right(*arrays, truncation=change(truncation))

    return method("by_visibility", broken)


def within(name: str, value: Any) -> Callable[..., Any]:
    """Something of the reference's module is another one while the sweep computes."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*arrays: Any, **options: Any) -> None:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(plane_sweep, name, value)
                right(*arrays, **options)

        return wrong

    return lambda right: method("by_view_sets", broken)(method("by_visibility", broken)(right))


def wrapped_around(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences with the pixels of the opposite border."""
    return tuple((np.roll(values, -1, axis) - np.roll(values, 1, axis)) / 2 for axis in (1, 0))


def forward_differences(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    padded = np.pad(values, ((0, 1), (0, 1), (0, 0)), mode="edge")
    return padded[:-1, 1:] - values, padded[1:, :-1] - values


RIGHT = plane_sweep.shifted


def rounded_down(size: int, shift: float) -> plane_sweep.Axis:
    """The nearest pixel of a place in the middle of two is the first of them."""
    axis = RIGHT(size, shift)
    return axis._replace(nearest=np.ceil((np.arange(size) + shift).clip(0, size - 1) - 0.5).astype(np.int64))


def always_inside(size: int, shift: float) -> plane_sweep.Axis:
    axis = RIGHT(size, shift)
    return axis._replace(inside=np.ones(size, np.bool_))


def without_border(size: int, shift: float) -> plane_sweep.Axis:
    """What lies exactly on the border is left out."""
    axis, place = RIGHT(size, shift), np.arange(size) + shift
    return axis._replace(inside=(place > 0) & (place < size - 1))


GRID = value_of(replace(CASE, offsets=grid(3, 3)))  # whose view_sets all differ
HALVES = value_of(replace(CASE, first=-1.5, step=1.0, count=4, offsets=((1.0, 0.0), (0.0, -1.0), (-1.0, 1.0))))

NAME = "plane_sweep"
FAULTS = (
    Fault("against the convention of signs", NAME, argument(1, np.negative), SIDE),
    Fault("rows and columns of offsets exchanged", NAME, argument(1, swapped), VALUE),
    Fault("begins a little later", NAME, option("first", lambda d: d + 1e-3), VALUE),
    Fault("all disparities the same", NAME, option("step", lambda _: 0.0), VALUE),
    Fault("scale ignored", NAME, option("scale", lambda _: 1.0), VALUE),
    Fault("no truncation", NAME, option("truncation", lambda _: 1e9), VALUE),
    Fault("no truncation of gradients", NAME, option("gradient_truncation", lambda _: 1e9), VALUE),
    Fault("a little more of gradients", NAME, option("gradient_weight", lambda w: 1.01 * w), VALUE),
    Fault("softness ignored", NAME, option("softness", lambda _: 0.0), VALUE),
    Fault("a little softer", NAME, option("softness", lambda s: 0.99 * s), VALUE),
    Fault("preference ignored", NAME, option("preference", lambda _: 0.0), VALUE),
    Fault("tolerance ignored", NAME, option("tolerance", lambda _: 0.0), VALUE),
    Fault("one is enough", NAME, option("least", lambda _: 1), VALUE),
    Fault("one more is needed", NAME, option("least", lambda least: least + 1), VALUE),
    Fault("nothing hides anything", NAME, seeing(lambda nearest: np.full_like(nearest, -1e6)), VALUE),
    Fault("surfaces of other views", NAME, seeing(lambda nearest: np.roll(nearest, 1, axis=0)), VALUE),
    Fault("surfaces one pixel off", NAME, seeing(lambda nearest: np.roll(nearest, 1, axis=2)), VALUE),
    Fault("nothing hides anything, seen in a program", NAME, seeing(lambda nearest: nearest - 3), PROGRAM),
    Fault("first view_set only", NAME, argument(2, lambda a: a[:1]), VALUE),
    Fault("last view_set skipped", NAME, argument(2, lambda a: a[:-1]), GRID),
    Fault("all in all view_sets", NAME, argument(2, np.ones_like), VALUE),
    Fault("all in all view_sets, seen by one side", NAME, argument(2, np.ones_like), SIDE),
    Fault("reference view counts", NAME, argument(1, lambda o: np.where(o == 0, 0.002, o)), REFERENCE_THERE),
    Fault("no penalty", NAME, within("PENALTY", 0.0), VALUE),
    Fault("forward differences", NAME, within("central_differences", forward_differences), VALUE),
    Fault("differences around the border", NAME, within("central_differences", wrapped_around), VALUE),
    Fault("outside counts", NAME, within("shifted", always_inside), VALUE),
    Fault("border does not count", NAME, within("shifted", without_border), ON_PIXELS),
    Fault("halves rounded down", NAME, within("shifted", rounded_down), HALVES),
    Fault("mask ignored", NAME, NO_MASK, VALUE),
    Fault("mask ignored, no truth", NAME, NO_MASK, MISSING),
    Fault("nothing counts", NAME, NO_MASK, NOTHING),
    Fault("last view skipped", NAME, method("load", without_last_view), VALUE),
    Fault("first light field kept", NAME, method("load", loading_once), VALUE),
    Fault("scale doubled, seen in a program", NAME, option("scale", lambda s: 2 * s), PROGRAM),
    Fault("mask kept", NAME, method("load", keeping_its_mask), UNMASKED),
    Fault("one pixel off", NAME, output("by_view_sets", one_off), VALUE),
    Fault("one seen pixel off", NAME, output("by_visibility", one_off), VALUE),
    Fault("last disparity skipped", NAME, output("by_view_sets", zeroed(-1)), VALUE),
    Fault("last row skipped", NAME, output("by_visibility", zeroed(np.s_[:, -1])), VALUE),
    Fault("adds to its output", NAME, method("by_view_sets", adding), VALUE),
    Fault("gradients where there should be none", NAME, truncated(lambda _: None), VALUE),
    Fault("intensities truncated a little later", NAME, truncated(lambda given: given and 1.01 * given), VALUE),
    Fault("gradients left out everywhere", NAME, truncated(lambda given: given or 0.3), VALUE),
    Fault("adds to what is seen", NAME, method("by_visibility", adding), VALUE),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)


def test_every_check_of_the_sweep_has_a_fault_that_it_catches() -> None:
    caught = {fault.check for fault in FAULTS}
    assert {VALUE, UNMASKED, REFERENCE_THERE, ON_PIXELS, GRID, HALVES, SIDE, MISSING, NOTHING, PROGRAM} == caught
