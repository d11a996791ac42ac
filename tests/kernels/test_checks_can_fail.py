"""The checks of memory, numbers, control and programs notice faults, which mutants of the reference's code are not."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import alignment_checks
import checks
import numpy as np
import programs
import pytest
import range_search_checks
import smoothing_checks
import splat_checks
import sweep_checks
import vector_checks
import volume_checks

from lfgpu._backends import load
from lfgpu.contract import KernelSet

pytestmark = pytest.mark.thorough

REFERENCE = load("reference")
SPLAT = splat_checks.SplatCase("splat", offsets=checks.IRREGULAR, masked=True, dtype="uint8")
VECTOR = vector_checks.VectorCase("vector", (11, 14))

Operation = Callable[..., Any]
Check = Callable[[KernelSet], Any]


def with_operation(name: str, operation: Any) -> KernelSet:
    """The reference with another operation in the place of one of its own."""
    return cast(KernelSet, SimpleNamespace(**{**vars(REFERENCE), name: operation}))


def rng() -> np.random.Generator:
    """The same numbers each time: among new ones, a fault might now and then make no difference."""
    return np.random.default_rng(0)


def value_of(name: str) -> Check:
    """The check of an operation against the reference."""
    (operation,) = (found for found in (*vector_checks.OPERATIONS, *splat_checks.OPERATIONS) if str(found) == name)
    inputs = splat_checks.splat_inputs(SPLAT, rng()) if operation.inputs == "splat" else vector_inputs()
    return lambda kernels: checks.check_value(kernels, "cpu", operation, inputs, 1e-5, again=True)


def vector_inputs() -> SimpleNamespace:
    return vector_checks.vector_inputs(VECTOR, rng())


def program(make: programs.MakeProgram) -> Check:
    return lambda kernels: programs.check_program(kernels, "cpu", make, programs.program_inputs(make, rng()))


def captured(kernels: KernelSet) -> None:
    """Of a backend that captures: a right one does the work once more, and begins where it was."""
    able = kernels if kernels.capture is not REFERENCE.capture else with_operation("capture", lambda work, _: work)
    random, make = rng(), programs.solving
    first, second = (programs.program_inputs(make, random) for _ in range(2))
    assert programs.check_capture(able, "cpu", make, first, second)
    total, one = np.zeros((1, 1)), np.ones((1, 1))
    again = able.capture(lambda: able.axpby(1.0, total, 1.0, one, total), "cpu")
    again()
    assert total[0, 0] == 1


def double_dot(kernels: KernelSet) -> None:
    vector_checks.check_dot_in_double(kernels, "cpu")


def double_numbers(kernels: KernelSet) -> None:
    vector_checks.check_numbers_in_double(kernels, "cpu")


def shared(kernels: KernelSet) -> None:
    vector_checks.check_shared(kernels, "cpu")


def repeats(kernels: KernelSet) -> None:
    programs.check_repeat(kernels, "cpu")


# --- ways to be wrong: each turns a right operation into a wrong one ---


def after(change: Callable[[Any], Any]) -> Callable[[Operation], Operation]:
    """The last array that it is given is changed in place afterwards."""

    def broken(right: Operation) -> Operation:
        def wrong(*arguments: Any, **options: Any) -> Any:
            result = right(*arguments, **options)
            change([value for value in (*arguments, *options.values()) if isinstance(value, np.ndarray)][-1])
            return result

        return wrong

    return broken


def argument(index: int, change: Callable[[Any], Any]) -> Callable[[Operation], Operation]:
    def broken(right: Operation) -> Operation:
        return lambda *a, **options: right(*a[:index], change(a[index]), *a[index + 1 :], **options)

    return broken


def option(name: str, change: Callable[[Any], Any]) -> Callable[[Operation], Operation]:
    return lambda right: lambda *a, **options: right(*a, **options | {name: change(options[name])})


def changing_its_input(right: Operation) -> Operation:
    def wrong(x: Any, *arguments: Any, **options: Any) -> None:
        right(x, *arguments, **options)
        x += 1

    return wrong


def looping(times: Callable[[Any, int], int]) -> Callable[[Operation], Operation]:
    """A loop that goes on for a number of times, or while there is anything to do."""

    def broken(right: Operation) -> Operation:
        def wrong(body: Callable[[], None], go_on: Any, most: int) -> None:
            for _ in range(times(go_on, most)):
                body()
            right(body, go_on, most - 1)

        return wrong

    return broken


def while_positive(right: Operation) -> Operation:
    def wrong(body: Callable[[], None], go_on: Any, most: int) -> None:
        for _ in range(most):
            if go_on[0] > 0:
                body()

    return wrong


def in_float32(values: Any) -> None:
    np.copyto(values, np.float32(values))


def noise(values: Any) -> None:
    values += np.random.default_rng().normal(size=values.shape) * 1e-13


def double(values: Any) -> None:
    values *= 2


FAULTS: dict[tuple[str, str], tuple[Callable[[Operation], Operation], Check]] = {
    ("dot", "in float32"): (after(in_float32), double_dot),
    ("ratio", "in float32"): (after(in_float32), double_numbers),
    ("scalar", "in float32"): (argument(0, np.float32), double_numbers),
    ("number", "in float32"): (lambda right: lambda scalar: float(np.float32(right(scalar))), double_numbers),
    ("number", "not a float"): (lambda right: lambda scalar: np.float32(right(scalar)), value_of("dot")),
    ("numpy", "of another type"): (lambda right: lambda array: right(array).astype(np.float32), value_of("copy")),
    ("clamp", "changes its input"): (changing_its_input, value_of("clamp")),
    ("ratio", "changes its input"): (changing_its_input, value_of("ratio")),
    ("splat", "changes its input"): (changing_its_input, value_of("splat")),
    ("splat", "other bits each time"): (after(noise), value_of("splat")),
    ("copy", "nothing done"): (lambda right: lambda source, target_out: None, value_of("copy")),
    ("fill", "first left out"): (lambda right: lambda value, out: right(value, out[1:]), value_of("fill")),
    ("field", "no copy"): (lambda right: lambda values, device: np.asarray(values), value_of("memory")),
    ("numpy", "no copy"): (lambda right: lambda array: array, value_of("memory")),
    ("zeros", "not zero"): (lambda right: lambda shape, device: np.ones(shape), value_of("memory")),
    ("zeros", "of another shape"): (lambda right: lambda shape, device: np.zeros((*shape, 1)), value_of("memory")),
    ("upload", "nothing done"): (lambda right: lambda values, out: None, value_of("memory")),
    ("upload", "nothing done to an image"): (lambda right: lambda values, out: None, value_of("image_memory")),
    ("upload", "strides ignored"): (argument(0, lambda values: values[..., ::-1]), value_of("memory")),
    ("image", "channels first"): (argument(0, lambda values: np.moveaxis(values, -1, 0)), value_of("image_memory")),
    ("image", "scaled"): (lambda right: lambda *a: right(*a) / 255, value_of("image_memory")),
    ("zeros_image", "not zero"): (lambda right: lambda shape, *_: np.ones(shape), value_of("image_memory")),
    ("clear", "nothing done"): (lambda right: lambda out: out, value_of("memory")),
    ("clear", "nothing done to an image"): (lambda right: lambda out: out, value_of("image_memory")),
    ("shared", "a copy"): (lambda right: lambda field: right(field).copy(), shared),
    ("shared", "turned"): (lambda right: lambda field: right(field)[::-1], shared),
    ("repeat", "looks afterwards"): (looping(lambda go_on, most: 1), repeats),
    ("repeat", "does not look"): (looping(lambda go_on, most: most), repeats),
    ("repeat", "once too often"): (lambda right: lambda body, go_on, most: right(body, go_on, most + 1), repeats),
    ("repeat", "while positive"): (while_positive, repeats),
    ("capture", "nothing done"): (lambda right: lambda work, device: lambda: None, captured),
    ("capture", "twice"): (lambda right: lambda work, device: lambda: (work(), work()), captured),
    ("repeat", "in a program"): (lambda right: lambda body, go_on, most: None, program(programs.counting)),
    ("nlm_laplacian", "in a program"): (after(double), program(programs.solving)),
    ("multiply", "in a program"): (after(double), program(programs.minimizing)),
    ("data_term", "in a program"): (option("scale", lambda s: 2 * s), program(programs.comparing)),
    ("plane_sweep", "in a program"): (option("scale", lambda s: 2 * s), program(sweep_checks.sweeping)),
    ("winner_takes_all", "in a program"): (option("step", lambda s: 2 * s), program(volume_checks.finding_the_lowest)),
    ("distinct_minimum", "in a program"): (after(double), program(range_search_checks.finding_what_is_distinct)),
    ("alignment", "in a program"): (option("scale", lambda s: 2 * s), program(alignment_checks.stepping)),
    ("smooth_views", "in a program"): (option("scale", lambda _: 0.5), program(smoothing_checks.showing_less_noise)),
}
"""By the name of an operation and what is wrong with it: what makes it wrong, and the check that must fail."""


@pytest.mark.parametrize("fault", FAULTS, ids=" ".join)
def test_a_fault_fails_a_check_that_the_reference_passes(fault: tuple[str, str]) -> None:
    broken, check = FAULTS[fault]
    right = getattr(REFERENCE, fault[0])
    check(with_operation(fault[0], right))
    with pytest.raises(AssertionError), np.errstate(all="ignore"):
        check(with_operation(fault[0], broken(right)))
