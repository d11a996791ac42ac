"""The operations that find the disparity range in the reference against loops; and their checks can fail."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import checks
import numpy as np
import programs
import pytest
import range_search_checks
from lfgpu.kernels.reference import range_search
from range_search_cases import RangeSearchCase, range_search_inputs
from range_search_checks import COSTS, DETAILS, DISTINCT, SHRINK
from single_faults import REFERENCE, Check, Fault, single_fault_tests
from ways_to_be_wrong import (
    accumulating,
    after,
    argument,
    first_inputs,
    mirrored,
    one_off,
    option,
    planned,
    scaled,
    with_another,
    zeroed,
)

from lfgpu.contract import UNSEEN, KernelSet

CASE = RangeSearchCase("any", size=(17, 19), masked=True)
ASKEW = replace(CASE, size=(25, 27), lines=((((-1.0, -0.5), (-2.0, -1.0)), ((1.0, 0.5),)),), count=5)


def run(operation: checks.Operation, case: RangeSearchCase, rng: np.random.Generator) -> tuple[Any, dict[str, Any]]:
    inputs = range_search_inputs(case, rng)
    return inputs, checks.compute(REFERENCE, "cpu", operation, inputs)


def test_shrink_is_the_mean_of_blocks(rng: np.random.Generator) -> None:
    i, got = run(SHRINK, CASE, rng)
    assert 0 < got["known"].mean() < 1
    for k, y, x in np.ndindex(got["values"].shape):
        rows, columns = (range(i.factor * at, i.factor * (at + 1)) for at in (y, x))
        block = [(row, column) for row in rows for column in columns]
        values = [float(value) for row, column in block for value in i.views[i.chosen[k], row, column]]
        assert got["known"][k, y, x] == all(i.valid[k, row, column] != 0 for row, column in block)
        if got["known"][k, y, x]:
            assert got["values"][k, y, x] == pytest.approx(i.scale * sum(values) / len(values), rel=1e-12)


@pytest.mark.parametrize("factor", [1, 2])
def test_details_are_without_their_mean(factor: int, rng: np.random.Generator) -> None:
    i, got = run(DETAILS, replace(CASE, factor=factor), rng)
    height, width = i.small
    images = i.images[:, : factor * height, : factor * width].astype(np.float64)
    images = sum(images[:, dy::factor, dx::factor] for dy in range(factor) for dx in range(factor)) / factor**2
    for n, y, x in np.ndindex(got["values"].shape):
        around = range(-(i.window // 2), i.window // 2 + 1)
        places = [(min(max(y + dy, 0), height - 1), min(max(x + dx, 0), width - 1)) for dy in around for dx in around]
        near = [images[n, row, column] for row, column in places if not math.isnan(images[n, row, column])]
        assert got["known"][n, y, x] != math.isnan(images[n, y, x])
        if got["known"][n, y, x]:
            assert got["values"][n, y, x] == pytest.approx(images[n, y, x] - sum(near) / len(near), abs=1e-12)


@pytest.mark.parametrize("case", [CASE, ASKEW], ids=["cross", "askew"])
def test_costs_are_means_of_differences(case: RangeSearchCase, rng: np.random.Generator) -> None:
    i, got = run(COSTS, case, rng)
    height, width = i.small

    def shown(view: int, x: float, y: float) -> float:
        """The detail of a view at a place, NaN outside."""
        total = 0.0
        for row, column in itertools.product((math.floor(y), math.ceil(y)), (math.floor(x), math.ceil(x))):
            weight = (1 - abs(y - row)) * (1 - abs(x - column))
            inside = 0 <= row < height and 0 <= column < width
            total += weight * float(i.details[view, row, column]) if inside else math.nan
        rows, columns = len({math.floor(y), math.ceil(y)}), len({math.floor(x), math.ceil(x)})
        return total * (rows * columns / 4)  # a place in a row or a column of pixels was counted more than once

    seen = 0
    for m, label, y, x in np.ndindex(len(i.lines), case.count, height, width):
        if (y + 2 * x + label) % 7:
            continue
        disparity, costs = case.first + case.step * label, []
        for side in i.lines[m]:
            terms = []
            for view, dy, dx in itertools.product(side, (-1, 0, 1), (-1, 0, 1)):
                if 0 <= y + dy < height and 0 <= x + dx < width:
                    du, dv = i.offsets[view]
                    there = shown(view, x + dx - disparity * du, y + dy - disparity * dv)
                    terms.append(abs(there - float(i.details[0, y + dy, x + dx])))
            terms = [term for term in terms if not math.isnan(term)]
            costs.append(sum(terms) / len(terms) if len(terms) >= 4.5 * len(side) else UNSEEN)
        seen += min(costs) < UNSEEN
        assert got["volume"][m, label, y, x] == pytest.approx(min(costs), abs=1e-12)
    assert seen > 20


def test_the_distinct_minimum_is_that_of_a_loop(rng: np.random.Generator) -> None:
    i, got = run(DISTINCT, CASE, rng)
    count = CASE.count
    for y, x in np.ndindex(*i.small):
        costs = [float(np.minimum(i.volume[:, label, y, x].astype(np.float64), 1).mean()) for label in range(count)]
        k = costs.index(min(costs))
        others = [cost for label, cost in enumerate(costs) if abs(label - k) > CASE.apart]
        place, least, spread, other, worst = got["found"][:, y, x]
        assert (least, spread) == (costs[k], max(costs) - costs[k])
        assert other == (min(others) - costs[k] if others else UNSEEN)
        if 0 < k < count - 1:
            before, here, next_ = costs[k - 1 : k + 2]
            bend = before - 2 * here + next_
            assert place == pytest.approx(k + ((before - next_) / (2 * bend) if bend > 1e-9 else 0))
            assert worst == i.volume[:, k, y, x].max()
        else:
            assert (place, worst) == (k, UNSEEN)


# --- the checks can fail ---


def value_of(operation: checks.Operation, case: RangeSearchCase = CASE) -> Check:
    return lambda kernels, rng: checks.check_value(kernels, "cpu", operation, range_search_inputs(case, rng), 1e-5)


def PROGRAM(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    make = range_search_checks.finding_what_is_distinct
    programs.check_program(kernels, "cpu", make, programs.program_inputs(make, rng))


def plan_of(change: Callable[..., Any], index: int) -> Callable[..., Any]:
    """What a plan leaves in its output is changed."""

    def changed(plan: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any) -> None:
            plan(*args)
            change(args[index])

        return wrong

    return planned(changed)


def adding(index: int) -> Callable[..., Any]:
    """A plan adds to what its output held."""

    def changed(plan: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any) -> None:
            held = args[index].copy()
            plan(*args)
            args[index][:] += held

        return wrong

    return planned(changed)


def turned(lines: Any) -> Any:
    return lines[::-1]


def joined(lines: Any) -> Any:
    """The views of both sides as one side."""
    return [[[view for side in line for view in side]] for line in lines]


FAULTS = (
    Fault("other views", "shrink", argument(1, lambda chosen: chosen[::-1]), value_of(SHRINK)),
    Fault("mask ignored", "shrink", argument(2, lambda _: None), value_of(SHRINK)),
    Fault("scale ignored", "shrink", option("scale", lambda _: 1.0), value_of(SHRINK)),
    Fault("one channel only", "shrink", argument(0, lambda views: views[..., :1]), value_of(SHRINK)),
    Fault("one pixel off", "shrink", after(one_off, "images_out"), value_of(SHRINK)),
    Fault("twice, seen in a program", "shrink", after(scaled(2.0), "images_out"), PROGRAM),
    Fault("adds to its output", "shrink", accumulating("images_out"), value_of(SHRINK)),
    Fault("narrower mean", "details", option("window", lambda window: window - 2), value_of(DETAILS)),
    Fault("mean stays", "details", option("window", lambda _: 10**3 + 1), value_of(DETAILS)),
    Fault("what is unknown counts", "details", planned(argument(0, np.nan_to_num)), value_of(DETAILS)),
    Fault("first images kept", "details", first_inputs, value_of(DETAILS)),
    Fault("mirrored", "details", plan_of(mirrored, 1), value_of(DETAILS)),
    Fault("adds to its output", "details", adding(1), value_of(DETAILS)),
    Fault("twice, seen in a program", "details", plan_of(scaled(2.0), 1), PROGRAM),
    Fault("x and y swapped", "side_costs", argument(1, lambda offsets: offsets[:, ::-1]), value_of(COSTS)),
    Fault("other sign", "side_costs", argument(1, lambda offsets: -offsets), value_of(COSTS, ASKEW)),
    Fault("whole shifts", "side_costs", option("step", lambda _: 1.0), value_of(COSTS)),
    Fault("first ignored", "side_costs", option("first", lambda _: 0.0), value_of(COSTS)),
    Fault("lines swapped", "side_costs", argument(2, turned), value_of(COSTS)),
    Fault("one side of both", "side_costs", argument(2, joined), value_of(COSTS)),
    Fault("what is unknown counts", "side_costs", planned(argument(0, np.nan_to_num)), value_of(COSTS)),
    Fault("another reference", "side_costs", option("reference", lambda _: 1), value_of(COSTS)),
    Fault(
        "of few terms", "side_costs", planned(with_another(range_search, "LEAST_SHARE", lambda _: 0.1)), value_of(COSTS)
    ),
    Fault("last disparity skipped", "side_costs", plan_of(zeroed(np.s_[:, -1]), 1), value_of(COSTS)),
    Fault("first details kept", "side_costs", first_inputs, value_of(COSTS)),
    Fault("adds to its output", "side_costs", adding(1), value_of(COSTS)),
    Fault("a part, seen in a program", "side_costs", plan_of(scaled(0.5), 1), PROGRAM),
    Fault("nearer", "distinct_minimum", option("apart", lambda apart: apart - 1), value_of(DISTINCT)),
    Fault("one line only", "distinct_minimum", argument(0, lambda volume: volume[:1]), value_of(DISTINCT)),
    Fault("what is unseen costs 0", "distinct_minimum", argument(0, lambda v: v * (v < 1)), value_of(DISTINCT)),
    Fault("last disparity ignored", "distinct_minimum", argument(0, lambda v: v[:, :-1]), value_of(DISTINCT)),
    Fault("one pixel off", "distinct_minimum", after(one_off, "found_out"), value_of(DISTINCT)),
    Fault("adds to its output", "distinct_minimum", accumulating("found_out"), value_of(DISTINCT)),
    Fault("half, seen in a program", "distinct_minimum", after(scaled(0.5), "found_out"), PROGRAM),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)


def test_every_operation_of_the_range_has_a_fault_that_its_check_catches() -> None:
    assert {fault.operation for fault in FAULTS} == {str(operation) for operation in range_search_checks.OPERATIONS}
