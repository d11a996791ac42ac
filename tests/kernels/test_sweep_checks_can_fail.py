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

from lfgpu.contract import KernelSet, SweepCost

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


def costs(change: Callable[[SweepCost], SweepCost]) -> Callable[..., Any]:
    """All sweeps are given another cost."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments: right(*arguments[:-2], change(arguments[-2]), arguments[-1])

    return lambda right: method("by_view_sets", broken)(method("by_visibility", broken)(right))


def with_gradients(cost: SweepCost) -> SweepCost:
    return replace(
        cost, gradient_weight=cost.gradient_weight or 0.5, gradient_truncation=cost.gradient_truncation or 0.1
    )


def field(index: int, name: str, change: Callable[[Any], Any]) -> Callable[..., Any]:
    """A field of an argument of the plan is another one."""
    return argument(index, lambda given: replace(given, **{name: change(getattr(given, name))}))


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
    Fault("against the convention of signs", NAME, field(1, "offsets", np.negative), SIDE),
    Fault("rows and columns of offsets exchanged", NAME, field(1, "offsets", swapped), VALUE),
    Fault("begins a little later", NAME, field(2, "first", lambda d: d + 1e-3), VALUE),
    Fault("all disparities the same", NAME, field(2, "step", lambda _: 0.0), VALUE),
    Fault("scale ignored", NAME, option("scale", lambda _: 1.0), VALUE),
    Fault("no truncation", NAME, costs(lambda cost: replace(cost, truncation=1e9)), VALUE),
    Fault("no truncation of gradients", NAME, costs(lambda cost: replace(cost, gradient_truncation=1e9)), VALUE),
    Fault(
        "a little more of gradients",
        NAME,
        costs(lambda cost: replace(cost, gradient_weight=1.01 * cost.gradient_weight)),
        VALUE,
    ),
    Fault("softness ignored", NAME, costs(lambda cost: replace(cost, softness=0.0)), VALUE),
    Fault("a little softer", NAME, costs(lambda cost: replace(cost, softness=0.99 * cost.softness)), VALUE),
    Fault("preference ignored", NAME, field(1, "preference", lambda _: 0.0), VALUE),
    Fault("tolerance ignored", NAME, field(1, "tolerance", lambda _: 0.0), VALUE),
    Fault("one is enough", NAME, field(1, "least", lambda _: 1), VALUE),
    Fault("one more is needed", NAME, field(1, "least", lambda least: least + 1), VALUE),
    Fault("nothing hides anything", NAME, seeing(lambda nearest: np.full_like(nearest, -1e6)), VALUE),
    Fault("surfaces of other views", NAME, seeing(lambda nearest: np.roll(nearest, 1, axis=0)), VALUE),
    Fault("surfaces one pixel off", NAME, seeing(lambda nearest: np.roll(nearest, 1, axis=2)), VALUE),
    Fault("nothing hides anything, seen in a program", NAME, seeing(lambda nearest: nearest - 3), PROGRAM),
    Fault("first view_set only", NAME, field(1, "members", lambda a: a[:1]), VALUE),
    Fault("last view_set skipped", NAME, field(1, "members", lambda a: a[:-1]), GRID),
    Fault("all in all view_sets", NAME, field(1, "members", np.ones_like), VALUE),
    Fault("all in all view_sets, seen by one side", NAME, field(1, "members", np.ones_like), SIDE),
    Fault("reference view counts", NAME, field(1, "offsets", lambda o: np.where(o == 0, 0.002, o)), REFERENCE_THERE),
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
    Fault("gradients where there should be none", NAME, costs(with_gradients), VALUE),
    Fault(
        "intensities truncated a little later", NAME, costs(lambda c: replace(c, truncation=1.01 * c.truncation)), VALUE
    ),
    Fault("gradients left out everywhere", NAME, costs(lambda c: replace(c, gradient_weight=0.0)), VALUE),
    Fault("adds to what is seen", NAME, method("by_visibility", adding), VALUE),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)


def test_every_check_of_the_sweep_has_a_fault_that_it_catches() -> None:
    caught = {fault.check for fault in FAULTS}
    assert {VALUE, UNMASKED, REFERENCE_THERE, ON_PIXELS, GRID, HALVES, SIDE, MISSING, NOTHING, PROGRAM} == caught
