"""The checks of the kernel matrix. Each takes a backend, and raises AssertionError where it breaks the contract.

They know nothing of pytest, so that `test_checks_can_fail.py` can hold broken backends against the same ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfgpu._backends import load
from lfgpu.contract import REDUCTION, KernelSet, StructureFilters, half_window
from lfgpu.errors import BackendError

Values = NDArray[Any]
Outputs = dict[str, Any]
"""Fields and images of a backend, floats that it gave, and lists of such."""


class Desk:
    """Arrays of one backend on one device: inputs whose changes would be noticed, outputs that hold garbage."""

    def __init__(self, kernels: KernelSet, device: str) -> None:
        self.kernels, self.device = kernels, device
        self._inputs: list[tuple[Any, Values]] = []
        self._numbers: list[tuple[Any, float]] = []

    def field(self, values: Values) -> Any:
        return self._remember(self.kernels.field(values, self.device))

    def image(self, values: Values) -> Any:
        return self._remember(self.kernels.image(values, self.device))

    def out(self, shape: tuple[int, ...]) -> Any:
        return self.kernels.field(np.full(shape, np.nan, np.float32), self.device)

    def image_out(self, shape: tuple[int, ...]) -> Any:
        return self.kernels.image(np.full(shape, np.nan, np.float32), self.device)

    def stored_out(self, shape: tuple[int, ...], stored: Any) -> Any:
        """An image of garbage of the NumPy type `stored`."""
        out = self.kernels.zeros_image(shape, self.device, stored)
        garbage = np.nan if np.dtype(stored).kind == "f" else np.iinfo(stored).max
        self.kernels.upload(np.full(shape, garbage, stored), out)
        return out

    def held(self, values: Values) -> Any:
        """A field that is input and output."""
        return self.kernels.field(values, self.device)

    def number(self, value: float) -> Any:
        scalar = self.kernels.scalar(value, self.device)
        self._numbers.append((scalar, value))
        return scalar

    def number_out(self, value: float = np.nan) -> Any:
        return self.kernels.scalar(value, self.device)

    def stored_values(self, image: Any) -> Any:
        """What an image holds as a field: stored values are whole numbers or floats, whatever they are read as."""
        return self.kernels.field(self.kernels.numpy(image), self.device)

    def check_inputs_unchanged(self) -> None:
        for array, before in self._inputs:
            np.testing.assert_array_equal(self.kernels.numpy(array), before, "an input was changed")
        for scalar, number in self._numbers:
            np.testing.assert_equal(self.kernels.number(scalar), number, "a number was changed")

    def _remember(self, array: Any) -> Any:
        self._inputs.append((array, self.kernels.numpy(array).copy()))
        return array


# --- the operations: inputs to outputs ---


def names_of(contract: type) -> set[str]:
    """The names of all operations and facts of a contract; what only some backends have is left out."""
    named = {name for base in contract.__mro__ for name in vars(base) if base.__module__.startswith("lfgpu.contract")}
    return {name for name in named if not name.startswith("_")} - {"streaming", "recording"}


def splat(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"views": desk.image_out(i.views.shape), "coverage": desk.out(i.views.shape[:3])}
    desk.kernels.splat(
        desk.image(i.image),
        desk.field(i.disparity),
        desk.field(i.offsets),
        softness=i.softness,
        views_out=out["views"],
        coverage_out=out["coverage"],
    )
    return out


def splat_transpose(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.image_out(i.image.shape)
    desk.kernels.splat_transpose(
        desk.image(i.views), desk.field(i.disparity), desk.field(i.offsets), softness=i.softness, image_out=out
    )
    return {"image": out}


def splat_jvp(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.image_out(i.views.shape)
    desk.kernels.splat_jvp(
        desk.image(i.image),
        desk.field(i.disparity),
        desk.field(i.tangent),
        desk.field(i.offsets),
        softness=i.softness,
        views_out=out,
    )
    return {"views": out}


def splat_vjp(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.disparity.shape)
    desk.kernels.splat_vjp(
        desk.image(i.image),
        desk.field(i.disparity),
        desk.image(i.views),
        desk.field(i.offsets),
        softness=i.softness,
        gradient_out=out,
    )
    return {"gradient": out}


def data_term(desk: Desk, i: SimpleNamespace) -> Outputs:
    """The value and the gradient after another light field was loaded and compared, which leaves no trace."""
    plan = desk.kernels.data_term(i.recorded.shape, desk.field(i.offsets), scale=i.scale, softness=i.softness)
    gradient, value = desk.out(i.disparity.shape), desk.number_out()
    other_mask = desk.field(np.arange(i.recorded[..., 0].size).reshape(i.recorded.shape[:3]) % 2)
    plan.load(desk.image(i.image[::-1] + 1), desk.image(i.recorded[:, ::-1]), other_mask)
    plan(desk.field(i.disparity[::-1, ::-1]), gradient, value)
    plan.load(desk.image(i.image), desk.image(i.recorded), None if i.valid is None else desk.field(i.valid))
    plan(desk.field(i.disparity[::-1, ::-1]), gradient, value)
    plan(desk.field(i.disparity), gradient, value)
    curvature = desk.out(i.disparity.shape)
    plan.curvature(curvature)
    return {"value": desk.kernels.number(value), "gradient": gradient, "curvature": curvature}


def seen_by_reference(desk: Desk, i: SimpleNamespace) -> Outputs:
    known, valid = desk.field(i.known), desk.field(i.valid)
    masks = {"anything": (None, None), "known": (known, None), "valid": (None, valid), "both": (known, valid)}
    out = {name: desk.out(i.valid.shape) for name in masks}
    disparity, offsets = desk.field(i.disparity), desk.field(i.offsets)
    for name, given in masks.items():
        desk.kernels.seen_by_reference(disparity, offsets, *given, seen_out=out[name])
    return out


def intensities(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"first": desk.image_out(i.views.shape[1:]), "one": desk.image_out(i.views.shape[1:])}
    views, valid = desk.image(i.views), None if i.valid is None else desk.field(i.valid)
    for name, index in (("first", 0), ("one", i.index)):
        desk.kernels.intensities(views, index, valid, scale=i.scale, fill=i.fill, image_out=out[name])
    return out


def line_of_views(desk: Desk, i: SimpleNamespace) -> Outputs:
    _, height, width, channels = i.views.shape
    size = (width, height) if i.vertical else (height, width)
    out = desk.stored_out((len(i.line), *size, channels), i.views.dtype.type)
    desk.kernels.line_of_views(desk.image(i.views), i.line, vertical=i.vertical, epis_out=out)
    fields = desk.out((len(i.line), *size))
    desk.kernels.line_of_views(desk.field(i.views[..., 0]), i.line, vertical=i.vertical, epis_out=fields)
    return {"epis": desk.stored_values(out), "fields": fields}


def normalization(desk: Desk, i: SimpleNamespace) -> Outputs:
    """Detail after that of other views, which leaves no trace."""
    plan = desk.kernels.normalization(i.views.shape, desk.device, scale=i.scale, sigma=i.sigma, floor=i.floor)
    out = desk.stored_out(i.views.shape, i.detail_dtype)
    other_mask = desk.field(np.arange(i.views[..., 0].size).reshape(i.views.shape[:3]) % 3)
    plan(desk.image(i.views[::-1, ::-1]), other_mask, out)
    plan(desk.image(i.views), None if i.valid is None else desk.field(i.valid), out)
    return {"detail": desk.stored_values(out)}


def nlm_weights(desk: Desk, i: SimpleNamespace) -> Outputs:
    plan = desk.kernels.nlm_weights(i.image.shape, desk.device, **i.options)
    out = desk.out(i.weights.shape)
    plan(desk.image(1 - i.image[::-1]), out)  # what a plan did before leaves no trace
    plan(desk.image(i.image), out)
    return {"weights": out}


def nlm_neighbors(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.values.shape)
    desk.kernels.nlm_neighbors(desk.field(i.weights), desk.field(i.values), window=i.window, sums_out=out)
    return {"sums": out}


def nlm_laplacian(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = desk.out(i.values.shape)
    desk.kernels.nlm_laplacian(desk.field(i.weights), desk.field(i.values), window=i.window, laplacian_out=out)
    return {"laplacian": out}


def structure_tensor(desk: Desk, i: SimpleNamespace) -> Outputs:
    filters = StructureFilters(*map(desk.field, i.filters))
    plan = desk.kernels.structure_tensor(i.epis.shape, desk.field(i.offsets), filters, scale=i.scale, floor=i.floor)
    shape = i.epis.shape[1:3]
    plan(desk.image(i.epis[::-1, ::-1]), i.shear + 1.0, desk.out(shape), desk.out(shape))  # leaves no trace
    out = {"disparity": desk.out(shape), "coherence": desk.out(shape)}
    plan(desk.image(i.epis), i.shear, out["disparity"], out["coherence"])
    return out


def keep_more_coherent(desk: Desk, i: SimpleNamespace) -> Outputs:
    out = {"disparity": desk.held(i.best_disparity), "coherence": desk.held(i.best_coherence)}
    for estimate in i.estimates:
        desk.kernels.keep_more_coherent(
            desk.field(estimate.disparity),
            desk.field(estimate.coherence),
            None if estimate.trusted is None else desk.field(estimate.trusted),
            **i.options,
            best_disparity_out=out["disparity"],
            best_coherence_out=out["coherence"],
        )
    return out


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
    return {"field": field, "strided": strided, "uploaded": uploaded, "zeros": zeros, "number": number}


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
        "stored zeros": desk.stored_values(
            desk.kernels.zeros_image(i.recorded.shape, desk.device, i.recorded.dtype.type)
        ),
    }


def residuals(desk: Desk, i: SimpleNamespace) -> Outputs:
    """The trace, and after each residual whether to go on, after another system, which leaves no trace."""
    plan, number = desk.kernels.residuals(desk.device, tolerance=i.tolerance, most=i.most), desk.kernels.number
    plan.begin(desk.number(0.5))
    plan.add(desk.number(1e9))
    norm, go_on = desk.number_out(i.norm), []
    plan.begin(norm)
    desk.kernels.copy(desk.number(1e9), norm)  # what becomes of the number afterwards does not matter
    for residual in i.residuals:
        plan.add(desk.number(residual))
        go_on.append(number(plan.go_on))
    return {"trace": plan.report(), "go on": go_on}


def lbfgs(desk: Desk, i: SimpleNamespace) -> Outputs:
    """All that a solver asks for and decides on the way of the inputs, after a way of another one.

    `trial k` is what it proposes at `x k`.
    """
    kernels, shape = desk.kernels, i.first.x.shape
    plan = kernels.lbfgs(shape, desk.device, **i.options)
    _one_step(desk, plan, i)
    x, gradient, value = desk.held(i.first.x), desk.held(i.first.gradient), desk.number_out(i.first.value)
    plan.begin(x, gradient, value, None if i.curvature is None else desk.field(i.curvature))
    out: Outputs = {"values": [], "go on": [kernels.number(plan.go_on)]}
    for k, told in enumerate(i.trials):
        out |= {
            f"x {k}": desk.held(i.first.x),
            f"gradient {k}": desk.held(i.first.gradient),
            f"trial {k}": desk.out(shape),
        }
        kernels.copy(x, out[f"x {k}"])
        kernels.copy(gradient, out[f"gradient {k}"])
        plan.propose(x, out[f"trial {k}"])
        plan.judge(value, desk.number(told.value))
        plan.learn(x, gradient, desk.field(told.x), desk.field(told.gradient))
        out["values"].append(kernels.number(value))
        out["go on"].append(kernels.number(plan.go_on))
    trace, evaluations, flat = plan.report()
    return {**out, "trace": trace, "evaluations": float(evaluations), "flat": float(flat)}


def _one_step(desk: Desk, plan: Any, i: SimpleNamespace) -> None:
    """A step of a bowl, which the plan learns from, and another one that it does not take."""
    start = np.full(i.first.x.shape, (i.options["low"] + i.options["high"]) / 2 + 0.125)
    x, gradient, trial = desk.held(start), desk.held(2 * start), desk.out(start.shape)
    value, lower, higher = desk.number_out(9.0), desk.number(-1e6), desk.number(1e6)
    plan.begin(x, gradient, value, desk.field(np.full(start.shape, 3.0)))
    for told in (lower, higher):
        plan.propose(x, trial)
        plan.judge(value, told)
        plan.learn(x, gradient, desk.field(start / 2), desk.field(start))


# --- how near outputs must be ---

Errors = Callable[[dict[str, Values], dict[str, Values], SimpleNamespace], dict[str, float]]


def largest_error(got: Values, want: Values, scale: float | None = None) -> float:
    """max |got - want| relative to `scale`, by default max |want|; 0 where both are 0."""
    error = float(np.abs(np.asarray(got, np.float64) - want).max(initial=0))
    scale = float(np.abs(want).max(initial=0)) if scale is None else scale
    return error / scale if scale else (0.0 if error == 0 else np.inf)


def relative_to_terms(**terms: Callable[[SimpleNamespace], float]) -> Errors:
    """Relative to max |want|, or where sums nearly cancel (on images of few pixels) to a tenth of their largest term.

    `terms` gives that term's size for each output in which terms of different signs are added.
    """

    def errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
        least = {name: 0.1 * terms[name](i) if name in terms else 0.0 for name in want}
        return {
            name: largest_error(got[name], want[name], max(float(np.abs(want[name]).max()), least[name]))
            for name in want
        }

    return errors


NOT_CANCELLING = relative_to_terms()


def size(*arrays: Values) -> float:
    """The product of the arrays' largest absolute values."""
    return float(np.prod([np.abs(array).max() for array in arrays]))


def dot_error(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Relative to the sum of the products' sizes: the sum itself may nearly cancel."""
    return {"sum": largest_error(got["sum"], want["sum"], float(np.abs(i.x.astype(np.float64) * i.y).sum()))}


def axpby_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """The two products may nearly cancel: their rounding shows in the sum, if fields are of few pixels."""
    term = 0.1 * abs(i.alpha) * size(i.x)
    return {name: largest_error(got[name], want[name], max(float(np.abs(want[name]).max()), term)) for name in want}


def lbfgs_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """Trials relative to the longest step of a pixel, but for the rounding of x + step."""
    errors = {name: largest_error(got[name], want[name]) for name in want if not name.startswith("trial")}
    for k in range(len(i.trials)):
        step = np.abs(want[f"trial {k}"] - want[f"x {k}"]).max()
        rounding = 2.0**-22 * np.abs(want[f"x {k}"]).max()
        off = np.abs(got[f"trial {k}"] - want[f"trial {k}"]).max()
        errors[f"trial {k}"] = float(max(0.0, off - rounding) / step) if step else float(off)
    return errors


def structure_errors(got: dict[str, Values], want: dict[str, Values], i: SimpleNamespace) -> dict[str, float]:
    """The angle between the two directions, not their tangents, as far as the tensor has a direction at all.

    The angle is that of (J_xx - J_uu, 2 J_xu), whose length is √coherence times the trace; its error in float32 is
    relative to the trace. One turn of that vector is half a turn of the direction.
    """
    angle = np.arctan(got["disparity"].astype(np.float64) - i.shear) - np.arctan(want["disparity"] - i.shear)
    direction = np.sqrt(want["coherence"].clip(0)) * np.abs(np.sin(angle))
    return {
        "disparity": float(direction.max()),
        "coherence": largest_error(got["coherence"], want["coherence"], 1.0),
    }


@dataclass(frozen=True)
class Operation:
    """One operation of `KernelSet`: how to run it, which inputs it takes, how errors are measured."""

    run: Callable[[Desk, SimpleNamespace], Outputs]
    inputs: str
    errors: Errors = NOT_CANCELLING

    def __str__(self) -> str:
        return self.run.__name__


OPERATIONS = (
    Operation(splat, "splat"),
    Operation(splat_transpose, "splat", relative_to_terms(image=lambda i: size(i.views))),
    Operation(splat_jvp, "splat", relative_to_terms(views=lambda i: size(i.image, i.tangent, i.offsets))),
    Operation(splat_vjp, "splat", relative_to_terms(gradient=lambda i: size(i.image, i.views, i.offsets))),
    Operation(data_term, "splat", relative_to_terms(gradient=lambda i: size(i.image, i.offsets))),
    Operation(image_memory, "splat"),
    Operation(seen_by_reference, "seen"),
    Operation(intensities, "views"),
    Operation(line_of_views, "views"),
    Operation(normalization, "views", relative_to_terms(detail=lambda i: 1.0 / i.floor if i.sigma else 0.0)),
    Operation(nlm_weights, "nlm"),
    Operation(nlm_neighbors, "nlm", relative_to_terms(sums=lambda i: size(i.values))),
    Operation(nlm_laplacian, "nlm", relative_to_terms(laplacian=lambda i: size(i.values))),
    Operation(structure_tensor, "epi", structure_errors),
    Operation(keep_more_coherent, "coherence"),
    Operation(dot, "vector", dot_error),
    Operation(ratio, "vector"),
    Operation(copy, "vector"),
    Operation(axpby, "vector", axpby_errors),
    Operation(multiply, "vector"),
    Operation(divide, "vector"),
    Operation(fill, "vector"),
    Operation(select, "vector"),
    Operation(threshold, "vector"),
    Operation(clamp, "vector"),
    Operation(memory, "vector"),
    Operation(residuals, "residuals"),
    Operation(lbfgs, "lbfgs", lbfgs_errors),
)
"""Every operation of `KernelSet`; `test_matrix.py` sees to it that none is missing."""


def operation_of(run: Callable[[Desk, SimpleNamespace], Outputs]) -> Operation:
    (found,) = (operation for operation in OPERATIONS if operation.run is run)
    return found


def compute(kernels: KernelSet, device: str, operation: Operation, inputs: SimpleNamespace) -> dict[str, Values]:
    """The operation's outputs as NumPy arrays; checks what needs no truth: dtypes, and that inputs are unchanged."""
    desk = Desk(kernels, device)
    outputs = operation.run(desk, inputs)
    desk.check_inputs_unchanged()
    read: dict[str, Values] = {}
    for name, output in outputs.items():
        if isinstance(output, float | list):
            assert all(isinstance(number, float) for number in np.ravel(np.array(output, object))), (
                f"{operation}: {name}"
            )
            read[name] = np.array(output, np.float64)
            continue
        assert not np.isscalar(output), f"{operation}: {name} is a {type(output).__name__}, not a float"
        read[name] = kernels.numpy(output)
        assert read[name].dtype == kernels.dtype, f"{operation}: {name} is {read[name].dtype}, not {kernels.dtype}"
    return read


def check_value(
    kernels: KernelSet,
    device: str,
    operation: Operation,
    inputs: SimpleNamespace,
    tolerance: float,
    want: dict[str, Values] | None = None,
) -> dict[str, float]:
    """The operation gives what the reference gives, into outputs that held garbage; returns the errors.

    `want` is what the reference gives, where that is known.
    """
    want = want or compute(load("reference"), "cpu", operation, inputs)
    got = compute(kernels, device, operation, inputs)
    assert got.keys() == want.keys()
    for name in want:
        assert got[name].shape == want[name].shape, f"{operation}: {name} is {got[name].shape}, not {want[name].shape}"
        assert np.isfinite(got[name]).all(), f"{operation}: {name} is not finite everywhere"
    errors = operation.errors(got, want, inputs)
    for name, error in errors.items():
        assert error <= tolerance, f"{operation}: {name} is off by {error:.2e}, more than {tolerance:.0e}"
    return errors


def check_repeats(kernels: KernelSet, device: str, operation: Operation, inputs: SimpleNamespace) -> None:
    """The operation gives the same bits when it is run again."""
    first, second = (compute(kernels, device, operation, inputs) for _ in range(2))
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], f"{operation}: {name} differs between runs")


# --- adjoints: ⟨A x, y⟩ = ⟨x, Aᵀ y⟩ without knowing what is true ---


def adjoint_tolerance(kernels: KernelSet) -> float:
    return 1e-12 if kernels.dtype is np.float64 else 2e-6


def check_image_adjoint(kernels: KernelSet, device: str, i: SimpleNamespace) -> float:
    """⟨A(d) I, V⟩ = ⟨I, A(d)ᵀ V⟩: the splat as a linear operator on images."""
    forward = compute(kernels, device, operation_of(splat), i)["views"]
    backward = compute(kernels, device, operation_of(splat_transpose), i)["image"]
    return _same_product("splat and splat_transpose", kernels, (forward, i.views), (i.image, backward))


def check_disparity_adjoint(kernels: KernelSet, device: str, i: SimpleNamespace) -> float:
    """⟨J t, r⟩ = ⟨t, Jᵀ r⟩: the splat's derivative with respect to the disparity."""
    forward = compute(kernels, device, operation_of(splat_jvp), i)["views"]
    backward = compute(kernels, device, operation_of(splat_vjp), i)["gradient"]
    return _same_product("splat_jvp and splat_vjp", kernels, (forward, i.views), (i.tangent, backward))


def check_nlm_symmetric(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """⟨W x, y⟩ = ⟨x, W y⟩, the same for L; L takes a constant to 0; L = diag(W 1) - W."""
    other = SimpleNamespace(**{**vars(i), "values": i.other_values})
    ones = SimpleNamespace(**{**vars(i), "values": np.ones_like(i.values)})
    neighbors, laplacian = operation_of(nlm_neighbors), operation_of(nlm_laplacian)
    for operation, output in ((neighbors, "sums"), (laplacian, "laplacian")):
        a, b = (compute(kernels, device, operation, inputs)[output] for inputs in (i, other))
        _same_product(str(operation), kernels, (a, i.other_values), (i.values, b))
    constant = compute(kernels, device, laplacian, ones)["laplacian"]
    assert np.abs(constant).max() <= adjoint_tolerance(kernels) * i.weights.sum(), "L 1 is not 0"
    degree = compute(kernels, device, neighbors, ones)["sums"].astype(np.float64)
    sums = compute(kernels, device, neighbors, i)["sums"]
    got = compute(kernels, device, laplacian, i)["laplacian"]
    error = np.abs(got - (degree * i.values - sums)).max() / max(1.0, float(np.abs(degree * i.values).max()))
    assert error <= 5 * adjoint_tolerance(kernels), f"L and diag(W 1) - W differ by {error:.2e}"


DATA_TERM = operation_of(data_term)


def check_masked_pixels_do_not_count(
    kernels: KernelSet, device: str, i: SimpleNamespace, operation: Operation = DATA_TERM
) -> None:
    """What is recorded where `valid` is 0 changes neither value nor gradient; all valid is the same as no mask."""
    hidden = i.valid == 0
    before = compute(kernels, device, operation, i)
    recorded = i.recorded.copy()
    recorded[hidden] = 1e4 if recorded.dtype.kind == "f" else np.iinfo(recorded.dtype).max - recorded[hidden]
    after = compute(kernels, device, operation, SimpleNamespace(**{**vars(i), "recorded": recorded}))
    all_valid, no_mask = (
        compute(kernels, device, operation, SimpleNamespace(**{**vars(i), "valid": valid}))
        for valid in (np.ones_like(i.valid), None)
    )
    tolerance = adjoint_tolerance(kernels)
    for name in before:
        assert largest_error(after[name], before[name]) <= tolerance, f"masked pixels change the {name}"
        assert largest_error(all_valid[name], no_mask[name]) <= tolerance, f"a mask of ones changes the {name}"


def check_masked_view_is_a_missing_view(
    kernels: KernelSet, device: str, i: SimpleNamespace, operation: Operation = DATA_TERM
) -> None:
    """A view without a valid pixel gives value and gradient of the light field without that view."""
    valid = np.ones(i.recorded.shape[:3], np.float32)
    valid[0] = 0
    masked = SimpleNamespace(**{**vars(i), "valid": valid})
    missing = SimpleNamespace(**{**vars(i), "recorded": i.recorded[1:], "offsets": i.offsets[1:], "valid": None})
    got, want = (compute(kernels, device, operation, inputs) for inputs in (masked, missing))
    for name in ("value", "gradient"):
        assert largest_error(got[name], want[name]) <= adjoint_tolerance(kernels), f"a masked view changes the {name}"


def check_nothing_valid_is_nothing_at_all(
    kernels: KernelSet, device: str, i: SimpleNamespace, operation: Operation = DATA_TERM
) -> None:
    """Where no recorded pixel is valid, there is nothing to differ from: value and gradient are 0."""
    hidden = SimpleNamespace(**{**vars(i), "valid": np.zeros_like(i.valid)})
    outputs = compute(kernels, device, operation, hidden)
    for name in ("value", "gradient"):
        assert not outputs[name].any(), f"without a valid pixel the {name} is not 0"


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


# --- programs: work of many operations that nobody on the host looks at until it is done ---


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


@dataclass(frozen=True)
class Program:
    """Work on a device that reads `inputs` and writes `outputs`; both are fields and images."""

    inputs: Outputs
    work: Callable[[], None]
    outputs: Outputs
    tolerance: float = 1e-5
    """Relative error of the outputs: sums may be in another order."""

    def read(self, kernels: KernelSet) -> dict[str, Values]:
        return {name: kernels.numpy(array) for name, array in self.outputs.items()}


MakeProgram = Callable[[KernelSet, str, dict[str, Values]], Program]


def counting(kernels: KernelSet, device: str, values: dict[str, Values], most: int = 5) -> Program:
    """Counts `left` [1, 1] down to 0 and `calls` up, but not more than `most` times."""
    left = kernels.field(values["left"], device)
    one, rest, calls = (kernels.field(np.full((1, 1), value), device) for value in (1.0, 9.0, 9.0))
    go_on = kernels.scalar(9.0, device)

    def count() -> None:
        kernels.axpby(1.0, rest, -1.0, one, rest)
        kernels.axpby(1.0, calls, 1.0, one, calls)
        kernels.dot(rest, one, go_on)

    def work() -> None:
        kernels.copy(left, rest)
        kernels.fill(0.0, calls)
        kernels.dot(rest, one, go_on)
        kernels.repeat(count, go_on, most)

    return Program({"left": left}, work, {"calls": calls, "rest": rest})


def check_repeat(kernels: KernelSet, device: str) -> None:
    """The body runs as often as `go_on` says, which is looked at before each call, but at most `most` times."""
    for left, most in ((0, 5), (1, 5), (3, 5), (5, 5), (9, 5), (3, 0), (-1, 2)):
        program = counting(kernels, device, {"left": np.full((1, 1), float(left))}, most)
        program.work()
        calls = float(program.read(kernels)["calls"][0, 0])
        want = most if left < 0 else min(left, most)
        assert calls == want, f"repeat called its body {calls:g} times, not {want} (to do: {left}, most: {most})"


WINDOW = 5  # of the operators of the linear system


def solving(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """Conjugate gradients on (L + 1) x = b with L the Laplacian of `weights`."""
    inputs = {name: kernels.field(values[name], device) for name in ("weights", "b")}
    shape = values["b"].shape
    x, r, p, q = (kernels.zeros(shape, device) for _ in range(4))
    now, before, product, step, back = (kernels.scalar(0.0, device) for _ in range(5))
    trace = kernels.residuals(device, tolerance=1e-6, most=60)

    def iterate() -> None:
        kernels.nlm_laplacian(inputs["weights"], p, window=WINDOW, laplacian_out=q)
        kernels.axpby(1.0, q, 1.0, p, q)
        kernels.dot(p, q, product)
        kernels.ratio(now, product, step)
        kernels.ratio(now, product, back, factor=-1.0)
        kernels.axpby(1.0, x, step, p, x)
        kernels.axpby(1.0, r, back, q, r)
        kernels.copy(now, before)
        kernels.dot(r, r, now)
        kernels.ratio(now, before, step)
        kernels.axpby(1.0, r, step, p, p)
        trace.add(now)

    def work() -> None:
        kernels.fill(0.0, x)
        kernels.copy(inputs["b"], r)
        kernels.copy(r, p)
        kernels.dot(r, r, now)
        trace.begin(now)
        trace.add(now)
        kernels.repeat(iterate, trace.go_on, 60)

    return Program(inputs, work, {"x": x}, tolerance=1e-4)


def minimizing(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """L-BFGS on the sum of h x² / 2 - b x within [-1, 1]: the minimum is b / h moved into the bounds."""
    inputs = {name: kernels.field(values[name], device) for name in ("h", "b", "start")}
    shape = values["b"].shape
    x, gradient, trial, trial_gradient, scratch = (kernels.zeros(shape, device) for _ in range(5))
    value, trial_value = (kernels.scalar(0.0, device) for _ in range(2))
    options = {"low": -1.0, "high": 1.0, "first_step": 0.1, "tolerance": 1e-12, "patience": 5, "most": 100}
    solver = kernels.lbfgs(shape, device, memory=6, **options)

    def evaluate(at: Any, gradient_out: Any, value_out: Any) -> None:
        kernels.multiply(inputs["h"], at, scratch)
        kernels.axpby(0.5, scratch, -1.0, inputs["b"], gradient_out)
        kernels.dot(at, gradient_out, value_out)
        kernels.axpby(1.0, scratch, -1.0, inputs["b"], gradient_out)

    def step() -> None:
        solver.propose(x, trial)
        evaluate(trial, trial_gradient, trial_value)
        solver.judge(value, trial_value)
        solver.learn(x, gradient, trial, trial_gradient)

    def work() -> None:
        kernels.clamp(inputs["start"], -1.0, 1.0, x)
        evaluate(x, gradient, value)
        solver.begin(x, gradient, value)
        kernels.repeat(step, solver.go_on, 300)

    # A minimum is as exact as a value is that no longer falls.
    return Program(inputs, work, {"x": x}, tolerance=2e-3)


def comparing(kernels: KernelSet, device: str, values: dict[str, Values]) -> Program:
    """The data term of a light field that is loaded each time."""
    views = values["recorded"]
    inputs = {name: kernels.image(values[name], device) for name in ("image", "recorded")}
    inputs |= {name: kernels.field(values[name], device) for name in ("valid", "disparity")}
    offsets = kernels.field(values["offsets"], device)
    plan = kernels.data_term(views.shape, offsets, scale=1.0, softness=0.125)
    gradient, scaled = (kernels.zeros(views.shape[1:3], device) for _ in range(2))
    value, size = kernels.scalar(0.0, device), kernels.scalar(100.0, device)

    def work() -> None:
        plan.load(inputs["image"], inputs["recorded"], inputs["valid"])
        plan(inputs["disparity"], gradient, value)
        kernels.ratio(value, size, value)
        kernels.fill(value, scaled)

    return Program(inputs, work, {"gradient": gradient, "value": scaled})


def program_inputs(make: MakeProgram, rng: np.random.Generator) -> dict[str, Values]:
    """Random inputs of a program."""
    shape = 9, 11
    if make is counting:
        return {"left": np.full((1, 1), float(rng.integers(0, 9)))}
    if make is solving:
        weights = rng.random((len(half_window(WINDOW)), *shape))
        y, x = np.mgrid[: shape[0], : shape[1]]
        for w, (dy, dx) in zip(weights, half_window(WINDOW), strict=True):
            w[(y + dy >= shape[0]) | (x + dx < 0) | (x + dx >= shape[1])] = 0
        return {"weights": weights, "b": rng.normal(size=shape)}
    if make is minimizing:
        h = rng.uniform(1, 20, shape)
        return {"h": h, "b": 1.5 * h * rng.uniform(-1, 1, shape), "start": rng.uniform(-1.5, 1.5, shape)}
    offsets = np.array([[1.0, 0.0], [-1.0, 0.5], [0.0, 2.0]])
    recorded = rng.random((3, *shape, 3), np.float32)
    return {
        "image": rng.random((*shape, 3), np.float32),
        "recorded": recorded,
        "valid": (rng.random(recorded.shape[:3]) < 0.8).astype(np.float32),
        "mostly valid": (rng.random(recorded.shape[:3]) < 0.97).astype(np.float32),
        "disparity": np.round(rng.uniform(-1.5, 1.5, shape) * 2**10) / 2**10,
        "offsets": offsets,
        "volume": rng.random((5, *shape), np.float32),
        "reduced": rng.random((5, *(side // REDUCTION for side in shape)), np.float32),
    }


PROGRAMS: tuple[MakeProgram, ...] = (counting, solving, minimizing, comparing)


def check_program(kernels: KernelSet, device: str, make: MakeProgram, values: dict[str, Values]) -> None:
    """A program that minimises or solves finds what it should; every one gives what it gives in the reference."""
    program, true_program = make(kernels, device, values), make(load("reference"), "cpu", values)
    program.work()
    true_program.work()
    got, want = program.read(kernels), true_program.read(load("reference"))
    if make is minimizing:
        want = {"x": np.clip(values["b"] / values["h"], -1, 1)}
    _same_outputs(make.__name__, got, want, program.tolerance)


def check_capture(
    kernels: KernelSet, device: str, make: MakeProgram, first: dict[str, Values], second: dict[str, Values]
) -> bool:
    """Captured work does the same again, with what its inputs hold by then; False where it cannot be captured."""
    program, fresh = make(kernels, device, first), make(kernels, device, second)
    program.work()
    before = program.read(kernels)
    again = kernels.capture(program.work, device)
    if again is None:
        return False
    fresh.work()
    after = fresh.read(kernels)
    for values, want in ((second, after), (first, before), (second, after)):
        for name, array in program.inputs.items():
            kernels.upload(values[name], array)
        again()
        _same_outputs(f"captured {make.__name__}", program.read(kernels), want, program.tolerance)
    return True


def _same_outputs(what: str, got: dict[str, Values], want: dict[str, Values], tolerance: float) -> None:
    assert got.keys() == want.keys()
    for name in want:
        error = largest_error(got[name], want[name])
        assert error <= tolerance, f"{what}: {name} is off by {error:.2e}, more than {tolerance:.0e}"


# --- L-BFGS as a whole ---

Quadratic = tuple[Values, Values]


def check_sufficient_decrease(kernels: KernelSet, device: str) -> None:
    """A trial is accepted from 1e-4 of the decrease on that the slope promises (Armijo), and no sooner.

    The first step goes from 0 to -1 everywhere, against a gradient of 1: the slope promises 4.
    """
    for value, accepted in ((-0.9e-4 * 4, False), (-1.1e-4 * 4, True)):
        memory = kernels.lbfgs(
            (2, 2), device, memory=3, low=-9.0, high=9.0, first_step=1.0, tolerance=0.0, patience=5, most=5
        )
        x, gradient, trial, trial_gradient = (
            kernels.field(np.full((2, 2), number, np.float32), device) for number in (0.0, 1.0, 0.0, 0.5)
        )
        held = kernels.scalar(0.0, device)
        memory.begin(x, gradient, held)
        memory.propose(x, trial)
        np.testing.assert_allclose(kernels.numpy(trial), -1.0, rtol=1e-6)
        memory.judge(held, kernels.scalar(value, device))
        memory.learn(x, gradient, trial, trial_gradient)
        trace, _, _ = memory.report()
        assert trace == ([0.0, value] if accepted else [0.0]), f"a decrease of {-value} is judged wrongly: {trace}"
        np.testing.assert_allclose(kernels.numpy(x), -1.0 if accepted else 0.0, rtol=1e-6)


def check_lbfgs_converges(
    kernels: KernelSet, device: str, quadratic: Quadratic, start: Values, tolerance: float
) -> None:
    """It finds the minimum within bounds of xᵀ A x / 2 - bᵀ x, where many bounds hold: no truth but the conditions.

    Those of Karush, Kuhn and Tucker: the gradient is 0 where x is between the bounds, and leads out of them elsewhere.
    """
    matrix, aim = quadratic
    low, high = -0.25, 0.5
    options = {"first_step": 0.05, "tolerance": 1e-14, "patience": 10, "most": 300}
    solver = kernels.lbfgs(start.shape, device, memory=8, low=low, high=high, **options)

    def evaluate(x: Any) -> tuple[float, Any]:
        flat = kernels.numpy(x).astype(np.float64).ravel()
        gradient = matrix @ flat - aim
        return float(flat @ (gradient - aim)) / 2, kernels.field(gradient.reshape(start.shape), device)

    x, trial = kernels.field(start.clip(low, high), device), kernels.zeros(start.shape, device)
    first, gradient = evaluate(x)
    value = kernels.scalar(first, device)
    solver.begin(x, gradient, value)
    judged = 0
    while kernels.number(solver.go_on) and judged < 1000:
        solver.propose(x, trial)
        proposed = kernels.numpy(trial)
        assert proposed.min() >= low, "a trial lies below the bounds"
        assert proposed.max() <= high, "a trial lies above the bounds"
        trial_value, trial_gradient = evaluate(trial)
        solver.judge(value, kernels.scalar(trial_value, device))
        solver.learn(x, gradient, trial, trial_gradient)
        judged += 1
    trace, evaluations, _ = solver.report()
    assert evaluations == judged + 1, "values are counted wrong"
    assert trace[0] == first, "the trace does not begin with the first value"
    assert trace[-1] == kernels.number(value), "the trace does not end with the last value"
    assert (np.diff(trace) <= 0).all(), "the value rises"
    found = kernels.numpy(x).astype(np.float64)
    slope = (matrix @ found.ravel() - aim).reshape(start.shape)
    free = slope[(found > low) & (found < high)]
    held = (found <= low) & (slope >= 0) | (found >= high) & (slope <= 0)
    assert held.any(), "no bound holds: the check says nothing"
    wrong = np.where(held | ((found > low) & (found < high)), 0, slope)
    error = max(np.abs(free).max(initial=0), np.abs(wrong).max()) / np.abs(aim).max()
    assert error <= tolerance, f"after {judged} values the gradient is still {error:.1e}, more than {tolerance:.0e}"


def _same_product(what: str, kernels: KernelSet, left: tuple[Values, Values], right: tuple[Values, Values]) -> float:
    (a, b), (c, d) = (tuple(values.astype(np.float64) for values in pair) for pair in (left, right))
    scale = float(np.linalg.norm(a) * np.linalg.norm(b) + np.linalg.norm(c) * np.linalg.norm(d)) / 2
    error = abs(float(np.vdot(a, b) - np.vdot(c, d)))
    relative = error / scale if scale else error
    limit = adjoint_tolerance(kernels)
    assert relative <= limit, f"{what}: the products differ by {relative:.2e} relative to their size, not {limit:.0e}"
    return relative
