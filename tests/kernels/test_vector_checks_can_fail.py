"""The checks of fields, numbers, memory and control can fail: the reference with one single fault is caught by them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cases
import numpy as np
import programs
import splat_cases
import vector_cases
import vector_checks
from single_faults import REFERENCE, Check, Fault, single_fault_tests, values_of, with_operation
from ways_to_be_wrong import after, argument, before, changing_its_input, option

from lfgpu.contract import KernelSet

SPLAT = splat_cases.SplatCase("splat", offsets=cases.IRREGULAR, masked=True, dtype="uint8")
VECTOR = vector_cases.VectorCase("vector", (11, 14))

value_of = values_of(
    vector_checks.OPERATIONS,
    {
        "splat": lambda rng: splat_cases.splat_inputs(SPLAT, rng),
        "vector": lambda rng: vector_cases.vector_inputs(VECTOR, rng),
    },
)


def captured(make: programs.MakeProgram) -> Check:
    """Of a backend that captures (a right one does the work once more)."""

    def check(kernels: KernelSet, rng: np.random.Generator) -> None:
        first, second = (programs.program_inputs(make, rng) for _ in range(2))
        able = kernels if kernels.capture is not REFERENCE.capture else with_operation("capture", doing_again)
        assert programs.check_capture(able, "cpu", make, first, second)

    return check


def doing_again(work: Callable[[], None], device: str) -> Callable[[], None]:
    return work


def forgetful(right: Callable[..., Any]) -> Callable[..., Any]:
    """The next direction is that of steepest descent."""

    def wrong(p: Any, q: Any, preconditioner: Any, rz: Any, x: Any, r: Any) -> None:
        right(p, q, preconditioner, rz, x, r)
        p[:] = preconditioner * r

    return wrong


DOUBLE_DOT: Check = lambda kernels, rng: vector_checks.check_dot_in_double(kernels, "cpu")  # noqa: E731
DOUBLE_NUMBERS: Check = lambda kernels, rng: vector_checks.check_numbers_in_double(kernels, "cpu")  # noqa: E731
SHARED: Check = lambda kernels, rng: vector_checks.check_shared(kernels, "cpu")  # noqa: E731
REPEATS: Check = lambda kernels, rng: programs.check_repeat(kernels, "cpu")  # noqa: E731


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


def quotient(x: Any, y: Any, out: Any) -> None:
    with np.errstate(divide="ignore", invalid="ignore"):
        np.divide(x, y, out=out)


def COUNTS_CAPTURED(kernels: KernelSet, rng: np.random.Generator) -> None:  # noqa: N802
    """Work that goes on from where it was."""
    total, one = np.zeros((1, 1)), np.ones((1, 1))
    capture = kernels.capture if kernels.capture is not REFERENCE.capture else doing_again
    again = capture(lambda: kernels.axpby(1.0, total, 1.0, one, total), "cpu")
    assert again is not None
    again()
    assert total[0, 0] == 1


FAULTS = (
    # vectors
    Fault("squares of residuals alone", "conjugate_step", argument(2, np.ones_like), value_of("conjugate_step")),
    Fault("the old direction forgotten", "conjugate_step", forgetful, value_of("conjugate_step")),
    Fault("its number kept", "conjugate_step", argument(3, np.copy), value_of("conjugate_step")),
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
    Fault("nothing done", "capture", lambda right: lambda work, device: lambda: None, captured(programs.solving)),
    Fault("twice", "capture", lambda right: lambda work, device: lambda: (work(), work()), COUNTS_CAPTURED),
)


test_single_fault_is_caught, test_reference_passes_every_check_that_catches_faults = single_fault_tests(FAULTS)
