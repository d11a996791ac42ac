"""The checks of views, of the prior and of the local estimate can fail: the reference with one single fault fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import local_cases
import local_checks
import nlm_cases
import nlm_checks
import numpy as np
import programs
import view_cases
import view_checks
from single_faults import Fault, program, single_fault_tests, values_of
from ways_to_be_wrong import after, argument, first_inputs, mirrored, one_off, option, planned, scaled, skewed

from lfgpu.contract import KernelSet, half_window

NLM = nlm_cases.NlmCase("nlm")
VIEWS = view_cases.ViewsCase("views", dtype="uint8", masked=True, count=4, line=(3, 0, 1))
TURNED = view_cases.ViewsCase("turned", size=(7, 7), line=(2, 0), vertical=True)
EPI = local_cases.EpiCase("epi", dtype="uint8", shear=0.75)
COHERENCE = local_cases.CoherenceCase("coherence", size=(23, 31))

value_of = values_of(
    (*view_checks.OPERATIONS, *nlm_checks.OPERATIONS, *local_checks.OPERATIONS),
    {
        "views": lambda rng: view_cases.views_inputs(VIEWS, rng),
        "nlm": lambda rng: nlm_cases.nlm_inputs(NLM, rng),
        "epi": lambda rng: local_cases.epi_inputs(EPI, rng),
        "coherence": lambda rng: local_cases.coherence_inputs(COHERENCE, rng),
    },
)


def NLM_SYMMETRIC(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    nlm_checks.check_nlm_symmetric(kernels, "cpu", nlm_cases.nlm_inputs(NLM, rng))


def without_itself(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(weights: np.ndarray, values: np.ndarray, *, window: int, sums_out: np.ndarray) -> None:
        right(weights, values, window=window, sums_out=sums_out)
        sums_out -= values

    return wrong


def half(right: Callable[..., Any]) -> Callable[..., Any]:
    """Only pixels before their neighbour gather: one half of the window is forgotten."""

    def wrong(weights: np.ndarray, values: np.ndarray, *, window: int, sums_out: np.ndarray) -> None:
        sums_out[:] = values
        height, width = values.shape
        for w, (dy, dx) in zip(weights, half_window(window), strict=True):
            for y in range(height - dy):
                for x in range(max(0, -dx), min(width, width - dx)):
                    sums_out[y, x] += w[y, x] * values[y + dy, x + dx]

    return wrong


def flipped_slope(plan: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(epis: Any, shear: float, disparity_out: Any, coherence_out: Any) -> None:
        plan(epis, shear, disparity_out, coherence_out)
        disparity_out[:] = 2 * shear - disparity_out

    return wrong


def shear_forgotten(plan: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(epis: Any, shear: float, disparity_out: Any, coherence_out: Any) -> None:
        plan(epis, shear, disparity_out, coherence_out)
        disparity_out -= shear

    return wrong


def root_of_coherence(plan: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(epis: Any, shear: float, disparity_out: Any, coherence_out: Any) -> None:
        plan(epis, shear, disparity_out, coherence_out)
        coherence_out[:] = np.sqrt(coherence_out)

    return wrong


def TURNED_INPUTS(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return view_cases.views_inputs(TURNED, rng)


def WIDE(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return local_cases.coherence_inputs(replace(COHERENCE, unit=2.0), rng)


def WITHIN(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return local_cases.coherence_inputs(replace(COHERENCE, bounds=(-0.25, 1.25)), rng)


def SQUARE(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return local_cases.coherence_inputs(replace(COHERENCE, size=(9, 9), vertical=True), rng)


FAULTS = (
    # views
    Fault("first view only", "intensities", argument(1, lambda _: 0), value_of("intensities")),
    Fault("scale ignored", "intensities", option("scale", lambda _: 1.0), value_of("intensities")),
    Fault("mask ignored", "intensities", argument(2, lambda _: None), value_of("intensities")),
    Fault("filled with 0", "intensities", option("fill", lambda _: 0.0), value_of("intensities")),
    Fault("mask of another view", "intensities", argument(2, lambda v: v[::-1]), value_of("intensities")),
    Fault(
        "first views instead", "line_of_views", argument(1, lambda line: range(len(line))), value_of("line_of_views")
    ),
    Fault("backwards", "line_of_views", argument(1, lambda line: line[::-1]), value_of("line_of_views")),
    Fault("not turned", "line_of_views", option("vertical", lambda _: False), value_of("line_of_views", TURNED_INPUTS)),
    Fault("mirrored", "normalization", planned(lambda plan: after(mirrored)(plan)), value_of("normalization")),
    Fault("scale ignored", "normalization", option("scale", lambda _: 1.0), value_of("normalization")),
    Fault("floor ignored", "normalization", option("floor", lambda _: 1e-6), value_of("normalization")),
    Fault("wider mean", "normalization", option("sigma", lambda s: 1.1 * s), value_of("normalization")),
    Fault("mask ignored", "normalization", planned(argument(1, lambda _: None)), value_of("normalization")),
    Fault("first views kept", "normalization", first_inputs, value_of("normalization")),
    # the prior
    Fault("one weight off", "nlm_weights", planned(lambda plan: after(one_off)(plan)), value_of("nlm_weights")),
    Fault("floor ignored", "nlm_weights", option("floor", lambda _: 0.0), value_of("nlm_weights")),
    Fault(
        "floor beyond the border",
        "nlm_weights",
        planned(lambda plan: after(lambda w: np.maximum(w, 1e-3, out=w))(plan)),
        value_of("nlm_weights"),
    ),
    Fault("patch ignored", "nlm_weights", option("patch", lambda _: 1), value_of("nlm_weights")),
    Fault("colour ignored", "nlm_weights", option("sigma_color", lambda _: 1e3), value_of("nlm_weights")),
    Fault("gradient ignored", "nlm_weights", option("sigma_gradient", lambda _: 1e3), value_of("nlm_weights")),
    Fault(
        "first channel only",
        "nlm_weights",
        planned(argument(0, lambda image: image[..., :1])),
        value_of("nlm_weights"),
    ),
    Fault("first image kept", "nlm_weights", first_inputs, value_of("nlm_weights")),
    Fault("without the pixel itself", "nlm_neighbors", without_itself, value_of("nlm_neighbors")),
    Fault("without the pixel itself, seen by L", "nlm_neighbors", after(scaled(0.999), "sums_out"), NLM_SYMMETRIC),
    Fault("one half of the window", "nlm_neighbors", half, value_of("nlm_neighbors")),
    Fault("one half of the window, seen by symmetry", "nlm_neighbors", half, NLM_SYMMETRIC),
    Fault("weights of the pixel beside", "nlm_laplacian", argument(0, skewed), value_of("nlm_laplacian")),
    Fault(
        "diagonal ignored", "nlm_laplacian", option("diagonal", lambda _: None, absent=True), value_of("nlm_laplacian")
    ),
    Fault("wrong sign", "nlm_laplacian", after(scaled(-1), "laplacian_out"), NLM_SYMMETRIC),
    Fault("factor 2 too much", "nlm_laplacian", after(scaled(2), "laplacian_out"), value_of("nlm_laplacian")),
    Fault(
        "a constant is not smooth",
        "nlm_laplacian",
        after(lambda a: np.add(a, 1e-3, out=a), "laplacian_out"),
        NLM_SYMMETRIC,
    ),
    Fault(
        "wrong sign, seen in a program", "nlm_laplacian", after(scaled(-1), "laplacian_out"), program(programs.solving)
    ),
    # the local estimate
    Fault("wrong sign", "structure_tensor", planned(flipped_slope), value_of("structure_tensor")),
    Fault("shear not added", "structure_tensor", planned(shear_forgotten), value_of("structure_tensor")),
    Fault("root of coherence", "structure_tensor", planned(root_of_coherence), value_of("structure_tensor")),
    Fault("floor ignored", "structure_tensor", option("floor", lambda _: 0.3), value_of("structure_tensor")),
    Fault("scale ignored", "structure_tensor", option("scale", lambda _: 1.0), value_of("structure_tensor")),
    Fault(
        "views in the wrong order",
        "structure_tensor",
        planned(argument(0, lambda epis: epis[::-1])),
        value_of("structure_tensor"),
    ),
    Fault("first views kept", "structure_tensor", first_inputs, value_of("structure_tensor")),
    Fault("offsets ignored", "structure_tensor", argument(1, np.zeros_like), value_of("structure_tensor")),
    Fault(
        "no outer window",
        "structure_tensor",
        argument(2, lambda f: f._replace(across_outer=np.ones(1))),
        value_of("structure_tensor"),
    ),
    Fault("any reach", "keep_more_coherent", option("reach", lambda _: 99.0), value_of("keep_more_coherent")),
    Fault(
        "reach not reached", "keep_more_coherent", option("reach", lambda r: 0.99 * r), value_of("keep_more_coherent")
    ),
    Fault("unit ignored", "keep_more_coherent", option("unit", lambda _: 1.0), value_of("keep_more_coherent", WIDE)),
    Fault("no lower bound", "keep_more_coherent", option("low", lambda _: -99.0), value_of("keep_more_coherent")),
    Fault(
        "below its upper bound",
        "keep_more_coherent",
        option("high", lambda h: h - 0.01),
        value_of("keep_more_coherent", WITHIN),
    ),
    Fault("trusts all", "keep_more_coherent", argument(2, lambda _: None), value_of("keep_more_coherent")),
    Fault(
        "as coherent is better", "keep_more_coherent", argument(1, lambda c: c + 1e-9), value_of("keep_more_coherent")
    ),
    Fault(
        "not turned",
        "keep_more_coherent",
        option("vertical", lambda _: False),
        value_of("keep_more_coherent", SQUARE),
    ),
    Fault(
        "coherence not kept",
        "keep_more_coherent",
        option("best_coherence_out", lambda c: c.copy()),
        value_of("keep_more_coherent"),
    ),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)
