"""The operations on fields and numbers, and memory: cases and checks."""

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from checks import Case, Desk, Operation, Outputs, Values, float32, largest_error, relative_to_terms, size

from lfgpu.contract import KernelSet
from lfgpu.errors import BackendError


@dataclass(frozen=True)
class VectorCase(Case):
    """Fields of one shape."""

    shape: tuple[int, ...]
    tolerance: float = 1e-6


VECTOR_CASES = (
    VectorCase("map", (11, 14)),
    VectorCase("one pixel", (1, 1)),
    VectorCase("line", (1, 1000)),
    VectorCase("stack", (3, 7, 5)),
    VectorCase("work for several threads", (301, 257)),
)


def vector_inputs(case: VectorCase, rng: np.random.Generator) -> SimpleNamespace:
    """Fields, of which `ties` and `holes` have many an element that is 0, and two numbers."""
    x, y, condition = float32(rng.normal(size=(3, *case.shape)))
    alpha, beta = (float(number) for number in float32(rng.normal(size=2)))
    ties = np.where(rng.random(case.shape) < 0.3, np.float32(0), condition)
    holes = np.where(rng.random(case.shape) < 0.3, np.float32(0), np.float32(0.1) * np.sign(y) + y)
    return SimpleNamespace(x=x, y=y, ties=ties, holes=holes, alpha=alpha, beta=beta, low=-0.5, high=0.75)


def dot(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.number_out()
    desk.kernels.dot(desk.field(i.x), desk.field(i.y), out)
    return {"sum": desk.kernels.number(out)}


def ratio(desk: Desk, i: SimpleNamespace) -> Outputs:
    kernels, a, b, zero = desk.kernels, desk.number(i.alpha), desk.number(i.beta), desk.number(0.0)
    out = {name: desk.number_out() for name in ("apart", "times factor", "by 0")}
    out |= {"onto numerator": desk.number_out(i.alpha), "onto denominator": desk.number_out(i.beta)}
    kernels.ratio(a, b, out["apart"])
    kernels.ratio(a, b, out["times factor"], factor=-2.5)
    kernels.ratio(a, zero, out["by 0"])
    kernels.ratio(out["onto numerator"], b, out["onto numerator"])
    kernels.ratio(a, out["onto denominator"], out["onto denominator"])
    return {name: kernels.number(scalar) for name, scalar in out.items()}


def weights(i: SimpleNamespace) -> Values:
    """A preconditioner."""
    return (0.5 + np.abs(i.ties)).astype(np.float32)


def conjugate_step(desk: Desk, i: SimpleNamespace) -> Outputs:
    """A step of a system that is a diagonal, one along nothing, from nothing, and one when there is nothing to do."""
    kernels, shape = desk.kernels, i.x.shape
    preconditioner, q = desk.field(weights(i)), desk.field((1 + np.abs(i.holes)) * i.x)
    rz = desk.number_out(float(np.sum(weights(i).astype(np.float64) * i.y.astype(np.float64) ** 2)))
    p, x, r = desk.held(i.x), desk.held(i.x[::-1]), desk.held(i.y)
    kernels.conjugate_step(p, q, preconditioner, rz, x, r, desk.number(1.0))
    still, at, left, none = desk.held(np.zeros(shape)), desk.held(i.x), desk.held(i.y), desk.number_out(0.0)
    kernels.conjugate_step(still, q, preconditioner, none, at, left, desk.number(1.0))
    out = {"p": p, "x": x, "r": r, "rz": kernels.number(rz)}
    done_x, done_r, along = desk.held(i.x[::-1]), desk.held(i.y), desk.held(i.x)
    for done in (0.0, -1.0):
        kernels.conjugate_step(along, q, preconditioner, desk.number_out(1.0), done_x, done_r, desk.number(done))
    out |= {"done x": done_x, "done r": done_r}
    return {**out, "still": still, "at": at, "left": left, "from 0": kernels.number(none)}


def copy(desk: Desk, i: SimpleNamespace) -> Outputs:
    out, number = desk.out(i.x.shape), desk.number_out()
    desk.kernels.copy(desk.field(i.x), out)
    desk.kernels.copy(desk.number(i.alpha), number)
    return {"target": out, "number": desk.kernels.number(number)}


def axpby(desk: Desk, i: SimpleNamespace) -> Outputs:
    """With coefficients from the host and from the device, into an array apart and onto its inputs."""
    kernels, x, y = desk.kernels, desk.field(i.x), desk.field(i.y)
    a, b = desk.number(i.alpha), desk.number(i.beta)
    out: Outputs = {}
    for numbers, (alpha, beta) in {
        "": (i.alpha, i.beta),
        "alpha there": (a, i.beta),
        "beta there": (i.alpha, b),
        "both there": (a, b),
    }.items():
        apart, onto_x, onto_y = desk.out(i.x.shape), desk.held(i.x), desk.held(i.y)
        kernels.axpby(alpha, x, beta, y, apart)
        kernels.axpby(alpha, onto_x, beta, y, onto_x)
        kernels.axpby(alpha, x, beta, onto_y, onto_y)
        out |= {f"apart {numbers}": apart, f"onto x {numbers}": onto_x, f"onto y {numbers}": onto_y}
    alone, number = desk.held(i.x), desk.number_out(i.alpha)
    kernels.axpby(i.alpha, alone, 0.0, alone, alone)
    kernels.axpby(2.0, number, 1.0, b, number)  # numbers are added as fields are
    return {**out, "scaled": alone, "number": kernels.number(number)}


def multiply(desk: Desk, i: SimpleNamespace) -> Outputs:
    return _pairwise(desk, desk.kernels.multiply, i.x, i.y)


def divide(desk: Desk, i: SimpleNamespace) -> Outputs:
    return _pairwise(desk, desk.kernels.divide, i.x, i.holes)


def _pairwise(desk: Desk, operation: Callable[[Any, Any, Any], None], a: Values, b: Values) -> Outputs:
    """An operation on two fields, into one apart and onto either of them."""
    x, y = desk.field(a), desk.field(b)
    apart, onto_x, onto_y = desk.out(a.shape), desk.held(a), desk.held(b)
    operation(x, y, apart)
    operation(onto_x, y, onto_x)
    operation(x, onto_y, onto_y)
    return {"apart": apart, "onto x": onto_x, "onto y": onto_y}


def fill(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"number": desk.out(i.x.shape), "number there": desk.out(i.x.shape)}
    desk.kernels.fill(i.alpha, out["number"])
    desk.kernels.fill(desk.number(i.beta), out["number there"])
    return out


def select(desk: Desk, i: SimpleNamespace) -> Outputs:
    kernels, condition, x, y = desk.kernels, desk.field(i.ties), desk.field(i.x), desk.field(i.y)
    out = {"apart": desk.out(i.x.shape), "onto condition": desk.held(i.ties)}
    out |= {"onto x": desk.held(i.x), "onto y": desk.held(i.y)}
    kernels.select(condition, x, y, out["apart"])
    kernels.select(out["onto condition"], x, y, out["onto condition"])
    kernels.select(condition, out["onto x"], y, out["onto x"])
    kernels.select(condition, x, out["onto y"], out["onto y"])
    return out


def threshold(desk: Desk, i: SimpleNamespace) -> Outputs:
    """The threshold is one of the values."""
    apart, onto_x, threshold = desk.out(i.x.shape), desk.held(i.x), float(i.x.flat[0])
    desk.kernels.threshold(desk.field(i.x), threshold, apart)
    desk.kernels.threshold(onto_x, threshold, onto_x)
    return {"apart": apart, "onto x": onto_x}


def clamp(desk: Desk, i: SimpleNamespace) -> Outputs:
    apart, onto_x = desk.out(i.x.shape), desk.held(i.x)
    desk.kernels.clamp(desk.field(i.x), i.low, i.high, apart)
    desk.kernels.clamp(onto_x, i.low, i.high, onto_x)
    return {"apart": apart, "onto x": onto_x}


def memory(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Fields are copies of what they were made of, and what is read from them is a copy of them."""
    source, other = i.x.copy(), i.y[..., ::-1].astype(np.float64)
    field, strided = desk.kernels.field(source, desk.device), desk.field(i.x[..., ::-1].T)
    uploaded = desk.out(i.y.shape)
    desk.kernels.upload(other, uploaded)
    source[:] = -9.0
    other[:] = -9.0
    desk.kernels.numpy(field)[:] = 9.0
    zeros = desk.kernels.zeros(i.x.shape, desk.device)
    number = desk.kernels.number(desk.number(i.alpha))
    read, beside = desk.kernels.read(field, desk.number(i.beta))
    cleared = desk.kernels.clear(desk.kernels.field(i.x, desk.device))
    return {
        "field": field,
        "strided": strided,
        "uploaded": uploaded,
        "zeros": zeros,
        "cleared": cleared,
        "number": number,
        "read": read.ravel().tolist(),
        "number beside": beside,
    }


def image_memory(desk: Desk, i: SimpleNamespace) -> Outputs:
    source, other = i.recorded.copy(), i.recorded[:, ::-1].copy()
    image = desk.kernels.image(source, desk.device)
    uploaded = desk.stored_out(i.recorded.shape, i.recorded.dtype.type)
    desk.kernels.upload(other[:, ::-1], uploaded)
    source[:] = 1
    other[:] = 1
    return {
        "image": desk.stored_values(image),
        "uploaded": desk.stored_values(uploaded),
        "strided": desk.stored_values(desk.kernels.image(i.recorded[:, :, ::-1], desk.device)),
        "zeros": desk.kernels.zeros_image(i.recorded.shape, desk.device),
        "cleared": desk.stored_values(desk.kernels.clear(desk.kernels.image(i.recorded, desk.device))),
        "stored zeros": desk.stored_values(
            desk.kernels.zeros_image(i.recorded.shape, desk.device, i.recorded.dtype.type)
        ),
    }


def dot_error(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to the sum of the products' sizes: the sum itself may nearly cancel."""
    return {"sum": largest_error(got["sum"], want["sum"], float(np.abs(i.x.astype(np.float64) * i.y).sum()))}


def axpby_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """The two products may nearly cancel: their rounding shows in the sum, if fields are of few pixels."""
    term = 0.1 * abs(i.alpha) * size(i.x)
    return {name: largest_error(got[name], want[name], max(float(np.abs(want[name]).max()), term)) for name in want}


def conjugate_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """The new direction is the preconditioned residual and some of the old direction: those two may nearly cancel."""
    residual = max(size(i.y), float(np.abs(want["r"]).max()))
    terms = relative_to_terms(x=lambda i: size(i.x), r=lambda _: residual, rz=lambda i: size(i.y) ** 2)
    scale = max(float(np.abs(want["p"]).max()), float(weights(i).max()) * residual)
    return {**terms(got, want, i), "p": largest_error(got["p"], want["p"], scale)}


DOT = Operation(dot, "vector", dot_error)
OPERATIONS = (
    DOT,
    Operation(ratio, "vector"),
    Operation(conjugate_step, "vector", conjugate_errors),
    Operation(copy, "vector"),
    Operation(axpby, "vector", axpby_errors),
    Operation(multiply, "vector"),
    Operation(divide, "vector"),
    Operation(fill, "vector"),
    Operation(select, "vector"),
    Operation(threshold, "vector"),
    Operation(clamp, "vector"),
    Operation(memory, "vector"),
    Operation(image_memory, "splat"),
)


def check_dot_in_double(kernels: KernelSet, device: str) -> None:
    """`dot` accumulates in float64: 1 + 2⁻³⁰ is not 1."""
    values = np.array([1.0, 2.0**-15, -(2.0**-15)], np.float32)
    fields = (kernels.field(a, device) for a in (values, np.abs(values) * (1, 1, 0)))
    product = kernels.scalar(0.0, device)
    kernels.dot(*fields, product)
    assert kernels.number(product) == 1.0 + 2.0**-30, "dot rounds its sum to float32"


def check_numbers_in_double(kernels: KernelSet, device: str) -> None:
    """A number on the device is a float64 wherever it goes: 1 + 2⁻⁴⁰ is not 1."""
    fine = 1.0 + 2.0**-40
    number, out = kernels.scalar(fine, device), kernels.scalar(0.0, device)
    assert kernels.number(number) == fine, "a number is rounded"
    kernels.copy(number, out)
    assert kernels.number(out) == fine, "copy rounds a number"
    kernels.axpby(3.0, number, -1.0, out, out)
    assert kernels.number(out) == 2 * fine, "axpby rounds a number"
    kernels.ratio(number, kernels.scalar(3.0, device), out, factor=7.0)
    assert abs(kernels.number(out) - 7 * fine / 3) <= 1e-15, "ratio rounds to float32"
    small = kernels.scalar(2.0**-40, device)  # of 1 + 2⁻⁴⁰ the root would round anyway
    trace = kernels.residuals(device, tolerance=0.0, most=5)
    trace.begin(kernels.scalar(3.0, device))
    trace.add(small)
    assert abs(trace.report()[0] / np.sqrt(2.0**-40 / 3) - 1) <= 1e-14, "residuals are rounded"
    options = {"low": -1.0, "high": 1.0, "first_step": 0.1, "tolerance": 0.0, "patience": 3, "most": 5}
    solver = kernels.lbfgs((1, 1), device, memory=2, **options)
    x, gradient = (kernels.field(np.full((1, 1), value), device) for value in (0.5, 2.0**-10))
    value = kernels.scalar(2.0 + 2.0**-40, device)
    solver.begin(x, gradient, value)
    solver.judge(value, number)
    assert solver.report()[0] == [2.0 + 2.0**-40, fine], "values in the trace are rounded"
    assert kernels.number(value) == fine, "an accepted value is rounded"


def check_shared(kernels: KernelSet, device: str) -> bool:
    """Whether other libraries can look at a field of the CPU; they see what becomes of it."""
    field = kernels.field(np.arange(6.0).reshape(2, 3), device)
    try:
        seen = np.from_dlpack(kernels.shared(field))
    except BackendError:
        return False
    np.testing.assert_array_equal(seen, [[0, 1, 2], [3, 4, 5]])
    kernels.fill(7.0, field)
    np.testing.assert_array_equal(seen, np.full((2, 3), 7))
    np.testing.assert_array_equal(np.asarray(kernels.shared(field)), np.full((2, 3), 7))
    return True
