"""The checks of the operations on cost volumes can fail: the reference with one single fault is caught by them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import checks
import numpy as np
import programs
import volume_checks
from lfgpu.kernels.reference import confidence, cost_volume, edges, semi_global
from single_faults import Check, Fault, single_fault_tests
from volume_cases import VolumeCase, volume_inputs
from ways_to_be_wrong import (
    accumulating,
    after,
    argument,
    changing_its_input,
    mirrored,
    one_off,
    option,
    rewritten,
    scaled,
    skewed,
    with_another,
    zeroed,
)

from lfgpu.contract import KernelSet

CASE = VolumeCase("any", size=(12, 13), count=6)


def value_of(operation: checks.Operation, case: VolumeCase = CASE) -> Check:
    return lambda kernels, rng: checks.check_value(kernels, "cpu", operation, volume_inputs(case, rng), 1e-5)


def PROGRAM(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    make = volume_checks.finding_the_lowest
    programs.check_program(kernels, "cpu", make, programs.program_inputs(make, rng))


def without_diagonals(right: Callable[..., Any]) -> Callable[..., Any]:
    return lambda volume, image, scale, dx, *options: right(volume, image, scale, dx, *options) * (dx == 0)


def wrapping(right: Callable[..., Any]) -> Callable[..., Any]:
    """A diagonal goes on at the other side of the frame, as the same path."""

    def wrong(volume: np.ndarray, image: np.ndarray, scale: np.ndarray, dx: int, *options: float) -> np.ndarray:
        height = len(image)
        moved = [np.roll(a, -dx * y, -1) for y, a in enumerate(volume.transpose(1, 0, 2))]
        colors = [np.roll(a, -dx * y, 0) for y, a in enumerate(image)]
        scales = [np.roll(a, -dx * y, 0) for y, a in enumerate(scale)]
        costs = right(np.stack(moved, 1), np.stack(colors), np.stack(scales), 0, *options)
        return np.stack([np.roll(costs[:, y], dx * y, -1) for y in range(height)], 1)

    return wrong


def the_last(right: Callable[..., Any]) -> Callable[..., Any]:
    """Of several least costs the last one."""

    def wrong(volume: np.ndarray, *, first: float, step: float, disparity_out: np.ndarray) -> None:
        end = first + step * (len(volume) - 1)
        right(volume[::-1], first=end, step=-step, disparity_out=disparity_out)

    return wrong


def whole(right: Callable[..., Any]) -> Callable[..., Any]:
    """Without the parabola."""

    def wrong(volume: np.ndarray, *, first: float, step: float, disparity_out: np.ndarray) -> None:
        disparity_out[:] = first + step * volume.argmin(0).clip(1, len(volume) - 2)

    return wrong


def beyond(right: Callable[..., Any]) -> Callable[..., Any]:
    """The first and the last disparity where they cost least."""

    def wrong(volume: np.ndarray, *, first: float, step: float, disparity_out: np.ndarray) -> None:
        right(volume, first=first, step=step, disparity_out=disparity_out)
        k = volume.argmin(0)
        ends = (k == 0) | (k == len(volume) - 1)
        disparity_out[ends] = (first + step * k)[ends]

    return wrong


def without_last(volume: np.ndarray) -> np.ndarray:
    return np.concatenate([volume[:-1], np.zeros_like(volume[-1:])])


def text(old: str, new: str) -> Callable[..., Any]:
    return rewritten(cost_volume, old, new)


AVERAGE, SEMI_GLOBAL, ADD_REDUCED, EDGES, LEAST, LOWEST, *CONFIDENCE = map(value_of, volume_checks.OPERATIONS)
EVIDENCE, LINE_MEAN, UNEVENNESS, JUDGE = CONFIDENCE

FIRST_ROW = "(shares * reduced)[:, :1].repeat(volume_inout.shape[1], 1)"
FAULTS = (
    Fault("weights beside their pixels", "nlm_average", argument(0, skewed), AVERAGE),
    Fault("a little wider", "nlm_average", argument(0, lambda w: 1.01 * w), AVERAGE),
    Fault("sums", "nlm_average", after(scaled(2.0), "average_out"), AVERAGE),
    Fault("last slice skipped", "nlm_average", after(zeroed(-1), "average_out"), AVERAGE),
    Fault("one pixel off", "nlm_average", after(one_off, "average_out"), AVERAGE),
    Fault("mirrored", "nlm_average", after(mirrored, "average_out"), AVERAGE),
    Fault("adds to its output", "nlm_average", accumulating("average_out"), AVERAGE),
    Fault("weights ignored, seen in a program", "nlm_average", argument(0, np.zeros_like), PROGRAM),
    Fault("weight ignored", "add_reduced", option("weight", lambda _: 1.0), ADD_REDUCED),
    Fault("weight ignored, seen in a program", "add_reduced", option("weight", lambda _: 1.0), PROGRAM),
    Fault("half a pixel off", "add_reduced", text("+ 0.5) / REDUCTION", "+ 1.0) / REDUCTION"), ADD_REDUCED),
    Fault("half a reduced pixel off", "add_reduced", text("REDUCTION - 0.5", "REDUCTION"), ADD_REDUCED),
    Fault("beyond the border", "add_reduced", text("0, small - 1)", "-1, small - 0.5)"), ADD_REDUCED),
    Fault("nearest", "add_reduced", text("(places - before)", "np.rint(places - before)"), ADD_REDUCED),
    Fault("along rows only", "add_reduced", text("_between(shares * reduced, places[0], 1)", FIRST_ROW), ADD_REDUCED),
    Fault("overwritten", "add_reduced", text("volume_inout += weight", "volume_inout[:] = weight"), ADD_REDUCED),
    Fault("twice", "add_reduced", text("volume_inout += weight", "volume_inout += 2 * weight"), ADD_REDUCED),
    Fault("taken away", "add_reduced", option("weight", lambda weight: -weight), ADD_REDUCED),
    Fault("shares ignored", "add_reduced", argument(1, np.ones_like), ADD_REDUCED),
    Fault("shares ignored, seen in a program", "add_reduced", argument(1, np.ones_like), PROGRAM),
    Fault("shares of the pixel above", "add_reduced", argument(1, lambda shares: np.roll(shares, 1, 0)), ADD_REDUCED),
    Fault("slices in reverse", "add_reduced", argument(0, lambda reduced: reduced[::-1]), ADD_REDUCED),
    Fault("last slice skipped", "add_reduced", argument(0, without_last), ADD_REDUCED),
    Fault("one pixel off", "add_reduced", after(one_off, "volume_inout"), ADD_REDUCED),
    Fault("its input changes", "add_reduced", changing_its_input, ADD_REDUCED),
    Fault("steps count a little less", "edge_weights", option("contrast", lambda c: 1.01 * c), EDGES),
    Fault("a pixel farther", "edge_weights", option("reach", lambda reach: reach + 1), EDGES),
    Fault("one channel only", "edge_weights", argument(0, lambda image: image[..., :1]), EDGES),
    Fault("down the columns only", "edge_weights", rewritten(edges, "np.maximum(*steps)", "steps[1]"), EDGES),
    Fault("along the rows only", "edge_weights", rewritten(edges, "np.maximum(*steps)", "steps[0]"), EDGES),
    Fault("mirrored", "edge_weights", after(mirrored, "weights_out"), EDGES),
    Fault("one pixel off", "edge_weights", after(one_off, "weights_out"), EDGES),
    Fault("adds to its output", "edge_weights", accumulating("weights_out"), EDGES),
    Fault("twice, seen in a program", "edge_weights", after(scaled(2.0), "weights_out"), PROGRAM),
    Fault("without diagonals", "semi_global", with_another(semi_global, "path_costs", without_diagonals), SEMI_GLOBAL),
    Fault("around the frame", "semi_global", with_another(semi_global, "path_costs", wrapping), SEMI_GLOBAL),
    Fault("edges let all pass", "semi_global", with_another(semi_global, "LEAST_SMALL", lambda _: 0.0), SEMI_GLOBAL),
    Fault("large is small", "semi_global", with_another(semi_global, "LEAST_LARGE", lambda _: 1.0), SEMI_GLOBAL),
    Fault("penalties alike", "semi_global", argument(2, np.ones_like), SEMI_GLOBAL),
    Fault("of all but the last", "least_costs", argument(0, lambda volume: volume[:-1]), LEAST),
    Fault("adds to its output", "least_costs", accumulating("least_out"), LEAST),
    Fault("twice, seen in a program", "least_costs", after(scaled(2.0), "least_out"), PROGRAM),
    Fault("image ignored", "semi_global", argument(1, np.zeros_like), SEMI_GLOBAL),
    Fault("one channel only", "semi_global", argument(1, lambda image: image[..., :1]), SEMI_GLOBAL),
    Fault("sum of channels", "semi_global", option("contrast", lambda c: c / 3), SEMI_GLOBAL),
    Fault("small ignored", "semi_global", option("small", lambda _: 0.0), SEMI_GLOBAL),
    Fault("large ignored", "semi_global", option("large", lambda _: 0.0), SEMI_GLOBAL),
    Fault("last slice skipped", "semi_global", after(zeroed(-1), "sum_out"), SEMI_GLOBAL),
    Fault("one pixel off", "semi_global", after(one_off, "sum_out"), SEMI_GLOBAL),
    Fault("adds to its output", "semi_global", accumulating("sum_out"), SEMI_GLOBAL),
    Fault("a mean, seen in a program", "semi_global", after(scaled(1 / 8), "sum_out"), PROGRAM),
    Fault("the last of the least", "winner_takes_all", the_last, LOWEST),
    Fault("without parabola", "winner_takes_all", whole, LOWEST),
    Fault("to the ends", "winner_takes_all", beyond, LOWEST),
    Fault("hills are valleys", "winner_takes_all", with_another(cost_volume, "LEAST_BEND", lambda _: -np.inf), LOWEST),
    Fault("first ignored", "winner_takes_all", option("first", lambda _: 0.0), LOWEST),
    Fault("step a little larger", "winner_takes_all", option("step", lambda step: 1.001 * step), LOWEST),
    Fault("step ignored, seen in a program", "winner_takes_all", option("step", lambda _: 1.0), PROGRAM),
    Fault("one pixel off", "winner_takes_all", after(one_off, "disparity_out"), LOWEST),
    Fault("adds to its output", "winner_takes_all", accumulating("disparity_out"), LOWEST),
    Fault("step ignored", "evidence", option("step", lambda _: 1.0), EVIDENCE),
    Fault("unit ignored", "evidence", option("unit", lambda _: 1.0), EVIDENCE),
    Fault("sharper", "evidence", with_another(confidence, "SHARPNESS", lambda s: 1.1 * s), EVIDENCE),
    Fault("a sum for a mean of paths", "evidence", with_another(confidence, "PATHS", lambda _: 1), EVIDENCE),
    Fault("any conflict counts", "evidence", with_another(confidence, "LEAST_CONFLICT", lambda _: 0.02), EVIDENCE),
    Fault("paths ignored", "evidence", argument(1, np.zeros_like), EVIDENCE),
    Fault("last slice ignored", "evidence", argument(0, lambda volume: volume[:-1]), EVIDENCE),
    Fault("one pixel off", "evidence", after(one_off, "evidence_out"), EVIDENCE),
    Fault("other axis", "line_mean", option("axis", lambda axis: 1 - axis), LINE_MEAN),
    Fault("reaches too far", "line_mean", option("reach", lambda reach: reach + 1), LINE_MEAN),
    Fault("a sum", "line_mean", after(scaled(3.0), "means_out"), LINE_MEAN),
    Fault("map ignored", "unevenness", argument(0, np.zeros_like), UNEVENNESS),
    Fault("any bend counts", "unevenness", with_another(confidence, "LEAST_BEND", lambda _: 1e-4), UNEVENNESS),
    Fault("any relief counts", "unevenness", with_another(confidence, "LEAST_RELIEF", lambda _: 0.02), UNEVENNESS),
    Fault("one pixel off", "unevenness", after(one_off, "bend_out"), UNEVENNESS),
    Fault("weights of the variance", "judge", option("share", lambda share: share[::-1]), JUDGE),
    Fault("spread ignored", "judge", option("spread", np.zeros_like), JUDGE),
    *(
        Fault(f"{name} ignored", "judge", argument(place, np.zeros_like), JUDGE)
        for place, name in enumerate(("conflict", "evidence", "bend", "relief", "wide", "cost"))
    ),
    Fault("span ignored", "judge", option("span", lambda _: 1.0), JUDGE),
    Fault("no least cost", "evidence", with_another(confidence, "LEAST_COST", lambda _: 1.5), EVIDENCE),
    Fault("unlike later", "judge", with_another(confidence, "MOST_COST", lambda _: 2.8), JUDGE),
    Fault("unlike sooner", "judge", with_another(confidence, "UNLIKE", lambda _: 11), JUDGE),
    Fault("blind sooner", "judge", with_another(confidence, "BLIND", lambda _: 7), JUDGE),
    Fault("doubt", "judge", after(scaled(-1.0), "confidence_out"), JUDGE),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)


def test_every_operation_on_volumes_has_a_fault_that_its_check_catches() -> None:
    assert {fault.operation for fault in FAULTS} == {str(operation) for operation in volume_checks.OPERATIONS}
