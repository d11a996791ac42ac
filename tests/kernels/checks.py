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
from lfgpu.energy import Energy
from lfgpu.model import ForwardModel
from lfgpu.prior import NonLocalMeans
from lfgpu.types import KernelSet, StructureFilters

Values = NDArray[Any]


class Desk:
    """Arrays of one backend on one device: inputs whose changes would be noticed, outputs that hold garbage."""

    def __init__(self, kernels: KernelSet, device: str) -> None:
        self.kernels, self.device = kernels, device
        self._inputs: list[tuple[Any, Values]] = []

    def field(self, values: Values) -> Any:
        return self._remember(self.kernels.field(values, self.device))

    def image(self, values: Values) -> Any:
        return self._remember(self.kernels.image(values, self.device))

    def out(self, shape: tuple[int, ...]) -> Any:
        return self.kernels.field(np.full(shape, np.nan, np.float32), self.device)

    def image_out(self, shape: tuple[int, ...]) -> Any:
        return self.kernels.image(np.full(shape, np.nan, np.float32), self.device)

    def check_inputs_unchanged(self) -> None:
        for array, before in self._inputs:
            np.testing.assert_array_equal(self.kernels.numpy(array), before, "an input was changed")

    def _remember(self, array: Any) -> Any:
        self._inputs.append((array, self.kernels.numpy(array).copy()))
        return array


# --- the operations: inputs to outputs ---


def splat(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
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


def splat_transpose(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    out = desk.image_out(i.image.shape)
    desk.kernels.splat_transpose(
        desk.image(i.views), desk.field(i.disparity), desk.field(i.offsets), softness=i.softness, image_out=out
    )
    return {"image": out}


def splat_jvp(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
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


def splat_vjp(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
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


def data_term(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    plan = desk.kernels.data_term(
        desk.image(i.image),
        desk.image(i.recorded),
        None if i.valid is None else desk.field(i.valid),
        desk.field(i.offsets),
        scale=i.scale,
        softness=i.softness,
    )
    plan(desk.field(i.disparity[::-1, ::-1]), desk.out(i.disparity.shape))  # what a plan did before leaves no trace
    gradient = desk.out(i.disparity.shape)
    return {"value": plan(desk.field(i.disparity), gradient), "gradient": gradient}


def nlm_weights(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    out = desk.out(i.weights.shape)
    scratch = desk.out(i.weights.shape)
    desk.kernels.nlm_weights(desk.image(i.image), **i.options, scratch_out=scratch, weights_out=out)
    return {"weights": out}


def nlm_neighbors(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    out = desk.out(i.values.shape)
    desk.kernels.nlm_neighbors(desk.field(i.weights), desk.field(i.values), window=i.window, sums_out=out)
    return {"sums": out}


def nlm_laplacian(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    out = desk.out(i.values.shape)
    desk.kernels.nlm_laplacian(desk.field(i.weights), desk.field(i.values), window=i.window, laplacian_out=out)
    return {"laplacian": out}


def structure_tensor(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    filters = StructureFilters(*map(desk.field, i.filters))
    plan = desk.kernels.structure_tensor(
        desk.image(i.epis), desk.field(i.offsets), filters, scale=i.scale, floor=i.floor
    )
    shape = i.epis.shape[1:3]
    plan(i.shear + 1.0, desk.out(shape), desk.out(shape))
    out = {"disparity": desk.out(shape), "coherence": desk.out(shape)}
    plan(i.shear, out["disparity"], out["coherence"])
    return out


def dot(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    return {"sum": desk.kernels.dot(desk.field(i.x), desk.field(i.y))}


def copy(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    out = desk.out(i.x.shape)
    desk.kernels.copy(desk.field(i.x), out)
    return {"target": out}


def axpby(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    kernels, x, y = desk.kernels, desk.field(i.x), desk.field(i.y)
    apart, onto_x, onto_y = desk.out(i.x.shape), kernels.field(i.x, desk.device), kernels.field(i.y, desk.device)
    kernels.axpby(i.alpha, x, i.beta, y, apart)
    kernels.axpby(i.alpha, onto_x, i.beta, y, onto_x)
    kernels.axpby(i.alpha, x, i.beta, onto_y, onto_y)
    return {"apart": apart, "onto x": onto_x, "onto y": onto_y}


def multiply(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    kernels, x, y = desk.kernels, desk.field(i.x), desk.field(i.y)
    apart, onto_x, onto_y = desk.out(i.x.shape), kernels.field(i.x, desk.device), kernels.field(i.y, desk.device)
    kernels.multiply(x, y, apart)
    kernels.multiply(onto_x, y, onto_x)
    kernels.multiply(x, onto_y, onto_y)
    return {"apart": apart, "onto x": onto_x, "onto y": onto_y}


def clamp(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    apart, onto_x = desk.out(i.x.shape), desk.kernels.field(i.x, desk.device)
    desk.kernels.clamp(desk.field(i.x), i.low, i.high, apart)
    desk.kernels.clamp(onto_x, i.low, i.high, onto_x)
    return {"apart": apart, "onto x": onto_x}


def memory(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    """Fields are copies of what they were made of, and what is read from them is a copy of them."""
    source = i.x.copy()
    field, strided = desk.kernels.field(source, desk.device), desk.field(i.x[..., ::-1].T)
    source[:] = -9.0
    desk.kernels.numpy(field)[:] = 9.0
    zeros = desk.kernels.zeros(i.x.shape, desk.device)
    return {"field": field, "strided": strided, "zeros": zeros}


def image_memory(desk: Desk, i: SimpleNamespace) -> dict[str, Any]:
    source = i.recorded.copy()
    image = desk.kernels.image(source, desk.device)
    source[:] = 1
    # Stored values are whole numbers or float32, whatever the dtype that they are read as.
    stored = desk.kernels.field(desk.kernels.numpy(image), desk.device)
    return {"image": stored, "zeros": desk.kernels.zeros_image(i.recorded.shape, desk.device)}


# --- how near outputs must be ---

Errors = Callable[[dict[str, Values], dict[str, Values], SimpleNamespace], dict[str, float]]


def largest_error(got: Values, want: Values, scale: float | None = None) -> float:
    """max |got - want| relative to `scale`, by default max |want|; 0 where both are 0."""
    error = float(np.abs(np.asarray(got, np.float64) - want).max())
    scale = float(np.abs(want).max()) if scale is None else scale
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

    run: Callable[[Desk, SimpleNamespace], dict[str, Any]]
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
    Operation(nlm_weights, "nlm"),
    Operation(nlm_neighbors, "nlm", relative_to_terms(sums=lambda i: size(i.values))),
    Operation(nlm_laplacian, "nlm", relative_to_terms(laplacian=lambda i: size(i.values))),
    Operation(structure_tensor, "epi", structure_errors),
    Operation(dot, "vector", dot_error),
    Operation(copy, "vector"),
    Operation(
        axpby,
        "vector",
        relative_to_terms(**dict.fromkeys(("apart", "onto x", "onto y"), lambda i: abs(i.alpha) * size(i.x))),
    ),
    Operation(multiply, "vector"),
    Operation(clamp, "vector"),
    Operation(memory, "vector"),
)
"""Every operation of `KernelSet`; `test_matrix.py` sees to it that none is missing."""


def operation_of(run: Callable[[Desk, SimpleNamespace], dict[str, Any]]) -> Operation:
    (found,) = (operation for operation in OPERATIONS if operation.run is run)
    return found


def compute(kernels: KernelSet, device: str, operation: Operation, inputs: SimpleNamespace) -> dict[str, Values]:
    """The operation's outputs as NumPy arrays; checks what needs no truth: dtypes, and that inputs are unchanged."""
    desk = Desk(kernels, device)
    outputs = operation.run(desk, inputs)
    desk.check_inputs_unchanged()
    read: dict[str, Values] = {}
    for name, output in outputs.items():
        if isinstance(output, float):
            read[name] = np.array(output)
            continue
        assert not np.isscalar(output), f"{operation}: {name} is a {type(output).__name__}, not a float"
        read[name] = kernels.numpy(output)
        assert read[name].dtype == kernels.dtype, f"{operation}: {name} is {read[name].dtype}, not {kernels.dtype}"
    return read


def check_value(
    kernels: KernelSet, device: str, operation: Operation, inputs: SimpleNamespace, tolerance: float
) -> dict[str, float]:
    """The operation gives what the reference gives, into outputs that held garbage; returns the errors."""
    want = compute(load("reference"), "cpu", operation, inputs)
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


def check_masked_pixels_do_not_count(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """What is recorded where `valid` is 0 changes neither value nor gradient; all valid is the same as no mask."""
    operation, hidden = operation_of(data_term), i.valid == 0
    before = compute(kernels, device, operation, i)
    recorded = i.recorded.copy()
    recorded[hidden] = 1e6 if recorded.dtype == np.float32 else np.iinfo(recorded.dtype).max - recorded[hidden]
    after = compute(kernels, device, operation, SimpleNamespace(**{**vars(i), "recorded": recorded}))
    all_valid, no_mask = (
        compute(kernels, device, operation, SimpleNamespace(**{**vars(i), "valid": valid}))
        for valid in (np.ones_like(i.valid), None)
    )
    tolerance = adjoint_tolerance(kernels)
    for name in before:
        assert largest_error(after[name], before[name]) <= tolerance, f"masked pixels change the {name}"
        assert largest_error(all_valid[name], no_mask[name]) <= tolerance, f"a mask of ones changes the {name}"


def check_masked_view_is_a_missing_view(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """A view without a valid pixel gives value and gradient of the light field without that view."""
    valid = np.ones(i.recorded.shape[:3], np.float32)
    valid[0] = 0
    masked = SimpleNamespace(**{**vars(i), "valid": valid})
    missing = SimpleNamespace(**{**vars(i), "recorded": i.recorded[1:], "offsets": i.offsets[1:], "valid": None})
    got, want = (compute(kernels, device, operation_of(data_term), inputs) for inputs in (masked, missing))
    for name in want:
        assert largest_error(got[name], want[name]) <= adjoint_tolerance(kernels), f"a masked view changes the {name}"


def check_nothing_valid_is_nothing_at_all(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """Where no recorded pixel is valid, there is nothing to differ from: value and gradient are 0."""
    hidden = SimpleNamespace(**{**vars(i), "valid": np.zeros_like(i.valid)})
    for name, output in compute(kernels, device, operation_of(data_term), hidden).items():
        assert not output.any(), f"without a valid pixel the {name} is not 0"


# --- the whole energy: data term and prior as the refinement puts them together ---

_DIFFERENCE_STEP = 1e-6  # pixels per view step


def check_energy(kernels: KernelSet, device: str, i: SimpleNamespace, tolerance: float) -> None:
    """Value and gradient are the reference's; the gradient is that of central differences in float64."""
    value, gradient = _energy(kernels, device, i)(i.disparity)
    true_energy = _energy(load("reference"), "cpu", i)
    true_value, true_gradient = true_energy(i.disparity)
    assert gradient.shape == i.disparity.shape
    differences = np.empty_like(true_gradient)
    for place in np.ndindex(i.disparity.shape):
        step = np.zeros_like(i.disparity)
        step[place] = _DIFFERENCE_STEP
        above, below = true_energy(i.disparity + step)[0], true_energy(i.disparity - step)[0]
        differences[place] = (above - below) / (2 * _DIFFERENCE_STEP)
    errors = {
        "value": largest_error(np.float64(value), np.float64(true_value)),
        "gradient": largest_error(gradient, true_gradient),
        "gradient against central differences": largest_error(gradient, differences),
    }
    for name, error in errors.items():
        assert error <= tolerance, f"energy: the {name} is off by {error:.2e}, more than {tolerance:.0e}"


def _energy(kernels: KernelSet, device: str, i: SimpleNamespace) -> Energy:
    reference = i.lf.reference_index
    valid = None if i.lf.valid is None else i.lf.valid[reference]
    model = ForwardModel(i.lf, i.refinement, kernels, device)
    prior = NonLocalMeans(i.lf.image(reference), i.prior, kernels, device, valid=valid)
    return Energy(model, prior, i.refinement.smoothness)


def check_dot_in_double(kernels: KernelSet, device: str) -> None:
    """`dot` accumulates in float64: 1 + 2⁻³⁰ is not 1."""
    values = np.array([1.0, 2.0**-15, -(2.0**-15)], np.float32)
    fields = (kernels.field(a, device) for a in (values, np.abs(values) * (1, 1, 0)))
    assert kernels.dot(*fields) == 1.0 + 2.0**-30, "dot rounds its sum to float32"


def _same_product(what: str, kernels: KernelSet, left: tuple[Values, Values], right: tuple[Values, Values]) -> float:
    (a, b), (c, d) = (tuple(values.astype(np.float64) for values in pair) for pair in (left, right))
    scale = float(np.linalg.norm(a) * np.linalg.norm(b) + np.linalg.norm(c) * np.linalg.norm(d)) / 2
    error = abs(float(np.vdot(a, b) - np.vdot(c, d)))
    relative = error / scale if scale else error
    limit = adjoint_tolerance(kernels)
    assert relative <= limit, f"{what}: the products differ by {relative:.2e} relative to their size, not {limit:.0e}"
    return relative
