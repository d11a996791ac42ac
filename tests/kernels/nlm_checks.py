"""The checks of the non-local-means weights and their operators."""

from types import SimpleNamespace

import numpy as np
from checks import Desk, Operation, Outputs, adjoint_tolerance, compute, relative_to_terms, same_product, size

from lfgpu.contract import KernelSet


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
    """Alone, and with a diagonal."""
    weights, values, diagonal = desk.field(i.weights), desk.field(i.values), desk.field(i.values[::-1, ::-1])
    alone, beside = desk.out(i.values.shape), desk.out(i.values.shape)
    desk.kernels.nlm_laplacian(weights, values, window=i.window, laplacian_out=alone)
    desk.kernels.nlm_laplacian(weights, values, window=i.window, laplacian_out=beside, diagonal=diagonal)
    return {"laplacian": alone, "and diagonal": beside}


NEIGHBORS = Operation(nlm_neighbors, "nlm", relative_to_terms(sums=lambda i: size(i.values)))
LAPLACIAN = Operation(
    nlm_laplacian, "nlm", relative_to_terms(**dict.fromkeys(("laplacian", "and diagonal"), lambda i: size(i.values)))
)
WEIGHTS = Operation(nlm_weights, "nlm")
OPERATIONS = (WEIGHTS, NEIGHBORS, LAPLACIAN)


def check_nlm_symmetric(kernels: KernelSet, device: str, i: SimpleNamespace) -> None:
    """⟨W x, y⟩ = ⟨x, W y⟩, the same for L; L takes a constant to 0; L = diag(W 1) - W."""
    other = SimpleNamespace(**{**vars(i), "values": i.other_values})
    ones = SimpleNamespace(**{**vars(i), "values": np.ones_like(i.values)})
    for operation, output in ((NEIGHBORS, "sums"), (LAPLACIAN, "laplacian")):
        a, b = (compute(kernels, device, operation, inputs)[output] for inputs in (i, other))
        same_product(str(operation), kernels, (a, i.other_values), (i.values, b))
    constant = compute(kernels, device, LAPLACIAN, ones)["laplacian"]
    assert np.abs(constant).max() <= adjoint_tolerance(kernels) * i.weights.sum(), "L 1 is not 0"
    degree = compute(kernels, device, NEIGHBORS, ones)["sums"].astype(np.float64)
    sums = compute(kernels, device, NEIGHBORS, i)["sums"]
    got = compute(kernels, device, LAPLACIAN, i)["laplacian"]
    error = np.abs(got - (degree * i.values - sums)).max() / max(1.0, float(np.abs(degree * i.values).max()))
    assert error <= 5 * adjoint_tolerance(kernels), f"L and diag(W 1) - W differ by {error:.2e}"
