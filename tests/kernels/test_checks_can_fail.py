"""Each check can fail: the reference with one single fault is caught by the very checks of the matrix.

The reference as it is passes them, so that it is the fault that is caught and not the wrapping. At the end, a whole
backend with a fault goes through the matrix itself, in a run of pytest of its own.
"""

from __future__ import annotations

import inspect
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, cast

import alignment_checks
import cases
import checks
import numpy as np
import occlusion_checks
import pytest
import range_search_checks
import resampling_checks
import smoothing_checks
import sweep_checks
import volume_checks
from lfgpu.kernels.reference import lbfgs as lbfgs_module

from lfgpu._backends import load
from lfgpu.contract import KernelSet, half_window

REFERENCE = load("reference")
SPLAT = cases.SplatCase("splat", offsets=cases.IRREGULAR, masked=True, dtype="uint8")
NLM = cases.NlmCase("nlm")
VIEWS = cases.ViewsCase("views", dtype="uint8", masked=True, count=4, line=(3, 0, 1))
TURNED = cases.ViewsCase("turned", size=(7, 7), line=(2, 0), vertical=True)
EPI = cases.EpiCase("epi", dtype="uint8", shear=0.75)
COHERENCE = cases.CoherenceCase("coherence", size=(23, 31))
VECTOR = cases.VectorCase("vector", (11, 14))
RESIDUALS = cases.ResidualsCase("residuals", residuals=(2.0, 3.0, 0.1, 0.05, 0.01, 0.01), tolerance=0.1, most=3)
LBFGS = cases.LbfgsCase("lbfgs", bounds=(-0.25, 0.5), values=12)

Check = Callable[[KernelSet, np.random.Generator], Any]


INPUTS: dict[str, Callable[[np.random.Generator], SimpleNamespace]] = {
    "splat": lambda rng: cases.splat_inputs(SPLAT, rng),
    "seen": lambda rng: cases.seen_inputs(SPLAT, rng),
    "views": lambda rng: cases.views_inputs(VIEWS, rng),
    "nlm": lambda rng: cases.nlm_inputs(NLM, rng),
    "epi": lambda rng: cases.epi_inputs(EPI, rng),
    "coherence": lambda rng: cases.coherence_inputs(COHERENCE, rng),
    "vector": lambda rng: cases.vector_inputs(VECTOR, rng),
    "residuals": lambda rng: cases.residuals_inputs(RESIDUALS, rng),
    "lbfgs": lambda rng: cases.lbfgs_inputs(LBFGS, rng),
}


def value_of(name: str, make: Callable[[np.random.Generator], SimpleNamespace] | None = None) -> Check:
    """The check of one operation against the reference, on inputs of its kind or on those of `make`."""
    (operation,) = (operation for operation in checks.OPERATIONS if str(operation) == name)
    inputs = make or INPUTS[operation.inputs]
    return lambda kernels, rng: checks.check_value(kernels, "cpu", operation, inputs(rng), 1e-5)


def way_of(**case: Any) -> Check:
    """The check of L-BFGS on another way."""
    return value_of("lbfgs", lambda rng: cases.lbfgs_inputs(cases.LbfgsCase("way", **case), rng))


def program(make: checks.MakeProgram) -> Check:
    return lambda kernels, rng: checks.check_program(kernels, "cpu", make, checks.program_inputs(make, rng))


def captured(make: checks.MakeProgram) -> Check:
    """Of a backend that captures (a right one does the work once more)."""

    def check(kernels: KernelSet, rng: np.random.Generator) -> None:
        first, second = (checks.program_inputs(make, rng) for _ in range(2))
        able = kernels if kernels.capture is not REFERENCE.capture else with_operation("capture", doing_again)
        assert checks.check_capture(able, "cpu", make, first, second)

    return check


def doing_again(work: Callable[[], None], device: str) -> Callable[[], None]:
    return work


def CONVERGES(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    checks.check_lbfgs_converges(kernels, "cpu", cases.quadratic(42, rng), rng.normal(size=(6, 7)), 1e-5)


def repeats_of(name: str) -> Check:
    (operation,) = (operation for operation in checks.OPERATIONS if str(operation) == name)
    return lambda kernels, rng: checks.check_repeats(kernels, "cpu", operation, cases.splat_inputs(SPLAT, rng))


def of_splat(check: Callable[[KernelSet, str, SimpleNamespace], Any]) -> Check:
    return lambda kernels, rng: check(kernels, "cpu", cases.splat_inputs(SPLAT, rng))


IMAGE_ADJOINT = of_splat(checks.check_image_adjoint)
DISPARITY_ADJOINT = of_splat(checks.check_disparity_adjoint)
MASKED_PIXELS = of_splat(checks.check_masked_pixels_do_not_count)
MASKED_VIEW = of_splat(checks.check_masked_view_is_a_missing_view)
NOTHING_VALID = of_splat(checks.check_nothing_valid_is_nothing_at_all)
DOUBLE_DOT: Check = lambda kernels, rng: checks.check_dot_in_double(kernels, "cpu")  # noqa: E731
DOUBLE_NUMBERS: Check = lambda kernels, rng: checks.check_numbers_in_double(kernels, "cpu")  # noqa: E731
SHARED: Check = lambda kernels, rng: checks.check_shared(kernels, "cpu")  # noqa: E731
REPEATS: Check = lambda kernels, rng: checks.check_repeat(kernels, "cpu")  # noqa: E731


def NLM_SYMMETRIC(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    checks.check_nlm_symmetric(kernels, "cpu", cases.nlm_inputs(NLM, rng))


@dataclass(frozen=True)
class Fault:
    """What is wrong, with which operation, and the check that must notice; `broken(right)` makes the wrong one."""

    what: str
    operation: str
    broken: Callable[[Callable[..., Any]], Callable[..., Any]]
    check: Check

    def __str__(self) -> str:
        return f"{self.operation}-{self.what}".replace(" ", "-")

    @property
    def kernels(self) -> KernelSet:
        return with_operation(self.operation, self.broken(getattr(REFERENCE, self.operation)))


def with_operation(name: str, operation: Any) -> KernelSet:
    """The reference with another operation in the place of one of its own."""
    return cast(KernelSet, SimpleNamespace(**{**vars(REFERENCE), name: operation}))


@pytest.fixture
def rng() -> np.random.Generator:
    """The same numbers each time: among new ones, a fault might now and then make no difference."""
    return np.random.default_rng(0)


# --- ways to be wrong: each turns a right operation into a wrong one ---


def after(change: Callable[[np.ndarray], Any], *outputs: str) -> Callable[..., Any]:
    """Outputs named `outputs` (or the last argument) are changed in place afterwards."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> Any:
            result = right(*args, **options)
            for output in [options[name] for name in outputs] or [args[-1]]:
                change(output)
            return result

        return wrong

    return broken


def before(change: Callable[[list[Any], dict[str, Any]], None]) -> Callable[..., Any]:
    """Arguments are changed before the operation sees them; `change` gets (positional, keyword)."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> Any:
            positional = list(args)
            change(positional, options)
            return right(*positional, **options)

        return wrong

    return broken


def planned(change: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Callable[..., Any]:
    """The plan that an operation makes is turned into a wrong one."""
    return lambda right: lambda *args, **options: change(right(*args, **options))


def accumulating(*outputs: str) -> Callable[..., Any]:
    """Adds to what the outputs held instead of overwriting it."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        def wrong(*args: Any, **options: Any) -> None:
            held = [options[name].copy() for name in outputs]
            right(*args, **options)
            for name, old in zip(outputs, held, strict=True):
                options[name] += old

        return wrong

    return broken


def argument(index: int, change: Callable[[Any], Any]) -> Callable[..., Any]:
    def replace(args: list[Any], options: dict[str, Any]) -> None:
        args[index] = change(args[index])

    return before(replace)


def option(name: str, change: Callable[[Any], Any], *, absent: bool = False) -> Callable[..., Any]:
    """A keyword argument is another one; `absent`: it may be missing."""
    return before(lambda args, options: options.update({name: change(options.get(name) if absent else options[name])}))


def rewritten(module: ModuleType, old: str, new: str) -> Callable[..., Any]:
    """The operation as the reference's module has it once a piece of its text is another one."""

    def broken(right: Callable[..., Any]) -> Callable[..., Any]:
        text = inspect.getsource(module)
        if text.count(old) != 1:  # not an AssertionError, as those are what faults are caught by
            raise ValueError(f"{old!r} does not stand once in {module.__name__}: this fault needs another place.")
        names = dict(vars(module))
        exec(compile(text.replace(old, new), str(module.__file__), "exec"), names)

        def wrong(*args: Any, **options: Any) -> None:
            with np.errstate(all="ignore"):
                names[right.__name__](*args, **options)

        return wrong

    return broken


def scaled(factor: float) -> Callable[[np.ndarray], None]:
    def change(output: np.ndarray) -> None:
        output *= factor

    return change


def zeroed(where: Any) -> Callable[[np.ndarray], None]:
    def change(output: np.ndarray) -> None:
        output[where] = 0

    return change


def noisy(output: np.ndarray) -> None:
    output += np.random.default_rng().normal(size=output.shape) * 1e-13


def one_off(output: np.ndarray) -> None:
    """One weight in the middle is wrong by one part in a thousand of the largest."""
    output[tuple(side // 2 for side in output.shape)] += 1e-3 * np.abs(output).max()


def without_tap(right: Callable[..., Any]) -> Callable[..., Any]:
    """The tap below and to the right is left out of the image of the splat and of its transpose alike."""

    def wrong(image: Any, disparity: Any, offsets: Any, *, softness: float, **outputs: Any) -> None:
        from lfgpu.kernels.reference.splat import taps  # the fault needs a look inside

        right(image, disparity, offsets, softness=softness, **outputs)
        for n, offset in enumerate(offsets):
            *_, tap = taps(disparity, offset, softness)
            np.subtract.at(outputs["views_out"][n], tap.target, tap.weight[:, None] * image[tap.inside])

    return wrong


def skewed(weights: np.ndarray) -> np.ndarray:
    """Weights that lie one column to the right of their pixels."""
    return np.roll(weights, 1, axis=2)


def without_itself(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(weights: np.ndarray, values: np.ndarray, *, window: int, sums_out: np.ndarray) -> None:
        right(weights, values, window=window, sums_out=sums_out)
        sums_out -= values

    return wrong


def mirrored(output: np.ndarray) -> None:
    output[:] = output[:, ::-1].copy()


def changing_its_input(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(x: Any, *args: Any, **options: Any) -> Any:
        result = right(x, *args, **options)
        x += 1
        return result

    return wrong


def swapped(offsets: np.ndarray) -> np.ndarray:
    return offsets[:, ::-1].copy()


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


def method(name: str, broken: Callable[[Callable[..., Any]], Callable[..., Any]]) -> Callable[..., Any]:
    """Of the plan that an operation makes one method is turned into a wrong one."""

    def change(plan: Any) -> Any:
        setattr(plan, name, broken(getattr(plan, name)))
        return plan

    return planned(change)


def called(plan: Any, wrong: Callable[..., Any]) -> Any:
    """The plan with another call, and its other methods."""
    others = {name: staticmethod(getattr(plan, name, None)) for name in ("load", "curvature")}
    return type("Wrong", (), {"__call__": staticmethod(wrong), **others})()


def half_curvature(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(curvature_out: Any) -> None:
        right(curvature_out)
        curvature_out *= 0.5

    return wrong


def without_curvature(right: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *state: right(*state[:3])


def half_gradient(plan: Any) -> Any:
    def wrong(disparity: Any, gradient_out: Any, value_out: Any) -> None:
        plan(disparity, gradient_out, value_out)
        gradient_out *= 0.5

    return called(plan, wrong)


def remembering(plan: Any) -> Any:
    """Adds up the values of all its calls."""
    total = np.zeros(1)

    def wrong(disparity: Any, gradient_out: Any, value_out: Any) -> None:
        plan(disparity, gradient_out, value_out)
        total[:] += value_out
        value_out[:] = total

    return called(plan, wrong)


def loading_once(right: Callable[..., Any]) -> Callable[..., Any]:
    """What is loaded first is what stays."""
    loaded: list[Any] = []

    def wrong(*light_field: Any) -> None:
        loaded.append(light_field)
        right(*loaded[0])

    return wrong


def keeping_its_mask(right: Callable[..., Any]) -> Callable[..., Any]:
    """Without a mask, the one before is taken."""
    masks: list[Any] = []

    def wrong(image: Any, recorded: Any, valid: Any) -> None:
        masks.extend([] if valid is None else [valid])
        right(image, recorded, masks[-1] if masks else None)

    return wrong


def without_last_view(right: Callable[..., Any]) -> Callable[..., Any]:
    """The last view is as if it were not valid."""

    def wrong(image: Any, recorded: Any, valid: Any) -> None:
        counts = np.ones(recorded.shape[:3]) if valid is None else valid.copy()
        counts[-1] = 0
        right(image, recorded, counts)

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


def first_inputs(right: Callable[..., Any]) -> Callable[..., Any]:
    """A plan that keeps what it was first called with."""

    def plan_wrong(*args: Any, **options: Any) -> Callable[..., Any]:
        plan, seen = right(*args, **options), []

        def wrong(inputs: Any, *more: Any) -> None:
            seen.append(inputs)
            plan(seen[0], *more)

        return wrong

    return plan_wrong


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


def once_more(right: Callable[..., Any]) -> Callable[..., Any]:
    """Looks only after the body has run."""

    def wrong(body: Callable[[], None], go_on: Any, most: int) -> None:
        body()
        right(body, go_on, most - 1)

    return wrong


def regardless(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(body: Callable[[], None], go_on: Any, most: int) -> None:
        for _ in range(most):
            body()

    return wrong


def without_end(right: Callable[..., Any]) -> Callable[..., Any]:
    return lambda body, go_on, most: right(body, go_on, most + 1)


def while_positive(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(body: Callable[[], None], go_on: Any, most: int) -> None:
        for _ in range(most):
            if go_on[0] <= 0:
                return
            body()

    return wrong


def rejecting_nothing(right: Callable[..., Any]) -> Callable[..., Any]:
    return lambda value, trial_value: right(value + 1e9, trial_value)


def half_the_step(right: Callable[..., Any]) -> Callable[..., Any]:
    """Does not look at the parabola: a step that is not accepted is halved."""

    def wrong(value: Any, trial_value: Any) -> None:
        solver = right.__self__  # type: ignore[attr-defined]
        step, count = solver._step, solver._rejected
        right(value, trial_value)
        if solver._rejected > count:
            solver._step = step / 2

    return wrong


def learning_anyway(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(*state: Any) -> None:
        right.__self__._accepted = True  # type: ignore[attr-defined]
        right(*state)

    return wrong


def keeping_pairs(right: Callable[..., Any]) -> Callable[..., Any]:
    """Begins with the pairs that it has."""

    def wrong(*state: Any) -> None:
        solver = right.__self__  # type: ignore[attr-defined]
        pairs = list(solver._pairs)
        right(*state)
        solver._pairs.extend(pairs)
        solver._turn(*state[:2])

    return wrong


def dropping_a_pair(right: Callable[..., Any]) -> Callable[..., Any]:
    """A pair that is not kept takes the place of the oldest."""

    def wrong(*state: Any) -> None:
        solver = right.__self__  # type: ignore[attr-defined]
        newest = solver._pairs[-1] if solver._pairs else None
        right(*state)
        kept = bool(solver._pairs) and solver._pairs[-1] is not newest
        if solver._accepted and not kept and len(solver._pairs) == solver._pairs.maxlen:
            solver._pairs.popleft()
            solver._turn(*state[:2])

    return wrong


def moving_inwards(right: Callable[..., Any]) -> Callable[..., Any]:
    """Pixels that the gradient holds at a bound are moved by what ties them to others."""

    def wrong(*state: Any) -> None:
        right(*state)
        solver, (x, gradient) = right.__self__, state[:2]  # type: ignore[attr-defined]
        if solver._accepted and solver._pairs:
            projected = lbfgs_module.projected_gradient(x, gradient, solver._low, solver._high)
            direction = -lbfgs_module.two_loop(solver._pairs, projected)
            stopped = ((x <= solver._low) & (direction < 0)) | ((x >= solver._high) & (direction > 0))
            solver._direction = np.where(stopped, 0, direction)

    return wrong


def outside(right: Callable[..., Any]) -> Callable[..., Any]:
    def wrong(x: Any, trial_out: Any) -> None:
        solver = right.__self__  # type: ignore[attr-defined]
        trial_out[:] = x + solver._step * solver._direction

    return wrong


def reporting(change: Callable[..., Any]) -> Callable[..., Any]:
    """Another report than the right one."""
    return method("report", lambda right: lambda: change(right()))


def adding(amount: float) -> Callable[..., Any]:
    """Each residual is larger by `amount`."""
    return method("add", lambda right: lambda residual: right(residual + amount))


def late_norm(plan: Any) -> Any:
    """The norm is looked at when a residual comes."""
    begin, add, norms = plan.begin, plan.add, []

    def add_wrong(residual: Any) -> None:
        plan._norm = float(norms[-1][0]) or 1.0
        add(residual)

    def begin_wrong(norm: Any) -> None:
        norms.append(norm)
        begin(norm)

    plan.begin, plan.add = begin_wrong, add_wrong
    return plan


def quotient(x: Any, y: Any, out: Any) -> None:
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(x, y, out=out)


def invert(output: np.ndarray) -> None:
    output[:] = 1 - output


NO_MASK = method("load", argument(2, lambda _: None))
STAIRS = {"function": "stairs", "size": (2, 2), "bounds": (-50.0, 50.0), "start": -30.0, "memory": 1, "values": 20}


def UNMASKED(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return cases.splat_inputs(replace(SPLAT, masked=False), rng)


def TURNED_INPUTS(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return cases.views_inputs(TURNED, rng)


def WIDE(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return cases.coherence_inputs(replace(COHERENCE, unit=2.0), rng)


def WITHIN(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return cases.coherence_inputs(replace(COHERENCE, bounds=(-0.25, 1.25)), rng)


def SQUARE(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return cases.coherence_inputs(replace(COHERENCE, size=(9, 9), vertical=True), rng)


def SMALL(rng: np.random.Generator) -> SimpleNamespace:  # noqa: N802
    return cases.residuals_inputs(replace(RESIDUALS, most=20), rng)


def COUNTS_CAPTURED(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    """Work that goes on from where it was."""
    total, one = np.zeros((1, 1)), np.ones((1, 1))
    capture = kernels.capture if kernels.capture is not REFERENCE.capture else doing_again
    again = capture(lambda: kernels.axpby(1.0, total, 1.0, one, total), "cpu")
    assert again is not None
    again()
    assert total[0, 0] == 1


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
    Fault("other bits each time", "splat", after(noisy, "views_out"), repeats_of("splat")),
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
    Fault("wrong sign", "nlm_laplacian", after(scaled(-1), "laplacian_out"), NLM_SYMMETRIC),
    Fault("factor 2 too much", "nlm_laplacian", after(scaled(2), "laplacian_out"), value_of("nlm_laplacian")),
    Fault(
        "a constant is not smooth",
        "nlm_laplacian",
        after(lambda a: np.add(a, 1e-3, out=a), "laplacian_out"),
        NLM_SYMMETRIC,
    ),
    Fault(
        "wrong sign, seen in a program", "nlm_laplacian", after(scaled(-1), "laplacian_out"), program(checks.solving)
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
    # vectors
    Fault("in float32", "dot", after(lambda a: np.copyto(a, np.float32(a))), DOUBLE_DOT),
    Fault("of sizes", "dot", lambda right: lambda a, b, out: right(np.abs(a), np.abs(b), out), value_of("dot")),
    Fault(
        "last element skipped",
        "dot",
        lambda right: lambda a, b, out: right(a.ravel()[:-1], b.ravel()[:-1], out),
        value_of("dot"),
    ),
    Fault("adds to its output", "dot", lambda right: lambda a, b, out: out.__iadd__(np.vdot(a, b)), value_of("dot")),
    Fault("factor ignored", "ratio", option("factor", lambda _: 1.0, absent=True), value_of("ratio")),
    Fault("upside down", "ratio", lambda right: lambda a, b, out, **o: right(b, a, out, **o), value_of("ratio")),
    Fault(
        "infinite", "ratio", lambda right: lambda a, b, out, factor=1.0: quotient(factor * a, b, out), value_of("ratio")
    ),
    Fault("in float32", "ratio", after(lambda a: np.copyto(a, np.float32(a))), DOUBLE_NUMBERS),
    Fault("changes its input", "ratio", changing_its_input, value_of("ratio")),
    Fault("nothing done", "copy", lambda right: lambda source, target_out: None, value_of("copy")),
    Fault(
        "numbers exchanged",
        "axpby",
        before(lambda a, _: a.__setitem__(slice(0, 3, 2), [a[2], a[0]])),
        value_of("axpby"),
    ),
    Fault(
        "adds to its output",
        "axpby",
        lambda right: lambda a, x, b, y, out: np.add(a * x + b * y, out, out=out),
        value_of("axpby"),
    ),
    Fault("a sum", "multiply", lambda right: lambda x, y, out: np.add(x, y, out=out), value_of("multiply")),
    Fault("upside down", "divide", lambda right: lambda x, y, out: right(y, x, out), value_of("divide")),
    Fault("infinite", "divide", lambda right: quotient, value_of("divide")),
    Fault("nothing done", "fill", lambda right: lambda value, out: None, value_of("fill")),
    Fault("first element skipped", "fill", lambda right: lambda value, out: right(value, out[1:]), value_of("fill")),
    Fault("0 is chosen", "select", argument(0, lambda condition: condition >= 0), value_of("select")),
    Fault("exchanged", "select", lambda right: lambda c, x, y, out: right(c, y, x, out), value_of("select")),
    Fault("the threshold too", "threshold", argument(1, lambda least: least + 1e-12), value_of("threshold")),
    Fault(
        "clamped", "threshold", lambda right: lambda x, least, out: np.maximum(x, least, out=out), value_of("threshold")
    ),
    Fault("upper bound ignored", "clamp", argument(2, lambda _: 1e9), value_of("clamp")),
    Fault("changes its input", "clamp", changing_its_input, value_of("clamp")),
    # memory
    Fault("no copy", "field", lambda right: lambda values, device: np.asarray(values), value_of("memory")),
    Fault("not zero", "zeros", lambda right: lambda shape, device: np.ones(shape), value_of("memory")),
    Fault("of another shape", "zeros", lambda right: lambda shape, device: np.zeros((*shape, 1)), value_of("memory")),
    Fault("no copy", "numpy", lambda right: lambda array: array, value_of("memory")),
    Fault("of another dtype", "numpy", lambda right: lambda array: right(array).astype(np.float32), value_of("copy")),
    Fault(
        "channels first",
        "image",
        lambda right: lambda values, device: right(np.moveaxis(values, -1, 0), device),
        value_of("image_memory"),
    ),
    Fault(
        "scaled", "image", lambda right: lambda values, device: right(values, device) / 255, value_of("image_memory")
    ),
    Fault(
        "not zero",
        "zeros_image",
        lambda right: lambda shape, device, stored=np.float32: np.ones(shape),
        value_of("image_memory"),
    ),
    Fault("nothing done", "upload", lambda right: lambda values, out: None, value_of("memory")),
    Fault("strides ignored", "upload", argument(0, lambda values: values[..., ::-1]), value_of("memory")),
    Fault("nothing done, to an image", "upload", lambda right: lambda values, out: None, value_of("image_memory")),
    Fault("a copy", "shared", lambda right: lambda field: right(field).copy(), SHARED),
    Fault("turned", "shared", lambda right: lambda field: right(field)[::-1], SHARED),
    Fault("in float32", "scalar", argument(0, np.float32), DOUBLE_NUMBERS),
    Fault("in float32", "number", lambda right: lambda scalar: float(np.float32(right(scalar))), DOUBLE_NUMBERS),
    Fault("not a float", "number", lambda right: lambda scalar: np.float32(right(scalar)), value_of("dot")),
    # control
    Fault("looks afterwards", "repeat", once_more, REPEATS),
    Fault("does not look", "repeat", regardless, REPEATS),
    Fault("once too often", "repeat", without_end, REPEATS),
    Fault("while positive", "repeat", while_positive, REPEATS),
    Fault("nothing done", "capture", lambda right: lambda work, device: lambda: None, captured(checks.solving)),
    Fault("twice", "capture", lambda right: lambda work, device: lambda: (work(), work()), COUNTS_CAPTURED),
    # solvers
    Fault("tolerance ignored", "residuals", option("tolerance", lambda _: 0.0), value_of("residuals", SMALL)),
    Fault("without end", "residuals", option("most", lambda most: most + 1), value_of("residuals")),
    Fault("squared", "residuals", reporting(lambda trace: [r**2 for r in trace]), value_of("residuals")),
    Fault("begins with an old trace", "residuals", reporting(lambda trace: [1.0, *trace]), value_of("residuals")),
    Fault("norm ignored", "residuals", method("begin", argument(0, np.ones_like)), value_of("residuals")),
    Fault("norm not copied", "residuals", planned(lambda plan: late_norm(plan)), value_of("residuals")),
    Fault("larger", "residuals", adding(1e-3), value_of("residuals")),
    Fault("memory of one pair", "lbfgs", option("memory", lambda _: 1), value_of("lbfgs")),
    Fault("begins with old pairs", "lbfgs", method("begin", keeping_pairs), value_of("lbfgs")),
    Fault("curvature ignored", "lbfgs", method("begin", without_curvature), way_of(curvature=True)),
    Fault("no bound", "lbfgs", option("low", lambda _: -99.0), value_of("lbfgs")),
    Fault("no bound of trials", "lbfgs", method("propose", outside), value_of("lbfgs")),
    Fault("held pixels move", "lbfgs", method("learn", moving_inwards), value_of("lbfgs")),
    Fault("held pixels move, seen without a truth", "lbfgs", method("learn", moving_inwards), CONVERGES),
    Fault("first step too long", "lbfgs", option("first_step", lambda s: 1.1 * s), value_of("lbfgs")),
    Fault("takes every trial", "lbfgs", method("judge", rejecting_nothing), way_of(function="lie")),
    Fault(
        "halves its steps",
        "lbfgs",
        method("judge", half_the_step),
        way_of(first_step=50.0, bounds=(-999.0, 999.0), start=0.25),
    ),
    Fault("learns what it did not take", "lbfgs", method("learn", learning_anyway), way_of(function="lie")),
    Fault("a pair that is not kept takes a place", "lbfgs", method("learn", dropping_a_pair), way_of(**STAIRS)),
    Fault("never flat", "lbfgs", option("tolerance", lambda _: -1.0), way_of(flat=0.02, patience=2, values=20)),
    Fault("impatient", "lbfgs", option("patience", lambda _: 1), way_of(flat=0.02, patience=2, values=20)),
    Fault("without end", "lbfgs", option("most", lambda most: most + 1), way_of(most=3)),
    Fault("counts itself short", "lbfgs", reporting(lambda r: (r[0], r[1] - 1, r[2])), value_of("lbfgs")),
    Fault("always flat", "lbfgs", reporting(lambda r: (r[0], r[1], True)), value_of("lbfgs")),
    Fault("learns nothing, seen without a truth", "lbfgs", method("learn", lambda _: lambda *a: None), CONVERGES),
)


@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_single_fault_is_caught(fault: Fault, rng: np.random.Generator) -> None:
    with pytest.raises(AssertionError):
        fault.check(fault.kernels, rng)


def test_reference_passes_every_check_that_catches_faults(rng: np.random.Generator) -> None:
    wrapped = with_operation("dot", REFERENCE.dot)
    for fault in FAULTS:
        fault.check(wrapped, rng)


def test_every_operation_has_a_fault_that_its_check_catches() -> None:
    broken = {fault.operation for fault in FAULTS}
    others = (
        *occlusion_checks.OPERATIONS,
        *sweep_checks.OPERATIONS,
        *volume_checks.OPERATIONS,
        *alignment_checks.OPERATIONS,
        *resampling_checks.OPERATIONS,
        *smoothing_checks.OPERATIONS,
        *range_search_checks.OPERATIONS,
    )
    elsewhere = {
        "name",
        "dtype",
        "devices",
        "is_deterministic",
        "asking",
        "kernel_cache",
        "compiles",
        *map(str, others),
    }
    assert broken == checks.names_of(KernelSet) - elsewhere


# --- a whole broken backend, in the matrix itself ---

ROOT = Path(__file__).parents[2]
REGISTRATION = """
import lfgpu.kernels
from lfgpu import _backends

lfgpu.kernels.__path__.append({folder!r})
_backends._PACKAGES["copied"] = "numpy"
"""
OFFSETS, FLIPPED = "zip(residual, offsets, strict=True)", "zip(residual, offsets * (-1, 1), strict=True)"
"""In `splat_vjp`: the sign of du is the wrong one. The data term of the copy goes through it too."""


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1, f"{old!r} does not stand once in {path.name}: this test needs another fault"
    path.write_text(text.replace(old, new))


def outcomes_of_the_matrix(folder: Path, cases: str) -> dict[str, str]:
    """Outcome of each test of the matrix for the backend `copied`, a package in that folder."""
    (folder / "register_copied.py").write_text(REGISTRATION.format(folder=str(folder)))
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    options = ("-p", "register_copied", "-p", "no:cacheprovider", "-rA", "--tb=no", "--backend=copied", "-k", cases)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options, str(ROOT / "tests" / "kernels" / "test_matrix.py")],
        cwd=ROOT,
        env={**environment, "PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        timeout=600,
    )
    found = re.findall(r"^(PASSED|FAILED|ERROR) \S+::(\S+)", done.stdout, re.MULTILINE)
    assert found, done.stdout + done.stderr
    return {test: outcome for outcome, test in found}


@pytest.mark.parametrize("fault", [False, True], ids=["right", "broken"])
def test_matrix_finds_a_new_backend_and_what_is_wrong_with_it(fault: bool, tmp_path: Path) -> None:
    copied = shutil.copytree(ROOT / "kernels" / "reference", tmp_path / "copied")
    edit(copied / "backend.py", 'name = "reference"', 'name = "copied"')
    if fault:
        edit(copied / "splat.py", OFFSETS, FLIPPED)
    outcomes = outcomes_of_the_matrix(tmp_path, "one-row-of-views or devices_are_names")
    wrong = {
        "test_operation_equals_the_reference[copied-cpu-splat_vjp-one-row-of-views]",
        "test_operation_equals_the_reference[copied-cpu-data_term-one-row-of-views]",
        "test_splat_vjp_is_the_adjoint_of_splat_jvp[copied-cpu-one-row-of-views]",
    }
    assert wrong <= outcomes.keys()
    assert len(outcomes) > 2 * len(wrong)
    assert outcomes == {test: "FAILED" if fault and test in wrong else "PASSED" for test in outcomes}
